//! What 8 bits cost: `radiance-transfer-ldr` against the same passes in radiance, in code values of the picture.

use super::percentile;
use super::statics::Static;
use crate::artefact::json;
use crate::composite::{composite, picture, write_png};
use crate::config::{Render, ShadowMethod};
use crate::driver::validate;
use crate::error::{Context as _, Result};
use crate::evaluate::display::flip;
use crate::exposure::{Capture, decode};
use crate::image::{Code, CodeImage, Image, RadianceImage};
use crate::printer::Printer;
use crate::render::Layer;
use crate::response::Response;
use crate::shadow::{self, Removed, Stored};
use crate::stage::Workspace;
use std::path::{Path, PathBuf};

/// Numbers of passes.
const PASSES: [usize; 3] = [10, 50, 200];
/// The number whose pictures are kept.
const SHOWN: usize = 50;
/// The region is where radiance removes more than this share of the plate.
const REMOVED: f32 = 0.02;
/// Side of the blocks whose means show structure under the grain, px.
const BLOCK: usize = 4;
/// Pictures reach this far beyond the region, px.
const MARGIN: usize = 16;
/// Times by which differences are amplified in pictures.
const GAIN: f32 = 16.0;

/// A capture with what the camera stored of it.
struct Subject {
    name: String,
    statics: Static,
    codes: CodeImage,
    response: Response,
    render: Render,
}

/// Figures of one number of passes, code values.
struct Row {
    /// Mean of the differences, + too bright.
    bias: f64,
    mean: f64,
    percentile_95: f64,
    largest: f64,
    /// Rms of the differences' block means: what is left of them under grain.
    blocks: f64,
    /// Steps between neighbouring blocks of what is removed beyond those in radiance: 95th percentile.
    step: f64,
    /// Median of the same of the photograph itself: its texture and grain, which hide smaller steps.
    own_step: f64,
    /// Distinct green values of what is removed, in 8 bits and in radiance.
    levels: [usize; 2],
    /// Mean ꟻLIP.
    flip: f64,
}

/// Prints a row for each capture and number of passes; writes a picture of each capture into `pictures`: radiance, 8 bits,
/// and their difference, amplified.
pub(super) fn print(
    settings: &[PathBuf],
    workspaces: &[Workspace],
    pictures: Option<&Path>,
    printer: &Printer,
) -> Result<()> {
    printer.data(&format!(
        "\n8-bit subtraction against radiance: differences of the pictures in 8-bit code values where more than {} % is \
         removed and no object stands, all channels; steps between means of {BLOCK}×{BLOCK} px, and whether most of \
         them stay under the photograph's own",
        100.0 * REMOVED
    ));
    printer.data(&format!(
        "{:<24}{:>7}{:>9}{:>8}{:>8}{:>8}{:>8}{:>9}{:>8}{:>9}{:>9}{:>9}{:>9}",
        "capture",
        "passes",
        "px",
        "bias",
        "mean",
        "95 %",
        "max",
        "blocks",
        "step",
        "own",
        "levels",
        "of",
        "flip"
    ));
    for (file, workspace) in settings.iter().zip(workspaces) {
        let subject = Subject::read(validate::name(file), workspace)?;
        for passes in PASSES {
            let [radiance, ldr] =
                [ShadowMethod::RadianceTransfer, ShadowMethod::RadianceTransferLdr].map(|method| {
                    let render = Render { method, passes, ..subject.render.clone() };
                    subject.removed(&render)
                });
            let (radiance, ldr) = (radiance?, ldr?);
            let region = subject.region(&radiance.epsilon);
            let exact = subject.picture(&radiance)?;
            let Some(codes) = ldr.codes else { continue };
            // Under the object nobody sees the shadow.
            let codes = Image::from_fn(codes.width(), codes.height(), |x, y| {
                *if *region.at(x, y) { &codes } else { &exact }.at(x, y)
            });
            let row = subject.compare(&exact, &codes, &region);
            printer.data(&line(&subject.name, passes, &region, &row));
            if let (SHOWN, Some(folder)) = (passes, pictures) {
                let path = folder.join(format!("ldr_{}.png", subject.name.replace('/', "_")));
                write_png(&path, &side_by_side(&exact, &codes, &region))?;
                printer.data(&path.display().to_string());
            }
        }
    }
    Ok(())
}

fn line(name: &str, passes: usize, region: &Image<bool>, row: &Row) -> String {
    let px = region.pixels().iter().filter(|r| **r).count();
    format!(
        "{name:<24}{passes:>7}{px:>9}{:>+8.2}{:>8.2}{:>8.1}{:>8.0}{:>9.2}{:>10.2}{:>9.2}{:>9}{:>9}{:>9}{:>9.4}",
        row.bias,
        row.mean,
        row.percentile_95,
        row.largest,
        row.blocks,
        row.step,
        row.own_step,
        if row.step > row.own_step { "over" } else { "under" },
        row.levels[0],
        row.levels[1],
        row.flip
    )
}

impl Subject {
    fn read(name: String, workspace: &Workspace) -> Result<Self> {
        let capture: Capture = json::read(&workspace.folder("ingest").join("capture.json"))?;
        let path = workspace.base.join(&capture.photos).join(&capture.plate()?.file);
        Ok(Self {
            name,
            statics: Static::read(workspace)?,
            codes: decode(&path)?.codes(&path)?,
            response: json::read(&workspace.folder("response").join("response.json"))?,
            render: workspace.pipeline.render.clone(),
        })
    }

    fn removed(&self, settings: &Render) -> Result<Removed> {
        let stored = Stored { codes: &self.codes, response: &self.response };
        let scene = shadow::Scene { stored: Some(stored), ..self.statics.scene() };
        shadow::removed_radiance(&scene, &self.statics.occluder(), settings).doing("finding the shadow")
    }

    /// Shadowed receiver pixels that the object leaves free.
    fn region(&self, epsilon: &RadianceImage) -> Image<bool> {
        let object =
            crate::visibility::Bvh::new(&self.statics.object.vertices, &self.statics.object.triangles);
        let eye = self.statics.cameras.plate_camera().centre();
        let eye = glam::Vec3::new(eye.x as f32, eye.y as f32, eye.z as f32);
        let inside = (0..epsilon.pixels().len()).map(|i| {
            let Some(receiver) = &self.statics.receivers.pixels.pixels()[i] else { return false };
            let (gone, plate) = (epsilon.pixels()[i].luminance(), self.statics.plate.pixels()[i].luminance());
            gone > REMOVED * plate && !object.occluded(eye, receiver.position)
        });
        Image::from_pixels(epsilon.width(), epsilon.height(), inside.collect())
    }

    /// The photograph with the shadow taken from its radiance; without the object.
    fn picture(&self, removed: &Removed) -> Result<CodeImage> {
        let (width, height) = self.codes.size();
        let nothing = |v: f32| Image::from_fn(width, height, |_, _| v);
        let layer = Layer {
            colour: self.codes.map(|_| Default::default()),
            coverage: nothing(0.0),
            depth: nothing(1.0),
        };
        let plate = &self.statics.plate;
        let result = composite(plate, &removed.epsilon, &layer).doing("subtracting the shadow")?;
        let encode = |v| self.response.code_of(v);
        picture(&self.codes, None, plate, &result.radiance, &layer, encode)
            .doing("mapping the picture back through the response")
    }

    fn compare(&self, exact: &CodeImage, ldr: &CodeImage, region: &Image<bool>) -> Row {
        let value =
            |image: &CodeImage, i: usize, c: usize| (f64::from(image.pixels()[i].0[c]) * 255.0).round();
        let inside: Vec<usize> = (0..region.pixels().len()).filter(|&i| region.pixels()[i]).collect();
        let mut sizes: Vec<f64> = Vec::with_capacity(3 * inside.len());
        let mut sum = 0.0;
        for (&i, c) in inside.iter().flat_map(|i| (0..3).map(move |c| (i, c))) {
            let difference = value(ldr, i, c) - value(exact, i, c);
            sum += difference;
            sizes.push(difference.abs());
        }
        sizes.sort_by(f64::total_cmp);
        let count = sizes.len().max(1) as f64;
        let levels = |image: &CodeImage| {
            let taken = inside.iter().map(|&i| (value(&self.codes, i, 1) - value(image, i, 1)) as i32);
            taken.collect::<std::collections::BTreeSet<i32>>().len()
        };
        let difference = blocks(region, |i| value(ldr, i, 1) - 255.0 * f64::from(exact.pixels()[i].0[1]));
        let own = blocks(region, |i| value(&self.codes, i, 1));
        let square: f64 = difference.pixels().iter().flatten().map(|d| d * d).sum();
        let block_count = difference.pixels().iter().flatten().count().max(1) as f64;
        Row {
            bias: sum / count,
            mean: sizes.iter().sum::<f64>() / count,
            percentile_95: percentile(&sizes, 0.95),
            largest: sizes.last().copied().unwrap_or(0.0),
            blocks: (square / block_count).sqrt(),
            step: percentile(&steps(&difference), 0.95),
            own_step: percentile(&steps(&own), 0.5),
            levels: [levels(ldr), levels(exact)],
            flip: flip(&crop(ldr, region), &crop(exact, region)),
        }
    }
}

/// Means over blocks that lie wholly in the region.
fn blocks(region: &Image<bool>, value: impl Fn(usize) -> f64) -> Image<Option<f64>> {
    let width = region.width();
    Image::from_fn(width / BLOCK, region.height() / BLOCK, |x, y| {
        let members = || (0..BLOCK * BLOCK).map(|k| (y * BLOCK + k / BLOCK) * width + x * BLOCK + k % BLOCK);
        members()
            .all(|i| region.pixels()[i])
            .then(|| members().map(&value).sum::<f64>() / (BLOCK * BLOCK) as f64)
    })
}

/// Sizes of the steps between neighbouring blocks, ascending.
fn steps(means: &Image<Option<f64>>) -> Vec<f64> {
    let (width, height) = means.size();
    let mut steps = Vec::new();
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        let Some(here) = means.at(x, y) else { continue };
        let right = (x + 1 < width).then(|| *means.at(x + 1, y)).flatten();
        let below = (y + 1 < height).then(|| *means.at(x, y + 1)).flatten();
        steps.extend([right, below].into_iter().flatten().map(|there| (there - here).abs()));
    }
    steps.sort_by(f64::total_cmp);
    steps
}

/// The region's surroundings.
fn crop(image: &CodeImage, region: &Image<bool>) -> CodeImage {
    let (width, height) = region.size();
    let used = || (0..width * height).filter(|&i| region.pixels()[i]).map(|i| (i % width, i / width));
    let (left, right) = (used().map(|p| p.0).min().unwrap_or(0), used().map(|p| p.0).max().unwrap_or(0));
    let (top, bottom) = (used().map(|p| p.1).min().unwrap_or(0), used().map(|p| p.1).max().unwrap_or(0));
    let (left, top) = (left.saturating_sub(MARGIN), top.saturating_sub(MARGIN));
    let (right, bottom) = ((right + MARGIN).min(width - 1), (bottom + MARGIN).min(height - 1));
    Image::from_fn(right - left + 1, bottom - top + 1, |x, y| *image.at(left + x, top + y))
}

/// Radiance, 8 bits, and 8 bits less radiance, amplified, on grey.
fn side_by_side(exact: &CodeImage, ldr: &CodeImage, region: &Image<bool>) -> CodeImage {
    let (exact, ldr) = (crop(exact, region), crop(ldr, region));
    let (width, height) = exact.size();
    Image::from_fn(3 * width, height, |x, y| {
        let (a, b) = (exact.at(x % width, y).0, ldr.at(x % width, y).0);
        match x / width {
            0 => Code(a),
            1 => Code(b),
            _ => Code(std::array::from_fn(|c| (0.5 + GAIN * (b[c] - a[c])).clamp(0.0, 1.0))),
        }
    })
}

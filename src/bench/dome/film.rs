//! The film beside its truth, and the film by ever more lights.

use super::{SPLITS, TABLE_1};
use crate::bench::spread;
use crate::config::Render;
use crate::driver::live::{Film, session};
use crate::error::{Context as _, Result};
use crate::exposure::{Photograph, decode};
use crate::image::{CodeImage, Image, Radiance, RadianceImage};
use crate::live::Output;
use crate::printer::Printer;
use crate::response::Response;
use crate::stage::Workspace;
use crate::synthetic::table;
use nalgebra::Point3;
use std::path::Path;

/// Frames shown of a film, without and with the lamp.
pub const SHOWN: [usize; 2] = [29, 59];
/// Size of a picture on the sheet, px.
pub const CELL: [usize; 2] = [160, 120];

/// Runs a film through; gives the frames shown.
pub fn film(workspace: &Workspace, name: &str, printer: &Printer) -> Result<Vec<CodeImage>> {
    let (mut shown, mut ms, mut lights) = (Vec::new(), Vec::new(), 0);
    run(workspace, |frame, _, output| {
        let t = output.timing;
        ms.push(t.pose + t.light + t.maps + t.shadow + t.object);
        lights = lights.max(output.lights);
        if SHOWN.contains(&frame) {
            shown.push(output.picture);
        }
    })?;
    printer.data(&format!(
        "\n{name}: {} frames, up to {lights} lights, {:.1} ms a frame",
        ms.len(),
        if ms.is_empty() { 0.0 } else { spread(&mut ms)[0] }
    ));
    Ok(shown)
}

/// Figure 6 on the film: both frames shown by the lights of Table 1, beside truth; prints the errors of their shadows.
pub fn series(
    workspace: &Workspace,
    file: &Path,
    printer: &Printer,
) -> Result<Vec<Vec<(String, CodeImage)>>> {
    let mut rows = SHOWN.map(|_| Vec::new());
    printer.data(&format!(
        "\nthe film by lights: relative shadow error and energy bias of frames {SHOWN:?} against the truth\n{:>7}{:>9}{:>9}{:>9}{:>9}",
        "lights", "error", "bias %", "error", "bias %"
    ));
    for (count, texels, _) in TABLE_1 {
        let workspace = with_lights(workspace, count, texels);
        let (mut lights, mut cells) = (0, String::new());
        run(&workspace, |frame, plate, output| {
            lights = lights.max(output.lights);
            let Some(row) = SHOWN.iter().position(|s| *s == frame) else { return };
            let found = judge(file, frame, &plate.map(|c| linear(c.0)), &output.radiance);
            cells += &match found {
                Some([error, bias]) => format!("{error:>9.3}{:>+9.1}", 100.0 * bias),
                None => format!("{:>18}", "no truth"),
            };
            let label = found.map_or(String::new(), |[error, _]| format!(", {error:.2}"));
            rows[row].push((format!("{} lights{label}", output.lights), cut(&output.picture, frame)));
        })?;
        printer.data(&format!("{lights:>7}{cells}"));
    }
    for (row, frame) in rows.iter_mut().zip(SHOWN) {
        row.extend(truth_of(file, frame).map(|truth| ("truth".to_string(), cut(&truth, frame))));
    }
    Ok(rows.into())
}

/// The same film with so many lights, those of Table 1.
pub fn with_lights(workspace: &Workspace, count: usize, texels: usize) -> Workspace {
    let mut pipeline = workspace.pipeline.clone();
    pipeline.live.most_lights = Some(count);
    let splits = if count > 192 { SPLITS } else { 0 };
    pipeline.render =
        Render { dome_texels: texels, dome_splits: splits, dome_centroid: true, ..pipeline.render };
    Workspace { pipeline, ..workspace.clone() }
}

/// A frame with the object in it, where the film has it.
pub fn truth_of(settings: &Path, frame: usize) -> Option<CodeImage> {
    picture(settings, &format!("{frame:04}"))
}

fn picture(settings: &Path, name: &str) -> Option<CodeImage> {
    match decode(&settings.parent()?.join(format!("truth/{name}.jpg"))).ok()? {
        Photograph::Codes(codes) => Some(codes),
        Photograph::Linear(_) => None,
    }
}

fn linear(codes: [f32; 3]) -> Radiance {
    Radiance(Response::srgb().exposure_of(codes))
}

/// Relative error and bias of a frame's shadow, where the film has truth.
fn judge(settings: &Path, frame: usize, plate: &RadianceImage, ours: &RadianceImage) -> Option<[f64; 2]> {
    let [with, empty] = [format!("{frame:04}"), format!("empty_{frame:04}")]
        .map(|name| Some(picture(settings, &name)?.map(|c| linear(c.0))));
    let [squares, signal, found, truth] = table::shadow_sums(&with?, &empty?, plate, ours);
    Some([(squares / signal).sqrt(), found / truth - 1.0])
}

/// What of a frame lies around the object.
fn cut(picture: &CodeImage, frame: usize) -> CodeImage {
    let foot = table::pose_of(frame).0;
    let place = Point3::new(f64::from(foot.x), 0.03, f64::from(foot.z));
    let middle = table::camera_of(frame).project(&place).unwrap_or_default();
    let start = |at: f64, cell: usize, size: usize| (at as usize).saturating_sub(cell / 2).min(size - cell);
    let (left, top) = (start(middle.x, CELL[0], picture.width()), start(middle.y, CELL[1], picture.height()));
    Image::from_fn(CELL[0], CELL[1], |x, y| *picture.at(left + x, top + y))
}

/// Puts the object into all frames; `take` gets each frame's number, the frame and what was made of it.
fn run(workspace: &Workspace, mut take: impl FnMut(usize, &CodeImage, Output)) -> Result<()> {
    let mut film = Film::open(workspace)?;
    let (mut live, mut count) = (None, 0);
    while let Some((frame, other)) = film.next()? {
        if live.is_none() {
            live = Some(session(workspace, frame.size(), other.as_ref().map(CodeImage::size))?);
        }
        let Some(live) = &mut live else { continue };
        let output = live.frame(&frame, other.as_ref()).doing("putting the object into the film")?;
        take(count, &frame, output);
        count += 1;
    }
    Ok(())
}

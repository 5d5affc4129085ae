//! A mirror ball of ours where a real one stood: the photographs of the probe, taken from the plate's place, beside the plate
//! with the object of the settings, and what either takes from the surface around.

use super::super::triptych;
use crate::artefact::exr;
use crate::composite::view;
use crate::driver::run::{self, Range};
use crate::driver::validate;
use crate::error::{Error, Result};
use crate::evaluate::error_map;
use crate::image::{CodeImage, Image, Radiance, RadianceImage, luminance};
use crate::printer::Printer;
use crate::response::Response;
use crate::stage::Workspace;
use std::path::{Path, PathBuf};

/// Ratios are taken after a blur of this standard deviation, px: of texture, and of what alignment leaves.
const BLUR_PX: f64 = 4.0;
/// Bins of the photograph's ratio, with over without the ball.
const BINS: [(f64, f64); 6] =
    [(0.0, 0.72), (0.72, 0.80), (0.80, 0.86), (0.86, 0.90), (0.90, 0.94), (0.98, 1.02)];
/// Ends of the pictures of ratios, and of the difference as a share of the plate.
const RATIO: f32 = 0.3;
/// What is brighter than without the ball by more than this is no shadow.
const CAUSTIC: f64 = 0.05;
/// Bins of fewer pixels say nothing.
const LEAST_PX: usize = 100;

/// Prints a block for each settings file whose probe was photographed from the plate's place.
pub(in crate::bench) fn print(
    settings: &[PathBuf],
    pictures: Option<&Path>,
    printer: &Printer,
) -> Result<()> {
    for file in settings {
        let workspace = Workspace::open(file)?;
        run::stages(&workspace, &Range::default(), printer)?;
        let name = validate::name(file);
        let pair = Pair::read(&workspace)?;
        pair.print(&name, printer);
        if let Some(folder) = pictures {
            pair.draw(&folder.join(format!("{}_ball.jpg", super::super::capture_name(&workspace)?)))?;
        }
    }
    Ok(())
}

/// Both pictures, and what is needed to compare them.
struct Pair {
    plate: RadianceImage,
    photograph: RadianceImage,
    ours: RadianceImage,
    /// Where the model receives a shadow and the object does not hide it.
    receives: Image<bool>,
    /// Luminance with over without the ball, of the photograph and of ours.
    ratios: [Image<f32>; 2],
}

impl Pair {
    fn read(workspace: &Workspace) -> Result<Self> {
        let planes = |stage: &str, name: &str| exr::read(&workspace.folder(stage).join(name));
        let radiance = |stage: &str, name: &str| exr::read_radiance(&workspace.folder(stage).join(name));
        let (plate, photograph) = (radiance("merge", "plate.exr")?, radiance("probe", "probe.exr")?);
        if plate.size() != photograph.size() {
            return Err(Error::Usage {
                problem: "the probe was not photographed from the plate's place".into(),
                hint: "the table `ball` is for captures with probe.camera = \"plate\"".into(),
            });
        }
        let (removed, reflected) = (radiance("render", "removed.exr")?, radiance("render", "reflected.exr")?);
        let (receivers, object) = (planes("render", "receivers.exr")?, planes("render", "object.exr")?);
        let covered = object.plane("A").unwrap_or_default();
        let seen = receivers.plane("Y").unwrap_or_default();
        let (w, h) = plate.size();
        let receives = Image::from_fn(w, h, |x, y| {
            let i = y * w + x;
            seen.get(i).is_some_and(|v| *v > 0.5) && covered.get(i).is_none_or(|a| *a < 1e-3)
        });
        let shadowed = Image::from_fn(w, h, |x, y| {
            let at = |image: &RadianceImage, k: usize| image.at(x, y).0[k];
            Radiance([0, 1, 2].map(|k| at(&plate, k) - at(&removed, k) + at(&reflected, k)))
        });
        let before = blurred(&plate);
        let ratio = |image: &RadianceImage| {
            let after = blurred(image);
            Image::from_fn(w, h, |x, y| after.at(x, y) / before.at(x, y).max(1e-6))
        };
        let ratios = [ratio(&photograph), ratio(&shadowed)];
        let ours = radiance("composite", "augmented.exr")?;
        Ok(Self { plate, photograph, ours, receives, ratios })
    }

    fn print(&self, name: &str, printer: &Printer) {
        printer.data(&format!(
            "\n{name}: luminance with the ball over without it, where the photograph has some ratio: mean there, and ours"
        ));
        printer.data(&format!("{:>14}{:>8}{:>14}{:>10}", "photograph", "px", "photograph", "ours"));
        let [theirs, ours] = &self.ratios;
        let pixels = || (0..self.receives.pixels().len()).filter(|i| self.receives.pixels()[*i]);
        for (low, high) in BINS {
            let inside: Vec<usize> =
                pixels().filter(|i| (low..high).contains(&f64::from(theirs.pixels()[*i]))).collect();
            if inside.len() < LEAST_PX {
                continue;
            }
            let mean = |of: &Image<f32>| {
                inside.iter().map(|i| f64::from(of.pixels()[*i])).sum::<f64>() / inside.len() as f64
            };
            printer.data(&format!(
                "{:>14}{:>8}{:>14.3}{:>10.3}",
                format!("{low:.2}-{high:.2}"),
                inside.len(),
                mean(theirs),
                mean(ours)
            ));
        }
        // Where the real ball's stand stood, or throws its caustics, nothing is compared.
        let all: Vec<[f64; 2]> = pixels()
            .map(|i| [theirs, ours].map(|r| 1.0 - f64::from(r.pixels()[i])))
            .filter(|[shadow, _]| *shadow < 1.0 - BINS[0].1 && *shadow > -CAUSTIC)
            .collect();
        let sum = |f: &dyn Fn(&[f64; 2]) -> f64| all.iter().map(f).sum::<f64>();
        let n = all.len().max(1) as f64;
        let [a, b] = [sum(&|v| v[0]) / n, sum(&|v| v[1]) / n];
        let covariance = sum(&|v| (v[0] - a) * (v[1] - b));
        let spread = sum(&|v| (v[0] - a).powi(2)) * sum(&|v| (v[1] - b).powi(2));
        printer.data(&format!(
            "shadow of ours over the photograph's {:.2}; their correlation over {} px {:.2}",
            b / a,
            all.len(),
            covariance / spread.sqrt()
        ));
    }

    /// Photograph, ours and difference; below the ratios of both and their difference.
    fn draw(&self, path: &Path) -> Result<()> {
        let (w, h) = self.plate.size();
        // The receivers, and as much above them.
        let inside = || (0..w * h).filter(|i| self.receives.pixels()[*i]).map(|i| (i % w, i / w));
        let (left, right) = inside().fold((w, 0), |(a, b), (x, _)| (a.min(x), b.max(x + 1)));
        let (top, bottom) = inside().fold((h, 0), |(a, b), (_, y)| (a.min(y), b.max(y + 1)));
        let top = top.saturating_sub(bottom.saturating_sub(top) * 5 / 4);
        if left >= right || top >= bottom {
            return Ok(());
        }
        let crop = |image: &CodeImage| {
            Image::from_fn(right - left, bottom - top, |x, y| *image.at(left + x, top + y))
        };
        let srgb = Response::srgb();
        let brightest = inside().map(|(x, y)| self.plate.at(x, y).luminance()).fold(0.0, f32::max);
        let stops = (0.6 / brightest.max(1e-6)).log2();
        let shown = |image: &RadianceImage| crop(&view(image, stops, |l| srgb.code_of(l)));
        let map = |image: &Image<f32>| crop(&error_map(&image.map(|v| Radiance([1.0 - v; 3])), RATIO).image);
        let difference = Image::from_fn(w, h, |x, y| {
            let [a, b] = [&self.photograph, &self.ours].map(|i| i.at(x, y).0);
            Radiance([0, 1, 2].map(|k| a[k] - b[k]))
        });
        let off =
            Image::from_fn(w, h, |x, y| Radiance([self.ratios[0].at(x, y) - self.ratios[1].at(x, y); 3]));
        let most = 0.5 * brightest;
        let rows = [
            vec![
                ("photograph".to_string(), shown(&self.photograph)),
                ("ours".to_string(), shown(&self.ours)),
                (format!("red too dark, +-{most:.2}"), crop(&error_map(&difference, most).image)),
            ],
            vec![
                (format!("with/without, 1+-{RATIO}"), map(&self.ratios[0])),
                ("ours".to_string(), map(&self.ratios[1])),
                ("red: ours is darker".to_string(), crop(&error_map(&off, RATIO).image)),
            ],
        ];
        triptych::write_sheet(path, &rows)
    }
}

/// Luminance under a Gaussian.
fn blurred(image: &RadianceImage) -> Image<f32> {
    let reach = (3.0 * BLUR_PX).ceil() as i64;
    let kernel: Vec<f64> = (-reach..=reach).map(|i| (-0.5 * (i as f64 / BLUR_PX).powi(2)).exp()).collect();
    let all: f64 = kernel.iter().sum();
    let (w, h) = image.size();
    let along = |image: &Image<f32>, dx: i64, dy: i64| {
        Image::from_fn(w, h, |x, y| {
            let at = |i: i64, n: usize, k: i64| (i + k).clamp(0, n as i64 - 1) as usize;
            let sum: f64 = kernel
                .iter()
                .zip(-reach..)
                .map(|(weight, k)| {
                    weight * f64::from(*image.at(at(x as i64, w, dx * k), at(y as i64, h, dy * k)))
                })
                .sum();
            (sum / all) as f32
        })
    };
    let luminances = image.map(|p| luminance(p.0));
    along(&along(&luminances, 1, 0), 0, 1)
}

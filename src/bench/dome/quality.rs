//! Figure 6 on a still: error and picture of the shadow by lights.

use super::SPLITS;
use super::film::CELL;
use crate::bench::spread;
use crate::bench::subject::Subject;
use crate::config::{Render, ShadowMethod};
use crate::error::{Context as _, Result};
use crate::image::{Code, CodeImage, Image, Radiance, RadianceImage};
use crate::printer::Printer;
use crate::response::Response;
use crate::shadow::Session;

/// Rays a pixel of the reference.
const REFERENCE: usize = 512;
/// Texels a face.
const TEXELS: [usize; 3] = [2, 4, 8];
/// Where the rays remove less than this share of the plate there is no shadow to look at.
const EDGE: f32 = 0.08;
/// Pictures show so many times what the shadow covers.
const MARGIN: f64 = 1.15;

/// Prints the table; gives pictures of the plate by some of its rows, lights at infinity as in the paper, and by the rays.
pub fn quality(subject: &Subject, frames: usize, printer: &Printer) -> Result<Vec<(String, CodeImage)>> {
    let mut shown = Vec::new();
    let reference = subject.traced(REFERENCE, subject.settings.seed ^ 0x5eed)?;
    printer.data(&format!(
        "\n{}: relative shadow error and energy bias against {REFERENCE} rays a pixel (noise {:.3}); ms, medians of {frames} frames",
        subject.name,
        reference.noise.unwrap_or(0.0)
    ));
    printer.data(&format!(
        "{:<10}{:<22}{:>8}{:>9}{:>9}{:>9}{:>10}{:>9}{:>9}{:>9}",
        "a face", "lights", "number", "ms", "error", "bias %", "infinity:", "ms", "error", "bias %"
    ));
    for texels in TEXELS {
        for (kind, (name, centroid, splits)) in [
            ("in the middle (paper)", false, 0),
            ("at centroids", true, 0),
            ("and brightest split", true, SPLITS),
        ]
        .into_iter()
        .enumerate()
        {
            let mut cells = String::new();
            for dome_at_infinity in [false, true] {
                let settings = Render {
                    method: ShadowMethod::LightDome,
                    dome_texels: texels,
                    dome_centroid: centroid,
                    dome_splits: splits,
                    dome_at_infinity,
                    ..subject.settings.clone()
                };
                let mut session =
                    Session::prepare(&subject.scene, &settings).doing("preparing the shadow method")?;
                let mut frame = || session.frame(&subject.occluder).doing("finding the shadow");
                let removed = frame()?.removed;
                let mut ms = (0..frames).map(|_| Ok(1e3 * frame()?.seconds)).collect::<Result<Vec<_>>>()?;
                let (error, bias) = subject.errors(&removed.epsilon, &reference.epsilon);
                if dome_at_infinity {
                    if texels > TEXELS[0] || !centroid {
                        let label = format!("{}{texels}x{texels}, {error:.2}", ["", "c ", "s "][kind]);
                        shown.push((label, view(subject, &removed.epsilon, &reference.epsilon)));
                    }
                    cells += &format!("{:>10}", "");
                } else {
                    cells += &format!("{:>8}", removed.sources_used);
                }
                cells += &format!("{:>9.1}{error:>9.3}{:>+9.1}", spread(&mut ms)[0], 100.0 * bias);
            }
            printer.data(&format!("{:<10}{name:<22}{cells}", format!("{texels}×{texels}")));
        }
    }
    // 8×8 at centroids is hardly another picture than 8×8 in the middle.
    shown.retain(|(label, _)| !label.starts_with("c 8"));
    shown.push(("rays".to_string(), view(subject, &reference.epsilon, &reference.epsilon)));
    Ok(shown)
}

/// The plate less ε around the shadow, exposed for the plate's brightest hundredth.
fn view(subject: &Subject, epsilon: &RadianceImage, reference: &RadianceImage) -> CodeImage {
    let plate = subject.scene.plate;
    let (w, h) = plate.size();
    let [mut left, mut top, mut right, mut bottom] = [w, h, 0, 0];
    for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
        if reference.at(x, y).luminance() > EDGE * plate.at(x, y).luminance() {
            [left, top, right, bottom] = [left.min(x), top.min(y), right.max(x), bottom.max(y)];
        }
    }
    let middle = [(left + right) as f64 / 2.0, (top + bottom) as f64 / 2.0];
    let across = right.saturating_sub(left).max(1) as f64 / CELL[0] as f64;
    let down = bottom.saturating_sub(top).max(1) as f64 / CELL[1] as f64;
    let step = MARGIN * across.max(down);
    let mut sorted: Vec<f32> = plate.pixels().iter().map(|p| p.luminance()).collect();
    sorted.sort_by(f32::total_cmp);
    let white = sorted[sorted.len() * 99 / 100].max(f32::MIN_POSITIVE);
    let srgb = Response::srgb();
    let left_over = plate.pixels().iter().zip(epsilon.pixels());
    let left_over = left_over.map(|(b, e)| Radiance([0, 1, 2].map(|k| (b.0[k] - e.0[k]) / white)));
    let left_over = RadianceImage::from_pixels(w, h, left_over.collect());
    Image::from_fn(CELL[0], CELL[1], |x, y| {
        let at = |p: usize, k: usize| middle[k] + (p as f64 + 0.5 - CELL[k] as f64 / 2.0) * step;
        Code(srgb.code_of(left_over.bilinear(at(x, 0), at(y, 1)).0))
    })
}

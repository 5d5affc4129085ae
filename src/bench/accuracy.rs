//! Speed against error: each setting of a shadow method against the ray-traced reference on the same scene model
//! (method error), where the reference removes more than 2 %.

use super::{Static, spread};
use crate::config::{Render, ShadowMethod};
use crate::error::{Context as _, Result};
use crate::image::{RadianceImage, luminance};
use crate::printer::Printer;
use crate::shadow::{self, Caster, Occluder, RadianceTransfer, Removed};
use crate::stage::Workspace;
use std::time::Instant;

/// Numbers of passes; 0 for one a source.
const PASSES: [usize; 6] = [10, 20, 50, 100, 200, 0];
/// Rays per pixel of the ray-traced rows, which use all sources; the references have as many as the settings say.
const RAYS: [usize; 2] = [16, 64];

/// A line of the table.
struct Row {
    name: String,
    removed: Removed,
    ms: Vec<f64>,
}

/// Prints a row for each setting: its error against the reference, and the error that the method expects of itself.
pub(super) fn print(statics: &Static, workspace: &Workspace, frames: usize, printer: &Printer) -> Result<()> {
    let occluder = statics.occluder();
    let settings = &workspace.pipeline.render;
    // Another seed than any row's.
    let reference = Render { seed: settings.seed ^ 0x5eed, ..settings.clone() };
    let reference =
        shadow::raytraced(&statics.scene(), &occluder, &reference).doing("tracing the reference")?;
    printer.data(&format!(
        "\nspeed against error: reference raytraced with {} rays per pixel, noise {:.4}; cpu, {frames} frames",
        settings.rays,
        reference.noise.unwrap_or(0.0)
    ));
    printer.data(&format!(
        "{:<24}{:>7}{:>9}{:>9}{:>9}{:>9}{:>10}{:>8}",
        "method", "maps", "time", "min", "max", "error", "expected", "bias"
    ));
    for passes in PASSES {
        let row = radiance_transfer(statics, &occluder, settings, passes, frames)?;
        printer.data(&line(row, statics, &reference));
    }
    for rays in RAYS.into_iter().filter(|&n| n < settings.rays) {
        printer.data(&line(raytraced(statics, &occluder, settings, rays)?, statics, &reference));
    }
    Ok(())
}

fn line(row: Row, statics: &Static, reference: &Removed) -> String {
    let Row { name, removed, mut ms } = row;
    let [time, least, largest] = spread(&mut ms);
    let (error, bias) = errors(&statics.plate, &removed.epsilon, &reference.epsilon);
    let expected = removed.expected_error.or(removed.noise).unwrap_or(0.0);
    format!(
        "{name:<24}{:>7}{time:>9.1}{least:>9.1}{largest:>9.1}{error:>9.4}{expected:>10.4}{bias:>+8.4}",
        removed.shadow_maps
    )
}

fn radiance_transfer(
    statics: &Static,
    occluder: &Occluder,
    settings: &Render,
    passes: usize,
    frames: usize,
) -> Result<Row> {
    let settings = Render { passes, ..settings.clone() };
    let method =
        RadianceTransfer::prepare(&statics.scene(), &settings).doing("preparing the shadow method")?;
    let caster = Caster::new(occluder, settings.caster_triangles).occluder;
    let frame = || method.removed_radiance(&caster).doing("finding the shadow");
    let removed = frame()?;
    let mut ms = Vec::with_capacity(frames);
    for _ in 0..frames {
        let started = Instant::now();
        std::hint::black_box(frame()?);
        ms.push(started.elapsed().as_secs_f64() * 1e3);
    }
    Ok(Row { name: format!("radiance-transfer {}", removed.passes), removed, ms })
}

fn raytraced(statics: &Static, occluder: &Occluder, settings: &Render, rays: usize) -> Result<Row> {
    let settings = Render { method: ShadowMethod::Raytraced, rays, ..settings.clone() };
    let started = Instant::now();
    let removed = shadow::raytraced(&statics.scene(), occluder, &settings).doing("tracing rays")?;
    let ms = vec![started.elapsed().as_secs_f64() * 1e3];
    Ok(Row { name: format!("raytraced {rays} rays"), removed, ms })
}

/// Relative shadow error and energy bias where the reference removes more than 2 % of the plate.
fn errors(plate: &RadianceImage, found: &RadianceImage, reference: &RadianceImage) -> (f64, f64) {
    let (mut difference, mut signal, mut sum, mut sum_reference) = (0.0, 0.0, 0.0, 0.0);
    for ((b, f), r) in plate.pixels().iter().zip(found.pixels()).zip(reference.pixels()) {
        if luminance(r.0) <= 0.02 * b.luminance() {
            continue;
        }
        for (f, r) in f.0.iter().zip(r.0).map(|(f, r)| (f64::from(*f), f64::from(r))) {
            difference += (f - r).powi(2);
            signal += r * r;
            sum += f;
            sum_reference += r;
        }
    }
    if signal > 0.0 { ((difference / signal).sqrt(), sum / sum_reference - 1.0) } else { (0.0, 0.0) }
}

//! What a frame costs on the graphics processor, by its own clock: by phase, beside the fastest texture lookups that it
//! can make, and how far its answer lies from the CPU's.

use super::subject::{LobbyTransfers, Subject};
use super::{Static, spread};
use crate::config::Render;
use crate::driver::run::{self, Range};
use crate::driver::validate;
use crate::error::{Context as _, Result};
use crate::gpu::{RadianceTransfer, Timing, Twin as _};
use crate::printer::Printer;
use crate::shadow::{Caster, Occluder};
use crate::stage::Workspace;
use glam::Vec3;
use std::path::PathBuf;

/// Patches of the lobby: enough that there are as many sources as are asked for.
const PATCHES: usize = 6000;
/// Sizes of its picture, px.
const SIZES: [[u32; 2]; 2] = [[800, 600], [1920, 1080]];
/// Shadow maps, one a pass.
const MAPS: [usize; 4] = [50, 64, 256, 1024];

/// Prints a table for the lobby in two sizes, then one for each settings file.
pub(super) fn print(settings: &[PathBuf], frames: usize, printer: &Printer) -> Result<()> {
    for size in SIZES {
        let made = LobbyTransfers::seen_in(PATCHES, size)?;
        table(&Subject::lobby(&made), frames, printer)?;
    }
    for file in settings {
        let workspace = Workspace::open(file)?;
        run::stages(&workspace, &Range::default(), printer)?;
        let statics = Static::read(&workspace)?;
        let subject = Subject::capture(validate::name(file), &statics, &workspace.pipeline.render);
        table(&subject, frames, printer)?;
    }
    Ok(())
}

/// Rows of one map a pass, then one with as many as the settings ask for.
fn table(subject: &Subject, frames: usize, printer: &Printer) -> Result<()> {
    let prepare = |settings: &Render| {
        RadianceTransfer::prepare(&subject.scene, settings).doing("preparing the graphics processor")
    };
    let caster = Caster::new(&subject.occluder, subject.settings.caster_triangles).occluder;
    let single = Render { origins: 1, ..subject.settings.clone() };
    let mut method = prepare(&single)?;
    let (width, height) = subject.scene.plate.size();
    printer.data(&format!(
        "\n{}: {width}×{height} px, {} sources, object of {} triangles in maps of at most {} px; {frames} frames",
        subject.name,
        subject.scene.transfers.sources.len(),
        caster.triangles.len(),
        subject.settings.shadow_map_px,
    ));
    let clock = if method.has_timestamps() { "the device's timestamps" } else { "wall time with waits" };
    printer.data(&format!(
        "{}; upload, maps and fused pass by {clock}, the rest by wall time; ms",
        method.adapter()
    ));
    printer.data(&format!(
        "{:>7}{:>7}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>10}{:>9}{:>11}{:>9}",
        "passes",
        "maps",
        "frame",
        "min",
        "max",
        "plan",
        "upload",
        "maps",
        "fused",
        "lookups/s",
        "ceiling",
        "difference",
        "rms"
    ));
    for maps in MAPS {
        method.set_passes(maps);
        row(&mut method, &caster, frames, printer)?;
    }
    drop(method);
    row(&mut prepare(&subject.settings)?, &caster, frames, printer)
}

fn row(method: &mut RadianceTransfer, caster: &Occluder, frames: usize, printer: &Printer) -> Result<()> {
    // The first frame warms caches and compiles pipelines.
    let (removed, difference) = method.parity(caster).doing("comparing with the CPU")?;
    let mut timings: Vec<Timing> = Vec::with_capacity(frames);
    for frame in 0..frames {
        // Moved to and fro by millimetres, so that nothing can be kept from the frame before.
        let by = Vec3::new(1e-3 * (1 + frame % 3) as f32, 0.0, 0.0);
        let mut moved = caster.clone();
        moved.vertices.iter_mut().for_each(|v| *v += by);
        timings.push(method.timed(&moved).doing("drawing a frame")?);
    }
    let of =
        |part: fn(&Timing) -> f64| spread(&mut timings.iter().map(|t| 1e3 * part(t)).collect::<Vec<_>>());
    let [frame, low, high] = of(|t| t.frame);
    let [plan, upload, maps, fused] =
        [of(|t| t.plan), of(|t| t.phases.upload), of(|t| t.phases.maps), of(|t| t.phases.fused)]
            .map(|s| s[0]);
    let lookups = method.lookups(caster).doing("counting lookups")? as f64 / (1e-3 * fused);
    let ceiling = method.ceiling().doing("measuring plain lookups")?;
    printer.data(&format!(
        "{:>7}{:>7}{frame:>9.2}{low:>9.2}{high:>9.2}{plan:>9.2}{upload:>9.2}{maps:>9.2}{fused:>9.2}{:>9.3}G{:>7.1} %{:>9.2} %{:>7.3} %",
        removed.passes,
        removed.shadow_maps,
        1e-9 * lookups,
        100.0 * lookups / ceiling,
        100.0 * difference.relative,
        100.0 * difference.rmse,
    ));
    Ok(())
}

//! What a frame costs when the object moves and all else is reused.

use super::{Static, spread};
use crate::composite::{composite, net};
use crate::config::{Backend, Render, ShadowMethod};
use crate::error::{Context as _, Error, Result};
use crate::printer::Printer;
use crate::render::Frames;
use crate::stage::Workspace;
use glam::{Affine3A, Vec3};
use std::time::Instant;

/// Prints a row for each back end; one that is not there says why.
pub(super) fn print(statics: &Static, workspace: &Workspace, frames: usize, printer: &Printer) -> Result<()> {
    printer.data(&format!(
        "\nframe: {} sources, {} of {} px receive, object of {} triangles; shadow maps {} px; {frames} frames",
        statics.transfers.sources.len(),
        statics.receivers.pixels.pixels().iter().flatten().count(),
        statics.receivers.pixels.pixels().len(),
        statics.object.triangles.len(),
        workspace.pipeline.render.shadow_map_px,
    ));
    printer.data(&format!(
        "{:<8}{:>10}{:>10}{:>10}{:>10}{:>10}{:>12}{:>12}",
        "backend", "casting", "prepare", "shadow", "min", "max", "object", "composite"
    ));
    for backend in [Backend::Cpu, Backend::Gpu] {
        match time(statics, workspace, backend, frames) {
            Ok(row) => printer.data(&row),
            Err(Error::Data { problem, .. }) => printer.data(&format!("{backend:?}: {problem}")),
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

fn time(statics: &Static, workspace: &Workspace, backend: Backend, frames: usize) -> Result<String> {
    let method = ShadowMethod::RadianceTransfer;
    let settings = Render { method, backend, ..workspace.pipeline.render.clone() };
    let started = Instant::now();
    let mut moving =
        Frames::prepare(&statics.scene(), statics.set(&settings), &statics.object, &statics.faces)?;
    let prepare = started.elapsed();
    let (mut shadow_ms, mut object_ms, mut composite_ms) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..=frames {
        let angle = i as f32 * 0.7;
        let motion = Affine3A::from_translation(Vec3::new(angle.cos(), 0.0, angle.sin()) * 0.02);
        let frame = moving.of_path(i, &motion)?;
        let started = Instant::now();
        let composite = net(&frame.removed.epsilon, &frame.shaded.reflected)
            .and_then(|net| composite(&statics.plate, &net, &frame.shaded.rendered.layer));
        let composite_time = started.elapsed();
        std::hint::black_box(composite).doing("compositing")?;
        // The first frame warms caches and compiles pipelines.
        if i > 0 {
            shadow_ms.push(frame.shadow_s * 1e3);
            object_ms.push(frame.shade_s * 1e3);
            composite_ms.push(composite_time.as_secs_f64() * 1e3);
        }
    }
    let name = match backend {
        Backend::Cpu => "cpu",
        Backend::Gpu => "gpu",
    };
    let [shadow, least, largest] = spread(&mut shadow_ms);
    let ([object, ..], [composite, ..]) = (spread(&mut object_ms), spread(&mut composite_ms));
    Ok(format!(
        "{name:<8}{:>10}{:>10.1}{shadow:>10.1}{least:>10.1}{largest:>10.1}{object:>12.1}{composite:>12.1}",
        moving.caster().occluder.triangles.len(),
        prepare.as_secs_f64() * 1e3,
    ))
}

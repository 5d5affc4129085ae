//! What a frame costs when the object moves and all else is reused.

use super::{Static, spread};
use crate::config::Backend;
use crate::error::{Context as _, Error, Result};
use crate::gpu;
use crate::irradiance::Beams;
use crate::printer::Printer;
use crate::render::{self, Environment, Lighting, Object, Shadowed};
use crate::shadow::{self, Occluder, RadianceTransfer, Removed};
use crate::stage::Workspace;
use glam::Vec3;
use std::time::Instant;

/// Prints a row for each back end; one that is not there says why.
pub(super) fn print(statics: &Static, workspace: &Workspace, frames: usize, printer: &Printer) -> Result<()> {
    printer.data(&format!(
        "\nframe: {} sources, {} of {} px receive, {} triangles cast; shadow maps {} px; {frames} frames",
        statics.transfers.sources.len(),
        statics.receivers.pixels.pixels().iter().flatten().count(),
        statics.receivers.pixels.pixels().len(),
        statics.object.triangles.len(),
        workspace.pipeline.render.shadow_map_px,
    ));
    printer.data(&format!(
        "{:<8}{:>10}{:>10}{:>10}{:>10}{:>12}{:>12}",
        "backend", "prepare", "shadow", "min", "max", "object", "composite"
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

/// The shadow method, prepared for one back end.
enum Prepared<'a> {
    Cpu(Box<RadianceTransfer<'a>>),
    Gpu(Box<gpu::RadianceTransfer<'a>>),
}

impl Prepared<'_> {
    fn removed_radiance(&mut self, occluder: &Occluder) -> Result<Removed, shadow::Problem> {
        match self {
            Self::Cpu(method) => method.removed_radiance(occluder),
            Self::Gpu(method) => method.removed_radiance(occluder),
        }
    }
}

fn time(statics: &Static, workspace: &Workspace, backend: Backend, frames: usize) -> Result<String> {
    let settings = &workspace.pipeline.render;
    let scene = statics.scene();
    let started = Instant::now();
    let mut prepared = match backend {
        Backend::Cpu => RadianceTransfer::prepare(&scene, settings).map(|m| Prepared::Cpu(Box::new(m))),
        Backend::Gpu => gpu::RadianceTransfer::prepare(&scene, settings).map(|m| Prepared::Gpu(Box::new(m))),
    }
    .doing("preparing the shadow method")?;
    let prepare = started.elapsed();
    let (mut shadow_ms, mut object_ms, mut composite_ms) = (Vec::new(), Vec::new(), Vec::new());
    for frame in 0..=frames {
        let angle = frame as f32 * 0.7;
        let moved = translated(&statics.object, Vec3::new(angle.cos(), 0.0, angle.sin()) * 0.02);
        let occluder = Occluder { vertices: moved.vertices.clone(), triangles: moved.triangles.clone() };
        let started = Instant::now();
        let removed = prepared.removed_radiance(&occluder).doing("finding the shadow")?;
        let shadow_time = started.elapsed();
        let started = Instant::now();
        let layer = shade(statics, &moved, &removed, workspace);
        let object_time = started.elapsed();
        let started = Instant::now();
        let composite = crate::composite::composite(&statics.plate, &removed.epsilon, &layer);
        let composite_time = started.elapsed();
        std::hint::black_box(composite).doing("compositing")?;
        // The first frame warms caches and compiles pipelines.
        if frame > 0 {
            shadow_ms.push(shadow_time.as_secs_f64() * 1e3);
            object_ms.push(object_time.as_secs_f64() * 1e3);
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
        "{name:<8}{:>10.1}{shadow:>10.1}{least:>10.1}{largest:>10.1}{object:>12.1}{composite:>12.1}",
        prepare.as_secs_f64() * 1e3,
    ))
}

fn translated(object: &Object, by: Vec3) -> Object {
    let mut moved = object.clone();
    moved.vertices.iter_mut().for_each(|v| *v += by);
    moved
}

fn shade(statics: &Static, object: &Object, removed: &Removed, workspace: &Workspace) -> render::Layer {
    let settings = &workspace.pipeline.render;
    let camera = statics.cameras.plate_camera();
    let [low, high] = object.bounds();
    let width = settings.environment_px.max(8);
    let environment =
        Environment::cast(&statics.light, &statics.light_bvh, (low + high) / 2.0, width, width / 2);
    let beams = Beams::new(&statics.light.distant, &statics.light_bvh);
    let irradiance = |position, normal| statics.volume.irradiance_with(&beams, position, normal);
    let shadowed =
        Shadowed { camera, plate: &statics.plate, removed: &removed.epsilon, scene: &statics.scene_bvh };
    let lighting = Lighting::new(&irradiance, &environment, object, settings.shading_rays, Some(&shadowed));
    render::render(object, camera, &statics.scene_bvh, &lighting, settings.antialiasing, settings.seed).layer
}

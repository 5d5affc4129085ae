//! `insitu bench`: what each stage costs, and what a frame costs when the object moves and all else is reused.

use crate::artefact::{exr, json};
use crate::calibrate::Cameras;
use crate::config::Backend;
use crate::driver::run::{self, Range};
use crate::error::{Context as _, Error, Result};
use crate::gpu;
use crate::illuminate;
use crate::irradiance::{Beams, Volume};
use crate::model::{Scene, face};
use crate::printer::Printer;
use crate::render::{self, Environment, Lighting, Object, Shadowed};
use crate::shadow::{self, Occluder, RadianceTransfer, Receivers, Removed};
use crate::stage::{STAGES, Workspace};
use crate::transfer::Transfers;
use crate::visibility::Bvh;
use glam::Vec3;
use std::path::Path;
use std::time::Instant;

/// Runs what is stale, then prints the table of stages and the table of frames.
pub fn bench(settings: &Path, frames: usize, printer: &Printer) -> Result<()> {
    if frames == 0 {
        return Err(Error::Usage {
            problem: "no frames to time".into(),
            hint: "ask for --frames 1 or more".into(),
        });
    }
    let workspace = Workspace::open(settings)?;
    run::stages(&workspace, &Range::default(), printer)?;
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    printer.data(&format!("{threads} threads; times in ms"));
    printer.data(&format!("\n{:<12}{:>10}{:>12}", "stage", "time", "memory MiB"));
    for stage in STAGES {
        let manifest = workspace.manifest(stage.name)?;
        printer.data(&format!(
            "{:<12}{:>10.0}{:>12.0}",
            stage.name,
            manifest.wall_s * 1e3,
            manifest.peak_memory_mib
        ));
    }
    let statics = Static::read(&workspace)?;
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
        match time(&statics, &workspace, backend, frames) {
            Ok(row) => printer.data(&row),
            Err(Error::Data { problem, .. }) => printer.data(&format!("{backend:?}: {problem}")),
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

/// What stays when the object moves.
struct Static {
    cameras: Cameras,
    plate: crate::image::RadianceImage,
    light: illuminate::patch::LightModel,
    volume: Volume,
    transfers: Transfers,
    receivers: Receivers,
    scene_bvh: Bvh,
    light_bvh: Bvh,
    object: Object,
}

impl Static {
    fn read(workspace: &Workspace) -> Result<Self> {
        let file = |stage: &str, name: &str| workspace.folder(stage).join(name);
        let cameras: Cameras = json::read(&file("calibrate", "cameras.json"))?;
        let scene: Scene = json::read(&file("model", "scene.json"))?;
        let light = illuminate::read_light(&workspace.folder("illuminate"))?;
        let faces = face::triangulate(&scene.faces);
        let settings = &workspace.pipeline.render;
        Ok(Self {
            plate: exr::read_radiance(&file("merge", "plate.exr"))?,
            volume: Volume::read(&file("irradiance", "irradiance.ply"))?,
            transfers: Transfers::read(&workspace.folder("transfer"))?,
            receivers: Receivers::cast(cameras.plate_camera(), &light.mesh),
            scene_bvh: Bvh::new(&faces.vertices, &faces.triangles),
            light_bvh: Bvh::new(&light.mesh.vertices, &light.mesh.triangles()),
            object: render::load_object(&workspace.base.join(&settings.object), settings)?,
            cameras,
            light,
        })
    }
}

/// The shadow method, prepared for one back end.
enum Prepared {
    Cpu(Box<RadianceTransfer>),
    Gpu(Box<gpu::RadianceTransfer>),
}

impl Prepared {
    fn removed_radiance(&self, occluder: &Occluder) -> Result<Removed, shadow::Problem> {
        match self {
            Self::Cpu(method) => method.removed_radiance(occluder),
            Self::Gpu(method) => method.removed_radiance(occluder),
        }
    }
}

fn time(statics: &Static, workspace: &Workspace, backend: Backend, frames: usize) -> Result<String> {
    let settings = &workspace.pipeline.render;
    let scene = shadow::Scene {
        light: &statics.light,
        transfers: &statics.transfers,
        receivers: &statics.receivers,
        plate: &statics.plate,
    };
    let started = Instant::now();
    let prepared = match backend {
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
    let median = |ms: &mut Vec<f64>| {
        ms.sort_by(f64::total_cmp);
        ms[ms.len() / 2]
    };
    let shadow = median(&mut shadow_ms);
    Ok(format!(
        "{name:<8}{:>10.1}{shadow:>10.1}{:>10.1}{:>10.1}{:>12.1}{:>12.1}",
        prepare.as_secs_f64() * 1e3,
        shadow_ms[0],
        shadow_ms[shadow_ms.len() - 1],
        median(&mut object_ms),
        median(&mut composite_ms),
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

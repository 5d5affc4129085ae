//! Stage `render`: shadow and object as layers.

use insitu::artefact::{exr, json};
use insitu::calibrate::Cameras;
use insitu::error::Context as _;
use insitu::illuminate;
use insitu::irradiance::Volume;
use insitu::model::{Scene, face};
use insitu::render::stage::{folder, load, report, stored, write_layers};
use insitu::render::{self, Frames, Set};
use insitu::shadow::{self, Receivers};
use insitu::transfer::{Finish, Transfers};
use insitu::visibility::Bvh;
use std::time::Instant;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("render", |ctx| {
        let settings = &ctx.pipeline.render;
        let cameras: Cameras = json::read(&ctx.artefact("calibrate", "cameras.json")?)?;
        let camera = cameras.plate_camera();
        let scene: Scene = json::read(&ctx.artefact("model", "scene.json")?)?;
        let plate = exr::read_radiance(&ctx.artefact("merge", "plate.exr")?)?;
        let light = illuminate::read_light(&folder(ctx, "illuminate", &["patches.ply", "distant.json"])?)?;
        let sky = illuminate::read_sky(&ctx.artefact("illuminate", "distant.exr")?, &light)?;
        let volume = Volume::read(&ctx.artefact("irradiance", "irradiance.ply")?)?;
        let transfers = Transfers::read(&folder(ctx, "transfer", &Transfers::FILES)?)?;
        let object = load(ctx)?;
        let gloss: Vec<_> = scene.faces.iter().map(|f| f.gloss).collect();
        let faces = face::triangulate(&scene.faces);
        let scene_bvh = Bvh::new(&faces.vertices, &faces.triangles);
        let light_bvh = Bvh::new(&light.mesh.vertices, &light.mesh.triangles());
        let receivers = Receivers::cast(camera, &light.mesh);
        let receivers = receivers.as_shown(&plate, &light.mesh).doing("preparing the shadow method")?;
        let stored = stored(ctx)?;

        let shadows = shadow::Scene {
            light: &light,
            transfers: &transfers,
            receivers: &receivers,
            plate: &plate,
            finish: Finish::new(camera, &gloss),
            stored: stored.as_ref().map(|(codes, response)| shadow::Stored { codes, response }),
        };
        let set = Set {
            camera,
            plate: &plate,
            light: &light,
            sky: sky.as_ref(),
            light_bvh: &light_bvh,
            volume: &volume,
            scene_bvh: &scene_bvh,
            receivers: &receivers,
            transfers: &transfers,
            settings,
        };
        let started = Instant::now();
        let mut frames = Frames::prepare(&shadows, set, &object, &faces.vertices)?;
        ctx.figure("shadow_preparation_s", started.elapsed().as_secs_f64());
        ctx.figure("caster_triangles", frames.caster().occluder.triangles.len());
        ctx.figure("caster_error_m", f64::from(frames.caster().error_m));

        json::write(&ctx.output("contacts.json"), &render::contacts(&object, cameras.posed_plate()))?;
        let frame = frames.first()?;
        report(ctx, &frame);
        write_layers(ctx, "", &frame)?;
        let seen = receivers.pixels.pixels().iter().map(|r| if r.is_some() { 1.0 } else { 0.0 }).collect();
        let (width, height) = plate.size();
        let mask = exr::Planes { width, height, channels: vec![("Y".into(), seen)] };
        exr::write(&ctx.output("receivers.exr"), &mask, exr::Kind::Picture)?;
        let environment = exr::Planes::from_radiance(&frame.shaded.environment.map);
        exr::write(&ctx.output("environment.exr"), &environment, exr::Kind::LatLong)?;

        let (mut shadow_ms, mut shade_ms, mut passes) = (Vec::new(), Vec::new(), Vec::new());
        for (i, motion) in render::motions(settings).doing("placing the object")?.iter().enumerate() {
            let frame = frames.of_path(i, motion)?;
            write_layers(ctx, &format!("_{i:04}"), &frame)?;
            shadow_ms.push(frame.shadow_s * 1e3);
            shade_ms.push(frame.shade_s * 1e3);
            passes.push(frame.removed.passes);
        }
        if !passes.is_empty() {
            ctx.figure("path_shadow_ms", shadow_ms);
            ctx.figure("path_shade_ms", shade_ms);
            ctx.figure("path_passes", passes);
        }
        Ok(())
    })
}

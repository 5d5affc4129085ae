//! Stage `render`: shadow and object as layers.

use insitu::artefact::{exr, json};
use insitu::calibrate::Cameras;
use insitu::error::{Context as _, Result};
use insitu::illuminate;
use insitu::irradiance::Volume;
use insitu::model::{Scene, face};
use insitu::render::{self, Object, Set};
use insitu::shadow::{self, Caster, Occluder, Receivers, Session};
use insitu::stage::{Context, Input, digest_file};
use insitu::transfer::Transfers;
use insitu::visibility::Bvh;
use std::path::{Path, PathBuf};
use std::time::Instant;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("render", |ctx| {
        let settings = &ctx.pipeline.render;
        let cameras: Cameras = json::read(&ctx.artefact("calibrate", "cameras.json")?)?;
        let camera = cameras.plate_camera();
        let scene: Scene = json::read(&ctx.artefact("model", "scene.json")?)?;
        let plate = exr::read_radiance(&ctx.artefact("merge", "plate.exr")?)?;
        let light = illuminate::read_light(&folder(ctx, "illuminate", &["patches.ply", "distant.json"])?)?;
        let volume = Volume::read(&ctx.artefact("irradiance", "irradiance.ply")?)?;
        let transfers = Transfers::read(&folder(ctx, "transfer", &Transfers::FILES)?)?;
        let object = load(ctx)?;
        let faces = face::triangulate(&scene.faces);
        let scene_bvh = Bvh::new(&faces.vertices, &faces.triangles);
        let warnings = render::check_placement(&object, camera, &faces.vertices, &scene_bvh)
            .doing("placing the object in the scene")?;
        warnings.into_iter().for_each(|w| ctx.warn(w));

        let started = Instant::now();
        let receivers = Receivers::cast(camera, &light.mesh);
        let occluder = Occluder { vertices: object.vertices.clone(), triangles: object.triangles.clone() };
        let shadows =
            shadow::Scene { light: &light, transfers: &transfers, receivers: &receivers, plate: &plate };
        let mut session = Session::prepare(&shadows, settings).doing("preparing the shadow method")?;
        ctx.figure("shadow_preparation_s", started.elapsed().as_secs_f64());
        let caster = Caster::of(&occluder, settings);
        ctx.figure("caster_triangles", caster.occluder.triangles.len());
        ctx.figure("caster_error_m", f64::from(caster.error_m));
        let frame = session.frame(&caster.occluder).doing("finding the shadow")?;
        let removed = frame.removed;
        ctx.figure("shadow_s", frame.seconds);
        ctx.figure("sources_used", removed.sources_used);
        ctx.figure("passes", removed.passes);
        ctx.figure("shadow_maps", removed.shadow_maps);
        ctx.figure("left_out_share", removed.left_out_share);
        if let Some(error) = removed.expected_error {
            ctx.figure("expected_shadow_error", error);
        }
        if let Some(noise) = removed.noise {
            ctx.figure("shadow_noise", noise);
        }

        let started = Instant::now();
        let light_bvh = Bvh::new(&light.mesh.vertices, &light.mesh.triangles());
        let set = Set {
            camera,
            plate: &plate,
            light: &light,
            light_bvh: &light_bvh,
            volume: &volume,
            scene_bvh: &scene_bvh,
            settings,
        };
        let (rendered, environment) = set.shade(&object, &removed.epsilon);
        ctx.figure("shade_s", started.elapsed().as_secs_f64());
        ctx.figure("object_visible_px", rendered.visible_px);
        ctx.figure("object_hidden_px", rendered.hidden_px);
        if rendered.visible_px == 0.0 {
            ctx.warn("no pixel shows the object: the scene hides it");
        }

        let seen = receivers.pixels.pixels().iter().map(|r| if r.is_some() { 1.0 } else { 0.0 }).collect();
        let (width, height) = plate.size();
        let mask = exr::Planes { width, height, channels: vec![("Y".into(), seen)] };
        exr::write(&ctx.output("receivers.exr"), &mask, exr::Kind::Picture)?;
        exr::write_radiance(&ctx.output("removed.exr"), &removed.epsilon)?;
        exr::write(
            &ctx.output("environment.exr"),
            &exr::Planes::from_radiance(&environment.map),
            exr::Kind::LatLong,
        )?;
        exr::write(&ctx.output("object.exr"), &rendered.layer.to_planes(), exr::Kind::Picture)?;

        let (mut shadow_ms, mut shade_ms, mut passes) = (Vec::new(), Vec::new(), Vec::new());
        for (i, motion) in render::motions(settings).doing("placing the object")?.iter().enumerate() {
            let what = || format!("rendering frame {i} of the path");
            let object = object.moved(motion);
            render::check_placement(&object, camera, &faces.vertices, &scene_bvh).doing(what())?;
            let frame = session.frame(&caster.moved(motion).occluder).doing(what())?;
            let started = Instant::now();
            let (rendered, _) = set.shade(&object, &frame.removed.epsilon);
            shade_ms.push(started.elapsed().as_secs_f64() * 1e3);
            shadow_ms.push(frame.seconds * 1e3);
            passes.push(frame.removed.passes);
            exr::write_radiance(&ctx.output(&format!("removed_{i:04}.exr")), &frame.removed.epsilon)?;
            let file = ctx.output(&format!("object_{i:04}.exr"));
            exr::write(&file, &rendered.layer.to_planes(), exr::Kind::Picture)?;
        }
        if !passes.is_empty() {
            ctx.figure("path_shadow_ms", shadow_ms);
            ctx.figure("path_shade_ms", shade_ms);
            ctx.figure("path_passes", passes);
        }
        Ok(())
    })
}

/// The folder of an earlier stage, all named files of which are read.
fn folder(ctx: &Context, stage: &str, files: &[&str]) -> Result<PathBuf> {
    let paths = files.iter().map(|f| ctx.artefact(stage, f)).collect::<Result<Vec<_>>>()?;
    Ok(paths.first().and_then(|p| p.parent()).unwrap_or(Path::new("")).to_path_buf())
}

fn load(ctx: &Context) -> Result<Object> {
    let settings = &ctx.pipeline.render;
    let object = render::load_object(&ctx.user_file(&settings.object)?, settings)?;
    for file in &object.files {
        ctx.depends_on(file, Input::File(digest_file(file)?));
    }
    object.warnings.iter().for_each(|w| ctx.warn(w));
    ctx.figure("object_triangles", object.triangles.len());
    Ok(object)
}

//! Stage `render`: shadow and object as layers.

use insitu::artefact::{exr, json};
use insitu::calibrate::Cameras;
use insitu::composite::write_png;
use insitu::config::ShadowMethod;
use insitu::error::{Context as _, Result};
use insitu::exposure::{self, Capture, Photograph};
use insitu::illuminate;
use insitu::image::CodeImage;
use insitu::irradiance::Volume;
use insitu::model::{Scene, face};
use insitu::render::{self, Frame, Frames, Object, Set};
use insitu::response::Response;
use insitu::shadow::{self, Receivers};
use insitu::stage::{Context, Input, digest_file};
use insitu::transfer::{Finish, Transfers};
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
        let gloss: Vec<_> = scene.faces.iter().map(|f| f.gloss).collect();
        let faces = face::triangulate(&scene.faces);
        let scene_bvh = Bvh::new(&faces.vertices, &faces.triangles);
        let light_bvh = Bvh::new(&light.mesh.vertices, &light.mesh.triangles());
        let receivers = Receivers::cast(camera, &light.mesh);
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

        let frame = frames.first()?;
        report(ctx, &frame);
        write_layers(ctx, "", &frame)?;
        let seen = receivers.pixels.pixels().iter().map(|r| if r.is_some() { 1.0 } else { 0.0 }).collect();
        let (width, height) = plate.size();
        let mask = exr::Planes { width, height, channels: vec![("Y".into(), seen)] };
        exr::write(&ctx.output("receivers.exr"), &mask, exr::Kind::Picture)?;
        let environment = exr::Planes::from_radiance(&frame.shaded.environment.map);
        exr::write(&ctx.output("environment.exr"), &environment, exr::Kind::LatLong)?;
        let levels = render::levels(&frame.shaded.environment);
        exr::write(&ctx.output("prefiltered.exr"), &levels, exr::Kind::LatLong)?;

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

/// More light than this whose shadow is not sought is worth a word, as a share.
const MOST_LEFT_OUT: f64 = 0.5;

/// Figures and warnings of a frame.
fn report(ctx: &Context, frame: &Frame) {
    let Frame { removed, shaded, .. } = frame;
    ctx.figure("shadow_s", frame.shadow_s);
    ctx.figure("sources_used", removed.sources_used);
    ctx.figure("passes", removed.passes);
    ctx.figure("shadow_maps", removed.shadow_maps);
    ctx.figure("left_out_share", removed.left_out_share);
    if removed.left_out_share > MOST_LEFT_OUT {
        ctx.warn(format!(
            "the shadow of {:.0} % of the light is left out: render.method = \"radiance-transfer\" takes light of any shape",
            100.0 * removed.left_out_share
        ));
    }
    if let Some(error) = removed.expected_error {
        ctx.figure("expected_shadow_error", error);
    }
    if let Some(noise) = removed.noise {
        ctx.figure("shadow_noise", noise);
    }
    ctx.figure("shade_s", frame.shade_s);
    ctx.figure("object_visible_px", shaded.rendered.visible_px);
    ctx.figure("object_hidden_px", shaded.rendered.hidden_px);
    frame.warnings.iter().for_each(|w| ctx.warn(w));
    if shaded.rendered.visible_px == 0.0 {
        ctx.warn("no pixel shows the object: the scene hides it");
    }
}

/// What `composite` puts into the plate.
fn write_layers(ctx: &Context, suffix: &str, Frame { removed, shaded, .. }: &Frame) -> Result<()> {
    let file = |name: &str, kind: &str| ctx.output(&format!("{name}{suffix}.{kind}"));
    exr::write_radiance(&file("removed", "exr"), &removed.epsilon)?;
    exr::write_radiance(&file("reflected", "exr"), &shaded.reflected)?;
    if let Some(codes) = &removed.codes {
        write_png(&file("codes", "png"), codes)?;
    }
    exr::write(&file("object", "exr"), &shaded.rendered.layer.to_planes(), exr::Kind::Picture)
}

/// The folder of an earlier stage, all named files of which are read.
fn folder(ctx: &Context, stage: &str, files: &[&str]) -> Result<PathBuf> {
    let paths = files.iter().map(|f| ctx.artefact(stage, f)).collect::<Result<Vec<_>>>()?;
    Ok(paths.first().and_then(|p| p.parent()).unwrap_or(Path::new("")).to_path_buf())
}

/// The plate's codes and the response, where the method works in codes and the plate has some.
fn stored(ctx: &Context) -> Result<Option<(CodeImage, Response)>> {
    if ctx.pipeline.render.method != ShadowMethod::RadianceTransferLdr {
        return Ok(None);
    }
    let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
    match exposure::load(ctx, &capture, capture.plate()?)? {
        Photograph::Codes(codes) => {
            Ok(Some((codes, json::read(&ctx.artefact("response", "response.json")?)?)))
        }
        Photograph::Linear(_) => Ok(None),
    }
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

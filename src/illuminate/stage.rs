//! What the stage does, for its program and for the truth of a rendered capture.

use super::{build, check, punctual, write_light};
use crate::artefact::{exr, json, remake};
use crate::calibrate::Cameras;
use crate::error::{Context as _, Error, Result};
use crate::image::{Image, RadianceImage};
use crate::merge::Merged;
use crate::model::{Scene, export};
use crate::probe::{Environment, ProbeFit};
use crate::stage::Context;
use std::path::Path;

/// Puts light on the model and writes it; `known` gives what is known of the light, by the scene's faces.
pub fn put_light(ctx: &Context, known: impl FnOnce(&Scene) -> Result<build::Known>) -> Result<()> {
    let scene: Scene = json::read(&ctx.artefact("model", "scene.json")?)?;
    let known = &known(&scene)?;
    let cameras: Cameras = json::read(&ctx.artefact("calibrate", "cameras.json")?)?;
    let fit: ProbeFit = json::read(&ctx.artefact("probe", "probe.json")?)?;
    let path = ctx.artefact("probe", "environment.exr")?;
    let env = Environment::from_planes(&exr::read(&path)?).ok_or_else(|| unfit(&path))?;
    let path = ctx.artefact("merge", "plate.exr")?;
    let plate = Merged::from_planes(&exr::read(&path)?).ok_or_else(|| unfit(&path))?;
    let plate =
        build::Plate { camera: cameras.plate_camera(), radiance: &plate.radiance, clipped: &plate.clipped };
    let settings = &ctx.pipeline.illuminate;
    let built = build::build(&scene.faces, &env, Some(&plate), known, settings, |d| fit.blur(d))
        .doing("putting light on the model")?;
    for (name, value) in &built.figures {
        ctx.figure(name, value);
    }
    let check = check::check(&built.light, &built.irradiance, &env, &built.distant_picture, Some(&plate));
    write_check(ctx, &check, &scene)?;
    let name = |face: u32| scene.faces[face as usize].name.clone();
    let lights = punctual::lights(&built.light, &built.irradiance, name);
    ctx.figure("lights", lights.len());
    export(ctx, &scene, &cameras, &ctx.pipeline.ingest.photos, &lights)?;
    for warning in built.warnings() {
        ctx.warn(warning);
    }
    exr::write(
        &ctx.output("distant.exr"),
        &exr::Planes::from_radiance(&built.distant_picture),
        exr::Kind::LatLong,
    )?;
    write_light(&ctx.output(""), &built.light)
}

/// Predictions and residuals, for a person to look at first.
fn write_check(ctx: &Context, check: &check::Check, scene: &Scene) -> Result<()> {
    for (name, value) in &check.figures {
        ctx.figure(name, value);
    }
    if let Some((face, stops)) = check.worst_face {
        ctx.figure("plate_residual_worst_face", &scene.faces[face as usize].name);
        ctx.figure("plate_residual_worst_face_stops", stops);
    }
    let planes = |picture: &RadianceImage, residual: &Image<f32>| {
        exr::Planes::from_radiance(picture).with("residual", residual.pixels().to_vec())
    };
    let plate = planes(&check.plate, &check.plate_residual);
    exr::write(&ctx.output("predicted_plate.exr"), &plate, exr::Kind::Picture)?;
    let probe = planes(&check.probe, &check.probe_residual);
    exr::write(&ctx.output("predicted_probe.exr"), &probe, exr::Kind::LatLong)
}

fn unfit(path: &Path) -> Error {
    Error::file("reading a picture", path, "lacks planes that it must have", remake(path))
}

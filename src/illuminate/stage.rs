//! What the stage does, for its program and for the truth of a rendered capture.

use super::{build, write_light};
use crate::artefact::{exr, json, remake};
use crate::calibrate::Cameras;
use crate::error::{Context as _, Error, Result};
use crate::merge::Merged;
use crate::model::Scene;
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

fn unfit(path: &Path) -> Error {
    Error::file("reading a picture", path, "lacks planes that it must have", remake(path))
}

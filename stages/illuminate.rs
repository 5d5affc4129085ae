//! Stage `illuminate`: carries the probe's and the plate's radiance onto a patch mesh.

use insitu::artefact::{exr, json, remake};
use insitu::calibrate::Cameras;
use insitu::error::{Context as _, Error};
use insitu::illuminate::{build, write_light};
use insitu::merge::Merged;
use insitu::model::Scene;
use insitu::probe::{Environment, ProbeFit};
use std::path::Path;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("illuminate", |ctx| {
        let scene: Scene = json::read(&ctx.artefact("model", "scene.json")?)?;
        let cameras: Cameras = json::read(&ctx.artefact("calibrate", "cameras.json")?)?;
        let fit: ProbeFit = json::read(&ctx.artefact("probe", "probe.json")?)?;
        let path = ctx.artefact("probe", "environment.exr")?;
        let env = Environment::from_planes(&exr::read(&path)?).ok_or_else(|| unfit(&path))?;
        let path = ctx.artefact("merge", "plate.exr")?;
        let plate = Merged::from_planes(&exr::read(&path)?).ok_or_else(|| unfit(&path))?;
        let plate = build::Plate {
            camera: cameras.plate_camera(),
            radiance: &plate.radiance,
            clipped: &plate.clipped,
        };
        let settings = &ctx.pipeline.illuminate;
        let built = build::build(&scene.faces, &env, Some(&plate), settings, |d| fit.blur(d))
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
    })
}

fn unfit(path: &Path) -> Error {
    Error::file("reading a picture", path, "lacks planes that it must have", remake(path))
}

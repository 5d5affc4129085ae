//! Stage `probe`: merges the probe's exposures, finds the mirror ball, unwraps what it reflects.

use insitu::annotations::Annotations;
use insitu::artefact::{exr, json};
use insitu::calibrate::Cameras;
use insitu::camera::Camera;
use insitu::config::{ProbeCamera, Role};
use insitu::error::{Context as _, Result};
use insitu::exposure::Capture;
use insitu::merge::Merged;
use insitu::probe::consistency::Surface;
use insitu::probe::{ProbeFit, Problem, clipped, exposures, find, marked, unwrap, view};
use insitu::response::Response;
use insitu::stage::Context;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("probe", |ctx| {
        let (settings, grid) = (&ctx.pipeline.probe, &ctx.pipeline.calibrate);
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        let response: Response = json::read(&ctx.artefact("response", "response.json")?)?;
        response.check().doing("reading the response")?;
        let merged = exposures::merged(ctx, &capture, &response)?;
        exr::write(&ctx.output("probe.exr"), &merged.planes(), exr::Kind::Picture)?;
        let cameras: Cameras = json::read(&ctx.artefact("calibrate", "cameras.json")?)?;
        let view = view::find(&merged.radiance, &cameras, settings, grid).doing(match settings.camera {
            ProbeCamera::Grid => "looking for the grid in the photographs of role `probe`",
            ProbeCamera::Plate => "placing the probe's camera",
        })?;
        if let Some(rms_px) = view.grid_rms_px {
            ctx.figure("grid_rms_px", rms_px);
        }
        let surface = Surface::new(settings, grid);
        let fit = ball(ctx, &capture, &merged, &view.camera, &surface)?;
        ctx.figure("outline_rms_px", fit.outline_rms_px);
        ctx.figure("mirror_correlation", fit.mirror_correlation);
        ctx.figure("centre_m", [fit.centre.x, fit.centre.y, fit.centre.z]);
        ctx.figure("centre_sigma_m", fit.centre_sigma_m);
        ctx.figure("diameter_px", fit.diameter_px);
        ctx.figure("reflectivity_seen", fit.reflectivity_seen);
        let given = settings.reflectivity[1];
        if let Some(seen) = fit.other_reflectivity(given) {
            ctx.warn(format!(
                "the ball mirrors {seen:.2} of the surface's light, but probe.reflectivity is {given:.2}"
            ));
        }
        let mut out =
            unwrap::unwrap(&fit, &merged.radiance, &merged.clipped, settings).doing("unwrapping the ball")?;
        ctx.figure("clipped_power_share", out.clipped_power_share);
        ctx.figure("blind_share", out.blind_share);
        if out.clipped_power_share > 0.0 {
            let found = clipped::restore(&fit, &merged, &surface, settings, &mut out);
            let found = found.doing("unwrapping the clipped light")?;
            if let Ok(found) = &found {
                ctx.figure("clipped_gain", found.gain);
                ctx.figure("clipped_gain_sigma", found.sigma);
                ctx.figure("clipped_gain_pixels", found.pixels);
            }
            clipped::warning(out.clipped_power_share, &found).into_iter().for_each(|w| ctx.warn(w));
        }
        json::write(&ctx.output("probe.json"), &fit)?;
        exr::write(&ctx.output("environment.exr"), &out.environment.to_planes(), exr::Kind::LatLong)
    })
}

/// The ball where a person marked it, or else the one that stands on the surface under the grid.
fn ball(
    ctx: &Context,
    capture: &Capture,
    merged: &Merged,
    camera: &Camera,
    surface: &Surface,
) -> Result<ProbeFit> {
    let settings = &ctx.pipeline.probe;
    let Some(ball) = Annotations::load(ctx)?.ball else {
        return find::find(camera, &merged.radiance, surface, settings)
            .doing("looking for the mirror ball in the photographs of role `probe`");
    };
    if capture.with_role(Role::Probe).all(|p| p.file != ball.image) {
        return Err(Problem::OtherImage { image: ball.image }).doing("reading the ball's outline");
    }
    marked::fit(camera, &merged.radiance, &ball.outline, settings)
        .doing("fitting the mirror ball to its marked outline")
}

//! Stage `probe`: merges the probe's exposures, finds the mirror ball, unwraps what it reflects; or takes the environment from a
//! fisheye's picture or a ready map.

use insitu::artefact::{exr, hdr, json};
use insitu::error::Context as _;
use insitu::exposure::Capture;
use insitu::probe;
use insitu::response::Response;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("probe", |ctx| {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        let response: Response = json::read(&ctx.artefact("response", "response.json")?)?;
        response.check().doing("reading the response")?;
        let (fit, out) = probe::of_capture(ctx, &capture, &response)?;
        json::write(&ctx.output("probe.json"), &fit)?;
        let environment = &out.environment;
        exr::write(&ctx.output("environment.exr"), &environment.to_planes(), exr::Kind::LatLong)?;
        hdr::write(&ctx.output("environment.hdr"), &environment.radiance)
    })
}

//! Stage `response`: from bracketed exposures to the camera's response curve.

use insitu::artefact::json;
use insitu::exposure::Capture;
use insitu::response;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("response", |ctx| {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        let response = response::of_capture(ctx, &capture)?;
        json::write(&ctx.output("response.json"), &response)
    })
}

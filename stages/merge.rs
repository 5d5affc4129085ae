//! Stage `merge`: from the plate and its brackets to `plate.exr`, linear radiance in units of the plate.

use insitu::artefact::json;
use insitu::error::Context as _;
use insitu::exposure::Capture;
use insitu::merge;
use insitu::response::Response;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("merge", |ctx| {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        let response: Response = json::read(&ctx.artefact("response", "response.json")?)?;
        response.check().doing("reading the response")?;
        merge::write_plate(ctx, &capture, &response)
    })
}

//! Stage `composite`: object and shadow in the plate, linear and as a photograph.

use insitu::artefact::{exr, json, remake};
use insitu::composite::{Composite, composite, picture, view, write_png};
use insitu::error::{Context as _, Error, Result};
use insitu::exposure::{self, Capture, Photograph};
use insitu::image::RadianceImage;
use insitu::render::Layer;
use insitu::response::Response;
use insitu::stage::Context;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("composite", |ctx| {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        let plate = exr::read_radiance(&ctx.artefact("merge", "plate.exr")?)?;
        let photograph = exposure::load(ctx, &capture, capture.plate()?)?;
        let response = match photograph {
            Photograph::Codes(_) => json::read(&ctx.artefact("response", "response.json")?)?,
            Photograph::Linear(_) => Response::srgb(),
        };
        let ev = ctx.pipeline.composite.exposure_ev;
        let encode = |v| response.code_of(v);
        let display = |result: &Composite, object: &Layer| match &photograph {
            Photograph::Codes(codes) => picture(codes, &plate, &result.radiance, object, encode)
                .doing("mapping the picture back through the response"),
            Photograph::Linear(_) => Ok(view(&result.radiance, ev, encode)),
        };

        let (result, object) = frame(ctx, &plate, "")?;
        ctx.figure("clamped_px", result.clamped_px);
        ctx.figure("clamped_share", result.clamped_share);
        if result.clamped_share > 0.01 {
            ctx.warn(format!(
                "{:.1} % of the radiance to be removed was not there ({} pixels): the shadow is too dark there",
                100.0 * result.clamped_share,
                result.clamped_px
            ));
        }
        exr::write_radiance(&ctx.output("augmented.exr"), &result.radiance)?;
        write_png(&ctx.output("augmented.png"), &display(&result, &object)?)?;
        for i in 0..ctx.pipeline.render.path.len() {
            let (result, object) = frame(ctx, &plate, &format!("_{i:04}"))?;
            write_png(&ctx.output(&format!("frame_{i:04}.png")), &display(&result, &object)?)?;
        }
        let before = match photograph {
            Photograph::Codes(codes) => codes,
            Photograph::Linear(_) => view(&plate, ev, encode),
        };
        write_png(&ctx.output("plate.png"), &before)
    })
}

/// The plate with the layers of a placement in it.
fn frame(ctx: &Context, plate: &RadianceImage, suffix: &str) -> Result<(Composite, Layer)> {
    let removed = exr::read_radiance(&ctx.artefact("render", &format!("removed{suffix}.exr"))?)?;
    let path = ctx.artefact("render", &format!("object{suffix}.exr"))?;
    let object = Layer::from_planes(&exr::read(&path)?).ok_or_else(|| {
        Error::file("reading the object's layer", &path, "lacks R, G, B, A or Z", remake(&path))
    })?;
    let result = composite(plate, &removed, &object).doing("putting the object into the plate")?;
    Ok((result, object))
}

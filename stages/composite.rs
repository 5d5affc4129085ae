//! Stage `composite`: object and shadow in the plate, linear and as a photograph.

use insitu::artefact::{exr, json, remake};
use insitu::composite::{composite, net, picture, view, write_png};
use insitu::error::{Context as _, Error};
use insitu::exposure::{self, Capture, Photograph};
use insitu::render::Layer;
use insitu::response::Response;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("composite", |ctx| {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        let plate = exr::read_radiance(&ctx.artefact("merge", "plate.exr")?)?;
        let removed = exr::read_radiance(&ctx.artefact("render", "removed.exr")?)?;
        let reflected = exr::read_radiance(&ctx.artefact("render", "reflected.exr")?)?;
        let path = ctx.artefact("render", "object.exr")?;
        let object = Layer::from_planes(&exr::read(&path)?).ok_or_else(|| {
            Error::file("reading the object's layer", &path, "lacks R, G, B, A or Z", remake(&path))
        })?;
        let result = net(&removed, &reflected)
            .and_then(|net| composite(&plate, &net, &object))
            .doing("putting the object into the plate")?;
        ctx.figure("clamped_px", result.clamped_px);
        ctx.figure("clamped_share", result.clamped_share);
        if result.clamped_share > 0.01 {
            ctx.warn(format!(
                "{:.1} % of the radiance to be removed was not there ({} pixels): the shadow is too dark there",
                100.0 * result.clamped_share,
                result.clamped_px
            ));
        }
        let (before, after) = match exposure::load(ctx, &capture, capture.plate()?)? {
            Photograph::Codes(codes) => {
                let response: Response = json::read(&ctx.artefact("response", "response.json")?)?;
                let encode = |v| response.code_of(v);
                let shadowed = match ctx.has_artefact("render", "codes.png") {
                    true => {
                        let path = ctx.artefact("render", "codes.png")?;
                        Some(exposure::decode(&path)?.codes(&path)?)
                    }
                    false => None,
                };
                let after = picture(&codes, shadowed.as_ref(), &plate, &result.radiance, &object, encode)
                    .doing("mapping the picture back through the response")?;
                (codes, after)
            }
            Photograph::Linear(_) => {
                let (srgb, ev) = (Response::srgb(), ctx.pipeline.composite.exposure_ev);
                let encode = |v| srgb.code_of(v);
                (view(&plate, ev, encode), view(&result.radiance, ev, encode))
            }
        };
        exr::write_radiance(&ctx.output("augmented.exr"), &result.radiance)?;
        write_png(&ctx.output("plate.png"), &before)?;
        write_png(&ctx.output("augmented.png"), &after)
    })
}

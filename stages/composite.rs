//! Stage `composite`: object and shadow in the plate, linear and as a photograph.

use insitu::artefact::{exr, json, remake};
use insitu::composite::{Composite, composite, net, picture, view, write_png};
use insitu::error::{Context as _, Error, Result};
use insitu::exposure::{self, Capture, Photograph};
use insitu::image::{CodeImage, Image, Radiance, RadianceImage};
use insitu::render::Layer;
use insitu::response::Response;
use insitu::stage::Context;
use std::borrow::Cow;

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
        let display = |frame: &Frame| match &photograph {
            Photograph::Codes(codes) => {
                let shadowed = frame.shadowed.as_ref();
                let (before, after) =
                    (behind_lens(&plate, &response), behind_lens(&frame.result.radiance, &response));
                picture(codes, shadowed, &before, &after, &frame.object, encode)
                    .doing("mapping the picture back through the response")
            }
            Photograph::Linear(_) => Ok(view(&frame.result.radiance, ev, encode)),
        };

        let frame = Frame::read(ctx, &plate, "")?;
        let result = &frame.result;
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
        write_png(&ctx.output("augmented.png"), &display(&frame)?)?;
        for i in 0..ctx.pipeline.render.path.len() {
            let frame = Frame::read(ctx, &plate, &format!("_{i:04}"))?;
            write_png(&ctx.output(&format!("frame_{i:04}.png")), &display(&frame)?)?;
        }
        let before = match photograph {
            Photograph::Codes(codes) => codes,
            Photograph::Linear(_) => view(&plate, ev, encode),
        };
        write_png(&ctx.output("plate.png"), &before)
    })
}

/// Light as it falls on the sensor: with the vignetting that merging took away.
fn behind_lens<'a>(image: &'a RadianceImage, response: &Response) -> Cow<'a, RadianceImage> {
    let Some(lens) = &response.vignetting else { return Cow::Borrowed(image) };
    let size = image.size();
    Cow::Owned(Image::from_fn(size.0, size.1, |x, y| {
        let (share, _) = lens.of_pixel(x, y, size);
        Radiance(image.at(x, y).0.map(|v| v * share))
    }))
}

/// The plate with the layers of a placement in it.
struct Frame {
    result: Composite,
    object: Layer,
    /// The plate's codes with the shadow, where the method works in codes.
    shadowed: Option<CodeImage>,
}

impl Frame {
    fn read(ctx: &Context, plate: &RadianceImage, suffix: &str) -> Result<Self> {
        let layer = |name: &str| exr::read_radiance(&ctx.artefact("render", &format!("{name}{suffix}.exr"))?);
        let path = ctx.artefact("render", &format!("object{suffix}.exr"))?;
        let object = Layer::from_planes(&exr::read(&path)?).ok_or_else(|| {
            Error::file("reading the object's layer", &path, "lacks R, G, B, A or Z", remake(&path))
        })?;
        let result = net(&layer("removed")?, &layer("reflected")?)
            .and_then(|net| composite(plate, &net, &object))
            .doing("putting the object into the plate")?;
        let codes = format!("codes{suffix}.png");
        let shadowed = match ctx.has_artefact("render", &codes) {
            true => {
                let path = ctx.artefact("render", &codes)?;
                Some(exposure::decode(&path)?.codes(&path)?)
            }
            false => None,
        };
        Ok(Self { result, object, shadowed })
    }
}

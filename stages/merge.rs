//! Stage `merge`: from the plate and its brackets to `plate.exr`, linear radiance in units of the plate.

use insitu::artefact::{exr, json};
use insitu::config::Role;
use insitu::error::{Context as _, Result};
use insitu::exposure::{self, Capture, Frame, Photo, Photograph};
use insitu::image::RadianceImage;
use insitu::merge::{self, Merged};
use insitu::response::Response;
use insitu::stage::Context;

/// Frames further than this from the merged picture, stops, have something wrong with them.
const SUSPICIOUS_STOPS: f64 = 0.15;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("merge", |ctx| {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        let response: Response = json::read(&ctx.artefact("response", "response.json")?)?;
        response.check().doing("reading the response")?;
        let plate = capture.plate()?;
        let brackets: Vec<&Photo> = capture.with_role(Role::Brackets).collect();
        let merged = match linear_plate(ctx, &capture, plate, &brackets)? {
            Some(linear) => untouched(ctx, linear),
            None => from_frames(
                ctx,
                &capture,
                if brackets.is_empty() { vec![plate] } else { brackets },
                &response,
            )?,
        };
        ctx.figure("clipped_share", merged.clipped_share());
        ctx.figure("median_relative_standard_error", merged.median_relative_error());
        if merged.clipped_share() > 0.001 {
            let percent = 100.0 * merged.clipped_share();
            ctx.warn(format!(
                "{percent:.1} % of the plate is clipped in every exposure: light there is too low"
            ));
        }
        exr::write(&ctx.output("plate.exr"), &merged.planes(), exr::Kind::Picture)
    })
}

/// The plate itself where it is a linear picture.
fn linear_plate(
    ctx: &Context,
    capture: &Capture,
    plate: &Photo,
    brackets: &[&Photo],
) -> Result<Option<RadianceImage>> {
    if !plate.linear {
        return Ok(None);
    }
    if !brackets.is_empty() {
        ctx.warn(format!("{} is linear: its brackets are not merged", plate.file));
    }
    match exposure::load(ctx, capture, plate)? {
        Photograph::Linear(image) => Ok(Some(image)),
        Photograph::Codes(_) => Ok(None),
    }
}

fn untouched(ctx: &Context, image: RadianceImage) -> Merged {
    let negative = image.pixels().iter().filter(|p| p.0.iter().any(|v| *v < 0.0)).count();
    if negative > 0 {
        ctx.warn(format!("{negative} pixels of the plate are below 0: they are taken as 0"));
    }
    Merged::from_linear(&image)
}

fn from_frames(ctx: &Context, capture: &Capture, photos: Vec<&Photo>, response: &Response) -> Result<Merged> {
    let unit = capture.plate_exposure()?;
    let bar = ctx.printer.progress("reading exposures", photos.len() as u64);
    let mut images = Vec::new();
    for photo in &photos {
        let codes = exposure::load(ctx, capture, photo)?.codes(photo.file.as_ref())?;
        images.push((codes, photo.exposure.map_or(unit, |e| e.scale())));
        bar.inc(1);
    }
    bar.finish_and_clear();
    let frames: Vec<_> =
        images.iter().map(|(codes, exposure)| Frame { codes, exposure: *exposure }).collect();
    let merged = merge::merge(&frames, response, unit, &ctx.pipeline.merge).doing("merging the exposures")?;
    let stops = merge::disagreement_stops(&frames, &merged, response, unit);
    for (photo, stops) in photos.iter().zip(&stops).filter(|(_, s)| **s > SUSPICIOUS_STOPS) {
        ctx.warn(format!(
            "{} differs from the merged picture by {stops:.2} stops: check its exposure, and that nothing moved",
            photo.file
        ));
    }
    ctx.figure("frame_residual_stops", stops);
    Ok(merged)
}

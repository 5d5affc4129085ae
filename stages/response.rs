//! Stage `response`: from bracketed exposures to the camera's response curve.

use insitu::artefact::json;
use insitu::config::Role;
use insitu::error::{Context as _, Result};
use insitu::exposure::{self, Capture, Frame, Photo, role_name};
use insitu::response::{self, Quality, Response};
use insitu::stage::Context;

/// A fit whose residuals are larger than this, stops, has something wrong with its exposures.
const SUSPICIOUS_STOPS: f64 = 0.15;
/// A middle grey less certain than this against saturation, stops, makes the colours uncertain.
const DOUBTFUL_STOPS: f64 = 0.1;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("response", |ctx| {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        let photos = series(ctx, &capture);
        let response = match (photos.is_empty(), capture.plate()?.linear) {
            (false, _) => fit(ctx, &capture, &photos)?,
            (true, true) => {
                ctx.warn("the plate is linear: pictures of it are stored by the sRGB curve");
                Response::srgb()
            }
            (true, false) => {
                ctx.warn(
                    "no role holds two exposures of one view: the sRGB curve is assumed, radiance is a guess",
                );
                Response::srgb()
            }
        };
        json::write(&ctx.output("response.json"), &response)
    })
}

/// The exposures to fit on: those of the role in the settings, or else of the other one that can serve.
fn series<'a>(ctx: &Context, capture: &'a Capture) -> Vec<&'a Photo> {
    let chosen = ctx.pipeline.response.role;
    for role in [chosen, Role::Brackets, Role::Probe] {
        let photos: Vec<_> = capture.with_role(role).filter(|p| !p.linear).collect();
        if photos.len() > 1 {
            if role != chosen {
                let (chosen, role) = (role_name(chosen), role_name(role));
                ctx.warn(format!(
                    "role `{chosen}` has no exposures: the response is fitted to role `{role}`"
                ));
            }
            return photos;
        }
    }
    Vec::new()
}

fn fit(ctx: &Context, capture: &Capture, photos: &[&Photo]) -> Result<Response> {
    let mut images = Vec::new();
    for photo in photos {
        let codes = exposure::load(ctx, capture, photo)?.codes(photo.file.as_ref())?;
        images.push((codes, photo.exposure.map_or(1.0, |e| e.scale())));
    }
    let frames: Vec<_> =
        images.iter().map(|(codes, exposure)| Frame { codes, exposure: *exposure }).collect();
    let files = format!("{} … {}", photos[0].file, photos[photos.len() - 1].file);
    let response =
        response::fit(&frames, &ctx.pipeline.response).doing(format!("fitting the response to {files}"))?;
    let Some(quality) = &response.quality else { return Ok(response) };
    ctx.figure("samples", quality.samples);
    ctx.figure("residual_rms_stops", quality.rms_stops);
    ctx.figure("condition_number", quality.condition);
    ctx.figure("black_level_code", response.curves.each_ref().map(|c| c.floor));
    ctx.figure("saturation_code", response.curves.each_ref().map(|c| c.clip));
    ctx.figure(
        "middle_standard_error_stops",
        response.curves.each_ref().map(|c| c.standard_error_stops(0.5)),
    );
    warn_of_doubts(ctx, photos, &response, quality);
    Ok(response)
}

fn warn_of_doubts(ctx: &Context, photos: &[&Photo], response: &Response, quality: &Quality) {
    for (photo, stops) in photos.iter().zip(&quality.frame_stops).filter(|(_, s)| s.abs() > SUSPICIOUS_STOPS)
    {
        ctx.warn(format!("{} is {stops:+.2} stops off the fitted response: check its exposure", photo.file));
    }
    let rms = quality.rms_stops.into_iter().fold(0.0, f64::max);
    if rms > SUSPICIOUS_STOPS {
        ctx.warn(format!(
            "the exposures disagree with any response by {rms:.2} stops rms (good: below 0.1): check exposure times, \
             and that neither camera nor light moved"
        ));
    }
    let error = response.curves.iter().map(|c| c.standard_error_stops(0.5)).fold(0.0, f64::max);
    if error > DOUBTFUL_STOPS {
        ctx.warn(format!(
            "saturation is known to {error:.2} stops only, and colour with it: add an exposure with bright tones \
             just below clipping"
        ));
    }
}

//! Stage `response`: from bracketed exposures to the camera's response curve.

use insitu::artefact::json;
use insitu::config::Role;
use insitu::error::{Context as _, FileContext, Result};
use insitu::exposure::{self, Capture, Frame, Photo, role_name};
use insitu::response::{self, FoundExposure, Quality, Response, Sampled};
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
            _ if ctx.pipeline.response.file.is_some() => saved(ctx)?,
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
    let bar = ctx.printer.progress("reading exposures", photos.len() as u64);
    let mut sampled = Vec::new();
    for photo in photos {
        let stored = exposure::load_stored(ctx, capture, photo)?;
        let exposure = photo.exposure.map_or(1.0, |e| e.scale());
        let frame = Frame { codes: &stored, exposure };
        sampled.push(Sampled::new(&frame).at("sampling a photograph", photo.file.as_ref())?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let files = format!("{} … {}", photos[0].file, photos[photos.len() - 1].file);
    let mut response = response::fit_sampled(&sampled, &ctx.pipeline.response)
        .doing(format!("fitting the response to {files}"))?;
    for (photo, exposure) in photos.iter().zip(&mut response.exposures) {
        exposure.file = photo.file.clone();
    }
    let Some(quality) = &response.quality else { return Ok(response) };
    ctx.figure("method", response.method);
    ctx.figure("samples", quality.samples);
    ctx.figure("residual_rms_stops", quality.rms_stops);
    ctx.figure("held_out_residual_rms_stops", quality.held_out_stops);
    ctx.figure("condition_number", quality.condition);
    ctx.figure("black_level_code", response.curves.each_ref().map(|c| c.floor));
    ctx.figure("saturation_code", response.curves.each_ref().map(|c| c.clip));
    ctx.figure(
        "middle_standard_error_stops",
        response.curves.each_ref().map(|c| c.standard_error_stops(0.5)),
    );
    let stops = |e: &FoundExposure| [Some(e.departure_stops()), e.sigma_stops];
    ctx.figure("exposures_found_stops", response.exposures.iter().map(stops).collect::<Vec<_>>());
    warn_of_doubts(ctx, photos, &response, quality);
    Ok(response)
}

/// A curve that was fitted to another set of the same camera.
fn saved(ctx: &Context) -> Result<Response> {
    let file = ctx.pipeline.response.file.clone().unwrap_or_default();
    let response: Response = json::read(&ctx.user_file(&file)?)?;
    response.check().doing(format!("reading the response {}", file.display()))?;
    // Its frames are others.
    Ok(Response { exposures: Vec::new(), quality: None, ..response })
}

fn warn_of_doubts(ctx: &Context, photos: &[&Photo], response: &Response, quality: &Quality) {
    for (photo, exposure) in photos.iter().zip(&response.exposures).filter(|(_, e)| e.is_doubtful()) {
        ctx.warn(exposure.told(&photo.file));
    }
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

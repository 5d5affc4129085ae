//! What the stage does: which exposures to fit, the fit, what a user should know of it.

use super::{FoundExposure, Quality, Response, Sampled, Vignetting, fit_sampled};
use crate::artefact::json;
use crate::config::Role;
use crate::error::{Context as _, FileContext, Result};
use crate::exposure::{self, Capture, Frame, Photo, Rows, role_name};
use crate::stage::Context;

/// A fit whose residuals are larger than this, stops, has something wrong with its exposures.
const SUSPICIOUS_STOPS: f64 = 0.15;
/// A middle grey less certain than this against saturation, stops, makes the colours uncertain.
const DOUBTFUL_STOPS: f64 = 0.1;

/// The response of a capture's camera: as saved, known, fitted, or assumed where there is nothing to fit to; with the
/// vignetting of its lens where the settings, a flat field or what was saved tell it.
pub fn of_capture(ctx: &Context, capture: &Capture) -> Result<Response> {
    let mut response = curves(ctx, capture)?;
    if let Some(found) = vignetting(ctx, capture, &response)? {
        response.vignetting = Some(found);
    }
    if let Some(v) = &response.vignetting {
        ctx.figure("vignetting", v.coefficients);
        ctx.figure("light_in_the_corners", v.at(1.0));
        ctx.figure("light_in_the_corners_sigma", v.sigma(1.0));
    }
    Ok(response)
}

fn vignetting(ctx: &Context, capture: &Capture, response: &Response) -> Result<Option<Vignetting>> {
    const DOING: &str = "finding the vignetting";
    let given = ctx.pipeline.response.vignetting;
    if given != [0.0; 3] {
        return Vignetting::given(given).doing(DOING).map(Some);
    }
    let flats: Vec<&Photo> = capture.with_role(Role::Flat).collect();
    if flats.is_empty() && ctx.pipeline.response.estimate_vignetting {
        return estimated(ctx, capture, response).map(Some);
    }
    let Some(first) = flats.first() else { return Ok(None) };
    warn_of_another_lens(ctx, first, capture.plate()?);
    let stored = exposure::load_each(ctx, capture, &flats, "reading flat fields", |_, stored| Ok(stored))?;
    let stored: Vec<&dyn Rows> = stored.iter().map(|s| s as &dyn Rows).collect();
    Vignetting::fit(&stored, response).doing(DOING).map(Some)
}

/// From the paper of the grid.
fn estimated(ctx: &Context, capture: &Capture, response: &Response) -> Result<Vignetting> {
    let plate = capture.plate()?;
    let size = |p: &Photo| (p.width_px, p.height_px);
    let photos: Vec<&Photo> =
        capture.with_role(Role::Grid).filter(|p| !p.linear && size(p) == size(plate)).collect();
    if let Some(first) = photos.first() {
        warn_of_another_lens(ctx, first, plate);
    }
    const READING: &str = "reading photographs of the grid";
    let codes = exposure::load_each(ctx, capture, &photos, READING, |photo, stored| {
        stored.rows(0..stored.height).at(READING, photo.file.as_ref())
    })?;
    Vignetting::estimate(&codes, response, &ctx.pipeline.calibrate)
        .doing("estimating the vignetting from photographs of the grid")
}

fn warn_of_another_lens(ctx: &Context, photo: &Photo, plate: &Photo) {
    let lens = |p: &Photo| (p.focal_mm, p.exposure.map(|e| e.f_number));
    if lens(photo) != lens(plate) {
        ctx.warn(format!(
            "{} ({}) and {} differ in focal length or aperture: vignetting changes with both",
            photo.file,
            role_name(photo.role),
            plate.file
        ));
    }
}

fn curves(ctx: &Context, capture: &Capture) -> Result<Response> {
    if ctx.pipeline.response.file.is_some() {
        return saved(ctx);
    }
    let plate = capture.plate()?;
    if plate.raw {
        return Ok(Response::of_raw());
    }
    let photos = series(ctx, capture);
    if !photos.is_empty() {
        return fitted(ctx, capture, &photos);
    }
    ctx.warn(if plate.linear {
        "the plate is linear: pictures of it are stored by the sRGB curve"
    } else {
        "no role holds two exposures of one view: the sRGB curve is assumed, radiance is a guess"
    });
    Ok(Response::srgb())
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

fn fitted(ctx: &Context, capture: &Capture, photos: &[&Photo]) -> Result<Response> {
    let sampled = exposure::load_each(ctx, capture, photos, "reading exposures", |photo, stored| {
        let exposure = photo.exposure.map_or(1.0, |e| e.scale());
        Sampled::new(&Frame { codes: &stored, exposure }).at("sampling a photograph", photo.file.as_ref())
    })?;
    let files = format!("{} … {}", photos[0].file, photos[photos.len() - 1].file);
    let mut response =
        fit_sampled(&sampled, &ctx.pipeline.response).doing(format!("fitting the response to {files}"))?;
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

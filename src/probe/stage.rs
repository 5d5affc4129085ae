//! What the stage does: its photographs to an environment, by a ball seen from one side or several, a fisheye lens or a ready map.

use super::consistency::Surface;
use super::views::{self, View};
use super::{ProbeFit, Problem, Unwrapped, clipped, crop, exposures, find, marked, placed, unwrap, view};
use crate::annotations::Annotations;
use crate::artefact::{exr, json};
use crate::calibrate::Cameras;
use crate::camera::Camera;
use crate::config::{ProbeCamera, ProbeSource, ProbeView, Role};
use crate::error::{Context as _, Error, Result};
use crate::exposure::{Capture, Photo, glob};
use crate::merge::Merged;
use crate::response::Response;
use crate::stage::Context;

/// A further view must agree with the first one so well (correlation of log luminance).
const AGREEMENT: f64 = 0.6;
/// Views of one ball may differ in brightness by these factors.
const ALIKE: std::ops::Range<f64> = 0.8..1.25;

/// The environment of a capture and what showed it; tells the stage's user its figures.
pub fn of_capture(ctx: &Context, capture: &Capture, response: &Response) -> Result<(ProbeFit, Unwrapped)> {
    let (fit, out) = match ctx.pipeline.probe.source {
        ProbeSource::Ball => balls(ctx, capture, response)?,
        _ => lens_or_map(ctx, capture, response)?,
    };
    ctx.figure("clipped_power_share", out.clipped_power_share);
    ctx.figure("blind_share", out.blind_share);
    Ok((fit, out))
}

/// A fisheye's picture or a ready map.
fn lens_or_map(ctx: &Context, capture: &Capture, response: &Response) -> Result<(ProbeFit, Unwrapped)> {
    let settings = &ctx.pipeline.probe;
    let photos: Vec<&Photo> = capture.with_role(Role::Probe).collect();
    let merged = exposures::merged(ctx, capture, &photos, response)?;
    exr::write(&ctx.output("probe.exr"), &merged.planes(), exr::Kind::Picture)?;
    let cameras: Cameras = json::read(&ctx.artefact("calibrate", "cameras.json")?)?;
    let (fit, out) = match settings.source {
        ProbeSource::Map => placed::of_map(&merged.radiance, cameras.plate_camera(), settings),
        _ => placed::of_fisheye(&merged, cameras.plate_camera(), settings),
    }
    .doing("taking the environment from the photographs of role `probe`")?;
    if out.clipped_power_share > 0.0 {
        let percent = 100.0 * out.clipped_power_share;
        ctx.warn(format!(
            "{percent:.0} % of the light is clipped in every exposure of the probe: add a shorter one"
        ));
    }
    Ok((fit, out))
}

/// The ball from one side or from several.
fn balls(ctx: &Context, capture: &Capture, response: &Response) -> Result<(ProbeFit, Unwrapped)> {
    let settings = &ctx.pipeline.probe;
    let whole = ProbeView {
        azimuth_deg: settings.azimuth_deg,
        elevation_deg: settings.elevation_deg,
        ..ProbeView::default()
    };
    let given = if settings.views.is_empty() { std::slice::from_ref(&whole) } else { &settings.views };
    let photographer = settings.photographer_deg.to_radians();
    let mut views: Vec<View> = Vec::new();
    for (i, given) in given.iter().enumerate() {
        let (mut view, merged) = one_view(ctx, capture, response, given, i)?;
        if let (Some(first), true, ProbeCamera::Crop) = (views.first(), settings.turn_views, settings.camera)
        {
            let (turn, agreement) = views::turn(&view, first, photographer);
            ctx.figure(&format!("view_{i}_agreement"), agreement);
            if agreement < AGREEMENT {
                return Err(Problem::Unlike { files: given.files.clone(), agreement, needed: AGREEMENT })
                    .doing("turning the views of the ball onto each other");
            }
            let fit = views::turned(&view.fit, &turn);
            let seen = unwrap::unwrap(&fit, &merged.radiance, &merged.clipped, settings)
                .doing("unwrapping the ball")?;
            let [azimuth, elevation] = crop::direction_deg(&fit);
            ctx.figure(&format!("view_{i}_azimuth_deg"), azimuth);
            ctx.figure(&format!("view_{i}_elevation_deg"), elevation);
            view = View { fit, seen };
        }
        if let Some(ratio) = views.first().and_then(|first| views::ratio(&view, first, photographer)) {
            ctx.figure(&format!("view_{i}_over_first"), ratio);
            if !ALIKE.contains(&ratio) {
                ctx.warn(format!(
                    "the view `{}` is {ratio:.2} times as bright as the first one",
                    given.files
                ));
            }
        }
        views.push(view);
    }
    let out =
        views::combine(&views, photographer).ok_or_else(|| Error::Bug("a ball without a view".into()))?;
    Ok((views.swap_remove(0).fit, out))
}

/// The photographs of a view.
fn photographs<'a>(capture: &'a Capture, view: &ProbeView) -> Result<Vec<&'a Photo>> {
    let photos: Vec<&Photo> = capture.with_role(Role::Probe).filter(|p| glob(&view.files, &p.file)).collect();
    if photos.is_empty() && capture.with_role(Role::Probe).next().is_some() {
        return Err(Problem::EmptyView { files: view.files.clone() }).doing("sorting the views of the ball");
    }
    Ok(photos)
}

/// Name of a figure of the `i`-th view: the first one's stand by themselves.
fn of_view(i: usize, name: &str) -> String {
    if i == 0 { name.to_string() } else { format!("view_{i}_{name}") }
}

fn one_view(
    ctx: &Context,
    capture: &Capture,
    response: &Response,
    given: &ProbeView,
    i: usize,
) -> Result<(View, Merged)> {
    let (settings, grid) = (&ctx.pipeline.probe, &ctx.pipeline.calibrate);
    let photos = photographs(capture, given)?;
    let merged = exposures::merged(ctx, capture, &photos, response)?;
    let name = if i == 0 { "probe.exr".to_string() } else { format!("probe_{i}.exr") };
    exr::write(&ctx.output(&name), &merged.planes(), exr::Kind::Picture)?;
    let surface = Surface::new(settings, grid);
    let mut fit = if settings.camera == ProbeCamera::Crop {
        crop::fit(merged.radiance.size(), [given.azimuth_deg, given.elevation_deg], settings)
            .doing("placing the camera of the ball's crop")?
    } else {
        let cameras: Cameras = json::read(&ctx.artefact("calibrate", "cameras.json")?)?;
        let view = view::find(&merged.radiance, &cameras, settings, grid).doing(match settings.camera {
            ProbeCamera::Plate => "placing the probe's camera",
            _ => "looking for the grid in the photographs of role `probe`",
        })?;
        if let Some(rms_px) = view.grid_rms_px {
            ctx.figure(&of_view(i, "grid_rms_px"), rms_px);
        }
        ball(ctx, capture, &merged, &view.camera, &surface)?
    };
    fit.photographs = photos.iter().map(|p| p.file.clone()).collect();
    figures(ctx, &fit, i);
    let mut seen =
        unwrap::unwrap(&fit, &merged.radiance, &merged.clipped, settings).doing("unwrapping the ball")?;
    if seen.clipped_power_share > 0.0 {
        restore(ctx, &fit, &merged, &surface, &mut seen, i)?;
    }
    Ok((View { fit, seen }, merged))
}

fn figures(ctx: &Context, fit: &ProbeFit, i: usize) {
    ctx.figure(&of_view(i, "outline_rms_px"), fit.outline_rms_px);
    ctx.figure(&of_view(i, "mirror_correlation"), fit.mirror_correlation);
    ctx.figure(&of_view(i, "centre_m"), [fit.centre.x, fit.centre.y, fit.centre.z]);
    ctx.figure(&of_view(i, "centre_sigma_m"), fit.centre_sigma_m);
    ctx.figure(&of_view(i, "diameter_px"), fit.diameter_px);
    ctx.figure(&of_view(i, "reflectivity_seen"), fit.reflectivity_seen);
    let given = ctx.pipeline.probe.reflectivity[1];
    if let Some(seen) = fit.other_reflectivity(given) {
        ctx.warn(format!(
            "the ball mirrors {seen:.2} of the surface's light, but probe.reflectivity is {given:.2}"
        ));
    }
}

/// Light that no exposure holds, by the ball's own shadow; a crop does not show it.
fn restore(
    ctx: &Context,
    fit: &ProbeFit,
    merged: &Merged,
    surface: &Surface,
    seen: &mut Unwrapped,
    i: usize,
) -> Result<()> {
    if ctx.pipeline.probe.camera == ProbeCamera::Crop {
        let percent = 100.0 * seen.clipped_power_share;
        ctx.warn(format!("{percent:.0} % of the light is clipped in every exposure of the probe, so there is more: add a shorter one"));
        return Ok(());
    }
    let found = clipped::restore(fit, merged, surface, &ctx.pipeline.probe, seen);
    let found = found.doing("unwrapping the clipped light")?;
    if let Ok(found) = &found {
        ctx.figure(&of_view(i, "clipped_gain"), found.gain);
        ctx.figure(&of_view(i, "clipped_gain_sigma"), found.sigma);
        ctx.figure(&of_view(i, "clipped_gain_pixels"), found.pixels);
    }
    clipped::warning(seen.clipped_power_share, &found).into_iter().for_each(|w| ctx.warn(w));
    Ok(())
}

/// The ball where a person marked it, or else the one that stands on the surface under the grid.
fn ball(
    ctx: &Context,
    capture: &Capture,
    merged: &Merged,
    camera: &Camera,
    surface: &Surface,
) -> Result<ProbeFit> {
    let settings = &ctx.pipeline.probe;
    let Some(ball) = Annotations::load(ctx)?.ball else {
        return find::find(camera, &merged.radiance, surface, settings)
            .doing("looking for the mirror ball in the photographs of role `probe`");
    };
    if capture.with_role(Role::Probe).all(|p| p.file != ball.image) {
        return Err(Problem::OtherImage { image: ball.image }).doing("reading the ball's outline");
    }
    marked::fit(camera, &merged.radiance, &ball.outline, settings)
        .doing("fitting the mirror ball to its marked outline")
}

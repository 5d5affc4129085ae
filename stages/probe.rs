//! Stage `probe`: merges the probe's exposures, finds the mirror ball, unwraps what it reflects.

use insitu::annotations::Annotations;
use insitu::artefact::{exr, json};
use insitu::calibrate::{self, Cameras};
use insitu::camera::Camera;
use insitu::config::{ProbeCamera, Role};
use insitu::error::{Context as _, Result};
use insitu::exposure::{self, Capture, Frame, Photograph};
use insitu::image::{Image, Radiance};
use insitu::merge::{self, Merged, align};
use insitu::probe::consistency::Surface;
use insitu::probe::unwrap::{self, Unwrapped};
use insitu::probe::{ProbeFit, Problem, clipped, find, marked};
use insitu::response::Response;
use insitu::stage::Context;

/// Shares of the picture that are drawn white when the grid is looked for.
const WHITE: [f64; 4] = [0.1, 0.02, 0.3, 0.5];
/// The reflectivity seen may differ from the one given by this share.
const REFLECTIVITY_TOLERANCE: f64 = 0.1;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("probe", |ctx| {
        let settings = &ctx.pipeline.probe;
        let merged = merged(ctx)?;
        exr::write(&ctx.output("probe.exr"), &merged.planes(), exr::Kind::Picture)?;
        let camera = camera(ctx, &merged)?;
        let fit = ball(ctx, &merged, &camera)?;
        ctx.figure("outline_rms_px", fit.outline_rms_px);
        ctx.figure("mirror_correlation", fit.mirror_correlation);
        ctx.figure("centre_m", [fit.centre.x, fit.centre.y, fit.centre.z]);
        ctx.figure("centre_sigma_m", fit.centre_sigma_m);
        ctx.figure("diameter_px", fit.diameter_px);
        ctx.figure("reflectivity_seen", fit.reflectivity_seen);
        let given = settings.reflectivity[1];
        let other = |seen: &f64| (seen / given - 1.0).abs() > REFLECTIVITY_TOLERANCE;
        if let Some(seen) = fit.reflectivity_seen.filter(other) {
            ctx.warn(format!(
                "the ball mirrors {seen:.2} of the surface's light, but probe.reflectivity is {given:.2}"
            ));
        }
        let mut out =
            unwrap::unwrap(&fit, &merged.radiance, &merged.clipped, settings).doing("unwrapping the ball")?;
        ctx.figure("clipped_power_share", out.clipped_power_share);
        ctx.figure("blind_share", out.blind_share);
        if out.clipped_power_share > 0.0 {
            restore(ctx, &fit, &merged, &surface(ctx), &mut out)?;
        }
        json::write(&ctx.output("probe.json"), &fit)?;
        exr::write(&ctx.output("environment.exr"), &out.environment.to_planes(), exr::Kind::LatLong)
    })
}

/// Gives light that no exposure holds the power that its shadow tells; what cannot be restored is warned of.
fn restore(
    ctx: &Context,
    fit: &ProbeFit,
    merged: &Merged,
    surface: &Surface,
    out: &mut Unwrapped,
) -> Result<()> {
    let settings = &ctx.pipeline.probe;
    let (w, h) = merged.radiance.size();
    let only = Image::from_fn(w, h, |x, y| {
        if *merged.clipped.at(x, y) { *merged.radiance.at(x, y) } else { Radiance::default() }
    });
    let lost = unwrap::unwrap(fit, &only, &merged.clipped, settings).doing("unwrapping the clipped light")?;
    let lost = &lost.environment;
    let share = 100.0 * out.clipped_power_share;
    match clipped::gain(fit, &merged.radiance, [&out.environment, lost], surface, settings.reflectivity) {
        Ok(found) => {
            ctx.figure("clipped_gain", found.gain);
            ctx.figure("clipped_gain_sigma", found.sigma);
            ctx.figure("clipped_gain_pixels", found.pixels);
            // Never below what was measured.
            let gain = found.gain.map(|g| g.max(1.0));
            for (l, part) in out.environment.radiance.pixels_mut().iter_mut().zip(lost.radiance.pixels()) {
                (0..3).for_each(|k| l.0[k] += (gain[k] - 1.0) as f32 * part.0[k]);
            }
            let [r, g, b] = gain;
            ctx.warn(format!(
                "{share:.0} % of the light is clipped in every exposure of the probe; by the ball's shadow it was raised by {r:.2} {g:.2} {b:.2} (± {:.2}): a shorter exposure would be surer",
                found.sigma.into_iter().fold(0.0, f64::max)
            ));
        }
        Err(why) if out.clipped_power_share > 0.01 => ctx.warn(format!(
            "{share:.0} % of the light is clipped in every exposure of the probe, so there is more, and the ball's shadow does not tell how much: {why}; add a shorter exposure"
        )),
        Err(_) => {}
    }
    Ok(())
}

/// All photographs of the probe as one picture in plate units.
fn merged(ctx: &Context) -> Result<Merged> {
    let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
    let response: Response = json::read(&ctx.artefact("response", "response.json")?)?;
    response.check().doing("reading the response")?;
    let unit = capture.plate_exposure()?;
    let photos: Vec<_> = capture.with_role(Role::Probe).collect();
    if photos.is_empty() {
        return Err(Problem::NoPicture)
            .doing("looking for the mirror ball in the photographs of role `probe`");
    }
    let bar = ctx.printer.progress("reading the probe", photos.len() as u64);
    let mut images = Vec::new();
    for photo in &photos {
        let scale = photo.exposure.map_or(unit, |e| e.scale());
        match exposure::load(ctx, &capture, photo)? {
            Photograph::Linear(image) => {
                let gain = (unit / scale) as f32;
                return Ok(Merged::from_linear(&image.map(|p| Radiance(p.0.map(|v| v * gain)))));
            }
            Photograph::Codes(codes) => images.push((codes, scale)),
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let frames: Vec<_> = images.iter().map(|(codes, e)| Frame { codes, exposure: *e }).collect();
    let shifts = align::shifts(&frames, &response);
    for ((photo, (codes, _)), shift) in
        photos.iter().zip(&mut images).zip(shifts).filter(|(_, s)| *s != [0, 0])
    {
        ctx.warn(format!(
            "{} lies {}, {} px beside the others: it is moved back",
            photo.file, shift[0], shift[1]
        ));
        *codes = align::moved_back(codes, shift);
    }
    let frames: Vec<_> = images.iter().map(|(codes, e)| Frame { codes, exposure: *e }).collect();
    merge::merge(&frames, &response, unit, &ctx.pipeline.merge).doing("merging the probe's exposures")
}

/// The ball where a person marked it, or else the one that stands on the surface under the grid.
fn ball(ctx: &Context, merged: &Merged, camera: &Camera) -> Result<ProbeFit> {
    let settings = &ctx.pipeline.probe;
    if let Some(ball) = Annotations::load(ctx)?.ball {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        if capture.with_role(Role::Probe).all(|p| p.file != ball.image) {
            return Err(Problem::OtherImage { image: ball.image }).doing("reading the ball's outline");
        }
        return marked::fit(camera, &merged.radiance, &ball.outline, settings)
            .doing("fitting the mirror ball to its marked outline");
    }
    find::find(camera, &merged.radiance, &surface(ctx), settings)
        .doing("looking for the mirror ball in the photographs of role `probe`")
}

/// The surface that the ball stands on, with the printed grid where there is one.
fn surface(ctx: &Context) -> Surface {
    let (settings, grid) = (&ctx.pipeline.probe, &ctx.pipeline.calibrate);
    // The squares around the inner corners, and a margin of half a square.
    let half = |corners: u32| f64::from(corners + 2) * grid.square_m / 2.0;
    Surface {
        height_m: settings.support_m.unwrap_or(-grid.thickness_m),
        board_half_m: (settings.camera == ProbeCamera::Grid).then(|| grid.inner_corners.map(half)),
    }
}

/// The view of the probe: the plate's, or from the grid in it; drawn at several exposures until the grid is found.
fn camera(ctx: &Context, merged: &Merged) -> Result<Camera> {
    let cameras: Cameras = json::read(&ctx.artefact("calibrate", "cameras.json")?)?;
    if ctx.pipeline.probe.camera == ProbeCamera::Plate {
        let camera = cameras.plate_camera();
        let (width, height) = merged.radiance.size();
        let plate = [camera.intrinsics.width_px, camera.intrinsics.height_px].map(|n| n as usize);
        if [width, height] != plate {
            return Err(Problem::OtherSize { probe: [width, height], plate })
                .doing("placing the probe's camera");
        }
        return Ok(camera.clone());
    }
    let mut luminance: Vec<f32> = merged.radiance.pixels().iter().map(|p| p.luminance()).collect();
    luminance.sort_by(f32::total_cmp);
    let mut last = None;
    for white in WHITE {
        let top = luminance[((1.0 - white) * (luminance.len() - 1) as f64) as usize].max(f32::MIN_POSITIVE);
        let grey: Image<u8> =
            merged.radiance.map(|p| (255.0 * (p.luminance() / top).clamp(0.0, 1.0).powf(1.0 / 2.2)) as u8);
        match calibrate::grid_pose(&grey, &cameras.intrinsics, &ctx.pipeline.calibrate) {
            Ok(posed) => {
                ctx.figure("grid_rms_px", posed.rms_px);
                return Ok(posed.camera);
            }
            Err(problem) => last = Some(problem),
        }
    }
    match last {
        Some(problem) => Err(problem).doing("looking for the grid in the photographs of role `probe`"),
        None => Err(Problem::NoPicture).doing("looking for the grid in the photographs of role `probe`"),
    }
}

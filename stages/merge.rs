//! Stage `merge`: from the plate and its brackets to `plate.exr`, linear radiance in units of the plate.

use insitu::artefact::{exr, json};
use insitu::config::Role;
use insitu::error::{Context as _, FileContext, Result};
use insitu::exposure::{self, Capture, Frame, Photo, Photograph, put_aside};
use insitu::image::RadianceImage;
use insitu::merge::align::{Motion, Moved, motions};
use insitu::merge::{self, Merged, Summary};
use insitu::response::{self, FoundExposure, Response, Sampled};
use insitu::stage::Context;

/// Frames further than this from the merged picture, stops, have something wrong with them.
const SUSPICIOUS_STOPS: f64 = 0.15;
/// Memory in which frames are kept, bytes; the others are put aside on the disk.
const ROOM: usize = 1 << 26;
/// A ghost of at least this share of the picture is told of.
const NOTABLE_SHARE: f64 = 0.001;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("merge", |ctx| {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        let response: Response = json::read(&ctx.artefact("response", "response.json")?)?;
        response.check().doing("reading the response")?;
        let plate = capture.plate()?;
        let brackets: Vec<&Photo> = capture.with_role(Role::Brackets).collect();
        let clipped_share = match linear_plate(ctx, &capture, plate, &brackets)? {
            Some(linear) => {
                let merged = untouched(ctx, linear);
                ctx.figure("median_relative_standard_error", merged.median_relative_error());
                exr::write(&ctx.output("plate.exr"), &merged.planes(), exr::Kind::Picture)?;
                merged.clipped_share()
            }
            None => {
                let photos = if brackets.is_empty() { vec![plate] } else { brackets };
                from_frames(ctx, &capture, photos, &response)?.clipped_share
            }
        };
        ctx.figure("clipped_share", clipped_share);
        if clipped_share > 0.001 {
            let percent = 100.0 * clipped_share;
            ctx.warn(format!(
                "{percent:.1} % of the plate is clipped in every exposure: light there is too low"
            ));
        }
        Ok(())
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

/// Puts the frames aside on the disk, brings them over each other and writes their merged picture, a band at a time.
fn from_frames(
    ctx: &Context,
    capture: &Capture,
    photos: Vec<&Photo>,
    response: &Response,
) -> Result<Summary> {
    let unit = capture.plate_exposure()?;
    let bar = ctx.printer.progress("reading exposures", photos.len() as u64);
    let (mut kept, mut sampled, mut room) = (Vec::new(), Vec::new(), ROOM);
    for photo in &photos {
        let stored = exposure::load_stored(ctx, capture, photo)?;
        let exposure = photo.exposure.map_or(unit, |e| e.scale());
        let doing = "putting a photograph aside";
        sampled.push(Sampled::new(&Frame { codes: &stored, exposure }).at(doing, photo.file.as_ref())?);
        kept.push(put_aside(stored, &mut room).at(doing, photo.file.as_ref())?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let exposures = exposures(ctx, &photos, &sampled, response);
    // The unit is the plate's: where it is one of the frames, as it was found.
    let plate = capture.plate()?;
    let of_plate = photos.iter().zip(&exposures).find(|(p, _)| p.file == plate.file).map(|(_, e)| *e);
    let unit = of_plate.unwrap_or(unit);
    let still: Vec<Frame> =
        kept.iter().zip(&exposures).map(|(codes, e)| Frame { codes: codes.as_ref(), exposure: *e }).collect();
    let motions = motion(ctx, &photos, &still, response)?;
    let moved: Vec<(usize, Moved)> = (still.iter().zip(&motions).enumerate())
        .filter(|(_, (_, motion))| !matches!(motion, Motion::Lost(_)))
        .map(|(i, (frame, motion))| (i, Moved::new(frame.codes, motion)))
        .collect();
    let frames: Vec<Frame> =
        moved.iter().map(|(i, codes)| Frame { codes, exposure: exposures[*i] }).collect();
    let photos: Vec<&Photo> = moved.iter().map(|(i, _)| photos[*i]).collect();
    let size = (plate.width_px as usize, plate.height_px as usize);
    let summary = exr::write_in_bands(&ctx.output("plate.exr"), size, &PLANES, |take| {
        let merge = |band: merge::Band| {
            let ghosts = band.left_out.pixels().iter().map(|bits| bits.count_ones() as f32).collect();
            take(&band.merged.planes().with("ghosts", ghosts)).map_err(Stopped::Writing)
        };
        match merge::merge_in_bands(&frames, response, unit, &ctx.pipeline.merge, merge) {
            Ok(summary) => Ok(summary),
            Err(Stopped::Merging(problem)) => Err(problem).doing("merging the exposures"),
            Err(Stopped::Writing(e)) => Err(e),
        }
    })?;
    tell(ctx, &photos, &summary);
    Ok(summary)
}

/// Planes of `plate.exr`: radiance, its variance, where it is clipped, and how many frames are left out as ghosts.
const PLANES: [&str; 8] = ["R", "G", "B", "VR", "VG", "VB", "clipped", "ghosts"];

/// Why merging ended early.
enum Stopped {
    Merging(merge::Problem),
    Writing(insitu::error::Error),
}

impl From<merge::Problem> for Stopped {
    fn from(problem: merge::Problem) -> Self {
        Self::Merging(problem)
    }
}

/// Exposures as the response was fitted with, or else by the pixels and the curve.
fn exposures(ctx: &Context, photos: &[&Photo], sampled: &[Sampled], response: &Response) -> Vec<f64> {
    let known = |p: &&Photo| response.exposures.iter().find(|e| e.file == p.file).cloned();
    let known: Option<Vec<FoundExposure>> = photos.iter().map(known).collect();
    let trusted = ctx.pipeline.response.exposures_from_pixels && !response.assumed;
    let found = match known {
        Some(known) => known,
        None if trusted && photos.len() > 2 => {
            let found = response::by_curve(sampled, response);
            for (photo, e) in photos.iter().zip(&found).filter(|(_, e)| e.is_corrected()) {
                ctx.warn(e.told(&photo.file));
            }
            found
        }
        None => sampled.iter().map(|s| FoundExposure::stated(s.exposure)).collect(),
    };
    found.iter().map(|e| e.used).collect()
}

/// How the frames lie against the middle exposure; a frame that cannot be brought over it is left out by name.
fn motion(ctx: &Context, photos: &[&Photo], frames: &[Frame], response: &Response) -> Result<Vec<Motion>> {
    if !ctx.pipeline.merge.align || frames.len() < 2 {
        return Ok(vec![Motion::Still; frames.len()]);
    }
    let found = motions(frames, response).at("reading what was put aside", photos[0].file.as_ref())?;
    let size = frames[0].codes.size();
    for (photo, motion) in photos.iter().zip(&found) {
        let px = motion.largest_px(size);
        match motion {
            Motion::Still => {}
            Motion::Shift([x, y]) => ctx.warn(format!(
                "{} lies {x:.1}, {y:.1} px beside the others: it is moved back",
                photo.file
            )),
            Motion::Homography(_) => ctx.warn(format!(
                "{} lies up to {px:.1} px beside the others, turned or tilted: it is moved back",
                photo.file
            )),
            Motion::Lost(correlation) => ctx.warn(format!(
                "{} is left out: no motion brings it over the others (their edges correlate by {correlation:.2})",
                photo.file
            )),
        }
    }
    ctx.figure("motion_px", found.iter().map(|m| m.largest_px(size)).collect::<Vec<_>>());
    Ok(found)
}

fn tell(ctx: &Context, photos: &[&Photo], summary: &Summary) {
    for (photo, frame) in photos.iter().zip(&summary.frames) {
        if frame.residual_stops > SUSPICIOUS_STOPS {
            ctx.warn(format!(
                "{} differs from the merged picture by {:.2} stops: check its exposure, and that nothing moved",
                photo.file, frame.residual_stops
            ));
        }
        if frame.left_out_share > NOTABLE_SHARE {
            ctx.warn(format!(
                "{}: {:.1} % of it shows something else than the other exposures and is left out (plane `ghosts` of plate.exr)",
                photo.file,
                100.0 * frame.left_out_share
            ));
        }
    }
    let of = |value: fn(&merge::FrameFigures) -> f64| summary.frames.iter().map(value).collect::<Vec<_>>();
    ctx.figure("frames", photos.iter().map(|p| &p.file).collect::<Vec<_>>());
    ctx.figure("frame_residual_stops", of(|f| f.residual_stops));
    ctx.figure("frame_clipped_share", of(|f| f.clipped_share));
    ctx.figure("frame_ghost_share", of(|f| f.left_out_share));
    ctx.figure("full_well_electrons", summary.sensors.map(|s| s.full_well_electrons()));
    ctx.figure("median_relative_standard_error", summary.median_relative_error);
}

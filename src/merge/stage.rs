//! What the stage does: the plate's exposures to `plate.exr`, a band at a time.

use super::series::Series;
use super::{Band, FrameFigures, Merged, Problem, Summary, merge_in_bands};
use crate::artefact::exr::{self, Planes};
use crate::config::Role;
use crate::error::{Context as _, Error, Result};
use crate::exposure::{self, Capture, Photo, Photograph};
use crate::image::{Image, RadianceImage};
use crate::response::Response;
use crate::stage::Context;

/// Planes of `plate.exr`: radiance, its variance, where it is clipped, and how many frames are left out as ghosts.
const PLANES: [&str; 8] = ["R", "G", "B", "VR", "VG", "VB", "clipped", "ghosts"];
/// Frames further than this from the merged picture, stops, have something wrong with them.
const SUSPICIOUS_STOPS: f64 = 0.15;
/// A ghost of at least this share of the picture is told of.
const NOTABLE_SHARE: f64 = 0.001;

/// Writes `plate.exr`.
pub fn write_plate(ctx: &Context, capture: &Capture, response: &Response) -> Result<()> {
    let plate = capture.plate()?;
    let brackets: Vec<&Photo> = capture.with_role(Role::Brackets).collect();
    let clipped_share = match linear_plate(ctx, capture, plate, &brackets)? {
        Some(linear) => {
            let merged = untouched(ctx, linear);
            ctx.figure("median_relative_standard_error", merged.median_relative_error());
            exr::write(&ctx.output("plate.exr"), &merged.planes(), exr::Kind::Picture)?;
            merged.clipped_share()
        }
        None => {
            let photos = if brackets.is_empty() { vec![plate] } else { brackets };
            from_photos(ctx, capture, photos, response)?.clipped_share
        }
    };
    ctx.figure("clipped_share", clipped_share);
    if clipped_share > 0.001 {
        let percent = 100.0 * clipped_share;
        ctx.warn(format!("{percent:.1} % of the plate is clipped in every exposure: light there is too low"));
    }
    Ok(())
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

fn from_photos(
    ctx: &Context,
    capture: &Capture,
    photos: Vec<&Photo>,
    response: &Response,
) -> Result<Summary> {
    let plate = capture.plate()?;
    let stated = capture.plate_exposure()?;
    let series = Series::read(ctx, capture, photos, response, stated)?;
    // The unit is the plate's: where it is one of the frames, as it was found.
    let unit = series.exposure_of(&plate.file).unwrap_or(stated);
    let size = (plate.width_px as usize, plate.height_px as usize);
    series.aligned(|frames, photos| {
        let summary = exr::write_in_bands(&ctx.output("plate.exr"), size, &PLANES, |take| {
            let merge = |band: Band| {
                let ghosts = band.left_out.pixels().iter().map(|bits| bits.count_ones() as f32).collect();
                take(&band.merged.planes().with("ghosts", ghosts)).map_err(Stopped::Writing)
            };
            match merge_in_bands(frames, response, unit, &ctx.pipeline.merge, merge) {
                Ok(summary) => Ok(summary),
                Err(Stopped::Merging(problem)) => Err(problem).doing("merging the exposures"),
                Err(Stopped::Writing(e)) => Err(e),
            }
        })?;
        tell(ctx, photos, &summary);
        write_residuals(ctx, &summary)?;
        Ok(summary)
    })
}

/// Writes `residuals.exr`: for the n-th frame of the figure `frames` a plane `Fn`, stops.
fn write_residuals(ctx: &Context, summary: &Summary) -> Result<()> {
    let Some((width, height)) = summary.residuals.first().map(Image::size) else { return Ok(()) };
    let mut planes = Planes { width, height, channels: Vec::new() };
    for (i, map) in summary.residuals.iter().enumerate() {
        planes = planes.with(&format!("F{i:02}"), map.pixels().to_vec());
    }
    exr::write(&ctx.output("residuals.exr"), &planes, exr::Kind::Picture)
}

/// Why merging ended early.
enum Stopped {
    Merging(Problem),
    Writing(Error),
}

impl From<Problem> for Stopped {
    fn from(problem: Problem) -> Self {
        Self::Merging(problem)
    }
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
    let of = |value: fn(&FrameFigures) -> f64| summary.frames.iter().map(value).collect::<Vec<_>>();
    ctx.figure("frames", photos.iter().map(|p| &p.file).collect::<Vec<_>>());
    ctx.figure("frame_residual_stops", of(|f| f.residual_stops));
    ctx.figure("frame_clipped_share", of(|f| f.clipped_share));
    ctx.figure("frame_ghost_share", of(|f| f.left_out_share));
    ctx.figure("full_well_electrons", summary.sensors.map(|s| s.full_well_electrons()));
    ctx.figure("median_relative_standard_error", summary.median_relative_error);
}

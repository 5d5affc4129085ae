//! A view's photographs, from their files to frames that lie over each other; tells the stage's user what was mended.

use super::align::{Motion, Moved, motions};
use crate::error::{FileContext, Result};
use crate::exposure::{self, Capture, Frame, Photo, Room, Rows};
use crate::response::{self, FoundExposure, Response, Sampled};
use crate::stage::Context;
use std::collections::BTreeMap;

/// Memory in which the frames of a view are kept, bytes.
pub const ROOM: usize = 1 << 27;

/// Exposures of one view, kept in memory or put aside on the disk.
pub struct Series<'a> {
    photos: Vec<&'a Photo>,
    kept: Vec<Box<dyn Rows + Send>>,
    exposures: Vec<f64>,
    motions: Vec<Motion>,
}

impl<'a> Series<'a> {
    /// Reads the photographs, and finds their exposures and how they lie. `unit` is the exposure of what states none.
    pub fn read(
        ctx: &Context,
        capture: &Capture,
        photos: Vec<&'a Photo>,
        response: &Response,
        unit: f64,
    ) -> Result<Self> {
        let room = Room::new(ROOM);
        let read = exposure::load_each(ctx, capture, &photos, "reading exposures", |photo, stored| {
            let exposure = photo.exposure.map_or(unit, |e| e.scale());
            let doing = "putting a photograph aside";
            let sampled = Sampled::new(&Frame { codes: &stored, exposure }).at(doing, photo.file.as_ref())?;
            Ok((room.keep(stored).at(doing, photo.file.as_ref())?, sampled))
        })?;
        let (kept, sampled): (Vec<_>, Vec<_>) = read.into_iter().unzip();
        let exposures = exposures(ctx, &photos, &sampled, response);
        let frames: Vec<Frame> = (kept.iter().zip(&exposures))
            .map(|(codes, e)| Frame { codes: codes.as_ref(), exposure: *e })
            .collect();
        let motions = how_they_lie(ctx, &photos, &frames, response)?;
        Ok(Self { photos, kept, exposures, motions })
    }

    /// Exposure of one of the photographs, as it was found.
    pub fn exposure_of(&self, file: &str) -> Option<f64> {
        let at = self.photos.iter().position(|p| p.file == file)?;
        Some(self.exposures[at])
    }

    /// Calls `f` with the frames as the view sees them, and their photographs; those that nothing brings over the others
    /// are left out.
    pub fn aligned<T>(&self, f: impl FnOnce(&[Frame], &[&Photo]) -> T) -> T {
        let moved: Vec<(usize, Moved)> = (self.kept.iter().zip(&self.motions).enumerate())
            .filter(|(_, (_, motion))| !matches!(motion, Motion::Lost(_)))
            .map(|(i, (codes, motion))| (i, Moved::new(codes.as_ref(), motion)))
            .collect();
        let frames: Vec<Frame> =
            moved.iter().map(|(i, codes)| Frame { codes, exposure: self.exposures[*i] }).collect();
        let photos: Vec<&Photo> = moved.iter().map(|(i, _)| self.photos[*i]).collect();
        f(&frames, &photos)
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

/// How the frames lie against the middle exposure; a frame that cannot be brought over it is named.
fn how_they_lie(
    ctx: &Context,
    photos: &[&Photo],
    frames: &[Frame],
    response: &Response,
) -> Result<Vec<Motion>> {
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
    let px = photos.iter().zip(&found).map(|(p, m)| (p.file.as_str(), m.largest_px(size)));
    ctx.figure("motion_px", px.collect::<BTreeMap<_, _>>());
    Ok(found)
}

//! The probe's exposures as one picture: by the same exposures from pixels, alignment and merging as the plate's.

use super::Problem;
use crate::config;
use crate::error::{Context as _, Result};
use crate::exposure::{self, Capture, Photo, Photograph};
use crate::image::{Radiance, RadianceImage};
use crate::merge::{self, Merged, Series};
use crate::response::Response;
use crate::stage::Context;

/// Photographs of the probe from one place as one picture in units of the plate.
///
/// A linear picture stands alone: it is brought to units of the plate, and the others are not looked at.
pub fn merged(ctx: &Context, capture: &Capture, photos: &[&Photo], response: &Response) -> Result<Merged> {
    if photos.is_empty() {
        return Err(Problem::NoPicture)
            .doing("looking for the mirror ball in the photographs of role `probe`");
    }
    // The plate's exposure as it was found, if it was, is the unit of the merged plate, too.
    let plate = capture.plate()?;
    let found = response.exposures.iter().find(|e| e.file == plate.file).map(|e| e.used);
    let unit = found.map_or_else(|| capture.plate_exposure(), Ok)?;
    if let Some(photo) = photos.iter().find(|p| p.linear)
        && let Photograph::Linear(image) = exposure::load(ctx, capture, photo)?
    {
        return Ok(in_plate_units(&image, photo.exposure.map_or(unit, |e| e.scale()), unit));
    }
    let series = Series::read(ctx, capture, photos.to_vec(), response, unit)?;
    // A lamp is a few pixels here: what looks like motion is a lamp half a pixel off, and its light must not be lost.
    let settings = config::Merge { deghost: false, ..ctx.pipeline.merge.clone() };
    series
        .aligned(|frames, _| merge::merge(frames, response, unit, &settings))
        .doing("merging the probe's exposures")
}

fn in_plate_units(image: &RadianceImage, exposure: f64, plate_exposure: f64) -> Merged {
    let gain = (plate_exposure / exposure) as f32;
    Merged::from_linear(&image.map(|p| Radiance(p.0.map(|v| v * gain))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Image;

    #[test]
    fn a_linear_picture_is_brought_to_units_of_the_plate() {
        let linear = Image::from_fn(96, 80, |_, _| Radiance([0.5, 1.0, 3.0]));
        let merged = in_plate_units(&linear, 0.5, 2.0);
        assert_eq!(merged.radiance.at(3, 4).0, [2.0, 4.0, 12.0]);
        assert!(!merged.clipped.pixels().contains(&true));
    }
}

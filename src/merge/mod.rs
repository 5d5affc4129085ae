//! Exposures of one view to linear radiance with a variance.
//!
//! Each frame gives an estimate exposure(code) / frame exposure; their mean, weighted by the inverse of the variance
//! that a sensor model predicts, is the maximum-likelihood estimate for Gaussian noise (Kirk and Andersen, *Noise
//! Characterization of Weighting Schemes for Combination of Multiple Exposures*, BMVC 2006; Hasinoff et al., CVPR
//! 2010). The variance is predicted from the exposure that all frames together make likely, not from the noisy code
//! itself, which would favour frames that happen to read low; its parameters come from the frames ([`noise`]). Frames
//! that see something else are left out where they do ([`ghosts`]). All goes in bands of rows, so that memory does not
//! grow with the frames.

pub mod align;
mod bands;
mod estimate;
mod ghosts;
mod noise;
mod order;
mod problem;
mod residuals;
mod series;
mod stage;

pub use crate::exposure::Frame;
pub use bands::{Band, FrameFigures, Summary, merge_in_bands};
pub use noise::{Noise, Sensor};
pub use problem::Problem;
pub use series::{ROOM, Series};
pub use stage::write_plate;

use crate::artefact::exr::Planes;
use crate::config;
use crate::image::{CodeImage, Image, Radiance, RadianceImage};
use crate::response::Response;

/// Radiance of a view.
#[derive(Debug, Clone, PartialEq)]
pub struct Merged {
    /// In units of the plate: 1 saturates the plate.
    pub radiance: RadianceImage,
    /// Variance of the radiance.
    pub variance: Image<[f32; 3]>,
    /// Saturated in every frame in at least one channel: the radiance there is a lower bound.
    pub clipped: Image<bool>,
}

/// Merges frames of one view and size; `plate_exposure` sets the unit.
pub fn merge(
    frames: &[Frame],
    response: &Response,
    plate_exposure: f64,
    settings: &config::Merge,
) -> Result<Merged, Problem> {
    let (mut radiance, mut variance, mut clipped) = (Vec::new(), Vec::new(), Vec::new());
    merge_in_bands(frames, response, plate_exposure, settings, |band| {
        radiance.extend_from_slice(band.merged.radiance.pixels());
        variance.extend_from_slice(band.merged.variance.pixels());
        clipped.extend_from_slice(band.merged.clipped.pixels());
        Ok::<_, Problem>(())
    })?;
    let (width, height) = frames.first().map_or((0, 0), |f| f.codes.size());
    Ok(Merged {
        radiance: Image::from_pixels(width, height, radiance),
        variance: Image::from_pixels(width, height, variance),
        clipped: Image::from_pixels(width, height, clipped),
    })
}

/// A single photograph, whose exposure is the unit.
pub fn linearise(
    codes: &CodeImage,
    response: &Response,
    settings: &config::Merge,
) -> Result<Merged, Problem> {
    merge(&[Frame { codes, exposure: 1.0 }], response, 1.0, settings)
}

/// Median; `None` of nothing.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Names of the variance planes.
const VARIANCE: [&str; 3] = ["VR", "VG", "VB"];

impl Merged {
    /// A linear picture that is merged already: nothing clipped, no variance known. Negative values become 0.
    pub fn from_linear(image: &RadianceImage) -> Self {
        Self {
            radiance: image.map(|p| Radiance(p.0.map(|v| v.max(0.0)))),
            variance: image.map(|_| [0.0; 3]),
            clipped: image.map(|_| false),
        }
    }

    /// As planes of an EXR: `R G B`, variance `VR VG VB`, and `clipped` 0 or 1.
    pub fn planes(&self) -> Planes {
        let clipped = self.clipped.pixels().iter().map(|c| if *c { 1.0 } else { 0.0 }).collect();
        let planes = Planes::from_radiance(&self.radiance).with("clipped", clipped);
        VARIANCE.iter().enumerate().fold(planes, |planes, (k, name)| {
            planes.with(name, self.variance.pixels().iter().map(|v| v[k]).collect())
        })
    }

    /// From such planes; `None` where one is missing.
    pub fn from_planes(planes: &Planes) -> Option<Self> {
        let [r, g, b] = VARIANCE.map(|name| planes.plane(name));
        let (r, g, b, clipped) = (r?, g?, b?, planes.plane("clipped")?);
        let variance = (0..r.len()).map(|i| [r[i], g[i], b[i]]).collect();
        Some(Self {
            radiance: planes.radiance()?,
            variance: Image::from_pixels(planes.width, planes.height, variance),
            clipped: Image::from_pixels(
                planes.width,
                planes.height,
                clipped.iter().map(|c| *c > 0.5).collect(),
            ),
        })
    }

    /// Share of pixels that are saturated in every frame.
    pub fn clipped_share(&self) -> f64 {
        let clipped = self.clipped.pixels().iter().filter(|c| **c).count();
        clipped as f64 / self.clipped.pixels().len().max(1) as f64
    }

    /// Median standard error over radiance of the green channel, over pixels that are not clipped.
    pub fn median_relative_error(&self) -> f64 {
        let pixels = self.radiance.pixels().iter().zip(self.variance.pixels()).zip(self.clipped.pixels());
        let relative = pixels
            .filter(|((radiance, _), clipped)| !**clipped && radiance.0[1] > 0.0)
            .map(|((radiance, variance), _)| f64::from(variance[1].sqrt() / radiance.0[1]));
        median(relative.collect()).unwrap_or(0.0)
    }
}

#[cfg(test)]
mod tests;

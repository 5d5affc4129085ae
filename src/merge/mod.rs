//! Exposures of one view to linear radiance with a variance.
//!
//! Each frame gives an estimate exposure(code) / frame exposure; their mean, weighted by the inverse of the variance
//! that a sensor model predicts, is the maximum-likelihood estimate for Gaussian noise (Kirk and Andersen, *Noise
//! Characterization of Weighting Schemes for Combination of Multiple Exposures*, BMVC 2006; Hasinoff et al., CVPR
//! 2010). The variance is predicted from the exposure that all frames together make likely, not from the noisy code
//! itself, which would favour frames that happen to read low.

pub mod align;
mod noise;
mod problem;

pub use crate::exposure::Frame;
pub use noise::Noise;
pub use problem::Problem;

use crate::artefact::exr::Planes;
use crate::config;
use crate::image::{Code, CodeImage, Image, Radiance, RadianceImage};
use crate::response::Response;
use rayon::prelude::*;

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
    check(frames, plate_exposure)?;
    let model = Noise::new(response, settings);
    // Radiance at which each frame has relative exposure 1.
    let units: Vec<f32> = frames.iter().map(|f| (plate_exposure / f.exposure) as f32).collect();
    let (width, height) = frames[0].codes.size();
    let mut merged = Merged {
        radiance: Image::from_fn(width, height, |_, _| Radiance::default()),
        variance: Image::from_fn(width, height, |_, _| [0.0; 3]),
        clipped: Image::from_fn(width, height, |_, _| false),
    };
    let pixels = (
        merged.radiance.pixels_mut().par_iter_mut(),
        merged.variance.pixels_mut().par_iter_mut(),
        merged.clipped.pixels_mut().par_iter_mut(),
    );
    let pixels = pixels.into_par_iter().enumerate();
    pixels.for_each_init(Vec::new, |readings, (i, (radiance, variance, clipped))| {
        for (channel, variance) in variance.iter_mut().enumerate() {
            readings.clear();
            let codes = frames.iter().map(|f| f.codes.pixels()[i].0[channel]);
            readings.extend(codes.zip(&units).map(|(code, unit)| model.read(channel, code, *unit)));
            overexpose(readings, &model, channel);
            let estimate = estimate(readings, &model, channel);
            radiance.0[channel] = estimate.radiance;
            *variance = estimate.variance;
            *clipped |= estimate.clipped;
        }
    });
    Ok(merged)
}

/// A single photograph, whose exposure is the unit.
pub fn linearise(
    codes: &CodeImage,
    response: &Response,
    settings: &config::Merge,
) -> Result<Merged, Problem> {
    merge(&[Frame { codes, exposure: 1.0 }], response, 1.0, settings)
}

/// By how much each frame disagrees with the merged picture, stops: median of |log2 (frame / merged)| over the pixels
/// that are well exposed in it; 0 where there are none. Noise, wrong exposures, motion all show.
pub fn disagreement_stops(
    frames: &[Frame],
    merged: &Merged,
    response: &Response,
    plate_exposure: f64,
) -> Vec<f64> {
    let of_frame = |frame: &Frame| {
        let unit = (plate_exposure / frame.exposure) as f32;
        let ratio = |(codes, radiance): (&Code, &Radiance)| {
            // Green alone: it has the least noise and is the same in JPEG's subsampled colour.
            let code = codes.0[1];
            let radiance = radiance.0[1];
            let good = (0.2..0.9).contains(&code) && radiance > 0.0;
            good.then(|| f64::from(response.curves[1].exposure_of(code) * unit / radiance).log2().abs())
        };
        let pixels = frame.codes.pixels().iter().zip(merged.radiance.pixels());
        median(pixels.filter_map(ratio).collect()).unwrap_or(0.0)
    };
    frames.iter().map(of_frame).collect()
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

fn check(frames: &[Frame], plate_exposure: f64) -> Result<(), Problem> {
    let first = frames.first().ok_or(Problem::NoFrame)?.codes.size();
    for (i, frame) in frames.iter().enumerate() {
        if frame.codes.size() != first {
            return Err(Problem::Sizes { frame: i + 1, size: frame.codes.size(), first });
        }
    }
    for exposure in frames.iter().map(|f| f.exposure).chain([plate_exposure]) {
        if !(exposure.is_finite() && exposure > 0.0) {
            return Err(Problem::Exposure { exposure });
        }
    }
    Ok(())
}

/// What one frame says of a pixel's channel.
#[derive(Debug, Clone, Copy)]
struct Reading {
    /// Relative exposure.
    exposure: f32,
    /// Radiance at which this frame has relative exposure 1.
    unit: f32,
    clipped: bool,
    /// At or below the black level.
    dark: bool,
}

#[derive(Debug, Clone, Copy)]
struct Estimate {
    radiance: f32,
    variance: f32,
    clipped: bool,
}

/// By so many standard deviations a shorter exposure must exceed a longer one's range to rule it out.
const SURE: f32 = 5.0;

/// Marks readings as clipped that a shorter exposure shows to be out of range: JPEG's coarse colour lets the code of a
/// clipped channel stray below the clipping level beside a small, strong light.
fn overexpose(readings: &mut [Reading], model: &Noise, channel: usize) {
    let (_, high) = model.range(channel);
    for i in 0..readings.len() {
        let Reading { exposure, unit, clipped, .. } = readings[i];
        let beyond = |s: &Reading| {
            let least = || s.exposure - SURE * model.variance(channel, s.exposure).sqrt();
            s.unit > unit && (s.clipped || !s.dark && least() * s.unit > high * unit)
        };
        if !clipped && exposure > 0.5 * high {
            readings[i].clipped = readings.iter().any(beyond);
        }
    }
}

fn estimate(readings: &[Reading], model: &Noise, channel: usize) -> Estimate {
    // First by what each frame reads, then by what all together make likely.
    let first = mean(readings.iter().filter(|r| !r.clipped && !r.dark), model, channel, |r| r.exposure);
    let Some((likely, _)) = first else { return at_the_ends(readings, model, channel) };
    let (low, high) = model.range(channel);
    let inside = |r: &&Reading| !r.clipped && (low..high).contains(&(likely / r.unit));
    let second = mean(readings.iter().filter(inside), model, channel, |r| likely / r.unit);
    let (radiance, variance) = second.or(first).unwrap_or_default();
    Estimate { radiance, variance, clipped: false }
}

/// Weighted mean and its variance; `expected` gives the exposure that a reading's variance is predicted from.
fn mean<'a>(
    readings: impl Iterator<Item = &'a Reading>,
    model: &Noise,
    channel: usize,
    expected: impl Fn(&Reading) -> f32,
) -> Option<(f32, f32)> {
    let (mut sum, mut weight) = (0.0_f64, 0.0_f64);
    for reading in readings {
        let variance = model.variance(channel, expected(reading)) * reading.unit * reading.unit;
        let w = 1.0 / f64::from(variance);
        sum += w * f64::from(reading.exposure * reading.unit);
        weight += w;
    }
    (weight > 0.0).then(|| ((sum / weight) as f32, (1.0 / weight) as f32))
}

/// No frame is well exposed. Saturated in the shortest: it gives a lower bound, as uncertain as it is large. Black in
/// the longest: what that one reads.
fn at_the_ends(readings: &[Reading], model: &Noise, channel: usize) -> Estimate {
    let shortest = readings.iter().max_by(|a, b| a.unit.total_cmp(&b.unit));
    let longest = readings.iter().filter(|r| !r.clipped).min_by(|a, b| a.unit.total_cmp(&b.unit));
    match (shortest, longest) {
        // Clipped in some and black in all others: the longest of the black ones tells most.
        (_, Some(r)) => {
            let variance = model.variance(channel, r.exposure) * r.unit * r.unit;
            Estimate { radiance: r.exposure * r.unit, variance, clipped: false }
        }
        (Some(r), None) => {
            let radiance = r.unit;
            Estimate { radiance, variance: radiance * radiance, clipped: true }
        }
        (None, None) => Estimate { radiance: 0.0, variance: 0.0, clipped: false },
    }
}

#[cfg(test)]
mod tests;

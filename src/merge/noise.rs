//! How far a reading may be off.

use super::Reading;
use crate::config;
use crate::response::{Curve, LEVELS, Response};

/// Standard deviation of a stored code: rounding to 8 bits (1/√12 of a step) and what JPEG adds, steps.
const CODE_SIGMA: f32 = 0.5;

/// Variance is tabulated over this many octaves of exposure below [`TOP_OCTAVE`], at so many points in each.
const OCTAVES: usize = 24;
const TOP_OCTAVE: i32 = 2;
const POINTS: usize = 16;

/// Photon, read and quantisation noise of a camera whose channels saturate at the full-well capacity, in relative
/// exposure.
#[derive(Debug, Clone)]
pub struct Noise<'a> {
    response: &'a Response,
    variance: [Vec<f32>; 3],
    /// Code from which a channel counts as clipped, and up to which as black.
    clip: [f32; 3],
    floor: [f32; 3],
}

impl<'a> Noise<'a> {
    /// The noise of a camera with this response.
    pub fn new(response: &'a Response, settings: &config::Merge) -> Self {
        let step = 1.0 / (LEVELS - 1) as f32;
        let read = settings.read_noise_electrons / settings.full_well_electrons;
        let variance = |curve: &Curve, exposure: f64| {
            let slope = curve.slope_at(curve.code_of(exposure as f32));
            let rounding = f64::from(slope * step * CODE_SIGMA);
            (exposure / settings.full_well_electrons + read * read + rounding * rounding) as f32
        };
        let curves = response.curves.each_ref();
        Self {
            response,
            variance: curves.map(|c| (0..OCTAVES * POINTS).map(|i| variance(c, exposure_at(i))).collect()),
            clip: curves.map(|c| c.clip * settings.clip.min(1.0 - 0.5 * step)),
            // Without a black level of its own, code 0 alone says nothing.
            floor: curves.map(|c| if c.floor > 0.0 { c.floor + 3.0 * step } else { 0.5 * step }),
        }
    }

    /// Variance of the relative exposure read where it is expected to be `exposure`.
    pub fn variance(&self, channel: usize, exposure: f32) -> f32 {
        let octave = exposure.log2() - (TOP_OCTAVE - OCTAVES as i32) as f32;
        // The conversion takes what is below the table, NaN included, to its first entry.
        let index = (octave * POINTS as f32 + 0.5) as usize;
        self.variance[channel][index.min(OCTAVES * POINTS - 1)]
    }

    /// Relative exposures between which a frame is worth reading.
    pub(super) fn range(&self, channel: usize) -> (f32, f32) {
        let curve = &self.response.curves[channel];
        (curve.exposure_of(self.floor[channel]), curve.exposure_of(self.clip[channel]))
    }

    pub(super) fn read(&self, channel: usize, code: f32, unit: f32) -> Reading {
        Reading {
            exposure: self.response.curves[channel].exposure_of(code),
            unit,
            clipped: code >= self.clip[channel],
            dark: code <= self.floor[channel],
        }
    }
}

/// Exposure of an entry of the table.
fn exposure_at(index: usize) -> f64 {
    (index as f64 / POINTS as f64 + f64::from(TOP_OCTAVE) - OCTAVES as f64).exp2()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photons_rule_in_the_light_and_reading_in_the_dark() {
        let (response, settings) = (Response::srgb(), config::Merge::default());
        let noise = Noise::new(&response, &settings);
        let read = (5.0_f32 / 12_000.0).powi(2);
        // Half a step of code at the foot of the sRGB curve, whose slope is 1 / 12.92.
        let rounding = (0.5_f32 / 255.0 / 12.92).powi(2);
        for dark in [0.0, -1.0, 1e-9] {
            assert!((noise.variance(1, dark) / (read + rounding) - 1.0).abs() < 0.05);
        }
        let (low, high) = (noise.variance(1, 0.1), noise.variance(1, 0.9));
        assert!(low > 0.1 / 12_000.0 && high > 0.9 / 12_000.0 && high < 1.3 * 0.9 / 12_000.0, "{low} {high}");
    }

    #[test]
    fn the_table_follows_the_formula() {
        let response = Response::srgb();
        let settings = config::Merge { full_well_electrons: 1000.0, ..Default::default() };
        let noise = Noise::new(&response, &settings);
        for i in 0..200 {
            let exposure = 1.01_f32.powi(-i * 4);
            let slope = response.curves[0].slope_at(response.curves[0].code_of(exposure));
            let exact = exposure / 1000.0 + 2.5e-5 + (slope * 0.5 / 255.0).powi(2);
            let ratio = noise.variance(0, exposure) / exact;
            assert!((ratio - 1.0).abs() < 0.05, "{exposure}: {ratio}");
        }
    }
}

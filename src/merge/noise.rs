//! How far a reading may be off.

use super::Reading;
use crate::config;
use crate::response::{Curve, LEVELS, Response};

/// Standard deviation of a stored code: rounding to 8 bits (1/√12 of a step) and what JPEG adds, steps.
const CODE_SIGMA: f32 = 0.5;

/// Photon, read and quantisation noise of a camera, in relative exposure.
#[derive(Debug, Clone)]
pub struct Noise<'a> {
    response: &'a Response,
    /// Standard deviation from the stored code, by level.
    code_sigma: [Vec<f32>; 3],
    full_well: f32,
    read: f32,
    /// Code from which a channel counts as clipped, and up to which as black.
    clip: [f32; 3],
    floor: [f32; 3],
}

impl<'a> Noise<'a> {
    /// The noise of a camera whose channels saturate at the full-well capacity.
    pub fn new(response: &'a Response, settings: &config::Merge) -> Self {
        let step = 1.0 / (LEVELS - 1) as f32;
        let sigma = |curve: &Curve| -> Vec<f32> {
            (0..LEVELS).map(|z| curve.slope_at(z as f32 * step) * step * CODE_SIGMA).collect()
        };
        let curves = response.curves.each_ref();
        Self {
            response,
            code_sigma: curves.map(sigma),
            full_well: settings.full_well_electrons as f32,
            read: (settings.read_noise_electrons / settings.full_well_electrons) as f32,
            clip: curves.map(|c| c.clip * settings.clip.min(1.0 - 0.5 * step)),
            // Without a black level of its own, code 0 alone says nothing.
            floor: curves.map(|c| if c.floor > 0.0 { c.floor + 3.0 * step } else { 0.5 * step }),
        }
    }

    /// Variance of the relative exposure read where it is expected to be `exposure`.
    pub fn variance(&self, channel: usize, exposure: f32) -> f32 {
        let code = self.response.curves[channel].code_of(exposure);
        let rounding = self.code_sigma[channel][(code * (LEVELS - 1) as f32).round() as usize];
        let photons = exposure.max(0.0) / self.full_well;
        photons + self.read * self.read + rounding * rounding
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

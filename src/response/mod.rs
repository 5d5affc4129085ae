//! Camera response: which exposure makes which code value.
//!
//! Fitted to brackets by one of three methods ([`crate::config::ResponseMethod`]), usually least squares (Debevec and
//! Malik, *Recovering High Dynamic Range Radiance Maps from Photographs*, SIGGRAPH 1997), at places spread over image and
//! range ([`samples`]), after the frames' exposures have been checked against their pixels ([`exposures`]). Exposure is relative, in each channel 1 where that channel saturates: brackets say
//! nothing of the channels' ratio, and all channels of a linear sensor saturate at one exposure.

mod debevec_malik;
mod exposures;
mod fit;
mod mitsunaga_nayar;
mod monotone;
mod observations;
mod problem;
mod robertson;
mod samples;
mod stage;
mod vignetting;

pub use exposures::{FoundExposure, by_curve};
pub use fit::{fit, fit_sampled, residual_stops};
pub use problem::Problem;
pub use samples::Sampled;
pub use stage::of_capture;
pub use vignetting::Vignetting;

use crate::artefact::json::JsonArtefact;
use crate::config::ResponseMethod;
use serde::{Deserialize, Serialize};

/// Levels at which a curve is known: all codes of 8 bits. Deeper codes lie between.
pub const LEVELS: usize = 256;
/// The largest level, code 1.
const TOP: f64 = (LEVELS - 1) as f64;
const LN_2: f64 = std::f64::consts::LN_2;

/// Response of one channel.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Curve {
    /// Relative exposure at each level, strictly rising; 1 at `clip`.
    pub exposure: Vec<f64>,
    /// Standard error of ln exposure at each level, against that of saturation: the larger of what least squares say and
    /// of the spread over fits to resampled places. Its 95 % band is 1.96 times that to either side.
    pub standard_error: Vec<f64>,
    /// Code at and below which the channel shows its black level and no light.
    pub floor: f32,
    /// Code at which the channel saturates.
    pub clip: f32,
}

/// Response of a camera: `response/response.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Response {
    /// Red, green, blue.
    pub curves: [Curve; 3],
    /// Not fitted but taken for granted, since there was nothing to fit to.
    pub assumed: bool,
    /// How it was fitted; none where it was not.
    pub method: Option<ResponseMethod>,
    /// How well the fit holds.
    pub quality: Option<Quality>,
    /// Exposures of the frames that it was fitted to.
    pub exposures: Vec<FoundExposure>,
    /// Fall-off of the lens that it was used with, where it is known.
    pub vignetting: Option<Vignetting>,
}

/// How well a fit holds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    /// Sample positions used, per channel.
    pub samples: [usize; 3],
    /// Weighted rms of ln E + ln t − g(Z), stops, per channel.
    pub rms_stops: [f64; 3],
    /// The same on places that were left out of the fit in turn, with the method chosen.
    pub held_out_stops: [f64; 3],
    /// Median of the same over each frame, stops, green channel; a wrong exposure time shows here.
    pub frame_stops: Vec<f64>,
    /// Condition number of the normal equations, the worst channel.
    pub condition: f64,
}

impl JsonArtefact for Response {
    const FORMAT: &'static str = "insitu-response";
    const VERSION: u32 = 3;

    fn check(&self) -> Result<(), String> {
        Self::check(self).map_err(|e| e.to_string())
    }
}

impl Curve {
    /// A curve that is taken for granted: `exposure(code)`, rising from about 0 to 1.
    fn assumed(exposure: impl Fn(f64) -> f64) -> Self {
        Self {
            exposure: (0..LEVELS).map(|z| exposure(z as f64 / TOP)).collect(),
            standard_error: vec![0.0; LEVELS],
            floor: 0.0,
            clip: 1.0,
        }
    }

    /// Relative exposure of a code in `0..=1`.
    pub fn exposure_of(&self, code: f32) -> f32 {
        let z = f64::from(code).clamp(0.0, 1.0) * TOP;
        let k = (z as usize).min(LEVELS - 2);
        let (a, b) = (self.exposure[k], self.exposure[k + 1]);
        (a + (b - a) * (z - k as f64)) as f32
    }

    /// Code in `0..=1` of a relative exposure: the inverse of [`Self::exposure_of`], clamped at both ends.
    pub fn code_of(&self, exposure: f32) -> f32 {
        let x = f64::from(exposure);
        let above = self.exposure.partition_point(|e| *e <= x);
        if above == 0 {
            return 0.0;
        }
        let Some(&b) = self.exposure.get(above) else { return 1.0 };
        let a = self.exposure[above - 1];
        (((above - 1) as f64 + (x - a) / (b - a)) / TOP) as f32
    }

    /// Standard error of the exposure at a code, stops.
    pub fn standard_error_stops(&self, code: f32) -> f64 {
        let level = (f64::from(code).clamp(0.0, 1.0) * TOP).round() as usize;
        self.standard_error.get(level).copied().unwrap_or(0.0) / LN_2
    }

    /// d exposure / d code at a code.
    pub fn slope_at(&self, code: f32) -> f32 {
        let k = (f64::from(code).clamp(0.0, 1.0) * TOP) as usize;
        let (low, high) = (k.saturating_sub(1), (k + 1).min(LEVELS - 1));
        ((self.exposure[high] - self.exposure[low]) * TOP / (high - low) as f64) as f32
    }
}

impl Response {
    /// The inverse of the sRGB curve (IEC 61966-2-1) in every channel.
    pub fn srgb() -> Self {
        let curve = Curve::assumed(linear_from_srgb);
        let curves = [curve.clone(), curve.clone(), curve];
        Self { curves, assumed: true, method: None, quality: None, exposures: Vec::new(), vignetting: None }
    }

    /// Of developed RAW files, which are stored by the sRGB curve exactly ([`crate::exposure`]).
    pub fn of_raw() -> Self {
        Self { assumed: false, ..Self::srgb() }
    }

    /// Relative exposures of a pixel's codes; 1 where a channel saturates.
    pub fn exposure_of(&self, codes: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|c| self.curves[c].exposure_of(codes[c]))
    }

    /// Codes of relative exposures, clamped to `0..=1`.
    pub fn code_of(&self, exposures: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|c| self.curves[c].code_of(exposures[c]))
    }

    /// Refuses a curve that cannot have been written by insitu.
    pub fn check(&self) -> Result<(), Problem> {
        for (channel, curve) in self.curves.iter().enumerate() {
            let rising = curve.exposure.windows(2).all(|w| w[0] < w[1]);
            let sound = curve.exposure.iter().all(|e| e.is_finite() && *e >= 0.0);
            if curve.exposure.len() != LEVELS || !rising || !sound {
                return Err(Problem::NotACurve { channel, levels: curve.exposure.len() });
            }
        }
        Ok(())
    }
}

fn linear_from_srgb(code: f64) -> f64 {
    if code <= 0.040_45 { code / 12.92 } else { ((code + 0.055) / 1.055).powf(2.4) }
}

/// `red`, `green` or `blue`.
fn channel_name(channel: usize) -> &'static str {
    ["red", "green", "blue"].get(channel).copied().unwrap_or("?")
}

#[cfg(test)]
mod tests;

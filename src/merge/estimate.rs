//! One channel of one pixel from what the frames read there.

use super::noise::Noise;

/// What one frame says of a pixel's channel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reading {
    /// Which frame.
    pub frame: usize,
    /// Relative exposure.
    pub exposure: f32,
    /// Radiance at which this frame has relative exposure 1, and its inverse.
    pub unit: f32,
    per_unit: f32,
    /// Radiance that it says, its variance, and the inverse of that.
    says: f32,
    variance: f32,
    weight: f32,
    pub clipped: bool,
    /// At or below the black level.
    pub dark: bool,
}

impl Reading {
    /// `variance`: of the relative exposure.
    pub fn new(frame: usize, exposure: f32, variance: f32, unit: f32, [clipped, dark]: [bool; 2]) -> Self {
        let (says, per_unit, variance) = (exposure * unit, 1.0 / unit, variance * unit * unit);
        Self { frame, exposure, unit, per_unit, says, variance, weight: 1.0 / variance, clipped, dark }
    }

    /// Of what a frame says at a code.
    pub fn of(frame: usize, unit: f32, told: &Told) -> Self {
        let Told { exposure, says, variance, weight, clipped, dark } = *told;
        Self { frame, exposure, unit, per_unit: 1.0 / unit, says, variance, weight, clipped, dark }
    }

    /// Without what all readings of its frame share.
    pub fn told(&self) -> Told {
        let Self { exposure, says, variance, weight, clipped, dark, .. } = *self;
        Told { exposure, says, variance, weight, clipped, dark }
    }

    fn tells(&self) -> bool {
        !self.clipped && !self.dark
    }
}

/// A [`Reading`] but for its frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Told {
    exposure: f32,
    says: f32,
    variance: f32,
    weight: f32,
    clipped: bool,
    dark: bool,
}

#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Estimate {
    pub radiance: f32,
    pub variance: f32,
    pub clipped: bool,
}

impl Estimate {
    /// The radiance before a lens that lets a share of it through; that share's variance adds to its own.
    pub fn through(self, (share, variance): (f32, f32)) -> Self {
        let radiance = self.radiance / share;
        Self {
            radiance,
            variance: (self.variance + radiance * radiance * variance) / (share * share),
            ..self
        }
    }
}

/// By so many standard deviations a shorter exposure must exceed a longer one's range to rule it out, and a reading be
/// off to count as of another scene.
const SURE: f32 = 5.0;
/// Relative error of a reading that noise does not tell of: the curve, the exposure, edges half a pixel off.
const UNTOLD: f32 = 0.03;
/// A frame that should read less than this share of its range, or more than so many times its black, is wrong to be
/// clipped or dark.
const FAR: f32 = 0.5;

/// Marks readings as clipped that a shorter exposure shows to be out of range: JPEG's coarse colour lets the code of a
/// clipped channel stray below the clipping level beside a small, strong light.
pub(super) fn overexpose(readings: &mut [Reading], model: &Noise, channel: usize) {
    let (_, high) = model.range(channel);
    for i in 0..readings.len() {
        let Reading { exposure, unit, clipped, .. } = readings[i];
        let beyond = |s: &Reading| {
            let surely = |over: f32| over > 0.0 && over * over > SURE * SURE * s.variance;
            s.unit > unit && (s.clipped || !s.dark && surely(s.says - high * unit))
        };
        if !clipped && exposure > FAR * high {
            readings[i].clipped = readings.iter().any(beyond);
        }
    }
}

/// The maximum-likelihood mean, for Gaussian noise whose variance is predicted from what all readings make likely.
pub(super) fn estimate(readings: &[Reading], model: &Noise, channel: usize) -> Estimate {
    // First by what each frame reads, then by what all together make likely.
    let (mut sum, mut weight) = (0.0_f32, 0.0_f32);
    for r in readings.iter().filter(|r| r.tells()) {
        sum += r.weight * r.says;
        weight += r.weight;
    }
    if weight == 0.0 {
        return at_the_ends(readings);
    }
    let likely = sum / weight;
    let mut radiance = (likely, 1.0 / weight);
    let (low, high) = model.range(channel);
    let (mut sum, mut weight, mut common) = (0.0_f64, 0.0_f64, 0.0_f64);
    for r in readings.iter().filter(|r| !r.clipped) {
        let expected = likely * r.per_unit;
        if expected >= low && expected < high {
            let (precision, shared) = model.precision(channel, expected);
            let w = f64::from(precision * r.per_unit * r.per_unit);
            sum += w * f64::from(r.says);
            weight += w;
            common += w * f64::from(shared);
        }
    }
    if weight > 0.0 {
        let mean = sum / weight;
        radiance = (mean as f32, (1.0 / weight + common / weight * mean * mean) as f32);
    }
    Estimate { radiance: radiance.0, variance: radiance.1, clipped: false }
}

/// No frame is well exposed. Saturated in the shortest: it gives a lower bound, as uncertain as it is large. Black in
/// the longest: what that one reads.
fn at_the_ends(readings: &[Reading]) -> Estimate {
    let shortest = readings.iter().max_by(|a, b| a.unit.total_cmp(&b.unit));
    let longest = readings.iter().filter(|r| !r.clipped).min_by(|a, b| a.unit.total_cmp(&b.unit));
    match (shortest, longest) {
        // Clipped in some and black in all others: the longest of the black ones tells most.
        (_, Some(r)) => Estimate { radiance: r.says, variance: r.variance, clipped: false },
        (Some(r), None) => Estimate { radiance: r.unit, variance: r.unit * r.unit, clipped: true },
        (None, None) => Estimate::default(),
    }
}

/// Frames, one bit each, that see something else than the others: further from the middle of the readings than noise
/// explains, clipped though the others say that they should not be, or black likewise.
pub(super) fn inconsistent(readings: &[Reading], model: &Noise, channel: usize, likely: f32) -> u64 {
    let off = |r: &Reading, centre: f32| {
        let off = r.says - centre;
        off * off > SURE * SURE * (r.variance + (UNTOLD * centre) * (UNTOLD * centre))
    };
    let (low, high) = model.range(channel);
    let impossible = |r: &Reading, centre: f32| {
        let expected = centre * r.per_unit;
        r.clipped && expected < FAR * high || r.dark && !r.clipped && FAR * expected > low.max(0.02)
    };
    let wrong = |centre: f32| {
        let bad = |r: &Reading| if r.tells() { off(r, centre) } else { impossible(r, centre) };
        readings.iter().filter(|r| r.frame < 64 && bad(r)).fold(0_u64, |bits, r| bits | 1 << r.frame)
    };
    if !readings.iter().any(Reading::tells) || wrong(likely) == 0 {
        return 0;
    }
    wrong(middle(readings))
}

/// Weighted median of what the frames say; all frames that are good to a few per cent count alike, so that the longest
/// exposure does not outvote all others.
fn middle(readings: &[Reading]) -> f32 {
    let mut said: Vec<(f32, f32)> = readings
        .iter()
        .filter(|r| r.tells())
        .map(|r| {
            (r.says, 1.0 / (r.variance + (UNTOLD * r.says).powi(2)).max(1e-20) * r.says.powi(2).max(1e-20))
        })
        .collect();
    said.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = said.iter().map(|s| s.1).sum::<f32>() / 2.0;
    let mut sum = 0.0;
    said.iter()
        .find(|s| {
            sum += s.1;
            sum >= half
        })
        .map_or(0.0, |s| s.0)
}

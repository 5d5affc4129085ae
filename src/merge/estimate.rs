//! One channel of a run of pixels from what the frames read there: frame by frame, all pixels of the run side by side, so that
//! the processor's vectors hold them.

use super::noise::Noise;

/// Pixels of a run. What ten frames say of them fits into the cache next to the processor.
pub(super) const RUN: usize = 64;

/// A number for each pixel of a run.
pub(super) type Lane = [f32; RUN];

/// What one frame says of a pixel's channel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Told {
    /// Radiance that it says.
    pub says: f32,
    /// Inverse of its variance; 0 where it says nothing, being clipped, dark or not there.
    weight: f32,
    /// Radiance that there surely is: +∞ where it is clipped, −∞ at or below the black level, no number where the frame does not
    /// reach.
    least: f32,
}

impl Told {
    /// Of a frame that was moved, where it does not reach.
    pub const NOTHING: Self = Self { says: 0.0, weight: 0.0, least: f32::NAN };

    /// `exposure`: relative one, with its variance. `unit`: radiance at which this frame has relative exposure 1.
    pub fn new(exposure: f32, variance: f32, unit: f32, [clipped, dark]: [bool; 2]) -> Self {
        let (says, variance) = (exposure * unit, variance * unit * unit);
        let (weight, least) = match (clipped, dark) {
            (true, _) => (0.0, f32::INFINITY),
            (_, true) => (0.0, f32::NEG_INFINITY),
            _ => (1.0 / variance, says - SURE * variance.sqrt()),
        };
        Self { says, weight, least }
    }

    fn is_there(&self) -> bool {
        !self.least.is_nan()
    }

    fn is_clipped(&self) -> bool {
        self.least == f32::INFINITY
    }

    fn is_dark(&self) -> bool {
        self.least == f32::NEG_INFINITY
    }

    fn tells(&self) -> bool {
        self.weight > 0.0
    }
}

/// One frame's [`Told`] of each pixel.
#[derive(Clone)]
struct Lanes {
    says: Lane,
    weight: Lane,
    least: Lane,
}

impl Lanes {
    fn at(&self, p: usize) -> Told {
        Told { says: self.says[p], weight: self.weight[p], least: self.least[p] }
    }
}

#[derive(Debug, Clone, Copy, Default, PartialEq)]
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

/// What all frames say of a channel of a run of pixels.
pub(super) struct Run<'a> {
    noise: &'a Noise<'a>,
    /// By frame, the shortest exposure first: radiance at which it has relative exposure 1.
    units: &'a [f32],
    /// Their inverses.
    per_unit: Vec<f32>,
    frames: Vec<Lanes>,
    /// What the telling ones weigh together.
    weight: Lane,
    radiance: Lane,
    variance: Lane,
    /// Room for what the frames say of one pixel, and how it counts.
    said: Vec<(f32, f32)>,
}

impl<'a> Run<'a> {
    pub fn new(noise: &'a Noise<'a>, units: &'a [f32]) -> Self {
        let [says, weight, least] = [[0.0; RUN], [0.0; RUN], [f32::NAN; RUN]];
        let frames = vec![Lanes { says, weight, least }; units.len()];
        let per_unit = units.iter().map(|unit| 1.0 / unit).collect();
        Self { noise, units, per_unit, frames, weight, radiance: says, variance: says, said: Vec::new() }
    }

    /// Takes down what a frame says of the pixels, at most [`RUN`] of them.
    pub fn put(&mut self, frame: usize, told: impl Iterator<Item = Told>) {
        let Lanes { says, weight, least } = &mut self.frames[frame];
        for (((told, says), weight), least) in told.zip(says).zip(weight).zip(least) {
            (*says, *weight, *least) = (told.says, told.weight, told.least);
        }
    }

    /// Takes back what some of the frames, one bit each, say of a pixel; where nothing would be left, all stay.
    pub fn leave_out(&mut self, p: usize, frames: u64) {
        let kept = |(frame, lanes): (usize, &Lanes)| !bit(frames, frame) && lanes.at(p).is_there();
        if self.frames.iter().enumerate().any(kept) {
            for (_, lanes) in self.frames.iter_mut().enumerate().filter(|(frame, _)| bit(frames, *frame)) {
                let Told { says, weight, least } = Told::NOTHING;
                (lanes.says[p], lanes.weight[p], lanes.least[p]) = (says, weight, least);
            }
        }
    }

    /// The maximum-likelihood mean of each pixel, for Gaussian noise whose variance is predicted from what all readings make
    /// likely; read by [`Self::at`].
    pub fn estimate(&mut self, channel: usize) {
        self.overexpose(channel);
        // First by what each frame reads, then by what all together make likely.
        let (mut sum, mut weight) = ([0.0; RUN], [0.0; RUN]);
        for Lanes { says, weight: own, .. } in &self.frames {
            for p in 0..RUN {
                sum[p] += own[p] * says[p];
                weight[p] += own[p];
            }
        }
        for p in 0..RUN {
            self.radiance[p] = sum[p] / weight[p];
            self.variance[p] = 1.0 / weight[p];
        }
        self.weight = weight;
        self.refine(channel);
    }

    /// Marks readings as clipped that a shorter exposure shows to be out of range: JPEG's coarse colour lets the code of a
    /// clipped channel stray below the clipping level beside a small, strong light.
    fn overexpose(&mut self, channel: usize) {
        let (_, high) = self.noise.range(channel);
        // By shorter exposures; by those up to this one.
        let (mut surely, mut so_far) = ([f32::NEG_INFINITY; RUN], [f32::NEG_INFINITY; RUN]);
        let mut last = f32::INFINITY;
        for (lanes, unit) in self.frames.iter_mut().zip(self.units) {
            if *unit < last {
                (surely, last) = (so_far, *unit);
            }
            let top = high * unit;
            for p in 0..RUN {
                let beyond = (surely[p] > top) & (lanes.says[p] > FAR * top);
                // Without a branch: all bits set where it is beyond.
                let mask = u32::from(beyond).wrapping_neg();
                let least = lanes.least[p].to_bits() & !mask | f32::INFINITY.to_bits() & mask;
                lanes.weight[p] = f32::from_bits(lanes.weight[p].to_bits() & !mask);
                lanes.least[p] = f32::from_bits(least);
                so_far[p] = if lanes.least[p] > so_far[p] { lanes.least[p] } else { so_far[p] };
            }
        }
    }

    /// Weighs anew by the variance expected at the radiance that is likely so far. A frame too dark to say much tells
    /// something as well, if that is expected of it.
    fn refine(&mut self, channel: usize) {
        let (low, high) = self.noise.range(channel);
        let (mut sum, mut weight, mut common) = ([0.0; RUN], [0.0; RUN], [0.0; RUN]);
        for (lanes, per_unit) in self.frames.iter().zip(&self.per_unit) {
            let mut expected = [0.0; RUN];
            let mut counts = [0.0; RUN];
            for p in 0..RUN {
                expected[p] = self.radiance[p] * per_unit;
                let in_range = (expected[p] >= low) & (expected[p] < high);
                counts[p] =
                    if in_range & (lanes.least[p] < f32::INFINITY) { per_unit * per_unit } else { 0.0 };
            }
            if counts.iter().all(|c| *c == 0.0) {
                continue;
            }
            let (precision, shared) = self.noise.precision(channel, &expected);
            for p in 0..RUN {
                let w = precision[p] * counts[p];
                sum[p] += w * lanes.says[p];
                weight[p] += w;
                common[p] += w * shared[p];
            }
        }
        for p in 0..RUN {
            let told = weight[p] > 0.0;
            let mean = sum[p] / weight[p];
            let variance = 1.0 / weight[p] + common[p] / weight[p] * mean * mean;
            self.radiance[p] = if told { mean } else { self.radiance[p] };
            self.variance[p] = if told { variance } else { self.variance[p] };
        }
    }

    /// What was estimated of a pixel.
    pub fn at(&self, p: usize, channel: usize) -> Estimate {
        if self.weight[p] > 0.0 {
            return Estimate { radiance: self.radiance[p], variance: self.variance[p], clipped: false };
        }
        self.at_the_ends(p, channel)
    }

    /// No frame is well exposed. Saturated in the shortest: it gives a lower bound, as uncertain as it is large. Black in
    /// the longest: what that one reads.
    fn at_the_ends(&self, p: usize, channel: usize) -> Estimate {
        let mut there = self.frames.iter().zip(self.units).filter(|(lanes, _)| lanes.at(p).is_there());
        // Clipped in some and black in all others: the longest of the black ones tells most.
        let longest = there.clone().rfind(|(lanes, _)| !lanes.at(p).is_clipped());
        match (longest, there.next()) {
            (Some((lanes, unit)), _) => {
                let radiance = lanes.says[p];
                let variance = self.noise.variance(channel, radiance / unit) * unit * unit;
                Estimate { radiance, variance, clipped: false }
            }
            (None, Some((_, unit))) => Estimate { radiance: *unit, variance: unit * unit, clipped: true },
            (None, None) => Estimate::default(),
        }
    }

    /// Pixels of which some frame may see something else than the others: further from the estimate than noise explains,
    /// clipped though the others say that it should not be, or black likewise.
    pub fn suspect(&self, channel: usize) -> [bool; RUN] {
        let (low, high) = self.noise.range(channel);
        let mut found = [0_u32; RUN];
        for (lanes, per_unit) in self.frames.iter().zip(&self.per_unit).take(64) {
            for (p, found) in found.iter_mut().enumerate() {
                let (centre, weight) = (self.radiance[p], lanes.weight[p]);
                let (least, expected) = (lanes.least[p], centre * per_unit);
                let wrong = is_off(lanes.says[p], weight, centre)
                    | (least == f32::INFINITY) & should_not_clip(expected, high)
                    | (least == f32::NEG_INFINITY) & should_not_be_dark(expected, low);
                *found |= u32::from(wrong);
            }
        }
        std::array::from_fn(|p| found[p] != 0 && self.weight[p] > 0.0)
    }

    /// Frames, one bit each, that see something else at a pixel than the middle of what the frames say.
    pub fn inconsistent(&mut self, p: usize, channel: usize) -> u64 {
        let (low, high) = self.noise.range(channel);
        let centre = self.middle(p);
        let wrong = |told: Told, per_unit: f32| {
            let expected = centre * per_unit;
            is_off(told.says, told.weight, centre)
                || told.is_clipped() && should_not_clip(expected, high)
                || told.is_dark() && should_not_be_dark(expected, low)
        };
        let frames = self.frames.iter().zip(&self.per_unit).take(64).enumerate();
        frames.fold(0, |bits, (i, (lanes, per_unit))| bits | u64::from(wrong(lanes.at(p), *per_unit)) << i)
    }

    /// Weighted median of what the frames say; all frames that are good to a few per cent count alike, so that the longest
    /// exposure does not outvote all others.
    fn middle(&mut self, p: usize) -> f32 {
        let telling = self.frames.iter().map(|lanes| lanes.at(p)).filter(Told::tells);
        self.said.clear();
        self.said.extend(telling.map(|Told { says, weight, .. }| {
            let variance = 1.0 / weight + (UNTOLD * says).powi(2);
            (says, says.powi(2).max(1e-20) / variance.max(1e-20))
        }));
        self.said.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let half = self.said.iter().map(|s| s.1).sum::<f32>() / 2.0;
        let mut sum = 0.0;
        let at_half = |s: &&(f32, f32)| {
            sum += s.1;
            sum >= half
        };
        self.said.iter().find(at_half).map_or(0.0, |s| s.0)
    }
}

/// Whether a frame is one of those that have a bit set.
fn bit(frames: u64, frame: usize) -> bool {
    frame < 64 && frames & 1 << frame != 0
}

/// Further from the middle than noise explains: (says − centre)² over variance and what is untold. Never, where nothing is said.
fn is_off(says: f32, weight: f32, centre: f32) -> bool {
    let (off, untold) = (says - centre, UNTOLD * centre);
    off * off * weight > SURE * SURE * (1.0 + untold * untold * weight)
}

fn should_not_clip(expected: f32, high: f32) -> bool {
    expected < FAR * high
}

fn should_not_be_dark(expected: f32, low: f32) -> bool {
    FAR * expected > low.max(0.02)
}

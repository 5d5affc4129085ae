//! The least-squares fit of Debevec and Malik (1997), eq. 3, channel by channel.
//!
//! Departures from the paper, and why: the ln radiances of the places are eliminated one by one (a Schur complement),
//! so that the count of samples costs next to nothing; smoothness is asked of the departure from a typical curve, so
//! that the ends, where there are few data, go on as cameras do and not as a straight line in ln exposure; falling
//! stretches are penalised until none is left (Eilers, *Unimodal smoothing*, J. Chemometrics 2005); outliers are
//! weighted down.

use super::monotone::{self, LEAST_STEP};
use super::samples::{Channel, Reading, median};
use super::{Curve, LEVELS, Problem, Quality, Response, TOP, linear_from_srgb};
use crate::config;
use crate::exposure::Frame;
use nalgebra::{DMatrix, DVector};

/// Fewer places than this determine nothing.
const FEWEST: usize = 30;
/// Largest standard error that is taken for an answer, stops, from the 10 % to the 90 % level.
const WORST_STOPS: f64 = 0.5;
const LN_2: f64 = std::f64::consts::LN_2;

/// Fits the response to frames of one view. Frames may come in any order; equal exposures count once more each.
pub fn fit(frames: &[Frame], settings: &config::Response) -> Result<Response, Problem> {
    let mut order: Vec<usize> = (0..frames.len()).collect();
    for (i, frame) in frames.iter().enumerate() {
        let (size, first) = (frame.codes.size(), frames[0].codes.size());
        if size != first {
            return Err(Problem::Sizes { frame: i + 1, size, first });
        }
        if !(frame.exposure.is_finite() && frame.exposure > 0.0) {
            return Err(Problem::Exposure { frame: i + 1, exposure: frame.exposure });
        }
    }
    order.sort_by(|a, b| frames[*a].exposure.total_cmp(&frames[*b].exposure));
    let sorted: Vec<Frame> = order.iter().map(|i| frames[*i]).collect();
    let distinct = sorted.windows(2).filter(|w| w[1].exposure > 1.01 * w[0].exposure).count() + 1;
    if distinct < 2 || sorted.is_empty() {
        return Err(Problem::OneExposure { frames: frames.len(), distinct: distinct.min(frames.len()) });
    }
    let fits = [0, 1, 2].map(|c| ChannelFit::new(&sorted, c, settings));
    let [red, green, blue] = fits;
    let fits = [red?, green?, blue?];
    let mut frame_stops = vec![0.0; frames.len()];
    order.iter().zip(&fits[1].frame_stops).for_each(|(i, stops)| frame_stops[*i] = *stops);
    let quality = Quality {
        samples: [0, 1, 2].map(|c: usize| fits[c].samples),
        rms_stops: [0, 1, 2].map(|c: usize| fits[c].rms_stops),
        frame_stops,
        condition: fits.iter().map(|f| f.condition).fold(0.0, f64::max),
    };
    Ok(Response { curves: fits.map(|f| f.curve), assumed: false, quality: Some(quality) })
}

struct ChannelFit {
    curve: Curve,
    samples: usize,
    rms_stops: f64,
    frame_stops: Vec<f64>,
    condition: f64,
}

/// One place in one frame.
struct Observation {
    place: usize,
    frame: usize,
    /// Level below, and share of the level above.
    level: usize,
    share: f64,
    ln_exposure: f64,
    weight: f64,
    /// Robust factor.
    trust: f64,
}

impl Observation {
    fn g(&self, g: &[f64]) -> f64 {
        g[self.level] * (1.0 - self.share) + g[self.level + 1] * self.share
    }
}

impl ChannelFit {
    fn new(frames: &[Frame], channel: usize, settings: &config::Response) -> Result<Self, Problem> {
        let exposures: Vec<f64> = frames.iter().map(|f| f.exposure).collect();
        let readings = Channel::read(frames, channel);
        let chosen = readings.choose(&exposures, settings.samples.max(FEWEST));
        if chosen.len() < FEWEST {
            return Err(too_few(&readings, channel, chosen.len()));
        }
        let mut observations = observe(&readings, &chosen, &exposures);
        let typical = typical_curve(&readings);
        let solver = Solver {
            typical: &typical,
            pinned: readings.clip as usize,
            smoothness: settings.smoothness,
            floor: readings.floor,
        };
        let (mut g, mut solution) = solver.solve(&observations, &typical);
        for _ in 0..ROUNDS {
            distrust_outliers(&mut observations, &g, chosen.len());
            (g, solution) = solver.solve(&observations, &g);
        }
        let residuals = residuals(&observations, &g, chosen.len());
        let total: f64 = observations.iter().map(|o| o.weight * o.trust).sum();
        let square: f64 = observations.iter().zip(&residuals).map(|(o, r)| o.weight * o.trust * r * r).sum();
        let freedom = (observations.len() as f64 - chosen.len() as f64).max(1.0) / observations.len() as f64;
        let variance = square / total / freedom;
        let standard_error =
            solution.standard_errors(variance, total / observations.len() as f64, solver.pinned);
        monotone::project(&mut g, &standard_error.iter().map(|s| 1.0 / (s * s + 1e-8)).collect::<Vec<_>>());
        let zero = g[solver.pinned];
        let curve = Curve {
            exposure: g.iter().map(|g| (g - zero).exp()).collect(),
            standard_error,
            floor: (readings.floor / TOP) as f32,
            clip: (readings.clip / TOP) as f32,
        };
        let fit = Self {
            curve,
            samples: chosen.len(),
            rms_stops: plain_rms(&observations, &residuals) / LN_2,
            frame_stops: frame_medians(&observations, &residuals, frames.len()),
            condition: solution.condition,
        };
        fit.determined(channel, &readings)?;
        Ok(fit)
    }

    fn determined(&self, channel: usize, readings: &Channel) -> Result<(), Problem> {
        let span = readings.clip - readings.lowest;
        let (low, high) = (readings.lowest + 0.1 * span, readings.lowest + 0.9 * span);
        let worst = (low as usize..high as usize).map(|k| (self.curve.standard_error[k] / LN_2, k));
        match worst.max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((stops, level)) if stops.is_nan() || stops > WORST_STOPS => Err(Problem::Undetermined {
                channel,
                level,
                stops,
                limit: WORST_STOPS,
                condition: self.condition,
            }),
            _ => Ok(()),
        }
    }
}

/// Rounds of weighting outliers down.
const ROUNDS: usize = 4;

fn too_few(readings: &Channel, channel: usize, usable: usize) -> Problem {
    let all: Vec<&Reading> = readings.places.iter().flatten().collect();
    let share = |is: &dyn Fn(&Reading) -> bool| {
        all.iter().filter(|r| is(r)).count() as f64 / (all.len() as f64).max(1.0)
    };
    Problem::TooFew {
        channel,
        usable,
        places: readings.places.len(),
        needed: FEWEST,
        clipped: share(&|r| readings.is_clipped(r)),
        dark: share(&|r| r.mean <= readings.lowest),
    }
}

fn observe(readings: &Channel, chosen: &[usize], exposures: &[f64]) -> Vec<Observation> {
    let mut observations = Vec::new();
    for (place, index) in chosen.iter().enumerate() {
        for (frame, reading) in readings.places[*index].iter().enumerate() {
            if readings.is_good(reading) {
                let level = (reading.mean as usize).min(LEVELS - 2);
                let hat = weight(readings, reading.mean);
                observations.push(Observation {
                    place,
                    frame,
                    level,
                    share: reading.mean - level as f64,
                    ln_exposure: exposures[frame].ln(),
                    weight: hat * hat,
                    trust: 1.0,
                });
            }
        }
    }
    observations
}

/// Half a hat: rises from the black level to the middle as in the paper, since noise in ln exposure falls that way;
/// then stays up, since the bright end fixes the scale, and clipped places have been left out already.
fn weight(readings: &Channel, level: f64) -> f64 {
    let rising = (level - readings.floor) / (0.5 * (readings.clip - readings.floor));
    rising.min(1.0) * ((readings.clip + 2.0 - level) / 12.0).clamp(0.0, 1.0)
}

/// ln exposure of the sRGB curve between black level and saturation, going on as steeply below.
fn typical_curve(readings: &Channel) -> Vec<f64> {
    let ln = |z: f64| linear_from_srgb((z - readings.floor) / (readings.clip - readings.floor)).ln();
    let start = readings.floor + 1.0;
    let below = |z: f64| ln(start) - (start - z) * LN_2;
    (0..LEVELS).map(|z| z as f64).map(|z| if z < start { below(z) } else { ln(z) }).collect()
}

struct Solver<'a> {
    typical: &'a [f64],
    /// Level whose ln exposure is 0.
    pinned: usize,
    smoothness: f64,
    /// Black level.
    floor: f64,
}

struct Solution {
    /// Inverse of the normal equations, data scaled to a mean weight of 1 a level.
    inverse: DMatrix<f64>,
    condition: f64,
    scale: f64,
}

impl Solution {
    fn standard_errors(&self, variance: f64, mean_weight: f64, pinned: usize) -> Vec<f64> {
        // `variance` is that of an observation of weight 1 in units where the mean weight is 1.
        let factor = variance * mean_weight * self.scale;
        (0..LEVELS)
            .map(|k| if k == pinned { 0.0 } else { (self.inverse[(k, k)].max(0.0) * factor).sqrt() })
            .collect()
    }
}

impl Solver<'_> {
    /// Minimises over all levels; `start` tells where the curve falls.
    fn solve(&self, observations: &[Observation], start: &[f64]) -> (Vec<f64>, Solution) {
        let total: f64 = observations.iter().map(|o| o.weight * o.trust).sum();
        let scale = LEVELS as f64 / total.max(1e-12);
        let (mut normal, mut right) = self.data_terms(observations, scale);
        self.add_smoothness(&mut normal);
        normal[(self.pinned, self.pinned)] += 1e9;
        let (fixed, fixed_right) = (normal.clone(), right.clone());
        let mut g = start.to_vec();
        let mut falling = Vec::new();
        loop {
            let inverse = match normal.clone().cholesky() {
                Some(factor) => factor.inverse(),
                None => DMatrix::from_element(LEVELS, LEVELS, f64::NAN),
            };
            let departure = &inverse * &right;
            g.iter_mut().enumerate().for_each(|(k, g)| *g = self.typical[k] + departure[k]);
            let before = falling.len();
            let falls = |k: &usize| g[k + 1] - g[*k] < LEAST_STEP && !falling.contains(k);
            let more: Vec<usize> = (0..LEVELS - 1).filter(falls).collect();
            falling.extend(more);
            if falling.len() == before || inverse[(0, 0)].is_nan() {
                let eigen = fixed.symmetric_eigenvalues();
                let mut values: Vec<f64> = eigen.iter().copied().collect();
                values.sort_by(f64::total_cmp);
                // The largest is the pin's.
                let condition = values[LEVELS - 2] / values[0].max(1e-300);
                return (g, Solution { inverse, condition, scale });
            }
            (normal, right) = (fixed.clone(), fixed_right.clone());
            falling.iter().for_each(|k| self.push_up(&mut normal, &mut right, *k));
        }
    }

    /// Normal equations of the departures from the typical curve, ln radiances eliminated.
    fn data_terms(&self, observations: &[Observation], scale: f64) -> (DMatrix<f64>, DVector<f64>) {
        let mut normal = DMatrix::zeros(LEVELS, LEVELS);
        let mut right = DVector::zeros(LEVELS);
        for place in observations.chunk_by(|a, b| a.place == b.place) {
            // Rows of the place, the mean row taken off each.
            let sum: f64 = place.iter().map(|o| o.weight * o.trust).sum();
            let mut mean_row: Vec<(usize, f64)> = Vec::new();
            let mut mean_value = 0.0;
            for o in place {
                let share = o.weight * o.trust / sum.max(1e-300);
                mean_row.extend([(o.level, share * (1.0 - o.share)), (o.level + 1, share * o.share)]);
                mean_value += share * (o.ln_exposure - o.g(self.typical));
            }
            for o in place {
                let row = [(o.level, 1.0 - o.share), (o.level + 1, o.share)];
                let value = o.ln_exposure - o.g(self.typical);
                add_product(&mut normal, &mut right, &row, value, scale * o.weight * o.trust);
            }
            add_product(&mut normal, &mut right, &mean_row, mean_value, -scale * sum);
        }
        (normal, right)
    }

    fn add_smoothness(&self, normal: &mut DMatrix<f64>) {
        let half = 0.5 * (self.pinned as f64 - self.floor);
        for k in 1..LEVELS - 1 {
            // Curves bend faster in the dark, where the scale of change is the level itself.
            let stiffness = ((k as f64 + 1.0 - self.floor) / half).clamp(1.0 / half, 1.0).powi(3);
            let row = [(k - 1, 1.0), (k, -2.0), (k + 1, 1.0)];
            for (i, a) in row {
                for (j, b) in row {
                    normal[(i, j)] += self.smoothness * stiffness * a * b;
                }
            }
        }
    }

    /// Asks the step above level `k` to be at least the least one.
    fn push_up(&self, normal: &mut DMatrix<f64>, right: &mut DVector<f64>, k: usize) {
        let value = 2.0 * LEAST_STEP - (self.typical[k + 1] - self.typical[k]);
        add_product(normal, right, &[(k, -1.0), (k + 1, 1.0)], value, 1e6);
    }
}

fn add_product(
    normal: &mut DMatrix<f64>,
    right: &mut DVector<f64>,
    row: &[(usize, f64)],
    value: f64,
    weight: f64,
) {
    for (i, a) in row {
        for (j, b) in row {
            normal[(*i, *j)] += weight * a * b;
        }
        right[*i] += weight * a * value;
    }
}

/// g(Z) − ln E − ln t at the best ln E of each place.
fn residuals(observations: &[Observation], g: &[f64], places: usize) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); places];
    for o in observations {
        let weight = o.weight * o.trust;
        sums[o.place].0 += weight * (o.g(g) - o.ln_exposure);
        sums[o.place].1 += weight;
    }
    observations
        .iter()
        .map(|o| o.g(g) - o.ln_exposure - sums[o.place].0 / sums[o.place].1.max(1e-300))
        .collect()
}

/// Tukey-like weights: an observation three times further off than usual counts half.
fn distrust_outliers(observations: &mut [Observation], g: &[f64], places: usize) {
    let residuals = residuals(observations, g, places);
    let sizes = observations.iter().zip(&residuals).map(|(o, r)| r.abs() * o.weight.sqrt());
    let usual = 1.4826 * median(sizes.filter(|s| *s > 0.0)).unwrap_or(0.0);
    for (o, r) in observations.iter_mut().zip(residuals) {
        let size = r.abs() * o.weight.sqrt() / (3.0 * usual.max(1e-6));
        o.trust = 1.0 / (1.0 + size.powi(2));
    }
}

/// Residuals as they are, without the robust factor: a frame that is off must show.
fn plain_rms(observations: &[Observation], residuals: &[f64]) -> f64 {
    let (sum, weight) = observations
        .iter()
        .zip(residuals)
        .fold((0.0, 0.0), |(s, w), (o, r)| (s + o.weight * r * r, w + o.weight));
    (sum / weight.max(1e-300)).sqrt()
}

/// Median residual of each frame, stops; 0 for a frame that has hardly any observation.
fn frame_medians(observations: &[Observation], residuals: &[f64], frames: usize) -> Vec<f64> {
    let of =
        |frame| observations.iter().zip(residuals).filter(move |(o, _)| o.frame == frame).map(|(_, r)| *r);
    (0..frames).map(|f| if of(f).count() < 10 { 0.0 } else { median(of(f)).unwrap_or(0.0) / LN_2 }).collect()
}

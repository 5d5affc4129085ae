//! The least-squares fit of Debevec and Malik (1997), eq. 3.
//!
//! Departures from the paper, and why: the ln radiances of the places are eliminated one by one (a Schur complement),
//! so that the count of samples costs next to nothing; smoothness is asked of the departure from a typical curve, so
//! that the ends, where there are few data, go on as cameras do and not as a straight line in ln exposure; falling
//! stretches are penalised until none is left (Eilers, *Unimodal smoothing*, J. Chemometrics 2005); outliers are
//! weighted down. The frames' exposures can be let free within the same solve ([`super::exposures`]).

use super::monotone::LEAST_STEP;
use super::observations::Observations;
use super::samples::Channel;
use super::{LEVELS, LN_2, linear_from_srgb};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Rounds of weighting outliers down.
const ROUNDS: usize = 4;
/// Steps of the power iteration.
const POWERS: usize = 30;
/// Rms of twice summed independent second differences of standard deviation 1 at full stiffness, a straight line taken off.
const SUMMED: f64 = 290.0;
/// No curve bends less: half of what common ones do (1.2 to 2.8 · 10⁻⁴).
const LEAST_BENDING: f64 = 1e-4;
/// Weight of what must hold exactly.
const FIRM: f64 = 1e6;

/// Fits ln exposure at all levels; outliers lose their weight in `observations`.
pub(super) fn fit(solver: &Solver, observations: &mut Observations) -> Solution {
    let mut solution = solver.solve(observations, None);
    for _ in 0..ROUNDS {
        observations.distrust_outliers(&solution.g);
        solution = solver.solve(observations, None);
    }
    solution
}

/// What the fit asks of a channel's curve.
pub(super) struct Solver {
    /// ln exposure of a typical camera.
    pub typical: Vec<f64>,
    /// Level whose ln exposure is 0.
    pinned: usize,
    smoothness: f64,
    /// Black level.
    floor: f64,
}

/// What is asked of the frames' departures δ from their stated ln exposures.
pub(super) struct Freedom<'a> {
    /// ω of each frame: Σ ω δ = 0 and Σ ω δ ln t = 0, since brackets tell neither the unit nor the power of exposure.
    pub weights: &'a [f64],
    /// ln exposure as stated.
    pub stated: &'a [f64],
}

pub(super) struct Solution {
    /// ln exposure at all levels.
    pub g: Vec<f64>,
    /// Departure of each frame's ln exposure from the stated one; empty where they are held.
    pub departures: Vec<f64>,
    factor: Option<Cholesky<f64, Dyn>>,
    /// Without what penalises falling stretches.
    normal: DMatrix<f64>,
    pinned: usize,
    /// Variance of an observation of weight 1, in the units of the normal equations.
    variance: f64,
    /// Weight of the second difference at each level.
    smoothness: Vec<(usize, f64)>,
    /// Standard deviation of a second difference times the root of its weight, as the curve bends.
    bending: f64,
}

impl Solution {
    /// Standard errors of all levels, then of the departures: from the noise, and where the data leave a level to
    /// smoothness, from how much curves bend all the same.
    pub fn standard_errors(&self) -> Vec<f64> {
        let Some(factor) = &self.factor else { return vec![f64::NAN; self.normal.nrows()] };
        let inverse = factor.inverse();
        let mut variances: Vec<f64> = inverse.diagonal().iter().map(|v| v.max(0.0) * self.variance).collect();
        // The solution is off by N⁻¹ (S d − noise) with S the smoothness and d the true departure from the typical curve; of
        // that, noise of the size that S takes for granted is in N⁻¹ already.
        let more = (self.bending * self.bending - self.variance).max(0.0);
        for (k, weight) in &self.smoothness {
            let row = inverse.column(k - 1) - 2.0 * inverse.column(*k) + inverse.column(k + 1);
            variances.iter_mut().zip(row.iter()).for_each(|(v, r)| *v += more * weight * r * r);
        }
        variances.into_iter().map(f64::sqrt).collect()
    }

    /// Condition number of the normal equations, by power iteration; the pin does not count.
    pub fn condition(&self) -> f64 {
        let n = self.normal.nrows();
        let Some(factor) = &self.factor else { return f64::INFINITY };
        let start = || DVector::from_fn(n, |i, _| 1.0 + (i as f64 * 0.7).sin());
        let (mut large, mut small) = (start(), start());
        let (mut largest, mut smallest) = (0.0, 0.0);
        for _ in 0..POWERS {
            large[self.pinned] = 0.0;
            large = &self.normal * large.normalize();
            large[self.pinned] = 0.0;
            largest = large.norm();
            small = factor.solve(&small.normalize());
            smallest = 1.0 / small.norm();
        }
        largest / f64::max(smallest, 1e-300)
    }
}

impl Solver {
    pub fn new(readings: &Channel, smoothness: f64) -> Self {
        Self {
            typical: typical_curve(readings),
            pinned: readings.clip as usize,
            smoothness,
            floor: readings.floor,
        }
    }

    /// Minimises over all levels, and over the frames' departures where they are free.
    pub fn solve(&self, observations: &Observations, freedom: Option<&Freedom>) -> Solution {
        let frames = freedom.map_or(0, |f| f.weights.len());
        let scale = LEVELS as f64 / observations.total().max(1e-12);
        let (mut normal, mut right) = self.data_terms(observations, scale, frames);
        self.add_smoothness(&mut normal);
        normal[(self.pinned, self.pinned)] += 1e9;
        if let Some(freedom) = freedom {
            freedom.add_to(&mut normal);
        }
        let plain = normal.clone();
        let mut falling: Vec<usize> = Vec::new();
        loop {
            let factor = normal.clone().cholesky();
            let x =
                factor.as_ref().map_or(DVector::from_element(LEVELS + frames, f64::NAN), |f| f.solve(&right));
            let g: Vec<f64> = (0..LEVELS).map(|k| self.typical[k] + x[k]).collect();
            let before = falling.len();
            let falls = |k: &usize| g[k + 1] - g[*k] < LEAST_STEP && !falling.contains(k);
            let more: Vec<usize> = (0..LEVELS - 1).filter(falls).collect();
            if more.is_empty() || factor.is_none() {
                let departures: Vec<f64> = (0..frames).map(|j| x[LEVELS + j]).collect();
                let variance = self.variance(observations, &g, &departures) * scale;
                let bending = self.smoothness.sqrt() * self.bending(&g);
                let (normal, pinned, smoothness) = (plain, self.pinned, self.weights().collect());
                return Solution { g, departures, factor, normal, pinned, variance, smoothness, bending };
            }
            more.iter().for_each(|k| self.push_up(&mut normal, &mut right, *k));
            falling.extend(more);
            debug_assert!(falling.len() > before);
        }
    }

    /// Of an observation of weight 1.
    fn variance(&self, observations: &Observations, g: &[f64], departures: &[f64]) -> f64 {
        let mut moved = observations.clone();
        for o in &mut moved.list {
            o.ln_exposure += departures.get(o.frame).copied().unwrap_or(0.0);
        }
        let residuals = moved.residuals(g);
        let square: f64 = moved.list.iter().zip(&residuals).map(|(o, r)| o.weight * o.trust * r * r).sum();
        let mut seen: Vec<usize> = moved.list.iter().map(|o| o.place).collect();
        seen.dedup();
        let count = moved.list.len() as f64;
        // The mean of the weights is that of an observation.
        square / (count - seen.len() as f64).max(1.0)
    }

    /// Normal equations of the departures from the typical curve, ln radiances eliminated.
    fn data_terms(
        &self,
        observations: &Observations,
        scale: f64,
        frames: usize,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let mut normal = DMatrix::zeros(LEVELS + frames, LEVELS + frames);
        let mut right = DVector::zeros(LEVELS + frames);
        for place in observations.list.chunk_by(|a, b| a.place == b.place) {
            // Rows of the place, the mean row taken off each.
            let sum: f64 = place.iter().map(|o| o.weight * o.trust).sum();
            let mut mean_row: Vec<(usize, f64)> = Vec::new();
            let mut mean_value = 0.0;
            for o in place {
                let share = o.weight * o.trust / sum.max(1e-300);
                let free = (frames > 0).then_some((LEVELS + o.frame, -share));
                mean_row.extend([(o.level, share * (1.0 - o.share)), (o.level + 1, share * o.share)]);
                mean_row.extend(free);
                mean_value += share * (o.ln_exposure - o.of(&self.typical));
            }
            for o in place {
                let row = [(o.level, 1.0 - o.share), (o.level + 1, o.share), (LEVELS + o.frame, -1.0)];
                let row = if frames > 0 { &row[..] } else { &row[..2] };
                let value = o.ln_exposure - o.of(&self.typical);
                add_product(&mut normal, &mut right, row, value, scale * o.weight * o.trust);
            }
            add_product(&mut normal, &mut right, &mean_row, mean_value, -scale * sum);
        }
        (normal, right)
    }

    fn add_smoothness(&self, normal: &mut DMatrix<f64>) {
        for (k, weight) in self.weights() {
            let row = [(k - 1, 1.0), (k, -2.0), (k + 1, 1.0)];
            for (i, a) in row {
                for (j, b) in row {
                    normal[(i, j)] += weight * a * b;
                }
            }
        }
    }

    /// Weight of the squared second difference at each level.
    fn weights(&self) -> impl Iterator<Item = (usize, f64)> {
        let (floor, smoothness) = (self.floor, self.smoothness);
        let half = 0.5 * (self.pinned as f64 - floor);
        // Curves bend faster in the dark, where the scale of change is the level itself.
        let stiffness = move |k: usize| ((k as f64 + 1.0 - floor) / half).clamp(1.0 / half, 1.0).powi(3);
        (1..LEVELS - 1).map(move |k| (k, smoothness * stiffness(k)))
    }

    /// Standard deviation of independent second differences, at full stiffness, that would sum up to what the curve departs
    /// from the typical one, a straight line apart. They are not independent: this one makes the sum right, which counts.
    fn bending(&self, g: &[f64]) -> f64 {
        let (low, high) = (self.floor as usize + 10, self.pinned.saturating_sub(10));
        if high < low + 10 {
            return LEAST_BENDING;
        }
        let points: Vec<(f64, f64)> = (low..high).map(|k| (k as f64, g[k] - self.typical[k])).collect();
        let n = points.len() as f64;
        let mean = |f: &dyn Fn(f64, f64) -> f64| points.iter().map(|p| f(p.0, p.1)).sum::<f64>() / n;
        let (mx, my) = (mean(&|x, _| x), mean(&|_, y| y));
        let slope = mean(&|x, y| (x - mx) * (y - my)) / mean(&|x, _| (x - mx).powi(2));
        let left = mean(&|x, y| (y - my - slope * (x - mx)).powi(2)).sqrt();
        (left / SUMMED).max(LEAST_BENDING)
    }

    /// Asks the step above level `k` to be at least the least one.
    fn push_up(&self, normal: &mut DMatrix<f64>, right: &mut DVector<f64>, k: usize) {
        let value = 2.0 * LEAST_STEP - (self.typical[k + 1] - self.typical[k]);
        add_product(normal, right, &[(k, -1.0), (k + 1, 1.0)], value, FIRM);
    }
}

impl Freedom<'_> {
    fn add_to(&self, normal: &mut DMatrix<f64>) {
        let total: f64 = self.weights.iter().sum();
        let mean = self.weights.iter().zip(self.stated).map(|(w, s)| w * s).sum::<f64>() / total;
        let unit: Vec<f64> = self.weights.iter().map(|w| w / total).collect();
        let slope: Vec<f64> = unit.iter().zip(self.stated).map(|(w, s)| w * (s - mean)).collect();
        for row in [unit, slope] {
            for (i, a) in row.iter().enumerate() {
                for (j, b) in row.iter().enumerate() {
                    normal[(LEVELS + i, LEVELS + j)] += FIRM * a * b;
                }
            }
        }
        // A frame that shares no place with another one is not moved.
        (0..self.weights.len()).for_each(|j| normal[(LEVELS + j, LEVELS + j)] += 1e-6);
    }
}

/// ln exposure of the sRGB curve between black level and saturation, going on as steeply below.
fn typical_curve(readings: &Channel) -> Vec<f64> {
    let ln = |z: f64| linear_from_srgb((z - readings.floor) / (readings.clip - readings.floor)).ln();
    let start = readings.floor + 1.0;
    let below = |z: f64| ln(start) - (start - z) * LN_2;
    (0..LEVELS).map(|z| z as f64).map(|z| if z < start { below(z) } else { ln(z) }).collect()
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

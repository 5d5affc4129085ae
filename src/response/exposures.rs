//! Relative exposures from the pixels that frames have in common, beside what EXIF or the settings state.
//!
//! Curve and exposures are solved for together, with each frame's ln exposure free to depart by δ from what is stated.
//! Brackets tell exposure only up to a unit and a power (Grossberg and Nayar, *Determining the Camera Response from
//! Images: What Is Knowable?*, PAMI 2003), so the δ have neither mean nor slope against the stated values; the weights of
//! that condition are those of robust regression, so that one wrong frame stands alone and does not tilt all others.

use super::debevec_malik::{Freedom, Solver};
use super::observations::Observations;
use super::samples::{Channel, Sampled, median};
use super::{LN_2, Response};
use serde::{Deserialize, Serialize};

/// Departures below this are the resolution of the method: nominal times are that near to true ones (1/125 s
/// is 1/128 s; 1/30 s is 1/32 s, 0.09 stops off), stops.
const LEAST_STOPS: f64 = 0.08;
/// Departures that are told of even where they are too uncertain to be used, stops.
const DOUBTFUL_STOPS: f64 = 0.1;
/// So many standard errors make a departure significant.
const SIGNIFICANT: f64 = 3.0;
/// Standard error that no count of pixels goes below, stops: the curve's own errors.
const FLOOR_STOPS: f64 = 0.01;
/// A frame is only told from the pixels where at least so many places are seen in it and in another one.
const NEEDED: usize = 30;
/// Scale of robust regression, ln: large at first, so that a far frame can be found, then as small as what counts.
const SCALES: [f64; 6] = [0.5, 0.25, 0.12, 0.06, 0.03, 0.03];

/// Exposure of a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FoundExposure {
    /// File of the frame, where it is known.
    pub file: String,
    /// t · S / N² by EXIF or settings.
    pub stated: f64,
    /// The same by the pixels; the stated one where they do not tell.
    pub found: f64,
    /// Standard error of the found one, stops; none where the pixels do not tell.
    pub sigma_stops: Option<f64>,
    /// The one that is used.
    pub used: f64,
}

impl FoundExposure {
    /// A frame of which pixels tell nothing.
    pub fn stated(exposure: f64) -> Self {
        Self { file: String::new(), stated: exposure, found: exposure, sigma_stops: None, used: exposure }
    }

    fn new(stated: f64, departure: f64, sigma_stops: f64) -> Self {
        let sigma_stops = sigma_stops.hypot(FLOOR_STOPS);
        let found = stated * departure.exp();
        if !(found.is_finite() && found > 0.0 && sigma_stops.is_finite()) {
            return Self::stated(stated);
        }
        let stops = departure.abs() / LN_2;
        let significant = stops > LEAST_STOPS && stops > SIGNIFICANT * sigma_stops;
        let used = if significant { found } else { stated };
        Self { file: String::new(), stated, found, sigma_stops: Some(sigma_stops), used }
    }

    /// What to tell of a frame whose pixels contradict what is stated.
    pub fn told(&self, file: &str) -> String {
        let (stops, sigma) = (self.departure_stops(), self.sigma_stops.unwrap_or(f64::INFINITY));
        let used = if self.is_corrected() {
            "what the pixels say is used"
        } else {
            "too uncertain to be used, what is stated stays"
        };
        format!(
            "{file}: by its pixels its exposure is {stops:+.2} ± {sigma:.2} stops from what is stated: {used}"
        )
    }

    /// Found against stated, stops.
    pub fn departure_stops(&self) -> f64 {
        (self.found / self.stated).log2()
    }

    /// Whether the found one lies further off than it should, too uncertain to be used or not.
    pub fn is_doubtful(&self) -> bool {
        let stops = self.departure_stops().abs();
        self.is_corrected() || self.sigma_stops.is_some_and(|s| stops > DOUBTFUL_STOPS && stops > 2.0 * s)
    }

    /// Whether the found exposure is used since it contradicts the stated one.
    pub fn is_corrected(&self) -> bool {
        self.used != self.stated
    }
}

/// Exposures of frames of rising exposure, by channels that are fitted apart; two exposures tell nothing of each other,
/// since any ratio is one camera's.
pub(super) fn find(
    channels: &[Channel; 3],
    observations: &[Observations; 3],
    exposures: &[f64],
    smoothness: f64,
) -> Vec<FoundExposure> {
    let distinct = exposures.windows(2).filter(|w| w[1] > 1.01 * w[0]).count() + 1;
    if distinct < 4 {
        return exposures.iter().map(|e| FoundExposure::stated(*e)).collect();
    }
    let stated: Vec<f64> = exposures.iter().map(|e| e.ln()).collect();
    let by_channel: Vec<Vec<Option<(f64, f64)>>> = (0..3)
        .map(|c| departures(&Solver::new(&channels[c], smoothness), &observations[c], &stated))
        .collect();
    let combined = |j: usize| {
        let told: Vec<(f64, f64)> = by_channel.iter().filter_map(|c| c[j]).collect();
        let middle = median(told.iter().map(|t| t.0))?;
        // Channels share the shutter: how far they differ is how well they tell.
        let spread = told.iter().map(|t| (t.0 - middle).powi(2)).sum::<f64>() / told.len() as f64;
        let formal = told.iter().map(|t| t.1).fold(f64::INFINITY, f64::min);
        // Of a median of three.
        Some((middle, (0.72 * spread.sqrt()).hypot(formal)))
    };
    exposures
        .iter()
        .enumerate()
        .map(|(j, e)| match combined(j) {
            Some((departure, sigma)) => FoundExposure::new(*e, departure, sigma / LN_2),
            None => FoundExposure::stated(*e),
        })
        .collect()
}

/// δ and its standard error of each frame by one channel, ln exposure.
fn departures(solver: &Solver, observations: &Observations, stated: &[f64]) -> Vec<Option<(f64, f64)>> {
    let mut observations = observations.clone();
    let mut seen = vec![0; stated.len()];
    for place in observations.list.chunk_by(|a, b| a.place == b.place).filter(|p| p.len() > 1) {
        place.iter().for_each(|o| seen[o.frame] += 1);
    }
    let told: Vec<bool> = seen.iter().map(|n| *n >= NEEDED).collect();
    if told.iter().filter(|t| **t).count() < 4 {
        return vec![None; stated.len()];
    }
    // A frame of which pixels tell nothing has no say in what is usual.
    let mut weights: Vec<f64> = told.iter().map(|t| if *t { 1.0 } else { 1e-6 }).collect();
    let mut solution = None;
    for scale in SCALES {
        let found = solver.solve(&observations, Some(&Freedom { weights: &weights, stated }));
        for (j, weight) in weights.iter_mut().enumerate().filter(|(j, _)| told[*j]) {
            *weight = 1.0 / (1.0 + (found.departures[j] / scale).powi(2));
        }
        let mut moved = observations.clone();
        moved.list.iter_mut().for_each(|o| o.ln_exposure += found.departures[o.frame]);
        moved.distrust_outliers(&found.g);
        observations.list.iter_mut().zip(&moved.list).for_each(|(o, m)| o.trust = m.trust);
        solution = Some(found);
    }
    let Some(solution) = solution else { return vec![None; stated.len()] };
    let errors = solution.standard_errors();
    let of = |j: usize| (solution.departures[j], errors[super::LEVELS + j]);
    (0..stated.len())
        .map(|j| told[j].then(|| of(j)).filter(|(d, s)| d.is_finite() && s.is_finite()))
        .collect()
}

/// Exposures of frames by a curve that is known: each frame against the next by the median of what both show.
pub fn by_curve(frames: &[Sampled], response: &Response) -> Vec<FoundExposure> {
    let mut order: Vec<usize> = (0..frames.len()).collect();
    order.sort_by(|a, b| frames[*a].exposure.total_cmp(&frames[*b].exposure));
    let stated: Vec<f64> = order.iter().map(|i| frames[*i].exposure).collect();
    // δ against the frame before, and the variance of the chain so far.
    let mut chain = vec![(0.0, 0.0)];
    for pair in order.windows(2) {
        let (a, b) = (&frames[pair[0]], &frames[pair[1]]);
        let step = (b.exposure / a.exposure).ln();
        let (delta, variance) = chain[chain.len() - 1];
        chain.push(match between(a, b, response) {
            Some((ratio, sigma)) => (delta + ratio - step, variance + sigma * sigma),
            None => (delta, f64::INFINITY),
        });
    }
    let usual = median(chain.iter().filter(|c| c.1.is_finite()).map(|c| c.0)).unwrap_or(0.0);
    let mut found = vec![FoundExposure::stated(1.0); frames.len()];
    for ((i, stated), (delta, variance)) in order.iter().zip(stated).zip(chain) {
        found[*i] = FoundExposure::new(stated, delta - usual, variance.sqrt() / LN_2);
    }
    // With two, either could be the wrong one.
    if frames.len() < 3 {
        found.iter_mut().for_each(|f| f.used = f.stated);
    }
    found
}

/// ln of the ratio of two frames' exposures, and its standard error.
fn between(a: &Sampled, b: &Sampled, response: &Response) -> Option<(f64, f64)> {
    let mut ratios = Vec::new();
    for (channel, curve) in response.curves.iter().enumerate() {
        let (low, high) = (curve.floor + 0.08, curve.clip - 0.03);
        for (p, q) in a.readings[channel].iter().zip(&b.readings[channel]) {
            let codes = [p, q].map(|r| (r.mean / super::TOP) as f32);
            let held = |r: &super::samples::Reading| {
                (r.low / super::TOP) as f32 > low && ((r.high / super::TOP) as f32) < high
            };
            if held(p) && held(q) {
                ratios.push(
                    f64::from(curve.exposure_of(codes[1])).ln() - f64::from(curve.exposure_of(codes[0])).ln(),
                );
            }
        }
    }
    if ratios.len() < NEEDED {
        return None;
    }
    let middle = median(ratios.iter().copied())?;
    let spread = 1.4826 * median(ratios.iter().map(|r| (r - middle).abs()))?;
    Some((middle, 1.25 * spread / (ratios.len() as f64).sqrt()))
}

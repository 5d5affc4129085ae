//! From frames to a response: places are read, exposures checked against the pixels, a method chosen and fitted channel
//! by channel, and its band found.

use super::debevec_malik::{self, Solver};
use super::exposures::{self, FoundExposure};
use super::mitsunaga_nayar;
use super::monotone;
use super::observations::{Observation, Observations};
use super::robertson;
use super::samples::{Channel, Reading, Sampled, median};
use super::{Curve, LEVELS, LN_2, Problem, Quality, Response, TOP};
use crate::config::{self, ResponseMethod};
use crate::exposure::Frame;
use rand::{Rng, SeedableRng, rngs::SmallRng};
use rayon::prelude::*;

/// Fewer places than this determine nothing.
const FEWEST: usize = 30;
/// Largest standard error that is taken for an answer, stops, from the 10 % to the 90 % level.
const WORST_STOPS: f64 = 0.5;
/// Parts of the places that are left out in turn to judge a method.
const FOLDS: usize = 4;
/// Resamplings of the places for the band.
const RESAMPLINGS: usize = 20;
/// Another method than the first must leave less than this share of its residual: above that it is chance.
const CLEARLY: f64 = 0.9;

/// Fits the response to frames of one view. Frames may come in any order; equal exposures count once more each.
pub fn fit(frames: &[Frame], settings: &config::Response) -> Result<Response, Problem> {
    let sampled = frames.par_iter().map(Sampled::new).collect::<Result<Vec<_>, _>>();
    fit_sampled(&sampled.map_err(|e| Problem::Read { why: e.to_string() })?, settings)
}

/// The same for frames that have been read already.
pub fn fit_sampled(frames: &[Sampled], settings: &config::Response) -> Result<Response, Problem> {
    let mut order: Vec<usize> = (0..frames.len()).collect();
    for (i, frame) in frames.iter().enumerate() {
        if frame.size != frames[0].size {
            return Err(Problem::Sizes { frame: i + 1, size: frame.size, first: frames[0].size });
        }
        if !(frame.exposure.is_finite() && frame.exposure > 0.0) {
            return Err(Problem::Exposure { frame: i + 1, exposure: frame.exposure });
        }
    }
    order.sort_by(|a, b| frames[*a].exposure.total_cmp(&frames[*b].exposure));
    let sorted: Vec<&Sampled> = order.iter().map(|i| &frames[*i]).collect();
    let distinct = sorted.windows(2).filter(|w| w[1].exposure > 1.01 * w[0].exposure).count() + 1;
    if distinct < 2 || sorted.is_empty() {
        return Err(Problem::OneExposure { frames: frames.len(), distinct: distinct.min(frames.len()) });
    }
    let channels = [0, 1, 2].map(|c| Channel::new(&sorted, c));
    let stated: Vec<f64> = sorted.iter().map(|f| f.exposure).collect();
    let seen = observe(&channels, &stated, settings)?;
    let found = if settings.exposures_from_pixels {
        exposures::find(&channels, &seen, &stated, settings.smoothness)
    } else {
        stated.iter().map(|e| FoundExposure::stated(*e)).collect()
    };
    let used: Vec<f64> = found.iter().map(|f| f.used).collect();
    let seen = if used == stated { seen } else { observe(&channels, &used, settings)? };

    let bases = (0..3).into_par_iter().map(|c| Base::new(c, &channels[c], &seen[c], settings));
    let bases = bases.collect::<Vec<_>>().into_iter().collect::<Result<Vec<_>, _>>()?;
    let (method, held_out_stops) = choose(&bases, settings);
    let fits: Vec<ChannelFit> =
        bases.par_iter().map(|base| ChannelFit::new(base, method, settings)).collect();
    let mut exposures = vec![FoundExposure::stated(1.0); frames.len()];
    let mut frame_stops = vec![0.0; frames.len()];
    for (place, i) in order.iter().enumerate() {
        exposures[*i] = found[place].clone();
        frame_stops[*i] = fits[1].frame_stops[place];
    }
    let quality = Quality {
        samples: [0, 1, 2].map(|c: usize| seen[c].places),
        rms_stops: [0, 1, 2].map(|c: usize| fits[c].rms_stops),
        held_out_stops,
        frame_stops,
        condition: bases.iter().map(|b| b.condition).fold(0.0, f64::max),
    };
    let mut curves = fits.into_iter().map(|f| f.curve);
    let curves = [curves.next(), curves.next(), curves.next()].map(Option::unwrap_or_default);
    Ok(Response {
        curves,
        assumed: false,
        method: Some(method),
        quality: Some(quality),
        exposures,
        vignetting: None,
    })
}

/// Rms residual of given curves (relative exposure at each level, per channel) at the places that [`fit`] would choose,
/// stops.
pub fn residual_stops(
    frames: &[Frame],
    curves: &[Vec<f64>; 3],
    settings: &config::Response,
) -> Result<[f64; 3], Problem> {
    let sampled = frames.par_iter().map(Sampled::new).collect::<Result<Vec<_>, _>>();
    let mut sampled = sampled.map_err(|e| Problem::Read { why: e.to_string() })?;
    sampled.sort_by(|a, b| a.exposure.total_cmp(&b.exposure));
    let sorted: Vec<&Sampled> = sampled.iter().collect();
    let channels = [0, 1, 2].map(|c| Channel::new(&sorted, c));
    let exposures: Vec<f64> = sorted.iter().map(|f| f.exposure).collect();
    let seen = observe(&channels, &exposures, settings)?;
    Ok([0, 1, 2].map(|c: usize| {
        let g: Vec<f64> = curves[c].iter().map(|e| e.max(1e-12).ln()).collect();
        seen[c].rms_stops(&g)
    }))
}

/// Chooses places in each channel and takes down what they show.
fn observe(
    channels: &[Channel; 3],
    exposures: &[f64],
    settings: &config::Response,
) -> Result<[Observations; 3], Problem> {
    let of = |channel: usize| {
        let readings = &channels[channel];
        let chosen = readings.choose(exposures, settings.samples.max(FEWEST), settings.seed);
        if chosen.len() < FEWEST {
            return Err(too_few(readings, channel, chosen.len()));
        }
        Ok(Observations::new(readings, &chosen, exposures))
    };
    Ok([of(0)?, of(1)?, of(2)?])
}

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

/// A channel with its outliers known: least squares, whatever the method, tell them, and how well levels are determined.
struct Base<'a> {
    readings: &'a Channel,
    solver: Solver,
    observations: Observations,
    least_squares: Vec<f64>,
    formal: Vec<f64>,
    condition: f64,
}

impl<'a> Base<'a> {
    fn new(
        channel: usize,
        readings: &'a Channel,
        seen: &Observations,
        settings: &config::Response,
    ) -> Result<Self, Problem> {
        let mut observations = seen.clone();
        let solver = Solver::new(readings, settings.smoothness);
        let solution = debevec_malik::fit(&solver, &mut observations);
        let condition = solution.condition();
        let formal = solution.standard_errors();
        determined(channel, readings, &formal, condition)?;
        Ok(Self { readings, solver, observations, least_squares: solution.g, formal, condition })
    }

    /// ln exposure by a method from some of the observations, made to rise.
    fn curve(&self, method: ResponseMethod, observations: &Observations) -> Vec<f64> {
        let mut g = match method {
            ResponseMethod::Auto | ResponseMethod::DebevecMalik => self.solver.solve(observations, None).g,
            ResponseMethod::MitsunagaNayar => {
                let polynomial = mitsunaga_nayar::fit(self.readings, observations);
                polynomial.unwrap_or_else(|| self.least_squares.clone())
            }
            ResponseMethod::Robertson => robertson::fit(&self.solver.typical, observations),
        };
        monotone::project(&mut g, &level_weights(observations));
        g
    }

    /// Residuals on places of parts of the image that were left out of the fit in turn: rms, stops, and the typical one in
    /// levels, in which a curve gains nothing by being flat where noise is strong.
    fn held_out(&self, method: ResponseMethod) -> [f64; 2] {
        let folds = (0..FOLDS).into_par_iter().map(|fold| {
            let kept = self.observations.only(|p| p % FOLDS != fold);
            let left_out = self.observations.only(|p| p % FOLDS == fold);
            let g = self.curve(method, &kept);
            let slope = |o: &Observation| (g[o.level + 1] - g[o.level]).max(monotone::LEAST_STEP);
            let sizes = left_out.list.iter().zip(left_out.residuals(&g)).map(|(o, r)| r.abs() / slope(o));
            let typical = 1.4826 * median(sizes).unwrap_or(0.0);
            [left_out.rms_stops(&g).powi(2) / FOLDS as f64, typical.powi(2) / FOLDS as f64]
        });
        folds.reduce(|| [0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]).map(f64::sqrt)
    }
}

/// How much is seen of each level.
fn level_weights(observations: &Observations) -> Vec<f64> {
    let mut weights = vec![1e-6; LEVELS];
    for o in &observations.list {
        weights[o.level] += o.weight * o.trust * (1.0 - o.share);
        weights[o.level + 1] += o.weight * o.trust * o.share;
    }
    weights
}

/// The method that leaves the least typical residual, over all channels, on places that it was not fitted to; and the rms
/// of that residual.
fn choose(bases: &[Base], settings: &config::Response) -> (ResponseMethod, [f64; 3]) {
    let methods = match settings.method {
        ResponseMethod::Auto => ResponseMethod::ALL.to_vec(),
        one => vec![one],
    };
    let left = methods.iter().map(|m| (*m, bases.iter().map(|b| b.held_out(*m)).collect::<Vec<_>>()));
    let left: Vec<(ResponseMethod, Vec<[f64; 2]>)> = left.collect();
    let size = |stops: &[[f64; 2]]| stops.iter().map(|s| s[1] * s[1]).sum::<f64>().sqrt();
    let mut best = &left[0];
    for other in &left[1..] {
        if size(&other.1) < CLEARLY * size(&best.1) {
            best = other;
        }
    }
    (best.0, [0, 1, 2].map(|c: usize| best.1[c][0]))
}

struct ChannelFit {
    curve: Curve,
    rms_stops: f64,
    frame_stops: Vec<f64>,
}

impl ChannelFit {
    fn new(base: &Base, method: ResponseMethod, settings: &config::Response) -> Self {
        let Base { readings, observations, formal, .. } = base;
        let pinned = readings.clip as usize;
        let g = from_saturation(base.curve(method, observations), pinned);
        let band = resampled(base, method, settings, pinned);
        let curve = Curve {
            exposure: g.iter().map(|g| g.exp()).collect(),
            standard_error: formal.iter().zip(&band).take(LEVELS).map(|(a, b)| a.max(*b)).collect(),
            floor: (readings.floor / TOP) as f32,
            clip: (readings.clip / TOP) as f32,
        };
        Self { curve, rms_stops: observations.rms_stops(&g), frame_stops: observations.frame_stops(&g) }
    }
}

/// ln exposure against that of saturation.
fn from_saturation(mut g: Vec<f64>, pinned: usize) -> Vec<f64> {
    let zero = g[pinned];
    g.iter_mut().for_each(|g| *g -= zero);
    g
}

/// Standard deviation of ln exposure at all levels, over fits to places drawn with replacement (Efron 1979).
fn resampled(base: &Base, method: ResponseMethod, settings: &config::Response, pinned: usize) -> Vec<f64> {
    let places = base.observations.places;
    let draw = |seed: u64| {
        let mut random = SmallRng::seed_from_u64(settings.seed.wrapping_mul(1000).wrapping_add(seed));
        let mut times = vec![0; places];
        (0..places).for_each(|_| times[random.random_range(0..places)] += 1);
        from_saturation(base.curve(method, &base.observations.repeated(&times)), pinned)
    };
    let curves: Vec<Vec<f64>> = (0..RESAMPLINGS as u64).into_par_iter().map(draw).collect();
    let deviation = |k: usize| {
        let mean = curves.iter().map(|c| c[k]).sum::<f64>() / RESAMPLINGS as f64;
        let square: f64 = curves.iter().map(|c| (c[k] - mean).powi(2)).sum();
        (square / (RESAMPLINGS - 1) as f64).sqrt()
    };
    (0..LEVELS).map(deviation).collect()
}

fn determined(channel: usize, readings: &Channel, errors: &[f64], condition: f64) -> Result<(), Problem> {
    let span = readings.clip - readings.lowest;
    let (low, high) = (readings.lowest + 0.1 * span, readings.lowest + 0.9 * span);
    let worst = (low as usize..high as usize).map(|k| (errors[k] / LN_2, k));
    match worst.max_by(|a, b| a.0.total_cmp(&b.0)) {
        Some((stops, level)) if stops.is_nan() || stops > WORST_STOPS => {
            Err(Problem::Undetermined { channel, level, stops, limit: WORST_STOPS, condition })
        }
        _ => Ok(()),
    }
}

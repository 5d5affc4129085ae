//! The iteration of Robertson, Borman and Stevenson, *Estimation-theoretic approach to dynamic range enhancement using
//! multiple exposures* (J. Electronic Imaging 2003): in turn the radiance of each place from the curve (eq. 10), and
//! the curve's value at each code as the mean exposure of what shows it (eq. 13), from a typical curve on.

use super::LEVELS;
use super::observations::Observations;

/// Iterations at most, and the change of ln exposure below which they end.
const MOST: usize = 100;
const SETTLED: f64 = 1e-4;

/// Fits ln exposure at all levels, from `start` on; levels that no place shows lie between those beside them.
pub(super) fn fit(start: &[f64], observations: &Observations) -> Vec<f64> {
    let mut f: Vec<f64> = start.iter().map(|g| g.exp()).collect();
    for _ in 0..MOST {
        let (mut sums, mut weights) = (vec![0.0; LEVELS], vec![0.0; LEVELS]);
        for place in observations.list.chunk_by(|a, b| a.place == b.place) {
            let (mut light, mut sum) = (0.0, 0.0);
            for o in place {
                let t = o.ln_exposure.exp();
                // Divided by the squared exposure: errors are relative ones.
                let w = o.weight * o.trust / o.of(&f).powi(2).max(1e-20);
                light += w * t * o.of(&f);
                sum += w * t * t;
            }
            for o in place {
                // What the curve lacks at this code, shared by the two levels beside it.
                let ratio = o.ln_exposure.exp() * light / sum.max(1e-300) / o.of(&f);
                for (level, share) in [(o.level, 1.0 - o.share), (o.level + 1, o.share)] {
                    sums[level] += share * o.weight * o.trust * ratio.ln();
                    weights[level] += share * o.weight * o.trust;
                }
            }
        }
        let mut change = 0.0_f64;
        let steps: Vec<Option<f64>> =
            sums.iter().zip(&weights).map(|(s, w)| (*w > 1e-9).then(|| s / w)).collect();
        for (f, step) in f.iter_mut().zip(between(&steps)) {
            *f *= step.exp();
            change = change.max(step.abs());
        }
        if change < SETTLED {
            break;
        }
    }
    f.iter().map(|f| f.ln()).collect()
}

/// Fills gaps by straight lines, ends by their neighbours.
fn between(steps: &[Option<f64>]) -> Vec<f64> {
    let known: Vec<(usize, f64)> = steps.iter().enumerate().filter_map(|(k, s)| Some((k, (*s)?))).collect();
    let at = |k: usize| {
        let above = known.partition_point(|(i, _)| *i < k);
        match (above.checked_sub(1).and_then(|i| known.get(i)), known.get(above)) {
            (Some((i, a)), Some((j, b))) => a + (b - a) * (k - i) as f64 / (j - i) as f64,
            (Some((_, a)), None) | (None, Some((_, a))) => *a,
            (None, None) => 0.0,
        }
    };
    (0..steps.len()).map(at).collect()
}

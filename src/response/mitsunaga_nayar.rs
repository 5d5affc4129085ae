//! The polynomial of Mitsunaga and Nayar, *Radiometric Self Calibration* (CVPR 1999): exposure is a polynomial of the
//! code, 1 at saturation, whose coefficients make f(Z_q) = R f(Z_q') for a place seen in two frames with exposures in
//! the ratio R (eq. 8).
//!
//! Departures: the ratios are taken as known (they are found apart, [`super::exposures`]); each equation is divided by
//! its exposure, so that dark and bright places count alike; the polynomial is one of the code less the black level and
//! has no constant; the order is the one with the least error on places left out.

use super::LEVELS;
use super::observations::{Observation, Observations};
use super::samples::Channel;
use nalgebra::{DMatrix, DVector};

/// Largest order, as in the paper.
const HIGHEST: usize = 10;
/// Rounds of dividing by the exposure.
const ROUNDS: usize = 4;

/// Fits ln exposure at all levels.
pub(super) fn fit(readings: &Channel, observations: &Observations) -> Option<Vec<f64>> {
    let (kept, left_out) = (observations.only(|p| p % 4 != 0), observations.only(|p| p % 4 == 0));
    let tried = (1..=HIGHEST).filter_map(|order| {
        let g = polynomial(readings, &kept, order)?;
        let error = left_out.rms_stops(&g);
        error.is_finite().then_some((error, order))
    });
    let (_, order) = tried.min_by(|a, b| a.0.total_cmp(&b.0))?;
    polynomial(readings, observations, order)
}

fn polynomial(readings: &Channel, observations: &Observations, order: usize) -> Option<Vec<f64>> {
    let unit = |level: f64| (level - readings.floor) / (readings.clip - readings.floor);
    let code = |o: &Observation| unit(o.level as f64 + o.share);
    // The coefficient of the highest power is 1 less all others: f(1) = 1.
    let basis = |u: f64| -> (Vec<f64>, f64) {
        let top = u.powi(order as i32);
        ((1..order).map(|n| u.powi(n as i32) - top).collect(), top)
    };
    let mut c = DVector::zeros(order - 1);
    let value = |c: &DVector<f64>, u: f64| {
        let (b, top) = basis(u);
        b.iter().zip(c.iter()).map(|(b, c)| b * c).sum::<f64>() + top
    };
    for round in 0..ROUNDS {
        let mut normal = DMatrix::<f64>::zeros(order - 1, order - 1);
        let mut right = DVector::<f64>::zeros(order - 1);
        for place in observations.list.chunk_by(|a, b| a.place == b.place) {
            for pair in place.windows(2) {
                let (a, b) = (code(&pair[0]), code(&pair[1]));
                let ratio = (pair[0].ln_exposure - pair[1].ln_exposure).exp();
                let ((row_a, top_a), (row_b, top_b)) = (basis(a), basis(b));
                // At first as if the camera had a gamma of 2.
                let size = if round == 0 { a * a } else { value(&c, a).abs() };
                let weight = pair[0].weight.min(pair[1].weight) / size.max(1e-4).powi(2);
                let row: Vec<f64> = row_a.iter().zip(&row_b).map(|(p, q)| p - ratio * q).collect();
                let target = ratio * top_b - top_a;
                for (i, p) in row.iter().enumerate() {
                    row.iter().enumerate().for_each(|(j, q)| normal[(i, j)] += weight * p * q);
                    right[i] += weight * p * target;
                }
            }
        }
        if order == 1 {
            break;
        }
        let ridge = 1e-12 * normal.trace().max(1e-300);
        (0..order - 1).for_each(|i| normal[(i, i)] += ridge);
        c = normal.cholesky()?.solve(&right);
    }
    let least = 1e-3 / LEVELS as f64;
    let exposure = |level: usize| value(&c, unit(level as f64)).max(least * unit(level as f64).max(1e-3));
    Some((0..LEVELS).map(|z| exposure(z).ln()).collect())
}

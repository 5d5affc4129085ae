//! From a good start to the minimum nearby, as fast as it goes and without a verdict: Levenberg and Marquardt on the normal
//! equations, which are solved by a skyline Cholesky factorisation (George and Liu 1981, §4).

use super::Residuals;
use nalgebra::{DMatrix, DVector};

/// JᵀJ, Jᵀr and ‖r‖².
#[derive(Debug, Clone)]
pub struct NormalEquations {
    hessian: DMatrix<f64>,
    gradient: DVector<f64>,
    cost: f64,
}

impl NormalEquations {
    /// Those of no residuals, for `n` parameters.
    pub fn zero(n: usize) -> Self {
        Self { hessian: DMatrix::zeros(n, n), gradient: DVector::zeros(n), cost: 0.0 }
    }

    /// Adds residuals whose derivatives by all but some parameters, in rising order, are 0.
    pub fn add(&mut self, residuals: &DVector<f64>, derivatives: &DMatrix<f64>, columns: &[usize]) {
        let (gradient, hessian) = (derivatives.tr_mul(residuals), derivatives.tr_mul(derivatives));
        for (a, &i) in columns.iter().enumerate() {
            self.gradient[i] += gradient[a];
            // The lower half serves.
            columns[..=a].iter().enumerate().for_each(|(b, &j)| self.hessian[(i, j)] += hessian[(a, b)]);
        }
        self.cost += residuals.norm_squared();
    }

    /// −(JᵀJ + λ diag JᵀJ)⁻¹ Jᵀr; `None` where that is singular.
    fn step(&self, damping: f64) -> Option<DVector<f64>> {
        let mut damped = self.hessian.clone();
        let largest = damped.diagonal().max();
        for k in 0..damped.nrows() {
            damped[(k, k)] += damping * damped[(k, k)].max(1e-12 * largest);
        }
        solve(&damped, &-&self.gradient)
    }
}

/// Solves a symmetric positive definite system given by its lower half. Zeros before the first entry of a row stay zeros, and
/// cost nothing.
fn solve(matrix: &DMatrix<f64>, right: &DVector<f64>) -> Option<DVector<f64>> {
    let n = matrix.nrows();
    let first = |i: usize| (0..i).find(|&j| matrix[(i, j)] != 0.0).unwrap_or(i);
    let starts: Vec<usize> = (0..n).map(first).collect();
    // Row by row, from its first entry to the diagonal.
    let mut rows: Vec<Vec<f64>> = Vec::with_capacity(n);
    for i in 0..n {
        let from = starts[i];
        let mut row = Vec::with_capacity(i + 1 - from);
        for j in from..i {
            let begin = from.max(starts[j]);
            let known = &row[begin - from..];
            let other: &[f64] = &rows[j][begin - starts[j]..];
            let sum: f64 = known.iter().zip(other).map(|(a, b)| a * b).sum();
            let diagonal = rows[j][j - starts[j]];
            row.push((matrix[(i, j)] - sum) / diagonal);
        }
        let square = matrix[(i, i)] - row.iter().map(|v| v * v).sum::<f64>();
        if square.is_nan() || square <= 0.0 {
            return None;
        }
        row.push(square.sqrt());
        rows.push(row);
    }
    let mut x = right.clone();
    for i in 0..n {
        let (row, from) = (&rows[i], starts[i]);
        let sum: f64 = row[..i - from].iter().zip(&x.as_slice()[from..i]).map(|(a, b)| a * b).sum();
        x[i] = (x[i] - sum) / row[i - from];
    }
    for i in (0..n).rev() {
        let (row, from) = (&rows[i], starts[i]);
        x[i] /= row[i - from];
        for (k, a) in row[..i - from].iter().enumerate() {
            let xi = x[i];
            x[from + k] -= a * xi;
        }
    }
    Some(x)
}

/// A step that gains less than this share of the cost is the last.
const LEAST_GAIN: f64 = 1e-6;
/// Damping at the start, and its bounds.
const DAMPING: [f64; 3] = [1e-6, 1e-12, 1e8];

/// Parameters of a minimum near `x`, after at most `steps` steps, and its cost ‖r‖²; `None` where the residuals cannot be
/// computed at `x`.
pub fn descend(model: &impl Residuals, mut x: DVector<f64>, steps: usize) -> Option<(DVector<f64>, f64)> {
    let [mut damping, least, most] = DAMPING;
    let mut equations = model.normal_equations(&x)?;
    if !equations.cost.is_finite() {
        return None;
    }
    for _ in 0..steps {
        let cost = equations.cost;
        let mut moved = None;
        while damping <= most {
            if let Some(step) = equations.step(damping) {
                let there = &x + &step;
                let after = model.residuals(&there).map(|r| r.norm_squared()).filter(|c| c.is_finite());
                if let Some(after) = after.filter(|after| *after <= cost) {
                    moved = Some((there, after));
                    break;
                }
            }
            damping *= 10.0;
        }
        let Some((there, after)) = moved else { break };
        x = there;
        damping = (damping / 10.0).max(least);
        if cost - after <= LEAST_GAIN * cost {
            return Some((x, after));
        }
        equations = model.normal_equations(&x)?;
    }
    let cost = equations.cost;
    Some((x, cost))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn it_finds_rosenbrocks_minimum() {
        let f = |x: &DVector<f64>| Some(DVector::from_vec(vec![10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]]));
        let (x, cost) = descend(&f, DVector::from_vec(vec![-1.2, 1.0]), 100).unwrap();
        assert!((x[0] - 1.0).abs() < 1e-4 && (x[1] - 1.0).abs() < 1e-4 && cost < 1e-8, "{x} {cost}");
    }

    proptest! {
        #[test]
        fn a_skyline_is_solved_as_a_full_matrix_is(
            entries in prop::collection::vec(-1.0..1.0f64, 64), mask in prop::collection::vec(prop::bool::ANY, 64),
            right in prop::collection::vec(-1.0..1.0f64, 8),
        ) {
            let a = DMatrix::from_fn(8, 8, |i, j| {
                let keep = i == j || mask[8 * i + j];
                if keep { entries[8 * i + j] + 2.0 * f64::from(i == j) } else { 0.0 }
            });
            let spd = &a * a.transpose() + DMatrix::identity(8, 8) * 0.1;
            let right = DVector::from_vec(right);
            let found = solve(&spd, &right).unwrap();
            prop_assert!((&spd * found - right).norm() < 1e-6);
        }
    }

    #[test]
    fn what_is_not_positive_definite_is_none() {
        let m = DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 1.0]);
        assert!(solve(&m, &DVector::zeros(2)).is_none());
    }
}

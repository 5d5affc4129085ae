//! Non-linear least squares: argmin's trust region on the Gauss–Newton model of the cost ½‖r(x)‖², with scaled
//! parameters, an optional robust loss, and a verdict on what the data determine.

mod descent;
mod trust_region;

pub use descent::{NormalEquations, descend};

use argmin::core::Executor;
use argmin::solver::trustregion::TrustRegion;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use trust_region::{ExactStep, Run, step_within};

/// What is to be fitted: residuals as a function of the parameters.
pub trait Residuals {
    /// Residuals at `x`; `None` where they cannot be computed (e.g. a point behind the camera), which a step then
    /// avoids.
    fn residuals(&self, x: &DVector<f64>) -> Option<DVector<f64>>;

    /// Derivatives of the residuals (rows) by the parameters (columns); by central differences unless given.
    fn jacobian(&self, x: &DVector<f64>) -> Option<DMatrix<f64>> {
        let mut columns = Vec::with_capacity(x.len());
        let mut y = x.clone();
        for k in 0..x.len() {
            // The cube root of the precision balances truncation and rounding.
            let h = f64::EPSILON.cbrt() * x[k].abs().max(1.0);
            y[k] = x[k] + h;
            let up = self.residuals(&y)?;
            y[k] = x[k] - h;
            let down = self.residuals(&y)?;
            y[k] = x[k];
            columns.push((up - down) / (2.0 * h));
        }
        Some(DMatrix::from_columns(&columns))
    }

    /// The normal equations at `x`; from the whole Jacobian unless the model knows which residuals each parameter moves.
    fn normal_equations(&self, x: &DVector<f64>) -> Option<NormalEquations> {
        let mut equations = NormalEquations::zero(x.len());
        let columns: Vec<usize> = (0..x.len()).collect();
        equations.add(&self.residuals(x)?, &self.jacobian(x)?, &columns);
        Some(equations)
    }
}

impl<F: Fn(&DVector<f64>) -> Option<DVector<f64>>> Residuals for F {
    fn residuals(&self, x: &DVector<f64>) -> Option<DVector<f64>> {
        self(x)
    }
}

/// How a residual counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// By its square.
    Squares,
    /// By its square up to the threshold, linearly beyond (Huber 1964); iteratively reweighted.
    Huber(f64),
}

impl Loss {
    /// The weight of a residual, in units of its standard deviation.
    pub fn weight(self, residual: f64) -> f64 {
        match self {
            Self::Huber(threshold) if residual.abs() > threshold => threshold / residual.abs(),
            _ => 1.0,
        }
    }
}

/// The result of a fit.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The parameters.
    pub parameters: DVector<f64>,
    /// Their covariance, (JᵀJ)⁻¹ σ² with σ² from the residuals; σ = 1 where there are no more residuals than parameters.
    pub covariance: DMatrix<f64>,
    /// The variance of a residual of unit weight that stands in the covariance.
    pub variance: f64,
    /// By how much each parameter (row) moves for a change of each residual (column): −(JᵀJ)⁻¹Jᵀ.
    pub gain: DMatrix<f64>,
    /// Residuals at the parameters, not weighted.
    pub residuals: DVector<f64>,
    /// Root mean square of the residuals.
    pub rms: f64,
    /// Condition number of the Jacobian with its columns scaled to unit length.
    pub condition: f64,
}

impl Fit {
    /// Standard deviation of parameter `k`.
    pub fn sigma(&self, k: usize) -> f64 {
        self.covariance[(k, k)].max(0.0).sqrt()
    }

    /// Sum of squared residuals.
    pub fn cost(&self) -> f64 {
        self.residuals.norm_squared()
    }
}

/// Why a fit cannot be trusted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// No residuals at the start.
    #[error("the fit cannot start: the first guess is outside the model's range")]
    Start,
    /// Still moving at the end.
    #[error("the fit has not converged after {iterations} iterations (rms {rms:.3}, next step {step:.1e} σ)")]
    NotConverged {
        /// Trust-region iterations.
        iterations: usize,
        /// Rms of the residuals reached.
        rms: f64,
        /// Length of the next Gauss–Newton step in standard deviations.
        step: f64,
    },
    /// Directions in parameter space do not change the residuals.
    #[error("the data do not determine {} (condition number {condition:.1e})", listed(parameters))]
    Undetermined {
        /// The parameters that take part in such a direction.
        parameters: Vec<String>,
        /// Condition number of the scaled Jacobian.
        condition: f64,
    },
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::Start => "check the marks for mistakes",
            Self::NotConverged { .. } => "check the marks for mistakes, or add some",
            Self::Undetermined { .. } => "add marks that determine it, or give its value",
        }
        .into()
    }
}

/// Names of the parameters, the last three of more as their number.
fn listed(names: &[String]) -> String {
    const SHOWN: usize = 6;
    match names {
        [] => "the parameters".into(),
        [one] => one.clone(),
        [all @ .., last] if all.len() < SHOWN => format!("{} and {last}", all.join(", ")),
        all => format!("{} and {} more", all[..SHOWN].join(", "), all.len() - SHOWN),
    }
}

/// Condition numbers from here on are rounding.
const MEANS_NOTHING: f64 = 1e10;
/// A parameter takes part in an undetermined direction from this share of the largest part on.
const PART: f64 = 0.2;

/// Condition number of the scaled Jacobian from which on a fit is refused. Central differences have a relative error of
/// some 1e-10, so that anything above 1e7 could be zero.
const MAX_CONDITION: f64 = 1e6;
/// Iterations of one trust-region run; scales and weights are refreshed between runs.
const RUN: u64 = 4;
const MAX_RUNS: usize = 60;
/// A fit has converged when the next step is shorter than this, in standard deviations.
const STEP_SIGMA: f64 = 1e-4;

/// Fits parameters from `start`. `names` are for messages.
pub fn minimise(model: &impl Residuals, names: &[String], start: &[f64], loss: Loss) -> Result<Fit, Problem> {
    let mut x = DVector::from_column_slice(start);
    let mut step = f64::INFINITY;
    for _ in 0..MAX_RUNS {
        let r = model.residuals(&x).filter(finite).ok_or(Problem::Start)?;
        if x.is_empty() || r.is_empty() {
            return finish(model, names, x, r, loss);
        }
        let weights = r.map(|r| loss.weight(r).sqrt());
        let j = weighted(&model.jacobian(&x).ok_or(Problem::Start)?, &weights);
        let scale = column_scale(&j);
        let js = scaled(&j, &scale);
        let rw = r.component_mul(&weights);
        let (gradient, hessian) = (js.tr_mul(&rw), js.tr_mul(&js));
        let newton = step_within(&gradient, &hessian, f64::INFINITY);
        let sigma2 = rw.norm_squared() / r.len().saturating_sub(x.len()).max(1) as f64;
        // Predicted gain in units of σ²/2: the squared length of the step in standard deviations.
        step = (-gradient.dot(&newton) / sigma2.max(f64::MIN_POSITIVE)).max(0.0).sqrt();
        let exact = rw.norm_squared() < 1e-24 * r.len() as f64;
        if step < STEP_SIGMA || exact {
            return finish(model, names, x, r, loss);
        }
        // The step becomes the unit of length, so that the radius starts at 1.
        let unit = &scale * newton.norm();
        let run = Run { model, weights: &weights, origin: &x, unit: &unit };
        let solver =
            TrustRegion::new(ExactStep::default()).with_max_radius(1e6).map_err(|_| Problem::Start)?;
        let outcome = Executor::new(run, solver)
            .configure(|state| state.param(DVector::zeros(x.len())).max_iters(RUN))
            .ctrlc(false)
            .run();
        let moved = outcome.ok().and_then(|mut o| o.state.take_best_param()).ok_or(Problem::Start)?;
        x += moved.component_mul(&unit);
    }
    let r = model.residuals(&x).ok_or(Problem::Start)?;
    finish(model, names, x, r.clone(), loss)?;
    Err(Problem::NotConverged { iterations: MAX_RUNS * RUN as usize, rms: rms(&r), step })
}

fn finish(
    model: &impl Residuals,
    names: &[String],
    parameters: DVector<f64>,
    residuals: DVector<f64>,
    loss: Loss,
) -> Result<Fit, Problem> {
    let n = parameters.len();
    let rms = rms(&residuals);
    if n == 0 {
        let (covariance, gain) = (DMatrix::zeros(0, 0), DMatrix::zeros(0, residuals.len()));
        return Ok(Fit { parameters, covariance, variance: 1.0, gain, residuals, rms, condition: 1.0 });
    }
    let name = |k: usize| names.get(k).cloned().unwrap_or_else(|| format!("parameter {k}"));
    if residuals.is_empty() {
        let parameters = (0..n).map(name).collect();
        return Err(Problem::Undetermined { parameters, condition: f64::INFINITY });
    }
    let weights = residuals.map(|r| loss.weight(r).sqrt());
    let j = weighted(&model.jacobian(&parameters).filter(finite_matrix).ok_or(Problem::Start)?, &weights);
    let scale = column_scale(&j);
    let js = scaled(&j, &scale);
    let (eigen, condition) = determined(&js, MAX_CONDITION, &name)?;
    let freedom = residuals.len() - n.min(residuals.len());
    let squares = residuals.component_mul(&weights).norm_squared();
    let variance = if freedom > 0 { squares / freedom as f64 } else { 1.0 };
    let inverse = &eigen.eigenvectors
        * DMatrix::from_diagonal(&eigen.eigenvalues.map(|l| 1.0 / l))
        * eigen.eigenvectors.transpose();
    let covariance = DMatrix::from_fn(n, n, |a, b| inverse[(a, b)] * scale[a] * scale[b] * variance);
    let mut gain = -(&inverse * js.transpose());
    gain.row_iter_mut().zip(scale.iter()).for_each(|(mut row, s)| row *= *s);
    gain.column_iter_mut().zip(weights.iter()).for_each(|(mut column, w)| column *= *w);
    Ok(Fit { parameters, covariance, variance, gain, residuals, rms, condition })
}

/// The eigenvalues of JᵀJ for derivatives by parameters (columns), scaled to unit length, and their condition number; above
/// `most` what the data do not determine is named.
pub(crate) fn determined(
    derivatives: &DMatrix<f64>,
    most: f64,
    name: &impl Fn(usize) -> String,
) -> Result<(SymmetricEigen<f64, nalgebra::Dyn>, f64), Problem> {
    let n = derivatives.ncols();
    let js = scaled(derivatives, &column_scale(derivatives));
    let eigen = SymmetricEigen::new(js.tr_mul(&js));
    let largest = eigen.eigenvalues.max();
    let condition_of = |l: f64| (largest / l.max(0.0)).sqrt();
    let condition = condition_of(eigen.eigenvalues.min());
    if condition.is_finite() && condition <= most {
        return Ok((eigen, condition));
    }
    // Per parameter its part in the null space.
    let weak = |k: &usize| eigen.eigenvalues[*k].is_nan() || condition_of(eigen.eigenvalues[*k]) > most;
    let columns: Vec<usize> = (0..n).filter(weak).collect();
    let part = |k: usize| columns.iter().map(|&c| eigen.eigenvectors[(k, c)].powi(2)).sum::<f64>();
    let parts: Vec<f64> = (0..n).map(|k| part(k).sqrt()).collect();
    let largest = parts.iter().copied().fold(0.0, f64::max);
    let taking = (0..n).filter(|&k| parts[k] >= PART * largest);
    // Rounding alone makes it finite.
    let condition = if condition < MEANS_NOTHING { condition } else { f64::INFINITY };
    Err(Problem::Undetermined { parameters: taking.map(name).collect(), condition })
}

fn rms(r: &DVector<f64>) -> f64 {
    (r.norm_squared() / r.len().max(1) as f64).sqrt()
}

fn finite(r: &DVector<f64>) -> bool {
    r.iter().all(|v| v.is_finite())
}

fn finite_matrix(j: &DMatrix<f64>) -> bool {
    j.iter().all(|v| v.is_finite())
}

fn weighted(j: &DMatrix<f64>, weights: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(j.nrows(), j.ncols(), |i, k| j[(i, k)] * weights[i])
}

/// Per parameter the change that alters the residual vector by 1; 1 where it has no effect.
fn column_scale(j: &DMatrix<f64>) -> DVector<f64> {
    DVector::from_iterator(
        j.ncols(),
        j.column_iter().map(|c| if c.norm() > 1e-12 { 1.0 / c.norm() } else { 1.0 }),
    )
}

fn scaled(j: &DMatrix<f64>, scale: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(j.nrows(), j.ncols(), |i, k| j[(i, k)] * scale[k])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(n: usize) -> Vec<String> {
        (0..n).map(|k| format!("p{k}")).collect()
    }

    #[test]
    fn rosenbrock_is_solved_from_its_classic_start() {
        let f = |x: &DVector<f64>| Some(DVector::from_vec(vec![10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]]));
        let fit = minimise(&f, &names(2), &[-1.2, 1.0], Loss::Squares).unwrap();
        assert!((fit.parameters[0] - 1.0).abs() < 1e-8 && (fit.parameters[1] - 1.0).abs() < 1e-8, "{fit:?}");
    }

    #[test]
    fn powells_singular_function_is_refused() {
        let f = |x: &DVector<f64>| {
            Some(DVector::from_vec(vec![
                x[0] + 10.0 * x[1],
                5f64.sqrt() * (x[2] - x[3]),
                (x[1] - 2.0 * x[2]).powi(2),
                10f64.sqrt() * (x[0] - x[3]).powi(2),
            ]))
        };
        let e = minimise(&f, &names(4), &[3.0, -1.0, 0.0, 1.0], Loss::Squares).unwrap_err();
        assert!(matches!(e, Problem::Undetermined { .. }), "{e}");
    }

    #[test]
    fn a_straight_line_has_the_textbook_covariance() {
        // y = a + b t at t = -1, 0, 1 with residuals that sum to zero in both normal equations.
        let (t, y) = ([-1.0, 0.0, 1.0], [1.1, 1.8, 3.1]);
        let f = |x: &DVector<f64>| Some(DVector::from_fn(3, |i, _| x[0] + x[1] * t[i] - y[i]));
        let fit = minimise(&f, &names(2), &[0.0, 0.0], Loss::Squares).unwrap();
        let (a, b) = (2.0, 1.0);
        assert!((fit.parameters[0] - a).abs() < 1e-9 && (fit.parameters[1] - b).abs() < 1e-9);
        let variance = (0.1f64 * 0.1 + 0.2 * 0.2 + 0.1 * 0.1) / 1.0;
        assert!((fit.covariance[(0, 0)] - variance / 3.0).abs() < 1e-9);
        assert!((fit.covariance[(1, 1)] - variance / 2.0).abs() < 1e-9);
        assert!(fit.covariance[(0, 1)].abs() < 1e-9);
    }

    #[test]
    fn the_undetermined_parameter_is_named() {
        let f = |x: &DVector<f64>| Some(DVector::from_vec(vec![x[0] - 1.0, x[2] - 2.0, x[0] + x[2] - 3.0]));
        let names = ["width", "height", "depth"].map(String::from);
        let e = minimise(&f, &names, &[0.0; 3], Loss::Squares).unwrap_err();
        assert!(matches!(&e, Problem::Undetermined { parameters, .. } if *parameters == ["height"]), "{e}");
    }

    #[test]
    fn steps_avoid_where_the_model_ends() {
        // The first full step of ln x = 0 from 5 goes to a negative x.
        let f = |x: &DVector<f64>| (x[0] > 0.0).then(|| DVector::from_element(1, x[0].ln()));
        let fit = minimise(&f, &names(1), &[5.0], Loss::Squares).unwrap();
        assert!((fit.parameters[0] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn huber_resists_what_squares_do_not() {
        let y = [1.0, 1.1, 0.9, 1.05, 0.95, 50.0];
        let f = |x: &DVector<f64>| Some(DVector::from_fn(6, |i, _| x[0] - y[i]));
        let squares = minimise(&f, &names(1), &[0.0], Loss::Squares).unwrap();
        let huber = minimise(&f, &names(1), &[0.0], Loss::Huber(0.1)).unwrap();
        assert!((squares.parameters[0] - 9.17).abs() < 0.01);
        assert!((huber.parameters[0] - 1.0).abs() < 0.1, "{}", huber.parameters[0]);
    }
}

//! One run of argmin's trust region, with the exact step within the radius.

use super::{Problem, Residuals, finite, finite_matrix, scaled, weighted};
use argmin::core::{
    CostFunction, Error as ArgminError, Gradient, Hessian, IterState, KV, Problem as Counted, Solver, State,
    TerminationReason, TrustRegionRadius,
};
use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// One trust-region run in parameters `s` with x = origin + unit ∘ s.
pub(super) struct Run<'a, M> {
    pub model: &'a M,
    pub weights: &'a DVector<f64>,
    pub origin: &'a DVector<f64>,
    pub unit: &'a DVector<f64>,
}

impl<M: Residuals> Run<'_, M> {
    fn at(&self, s: &DVector<f64>) -> DVector<f64> {
        self.origin + s.component_mul(self.unit)
    }

    fn linearised(&self, s: &DVector<f64>) -> Result<(DVector<f64>, DMatrix<f64>), ArgminError> {
        let x = self.at(s);
        let r = self.model.residuals(&x).filter(finite).ok_or(Problem::Start)?;
        let j = self.model.jacobian(&x).filter(finite_matrix).ok_or(Problem::Start)?;
        Ok((r.component_mul(self.weights), scaled(&weighted(&j, self.weights), self.unit)))
    }
}

impl<M: Residuals> CostFunction for Run<'_, M> {
    type Param = DVector<f64>;
    type Output = f64;
    fn cost(&self, s: &DVector<f64>) -> Result<f64, ArgminError> {
        let r = self.model.residuals(&self.at(s)).filter(finite);
        Ok(r.map_or(f64::INFINITY, |r| r.component_mul(self.weights).norm_squared() / 2.0))
    }
}

impl<M: Residuals> Gradient for Run<'_, M> {
    type Param = DVector<f64>;
    type Gradient = DVector<f64>;
    fn gradient(&self, s: &DVector<f64>) -> Result<DVector<f64>, ArgminError> {
        let (r, j) = self.linearised(s)?;
        Ok(j.tr_mul(&r))
    }
}

impl<M: Residuals> Hessian for Run<'_, M> {
    type Param = DVector<f64>;
    type Hessian = DMatrix<f64>;
    fn hessian(&self, s: &DVector<f64>) -> Result<DMatrix<f64>, ArgminError> {
        let (_, j) = self.linearised(s)?;
        Ok(j.tr_mul(&j))
    }
}

/// The exact minimiser of the quadratic model within the radius (Nocedal and Wright 2006, §4.3). The problems here have
/// tens of parameters, so that a decomposition costs less than the residuals do.
#[derive(Clone, Default)]
pub(super) struct ExactStep {
    radius: f64,
}

impl TrustRegionRadius<f64> for ExactStep {
    fn set_radius(&mut self, radius: f64) {
        self.radius = radius;
    }
}

type Quadratic = IterState<DVector<f64>, DVector<f64>, (), DMatrix<f64>, (), f64>;

impl<O> Solver<O, Quadratic> for ExactStep {
    fn name(&self) -> &str {
        "exact step"
    }

    fn next_iter(
        &mut self,
        _: &mut Counted<O>,
        mut state: Quadratic,
    ) -> Result<(Quadratic, Option<KV>), ArgminError> {
        let gradient = state.take_gradient().ok_or(Problem::Start)?;
        let hessian = state.take_hessian().ok_or(Problem::Start)?;
        let step = step_within(&gradient, &hessian, self.radius);
        Ok((state.param(step).terminate_with(TerminationReason::SolverConverged), None))
    }
}

/// argmin gᵀp + ½pᵀHp for ‖p‖ ≤ radius, H positive semidefinite; directions without curvature are left alone.
pub(super) fn step_within(gradient: &DVector<f64>, hessian: &DMatrix<f64>, radius: f64) -> DVector<f64> {
    let eigen = SymmetricEigen::new(hessian.clone());
    let floor = eigen.eigenvalues.max() * 1e-14;
    let g = eigen.eigenvectors.tr_mul(gradient);
    let damped = |mu: f64| g.zip_map(&eigen.eigenvalues, |g, l| if l > floor { -g / (l + mu) } else { 0.0 });
    let mut p = damped(0.0);
    if p.norm() > radius {
        // ‖p(μ)‖ falls monotonically and is below the radius at μ = ‖g‖ / radius.
        let (mut low, mut high) = (0.0, g.norm() / radius);
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if damped(middle).norm() > radius { low = middle } else { high = middle }
        }
        p = damped(high);
        p *= radius / p.norm();
    }
    &eigen.eigenvectors * p
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_step_is_the_best_within_the_radius(
            a in prop::collection::vec(-1.0..1.0f64, 12), g in prop::collection::vec(-1.0..1.0f64, 3),
            radius in 0.01..3.0f64, other in prop::collection::vec(-1.0..1.0f64, 3),
        ) {
            let a = DMatrix::from_vec(4, 3, a);
            let (h, g) = (a.tr_mul(&a), DVector::from_vec(g));
            let value = |p: &DVector<f64>| g.dot(p) + 0.5 * p.dot(&(&h * p));
            let p = step_within(&g, &h, radius);
            prop_assert!(p.norm() <= radius * (1.0 + 1e-12));
            let mut other = DVector::from_vec(other);
            other *= radius / other.norm().max(radius);
            prop_assert!(value(&p) <= value(&other) + 1e-9);
        }
    }
}

//! Irradiance of a whole environment up to l = 4, for what stands in it without occluders: up to l = 2 it errs by some per cent
//! where small lights give most of it, as much as a few shadow-casting lights do (2001, §3.3).

use super::{Coefficients, Projection, convolved, evaluate};
use glam::Vec3;
use std::f64::consts::PI;

/// Harmonics of degree 4.
const FOURTH: usize = 9;
/// Factor of the clamped cosine for l = 4 (2001, eq. 8); there is none for l = 3.
const COSINE_4: f64 = -PI / 24.0;

/// Irradiance by normal.
#[derive(Debug, Clone)]
pub struct UnshadowedIrradiance {
    low: Coefficients,
    high: [[f32; 3]; FOURTH],
}

impl UnshadowedIrradiance {
    /// Of an environment given by samples (unit direction, radiance, solid angle in sr).
    pub fn new(samples: impl IntoIterator<Item = (Vec3, [f32; 3], f64)>) -> Self {
        let (mut low, mut high) = (Projection::default(), [[0.0f64; 3]; FOURTH]);
        for (direction, radiance, solid_angle) in samples {
            low.add(direction, radiance, solid_angle);
            for (sum, y) in high.iter_mut().zip(fourth(direction)) {
                for (sum, l) in sum.iter_mut().zip(radiance) {
                    *sum += COSINE_4 * f64::from(y) * f64::from(l) * solid_angle;
                }
            }
        }
        Self { low: convolved(&low.coefficients()), high: high.map(|c| c.map(|v| v as f32)) }
    }

    /// On a surface of unit normal; not below zero.
    pub fn at(&self, normal: Vec3) -> [f32; 3] {
        let (low, basis) = (evaluate(&self.low, normal), fourth(normal));
        std::array::from_fn(|k| {
            let high: f32 = self.high.iter().zip(basis).map(|(c, y)| c[k] * y).sum();
            (low[k] + high).max(0.0)
        })
    }
}

/// The harmonics (4,−4) … (4,4) in a unit direction.
fn fourth(d: Vec3) -> [f32; FOURTH] {
    let Vec3 { x, y, z } = d;
    let (x2, y2, z2) = (x * x, y * y, z * z);
    [
        2.503_342_9 * x * y * (x2 - y2),
        1.770_130_8 * y * z * (3.0 * x2 - y2),
        0.946_174_7 * x * y * (7.0 * z2 - 1.0),
        0.669_046_5 * y * z * (7.0 * z2 - 3.0),
        0.105_785_55 * (35.0 * z2 * z2 - 30.0 * z2 + 3.0),
        0.669_046_5 * x * z * (7.0 * z2 - 3.0),
        0.473_087_35 * (x2 - y2) * (7.0 * z2 - 1.0),
        1.770_130_8 * x * z * (x2 - 3.0 * y2),
        0.625_835_7 * (x2 * (x2 - 3.0 * y2) - y2 * (3.0 * x2 - y2)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sh::{COUNT, irradiance, project, sphere_direction};
    use proptest::prelude::*;

    const POINTS: usize = 4000;

    fn sphere() -> impl Iterator<Item = (Vec3, f64)> {
        (0..POINTS).map(|i| (sphere_direction(i, POINTS), 4.0 * PI / POINTS as f64))
    }

    #[test]
    fn harmonics_of_degree_four_are_orthonormal_and_across_the_lower_ones() {
        let all = |d: Vec3| super::super::basis(d).into_iter().chain(fourth(d)).collect::<Vec<_>>();
        let n = COUNT + FOURTH;
        let mut gram = vec![0.0f64; n * n];
        for (d, w) in sphere() {
            let y = all(d);
            (0..n * n).for_each(|i| gram[i] += w * f64::from(y[i / n]) * f64::from(y[i % n]));
        }
        for (i, g) in gram.iter().enumerate() {
            assert!((g - f64::from(i / n == i % n)).abs() < 2e-3, "({}, {}): {g}", i / n, i % n);
        }
    }

    proptest! {
        #[test]
        fn a_lamp_gives_its_cosine_better_than_up_to_degree_two(
            x in -1.0..1.0f32, y in -1.0..1.0f32, z in -1.0..1.0f32,
        ) {
            let towards = Vec3::new(x, y, z).normalize_or(Vec3::Y);
            let lamp = [(towards, [10.0; 3], 0.1)];
            let (fine, coarse) = (UnshadowedIrradiance::new(lamp), project(lamp));
            let mut errors = [0.0f64; 2];
            for (n, w) in sphere() {
                let truth = towards.dot(n).max(0.0);
                for (error, e) in errors.iter_mut().zip([fine.at(n)[0], irradiance(&coarse, n)[0]]) {
                    *error += w * f64::from(e - truth).powi(2) / (4.0 * PI);
                }
            }
            let [fine, coarse] = errors.map(f64::sqrt);
            prop_assert!(fine < 0.018 && fine < 0.55 * coarse, "{} {}", fine, coarse);
        }

        #[test]
        fn even_light_gives_pi_times_its_radiance(x in -1.0..1.0f32, y in -1.0..1.0f32) {
            let even = UnshadowedIrradiance::new(sphere().map(|(d, w)| (d, [2.0, 1.0, 0.5], w)));
            let e = even.at(Vec3::new(x, y, 0.5).normalize());
            prop_assert!((e[0] / (2.0 * PI as f32) - 1.0).abs() < 1e-3, "{:?}", e);
        }
    }
}

//! Real orthonormal spherical harmonics up to l = 2, in the order (0,0) (1,−1) (1,0) (1,1) (2,−2) … (2,2), with the
//! signs of Ramamoorthi and Hanrahan, *An efficient representation for irradiance environment maps*, 2001, eq. 3.
//! The polar axis is the world's z.

use glam::Vec3;
use std::f64::consts::PI;

/// Number of coefficients.
pub const COUNT: usize = 9;

/// Coefficients of a coloured function on the sphere: one triple per harmonic.
pub type Coefficients = [[f32; 3]; COUNT];

/// Factors of the clamped cosine for l = 0, 1, 2 (2001, eq. 8): irradiance = Σ A_l L_lm Y_lm.
pub const COSINE: [f32; 3] = [PI as f32, (2.0 * PI / 3.0) as f32, (PI / 4.0) as f32];

/// The nine harmonics in a unit direction.
pub fn basis(d: Vec3) -> [f32; COUNT] {
    let Vec3 { x, y, z } = d;
    [
        0.282_094_8,
        0.488_602_5 * y,
        0.488_602_5 * z,
        0.488_602_5 * x,
        1.092_548_4 * x * y,
        1.092_548_4 * y * z,
        0.315_391_57 * (3.0 * z * z - 1.0),
        1.092_548_4 * x * z,
        0.546_274_2 * (x * x - y * y),
    ]
}

/// Sums samples of a function into its coefficients; sums in f64, so that thousands of faint samples count.
#[derive(Debug, Clone, Default)]
pub struct Projection([[f64; 3]; COUNT]);

impl Projection {
    /// Adds radiance seen in a unit direction over a solid angle, sr.
    pub fn add(&mut self, direction: Vec3, radiance: [f32; 3], solid_angle_sr: f64) {
        for (sum, y) in self.0.iter_mut().zip(basis(direction)) {
            for (sum, l) in sum.iter_mut().zip(radiance) {
                *sum += f64::from(y) * f64::from(l) * solid_angle_sr;
            }
        }
    }

    /// The coefficients.
    pub fn coefficients(&self) -> Coefficients {
        self.0.map(|c| c.map(|v| v as f32))
    }
}

/// Coefficients of a function given by samples (unit direction, radiance, solid angle in sr).
pub fn project(samples: impl IntoIterator<Item = (Vec3, [f32; 3], f64)>) -> Coefficients {
    let mut sum = Projection::default();
    samples.into_iter().for_each(|(d, l, w)| sum.add(d, l, w));
    sum.coefficients()
}

/// The function in a unit direction; may ring below zero.
pub fn evaluate(coefficients: &Coefficients, direction: Vec3) -> [f32; 3] {
    combine(coefficients, basis(direction))
}

/// Irradiance on a surface of unit `normal` under the radiance given by `coefficients`, clamped at zero: near a small
/// bright source the truncated series rings below it.
pub fn irradiance(coefficients: &Coefficients, normal: Vec3) -> [f32; 3] {
    evaluate(&convolved(coefficients), normal).map(|e| e.max(0.0))
}

/// Coefficients of irradiance by normal from those of radiance by direction.
pub fn convolved(coefficients: &Coefficients) -> Coefficients {
    std::array::from_fn(|i| coefficients[i].map(|c| COSINE[degree(i)] * c))
}

/// Degree l of the `i`-th harmonic.
fn degree(i: usize) -> usize {
    match i {
        0 => 0,
        1..=3 => 1,
        _ => 2,
    }
}

fn combine(coefficients: &Coefficients, weights: [f32; COUNT]) -> [f32; 3] {
    std::array::from_fn(|k| coefficients.iter().zip(weights).map(|(c, w)| c[k] * w).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::latlong;
    use proptest::prelude::*;

    fn sphere(width: usize) -> impl Iterator<Item = (Vec3, f64)> {
        let height = width / 2;
        (0..width * height).map(move |i| {
            let (x, y) = (i % width, i / width);
            let d = latlong::direction(x as f32 + 0.5, y as f32 + 0.5, width, height);
            (d, latlong::texel_solid_angle(y, width, height))
        })
    }

    #[test]
    fn harmonics_are_orthonormal() {
        let mut gram = [[0.0f64; COUNT]; COUNT];
        for (d, w) in sphere(256) {
            let y = basis(d);
            for i in 0..COUNT {
                for j in 0..COUNT {
                    gram[i][j] += w * f64::from(y[i] * y[j]);
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, g) in row.iter().enumerate() {
                assert!((g - f64::from(i == j)).abs() < 1e-3, "({i}, {j}): {g}");
            }
        }
    }

    #[test]
    fn white_furnace() {
        let c = project(sphere(128).map(|(d, w)| (d, [2.0; 3], w)));
        assert!(c[1..].iter().all(|c| c[0].abs() < 3e-3), "higher bands vanish: {c:?}");
        assert!((irradiance(&c, Vec3::new(0.6, 0.0, 0.8))[1] - 2.0 * PI as f32).abs() < 1e-2);
    }

    #[test]
    fn ringing_stays_at_zero() {
        let c = project([(Vec3::Y, [100.0; 3], 1e-3)]);
        let lowest = sphere(64).map(|(d, _)| irradiance(&c, d)[0]).fold(f32::MAX, f32::min);
        assert!(lowest == 0.0, "{lowest}");
        let on_axis = irradiance(&c, Vec3::Y)[0];
        assert!(
            (on_axis / 0.1 - 1.0).abs() < 0.1,
            "a point source of 0.1 gives {on_axis} at normal incidence"
        );
    }

    proptest! {
        #[test]
        fn evaluation_inverts_projection(c in proptest::array::uniform9(-1.0..1.0f32), x in -1.0..1.0f32, y in -1.0..1.0f32) {
            let given: Coefficients = c.map(|v| [v, 0.5 * v, -v]);
            let again = project(sphere(128).map(|(d, w)| (d, evaluate(&given, d), w)));
            let d = Vec3::new(x, y, 0.3).normalize();
            prop_assert!((evaluate(&given, d)[0] - evaluate(&again, d)[0]).abs() < 5e-3);
        }
    }
}

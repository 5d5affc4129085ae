//! Real orthonormal spherical harmonics up to l = 2, in the order (0,0) (1,−1) (1,0) (1,1) (2,−2) … (2,2), with the
//! signs of Ramamoorthi and Hanrahan, *An efficient representation for irradiance environment maps*, 2001, eq. 3.
//! The polar axis is the world's z.

mod unshadowed;

pub use unshadowed::UnshadowedIrradiance;

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

/// Normals at which irradiance is looked at for what is below zero.
const NORMALS: usize = 400;
/// Halvings of the strength of a window.
const HALVINGS: usize = 12;
/// No window is stronger than this.
const STRONGEST: f32 = 4.0;

/// Incident radiance whose irradiance is nowhere below zero: near a small bright source a truncated series rings below it.
/// Channels that do are windowed by 1 / (1 + λ l²(l+1)²), the least curved of all (Sloan, *Stupid Spherical Harmonics
/// Tricks*, 2008), with the smallest λ that does; the light in all, l = 0, is kept.
pub fn windowed(coefficients: &Coefficients) -> Coefficients {
    static BASES: std::sync::LazyLock<Vec<[f32; COUNT]>> =
        std::sync::LazyLock::new(|| (0..NORMALS).map(|i| basis(sphere_direction(i, NORMALS))).collect());
    let mut made = *coefficients;
    for k in 0..3 {
        let window = |strength: f32, i: usize| {
            let l = degree(i) as f32;
            coefficients[i][k] / (1.0 + strength * (l * (l + 1.0)).powi(2))
        };
        let holds = |strength: f32| {
            let c: [f32; COUNT] = std::array::from_fn(|i| COSINE[degree(i)] * window(strength, i));
            BASES.iter().all(|y| c.iter().zip(y).map(|(c, y)| c * y).sum::<f32>() >= 0.0)
        };
        if coefficients[0][k] <= 0.0 || holds(0.0) {
            continue;
        }
        let (mut low, mut high) = (0.0, STRONGEST);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if holds(middle) { high = middle } else { low = middle }
        }
        (0..COUNT).for_each(|i| made[i][k] = window(high, i));
    }
    made
}

/// The `i`-th of `n` directions spread evenly over the sphere (Fibonacci lattice).
pub(crate) fn sphere_direction(i: usize, n: usize) -> Vec3 {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let y = 1.0 - (2.0 * i as f64 + 1.0) / n as f64;
    let r = (1.0 - y * y).sqrt();
    let (sin, cos) = (std::f64::consts::TAU * (i as f64 * GOLDEN).fract()).sin_cos();
    Vec3::new((r * cos) as f32, y as f32, (r * sin) as f32)
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
        fn a_window_takes_away_what_is_below_zero_and_keeps_the_light(
            x in -1.0..1.0f32, y in -1.0..1.0f32, z in -1.0..1.0f32, faint in 0.0..0.3f32
        ) {
            let d = Vec3::new(x, y, z).normalize_or(Vec3::Y);
            let c = project([(d, [100.0, 10.0, 0.0], 1e-3), (-d, [100.0 * faint; 3], 1e-3)]);
            let made = windowed(&c);
            prop_assert_eq!(made[0], c[0]);
            let raw = |n: Vec3| evaluate(&convolved(&made), n);
            let lowest = sphere(64).map(|(n, _)| raw(n)[0]).fold(f32::MAX, f32::min);
            prop_assert!(lowest > -2e-4, "{}", lowest);
            // What rings not is left as it is.
            let even = project(sphere(64).map(|(n, w)| (n, [1.0 + 0.4 * n.x; 3], w)));
            prop_assert_eq!(windowed(&even), even);
        }

        #[test]
        fn evaluation_inverts_projection(c in proptest::array::uniform9(-1.0..1.0f32), x in -1.0..1.0f32, y in -1.0..1.0f32) {
            let given: Coefficients = c.map(|v| [v, 0.5 * v, -v]);
            let again = project(sphere(128).map(|(d, w)| (d, evaluate(&given, d), w)));
            let d = Vec3::new(x, y, 0.3).normalize();
            prop_assert!((evaluate(&given, d)[0] - evaluate(&again, d)[0]).abs() < 5e-3);
        }
    }
}

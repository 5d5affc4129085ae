//! The GGX lobe against an environment: the mean under the lobe as seen head-on, times what the lobe reflects of white
//! light (Karis 2013, "split sum").

use super::brdf::{grazing, smith};
use crate::render::{Environment, Prefiltered};
use glam::Vec3;
use std::f32::consts::TAU;

/// What a GGX lobe of one roughness reflects, by its axis and the angle of incidence.
#[derive(Debug, Clone)]
pub struct GgxLobe {
    means: Prefiltered,
    /// By cosine of incidence, 0 … 1: factor of the reflectance at normal incidence, and what is added to it.
    albedo: Vec<[f32; 2]>,
    normal_reflectance: f32,
}

/// Cosines at which the albedo is tabulated.
const COSINES: usize = 64;

impl GgxLobe {
    /// Prefilters an environment.
    pub fn new(environment: &Environment, roughness: f32, normal_reflectance: f32) -> Self {
        let cosine = |i: usize| (i as f32 / (COSINES - 1) as f32).max(1e-3);
        Self {
            means: Prefiltered::ggx(environment, roughness),
            albedo: (0..COSINES).map(|i| albedo(roughness, cosine(i))).collect(),
            normal_reflectance,
        }
    }

    /// Radiance sent back, the mirror direction along `axis`, at a cosine of incidence.
    pub fn reflected(&self, axis: Vec3, cos: f32) -> [f32; 3] {
        let at = cos.clamp(0.0, 1.0) * (COSINES - 1) as f32;
        let i = (at as usize).min(COSINES - 2);
        let [scale, bias] = [0, 1].map(|k| {
            let (a, b) = (self.albedo[i][k], self.albedo[i + 1][k]);
            a + (b - a) * (at - i as f32)
        });
        self.means.radiance(axis).map(|v| v * (self.normal_reflectance * scale + bias))
    }
}

/// ∫ f cos θ dω = F₀ · first + second, over facets drawn from their distribution.
fn albedo(roughness: f32, cos_v: f32) -> [f32; 2] {
    const STEPS: [usize; 2] = [64, 32];
    let viewer = Vec3::new((1.0 - cos_v * cos_v).sqrt(), 0.0, cos_v);
    let mut sum = [0.0f64; 2];
    for (i, j) in (0..STEPS[0]).flat_map(|i| (0..STEPS[1]).map(move |j| (i, j))) {
        let (u, azimuth) = ((i as f32 + 0.5) / STEPS[0] as f32, TAU * (j as f32 + 0.5) / STEPS[1] as f32);
        let cos_h = ((1.0 - u) / (1.0 + (roughness * roughness - 1.0) * u)).sqrt();
        let sin_h = (1.0 - cos_h * cos_h).max(0.0).sqrt();
        let half = Vec3::new(sin_h * azimuth.cos(), sin_h * azimuth.sin(), cos_h);
        let cos_d = viewer.dot(half);
        let cos_l = 2.0 * cos_d * half.z - viewer.z;
        if cos_l > 0.0 && cos_d > 0.0 {
            let seen = smith(cos_l, roughness) * smith(cos_v, roughness) * cos_d / (cos_h * cos_v);
            sum[0] += f64::from(seen * (1.0 - grazing(cos_d)));
            sum[1] += f64::from(seen * grazing(cos_d));
        }
    }
    sum.map(|s| (s / (STEPS[0] * STEPS[1]) as f64) as f32)
}

#[cfg(test)]
mod tests {
    use super::super::Brdf;
    use super::*;
    use crate::image::{Image, Radiance};

    #[test]
    fn a_broad_environment_is_reflected_as_by_direct_summation() {
        let environment = Environment {
            map: Image::from_fn(64, 32, |x, y| {
                Radiance([2.0 + (TAU * x as f32 / 64.0).sin(), 1.0 + y as f32 / 32.0, 1.0])
            }),
        };
        let (roughness, normal_reflectance) = (0.3, 0.2);
        let lobe = GgxLobe::new(&environment, roughness, normal_reflectance);
        let brdf = Brdf::Ggx { roughness, normal_reflectance };
        let normal = Vec3::new(0.2, 0.5, 0.8).normalize();
        for viewer in [normal, (normal + Vec3::X * 0.8).normalize()] {
            let mut exact = [0.0f32; 3];
            for (i, radiance) in environment.map.pixels().iter().enumerate() {
                let (light, solid_angle) = environment.texel(i);
                let weight = brdf.value(normal, light, viewer) * normal.dot(light).max(0.0) * solid_angle;
                (0..3).for_each(|k| exact[k] += weight * radiance.0[k]);
            }
            let cos = normal.dot(viewer);
            let found = lobe.reflected(normal * (2.0 * cos) - viewer, cos);
            for k in 0..3 {
                // Seen aslant, the true lobe is longer than the one prefiltered head-on.
                assert!((found[k] / exact[k] - 1.0).abs() < 0.08, "{found:?} {exact:?}");
            }
        }
    }
}

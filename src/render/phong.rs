//! The Phong lobe against an environment, in the normalised form (n + 2)/2π cosⁿα (Lafortune and Willems 1994).

use super::environment::Environment;
use super::prefilter::Prefiltered;
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::{PI, TAU};

/// What a lobe of one exponent reflects, by direction of its axis and angle of incidence.
#[derive(Debug, Clone)]
pub struct Lobe {
    means: Prefiltered,
    albedo: Vec<f32>,
}

/// Angles at which the albedo is tabulated.
const ANGLES: usize = 64;

impl Lobe {
    /// Means of the environment under cosⁿα about each axis, and the lobe's albedo.
    pub fn new(environment: &Environment, exponent: f32) -> Self {
        let means = Prefiltered::phong(environment, exponent);
        let albedo = (0..ANGLES)
            .into_par_iter()
            .map(|i| directional_albedo(exponent, PI / 2.0 * i as f32 / (ANGLES - 1) as f32))
            .collect();
        Self { means, albedo }
    }

    /// Radiance that a lobe of specular reflectance 1 sends back, its axis along the mirror direction `axis` and
    /// the cosine of incidence `cos`.
    pub fn reflected(&self, axis: Vec3, cos: f32) -> [f32; 3] {
        let albedo = self.albedo(cos);
        self.means.radiance(axis).map(|v| v * albedo)
    }

    /// Share of light reflected at a cosine of incidence.
    pub fn albedo(&self, cos: f32) -> f32 {
        let at = cos.clamp(0.0, 1.0).acos() / (PI / 2.0) * (ANGLES - 1) as f32;
        let i = (at as usize).min(ANGLES - 2);
        self.albedo[i] + (self.albedo[i + 1] - self.albedo[i]) * (at - i as f32)
    }
}

/// Share of light that the normalised lobe reflects at an angle of incidence: ∫ (n+2)/2π cosⁿα cos⁺θ dω, 1 at
/// normal incidence and less towards grazing, where part of the lobe is cut off by the surface.
pub fn directional_albedo(exponent: f32, incidence_rad: f32) -> f32 {
    const STEPS: usize = 256;
    let (sin_i, cos_i) = incidence_rad.sin_cos();
    let mut sum = 0.0f64;
    for i in 0..STEPS {
        // Equal shares of the lobe: c = u^(1/(n+1)) has density (n+1) cⁿ.
        let c = ((i as f32 + 0.5) / STEPS as f32).powf(1.0 / (exponent + 1.0));
        let s = (1.0 - c * c).max(0.0).sqrt();
        for j in 0..STEPS {
            let azimuth = TAU * (j as f32 + 0.5) / STEPS as f32;
            sum += f64::from((c * cos_i + s * azimuth.cos() * sin_i).max(0.0));
        }
    }
    ((sum / (STEPS * STEPS) as f64) as f32 * (exponent + 2.0) / (exponent + 1.0)).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Image, Radiance};

    #[test]
    fn the_lobe_never_sends_more_than_it_gets() {
        for exponent in [0.0, 1.0, 10.0, 100.0, 5000.0] {
            assert!(
                (directional_albedo(exponent, 0.0) - 1.0).abs() < 2e-3,
                "normal incidence, n = {exponent}"
            );
            let mut before = 1.01;
            for i in 0..=10 {
                let albedo = directional_albedo(exponent, i as f32 * PI / 20.0);
                assert!(albedo <= 1.0 && albedo <= before + 1e-4, "n = {exponent}, step {i}: {albedo}");
                before = albedo;
            }
        }
        // A thin lobe loses half of itself and keeps cos θ ≈ 0 of the rest at grazing incidence.
        assert!(directional_albedo(5000.0, PI / 2.0) < 0.02);
    }

    #[test]
    fn a_white_furnace_stays_white() {
        let environment = Environment { map: Image::from_fn(32, 16, |_, _| Radiance([2.0, 1.0, 0.5])) };
        for exponent in [1.0, 30.0, 1e5] {
            let lobe = Lobe::new(&environment, exponent);
            let axis = Vec3::new(0.3, -0.5, 0.9).normalize();
            let reflected = lobe.reflected(axis, 1.0);
            assert!((reflected[0] - 2.0).abs() < 5e-3 && (reflected[2] - 0.5).abs() < 2e-3, "{reflected:?}");
        }
    }

    #[test]
    fn a_narrow_lobe_mirrors() {
        let environment = Environment {
            map: Image::from_fn(128, 64, |x, _| Radiance([if x < 64 { 1.0 } else { 0.0 }; 3])),
        };
        let lobe = Lobe::new(&environment, 5e4);
        // The left half of a latlong map holds longitudes 0..π, that is +X.
        assert!((lobe.reflected(Vec3::X, 1.0)[0] - 1.0).abs() < 1e-3);
        assert!(lobe.reflected(-Vec3::X, 1.0)[0] < 1e-3);
        let broad = Lobe::new(&environment, 3.0);
        assert!((broad.reflected(Vec3::Z, 1.0)[0] - 0.5).abs() < 0.02, "half of it at the border");
    }
}

//! Unshadowed light in constant time (decoro2008, §3.1): irradiance by spherical harmonics (Ramamoorthi and Hanrahan
//! 2001), gloss by a prefiltered environment (Heidrich and Seidel 1999) or, for any other material, by a radiance cache.

use super::ggx::GgxLobe;
use super::{Brdf, RadianceCache};
use crate::illuminate::patch::DistantSource;
use crate::render::{Environment, Lobe};
use crate::sh;
use glam::Vec3;

/// The light that an environment without occluders sends by way of one material.
pub struct Unshadowed {
    harmonics: sh::Coefficients,
    gloss: Gloss,
}

enum Gloss {
    None,
    Phong(Lobe),
    Ggx(GgxLobe),
    Cached(RadianceCache),
}

impl Unshadowed {
    /// Prepares an environment for a material. A radiance cache is made for the unit vector towards the viewer, from
    /// `lights` that stand for the whole environment.
    pub fn new(environment: &Environment, brdf: Brdf, viewer: Vec3, lights: &[DistantSource]) -> Self {
        let texels = environment.map.pixels().iter().enumerate();
        let samples = texels.map(|(i, radiance)| {
            let (direction, solid_angle) = environment.texel(i);
            (direction, radiance.0, f64::from(solid_angle))
        });
        let gloss = match brdf {
            Brdf::Lambert => Gloss::None,
            Brdf::Phong { exponent } => Gloss::Phong(Lobe::new(environment, exponent)),
            Brdf::Ggx { roughness, normal_reflectance } => {
                Gloss::Ggx(GgxLobe::new(environment, roughness, normal_reflectance))
            }
            Brdf::TorranceSparrow { .. } => {
                let mut cache = RadianceCache::default();
                cache.update(brdf, viewer, lights);
                Gloss::Cached(cache)
            }
        };
        Self { harmonics: sh::project(samples), gloss }
    }

    /// Irradiance on a surface of unit normal.
    pub fn irradiance(&self, normal: Vec3) -> [f32; 3] {
        sh::irradiance(&self.harmonics, normal)
    }

    /// Radiance of the gloss (reflectance 1) towards the viewer, 0 for a matt material.
    pub fn gloss(&self, normal: Vec3, viewer: Vec3) -> [f32; 3] {
        let cos = normal.dot(viewer);
        let mirror = normal * (2.0 * cos) - viewer;
        match &self.gloss {
            _ if cos <= 0.0 => [0.0; 3],
            Gloss::None => [0.0; 3],
            Gloss::Phong(lobe) => lobe.reflected(mirror, cos),
            Gloss::Ggx(lobe) => lobe.reflected(mirror, cos),
            Gloss::Cached(cache) => cache.radiance(normal, viewer),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::LightSampling;
    use crate::image::{Image, Radiance};
    use crate::subtractive::sample;
    use std::f32::consts::PI;

    #[test]
    fn a_white_furnace_stays_white() {
        let environment = Environment { map: Image::from_fn(64, 32, |_, _| Radiance([2.0, 1.0, 0.5])) };
        let lights = sample(&environment.map, 1000, LightSampling::Structured);
        let lights: Vec<DistantSource> = lights.iter().map(|s| s.source).collect();
        let viewer = Vec3::new(0.1, 0.2, 1.0).normalize();
        let facets = |roughness| {
            [
                Brdf::TorranceSparrow { roughness, normal_reflectance: 1.0 },
                Brdf::Ggx { roughness, normal_reflectance: 1.0 },
            ]
        };
        let all = facets(0.3).into_iter().chain([Brdf::Phong { exponent: 40.0 }]);
        for brdf in all {
            let unshadowed = Unshadowed::new(&environment, brdf, viewer, &lights);
            for normal in [viewer, (viewer + Vec3::X * 0.5).normalize()] {
                let [irradiance, gloss] = [unshadowed.irradiance(normal), unshadowed.gloss(normal, viewer)];
                assert!((irradiance[0] / (2.0 * PI) - 1.0).abs() < 1e-3, "{irradiance:?}");
                assert!((0.85..1.03).contains(&(gloss[0] / 2.0)), "{brdf:?}: {gloss:?}");
                assert!((gloss[2] / gloss[0] - 0.25).abs() < 1e-3, "{brdf:?}: {gloss:?}");
            }
            assert_eq!(unshadowed.gloss(-viewer, viewer), [0.0; 3], "from behind");
        }
        let matt = Unshadowed::new(&environment, Brdf::Lambert, viewer, &[]);
        assert_eq!(matt.gloss(viewer, viewer), [0.0; 3]);
    }
}

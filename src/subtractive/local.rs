//! Unshadowed light in constant time (decoro2008, §3.1): irradiance by spherical harmonics (Ramamoorthi and Hanrahan
//! 2001), gloss by a prefiltered environment (Heidrich and Seidel 1999) or, for any other material, by a radiance cache.

use super::ggx::GgxLobe;
use super::{Brdf, Light, RadianceCache};
use crate::render::{Environment, Lobe};
use crate::sh::UnshadowedIrradiance;
use glam::Vec3;

/// The light that an environment without occluders sends by way of one material.
pub struct Unshadowed {
    harmonics: UnshadowedIrradiance,
    gloss: Gloss,
}

enum Gloss {
    None,
    Phong(Lobe),
    Ggx(GgxLobe),
    Cached(RadianceCache),
}

impl Unshadowed {
    /// Prepares an environment for a material. Phong's lobe is prefiltered; any other gloss comes from a radiance cache for
    /// the unit vector towards the viewer, made from `lights` that stand for the whole environment.
    pub fn new(environment: &Environment, brdf: Brdf, viewer: Vec3, lights: &[Light]) -> Self {
        let mut cache = RadianceCache::default();
        let gloss = match brdf {
            Brdf::Lambert => Gloss::None,
            Brdf::Phong { exponent } => Gloss::Phong(Lobe::new(environment, exponent)),
            Brdf::TorranceSparrow { .. } | Brdf::Ggx { .. } => {
                cache.update(brdf, viewer, lights);
                Gloss::Cached(cache)
            }
        };
        Self { harmonics: harmonics(environment), gloss }
    }

    /// GGX by its prefiltered lobe: cheaper than a cache, but with one shape of the lobe for all angles of incidence (the
    /// split sum), an error that more lights do not cure.
    pub fn prefiltered(environment: &Environment, roughness: f32, normal_reflectance: f32) -> Self {
        let gloss = Gloss::Ggx(GgxLobe::new(environment, roughness, normal_reflectance));
        Self { harmonics: harmonics(environment), gloss }
    }

    /// Irradiance on a surface of unit normal.
    pub fn irradiance(&self, normal: Vec3) -> [f32; 3] {
        self.harmonics.at(normal)
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

fn harmonics(environment: &Environment) -> UnshadowedIrradiance {
    let texels = environment.map.pixels().iter().enumerate();
    UnshadowedIrradiance::new(texels.map(|(i, radiance)| {
        let (direction, solid_angle) = environment.texel(i);
        (direction, radiance.0, f64::from(solid_angle))
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::LightSampling;
    use crate::image::{Image, Radiance};
    use crate::subtractive::{Surface, gather, sample};
    use std::f32::consts::PI;

    #[test]
    fn without_occluders_a_cache_is_the_sum_of_all_lights_and_a_prefiltered_lobe_is_not() {
        // A lamp in the dark, on which the shape of a lobe shows.
        let lamp = |x: usize, y: usize| x.abs_diff(40) < 3 && y.abs_diff(14) < 2;
        let environment = Environment {
            map: Image::from_fn(128, 64, |x, y| Radiance([if lamp(x, y) { 200.0 } else { 0.1 }; 3])),
        };
        let lights: Vec<Light> = sample(&environment.map, 1000, LightSampling::Structured)
            .iter()
            .map(|s| Light::of_stratum(s).as_point())
            .collect();
        let viewer = Vec3::new(0.2, 0.1, 1.0).normalize();
        let (roughness, normal_reflectance) = (0.2, 0.5);
        let brdf = Brdf::Ggx { roughness, normal_reflectance };
        let cached = Unshadowed::new(&environment, brdf, viewer, &lights);
        let lobe = Unshadowed::prefiltered(&environment, roughness, normal_reflectance);
        let (mut signal, mut errors) = (0.0f64, [0.0f64; 2]);
        for i in 0..400 {
            let tilt = Vec3::new((i % 20) as f32 / 8.0 - 1.2, (i / 20) as f32 / 8.0 - 1.2, 0.0);
            let normal = (viewer + tilt).normalize();
            let surface = Surface {
                position: Vec3::ZERO,
                normal,
                face_normal: normal,
                viewer,
                material: 0,
                pixel_m: 1e-3,
            };
            let sum = gather(&surface, Some(brdf), &lights, 0..lights.len(), |_, _| [1.0; 3]).gloss[0];
            signal += f64::from(sum).powi(2);
            for (error, unshadowed) in errors.iter_mut().zip([&cached, &lobe]) {
                *error += f64::from(unshadowed.gloss(normal, viewer)[0] - sum).powi(2);
            }
        }
        let [cache, lobe] = errors.map(|e| (e / signal).sqrt());
        assert!(cache < 0.02 && lobe > 0.1, "cache {cache}, lobe {lobe}");
    }

    #[test]
    fn a_white_furnace_stays_white() {
        let environment = Environment { map: Image::from_fn(64, 32, |_, _| Radiance([2.0, 1.0, 0.5])) };
        let lights = sample(&environment.map, 1000, LightSampling::Structured);
        let lights: Vec<Light> = lights.iter().map(|s| Light::of_stratum(s).as_point()).collect();
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
        let lobe = Unshadowed::prefiltered(&environment, 0.3, 1.0).gloss(viewer, viewer);
        assert!((0.85..1.03).contains(&(lobe[0] / 2.0)), "{lobe:?}");
        let matt = Unshadowed::new(&environment, Brdf::Lambert, viewer, &[]);
        assert_eq!(matt.gloss(viewer, viewer), [0.0; 3]);
    }
}

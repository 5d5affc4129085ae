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

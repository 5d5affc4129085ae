//! Reflection models, each of reflectance 1: reciprocal, and never more light than arrives.

use glam::Vec3;
use std::f32::consts::PI;

/// How a surface scatters light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Brdf {
    /// Evenly.
    Lambert,
    /// About the mirror direction: (n + 2)/2π cosⁿα (Lafortune and Willems 1994).
    Phong {
        /// n.
        exponent: f32,
    },
    /// By V-shaped grooves of facets with Beckmann's distribution (Torrance and Sparrow 1967; Cook and Torrance 1982).
    TorranceSparrow {
        /// Root mean square slope of the facets.
        roughness: f32,
        /// Reflectance of a facet at normal incidence.
        normal_reflectance: f32,
    },
    /// By facets with the GGX distribution and Smith's shadowing (Walter et al. 2007).
    Ggx {
        /// α.
        roughness: f32,
        /// Reflectance of a facet at normal incidence.
        normal_reflectance: f32,
    },
}

/// Facets smoother than this are taken as so rough: a perfect mirror has no value.
const LEAST_ROUGHNESS: f32 = 1e-3;

impl Brdf {
    /// f, sr⁻¹, for the unit vectors of the surface's normal, towards the light and towards the viewer; 0 where either is
    /// below the surface.
    pub fn value(&self, normal: Vec3, light: Vec3, viewer: Vec3) -> f32 {
        let (cos_l, cos_v) = (normal.dot(light), normal.dot(viewer));
        if cos_l <= 0.0 || cos_v <= 0.0 {
            return 0.0;
        }
        match *self {
            Self::Lambert => 1.0 / PI,
            Self::Phong { exponent } => {
                let mirror = normal * (2.0 * cos_v) - viewer;
                (exponent + 2.0) / (2.0 * PI) * mirror.dot(light).clamp(0.0, 1.0).powf(exponent)
            }
            Self::TorranceSparrow { roughness, normal_reflectance } => {
                let facets = Facets::new(normal, light, viewer);
                let grooves = 2.0 * facets.cos_h * cos_l.min(cos_v) / facets.cos_d;
                let reflected = beckmann(facets.cos_h, roughness) * grooves.min(1.0);
                reflected * fresnel(normal_reflectance, facets.cos_d) / (4.0 * cos_l * cos_v)
            }
            Self::Ggx { roughness, normal_reflectance } => {
                let facets = Facets::new(normal, light, viewer);
                let seen = smith(cos_l, roughness) * smith(cos_v, roughness);
                let reflected = ggx(facets.cos_h, roughness) * seen;
                reflected * fresnel(normal_reflectance, facets.cos_d) / (4.0 * cos_l * cos_v)
            }
        }
    }
}

impl Brdf {
    /// The lobe of a light that comes from a solid angle (sr) instead of a point: as wide as both. Of all facets within α of
    /// the normal the mirror directions fill about 4π α².
    pub fn widened(self, solid_angle_sr: f32) -> Self {
        let rougher = |roughness: f32| (roughness * roughness + solid_angle_sr / (4.0 * PI)).sqrt().min(1.0);
        match self {
            Self::Lambert => self,
            Self::Phong { exponent } => {
                let width = 1.0 / (exponent + 1.0) + solid_angle_sr / (2.0 * PI);
                Self::Phong { exponent: (1.0 / width - 1.0).max(0.0) }
            }
            Self::TorranceSparrow { roughness, normal_reflectance } => {
                Self::TorranceSparrow { roughness: rougher(roughness), normal_reflectance }
            }
            Self::Ggx { roughness, normal_reflectance } => {
                Self::Ggx { roughness: rougher(roughness), normal_reflectance }
            }
        }
    }
}

/// Cosines at the facets that mirror one direction into the other.
struct Facets {
    /// From the normal to theirs.
    cos_h: f32,
    /// From theirs to either direction.
    cos_d: f32,
}

impl Facets {
    fn new(normal: Vec3, light: Vec3, viewer: Vec3) -> Self {
        let half = (light + viewer).normalize_or(normal);
        Self { cos_h: normal.dot(half).clamp(0.0, 1.0), cos_d: half.dot(viewer).clamp(1e-4, 1.0) }
    }
}

/// Share of a surface's facets per solid angle whose normal lies at an angle from its own, sr⁻¹.
fn beckmann(cos: f32, roughness: f32) -> f32 {
    let (m2, c2) = (roughness.max(LEAST_ROUGHNESS).powi(2), (cos * cos).max(1e-6));
    (-(1.0 - c2) / (c2 * m2)).exp() / (PI * m2 * c2 * c2)
}

/// The same by GGX.
pub(crate) fn ggx(cos: f32, roughness: f32) -> f32 {
    let a2 = roughness.max(LEAST_ROUGHNESS).powi(2);
    // cos² (a² − 1) + 1, without the loss of digits near cos = 1.
    let d = cos * cos * a2 + (1.0 - cos) * (1.0 + cos);
    a2 / (PI * d * d)
}

/// Share of facets that are seen at a cosine, by Smith for GGX.
pub(super) fn smith(cos: f32, roughness: f32) -> f32 {
    let a2 = roughness.max(LEAST_ROUGHNESS).powi(2);
    2.0 * cos / (cos + (a2 + (1.0 - a2) * cos * cos).sqrt())
}

/// Reflectance at a cosine of incidence (Schlick 1994).
fn fresnel(normal_reflectance: f32, cos: f32) -> f32 {
    normal_reflectance + (1.0 - normal_reflectance) * grazing(cos)
}

/// Schlick's weight of what is reflected at grazing incidence.
pub(super) fn grazing(cos: f32) -> f32 {
    (1.0 - cos).powi(5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn all(roughness: f32, normal_reflectance: f32) -> [Brdf; 5] {
        [
            Brdf::Lambert,
            Brdf::Phong { exponent: 40.0 },
            Brdf::Phong { exponent: 500.0 },
            Brdf::TorranceSparrow { roughness, normal_reflectance },
            Brdf::Ggx { roughness, normal_reflectance },
        ]
    }

    fn upper(cos: f32, azimuth: f32) -> Vec3 {
        let (sin, (s, c)) = ((1.0 - cos * cos).sqrt(), azimuth.sin_cos());
        Vec3::new(sin * c, sin * s, cos)
    }

    /// ∫ f cos θ dω over the hemisphere of lights.
    fn albedo(brdf: Brdf, viewer: Vec3) -> f64 {
        const STEPS: [usize; 2] = [400, 800];
        let mut sum = 0.0;
        for i in 0..STEPS[0] {
            // Uniform in cos², so that each cell holds the same ∫ cos θ dω.
            let cos = ((i as f32 + 0.5) / STEPS[0] as f32).sqrt();
            for j in 0..STEPS[1] {
                let light = upper(cos, 2.0 * PI * (j as f32 + 0.5) / STEPS[1] as f32);
                sum += f64::from(brdf.value(Vec3::Z, light, viewer));
            }
        }
        sum * std::f64::consts::PI / (STEPS[0] * STEPS[1]) as f64
    }

    proptest! {
        #[test]
        fn light_and_viewer_may_change_places(
            a in 0.01..1.0f32, b in 0.01..1.0f32, turn in 0.0..2.0 * PI, roughness in 0.05..1.0f32, f0 in 0.0..1.0f32,
        ) {
            let (light, viewer) = (upper(a, 0.3), upper(b, turn));
            for brdf in all(roughness, f0) {
                let (there, back) = (brdf.value(Vec3::Z, light, viewer), brdf.value(Vec3::Z, viewer, light));
                prop_assert!(there >= 0.0 && (there - back).abs() <= 2e-3 * (there + back) + 1e-5, "{:?}", brdf);
            }
        }
    }

    #[test]
    fn no_more_light_leaves_than_arrives() {
        for roughness in [0.15, 0.4, 1.0] {
            for brdf in all(roughness, 1.0) {
                for cos in [1.0, 0.7, 0.3, 0.1] {
                    let sent = albedo(brdf, upper(cos, 0.0));
                    assert!(sent < 1.01, "{brdf:?} at {cos}: {sent}");
                }
            }
        }
        assert!((albedo(Brdf::Lambert, Vec3::Z) - 1.0).abs() < 1e-4);
        assert!((albedo(Brdf::Phong { exponent: 40.0 }, Vec3::Z) - 1.0).abs() < 0.01);
    }

    #[test]
    fn a_wide_light_shines_no_brighter_than_its_radiance() {
        // Radiance 1 from a solid angle around the mirror direction: a mirror would show 1.
        for solid_angle in [0.01, 0.1, 0.5] {
            for brdf in all(0.05, 1.0).into_iter().skip(1) {
                let peak = brdf.widened(solid_angle).value(Vec3::Z, Vec3::Z, Vec3::Z) * solid_angle;
                assert!(peak < 1.1, "{brdf:?} by {solid_angle} sr: {peak}");
            }
        }
        assert_eq!(Brdf::Phong { exponent: 40.0 }.widened(0.0), Brdf::Phong { exponent: 40.0 });
    }

    #[test]
    fn what_is_below_the_surface_neither_lights_nor_sees() {
        for brdf in all(0.3, 0.5) {
            assert_eq!(brdf.value(Vec3::Z, -Vec3::Z, Vec3::Z), 0.0);
            assert_eq!(brdf.value(Vec3::Z, Vec3::Z, upper(-0.1, 0.0)), 0.0);
        }
    }
}

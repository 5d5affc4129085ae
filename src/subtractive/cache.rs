//! The radiance cache (decoro2008, §3.1; Miller and Hoffman 1984): what a material sends towards a distant viewer, by
//! normal, as a texture.

use super::{Brdf, Light};
use glam::Vec3;
use rayon::prelude::*;

/// Side of the texture, texels; the paper's.
const SIDE: usize = 128;

/// Radiance by normal, for one material, one view direction and one set of lights.
#[derive(Debug, Clone, Default)]
pub struct RadianceCache {
    made_for: Option<(Brdf, Vec3, Vec<Light>)>,
    /// Axes of the texture; the last one points to the viewer.
    axes: [Vec3; 3],
    texels: Vec<[f32; 3]>,
}

impl RadianceCache {
    /// Makes the cache for a unit vector towards the viewer, or keeps it where nothing changed; says whether it was made.
    /// Its light is that of all `lights`, taken as distant and spread as they are: many of them stand for a whole environment.
    pub fn update(&mut self, brdf: Brdf, viewer: Vec3, lights: &[Light]) -> bool {
        if let Some((b, v, l)) = &self.made_for
            && (*b, *v, l.as_slice()) == (brdf, viewer, lights)
        {
            return false;
        }
        let (a, b) = viewer.any_orthonormal_pair();
        self.axes = [a, b, viewer];
        let axes = self.axes;
        let spread: Vec<_> = lights
            .iter()
            .map(|light| (light.seen_from(Vec3::ZERO).0, brdf.widened(light.extent_sr), light.power))
            .collect();
        let texel = |i: usize| {
            let normal = from_square(
                [(i % SIDE) as f32, (i / SIDE) as f32].map(|t| 2.0 * t / (SIDE - 1) as f32 - 1.0),
            );
            let normal = axes[0] * normal.x + axes[1] * normal.y + axes[2] * normal.z;
            let mut sum = [0.0f32; 3];
            for (direction, brdf, power) in &spread {
                let cos = normal.dot(*direction);
                if cos > 0.0 {
                    let weight = brdf.value(normal, *direction, viewer) * cos;
                    (0..3).for_each(|k| sum[k] += weight * power[k]);
                }
            }
            sum
        };
        self.texels = (0..SIDE * SIDE).into_par_iter().map(texel).collect();
        self.made_for = Some((brdf, viewer, lights.to_vec()));
        true
    }

    /// Radiance (reflectance 1) towards a viewer, bilinear. One who stands near sees each point from a direction of its
    /// own: the entry is that which mirrors the same part of the environment. 0 before the first update.
    pub fn radiance(&self, normal: Vec3, viewer: Vec3) -> [f32; 3] {
        if self.texels.is_empty() {
            return [0.0; 3];
        }
        let mirror = normal * (2.0 * normal.dot(viewer)) - viewer;
        let normal = (mirror + self.axes[2]).normalize_or(normal);
        let local = Vec3::from_array(self.axes.map(|axis| normal.dot(axis)));
        let [u, v] = to_square(local).map(|t| ((t + 1.0) / 2.0).clamp(0.0, 1.0) * (SIDE - 1) as f32);
        let (x, y) = ((u as usize).min(SIDE - 2), (v as usize).min(SIDE - 2));
        let (fx, fy) = (u - x as f32, v - y as f32);
        let at = |dx: usize, dy: usize| self.texels[(y + dy) * SIDE + x + dx];
        let (a, b, c, d) = (at(0, 0), at(1, 0), at(0, 1), at(1, 1));
        std::array::from_fn(|k| {
            (a[k] * (1.0 - fx) + b[k] * fx) * (1.0 - fy) + (c[k] * (1.0 - fx) + d[k] * fx) * fy
        })
    }
}

/// The square (±1) as a hemisphere about +Z, by half an octahedron: even enough up to the silhouette.
fn from_square([u, v]: [f32; 2]) -> Vec3 {
    let (x, y) = ((u + v) / 2.0, (u - v) / 2.0);
    Vec3::new(x, y, 1.0 - x.abs() - y.abs()).normalize()
}

fn to_square(n: Vec3) -> [f32; 2] {
    let n = n / (n.x.abs() + n.y.abs() + n.z.max(0.0)).max(f32::MIN_POSITIVE);
    [n.x + n.y, n.x - n.y]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illuminate::patch::DistantSource;
    use proptest::prelude::*;

    const GLOSSY: Brdf = Brdf::TorranceSparrow { roughness: 0.25, normal_reflectance: 0.3 };

    fn lights() -> Vec<Light> {
        let light = |i: i32| DistantSource {
            direction: Vec3::new((i as f32).sin(), (1.7 * i as f32).cos(), 0.5).normalize(),
            solid_angle_sr: 0.1,
            radiance: [1.0 + i as f32, 2.0, 0.5],
        };
        (0..12).map(|i| Light::distant(&light(i)).as_point()).collect()
    }

    proptest! {
        #[test]
        fn the_square_is_the_hemisphere(u in -1.0..1.0f32, v in -1.0..1.0f32) {
            let [a, b] = to_square(from_square([u, v]));
            prop_assert!((a - u).abs() < 1e-4 && (b - v).abs() < 1e-4);
        }

        #[test]
        fn it_answers_as_direct_summation_does(x in -0.8..0.8f32, y in -0.5..0.5f32) {
            let viewer = Vec3::new(0.2, 0.1, 0.9).normalize();
            let normal = (viewer + Vec3::new(x, y, 0.0)).normalize();
            let mut cache = RadianceCache::default();
            cache.update(GLOSSY, viewer, &lights());
            let found = cache.radiance(normal, viewer);
            for (k, found) in found.into_iter().enumerate() {
                let sent = |l: &Light| {
                    let direction = l.seen_from(Vec3::ZERO).0;
                    GLOSSY.value(normal, direction, viewer) * normal.dot(direction).max(0.0) * l.power[k]
                };
                let exact: f32 = lights().iter().map(sent).sum();
                prop_assert!((found - exact).abs() < 0.02 * exact + 0.02, "{} {}", found, exact);
            }
        }
    }

    #[test]
    fn it_is_made_again_when_material_view_or_light_changes() {
        let mut cache = RadianceCache::default();
        let mut lights = lights();
        assert!(cache.update(GLOSSY, Vec3::Z, &lights));
        assert!(!cache.update(GLOSSY, Vec3::Z, &lights));
        assert!(cache.update(Brdf::Phong { exponent: 20.0 }, Vec3::Z, &lights));
        assert!(cache.update(GLOSSY, Vec3::Z, &lights) && cache.update(GLOSSY, Vec3::X, &lights));
        lights[3].power[1] *= 1.1;
        assert!(cache.update(GLOSSY, Vec3::X, &lights));
    }
}

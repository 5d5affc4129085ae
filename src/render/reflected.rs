//! Light that the object reflects onto the scene: what differential rendering adds where the shadow takes (tutorial eq. 2;
//! Gibson et al. 2003, §4 leave it out).
//!
//! The object's vertices get their irradiance as its pixels do, self-occlusion and its own shadow on the scene counted.
//! Every receiver near enough then sends rays into the cone of the object's bounding sphere. The specular part of a
//! material is spread as if it were diffuse: its energy is kept, caustics are not formed.

use super::object::Object;
use super::shade::{Lighting, Sample, Scene, irradiance};
use crate::image::{Image, Radiance, RadianceImage};
use crate::shadow::{Receiver, Receivers};
use crate::transfer::sampling::{Shift, in_cap};
use crate::visibility::Bvh;
use glam::Vec3;
use rand::{SeedableRng, rngs::SmallRng};
use rayon::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Light that cannot raise a receiver's by more than this share is not sought …
const LEAST_SHARE: f32 = 1e-3;
/// … and fewer rays seek what cannot raise it by more than this.
const FULL_SHARE: f32 = 0.1;
/// Rays leave a receiver by this much, m.
const OFFSET_M: f32 = 1e-4;

/// The object as a source of light.
pub struct Reflector<'a> {
    object: &'a Object,
    bvh: Bvh,
    centre: Vec3,
    /// Of the bounding sphere, m.
    radius: f32,
    /// Radiance by vertex, of the front and, if the mesh is open, of the back, per unit of reflectance.
    sides: Vec<Vec<[f32; 3]>>,
    /// Largest radiance of any vertex.
    brightest: f32,
}

impl<'a> Reflector<'a> {
    /// Lights the object's vertices.
    pub fn new(object: &'a Object, lighting: &Lighting, seed: u64) -> Self {
        let bvh = Bvh::new(&object.vertices, &object.triangles);
        let scene = Scene::new(object, &bvh);
        let lit = |side: f32| -> Vec<[f32; 3]> {
            let vertices = object.vertices.par_iter().zip(&object.normals).enumerate();
            vertices
                .map(|(i, (&position, &normal))| {
                    let mut rng = SmallRng::seed_from_u64(seed ^ (i as u64 + 1) << 20);
                    let sample = Sample::of_surface(position, normal * side);
                    irradiance(&scene, lighting, &sample, &mut rng).map(|e| e / PI)
                })
                .collect()
        };
        let sides: Vec<_> = if object.closed { vec![lit(1.0)] } else { vec![lit(1.0), lit(-1.0)] };
        let reflectance = object.materials.iter().flat_map(|m| (0..3).map(|k| m.diffuse[k] + m.specular[k]));
        let most = sides.iter().flatten().flatten().copied().fold(0.0, f32::max);
        let [low, high] = object.bounds();
        let centre = (low + high) / 2.0;
        Self {
            centre,
            radius: object.vertices.iter().map(|v| v.distance(centre)).fold(0.0, f32::max),
            brightest: most * reflectance.fold(0.0, f32::max),
            object,
            bvh,
            sides,
        }
    }

    /// Radiance that the plate's pixels gain, plate units: the plate's own times the gained over the total irradiance, so
    /// that the plate's reflectance is kept. `total` is the irradiance of a receiver from all light of the empty scene.
    pub fn onto(
        &self,
        receivers: &Receivers,
        plate: &RadianceImage,
        scene: &Bvh,
        total: impl Fn(&Receiver) -> Option<[f32; 3]> + Sync,
        rays: usize,
    ) -> RadianceImage {
        let (width, height) = plate.size();
        let pixels = (0..width * height).into_par_iter().map(|i| {
            let gained = receivers.pixels.pixels()[i].as_ref().and_then(|receiver| {
                let total = total(receiver)?;
                let faintest = total.into_iter().fold(f32::INFINITY, f32::min);
                let e = self.irradiance(receiver, scene, faintest, rays, i as u64);
                let share = |k: usize| if total[k] > 0.0 { e[k] / total[k] } else { 0.0 };
                Some(std::array::from_fn(|k| plate.pixels()[i].0[k].max(0.0) * share(k)))
            });
            Radiance(gained.unwrap_or_default())
        });
        Image::from_pixels(width, height, pixels.collect())
    }

    /// Irradiance of a receiver from the object; none where it is certainly too faint beside `total` (the faintest channel).
    fn irradiance(&self, receiver: &Receiver, scene: &Bvh, total: f32, rays: usize, seed: u64) -> [f32; 3] {
        let origin = receiver.position + receiver.normal * OFFSET_M;
        let to = self.centre - origin;
        let distance = to.length();
        let sine = (self.radius / distance).min(1.0);
        // A sphere has at most the form factor sin².
        let most = self.brightest * PI * sine * sine;
        let behind = to.dot(receiver.normal) < -self.radius;
        if behind || rays == 0 || most < LEAST_SHARE * total {
            return [0.0; 3];
        }
        let rays = (rays as f32 * (most / (FULL_SHARE * total)).min(1.0)).ceil() as u32;
        let shift = Shift::new(seed, 0x0b0e);
        let (axis, angle) =
            if sine < 1.0 { (to / distance, sine.asin()) } else { (receiver.normal, FRAC_PI_2) };
        let weight = TAU * (1.0 - angle.cos()) / rays as f32;
        let mut sum = [0.0f32; 3];
        for i in 0..rays {
            let direction = in_cap(axis, angle, shift.point(i));
            let cosine = direction.dot(receiver.normal);
            if cosine <= 0.0 {
                continue;
            }
            let Some(hit) = self.bvh.closest(origin, direction, 0.0, f32::INFINITY) else { continue };
            // A surface that the object touches does not hide it.
            if scene.any_hit(origin, direction, 0.0, hit.t * (1.0 - 1e-3)) {
                continue;
            }
            let radiance = self.radiance(hit.triangle as usize, hit.barycentric, direction);
            (0..3).for_each(|k| sum[k] += weight * cosine * radiance[k]);
        }
        sum
    }

    /// Radiance against `direction`.
    fn radiance(&self, triangle: usize, weights: [f32; 3], direction: Vec3) -> [f32; 3] {
        let [a, b, c] = self.object.corners(triangle);
        let from_behind = (b - a).cross(c - a).dot(direction) > 0.0;
        let side = &self.sides[usize::from(from_behind).min(self.sides.len() - 1)];
        let corners = self.object.triangles[triangle].map(|v| side[v as usize]);
        let material = &self.object.materials[self.object.material_of[triangle] as usize];
        std::array::from_fn(|k| {
            let lit: f32 = (0..3).map(|v| weights[v] * corners[v][k]).sum();
            (material.diffuse[k] + material.specular[k]) * lit
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Environment, Material, Soup};
    use super::*;
    use crate::transfer::form_factor;

    const E0: f32 = 2.0;

    /// An upright square, 0.4 m a side, whose front looks along +x, at x = 0 from height 0.05 up; its cover from behind
    /// makes the mesh a box if `closed`.
    fn square(closed: bool) -> Object {
        let at = |x: f32, y: f32, z: f32| Vec3::new(x, y + 0.05, z);
        let mut soup = Soup {
            positions: [0.0, -0.02]
                .into_iter()
                .flat_map(|x| [at(x, 0.0, 0.2), at(x, 0.0, -0.2), at(x, 0.4, -0.2), at(x, 0.4, 0.2)])
                .collect(),
            materials: vec![Material {
                diffuse: [0.5, 0.25, 0.0],
                specular: [0.1; 3],
                shininess: 10.0,
                roughness: None,
            }],
            ..Soup::default()
        };
        soup.add_polygon(&[0, 1, 2, 3], None, 0);
        if closed {
            for p in [[7, 6, 5, 4], [0, 3, 7, 4], [1, 5, 6, 2], [0, 4, 5, 1], [3, 2, 6, 7]] {
                soup.add_polygon(&p, None, 0);
            }
        }
        Object::new(soup, 10.0).unwrap()
    }

    fn floor(x: f32, z: f32) -> Receiver {
        Receiver {
            patch: 0,
            barycentric: [1.0, 0.0, 0.0],
            position: Vec3::new(x, 0.0, z),
            normal: Vec3::Y,
            footprint: [Vec3::ZERO; 2],
        }
    }

    fn gained(object: &Object, scene: &Bvh, receiver: Receiver, rays: usize) -> [f32; 3] {
        let environment = Environment { map: Image::from_fn(16, 8, |_, _| Radiance([1.0; 3])) };
        let even = |_: Vec3, _: Vec3| [E0; 3];
        let lighting = Lighting::new(&even, &environment, object, 64, None);
        let receivers = Receivers { pixels: Image::from_pixels(1, 1, vec![Some(receiver)]), seen: vec![0] };
        let plate = Image::from_pixels(1, 1, vec![Radiance([3.0; 3])]);
        let reflector = Reflector::new(object, &lighting, 1);
        let gained = reflector.onto(&receivers, &plate, scene, |_| Some([4.0; 3]), rays).pixels()[0].0;
        // The plate shows 3 where 4 arrive.
        gained.map(|v| v / 3.0 * 4.0)
    }

    #[test]
    fn a_lit_square_sends_its_form_factor() {
        let nothing = Bvh::new(&[], &[]);
        for closed in [true, false] {
            let object = square(closed);
            assert_eq!(object.closed, closed);
            for (x, z) in [(0.1, 0.0), (0.3, 0.1), (0.6, -0.2)] {
                let receiver = floor(x, z);
                // The body is convex: what faces the floor is seen whole.
                let seen = |t| form_factor::polygon(receiver.position, receiver.normal, &object.corners(t));
                let f: f32 = (0..object.triangles.len()).map(seen).sum();
                let e = gained(&object, &nothing, receiver, 4096);
                for (k, reflectance) in [0.6, 0.35, 0.1].into_iter().enumerate() {
                    let expected = reflectance * E0 * f;
                    assert!(
                        (e[k] - expected).abs() < 0.03 * expected,
                        "{closed} {x}: {} of {expected}",
                        e[k]
                    );
                }
            }
        }
    }

    #[test]
    fn the_scene_hides_the_object_and_what_looks_away_gets_nothing() {
        let object = square(true);
        let corners = [(0.0, -1.0), (2.0, -1.0), (2.0, 1.0), (0.0, 1.0)];
        let screen: Vec<Vec3> = corners.map(|(y, z)| Vec3::new(0.05, y, z)).into();
        let screen = Bvh::new(&screen, &[[0, 1, 2], [0, 2, 3]]);
        assert_eq!(gained(&object, &screen, floor(0.3, 0.0), 256), [0.0; 3]);
        let ceiling = Receiver { normal: -Vec3::Y, ..floor(0.3, 0.0) };
        assert_eq!(gained(&object, &Bvh::new(&[], &[]), ceiling, 256), [0.0; 3]);
        assert_eq!(gained(&object, &Bvh::new(&[], &[]), floor(0.3, 0.0), 0), [0.0; 3], "no rays, no light");
        assert_eq!(gained(&object, &Bvh::new(&[], &[]), floor(30.0, 0.0), 256), [0.0; 3], "too far");
    }
}

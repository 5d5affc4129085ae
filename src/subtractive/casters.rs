//! A shadow map of the object for each light (decoro2008, §2 step 2b; the paper has shadow volumes).

use super::{Light, Surface};
use crate::shadow::{Bounds, MapPlan, Occluder, ShadowMap, rasterise};
use crate::visibility::Bvh;
use glam::Vec3;
use rayon::prelude::*;

/// What an object hides from each light.
pub struct Casters {
    plans: Vec<MapPlan>,
    maps: Vec<Option<ShadowMap>>,
    /// For lights too near for a map.
    rays: Option<Bvh>,
    /// Surfaces are looked up so far above themselves, m.
    lift_m: f32,
}

impl Casters {
    /// Draws a map of `size` texels a side for each light.
    pub fn draw(lights: &[Light], occluder: &Occluder, size: usize) -> Self {
        let bounds = Bounds::of(occluder);
        let plan = |light: &Light| MapPlan::new(0, light.origin, 1.0, 0, &bounds, size);
        let plans: Vec<MapPlan> = lights.iter().map(plan).collect();
        let draw = |plan: &MapPlan| plan.projection.map(|p| rasterise(&p, occluder, size));
        let maps: Vec<Option<ShadowMap>> = plans.par_iter().map(draw).collect();
        let rays =
            maps.iter().any(Option::is_none).then(|| Bvh::new(&occluder.vertices, &occluder.triangles));
        Self { plans, maps, rays, lift_m: 0.0 }
    }

    /// The same for what falls on the object itself: looked up a texel above its surface, so that the neighbouring triangles
    /// of a hollow do not hide it.
    pub fn on_itself(lights: &[Light], occluder: &Occluder, size: usize) -> Self {
        let lift_m = 2.0 * Bounds::of(occluder).radius / size.max(1) as f32;
        Self { lift_m, ..Self::draw(lights, occluder, size) }
    }

    /// Number of maps drawn.
    pub fn maps(&self) -> usize {
        self.maps.iter().flatten().count()
    }

    /// Lights from which the object may hide something in a sphere (m).
    pub fn near(&self, centre: Vec3, radius: f32) -> Vec<usize> {
        (0..self.plans.len()).filter(|&i| self.plans[i].may_shadow(centre, radius)).collect()
    }

    /// Whether the object hides a light, in a unit direction, from a surface. A triangle that is turned away while its
    /// smooth normal is not counts as lit: the maps would show the triangles' edges there.
    pub fn hide(&self, light: usize, surface: &Surface, direction: Vec3) -> bool {
        if surface.face_normal.dot(direction) <= 0.0 {
            return false;
        }
        let from = surface.position + surface.face_normal * self.lift_m;
        match (&self.maps[light], &self.rays) {
            (Some(map), _) => map.blocked(from, surface.face_normal),
            (None, Some(object)) => self.plans[light].origin.hidden_by(object, from),
            (None, None) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illuminate::patch::DistantSource;
    use crate::synthetic::{blob, cuboid};

    fn from(direction: Vec3) -> Light {
        let direction = direction.normalize();
        Light::distant(&DistantSource { direction, solid_angle_sr: 0.1, radiance: [1.0; 3] })
    }

    fn surface(position: Vec3, normal: Vec3) -> Surface {
        Surface { position, normal, face_normal: normal, viewer: normal, material: 0, pixel_m: 1e-3 }
    }

    #[test]
    fn a_box_hides_what_lies_behind_it() {
        let casters = Casters::draw(&[from(Vec3::Y)], &cuboid(Vec3::Y, Vec3::splat(0.2)), 64);
        let hidden = |x: f32| casters.hide(0, &surface(Vec3::X * x, Vec3::Y), Vec3::Y);
        assert!(hidden(0.0) && hidden(0.18) && !hidden(0.22));
        assert_eq!((casters.maps(), casters.near(Vec3::X * 3.0, 0.1).len()), (1, 0));
        assert_eq!(casters.near(Vec3::ZERO, 0.1), [0]);
    }

    #[test]
    fn a_round_object_hides_no_light_from_its_lit_side() {
        let sphere = blob(Vec3::ZERO, 0.2, 0.0, 40);
        for light in [Vec3::Y, Vec3::new(1.0, 0.3, 0.2), Vec3::new(-0.4, 0.7, -1.0)] {
            let direction = light.normalize();
            let casters = Casters::on_itself(&[from(light)], &sphere, 256);
            for t in &sphere.triangles {
                let [a, b, c] = t.map(|v| sphere.vertices[v as usize]);
                let Some(normal) = (b - a).cross(c - a).try_normalize() else { continue };
                let (centre, outside) = ((a + b + c) / 3.0, normal * normal.dot(a + b + c).signum());
                if outside.dot(direction) > 0.1 {
                    assert!(!casters.hide(0, &surface(centre, outside), direction), "{centre} from {light}");
                }
            }
        }
    }
}

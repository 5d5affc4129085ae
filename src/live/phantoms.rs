//! Phantom objects (Fuhrmann et al. 1999): what of the real scene receives the object's shadow and hides the object.

use super::Problem;
use crate::calibrate::world_from_grid;
use crate::config;
use crate::model::Scene;
use crate::model::face::triangulate;
use crate::synthetic::cuboid;
use crate::visibility::{Bvh, Hit};
use glam::Vec3;
use nalgebra::{Point3, Rotation3, Vector3};

/// The real scene's surfaces.
pub struct Phantoms {
    /// Their triangles.
    pub bvh: Bvh,
    normal_of: Vec<usize>,
    normals: Vec<Vec3>,
}

/// Back sides looked through.
const BACK_SIDES: usize = 8;
/// What is nearer to a surface lies on it, m.
const TOUCHES_M: f32 = 1e-3;
/// Of cosines.
const ROUNDING: f32 = 1e-6;

impl Phantoms {
    /// Of the settings; `scene` is the model that they name.
    pub fn of(settings: &config::Live, scene: Option<&Scene>) -> Result<Self, Problem> {
        let (mut vertices, mut triangles): (Vec<Vec3>, Vec<[u32; 3]>) = (Vec::new(), Vec::new());
        let world = |p: Point3<f64>| {
            let p = world_from_grid() * p;
            Vec3::new(p.x as f32, p.y as f32, p.z as f32)
        };
        let mut add = |points: Vec<Vec3>, corners: Vec<[u32; 3]>| {
            let base = vertices.len() as u32;
            vertices.extend(points);
            triangles.extend(corners.into_iter().map(|t| t.map(|v| v + base)));
        };
        for plane in &settings.planes {
            let (u, v) = (Vector3::from(plane.side_u_m), Vector3::from(plane.side_v_m));
            if u.cross(&v).norm() <= 1e-9 {
                return Err(Problem::Setting { name: "planes", what: "have one without area".into() });
            }
            let corner = Point3::from(plane.corner_m);
            let corners = [corner, corner + u, corner + u + v, corner + v].map(world);
            add(corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]]);
        }
        for solid in &settings.boxes {
            if solid.size_m.iter().any(|s| *s <= 0.0 || !s.is_finite()) {
                return Err(Problem::Setting { name: "boxes", what: "have one without volume".into() });
            }
            let half = Vec3::from_array(solid.size_m.map(|s| s as f32 / 2.0));
            let shape = cuboid(Vec3::ZERO, half);
            let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), solid.rotation_deg.to_radians());
            let place = |p: &Vec3| {
                let p = turn * Vector3::new(f64::from(p.x), f64::from(p.y), f64::from(p.z));
                world(Point3::from(solid.centre_m) + p)
            };
            add(shape.vertices.iter().map(place).collect(), outward(&shape));
        }
        if let Some(scene) = scene {
            let faces = triangulate(&scene.faces);
            add(faces.vertices, faces.triangles);
        }
        if triangles.is_empty() {
            return Err(Problem::NotGiven("planes"));
        }
        let (mut normals, mut normal_of): (Vec<Vec3>, Vec<usize>) = (Vec::new(), Vec::new());
        for t in &triangles {
            let [a, b, c] = t.map(|v| vertices[v as usize]);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let known = normals.iter().position(|n| n.dot(normal) > 0.99999);
            normal_of.push(known.unwrap_or(normals.len()));
            if known.is_none() {
                normals.push(normal);
            }
        }
        Ok(Self { bvh: Bvh::new(&vertices, &triangles), normal_of, normals })
    }

    /// All normals that there are.
    pub fn normals(&self) -> &[Vec3] {
        &self.normals
    }

    /// Lowest and highest coordinates, m.
    pub fn bounds(&self) -> [Vec3; 2] {
        let corners = self.bvh.triangles().flatten();
        corners.fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[a, b], p| [a.min(p), b.max(p)])
    }

    /// The first front that a ray meets: place (m) and number of its normal. `closest` finds what the ray meets first from a
    /// distance on.
    pub fn seen(
        &self,
        origin: Vec3,
        direction: Vec3,
        closest: impl Fn(f32) -> Option<Hit>,
    ) -> Option<(Vec3, usize)> {
        let mut from = 1e-4;
        for _ in 0..BACK_SIDES {
            let hit = closest(from)?;
            let normal = self.normal_of[hit.triangle as usize];
            if self.normals[normal].dot(direction) < 0.0 {
                return Some((origin + direction * hit.t, normal));
            }
            from = hit.t * (1.0 + 1e-5) + 1e-5;
        }
        None
    }

    /// Whether one of them may hide light of a direction from something in a box (m); may say yes where none does. What lies on
    /// a surface is not hidden by it.
    pub fn may_hide(&self, [low, high]: [Vec3; 2], direction: Vec3) -> bool {
        let (centre, half) = ((low + high) / 2.0, (high - low) / 2.0);
        self.bvh.triangles().zip(&self.normal_of).any(|(corners, &normal)| {
            let normal = self.normals[normal];
            let (at, reach) = (normal.dot(centre - corners[0]), normal.abs().dot(half));
            let towards = normal.dot(direction);
            // All of the box on one side, and the light on the same.
            let before = at - reach > -TOUCHES_M && towards >= -ROUNDING;
            let behind = at + reach < TOUCHES_M && towards <= ROUNDING;
            // The sphere around the triangle off the way of the sphere around the box.
            let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
            let radius = corners.iter().map(|c| c.distance(middle)).fold(0.0, f32::max) + half.length();
            let way = middle - centre;
            let along = way.dot(direction);
            let beside = along < -radius || way.length_squared() - along * along > radius * radius;
            !(before || behind || beside)
        })
    }
}

/// Triangles of a convex shape around the origin, turned to the outside.
fn outward(shape: &crate::shadow::Occluder) -> Vec<[u32; 3]> {
    let turned = |&[a, b, c]: &[u32; 3]| {
        let [p, q, r] = [a, b, c].map(|v| shape.vertices[v as usize]);
        if (q - p).cross(r - p).dot(p + q + r) < 0.0 { [a, c, b] } else { [a, b, c] }
    };
    shape.triangles.iter().map(turned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_on_a_plane_shows_its_top_and_sides() {
        let plane = config::PhantomPlane {
            corner_m: [-1.0, -1.0, 0.0],
            side_u_m: [2.0, 0.0, 0.0],
            side_v_m: [0.0, 2.0, 0.0],
        };
        let solid = config::PhantomBox { centre_m: [0.2, 0.0, 0.1], size_m: [0.2; 3], rotation_deg: 0.0 };
        let settings = config::Live { planes: vec![plane], boxes: vec![solid], ..Default::default() };
        let phantoms = Phantoms::of(&settings, None).unwrap();
        let seen = |origin, direction| {
            let closest = |from| phantoms.bvh.closest(origin, direction, from, f32::INFINITY);
            phantoms.seen(origin, direction, closest)
        };
        let down = |x: f32| seen(Vec3::new(x, 1.0, 0.0), Vec3::NEG_Y).unwrap();
        assert!(down(-0.5).0.y.abs() < 1e-6 && (down(0.2).0.y - 0.2).abs() < 1e-6);
        let (place, normal) = seen(Vec3::new(-1.0, 0.1, 0.0), Vec3::X).unwrap();
        assert!((place.x - 0.1).abs() < 1e-6 && phantoms.normals()[normal].dot(Vec3::NEG_X) > 0.999);
        assert_eq!(seen(Vec3::NEG_Y, Vec3::Y).map(|h| h.1), None, "from below there are backs only");
    }

    #[test]
    fn what_may_hide_a_light_is_never_left_out() {
        let plane = config::PhantomPlane {
            corner_m: [-1.0, -1.0, 0.0],
            side_u_m: [2.0, 0.0, 0.0],
            side_v_m: [0.0, 2.0, 0.0],
        };
        let plane = config::Live { planes: vec![plane], ..Default::default() };
        let with_box = config::Live {
            boxes: vec![config::PhantomBox {
                centre_m: [0.2, 0.0, 0.1],
                size_m: [0.2; 3],
                rotation_deg: 30.0,
            }],
            ..plane.clone()
        };
        let [plane, with_box] = [plane, with_box].map(|s| Phantoms::of(&s, None).unwrap());
        let (mut yes, mut no) = (0, 0);
        for i in 0..2000 {
            let part = |k: usize| ((i * k) as f32 * 0.618_034).fract();
            let low = Vec3::new(part(1) - 0.5, 0.3 * part(2), part(3) - 0.5);
            let area = [low, low + Vec3::new(0.05, 0.05 * part(7), 0.05)];
            let direction = Vec3::new(part(4) - 0.5, 0.7 * part(5), part(6) - 0.5).normalize();
            assert!(!plane.may_hide(area, direction), "nothing above a plane is hidden by it");
            let inside =
                |k: usize| area[0] + (area[1] - area[0]) * Vec3::new(part(k + 9), part(k + 10), part(k + 11));
            // What is touched does not hide.
            let hidden = |k| {
                let hit = with_box.bvh.closest(inside(k), direction, 1e-4, f32::INFINITY);
                hit.is_some_and(|hit| {
                    let normal = with_box.normals[with_box.normal_of[hit.triangle as usize]];
                    hit.t * normal.dot(direction).abs() > TOUCHES_M
                })
            };
            let hides = with_box.may_hide(area, direction);
            assert!(hides || !(0..20).any(hidden), "{area:?} {direction}");
            *if hides { &mut yes } else { &mut no } += 1;
        }
        assert!(yes > 100 && no > 500, "{yes} {no}");
    }

    #[test]
    fn nothing_and_flat_things_are_refused() {
        let said = |settings: config::Live| Phantoms::of(&settings, None).err().map(|e| e.to_string());
        assert_eq!(said(config::Live::default()).as_deref(), Some("`live.planes` is not given"));
        let flat =
            config::PhantomPlane { corner_m: [0.0; 3], side_u_m: [1.0, 0.0, 0.0], side_v_m: [2.0, 0.0, 0.0] };
        let flat = config::Live { planes: vec![flat], ..Default::default() };
        assert_eq!(said(flat).as_deref(), Some("`live.planes` have one without area"));
        let thin = config::PhantomBox { centre_m: [0.0; 3], size_m: [0.1, 0.0, 0.1], rotation_deg: 0.0 };
        let thin = config::Live { boxes: vec![thin], ..Default::default() };
        assert_eq!(said(thin).as_deref(), Some("`live.boxes` have one without volume"));
    }
}

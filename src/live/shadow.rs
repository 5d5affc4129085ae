//! What the object's shadow takes from the real scene (§V.D, phantom objects): the share that the shadow buffer R has of the
//! irradiance E at each place, B R / E. Light that a real thing already takes from a place is in neither.

use super::Phantoms;
use crate::camera::Camera;
use crate::dome::{DomeLight, DomeMaps, irradiance};
use crate::image::{Image, Radiance, RadianceImage};
use crate::subtractive::{Surface, pixel_angle};
use crate::visibility::Screen;
use glam::Vec3;
use nalgebra::{Point2, Point3};
use rayon::prelude::*;

/// Side of a tile whose pixels are looked up together, px.
const TILE: usize = 16;
/// Rays to lights leave a surface by this much, m.
const OFFSET_M: f32 = 1e-4;
/// Nothing is seen that is nearer to the camera, m.
const NEAR_M: f64 = 0.01;

/// The dome among real things.
pub(super) struct Dome<'a> {
    pub phantoms: &'a Phantoms,
    pub maps: &'a DomeMaps,
    /// All lights above the horizon, those without map too.
    lights: &'a [DomeLight],
    /// Whether a light comes from beyond all real things: that of a real thing itself is hidden by none.
    beyond: Vec<bool>,
    /// By light of the maps, its number among all.
    numbers: Vec<usize>,
    /// Irradiance by normal where nothing is hidden.
    open: Vec<[f32; 3]>,
}

impl<'a> Dome<'a> {
    /// `beyond` says whether the environment's picture shows what lies beyond all real things in a light's direction.
    pub fn new(
        phantoms: &'a Phantoms,
        maps: &'a DomeMaps,
        lights: &'a [DomeLight],
        beyond: impl Fn(Vec3) -> bool,
    ) -> Self {
        let number = |l: &DomeLight| lights.iter().position(|other| other.cell == l.cell).unwrap_or(0);
        Self {
            phantoms,
            maps,
            lights,
            beyond: lights.iter().map(|l| beyond(l.source.direction)).collect(),
            numbers: maps.lights().map(number).collect(),
            open: phantoms.normals().iter().map(|n| irradiance(lights, *n)).collect(),
        }
    }

    /// By light of the maps, whether a real thing may hide it from something in a box, m.
    pub fn may_be_hidden(&self, within: [Vec3; 2]) -> Vec<bool> {
        let may =
            |&i: &usize| self.beyond[i] && self.phantoms.may_hide(within, self.lights[i].source.direction);
        self.numbers.iter().map(may).collect()
    }

    /// Radiance that leaves a plate.
    pub fn removed(&self, camera: &Camera, plate: &RadianceImage, opacity: f32) -> RadianceImage {
        let (width, height) = plate.size();
        let mut removed = Image::filled(width, height, Radiance::default());
        if self.maps.lights().len() == 0 {
            return removed;
        }
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let screen = Screen::new(&self.phantoms.bvh, camera);
        let bodies = self.maps.shadowed(self.phantoms.bounds());
        let reached = reached(camera, &bodies, [columns, rows]);
        let tiles: Vec<Vec<(usize, [f32; 3])>> = (0..columns * rows)
            .into_par_iter()
            .filter(|&tile| reached[tile])
            .map(|tile| self.tile(camera, &screen, [tile % columns * TILE, tile / columns * TILE]))
            .collect();
        for (i, share) in tiles.into_iter().flatten() {
            let b = plate.pixels()[i].0;
            removed.pixels_mut()[i] = Radiance([0, 1, 2].map(|k| opacity * share[k] * b[k]));
        }
        removed
    }

    /// The pixels of a tile that lose light, and which share of it.
    fn tile(&self, camera: &Camera, screen: &Screen, [left, top]: [usize; 2]) -> Vec<(usize, [f32; 3])> {
        let lens = &camera.intrinsics;
        let (width, height) = (lens.width_px as usize, lens.height_px as usize);
        let (origin, turn) = (camera.centre(), camera.world_from_camera.rotation.to_rotation_matrix());
        let origin = Vec3::new(origin.x as f32, origin.y as f32, origin.z as f32);
        let pixel_rad = pixel_angle(camera);
        let (mut at, mut surfaces, mut normals) = (Vec::new(), Vec::new(), Vec::new());
        for (y, x) in
            (top..height.min(top + TILE)).flat_map(|y| (left..width.min(left + TILE)).map(move |x| (y, x)))
        {
            let d = turn * lens.direction(&Point2::new(x as f64 + 0.5, y as f64 + 0.5)).into_inner();
            let direction = Vec3::new(d.x as f32, d.y as f32, d.z as f32);
            let closest = |from| screen.closest([x, y], origin, direction, from, f32::INFINITY);
            let Some((position, normal)) = self.phantoms.seen(origin, direction, closest) else { continue };
            at.push(y * width + x);
            normals.push(normal);
            let n = self.phantoms.normals()[normal];
            let pixel_m = origin.distance(position) * pixel_rad;
            surfaces.push(Surface {
                position,
                normal: n,
                face_normal: n,
                viewer: -direction,
                material: 0,
                pixel_m,
            });
        }
        let mut gone = self.maps.shadow_buffer(&surfaces, |_, _| false);
        if gone.iter().all(|g| *g == [0.0; 3]) {
            return Vec::new();
        }
        let low = surfaces.iter().fold(Vec3::INFINITY, |a, s| a.min(s.position));
        let high = surfaces.iter().fold(Vec3::NEG_INFINITY, |a, s| a.max(s.position));
        let may =
            |i: usize| self.beyond[i] && self.phantoms.may_hide([low, high], self.lights[i].source.direction);
        let may: Vec<bool> = (0..self.lights.len()).map(may).collect();
        let hidden = |i: usize, at: usize| {
            let Surface { position, normal, .. } = surfaces[at];
            let (from, direction) = (position + normal * OFFSET_M, self.lights[i].source.direction);
            may[i] && self.phantoms.bvh.any_hit(from, direction, 0.0, f32::INFINITY)
        };
        let some = may.iter().any(|m| *m);
        if some {
            gone = self.maps.shadow_buffer(&surfaces, |i, at| hidden(self.numbers[i], at));
        }
        let share = |at: usize| {
            let mut all = self.open[normals[at]];
            let taken = (0..self.lights.len()).filter(|&i| some && hidden(i, at));
            for light in taken.map(|i| &self.lights[i]) {
                let (cos, power) = (surfaces[at].normal.dot(light.source.direction).max(0.0), light.power());
                (0..3).for_each(|k| all[k] -= cos * power[k]);
            }
            [0, 1, 2].map(|k| if all[k] > 0.0 { (gone[at][k] / all[k]).min(1.0) } else { 0.0 })
        };
        (0..at.len()).filter(|&i| gone[i] != [0.0; 3]).map(|i| (at[i], share(i))).collect()
    }
}

/// Tiles in which a camera sees something of bodies, given by their corners; may name more.
fn reached(camera: &Camera, bodies: &[[Vec3; 16]], [columns, rows]: [usize; 2]) -> Vec<bool> {
    let mut reached = vec![false; columns * rows];
    if camera.intrinsics.distortion != [0.0; 5] {
        // Edges are bent.
        return vec![true; columns * rows];
    }
    for body in bodies {
        let corners = body.map(|v| {
            let p = Point3::from(v.as_dvec3().to_array());
            camera.world_from_camera.inverse_transform_point(&p)
        });
        let (front, behind): (Vec<_>, Vec<_>) = corners.iter().partition(|p| p.z > NEAR_M);
        let crossing = |a: &Point3<f64>, b: &Point3<f64>| a + (b - a) * ((NEAR_M - a.z) / (b.z - a.z));
        let cut = front.iter().flat_map(|a| behind.iter().map(|b| crossing(a, b)));
        let seen: Vec<Point3<f64>> = front.iter().copied().chain(cut).collect();
        let corners: Vec<Point2<f64>> = seen.iter().filter_map(|p| camera.intrinsics.project(p)).collect();
        if corners.is_empty() {
            continue;
        }
        let hull = hull(corners);
        for row in 0..rows {
            // What of the hull lies between the row's borders: corners, and where sides cross a border.
            let borders = [row, row + 1].map(|r| (r * TILE) as f64);
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            let mut reach = |x: f64| (low, high) = (low.min(x), high.max(x));
            for (i, a) in hull.iter().enumerate() {
                let b = hull[(i + 1) % hull.len()];
                if (borders[0]..=borders[1]).contains(&a.y) {
                    reach(a.x);
                }
                for border in borders {
                    let along = (border - a.y) / (b.y - a.y);
                    if (0.0..=1.0).contains(&along) {
                        reach(a.x + along * (b.x - a.x));
                    }
                }
            }
            let [from, to] = [low, high + TILE as f64].map(|x| (x / TILE as f64).max(0.0) as usize);
            for column in from..to.min(columns) {
                reached[row * columns + column] = true;
            }
        }
    }
    reached
}

/// The convex hull of points, in one turn (Andrew's monotone chain).
fn hull(mut points: Vec<Point2<f64>>) -> Vec<Point2<f64>> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let half = |points: &mut dyn Iterator<Item = &Point2<f64>>| {
        let mut chain: Vec<Point2<f64>> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..]
                && (b - a).perp(&(p - a)) <= 0.0
            {
                chain.pop();
            }
            chain.push(*p);
        }
        chain.pop();
        chain
    };
    let mut hull = half(&mut points.iter());
    hull.extend(half(&mut points.iter().rev()));
    hull
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::camera;

    #[test]
    fn tiles_that_see_a_body_are_all_reached_and_those_far_off_are_not() {
        let camera = camera([0.3, 0.6, 0.9], [0.0, 0.0, 0.0], 320, 240, 260.0);
        let along = Vec3::new(-0.5, -0.4, 0.1);
        let body: [Vec3; 16] = std::array::from_fn(|i| {
            let corner = Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2 & 1) as f32) * 0.1;
            corner + along * (i >> 3) as f32
        });
        let reached = reached(&camera, &[body], [20, 15]);
        let part = |i: usize, k: usize| ((i * k) as f32 * 0.618_034).fract();
        for i in 0..3000 {
            let inside = Vec3::new(part(i, 1), part(i, 2), part(i, 3)) * 0.1 + along * part(i, 5);
            let p = camera.project(&Point3::from(inside.as_dvec3().to_array())).unwrap();
            if (0.0..320.0).contains(&p.x) && (0.0..240.0).contains(&p.y) {
                assert!(reached[p.y as usize / TILE * 20 + p.x as usize / TILE], "{p}");
            }
        }
        let count = reached.iter().filter(|r| **r).count();
        assert!((20..160).contains(&count), "{count} of 300");
    }
}

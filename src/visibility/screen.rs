//! Which triangles each part of a camera's picture can show, so that its rays ask these few and not a hierarchy.

use super::{Bvh, Hit, ray};
use crate::camera::Camera;
use glam::Vec3;
use nalgebra::{Point2, Point3};

/// Side of a tile of the picture, px.
const TILE: usize = 4;
/// Tiles that more triangles may show ask the hierarchy.
const MOST: usize = 32;
/// Added around projected corners, px.
const ROUNDING_PX: f64 = 0.01;
/// The same of a lens with distortion, as a share of the picture.
const BEND: f64 = 0.02;
/// Corners farther out than those of the picture by this factor are not bounded where there is distortion.
const WIDER: f64 = 1.3;
/// Nearer corners count as behind the camera, m.
const NEAR_M: f64 = 1e-4;

/// Triangles by tile of a picture. Answers are those of the hierarchy; of triangles that meet a ray at the same distance,
/// at an edge, it may name another.
pub struct Screen<'a> {
    bvh: &'a Bvh,
    columns: usize,
    /// Where the triangles of a tile begin; one more at the end.
    starts: Vec<u32>,
    triangles: Vec<u32>,
    /// Those that corners do not bound; none: there are too many of them, and the hierarchy is asked.
    everywhere: Option<Vec<u32>>,
}

/// Where in a picture a triangle may be seen.
enum Place {
    Nowhere,
    /// `[left, top, right, bottom]`, tiles.
    Within([usize; 4]),
    /// It reaches behind the camera, or so far out that its distortion is not that of the picture.
    Anywhere,
}

impl<'a> Screen<'a> {
    /// Of the triangles of a hierarchy as a camera sees them.
    pub fn new(bvh: &'a Bvh, camera: &Camera) -> Self {
        let (width, height) = (camera.intrinsics.width_px as usize, camera.intrinsics.height_px as usize);
        let (columns, rows) = (width.div_ceil(TILE).max(1), height.div_ceil(TILE).max(1));
        let view = View::new(camera, [columns, rows]);
        let (mut bounded, mut everywhere) = (Vec::new(), Vec::new());
        for (i, corners) in (0..).zip(bvh.triangles()) {
            match view.place(&corners) {
                Place::Nowhere => {}
                Place::Within(tiles) => bounded.push((i, tiles)),
                Place::Anywhere => everywhere.push(i),
            }
        }
        let of = |[left, top, right, bottom]: [usize; 4]| {
            (top..bottom).flat_map(move |row| (left..right).map(move |column| row * columns + column))
        };
        let mut starts = vec![0u32; columns * rows + 1];
        for (_, tiles) in &bounded {
            of(*tiles).for_each(|tile| starts[tile + 1] += 1);
        }
        (0..columns * rows).for_each(|tile| starts[tile + 1] += starts[tile]);
        let mut next = starts.clone();
        let mut triangles = vec![0; starts[columns * rows] as usize];
        for (triangle, tiles) in bounded {
            for tile in of(tiles) {
                triangles[next[tile] as usize] = triangle;
                next[tile] += 1;
            }
        }
        let everywhere = (everywhere.len() <= MOST).then_some(everywhere);
        Self { bvh, columns, starts, triangles, everywhere }
    }

    /// Triangles that pixel `(x, y)` may show; none where they are too many.
    fn of(&self, [x, y]: [usize; 2]) -> Option<impl Iterator<Item = u32> + '_> {
        let tile = y / TILE * self.columns + x / TILE;
        let own = &self.triangles[self.starts[tile] as usize..self.starts[tile + 1] as usize];
        let everywhere = self.everywhere.as_ref()?;
        (own.len() <= MOST).then(|| own.iter().chain(everywhere).copied())
    }

    /// Whether no triangle can be seen in pixel `(x, y)`.
    pub fn is_empty(&self, x: usize, y: usize) -> bool {
        self.of([x, y]).is_some_and(|mut few| few.next().is_none())
    }

    /// [`Bvh::closest`] of a ray that the camera sees in pixel `at`.
    pub fn closest(
        &self,
        at: [usize; 2],
        origin: Vec3,
        direction: Vec3,
        t_min: f32,
        t_max: f32,
    ) -> Option<Hit> {
        let Some(few) = self.of(at) else { return self.bvh.closest(origin, direction, t_min, t_max) };
        let mut ray = ray(origin, direction, t_min, t_max);
        let mut found = None;
        for triangle in few {
            let t = self.bvh.triangles[triangle as usize].intersect(&ray);
            if t < ray.tmax {
                (ray.tmax, found) = (t, Some(triangle));
            }
        }
        let triangle = found?;
        let barycentric = self.bvh.barycentric(triangle, origin + direction * ray.tmax);
        Some(Hit { triangle, t: ray.tmax, barycentric })
    }

    /// [`Bvh::any_hit`] of a ray that the camera sees in pixel `at`.
    pub fn any_hit(&self, at: [usize; 2], origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> bool {
        let Some(mut few) = self.of(at) else { return self.bvh.any_hit(origin, direction, t_min, t_max) };
        let ray = ray(origin, direction, t_min, t_max);
        few.any(|triangle| self.bvh.triangles[triangle as usize].intersect(&ray) < t_max)
    }
}

/// A camera and the tiles of its picture.
struct View<'a> {
    camera: &'a Camera,
    tiles: [usize; 2],
    /// Added on all sides, px: distortion bends edges between corners.
    margin: f64,
    /// Corners farther from the axis than this tangent are not bounded.
    widest: f64,
}

impl<'a> View<'a> {
    fn new(camera: &'a Camera, tiles: [usize; 2]) -> Self {
        let lens = &camera.intrinsics;
        let (width, height) = (f64::from(lens.width_px), f64::from(lens.height_px));
        let (mut margin, mut widest) = (ROUNDING_PX, f64::INFINITY);
        if lens.distortion != [0.0; 5] {
            margin = BEND * width.max(height);
            let corners = [[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]];
            let tangent = |[x, y]: [f64; 2]| {
                let d = lens.direction(&Point2::new(x, y));
                d.x.hypot(d.y) / d.z
            };
            widest = WIDER * corners.map(tangent).into_iter().fold(0.0, f64::max);
        }
        Self { camera, tiles, margin, widest }
    }

    fn place(&self, corners: &[Vec3; 3]) -> Place {
        let seen = corners.map(|v| {
            let p = Point3::from(v.as_dvec3().to_array());
            self.camera.world_from_camera.inverse_transform_point(&p)
        });
        match seen.iter().filter(|p| p.z > NEAR_M).count() {
            0 => return Place::Nowhere,
            3 => {}
            _ => return Place::Anywhere,
        }
        if seen.iter().any(|p| p.x.hypot(p.y) > self.widest * p.z) {
            return Place::Anywhere;
        }
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in seen.iter().filter_map(|p| self.camera.intrinsics.project(p)) {
            for k in 0..2 {
                (low[k], high[k]) = (low[k].min(p[k] - self.margin), high[k].max(p[k] + self.margin));
            }
        }
        let from = |k: usize| (low[k].max(0.0) / TILE as f64) as usize;
        let to = |k: usize| if high[k] < 0.0 { 0 } else { (high[k] / TILE as f64) as usize + 1 };
        let [left, top] = [0, 1].map(from);
        let [right, bottom] = [0, 1].map(|k| to(k).min(self.tiles[k]));
        if left < right && top < bottom { Place::Within([left, top, right, bottom]) } else { Place::Nowhere }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::synthetic::{blob, camera};

    #[test]
    fn a_screen_answers_as_the_hierarchy_does() {
        let mut object = blob(Vec3::Y * 0.1, 0.08, 0.3, 16);
        // A floor that reaches behind the camera.
        let base = object.vertices.len() as u32;
        object.vertices.extend([
            Vec3::new(-9.0, 0.0, -9.0),
            Vec3::new(9.0, 0.0, -9.0),
            Vec3::new(9.0, 0.0, 9.0),
            Vec3::new(-9.0, 0.0, 9.0),
        ]);
        object.triangles.extend([[base, base + 2, base + 1], [base, base + 3, base + 2]]);
        let bvh = Bvh::new(&object.vertices, &object.triangles);
        for distortion in [[0.0; 5], [-0.2, 0.05, 0.001, -0.002, 0.0]] {
            let mut camera = camera([0.2, 0.3, 0.6], [0.0, 0.05, 0.0], 120, 90, 110.0);
            camera.intrinsics = Intrinsics { distortion, ..camera.intrinsics };
            let screen = Screen::new(&bvh, &camera);
            let mut hits = 0;
            for (y, x) in (0..90).flat_map(|y| (0..120).map(move |x| (y, x))) {
                for part in [0.02, 0.5, 0.97] {
                    let ray = camera.ray(&Point2::new(x as f64 + part, y as f64 + 1.0 - part));
                    let vec3 = |v: [f64; 3]| Vec3::from_array(v.map(|c| c as f32));
                    let (o, d) = (vec3(ray.origin.coords.into()), vec3(ray.direction.into_inner().into()));
                    let plain = bvh.closest(o, d, 0.0, f32::INFINITY).map(|h| h.t);
                    assert_eq!(screen.closest([x, y], o, d, 0.0, f32::INFINITY).map(|h| h.t), plain);
                    assert_eq!(
                        screen.any_hit([x, y], o, d, 0.0, 0.7),
                        bvh.any_hit(o, d, 0.0, 0.7),
                        "({x}, {y})"
                    );
                    hits += usize::from(plain.is_some());
                }
            }
            assert!(hits > 10_000, "{hits}");
        }
    }
}

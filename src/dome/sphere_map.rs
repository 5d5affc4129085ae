//! Which direction every pixel of a mirror ball or of a fisheye's picture shows (supan2006, §III), and the cube map of it
//! (§VI.1): each part of a pixel adds what it shows over the solid angle that it shows.

use super::cube::{CubeMap, Sums};
use crate::camera::Camera;
use crate::image::{Image, Radiance, RadianceImage};
use crate::maps::spherical_triangle;
use crate::probe::fisheye::Projection;
use crate::probe::mirror_ball::reflected_ray;
use crate::probe::outline;
use glam::{Mat3, Vec3};
use nalgebra::{Point2, Point3, Vector3};
use rayon::prelude::*;

/// Parts of a pixel along each side.
const PARTS: usize = 3;
/// One less where more pixels than these show the environment across.
const LARGE_PX: usize = 90;
/// Reflections closer to the ball's outline than this mix with what stands behind it, px.
const BLIND_PX: f64 = 1.5;
/// Smallest ball that shows an environment, px across.
const LEAST_PX: f64 = 12.0;
/// Of the outline, so much may lie outside the picture.
const MOST_OUTSIDE: f64 = 0.02;

/// Why a frame does not show its environment.
#[derive(Debug, Clone, Copy, thiserror::Error, PartialEq)]
pub enum Problem {
    /// Out of the picture, or cut off.
    #[error("the mirror ball is out of the frame: {:.0} % of its outline lie outside", 100.0 * outside)]
    OutOfFrame {
        /// Share of the outline outside.
        outside: f64,
    },
    /// Too far away.
    #[error("the mirror ball is {diameter_px:.0} px across, at least {LEAST_PX} px are needed")]
    Small {
        /// Its diameter, px.
        diameter_px: f64,
    },
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::OutOfFrame { .. } => {
                "check live.ball_centre_m and probe.radius_m, or keep the ball in the picture"
            }
            Self::Small { .. } => "go nearer, use a larger ball, or a second camera that looks at it",
        }
        .into()
    }
}

/// A fisheye lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fisheye {
    /// How far from the middle a direction is seen.
    pub projection: Projection,
    /// f, px per rad.
    pub focal_px: f64,
    /// Principal point, px.
    pub centre_px: [f64; 2],
    /// Half its field of view, rad.
    pub half_field: f64,
    /// Its right, down and forward in the world.
    pub world_from_camera: Mat3,
}

impl Fisheye {
    /// Unit direction seen at a place of the picture (px), nothing outside its field.
    pub fn direction(&self, x: f64, y: f64) -> Option<Vec3> {
        let [x, y] = [(x - self.centre_px[0]) / self.focal_px, (y - self.centre_px[1]) / self.focal_px];
        let radius = x.hypot(y);
        let angle = self.projection.angle(radius)?;
        let (sin, cos) = angle.sin_cos();
        let across = if radius > 1e-12 { sin / radius } else { 1.0 };
        let seen = Vec3::new((x * across) as f32, (y * across) as f32, cos as f32);
        (angle < self.half_field).then(|| self.world_from_camera * seen)
    }

    /// Place (px) of a unit direction, and its angle from the lens's axis; nothing outside its field.
    pub fn pixel(&self, direction: Vec3) -> Option<([f64; 2], f64)> {
        let seen = (self.world_from_camera.transpose() * direction).as_dvec3();
        let across = seen.x.hypot(seen.y);
        let angle = across.atan2(seen.z);
        let scale = if across > 1e-12 { self.projection.radius(angle) / across } else { 0.0 };
        let at = [seen.x, seen.y].map(|v| self.focal_px * scale * v);
        (angle < self.half_field).then(|| ([at[0] + self.centre_px[0], at[1] + self.centre_px[1]], angle))
    }
}

/// A part of a pixel and what it shows.
struct Part {
    pixel: u32,
    direction: Vec3,
    solid_angle: f64,
}

/// The layout of a picture that shows the environment.
pub struct SphereMap {
    size: (usize, usize),
    parts: Vec<Part>,
}

/// An environment as a picture shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Its radiance.
    pub cube: CubeMap,
    /// The part of it from pixels that are clipped: it is brighter than that.
    pub clipped: CubeMap,
}

impl SphereMap {
    /// Of a ball as a camera sees it. What it shows lies at a distance from it (m; 0: at infinity), for a reflection starts on
    /// the ball and not in its middle.
    pub fn of_ball(
        camera: &Camera,
        centre: &Point3<f64>,
        radius_m: f64,
        distance_m: f64,
    ) -> Result<Self, Problem> {
        let size = (camera.intrinsics.width_px as usize, camera.intrinsics.height_px as usize);
        let (w, h) = (size.0 as f64, size.1 as f64);
        let outline = outline::project(camera, centre, radius_m, 64).unwrap_or_default();
        let inside = |p: &&Point2<f64>| (0.0..w).contains(&p.x) && (0.0..h).contains(&p.y);
        let outside = 1.0 - outline.iter().filter(inside).count() as f64 / 64.0;
        if outside > MOST_OUTSIDE {
            return Err(Problem::OutOfFrame { outside });
        }
        let radius_px = outline::radius_px(&outline);
        if 2.0 * radius_px < LEAST_PX {
            return Err(Problem::Small { diameter_px: 2.0 * radius_px });
        }
        let low = outline.iter().fold([w, h], |a, p| [a[0].min(p.x), a[1].min(p.y)]);
        let high = outline.iter().fold([0.0f64; 2], |a, p| [a[0].max(p.x), a[1].max(p.y)]);
        let eye = camera.centre();
        let show = |pixel: Point2<f64>| {
            let ray = reflected_ray(camera, centre, radius_m, &pixel)?;
            let normal = (ray.origin - centre) / radius_m;
            let cosine = (eye - ray.origin).normalize().dot(&normal).clamp(0.0, 1.0);
            let from_outline = radius_px * (1.0 - (1.0 - cosine * cosine).sqrt());
            let direction = ray.direction.into_inner();
            let from_middle =
                if distance_m > 0.0 { (ray.origin - centre) / distance_m } else { Vector3::zeros() };
            (from_outline > BLIND_PX).then_some((direction + from_middle).normalize())
        };
        Ok(Self::new(size, low, high, |p| show(p).map(|d| Vec3::new(d.x as f32, d.y as f32, d.z as f32))))
    }

    /// Of a fisheye's picture of a size, px.
    pub fn of_fisheye(lens: &Fisheye, size: (usize, usize)) -> Self {
        Self::new(size, [0.0; 2], [size.0 as f64, size.1 as f64], |p| lens.direction(p.x, p.y))
    }

    fn new(
        size: (usize, usize),
        low: [f64; 2],
        high: [f64; 2],
        show: impl Fn(Point2<f64>) -> Option<Vec3> + Sync,
    ) -> Self {
        let (left, top) = (low[0].max(0.0) as usize, low[1].max(0.0) as usize);
        let (right, bottom) = ((high[0].ceil() as usize).min(size.0), (high[1].ceil() as usize).min(size.1));
        // A large picture has parts enough.
        let cut = if (right - left).min(bottom - top) > LARGE_PX { PARTS - 1 } else { PARTS };
        let (columns, rows) = ((right - left) * cut + 1, (bottom - top) * cut + 1);
        let at = |i: usize, from: usize| from as f64 + i as f64 / cut as f64;
        let corner = |i: usize| show(Point2::new(at(i % columns, left), at(i / columns, top)));
        let corners: Vec<Option<Vec3>> = (0..columns * rows).into_par_iter().map(corner).collect();
        let part = |i: usize| {
            let (row, column) = (i / (columns - 1), i % (columns - 1));
            let at = |dr: usize, dc: usize| corners[(row + dr) * columns + column + dc];
            let (a, b, c, d) = (at(0, 0)?, at(0, 1)?, at(1, 1)?, at(1, 0)?);
            let direction = (a + b + c + d).try_normalize()?;
            let (x, y) = (left + column / cut, top + row / cut);
            let solid_angle = spherical_triangle(a, b, c) + spherical_triangle(a, c, d);
            Some(Part { pixel: (y * size.0 + x) as u32, direction, solid_angle })
        };
        let parts = (0..(rows - 1) * (columns - 1)).into_par_iter().filter_map(part).collect();
        Self { size, parts }
    }

    /// Width and height of the pictures that it is for, px.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// The environment of a picture, on a cube of `side` texels.
    pub fn environment(&self, picture: &RadianceImage, clipped: &Image<bool>, side: usize) -> Seen {
        let (mut all, mut lost) = (Sums::new(side), Sums::new(side));
        for part in &self.parts {
            let i = part.pixel as usize;
            let Radiance(radiance) = picture.pixels()[i];
            all.add(part.direction, radiance, part.solid_angle);
            let cut = if clipped.pixels()[i] { radiance } else { [0.0; 3] };
            lost.add(part.direction, cut, part.solid_angle);
        }
        Seen { cube: all.finish(), clipped: lost.finish() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::probe::synthetic::{look_at, render};

    fn sky(d: nalgebra::Vector3<f64>) -> [f32; 3] {
        let lamp = d.dot(&nalgebra::Vector3::new(0.4, 0.8, 0.3).normalize()) > 0.985;
        [if lamp { 40.0 } else { 1.0 + 0.5 * d.y as f32 }, 1.0, 0.5 + 0.2 * d.x as f32]
    }

    fn compare(seen: &Seen, hidden: impl Fn(Vec3) -> bool) {
        let truth = CubeMap::from_fn(64, |d| sky(nalgebra::Vector3::new(d.x, d.y, d.z).cast()));
        for (k, (a, b)) in seen.cube.power().iter().zip(truth.power()).enumerate() {
            assert!((a / b - 1.0).abs() < 0.03, "channel {k}: {a} {b}");
        }
        let coarse = truth.downsampled(4);
        let fine = seen.cube.downsampled(2);
        let off = (0..coarse.texels().len())
            .filter(|&i| !hidden(coarse.texel(i).0))
            .map(|i| (coarse.texels()[i].0[2] - fine.texels()[i].0[2]).abs());
        assert!(off.fold(0.0, f32::max) < 0.03);
    }

    #[test]
    fn a_balls_picture_gives_the_environment_with_its_energy() {
        let eye = Point3::new(0.0, 0.6, 1.0);
        let (centre, radius) = (Point3::new(0.05, 0.1, 0.0), 0.1);
        let camera = look_at(Intrinsics::pinhole(320, 240, 500.0), eye, centre);
        // The floor lies far below, out of the light.
        let picture = render(&camera, &centre, radius, 1.0, sky, |_, _| [1.0, 1.0, 0.5], 4);
        let no_floor = Image::from_fn(320, 240, |x, y| {
            let p = Point2::new(x as f64 + 0.5, y as f64 + 0.5);
            match reflected_ray(&camera, &centre, radius, &p) {
                Some(ray) => Radiance(sky(ray.direction.into_inner())),
                None => *picture.at(x, y),
            }
        });
        let map = SphereMap::of_ball(&camera, &centre, radius, 0.0).unwrap();
        let clipped = Image::from_fn(320, 240, |x, y| no_floor.at(x, y).0[0] > 20.0);
        let seen = map.environment(&no_floor, &clipped, 32);
        let behind = (centre - eye).normalize();
        let behind = Vec3::new(behind.x as f32, behind.y as f32, behind.z as f32);
        compare(&seen, |d| d.dot(behind) > 0.85);
        let share = seen.clipped.power()[0] / seen.cube.power()[0];
        assert!((0.05..0.3).contains(&share), "{share}");
    }

    #[test]
    fn a_fisheye_shows_its_half_of_the_sky() {
        let lens = Fisheye {
            projection: Projection::Equidistant,
            focal_px: 60.0,
            centre_px: [100.0; 2],
            half_field: 1.57,
            world_from_camera: Mat3::from_cols(Vec3::NEG_X, Vec3::Z, Vec3::Y),
        };
        let map = SphereMap::of_fisheye(&lens, (200, 200));
        let picture = Image::from_fn(200, 200, |x, y| {
            let (dx, dy) = ((x as f64 - 99.5) / 60.0, (y as f64 - 99.5) / 60.0);
            let angle = dx.hypot(dy).max(1e-9);
            let across = angle.sin() / angle;
            Radiance(sky(nalgebra::Vector3::new(-dx * across, angle.cos(), dy * across)))
        });
        let seen = map.environment(&picture, &Image::from_fn(200, 200, |_, _| false), 32);
        let up = [0, 1, 2].map(|k| seen.cube.irradiance(Vec3::Y)[k]);
        let truth = CubeMap::from_fn(64, |d| sky(nalgebra::Vector3::new(d.x, d.y, d.z).cast()));
        let truth = truth.irradiance(Vec3::Y);
        assert!((0..3).all(|k| (up[k] / truth[k] - 1.0).abs() < 0.03), "{up:?} {truth:?}");
    }

    #[test]
    fn a_ball_out_of_the_frame_or_too_small_is_refused() {
        let look =
            |at: Point3<f64>| look_at(Intrinsics::pinhole(320, 240, 300.0), Point3::new(0.0, 0.5, 1.0), at);
        let centre = Point3::new(0.0, 0.1, 0.0);
        let off = SphereMap::of_ball(&look(Point3::new(2.0, 0.0, 0.0)), &centre, 0.1, 0.0).err();
        assert_eq!(off, Some(Problem::OutOfFrame { outside: 1.0 }));
        let small = SphereMap::of_ball(&look(centre), &centre, 0.01, 0.0).err();
        assert!(matches!(small, Some(Problem::Small { .. })), "{small:?}");
    }
}

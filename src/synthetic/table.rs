//! A table in a room, with a printed board of markers and a mirror ball on it, as a hand-held camera films it: the light dome's
//! test sequence. A window shines all the time, a lamp is switched on half way; an object moves over the board.

use super::shapes::{blob, camera};
use super::tracer::{Ball, Finish, Quad, Tracer};
use crate::camera::Camera;
use crate::dome::Fisheye;
use crate::image::RadianceImage;
use crate::probe::fisheye::Projection;
use crate::shadow::Occluder;
use glam::{Mat3, Quat, Vec3};

/// Frames of the sequence.
pub const FRAMES: usize = 60;
/// From here on the camera moves.
pub const MOVES_FROM: usize = 15;
/// From here on the lamp shines.
pub const LAMP_FROM: usize = 30;
/// Radius of the ball, m.
pub const BALL_RADIUS_M: f32 = 0.06;
/// Its centre in the world, m.
pub const BALL: Vec3 = Vec3::new(0.27, BALL_RADIUS_M, -0.02);
/// Share of light that it reflects.
pub const REFLECTIVITY: f32 = 0.9;
/// Reflectance of the board's paper and ink.
pub const PAPER: f32 = 0.8;
const INK: f32 = 0.04;
/// Reflectance of the object.
pub const OBJECT: [f32; 3] = [0.62, 0.24, 0.14];
/// Half the room's width and depth, its height over the table and the table's over its floor, m.
const ROOM: [f32; 3] = [3.0, 2.2, 0.8];
/// Half the table's side, m.
const TABLE: f32 = 0.8;
const LAMP: [f32; 3] = [95.0, 75.0, 45.0];
const WINDOW: [f32; 3] = [5.0, 6.0, 7.5];

/// A board of square markers on white paper in the world's plane y = 0.
pub struct Board {
    /// Columns and rows.
    pub markers: [usize; 2],
    /// Side of a marker and space between two, m.
    pub side_m: f32,
    /// Space between two markers and around all, m.
    pub gap_m: f32,
    /// Cells of every marker, row by row from the top, white or not; the first marker lies at −x, −z.
    pub cells: Vec<Vec<bool>>,
}

impl Board {
    /// Reflectance at a place, none beside the board.
    fn reflectance(&self, p: Vec3) -> Option<f32> {
        let step = self.side_m + self.gap_m;
        let along = |v: f32, n: usize| v + (n as f32 * step + self.gap_m) / 2.0;
        let (x, z) = (along(p.x, self.markers[0]), along(p.z, self.markers[1]));
        let inside = |v: f32, n: usize| (0.0..n as f32 * step + self.gap_m).contains(&v);
        if !inside(x, self.markers[0]) || !inside(z, self.markers[1]) {
            return None;
        }
        let place = |v: f32| {
            let (i, rest) = ((v / step) as usize, v % step);
            (i, (rest - self.gap_m) / self.side_m)
        };
        let ((i, u), (j, v)) = (place(x), place(z));
        if u < 0.0 || v < 0.0 || i >= self.markers[0] || j >= self.markers[1] {
            return Some(PAPER);
        }
        let cells = &self.cells[j * self.markers[0] + i];
        let n = cells.len().isqrt();
        let at = |u: f32| ((u * n as f32) as usize).min(n - 1);
        Some(if cells[at(v) * n + at(u)] { PAPER } else { INK })
    }
}

/// The camera of a frame.
pub fn camera_of(frame: usize) -> Camera {
    let t = frame.saturating_sub(MOVES_FROM) as f64 / (FRAMES - MOVES_FROM) as f64;
    // It starts and turns back smoothly.
    let (azimuth, height) = (-0.35 + 0.5 * (1.0 - (3.0 * t).cos()) / 2.0, 0.62 + 0.08 * (5.0 * t).sin() * t);
    let eye = [0.95 * azimuth.sin(), height, 0.95 * azimuth.cos()];
    camera(eye, [0.04, 0.02, 0.0], 400, 300, 430.0)
}

/// A fixed camera on the ball, that also sees part of the board.
pub fn ball_camera() -> Camera {
    camera([0.42, 0.34, 0.42], [0.22, 0.05, 0.0], 200, 150, 260.0)
}

/// A lens beside the board that looks up.
pub fn fisheye() -> Fisheye {
    Fisheye {
        projection: Projection::Equidistant,
        focal_px: 48.0,
        centre_px: [80.0; 2],
        half_field: std::f64::consts::FRAC_PI_2,
        world_from_camera: Mat3::from_cols(Vec3::NEG_X, Vec3::Z, Vec3::Y),
    }
}

/// Where the lens stands, m.
const FISHEYE: Vec3 = Vec3::new(0.27, 0.03, 0.17);

/// The object at the world's origin, standing on y = 0.
pub fn object() -> Occluder {
    let mut object = blob(Vec3::ZERO, 0.05, 0.12, 20);
    // Taller than broad.
    object.vertices.iter_mut().for_each(|v| v.y *= 1.5);
    let low = object.vertices.iter().map(|v| v.y).fold(f32::MAX, f32::min);
    object.vertices.iter_mut().for_each(|v| v.y -= low);
    object
}

/// Where the object stands in a frame: place (m) and turn about the vertical, rad.
pub fn pose_of(frame: usize) -> (Vec3, f32) {
    let t = frame as f32 / FRAMES as f32;
    let angle = 2.2 * t;
    (Vec3::new(-0.05 + 0.09 * angle.cos(), 0.0, 0.05 * angle.sin()), 0.6 * t)
}

/// The scene of a frame, with the object or without.
pub fn with_scene<T>(
    board: &Board,
    lamp_on: bool,
    object: Option<(Vec3, f32)>,
    body: impl FnOnce(&Tracer) -> T,
) -> T {
    let table = |p: Vec3| match board.reflectance(p) {
        Some(paper) => [paper; 3],
        None => [0.42, 0.33, 0.25].map(|c| c * (1.0 + 0.12 * (p.x * 60.0 + (p.z * 9.0).sin()).sin())),
    };
    let [half, high, low] = ROOM;
    let corner = Vec3::new(-half, -low, -half);
    let (x, y, z) = (Vec3::X * 2.0 * half, Vec3::Y * (high + low), Vec3::Z * 2.0 * half);
    let shine = |corner, u, v, radiance, sampled| Quad {
        corner,
        sides: [u, v],
        finish: Finish::Emitter(radiance),
        sampled,
    };
    let mut quads = vec![
        shine(corner, z, x, [0.05, 0.04, 0.03], false),
        shine(corner + y, x, z, [0.16, 0.16, 0.15], false),
        shine(corner, y, z, [0.10, 0.11, 0.13], false),
        shine(corner + x, z, y, [0.16, 0.12, 0.09], false),
        shine(corner, x, y, [0.11, 0.13, 0.10], false),
        shine(corner + z, y, x, [0.12, 0.12, 0.12], false),
        shine(Vec3::new(-half + 0.01, 0.3, -1.3), Vec3::Y * 1.4, Vec3::Z * 2.0, WINDOW, true),
        Quad {
            corner: Vec3::new(-TABLE, 0.0, -TABLE),
            sides: [Vec3::Z * 2.0 * TABLE, Vec3::X * 2.0 * TABLE],
            finish: Finish::Diffuse(&table),
            sampled: false,
        },
    ];
    if lamp_on {
        quads.push(shine(Vec3::new(1.15, 1.9, 0.35), Vec3::X * 0.35, Vec3::Z * 0.35, LAMP, true));
    }
    let ball = Ball { centre: BALL, radius: BALL_RADIUS_M, reflectivity: REFLECTIVITY };
    let placed = object.map(|(at, turn)| {
        let mut placed = self::object();
        let turn = Quat::from_rotation_y(turn);
        placed.vertices.iter_mut().for_each(|v| *v = turn * *v + at);
        placed
    });
    body(&Tracer::new(quads, Some(ball), placed.as_ref().map(|o| (o, OBJECT))))
}

/// What a camera sees.
pub fn film(tracer: &Tracer, camera: &Camera, side: usize, seed: u64) -> RadianceImage {
    let size = (camera.intrinsics.width_px as usize, camera.intrinsics.height_px as usize);
    tracer.picture(size, side, seed, |x, y| {
        let ray = camera.ray(&nalgebra::Point2::new(x, y));
        let vector = |v: [f64; 3]| Vec3::from_array(v.map(|c| c as f32));
        Some((vector(ray.origin.coords.into()), vector(ray.direction.into_inner().into())))
    })
}

/// What the lens beside the board sees.
pub fn film_up(tracer: &Tracer, side: usize, seed: u64) -> RadianceImage {
    let lens = fisheye();
    let size = lens.centre_px.map(|c| (2.0 * c) as usize);
    tracer.picture((size[0], size[1]), side, seed, |x, y| Some((FISHEYE, lens.direction(x, y)?)))
}

/// How far a frame's shadow lies from the true one: sums of (ours − truth)², truth², ours and truth over places where truth
/// removes more than 5 % and where neither picture shows the object. `with` is the true frame, `empty` the same without the
/// object and without noise, `plate` the frame filmed, `ours` what was made of it. Places are 3×3 px: single ones are noise.
pub fn shadow_sums(
    with: &RadianceImage,
    empty: &RadianceImage,
    plate: &RadianceImage,
    ours: &RadianceImage,
) -> [f64; 4] {
    let (w, h) = with.size();
    // The object is redder than all else.
    let red = |p: &RadianceImage, x: usize, y: usize| p.at(x, y).0[0] > 1.6 * p.at(x, y).0[1];
    let object = |x: usize, y: usize| {
        (y.saturating_sub(3)..(y + 4).min(h))
            .flat_map(|y| (x.saturating_sub(3)..(x + 4).min(w)).map(move |x| (x, y)))
            .any(|(x, y)| red(with, x, y) || red(ours, x, y))
    };
    let mut sums = [0.0; 4];
    for (y, x) in (1..h / 3 - 1).flat_map(|y| (1..w / 3 - 1).map(move |x| (3 * y, 3 * x))) {
        let mean = |a: &RadianceImage, k: usize| {
            (0..9).map(|i| f64::from(a.at(x + i % 3, y + i / 3).0[k])).sum::<f64>() / 9.0
        };
        let [t, b] = [with, empty].map(|a| (0..3).map(|k| mean(a, k)).sum::<f64>());
        if t > 0.95 * b || object(x + 1, y + 1) {
            continue;
        }
        for k in 0..3 {
            let truth = mean(empty, k) - mean(with, k);
            let found = mean(plate, k) - mean(ours, k);
            let of = [(found - truth).powi(2), truth * truth, found, truth];
            sums.iter_mut().zip(of).for_each(|(sum, v)| *sum += v);
        }
    }
    sums
}

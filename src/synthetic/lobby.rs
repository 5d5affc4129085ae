//! A lobby of 16 × 4.5 × 10 m: a front of windows, luminaires in the ceiling, columns, a counter, two benches.

use super::shapes::{blob, camera, face};
use crate::camera::Camera;
use crate::illuminate::patch::{LightModel, PatchMesh};
use crate::image::{Radiance, RadianceImage};
use crate::shadow::{Occluder, Receivers};
use glam::Vec3;

/// Half the width, height, half the depth, m.
const HALF: Vec3 = Vec3::new(8.0, 4.5, 5.0);
/// Windows and luminaires stand so far before wall and ceiling, m.
const BEFORE_M: f32 = 0.005;
/// Rings of the object: 2,500 triangles.
const RINGS: u32 = 25;

/// The lobby as a photograph shows it.
pub struct Lobby {
    /// Its surfaces and their radiance.
    pub light: LightModel,
    /// The view of the middle of its floor.
    pub camera: Camera,
    /// What that view sees, by pixel.
    pub receivers: Receivers,
    /// Radiance of what is seen.
    pub plate: RadianceImage,
}

impl Lobby {
    /// The lobby with patches of at most `edge` m, seen in `width` × 3/4 `width` px.
    pub fn new(edge: f32, width: u32) -> Self {
        Self::seen_in(edge, [width, width * 3 / 4])
    }

    /// The same in a picture of any shape, px.
    pub fn seen_in(edge: f32, [width, height]: [u32; 2]) -> Self {
        let light = lobby(edge);
        let focal = 0.85 * f64::from(width);
        let camera = camera([2.6, 1.6, 3.6], [-0.6, 0.3, -0.4], width, height, focal);
        let receivers = Receivers::cast(&camera, &light.mesh);
        let plate = receivers.pixels.map(|r| {
            // Tiles, so that a wrong share of the plate shows as such.
            let tile = |p: Vec3| 0.9 + 0.2 * ((p.x.floor() + p.y.floor() + p.z.floor()).rem_euclid(2.0));
            Radiance(r.map_or([0.0; 3], |r| surface(r.position, r.normal).map(|c| c * tile(r.position))))
        });
        Self { light, camera, receivers, plate }
    }

    /// An object of 2,500 triangles standing on the floor at (x, z), lifted by `lift` m.
    pub fn object(at: [f32; 2], lift: f32) -> Occluder {
        let mut object = blob(Vec3::ZERO, 0.35, 0.15, RINGS);
        let low = object.vertices.iter().map(|v| v.y).fold(f32::MAX, f32::min);
        let by = Vec3::new(at[0], lift - low + 1e-3, at[1]);
        object.vertices.iter_mut().for_each(|v| *v += by);
        object
    }
}

/// Radiance of walls, floor and furniture: lighter towards the windows (at −z) and under the ceiling's light.
fn surface(p: Vec3, normal: Vec3) -> [f32; 3] {
    let daylight = 0.25 / (1.0 + (p.z + HALF.z) / 3.0);
    let below = if normal.y < -0.5 { 0.6 } else { 1.0 };
    let colour = if normal.y > 0.5 && p.y < 0.01 { [0.9, 0.75, 0.6] } else { [1.0, 0.95, 0.88] };
    [0.0, 0.06, 0.16].map(|bluish| daylight * (1.0 + bluish) + 0.12).iter().zip(colour).enumerate().fold(
        [0.0; 3],
        |mut out, (k, (l, c))| {
            out[k] = l * c * below;
            out
        },
    )
}

/// All of the lobby's surfaces with patches of at most `edge` m.
pub fn lobby(edge: f32) -> LightModel {
    let mut mesh = PatchMesh::default();
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    let low = Vec3::new(-HALF.x, 0.0, -HALF.z);
    let (w, h, d) = (x * 2.0 * HALF.x, y * HALF.y, z * 2.0 * HALF.z);
    for (corner, u, v) in
        [(low, d, w), (low + h, w, d), (low, h, d), (low + w, d, h), (low, w, h), (low + d, h, w)]
    {
        let normal = u.cross(v).normalize();
        face(&mut mesh, corner, u, v, edge, |p| surface(p, normal));
    }
    for i in 0..4 {
        let corner = low + Vec3::new(1.0 + 3.8 * i as f32, 0.8, BEFORE_M);
        face(&mut mesh, corner, x * 2.6, y * 2.9, edge, |p| [5.0, 6.0, 8.0].map(|c| c * (0.6 + 0.2 * p.y)));
    }
    for (i, k) in (0..4).flat_map(|i| (0..2).map(move |k| (i, k))) {
        let corner = Vec3::new(-6.3 + 4.0 * i as f32, HALF.y - BEFORE_M, -2.8 + 5.0 * k as f32);
        face(&mut mesh, corner, x * 0.6, z * 0.6, edge, |_| [22.0, 18.0, 13.0]);
    }
    for (i, k) in (0..2).flat_map(|i| (0..2).map(move |k| (i, k))) {
        let middle = Vec3::new(-3.2 + 6.4 * i as f32, 0.0, -2.2 + 4.0 * k as f32);
        solid(&mut mesh, middle, Vec3::new(0.4, HALF.y, 0.4), edge, false);
    }
    solid(&mut mesh, Vec3::new(-1.5, 0.0, -3.2), Vec3::new(3.0, 1.1, 0.7), edge, true);
    for i in 0..2 {
        solid(&mut mesh, Vec3::new(-5.0 + 4.0 * i as f32, 0.0, 0.8), Vec3::new(1.6, 0.45, 0.5), edge, true);
    }
    LightModel { mesh, distant: Vec::new() }
}

/// A box that stands on the floor: sides, and a top if it is not as high as the room.
fn solid(mesh: &mut PatchMesh, middle: Vec3, size: Vec3, edge: f32, top: bool) {
    let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
    let low = middle - (x + z) / 2.0;
    let mut sides = vec![(low, z, y), (low + x, y, z), (low, y, x), (low + z, x, y)];
    if top {
        sides.push((low + y, z, x));
    }
    for (corner, u, v) in sides {
        let normal = u.cross(v).normalize();
        face(mesh, corner, u, v, edge, |p| surface(p, normal).map(|c| 0.8 * c));
    }
}

/// The edge length (m) that gives the lobby about so many patches.
pub fn lobby_of(patches: usize) -> f32 {
    let (mut fine, mut coarse) = (0.05f32, 16.0f32);
    for _ in 0..30 {
        let middle = (fine * coarse).sqrt();
        if lobby(middle).mesh.patches.len() > patches { fine = middle } else { coarse = middle }
    }
    coarse
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::Bvh;

    #[test]
    fn the_lobby_is_closed_and_of_the_size_asked_for() {
        for patches in [250, 2000, 20_000] {
            let mesh = lobby(lobby_of(patches)).mesh;
            let off = mesh.patches.len() as f64 / patches as f64;
            assert!((0.8..=1.0).contains(&off), "{} for {patches}", mesh.patches.len());
        }
        let mesh = lobby(1.0).mesh;
        let bvh = Bvh::new(&mesh.vertices, &mesh.triangles());
        for i in 0..500 {
            let (a, b) = (i as f32 * 2.399, (i as f32 + 0.5) / 250.0 - 1.0);
            let r = (1.0 - b * b).sqrt();
            let direction = Vec3::new(r * a.cos(), b, r * a.sin());
            let hit = bvh.closest(Vec3::new(1.0, 1.5, 1.0), direction, 0.0, f32::MAX);
            let normal = mesh.normal(hit.expect("a wall").triangle as usize);
            assert!(normal.dot(direction) < 0.0, "a back side is seen along {direction}");
        }
    }

    #[test]
    fn the_view_shows_floor_and_every_pixel_something() {
        let seen = Lobby::new(1.5, 64);
        assert!(seen.receivers.pixels.pixels().iter().all(Option::is_some));
        let floor = seen.receivers.pixels.pixels().iter().flatten().filter(|r| r.position.y < 1e-3).count();
        assert!(floor > 64 * 48 / 3, "{floor} of {} px", 64 * 48);
        assert!(seen.plate.pixels().iter().all(|p| p.luminance() > 0.0));
        assert_eq!(Lobby::object([0.0, 0.0], 0.0).triangles.len(), 2500);
    }
}

//! A synthetic room, 4 × 2.6 × 4 m: floor, walls, ceiling with their own radiance, a bright window, a ceiling lamp.
#![allow(dead_code)] // each test program uses its part

use glam::Vec3;
use insitu::camera::{Camera, Intrinsics};
use insitu::config;
use insitu::illuminate::patch::{Evidence, LightModel, Patch, PatchMesh};
use insitu::image::{Image, Radiance, RadianceImage, luminance};
use insitu::shadow::{Occluder, Receivers, Scene};
use insitu::transfer::{Transfers, solve};
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Cuts the parallelogram `corner + u + v` (front along u × v) into right triangles with legs of at most `edge` m.
pub fn face(
    mesh: &mut PatchMesh,
    corner: Vec3,
    u: Vec3,
    v: Vec3,
    edge: f32,
    radiance: impl Fn(Vec3) -> [f32; 3],
) {
    let (columns, rows) = ((u.length() / edge).ceil() as u32, (v.length() / edge).ceil() as u32);
    let base = mesh.vertices.len() as u32;
    let face = mesh.patches.last().map_or(0, |p| p.face + 1);
    for j in 0..=rows {
        for i in 0..=columns {
            mesh.vertices.push(corner + u * (i as f32 / columns as f32) + v * (j as f32 / rows as f32));
            mesh.normals.push(u.cross(v).normalize());
        }
    }
    for (j, i) in (0..rows).flat_map(|j| (0..columns).map(move |i| (j, i))) {
        let at = |di, dj| base + (j + dj) * (columns + 1) + i + di;
        for vertices in [[at(0, 0), at(1, 0), at(1, 1)], [at(0, 0), at(1, 1), at(0, 1)]] {
            let centre = vertices.iter().map(|&k| mesh.vertices[k as usize]).sum::<Vec3>() / 3.0;
            let radiance = radiance(centre);
            mesh.patches.push(Patch {
                vertices,
                face,
                radiance,
                reflectance: [0.5; 3],
                evidence: Evidence::Probe,
            });
        }
    }
}

/// The room. The window (2 × 1.2 m) is part of the wall at x = −2, its patches of the wall's size.
pub fn room(edge: f32) -> LightModel {
    let mut mesh = PatchMesh::default();
    let (x, y, z) = (Vec3::X * 4.0, Vec3::Y * 2.6, Vec3::Z * 4.0);
    let low = Vec3::new(-2.0, 0.0, -2.0);
    face(&mut mesh, low, z, x, edge, |p| [0.20, 0.16, 0.12].map(|c| c * (1.0 + 0.3 * p.x)));
    face(&mut mesh, low + y, x, z, edge, |p| {
        if p.x.abs() < 0.2 && (p.z - 0.8).abs() < 0.2 { [25.0, 20.0, 14.0] } else { [0.5, 0.5, 0.5] }
    });
    face(&mut mesh, low, y, z, edge, |p| {
        if (p.y - 1.4).abs() < 0.6 && p.z.abs() < 1.0 { [6.0, 7.0, 9.0] } else { [0.3, 0.3, 0.3] }
    });
    face(&mut mesh, low + x, z, y, edge, |_| [0.6, 0.55, 0.5]);
    face(&mut mesh, low, x, y, edge, |_| [0.5, 0.3, 0.2]);
    face(&mut mesh, low + z, y, x, edge, |_| [0.4, 0.4, 0.5]);
    LightModel { mesh, distant: Vec::new() }
}

/// A camera at `eye` that looks at `target`.
pub fn camera(eye: [f64; 3], target: [f64; 3], width: u32, height: u32, focal: f64) -> Camera {
    let (eye, target) = (Point3::from(eye), Point3::from(target));
    let forward = (target - eye).normalize();
    let right = forward.cross(&Vector3::y()).normalize();
    let down = forward.cross(&right);
    let rotation = Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(&[right, down, forward]));
    Camera {
        intrinsics: Intrinsics::pinhole(width, height, focal),
        world_from_camera: Isometry3::from_parts(
            Translation3::from(eye.coords),
            UnitQuaternion::from_rotation_matrix(&rotation),
        ),
    }
}

/// What a test shadows: light, transfers, receivers and a plate that is consistent with them.
pub struct Stage {
    pub light: LightModel,
    pub receivers: Receivers,
    pub transfers: Transfers,
    pub plate: RadianceImage,
}

impl Stage {
    pub fn new(light: LightModel, camera: &Camera, settings: &config::Transfer) -> Self {
        let receivers = Receivers::cast(camera, &light.mesh);
        let transfers = solve(&light, &receivers, settings, || {}).unwrap();
        let (width, height) = receivers.pixels.size();
        let plate =
            Image::from_fn(width, height, |x, y| Radiance([0.2 + 0.1 * ((x / 8 + y / 8) % 2) as f32; 3]));
        Self { light, receivers, transfers, plate }
    }

    pub fn scene(&self) -> Scene<'_> {
        Scene {
            light: &self.light,
            transfers: &self.transfers,
            receivers: &self.receivers,
            plate: &self.plate,
            stored: None,
        }
    }
}

/// The room seen from 1.5 m above the floor towards its middle.
pub fn stage(edge: f32, width: u32, share: f64) -> Stage {
    let camera = camera([0.9, 1.3, 1.7], [0.0, 0.1, 0.0], width, width * 3 / 4, f64::from(width) * 0.9);
    Stage::new(room(edge), &camera, &config::Transfer { source_share: share, ..Default::default() })
}

pub fn cuboid(centre: Vec3, half: Vec3) -> Occluder {
    let vertices = (0..8)
        .map(|i| {
            let s = |bit: i32| ((i >> bit & 1) * 2 - 1) as f32;
            centre + half * Vec3::new(s(0), s(1), s(2))
        })
        .collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Occluder { vertices, triangles }
}

/// A sphere with bumps of the given height: `bumps = 0` is round, more makes a closed organic shape.
pub fn blob(centre: Vec3, radius: f32, bumps: f32, rings: u32) -> Occluder {
    let mut out = Occluder::default();
    let turns = rings * 2;
    for i in 0..=rings {
        for j in 0..turns {
            let (theta, phi) = (
                std::f32::consts::PI * i as f32 / rings as f32,
                std::f32::consts::TAU * j as f32 / turns as f32,
            );
            let r = radius
                * (1.0 + bumps * ((3.0 * phi).sin() * theta.sin().powi(3) + 0.5 * (5.0 * theta).cos()));
            let d = Vec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin());
            out.vertices.push(centre + d * r);
        }
    }
    for (i, j) in (0..rings).flat_map(|i| (0..turns).map(move |j| (i, j))) {
        let at = |i: u32, j: u32| i * turns + j % turns;
        out.triangles.push([at(i, j), at(i, j + 1), at(i + 1, j)]);
        out.triangles.push([at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)]);
    }
    out
}

/// Relative shadow error and energy bias where the reference removes more than 2 % (DESIGN §8, method error).
pub fn errors(plate: &RadianceImage, found: &RadianceImage, reference: &RadianceImage) -> (f64, f64) {
    let (mut difference, mut signal, mut sum, mut sum_reference) = (0.0, 0.0, 0.0, 0.0);
    for ((b, f), r) in plate.pixels().iter().zip(found.pixels()).zip(reference.pixels()) {
        if luminance(r.0) <= 0.02 * b.luminance() {
            continue;
        }
        for c in 0..3 {
            let (f, r) = (f64::from(f.0[c]), f64::from(r.0[c]));
            difference += (f - r).powi(2);
            signal += r * r;
            sum += f;
            sum_reference += r;
        }
    }
    ((difference / signal).sqrt(), sum / sum_reference - 1.0)
}

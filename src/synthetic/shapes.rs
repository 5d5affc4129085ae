//! Faces cut into patches, cameras, objects.

use crate::camera::{Camera, Intrinsics};
use crate::illuminate::patch::{Evidence, Patch, PatchMesh};
use crate::shadow::Occluder;
use glam::Vec3;
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Cuts the parallelogram `corner + u + v` (front along u × v) into right triangles with legs of at most `edge` m;
/// `radiance` is that at a patch's centroid.
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
            mesh.patches.push(Patch {
                vertices,
                face,
                radiance: radiance(centre),
                reflectance: [0.5; 3],
                evidence: Evidence::Probe,
            });
        }
    }
}

/// A camera at `eye` (m) that looks at `target`; focal length in px.
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

/// A box of 12 triangles.
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

/// A closed shape of 4 `rings`² triangles around `centre`: round without `bumps`, with them organic.
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

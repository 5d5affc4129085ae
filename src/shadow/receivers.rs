//! What each pixel of the plate looks at.

use super::Problem;
use crate::camera::Camera;
use crate::illuminate::patch::PatchMesh;
use crate::image::{Image, RadianceImage};
use crate::visibility::Bvh;
use glam::{Vec2, Vec3};
use nalgebra::Point2;
use rayon::prelude::*;

/// The surface point seen at the centre of a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Receiver {
    /// Index into [`PatchMesh::patches`].
    pub patch: u32,
    /// Weights of the patch's three vertices.
    pub barycentric: [f32; 3],
    /// Position in the world, m.
    pub position: Vec3,
    /// Unit normal of the patch's front.
    pub normal: Vec3,
    /// One pixel to the right and one down on the patch's plane, m.
    pub footprint: [Vec3; 2],
}

impl Receiver {
    /// A point of its plane, px from the pixel's centre; m.
    pub fn at(&self, offset: Vec2) -> Vec3 {
        self.position + self.footprint[0] * offset.x + self.footprint[1] * offset.y
    }
}

/// The receivers of a plate, one a pixel; `None` where the pixel sees no patch.
#[derive(Debug, Clone, PartialEq)]
pub struct Receivers {
    /// By pixel of the plate.
    pub pixels: Image<Option<Receiver>>,
    /// Patches that the centre or a corner of some pixel sees, ascending.
    pub seen: Vec<u32>,
}

/// Back sides are looked through, e.g. the near wall of a room modelled smaller than it is; at most so many.
const BACK_SIDES: usize = 16;

impl Receivers {
    /// Refuses a plate that is not this camera's.
    pub(super) fn check(&self, plate: &RadianceImage) -> Result<(), Problem> {
        if self.pixels.size() == plate.size() {
            return Ok(());
        }
        let [found, expected] = [self.pixels.size(), plate.size()].map(|size| format!("{size:?} px"));
        Err(Problem::Mismatch { what: "size of the plate's camera", found, expected })
    }

    /// Casts the ray of every pixel's centre onto the front sides of the mesh.
    pub fn cast(camera: &Camera, mesh: &PatchMesh) -> Self {
        let bvh = Bvh::new(&mesh.vertices, &mesh.triangles());
        let (width, height) = (camera.intrinsics.width_px as usize, camera.intrinsics.height_px as usize);
        let ray = |x: f64, y: f64| {
            let ray = camera.ray(&Point2::new(x, y));
            let (o, d) = (ray.origin.coords, ray.direction.into_inner());
            (Vec3::new(o.x as f32, o.y as f32, o.z as f32), Vec3::new(d.x as f32, d.y as f32, d.z as f32))
        };
        let pixels = (0..width * height)
            .into_par_iter()
            .map(|i| {
                let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
                let (origin, direction) = ray(x, y);
                let mut receiver = first_front(mesh, &bvh, origin, direction)?;
                receiver.footprint =
                    [ray(x + 1.0, y), ray(x, y + 1.0)].map(|(_, d)| step(&receiver, origin, direction, d));
                Some(receiver)
            })
            .collect();
        let pixels: Image<Option<Receiver>> = Image::from_pixels(width, height, pixels);
        let corners: Vec<Option<u32>> = (0..(width + 1) * (height + 1))
            .into_par_iter()
            .map(|i| {
                let (origin, direction) = ray((i % (width + 1)) as f64, (i / (width + 1)) as f64);
                first_front(mesh, &bvh, origin, direction).map(|r| r.patch)
            })
            .collect();
        let mut seen = vec![false; mesh.patches.len()];
        let centres = pixels.pixels().iter().flatten().map(|r| r.patch);
        centres.chain(corners.into_iter().flatten()).for_each(|p| seen[p as usize] = true);
        let seen = (0..mesh.patches.len() as u32).filter(|&p| seen[p as usize]).collect();
        Self { pixels, seen }
    }
}

/// A footprint is at most this many times as long as a pixel seen head-on: at the horizon it would have no end.
const LONGEST: f32 = 16.0;

/// From a receiver to where the neighbouring pixel's ray meets its plane.
fn step(receiver: &Receiver, eye: Vec3, direction: Vec3, neighbour: Vec3) -> Vec3 {
    let to = receiver.position - eye;
    let head_on = direction.distance(neighbour) * to.length();
    let slope = neighbour.dot(receiver.normal);
    if slope > -1e-4 {
        return Vec3::ZERO;
    }
    (eye + neighbour * (to.dot(receiver.normal) / slope) - receiver.position)
        .clamp_length_max(LONGEST * head_on)
}

/// Weights of a triangle's corners at a point of its plane; beside the triangle those of a point on its border.
pub(super) fn barycentric([a, b, c]: [Vec3; 3], p: Vec3) -> [f32; 3] {
    let n = (b - a).cross(c - a);
    let of = |q: Vec3, r: Vec3| (((r - q).cross(p - q)).dot(n) / n.length_squared()).max(0.0);
    let weights = [of(b, c), of(c, a), of(a, b)];
    let sum: f32 = weights.iter().sum();
    weights.map(|w| w / sum)
}

fn first_front(mesh: &PatchMesh, bvh: &Bvh, origin: Vec3, direction: Vec3) -> Option<Receiver> {
    let mut from = 1e-4;
    for _ in 0..BACK_SIDES {
        let hit = bvh.closest(origin, direction, from, f32::INFINITY)?;
        let normal = mesh.normal(hit.triangle as usize);
        if normal.dot(direction) < 0.0 {
            let corners = mesh.corners(hit.triangle as usize);
            let position = (0..3).map(|k| corners[k] * hit.barycentric[k]).sum();
            return Some(Receiver {
                patch: hit.triangle,
                barycentric: hit.barycentric,
                position,
                normal,
                footprint: [Vec3::ZERO; 2],
            });
        }
        from = hit.t * (1.0 + 1e-5) + 1e-5;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_of_a_point_beside_a_triangle_are_those_of_its_border() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
        assert_eq!(barycentric(corners, Vec3::new(0.25, 0.5, 0.0)), [0.25, 0.25, 0.5]);
        let [a, b, c] = barycentric(corners, Vec3::new(0.5, -0.1, 0.0));
        assert!(c == 0.0 && a > 0.4 && b > 0.4 && (a + b - 1.0).abs() < 1e-6);
    }
}

//! What each pixel of the plate looks at.

use crate::camera::Camera;
use crate::illuminate::patch::PatchMesh;
use crate::image::Image;
use crate::visibility::Bvh;
use glam::Vec3;
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
}

/// The receivers of a plate, one a pixel; `None` where the pixel sees no patch.
#[derive(Debug, Clone, PartialEq)]
pub struct Receivers {
    /// By pixel of the plate.
    pub pixels: Image<Option<Receiver>>,
}

/// Back sides are looked through, e.g. the near wall of a room modelled smaller than it is; at most so many.
const BACK_SIDES: usize = 16;

impl Receivers {
    /// Casts the ray of every pixel's centre onto the front sides of the mesh.
    pub fn cast(camera: &Camera, mesh: &PatchMesh) -> Self {
        let bvh = Bvh::new(&mesh.vertices, &mesh.triangles());
        let (width, height) = (camera.intrinsics.width_px as usize, camera.intrinsics.height_px as usize);
        let pixels = (0..width * height)
            .into_par_iter()
            .map(|i| {
                let ray = camera.ray(&Point2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5));
                let (o, d) = (ray.origin.coords, ray.direction.into_inner());
                let origin = Vec3::new(o.x as f32, o.y as f32, o.z as f32);
                first_front(mesh, &bvh, origin, Vec3::new(d.x as f32, d.y as f32, d.z as f32))
            })
            .collect();
        Self { pixels: Image::from_pixels(width, height, pixels) }
    }
}

fn first_front(mesh: &PatchMesh, bvh: &Bvh, origin: Vec3, direction: Vec3) -> Option<Receiver> {
    let mut from = 1e-4;
    for _ in 0..BACK_SIDES {
        let hit = bvh.closest(origin, direction, from, f32::INFINITY)?;
        let normal = mesh.normal(hit.triangle as usize);
        if normal.dot(direction) < 0.0 {
            let corners = mesh.corners(hit.triangle as usize);
            let position = (0..3).map(|k| corners[k] * hit.barycentric[k]).sum();
            return Some(Receiver { patch: hit.triangle, barycentric: hit.barycentric, position, normal });
        }
        from = hit.t * (1.0 + 1e-5) + 1e-5;
    }
    None
}

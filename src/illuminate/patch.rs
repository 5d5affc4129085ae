//! The light model: a triangular patch mesh with radiance and reflectance, and distant light kept apart.

use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Where a patch's radiance comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[repr(u8)]
pub enum Evidence {
    /// Seen in the probe.
    Probe = 0,
    /// Seen in the plate.
    Plate = 1,
    /// Seen in neither: gathered from the other patches.
    Gathered = 2,
}

/// One triangle of the light model. Front side by the order of its vertices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// Indices into [`PatchMesh::vertices`]; vertices are never shared between faces.
    pub vertices: [u32; 3],
    /// Index of the scene's face it lies on.
    pub face: u32,
    /// Mean outgoing radiance of the front, plate units.
    pub radiance: [f32; 3],
    /// Diffuse reflectance, 0..1.
    pub reflectance: [f32; 3],
    /// Where the radiance was seen.
    pub evidence: Evidence,
}

/// Triangles over all faces of the scene, watertight within a face.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PatchMesh {
    /// Positions in the world, m.
    pub vertices: Vec<Vec3>,
    /// Unit normal of the face each vertex lies on.
    pub normals: Vec<Vec3>,
    /// The triangles.
    pub patches: Vec<Patch>,
}

impl PatchMesh {
    /// Corners of patch `i`, m.
    pub fn corners(&self, i: usize) -> [Vec3; 3] {
        self.patches[i].vertices.map(|v| self.vertices[v as usize])
    }

    /// Area of patch `i`, m².
    pub fn area(&self, i: usize) -> f32 {
        let [a, b, c] = self.corners(i);
        (b - a).cross(c - a).length() / 2.0
    }

    /// Centroid of patch `i`, m.
    pub fn centroid(&self, i: usize) -> Vec3 {
        let [a, b, c] = self.corners(i);
        (a + b + c) / 3.0
    }

    /// Unit normal of patch `i`.
    pub fn normal(&self, i: usize) -> Vec3 {
        self.normals[self.patches[i].vertices[0] as usize]
    }

    /// Vertex indices of all patches, for [`crate::visibility::Bvh::new`].
    pub fn triangles(&self) -> Vec<[u32; 3]> {
        self.patches.iter().map(|p| p.vertices).collect()
    }
}

/// Light from beyond the scene model: one cell of the environment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DistantSource {
    /// Unit vector towards the light, world frame.
    pub direction: Vec3,
    /// Solid angle, sr.
    pub solid_angle_sr: f32,
    /// Mean radiance over the solid angle, plate units.
    pub radiance: [f32; 3],
}

impl DistantSource {
    /// Angular radius of a disc of the same solid angle, rad.
    pub fn angular_radius(&self) -> f32 {
        (1.0 - self.solid_angle_sr / std::f32::consts::TAU).clamp(-1.0, 1.0).acos()
    }
}

/// What lights a scene.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LightModel {
    /// Surfaces of the scene model.
    pub mesh: PatchMesh,
    /// Light from beyond it; empty in a closed room.
    pub distant: Vec<DistantSource>,
}

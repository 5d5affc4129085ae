//! Where transfers are known: the patches that the plate sees, split where the scene's own shadows fall.

use crate::illuminate::patch::PatchMesh;
use glam::Vec3;

/// A triangle between receiver vertices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReceiverTriangle {
    /// Indices into [`ReceiverMesh::positions`], counter-clockwise seen from the front.
    pub vertices: [u32; 3],
    /// Index into [`PatchMesh::patches`] of the patch that it is a part of.
    pub patch: u32,
}

/// A patch or a part of one, and how it is bisected further.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Part {
    pub vertices: [u32; 3],
    pub split: Option<Split>,
}

/// Edge `edge` (from corner `edge` to the next) is halved; the parts lie at `first` (which keeps the edge's start) and
/// `first + 1` (which keeps its end) and have the corners in the same places, the edge's other end replaced by its middle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Split {
    pub edge: u8,
    pub first: u32,
}

/// Triangles over all receiver patches.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ReceiverMesh {
    /// Positions in the world, m.
    pub positions: Vec<Vec3>,
    /// Unit normals of the faces that the vertices lie on.
    pub normals: Vec<Vec3>,
    /// Triangles that are not split further, patch by patch.
    pub triangles: Vec<ReceiverTriangle>,
    /// Receiver patches, ascending.
    pub patches: Vec<u32>,
    /// The patches in the same order, then the parts of them.
    pub(super) parts: Vec<Part>,
}

impl ReceiverMesh {
    /// The given patches (ascending), not yet split.
    pub fn new(mesh: &PatchMesh, patches: Vec<u32>) -> Self {
        let mut ids: Vec<u32> = patches.iter().flat_map(|&p| mesh.patches[p as usize].vertices).collect();
        ids.sort_unstable();
        ids.dedup();
        let mut vertex_of = vec![u32::MAX; mesh.vertices.len()];
        ids.iter().zip(0..).for_each(|(&id, v)| vertex_of[id as usize] = v);
        let part = |&p: &u32| {
            let vertices = mesh.patches[p as usize].vertices.map(|v| vertex_of[v as usize]);
            Part { vertices, split: None }
        };
        let mut receivers = Self {
            positions: ids.iter().map(|&id| mesh.vertices[id as usize]).collect(),
            normals: ids.iter().map(|&id| mesh.normals[id as usize]).collect(),
            triangles: Vec::new(),
            parts: patches.iter().map(part).collect(),
            patches,
        };
        receivers.list_triangles();
        receivers
    }

    /// Remakes [`Self::triangles`] after splits.
    pub(super) fn list_triangles(&mut self) {
        let triangle =
            |(i, patch): (u32, u32)| ReceiverTriangle { vertices: self.parts[i as usize].vertices, patch };
        self.triangles = self.leaves().into_iter().map(triangle).collect();
    }

    /// The parts that are not split further with their patches, patch by patch.
    fn leaves(&self) -> Vec<(u32, u32)> {
        let (mut leaves, mut below) = (Vec::with_capacity(self.parts.len()), Vec::new());
        for (root, &patch) in self.patches.iter().enumerate() {
            below.push(root as u32);
            while let Some(i) = below.pop() {
                match self.parts[i as usize].split {
                    None => leaves.push((i, patch)),
                    Some(split) => below.extend([split.first + 1, split.first]),
                }
            }
        }
        leaves
    }

    /// How many of some points lie in each of [`Self::triangles`]. Points are parts with weights of their vertices, and move
    /// down to those that are not split further.
    pub(super) fn count(&self, points: &mut [(u32, [f32; 3])]) -> Vec<u32> {
        let mut counts = vec![0; self.parts.len()];
        for point in points {
            *point = self.descend(*point);
            counts[point.0 as usize] += 1;
        }
        self.leaves().into_iter().map(|(i, _)| counts[i as usize]).collect()
    }

    /// Receiver vertices around a point of a patch and their weights (sum 1, as those given). `None`: the patch is no
    /// receiver.
    pub fn locate(&self, patch: u32, barycentric: [f32; 3]) -> Option<([u32; 3], [f32; 3])> {
        let (part, weights) = self.descend((self.root(patch)?, barycentric));
        Some((self.parts[part as usize].vertices, weights))
    }

    /// The part that is a whole patch.
    pub(super) fn root(&self, patch: u32) -> Option<u32> {
        self.patches.binary_search(&patch).ok().map(|i| i as u32)
    }

    /// The part below that is around a point and not split further.
    fn descend(&self, (mut part, mut weights): (u32, [f32; 3])) -> (u32, [f32; 3]) {
        while let Some(Split { edge, first }) = self.parts[part as usize].split {
            let (start, end) = (edge as usize, (edge as usize + 1) % 3);
            let (a, b) = (weights[start], weights[end]);
            // w_a A + w_b B with the middle M = (A + B) / 2.
            if a >= b {
                (weights[start], weights[end]) = (a - b, 2.0 * b);
                part = first;
            } else {
                (weights[start], weights[end]) = (2.0 * a, b - a);
                part = first + 1;
            }
        }
        (part, weights)
    }

    /// Centroid of a triangle, m.
    pub(super) fn centroid(&self, triangle: &ReceiverTriangle) -> Vec3 {
        triangle.vertices.map(|v| self.positions[v as usize]).into_iter().sum::<Vec3>() / 3.0
    }

    /// A third of the area of the triangles around each vertex, m².
    pub fn vertex_areas(&self) -> Vec<f64> {
        let mut areas = vec![0.0; self.positions.len()];
        for t in &self.triangles {
            let [a, b, c] = t.vertices.map(|v| self.positions[v as usize]);
            let third = f64::from((b - a).cross(c - a).length()) / 6.0;
            t.vertices.iter().for_each(|&v| areas[v as usize] += third);
        }
        areas
    }
}

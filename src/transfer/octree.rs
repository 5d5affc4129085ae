//! The receiver octree (gibson §6): clusters of patches that the plate sees.

use super::boxes::Box3;
use super::receivers::ReceiverMesh;
use glam::Vec3;
use std::ops::Range;

/// A cluster of receiver patches.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ReceiverNode {
    /// Around its patches, m.
    pub bounds: Box3,
    /// The nodes below, side by side; empty: a leaf.
    pub children: Range<u32>,
    /// Its patches, as a range of [`ReceiverTree::order`].
    pub patches: Range<u32>,
}

/// Octree over receiver patches.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct ReceiverTree {
    /// The root first, children after their parents.
    pub nodes: Vec<ReceiverNode>,
    /// Indices into [`ReceiverMesh::patches`].
    pub order: Vec<u32>,
}

impl ReceiverTree {
    /// Splits nodes of more than `leaf_patches` patches at the middle of their centroids. Patches that all have one
    /// centroid stay together.
    pub fn build(receivers: &ReceiverMesh, leaf_patches: usize) -> Self {
        let corners = |i: u32| receivers.parts[i as usize].vertices.map(|v| receivers.positions[v as usize]);
        let centroid = |i: u32| corners(i).into_iter().sum::<Vec3>() / 3.0;
        let bounds = |order: &[u32]| Box3::of(order.iter().flat_map(|&i| corners(i)));
        let mut order: Vec<u32> = (0..receivers.patches.len() as u32).collect();
        let root = ReceiverNode { bounds: bounds(&order), children: 0..0, patches: 0..order.len() as u32 };
        let mut nodes = vec![root];
        let mut next = 0;
        while next < nodes.len() {
            let range = nodes[next].patches.clone();
            let members = &mut order[range.start as usize..range.end as usize];
            let centroids = Box3::of(members.iter().map(|&i| centroid(i)));
            if members.len() > leaf_patches.max(1) && centroids.size().max_element() > 0.0 {
                let middle = centroids.centre();
                let octant = |i: u32| centroid(i).cmpge(middle).bitmask();
                members.sort_by_key(|&i| octant(i));
                let first = nodes.len() as u32;
                let mut start = range.start;
                for part in members.chunk_by(|&a, &b| octant(a) == octant(b)) {
                    let patches = start..start + part.len() as u32;
                    start = patches.end;
                    nodes.push(ReceiverNode { bounds: bounds(part), children: 0..0, patches });
                }
                nodes[next].children = first..nodes.len() as u32;
            }
            next += 1;
        }
        Self { nodes, order }
    }

    /// Receiver vertices of a node's patches and their parts, ascending; [nodes].
    pub fn vertices(&self, receivers: &ReceiverMesh) -> Vec<Vec<u32>> {
        let mut of_patch = vec![Vec::new(); receivers.patches.len()];
        for triangle in &receivers.triangles {
            if let Ok(i) = receivers.patches.binary_search(&triangle.patch) {
                of_patch[i].extend(triangle.vertices);
            }
        }
        let all = |node: &ReceiverNode| {
            let members = &self.order[node.patches.start as usize..node.patches.end as usize];
            let mut all: Vec<u32> =
                members.iter().flat_map(|&i| of_patch[i as usize].iter().copied()).collect();
            all.sort_unstable();
            all.dedup();
            all
        };
        self.nodes.iter().map(all).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::receivers::Part;

    fn mesh(triangles: &[[Vec3; 3]]) -> ReceiverMesh {
        let n = triangles.len() as u32;
        let mut mesh = ReceiverMesh {
            positions: triangles.iter().flatten().copied().collect(),
            normals: vec![Vec3::Y; 3 * triangles.len()],
            patches: (0..n).map(|i| 2 * i).collect(),
            parts: (0..n).map(|i| Part { vertices: [3 * i, 3 * i + 1, 3 * i + 2], split: None }).collect(),
            triangles: Vec::new(),
        };
        mesh.list_triangles();
        mesh
    }

    #[test]
    fn leaves_part_the_patches() {
        let at = |i: u32| Vec3::new((i % 17) as f32, 0.0, (i / 17) as f32 * 1.3);
        let triangles: Vec<_> = (0..200).map(|i| [at(i), at(i) + Vec3::X, at(i) + Vec3::Z]).collect();
        let mesh = mesh(&triangles);
        let tree = ReceiverTree::build(&mesh, 8);
        let mut seen = tree.order.clone();
        seen.sort_unstable();
        assert!(seen.into_iter().eq(0..200));
        for node in &tree.nodes {
            let below = &tree.nodes[node.children.start as usize..node.children.end as usize];
            assert!(!node.children.is_empty() || node.patches.len() <= 8);
            assert!(
                node.children.is_empty()
                    || below.iter().map(|n| n.patches.len()).sum::<usize>() == node.patches.len()
            );
            assert!(below.iter().all(|n| n.bounds.union(node.bounds) == node.bounds));
        }
        assert!(tree.nodes.len() < 120, "a broad tree: {}", tree.nodes.len());
    }

    #[test]
    fn patches_on_top_of_each_other_end_as_one_leaf() {
        let tree = ReceiverTree::build(&mesh(&[[Vec3::ZERO, Vec3::X, Vec3::Z]; 20]), 8);
        assert_eq!(tree.nodes.len(), 1);
    }
}

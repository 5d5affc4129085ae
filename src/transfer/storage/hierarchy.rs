//! Arrays of the shaft hierarchy.

use crate::transfer::ShaftHierarchy;
use crate::transfer::boxes::Box3;
use crate::transfer::octree::{ReceiverNode, ReceiverTree};
use crate::transfer::shafts::ShaftNode;
use crate::transfer::tree::Extent;
use glam::Vec3;
use ndarray::Array2;

/// [shafts × (source node, receiver node, first shaft within, how many)].
pub(super) fn shafts_array(hierarchy: &ShaftHierarchy) -> Array2<u32> {
    let row = |s: &ShaftNode| [s.source, s.receiver, s.first, s.count];
    Array2::from(hierarchy.shafts.iter().map(row).collect::<Vec<_>>())
}

pub(super) fn read_shafts(array: &Array2<u32>, sources: usize, receivers: usize) -> Option<Vec<ShaftNode>> {
    let shaft = |(r, i): (ndarray::ArrayView1<u32>, u32)| {
        let [source, receiver, first, count] = [r[0], r[1], r[2], r[3]];
        let ends = (source as usize) < sources && (receiver as usize) < receivers;
        let within = first.checked_add(count).is_some_and(|end| end as usize <= array.nrows());
        let whole = ends && within && (count == 0 || first > i);
        whole.then_some(ShaftNode { source, receiver, first, count })
    };
    array.outer_iter().zip(0..).map(shaft).collect()
}

/// [nodes × (0 patches, 1 distant, 2 both; least and largest coordinates)].
pub(super) fn source_boxes_array(hierarchy: &ShaftHierarchy) -> Array2<f32> {
    let row = |e: &Extent| {
        let (kind, b) = match *e {
            Extent::Patches(b) => (0.0, b),
            Extent::Distant(b) => (1.0, b),
            Extent::Both => (2.0, Box3 { min: Vec3::ZERO, max: Vec3::ZERO }),
        };
        [kind, b.min.x, b.min.y, b.min.z, b.max.x, b.max.y, b.max.z]
    };
    Array2::from(hierarchy.sources.iter().map(row).collect::<Vec<_>>())
}

pub(super) fn read_source_boxes(array: &Array2<f32>) -> Vec<Extent> {
    let extent = |r: ndarray::ArrayView1<f32>| match (r[0] as u32, box_of(r.slice(ndarray::s![1..]))) {
        (0, b) => Extent::Patches(b),
        (1, b) => Extent::Distant(b),
        _ => Extent::Both,
    };
    array.outer_iter().map(extent).collect()
}

fn box_of(r: ndarray::ArrayView1<f32>) -> Box3 {
    Box3 { min: Vec3::new(r[0], r[1], r[2]), max: Vec3::new(r[3], r[4], r[5]) }
}

/// [nodes × (first child, end; first patch, end)].
pub(super) fn octree_array(tree: &ReceiverTree) -> Array2<u32> {
    let row = |n: &ReceiverNode| [n.children.start, n.children.end, n.patches.start, n.patches.end];
    Array2::from(tree.nodes.iter().map(row).collect::<Vec<_>>())
}

/// [nodes × (least and largest coordinates, m)].
pub(super) fn boxes_array(tree: &ReceiverTree) -> Array2<f32> {
    let row = |n: &ReceiverNode| {
        let (a, b) = (n.bounds.min, n.bounds.max);
        [a.x, a.y, a.z, b.x, b.y, b.z]
    };
    Array2::from(tree.nodes.iter().map(row).collect::<Vec<_>>())
}

pub(super) fn read_octree(nodes: &Array2<u32>, boxes: &Array2<f32>, order: Vec<u32>) -> Option<ReceiverTree> {
    let (count, patches) = (nodes.nrows() as u32, order.len() as u32);
    let node = |((r, b), i): ((ndarray::ArrayView1<u32>, ndarray::ArrayView1<f32>), u32)| {
        let (children, range) = (r[0]..r[1], r[2]..r[3]);
        let whole = children.start <= children.end
            && children.end <= count
            && (children.is_empty() || children.start > i)
            && range.start <= range.end
            && range.end <= patches;
        whole.then_some(ReceiverNode { bounds: box_of(b), children, patches: range })
    };
    let nodes = nodes.outer_iter().zip(boxes.outer_iter()).zip(0..).map(node).collect::<Option<_>>()?;
    order.iter().all(|&p| p < patches).then_some(ReceiverTree { nodes, order })
}

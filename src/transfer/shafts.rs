//! The shaft hierarchy: which sources and receivers an object's box may part (gibson §6).

use super::boxes::Box3;
use super::links::Links;
use super::octree::ReceiverTree;
use super::shaft::Shaft;
use super::tree::{Extent, LightTree};
use super::{ReceiverMesh, SourceTree, Transfers};
use crate::image::luminance;
use glam::Vec3;
use ndarray::Array2;
use serde::{Deserialize, Serialize};

/// Shafts between clusters of sources and of receivers.
///
/// A shaft is kept as its two ends; its planes follow from their boxes ([`Shaft`]).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ShaftHierarchy {
    /// The root first; none where there is no source.
    pub(super) shafts: Vec<ShaftNode>,
    /// Where the nodes of the source tree are.
    pub(super) sources: Vec<Extent>,
    pub(super) receivers: ReceiverTree,
}

/// A shaft between a node of the source tree and one of the receiver tree, and the shafts within it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ShaftNode {
    pub source: u32,
    pub receiver: u32,
    /// Shafts within it, side by side.
    pub first: u32,
    /// None: a leaf.
    pub count: u32,
}

/// Sources and receivers between which an object may stand.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Affected {
    /// Indices of sources, ascending.
    pub sources: Vec<u32>,
    /// Receiver patches, ascending.
    pub patches: Vec<u32>,
}

/// What the hierarchy is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ShaftCounts {
    /// All shafts.
    pub shafts: usize,
    /// Those with none within.
    pub leaves: usize,
    /// Leaves that end above single sources or receiver leaves: too little light passes.
    pub ended: usize,
    /// Memory of one.
    pub bytes_per_shaft: usize,
    /// Nodes of the source tree.
    pub source_nodes: usize,
    /// Nodes of the receiver tree.
    pub receiver_nodes: usize,
}

/// What shafts are built from.
pub(super) struct Ends<'a> {
    pub tree: &'a SourceTree,
    pub lights: &'a LightTree,
    pub receivers: &'a ReceiverMesh,
    pub links: &'a Links,
    /// [receiver vertices × 3]
    pub irradiance: &'a Array2<f32>,
}

struct Builder<'a> {
    ends: &'a Ends<'a>,
    /// Share of a vertex's irradiance.
    share: f64,
    octree: &'a ReceiverTree,
    vertices: Vec<Vec<u32>>,
    /// Luminance by receiver vertex.
    total: Vec<f64>,
    /// Diagonal of the receivers, m: distance at which directions count as places.
    size: f32,
    shafts: Vec<ShaftNode>,
}

/// What passes a shaft.
#[derive(Clone, Copy, PartialEq)]
enum Passes {
    Nothing,
    /// Less than the share at each vertex.
    Little,
    Much,
}

impl ShaftHierarchy {
    /// From the roots down to leaves of both trees, or to where less than `share` of the irradiance of every receiver
    /// vertex passes. Shafts without light have no place: sources turned away, or hidden by the scene, from all the
    /// receivers of a node.
    pub(super) fn build(ends: &Ends, leaf_patches: usize, share: f64) -> Self {
        let octree = ReceiverTree::build(ends.receivers, leaf_patches);
        let total = ends.irradiance.outer_iter().map(|e| f64::from(luminance([e[0], e[1], e[2]]))).collect();
        let size = octree.nodes[0].bounds.size().length();
        let vertices = octree.vertices(ends.receivers);
        let mut builder = Builder { ends, share, octree: &octree, vertices, total, size, shafts: Vec::new() };
        builder.grow();
        let sources = ends.lights.nodes.iter().map(|n| n.extent).collect();
        Self { shafts: builder.shafts, sources, receivers: octree }
    }
}

impl Builder<'_> {
    fn grow(&mut self) {
        if self.ends.tree.nodes.is_empty() {
            return;
        }
        self.shafts.push(ShaftNode { source: 0, receiver: 0, first: 0, count: 0 });
        let mut next = 0;
        let mut deeper = vec![true];
        while next < self.shafts.len() {
            let ShaftNode { source, receiver, .. } = self.shafts[next];
            if deeper[next] {
                let first = self.shafts.len() as u32;
                for (source, receiver) in self.within(source, receiver) {
                    let passes = self.passes(source, receiver);
                    if passes != Passes::Nothing {
                        self.shafts.push(ShaftNode { source, receiver, first: 0, count: 0 });
                        deeper.push(passes == Passes::Much);
                    }
                }
                let count = self.shafts.len() as u32 - first;
                (self.shafts[next].first, self.shafts[next].count) = (first, count);
            }
            next += 1;
        }
    }

    /// The shafts into which one is cut: across its larger end. None between two leaves.
    fn within(&self, source: u32, receiver: u32) -> Vec<(u32, u32)> {
        let node = &self.octree.nodes[receiver as usize];
        let children = self.ends.tree.nodes[source as usize].children;
        let extent = match self.ends.lights.nodes[source as usize].extent {
            Extent::Patches(b) => b.size().length(),
            Extent::Distant(b) => b.size().length() * self.size,
            Extent::Both => f32::INFINITY,
        };
        match children {
            Some(below) if node.children.is_empty() || extent >= node.bounds.size().length() => {
                below.map(|s| (s, receiver)).to_vec()
            }
            _ => node.children.clone().map(|r| (source, r)).collect(),
        }
    }

    /// Irradiance that sources send to the vertices of receivers, against all that these get. What an entry above the
    /// sources holds parts by the averages, but however small, is something.
    fn passes(&self, source: u32, receiver: u32) -> Passes {
        let (nodes, links) = (&self.ends.tree.nodes, self.ends.links);
        let wanted = &nodes[source as usize];
        let mut found = Passes::Nothing;
        for &v in &self.vertices[receiver as usize] {
            let row = links.first[v as usize] as usize..links.first[v as usize + 1] as usize;
            let entries = &links.node[row.clone()];
            let leaves = |&e: &u32| &nodes[e as usize].leaves;
            let from = entries.partition_point(|e| leaves(e).end <= wanted.leaves.start);
            let mut sum = 0.0;
            for (e, irradiance) in entries[from..].iter().zip(&links.irradiance[row.start + from..]) {
                let node = &nodes[*e as usize];
                if node.leaves.start >= wanted.leaves.end {
                    break;
                }
                found = if found == Passes::Nothing { Passes::Little } else { found };
                let part =
                    if node.leaves.len() > wanted.leaves.len() { wanted.mean / node.mean } else { 1.0 };
                sum += f64::from(luminance(*irradiance)) * if part.is_finite() { part } else { 1.0 };
            }
            if sum > 0.0 && sum >= self.share * self.total[v as usize] {
                return Passes::Much;
            }
        }
        found
    }
}

/// Marks of one traversal on the nodes of both trees, kept between frames: a mark is the frame's number, so that none is
/// wiped and each node enters once (gibson §6.1).
#[derive(Debug, Clone, Default)]
pub struct Traversal {
    frame: u32,
    sources: Vec<u32>,
    receivers: Vec<u32>,
    stack: Vec<u32>,
    visited: usize,
}

impl Traversal {
    /// Shafts that the last traversal tested.
    pub fn visited(&self) -> usize {
        self.visited
    }

    /// As [`Transfers::affected`].
    pub fn affected(&mut self, transfers: &Transfers, min: Vec3, max: Vec3) -> Affected {
        let (hierarchy, object) = (&transfers.shafts, Box3 { min, max });
        self.begin(hierarchy);
        let reach = reach(hierarchy, object);
        while let Some(i) = self.stack.pop() {
            let shaft = hierarchy.shafts[i as usize];
            self.visited += 1;
            if !hierarchy.shaft(shaft, reach).meets(object) {
                continue;
            }
            if shaft.count > 0 {
                self.stack.extend(shaft.first..shaft.first + shaft.count);
            } else {
                self.sources[shaft.source as usize] = self.frame;
                self.receivers[shaft.receiver as usize] = self.frame;
            }
        }
        let sources = transfers.tree.nodes.iter().zip(&self.sources);
        let sources = sources.filter(|(_, f)| **f == self.frame).map(|(n, _)| n.leaves.clone());
        let receivers = hierarchy.receivers.nodes.iter().zip(&self.receivers);
        let receivers = receivers.filter(|(_, f)| **f == self.frame).map(|(n, _)| n.patches.clone());
        let patch = |i: u32| transfers.receivers.patches[hierarchy.receivers.order[i as usize] as usize];
        Affected { sources: listed(sources.flatten()), patches: listed(receivers.flatten().map(patch)) }
    }

    fn begin(&mut self, hierarchy: &ShaftHierarchy) {
        self.sources.resize(hierarchy.sources.len(), 0);
        self.receivers.resize(hierarchy.receivers.nodes.len(), 0);
        self.frame = self.frame.wrapping_add(1);
        if self.frame == 0 {
            self.sources.fill(0);
            self.receivers.fill(0);
            self.frame = 1;
        }
        self.visited = 0;
        self.stack.clear();
        if !hierarchy.shafts.is_empty() {
            self.stack.push(0);
        }
    }
}

fn listed(items: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut all: Vec<u32> = items.collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// A distance that no segment between the receivers and the object exceeds, m.
fn reach(hierarchy: &ShaftHierarchy, object: Box3) -> f64 {
    let all = hierarchy.receivers.nodes.first().map_or(object, |n| n.bounds.union(object));
    f64::from(all.size().length()) + 1.0
}

impl ShaftHierarchy {
    fn shaft(&self, node: ShaftNode, reach: f64) -> Shaft {
        let receivers = self.receivers.nodes[node.receiver as usize].bounds;
        Shaft::to(receivers, self.sources[node.source as usize], reach)
    }
}

impl Transfers {
    /// Sources of which something in the box (m, world) may hide a part from a receiver that they light, and those
    /// receivers. May name too many, never too few. For frame after frame, [`Traversal`] does the same.
    pub fn affected(&self, min: Vec3, max: Vec3) -> Affected {
        Traversal::default().affected(self, min, max)
    }

    /// The same without the hierarchy: a shaft for each pair of a source and a receiver patch, lit or not.
    pub fn affected_by_pairs(&self, min: Vec3, max: Vec3) -> Affected {
        let object = Box3 { min, max };
        let reach = reach(&self.shafts, object);
        let single = self.tree.nodes.iter().zip(&self.shafts.sources).filter(|(n, _)| n.children.is_none());
        let sources: Vec<(u32, Extent)> = single.map(|(n, &extent)| (n.leaves.start, extent)).collect();
        let mut found = (vec![false; self.sources.len()], Vec::new());
        for (part, &patch) in self.receivers.parts.iter().zip(&self.receivers.patches) {
            let bounds = Box3::of(part.vertices.map(|v| self.receivers.positions[v as usize]));
            let mut any = false;
            for &(source, extent) in &sources {
                if Shaft::to(bounds, extent, reach).meets(object) {
                    (any, found.0[source as usize]) = (true, true);
                }
            }
            if any {
                found.1.push(patch);
            }
        }
        let marked = (0..self.sources.len() as u32).filter(|&s| found.0[s as usize]);
        Affected { sources: marked.collect(), patches: found.1 }
    }

    /// What the hierarchies are made of.
    pub fn shaft_counts(&self) -> ShaftCounts {
        let hierarchy = &self.shafts;
        let leaves = || hierarchy.shafts.iter().filter(|s| s.count == 0);
        let whole = |s: &&ShaftNode| {
            let receivers = &hierarchy.receivers.nodes[s.receiver as usize];
            receivers.children.is_empty() && self.tree.nodes[s.source as usize].children.is_none()
        };
        ShaftCounts {
            shafts: hierarchy.shafts.len(),
            leaves: leaves().count(),
            ended: leaves().filter(|s| !whole(s)).count(),
            bytes_per_shaft: size_of::<ShaftNode>(),
            source_nodes: hierarchy.sources.len(),
            receiver_nodes: hierarchy.receivers.nodes.len(),
        }
    }
}

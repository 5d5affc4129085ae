//! All light at receiver points: the cut of the source set's tree, and how much the rest adds.

use super::blockers::{Blockers, Sides};
use super::field::{LightField, Point};
use super::gather::{Fineness, Gatherer, OFFSET_M, Sent};
use super::links::{Cutter, Entry};
use super::lobe::Finish;
use super::octree::ReceiverTree;
use super::receivers::ReceiverMesh;
use super::sets;
use super::{SourceTree, tree::LightTree};
use crate::illuminate::patch::PatchMesh;
use crate::image::luminance;
use crate::visibility::Bvh;
use glam::Vec3;
use rayon::prelude::*;
use std::sync::OnceLock;

/// Vertices move towards the middle of their triangles by this share of the distance, so that one on the border of a
/// face looks past the wall that adjoins there.
const INSET: f32 = 0.02;
/// Receiver patches that ask together what may stand between them and the lights.
const GROUP_PATCHES: usize = 32;
/// Points whose results are held before they are summed.
const BATCH: usize = 64;

/// Lights, and where they lie to the scene's planes.
pub(super) struct Field {
    pub lights: LightField,
    sides: Sides,
    /// By group of receivers: the nodes that nothing can hide from it, found when it is asked for.
    free: Vec<OnceLock<Vec<bool>>>,
}

/// The static scene around the receivers.
pub(super) struct Surroundings<'a> {
    mesh: &'a PatchMesh,
    finish: Option<Finish<'a>>,
    blockers: Blockers,
    gatherer: Gatherer<'a>,
    /// Group of each receiver patch, in the order of [`ReceiverMesh::patches`].
    group_of: Vec<u32>,
    /// Corners of each group as far inset as they may be, m: their hull holds every point of the group.
    places: Vec<Vec<Vec3>>,
}

/// What a receiver vertex gets.
#[derive(Debug, Clone, Default)]
pub(super) struct Row {
    pub cut: Vec<Entry>,
    /// From all lights, plate units.
    pub irradiance: [f32; 3],
    /// Share that comes from outside the source set.
    pub left_out: f64,
    /// Luminance that each of some clusters sends, and would send with nothing between.
    pub profile: Vec<[f32; 2]>,
}

/// The source set and the rest.
pub(super) struct Lighting<'a> {
    pub set: &'a Field,
    pub rest: &'a Field,
    pub tree: &'a SourceTree,
    /// First leaf of each cluster of the profiles.
    pub profile: &'a [u32],
    pub tolerance: f64,
}

impl<'a> Surroundings<'a> {
    pub fn new(
        mesh: &'a PatchMesh,
        finish: Option<Finish<'a>>,
        receivers: &ReceiverMesh,
        bvh: &'a Bvh,
        rays: u32,
    ) -> Self {
        let octree = ReceiverTree::build(receivers, GROUP_PATCHES);
        let mut group_of = vec![0; receivers.patches.len()];
        for (node, group) in octree.nodes.iter().zip(0..).filter(|(n, _)| n.children.is_empty()) {
            let members = &octree.order[node.patches.start as usize..node.patches.end as usize];
            members.iter().for_each(|&i| group_of[i as usize] = group);
        }
        let mut around = vec![Vec::new(); receivers.positions.len()];
        for t in &receivers.triangles {
            t.vertices.iter().for_each(|&v| around[v as usize].extend(t.vertices));
        }
        let at = |v: u32| receivers.positions[v as usize];
        let inset = |&v: &u32| {
            let base = at(v) + receivers.normals[v as usize] * OFFSET_M;
            around[v as usize].iter().map(move |&w| base + (at(w) - at(v)) * INSET)
        };
        let vertices = octree.vertices(receivers);
        let places = vertices.iter().map(|group| group.iter().flat_map(inset).collect()).collect();
        let (blockers, gatherer) = (Blockers::new(mesh), Gatherer { bvh, rays });
        Self { mesh, finish, blockers, gatherer, group_of, places }
    }

    pub fn field(&self, lights: LightField) -> Field {
        let free = self.places.iter().map(|_| OnceLock::new()).collect();
        Field { sides: self.blockers.sides(&lights), lights, free }
    }

    /// Of each node of a field whether nothing stands between it and a group.
    fn free<'f>(&self, field: &'f Field, group: u32) -> &'f [bool] {
        let find = || self.blockers.free(&field.lights, &field.sides, &self.places[group as usize]);
        field.free[group as usize].get_or_init(find)
    }

    /// Group of a patch.
    pub fn group(&self, receivers: &ReceiverMesh, patch: u32) -> u32 {
        receivers.patches.binary_search(&patch).map_or(0, |i| self.group_of[i])
    }

    /// A point of a patch as rays see it; the centroids of the receiver triangles around it are given as sum and number.
    pub fn point(&self, patch: u32, position: Vec3, normal: Vec3, (sum, count): (Vec3, f32)) -> Point {
        let inset = (sum / count - position) * INSET;
        let patch = &self.mesh.patches[patch as usize];
        let lobe = self.finish.and_then(|f| f.lobe(patch, position, normal));
        Point { position: position + inset + normal * OFFSET_M, normal, lobe }
    }

    /// What each light of a field (in the order of its leaves) sends to some points together: luminance × weight, and share of
    /// the point's light × weight. Rays to few points take less time than to find out where none are needed.
    pub fn received(&self, field: &LightField, points: &[(Point, f64)], tolerance: f64) -> [Vec<f64>; 2] {
        let free = vec![false; field.tree.nodes.len()];
        let part = |sent: &mut Vec<Sent>, (point, weight): &(Point, f64)| {
            let about = self.gatherer.about(field, &free, point, sent);
            let fineness = Fineness { most: tolerance * about, coarse: false };
            self.gatherer.cut(field, &free, point, fineness, sent);
            let (mut part, all) = (Vec::new(), sets::magnitude(sent));
            // Where no light arrives there is none to share.
            if all > 0.0 {
                sets::by_light(field, sent, |leaf, e| part.push((leaf, [e, e / all].map(|e| e * weight))));
            }
            part
        };
        let mut received = [0, 1].map(|_| vec![0.0; field.lights.len()]);
        for points in points.chunks(BATCH) {
            let parts: Vec<Vec<(usize, [f64; 2])>> = points.par_iter().map_init(Vec::new, part).collect();
            for &(leaf, sent) in parts.iter().flatten() {
                (0..2).for_each(|k| received[k][leaf] += sent[k]);
            }
        }
        received
    }

    /// The rows of some points; `done` is called for each.
    pub fn rows(&self, lighting: &Lighting, points: &[(u32, Point)], done: &(impl Fn() + Sync)) -> Vec<Row> {
        let row = |sent: &mut [Vec<Sent>; 2], (group, point): &(u32, Point)| {
            let free = [lighting.set, lighting.rest].map(|f| self.free(f, *group));
            let row = self.row(lighting, point, free, sent);
            done();
            row
        };
        points.par_iter().map_init(Default::default, row).collect()
    }

    fn row(&self, lighting: &Lighting, p: &Point, free: [&[bool]; 2], sent: &mut [Vec<Sent>; 2]) -> Row {
        let fields = [lighting.set, lighting.rest];
        let mut about = 0.0;
        if lighting.tolerance > 0.0 {
            for k in 0..2 {
                about += self.gatherer.about(&fields[k].lights, free[k], p, &mut sent[k]);
            }
        }
        // How a far cluster's light parts may be wrong by twice what it sends.
        let fineness = Fineness { most: lighting.tolerance / 2.0 * about, coarse: false };
        let mut sums = [[0.0f64; 3]; 2];
        for k in 0..2 {
            self.gatherer.cut(&fields[k].lights, free[k], p, fineness, &mut sent[k]);
            for s in &sent[k] {
                (0..3).for_each(|c| sums[k][c] += f64::from(s.irradiance[c]));
            }
        }
        let irradiance = std::array::from_fn(|c| (sums[0][c] + sums[1][c]) as f32);
        let bright = |e: [f64; 3]| f64::from(luminance(e.map(|c| c as f32)));
        let total = f64::from(luminance(irradiance));
        let fine: Vec<Entry> =
            sent[0].iter().filter(|s| s.irradiance != [0.0; 3]).map(|s| (s.node, s.irradiance)).collect();
        Row {
            cut: Cutter { tree: lighting.tree, tolerance: lighting.tolerance }.coarsen(&fine, total),
            irradiance,
            left_out: if total > 0.0 { bright(sums[1]) / total } else { 0.0 },
            profile: profile(&sent[0], &lighting.set.lights.tree, lighting.profile),
        }
    }
}

fn profile(sent: &[Sent], tree: &LightTree, first_leaves: &[u32]) -> Vec<[f32; 2]> {
    let mut profile = vec![[0.0; 2]; first_leaves.len()];
    for s in sent {
        let start = tree.nodes[s.node as usize].leaves.start;
        let cluster = &mut profile[first_leaves.partition_point(|&f| f <= start) - 1];
        *cluster = [cluster[0] + luminance(s.irradiance), cluster[1] + s.open];
    }
    profile
}

/// First leaves of `count` clusters that together hold all sources: the strongest are parted first.
pub(super) fn strong_clusters(tree: &SourceTree, count: usize) -> Vec<u32> {
    let mut nodes = if tree.nodes.is_empty() { Vec::new() } else { vec![0u32] };
    while nodes.len() < count {
        let mean = |i: u32| tree.nodes[i as usize].mean;
        let inner = (0..nodes.len()).filter(|&k| tree.nodes[nodes[k] as usize].children.is_some());
        let Some(k) = inner.max_by(|&a, &b| mean(nodes[a]).total_cmp(&mean(nodes[b]))) else { break };
        let Some(below) = tree.nodes[nodes.swap_remove(k) as usize].children else { break };
        nodes.extend(below);
    }
    let mut first: Vec<u32> = nodes.iter().map(|&i| tree.nodes[i as usize].leaves.start).collect();
    first.sort_unstable();
    first
}

/// The vertices of receivers with their groups.
pub(super) fn vertex_points(receivers: &ReceiverMesh, surroundings: &Surroundings) -> Vec<(u32, Point)> {
    let mut around = vec![(Vec3::ZERO, 0.0f32); receivers.positions.len()];
    let mut patches = vec![0; receivers.positions.len()];
    for t in &receivers.triangles {
        for v in t.vertices.map(|v| v as usize) {
            around[v] = (around[v].0 + receivers.centroid(t), around[v].1 + 1.0);
            patches[v] = t.patch;
        }
    }
    let point = |v: usize| {
        let (position, normal) = (receivers.positions[v], receivers.normals[v]);
        let group = surroundings.group(receivers, patches[v]);
        (group, surroundings.point(patches[v], position, normal, around[v]))
    };
    (0..receivers.positions.len()).map(point).collect()
}

//! Sparse transfers: for every receiver vertex a cut of the source tree.
//!
//! An entry at an inner node holds the sum of what the sources below send to the vertex; how it parts among them is the
//! tree's average. The cut is as coarse as that allows: for each entry, what the sources below really send and what
//! their average share says differ by at most the tolerance times the vertex's irradiance (sum of absolute differences of
//! luminance over the sources).

use super::tree::{LightNode, LightTree};
use super::{Source, SourceNode, SourceTree, Transfers};
use crate::image::luminance;
use ndarray::Array3;
use std::ops::Range;

/// Transfers by receiver vertex: vertex v has the entries `first[v]..first[v + 1]`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Links {
    /// One more than there are vertices.
    pub first: Vec<u32>,
    /// Nodes of the source tree; at each vertex none below another, ascending by their leaves.
    pub node: Vec<u32>,
    /// Irradiance from all sources below the node, plate units.
    pub irradiance: Vec<[f32; 3]>,
}

/// What a node sends to a vertex.
pub(super) type Entry = (u32, [f32; 3]);

impl Links {
    /// From the cuts of all vertices.
    pub(super) fn of(cuts: &[Vec<Entry>]) -> Self {
        let entries = || cuts.iter().flatten();
        let ends = cuts.iter().scan(0, |sum, cut| {
            *sum += cut.len() as u32;
            Some(*sum)
        });
        Self {
            first: std::iter::once(0).chain(ends).collect(),
            node: entries().map(|e| e.0).collect(),
            irradiance: entries().map(|e| e.1).collect(),
        }
    }

    /// The entries of a vertex.
    pub fn at(&self, vertex: u32) -> impl Iterator<Item = (u32, [f32; 3])> + '_ {
        let range = self.first[vertex as usize] as usize..self.first[vertex as usize + 1] as usize;
        self.node[range.clone()].iter().copied().zip(self.irradiance[range].iter().copied())
    }
}

/// Makes cuts of rows: the tree's shape and its average transfers.
pub(super) struct Cutter<'a> {
    pub tree: &'a SourceTree,
    /// Largest misattributed share of a vertex's irradiance in one entry.
    pub tolerance: f64,
}

/// A subtree as the cut sees it.
struct Below {
    /// Irradiance from it.
    sum: [f64; 3],
    /// Bound on the sum of absolute errors if it is one entry, as luminance.
    error: f64,
}

impl Cutter<'_> {
    /// Coarsens a cut (entries ascending by leaves); `total` is the vertex's whole irradiance as luminance.
    pub fn coarsen(&self, fine: &[Entry], total: f64) -> Vec<Entry> {
        let mut cut = Vec::with_capacity(fine.len());
        if !self.tree.nodes.is_empty() {
            self.visit(0, fine, self.tolerance * total, &mut cut);
        }
        cut
    }

    /// Appends the cut of a node; `Some` while the node may be one entry.
    fn visit(&self, node: u32, fine: &[Entry], most: f64, cut: &mut Vec<Entry>) -> Option<Below> {
        let Some(&(at, irradiance)) = fine.first() else {
            return Some(Below { sum: [0.0; 3], error: 0.0 });
        };
        let n = &self.tree.nodes[node as usize];
        if at == node {
            cut.push((node, irradiance));
            let sum = irradiance.map(f64::from);
            // Nothing is known of how a coarse entry parts: at worst, as two that have nothing in common.
            let error = if n.children.is_some() { 2.0 * bright(sum) } else { 0.0 };
            return Some(Below { sum, error });
        }
        let [a, b] = n.children?;
        let start = self.tree.nodes[b as usize].leaves.start;
        let middle = fine.partition_point(|e| self.tree.nodes[e.0 as usize].leaves.start < start);
        let before = cut.len();
        let below = (self.visit(a, &fine[..middle], most, cut), self.visit(b, &fine[middle..], most, cut));
        let (Some(x), Some(y)) = below else { return None };
        let sum: [f64; 3] = std::array::from_fn(|c| x.sum[c] + y.sum[c]);
        let share = self.tree.share(a, b);
        let off = std::array::from_fn(|c| (x.sum[c] - share * sum[c]).abs());
        let error = x.error + y.error + 2.0 * bright(off);
        if error > most {
            return None;
        }
        if cut.len() > before {
            cut.truncate(before);
            cut.push((node, sum.map(|c| c as f32)));
        }
        Some(Below { sum, error })
    }
}

fn bright(c: [f64; 3]) -> f64 {
    f64::from(luminance(c.map(|c| c as f32)))
}

impl SourceTree {
    /// Share that the first of two sisters has in their average transfer.
    fn share(&self, a: u32, b: u32) -> f64 {
        let (x, y) = (&self.nodes[a as usize], &self.nodes[b as usize]);
        let both = x.mean + y.mean;
        if both > 0.0 {
            return x.mean / both;
        }
        x.leaves.len() as f64 / (x.leaves.len() + y.leaves.len()) as f64
    }

    /// Shares that the sources have in a node's average transfer: calls `each` with source and share.
    fn spread(&self, node: u32, share: f64, each: &mut impl FnMut(u32, f64)) {
        match self.nodes[node as usize].children {
            None => each(self.nodes[node as usize].leaves.start, share),
            Some([a, b]) => {
                let first = self.share(a, b);
                self.spread(a, share * first, each);
                self.spread(b, share * (1.0 - first), each);
            }
        }
    }

    /// Share of the marked sources of a range in a node's average transfer.
    fn share_of(&self, node: u32, range: &Range<u32>, marked: &[u32]) -> f64 {
        let n = &self.nodes[node as usize];
        let (low, high) = (n.leaves.start.max(range.start), n.leaves.end.min(range.end));
        if low >= high || marked[low as usize] == marked[high as usize] {
            return 0.0;
        }
        let whole = low == n.leaves.start && high == n.leaves.end;
        if whole && marked[high as usize] - marked[low as usize] == high - low {
            return 1.0;
        }
        let Some([a, b]) = n.children else { return 0.0 };
        let first = self.share(a, b);
        first * self.share_of(a, range, marked) + (1.0 - first) * self.share_of(b, range, marked)
    }

    /// The shape of a light tree, with the average transfers of its sources.
    pub(super) fn of(tree: &LightTree, sources: &[Source]) -> Self {
        let node = |n: &LightNode| SourceNode { leaves: n.leaves.clone(), children: n.children, mean: 0.0 };
        let mut tree = Self { nodes: tree.nodes.iter().map(node).collect() };
        tree.sum_means(sources);
        tree
    }

    /// Average transfers of all nodes from those of the sources.
    pub(super) fn sum_means(&mut self, sources: &[Source]) {
        for i in (0..self.nodes.len()).rev() {
            self.nodes[i].mean = match self.nodes[i].children {
                None => sources[self.nodes[i].leaves.start as usize].mean,
                Some([a, b]) => self.nodes[a as usize].mean + self.nodes[b as usize].mean,
            };
        }
    }
}

impl Transfers {
    /// Irradiance of each source at a receiver vertex, plate units, [sources]: entries of inner nodes are spread over their
    /// sources by the average transfers.
    pub fn expand(&self, vertex: u32, out: &mut [[f32; 3]]) {
        out.fill([0.0; 3]);
        for (node, irradiance) in self.links.at(vertex) {
            self.tree.spread(node, 1.0, &mut |source, share| {
                out[source as usize] = irradiance.map(|c| (f64::from(c) * share) as f32);
            });
        }
    }

    /// Irradiance that clusters send to vertices, plate units, [vertices × clusters × 3] in the order given. Clusters are
    /// disjoint ascending ranges of sources, of which only the marked ones ([sources]) count.
    pub fn gather(&self, marked: &[bool], clusters: &[Range<u32>], vertices: &[u32]) -> Array3<f32> {
        let marks = std::iter::once(0).chain(marked.iter().scan(0, |sum, &m| {
            *sum += u32::from(m);
            Some(*sum)
        }));
        let marks: Vec<u32> = marks.collect();
        let mut out = Array3::zeros((vertices.len(), clusters.len(), 3));
        for (mut row, &vertex) in out.outer_iter_mut().zip(vertices) {
            let mut from = 0;
            for (node, irradiance) in self.links.at(vertex) {
                let leaves = &self.tree.nodes[node as usize].leaves;
                while clusters.get(from).is_some_and(|c| c.end <= leaves.start) {
                    from += 1;
                }
                for (k, cluster) in clusters.iter().enumerate().skip(from) {
                    if cluster.start >= leaves.end {
                        break;
                    }
                    let share = self.tree.share_of(node, cluster, &marks);
                    for c in 0..3 {
                        row[(k, c)] += (f64::from(irradiance[c]) * share) as f32;
                    }
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::super::SourceKind;
    use super::*;
    use proptest::prelude::*;

    /// A balanced tree over sources of the given average transfers.
    fn tree(means: &[f64]) -> SourceTree {
        fn grow(tree: &mut SourceTree, means: &[f64], leaves: Range<u32>) -> u32 {
            let at = tree.nodes.len();
            let mean = means[leaves.start as usize..leaves.end as usize].iter().sum();
            tree.nodes.push(SourceNode { leaves: leaves.clone(), children: None, mean });
            if leaves.len() > 1 {
                let middle = leaves.start + leaves.len() as u32 / 2;
                let a = grow(tree, means, leaves.start..middle);
                let b = grow(tree, means, middle..leaves.end);
                tree.nodes[at].children = Some([a, b]);
            }
            at as u32
        }
        let mut tree = SourceTree { nodes: Vec::new() };
        grow(&mut tree, means, 0..means.len() as u32);
        tree
    }

    fn leaf_of(tree: &SourceTree, source: u32) -> u32 {
        let leaf = |n: &SourceNode| n.children.is_none() && n.leaves.start == source;
        tree.nodes.iter().position(leaf).unwrap() as u32
    }

    fn transfers(means: &[f64], rows: &[Vec<[f32; 3]>], tolerance: f64) -> Transfers {
        let tree = tree(means);
        let cuts: Vec<_> = rows
            .iter()
            .map(|row| {
                let fine: Vec<_> = (0..row.len())
                    .filter(|&j| row[j] != [0.0; 3])
                    .map(|j| (leaf_of(&tree, j as u32), row[j]))
                    .collect();
                let total = row.iter().map(|&e| f64::from(luminance(e))).sum();
                Cutter { tree: &tree, tolerance }.coarsen(&fine, total)
            })
            .collect();
        let source = |mean: &f64| Source { kind: SourceKind::Patch(0), power_share: 0.0, mean: *mean };
        Transfers {
            sources: means.iter().map(source).collect(),
            links: Links::of(&cuts),
            tree,
            ..Default::default()
        }
    }

    fn rows() -> impl Strategy<Value = (Vec<f64>, Vec<Vec<[f32; 3]>>)> {
        (1usize..40).prop_flat_map(|n| {
            let value = prop_oneof![2 => Just(0.0f32), 3 => 1e-6..1.0f32, 1 => 1.0..1e6f32];
            let colour = (value, 0.1..1.0f32).prop_map(|(v, g)| [v, v * g, v * 0.3]);
            let row = prop::collection::vec(colour, n);
            (
                prop::collection::vec(prop_oneof![1 => Just(0.0), 4 => 1e-6..1e3f64], n),
                prop::collection::vec(row, 1..4),
            )
        })
    }

    proptest! {
        #[test]
        fn cuts_keep_every_sum_and_their_bound((means, rows) in rows(), tolerance in 0.0..0.3f64) {
            let t = transfers(&means, &rows, tolerance);
            let mut out = vec![[0.0; 3]; means.len()];
            for (v, row) in rows.iter().enumerate() {
                let total: f64 = row.iter().map(|&e| f64::from(luminance(e))).sum();
                let mut end = 0;
                for (node, irradiance) in t.links.at(v as u32) {
                    let leaves = t.tree.nodes[node as usize].leaves.clone();
                    prop_assert!(leaves.start >= end, "entries overlap");
                    end = leaves.end;
                    let below = &row[leaves.start as usize..leaves.end as usize];
                    for c in 0..3 {
                        let sum: f64 = below.iter().map(|e| f64::from(e[c])).sum();
                        prop_assert!((f64::from(irradiance[c]) - sum).abs() <= 1e-6 * sum);
                    }
                    t.expand(v as u32, &mut out);
                    let off: f64 = leaves.clone().map(|j| {
                        let (a, b) = (row[j as usize], out[j as usize]);
                        f64::from(luminance(std::array::from_fn(|c| (a[c] - b[c]).abs())))
                    }).sum();
                    prop_assert!(off <= (tolerance + 1e-5) * total, "{} misattributed of {}", off, total);
                }
                if tolerance == 0.0 {
                    prop_assert_eq!(&out, row);
                }
            }
        }

        #[test]
        fn clusters_gather_what_their_marked_sources_send((means, rows) in rows(), marks in prop::collection::vec(any::<bool>(), 40), step in 1u32..9) {
            let t = transfers(&means, &rows, 0.05);
            let n = means.len() as u32;
            let clusters: Vec<_> = (0..n).step_by(step as usize).map(|a| a..(a + step.max(2) - 1).min(n)).collect();
            let vertices: Vec<u32> = (0..rows.len() as u32).collect();
            let found = t.gather(&marks[..n as usize], &clusters, &vertices);
            let mut out = vec![[0.0; 3]; n as usize];
            for &v in &vertices {
                t.expand(v, &mut out);
                for (k, cluster) in clusters.iter().enumerate() {
                    for c in 0..3 {
                        let sum: f64 = cluster.clone().filter(|&j| marks[j as usize]).map(|j| f64::from(out[j as usize][c])).sum();
                        prop_assert!((f64::from(found[(v as usize, k, c)]) - sum).abs() <= 1e-5 * sum);
                    }
                }
            }
        }
    }

    #[test]
    fn what_parts_like_the_average_is_one_entry() {
        let means = [1.0, 2.0, 3.0, 4.0];
        let row: Vec<_> = means.iter().map(|&m| [m as f32 * 2.0; 3]).collect();
        let t = transfers(&means, &[row], 1e-6);
        assert_eq!((t.links.node, t.links.irradiance), (vec![0], vec![[20.0; 3]]));
    }
}

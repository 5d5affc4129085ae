//! The representative source set (Gibson et al. 2003, §8): a frame's sources in at most n clusters.

use crate::transfer::SourceTree;
use glam::DVec3;
use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::ops::Range;

/// What a frame knows of a source.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Seen {
    /// Irradiance that it sends to where its shadow falls, in any one unit: its weight within a cluster.
    pub weight: f64,
    /// Light that the picture loses of it, in any one unit.
    pub lost: f64,
    /// Whether the object may stand in its light at all.
    pub marked: bool,
    /// Unit direction towards its centre from the object's.
    pub direction: DVec3,
    /// Variance of the directions towards its points, rad².
    pub own_variance: f64,
    /// Its centre, m; `None`: distant.
    pub position: Option<DVec3>,
}

/// Sums over the marked sources before each leaf, so that those of any node are a difference.
pub(crate) struct Moments(Vec<Sum>);

/// Sums over some sources.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sum {
    /// Marked sources.
    pub count: u32,
    pub weight: f64,
    pub lost: f64,
    direction: DVec3,
    own_variance: f64,
    position: DVec3,
    near: f64,
}

impl Moments {
    pub fn new(sources: &[Seen]) -> Self {
        let mut sums = Vec::with_capacity(sources.len() + 1);
        let mut sum = Sum::default();
        sums.push(sum);
        for source in sources {
            if source.marked {
                let w = source.weight;
                sum.count += 1;
                sum.weight += w;
                sum.lost += source.lost;
                sum.direction += source.direction * w;
                sum.own_variance += source.own_variance * w;
                if let Some(p) = source.position {
                    sum.position += p * w;
                    sum.near += w;
                }
            }
            sums.push(sum);
        }
        Self(sums)
    }

    pub fn of(&self, leaves: &Range<u32>) -> Sum {
        let (a, b) = (self.0[leaves.start as usize], self.0[leaves.end as usize]);
        Sum {
            count: b.count - a.count,
            weight: b.weight - a.weight,
            lost: b.lost - a.lost,
            direction: b.direction - a.direction,
            own_variance: b.own_variance - a.own_variance,
            position: b.position - a.position,
            near: b.near - a.near,
        }
    }
}

impl Sum {
    /// Variance of the directions towards the light, rad²: that of the centres and that within the sources.
    pub fn variance(&self) -> f64 {
        if self.weight <= 0.0 {
            return 0.0;
        }
        // |d| = 1: E|d|² − |E d|².
        let between = 1.0 - (self.direction / self.weight).length_squared();
        between.max(0.0) + self.own_variance / self.weight
    }

    /// Mean position of those with a place, if they carry at least half of the light.
    pub fn centroid(&self) -> Option<DVec3> {
        (self.near > 0.0 && 2.0 * self.near >= self.weight).then(|| self.position / self.near)
    }

    /// Mean direction.
    pub fn direction(&self) -> Option<DVec3> {
        self.direction.try_normalize()
    }
}

/// An entry of the queue; the larger key first, then the smaller node, so that the order is one.
struct Entry {
    key: f64,
    node: u32,
}

impl Ord for Entry {
    fn cmp(&self, other: &Self) -> Ordering {
        self.key.total_cmp(&other.key).then(other.node.cmp(&self.node))
    }
}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Entry {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Entry {}

/// Nodes of the tree, in the order of their leaves, that hold every marked source once; at most `count`, 0 for one a
/// source. The node of which the picture loses most is split first: the paper's largest average transfer, taken where the
/// shadow falls.
pub(crate) fn representatives(tree: &SourceTree, moments: &Moments, count: usize) -> Vec<u32> {
    let entry = |node: u32| {
        let sum = moments.of(&tree.nodes[node as usize].leaves);
        (sum.count > 0).then_some(Entry { key: sum.lost, node })
    };
    let most = if count == 0 { usize::MAX } else { count };
    let mut queue: BinaryHeap<Entry> =
        if tree.nodes.is_empty() { None } else { entry(0) }.into_iter().collect();
    let mut chosen: Vec<u32> = Vec::new();
    while chosen.len() + queue.len() < most {
        let Some(Entry { node, .. }) = queue.pop() else { break };
        match tree.nodes[node as usize].children {
            Some(children) => queue.extend(children.into_iter().filter_map(entry)),
            None => chosen.push(node),
        }
    }
    chosen.extend(queue.into_iter().map(|e| e.node));
    chosen.sort_by_key(|&n| tree.nodes[n as usize].leaves.start);
    chosen
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::transfer::SourceNode;
    use proptest::prelude::*;

    /// A balanced tree, children after their parents.
    pub fn balanced(leaves: u32) -> SourceTree {
        let mut nodes = vec![SourceNode { leaves: 0..leaves, children: None, mean: 0.0 }];
        let mut next = 0;
        while next < nodes.len() {
            let Range { start, end } = nodes[next].leaves;
            if end - start > 1 {
                let (middle, first) = (start + (end - start) / 2, nodes.len() as u32);
                nodes[next].children = Some([first, first + 1]);
                nodes.push(SourceNode { leaves: start..middle, children: None, mean: 0.0 });
                nodes.push(SourceNode { leaves: middle..end, children: None, mean: 0.0 });
            }
            next += 1;
        }
        SourceTree { nodes }
    }

    fn seen(weights: &[f64]) -> Vec<Seen> {
        let seen = |(i, &weight): (usize, &f64)| {
            let direction = DVec3::new((i as f64).cos(), 1.0, (i as f64).sin()).normalize();
            Seen {
                weight,
                lost: weight,
                marked: weight > 0.0,
                direction,
                own_variance: 1e-3,
                position: Some(direction * 2.0),
            }
        };
        weights.iter().enumerate().map(seen).collect()
    }

    proptest! {
        #[test]
        fn every_marked_source_is_in_one_cluster(
            weights in proptest::collection::vec(prop_oneof![Just(0.0), 1e-6..1.0f64], 1..80), count in 0usize..100,
        ) {
            let tree = balanced(weights.len() as u32);
            let moments = Moments::new(&seen(&weights));
            let nodes = representatives(&tree, &moments, count);
            let marked = weights.iter().filter(|w| **w > 0.0).count();
            let expected = if count == 0 { marked } else { marked.min(count) };
            prop_assert_eq!(nodes.len(), expected);
            let (mut end, mut total, mut sources) = (0, 0.0, 0);
            for &n in &nodes {
                let leaves = &tree.nodes[n as usize].leaves;
                prop_assert!(leaves.start >= end, "ascending, disjoint");
                end = leaves.end;
                let sum = moments.of(leaves);
                total += sum.weight;
                sources += sum.count as usize;
            }
            prop_assert_eq!(sources, marked);
            prop_assert!((total - weights.iter().sum::<f64>()).abs() < 1e-9);
        }
    }

    #[test]
    fn the_largest_loss_is_split_first() {
        let tree = balanced(4);
        let moments = Moments::new(&seen(&[0.1, 0.1, 0.4, 0.4]));
        let leaves = |count| -> Vec<Range<u32>> {
            let nodes = representatives(&tree, &moments, count);
            nodes.iter().map(|&n| tree.nodes[n as usize].leaves.clone()).collect()
        };
        assert_eq!(leaves(1), std::slice::from_ref(&(0..4)));
        assert_eq!(leaves(2), [0..2, 2..4]);
        assert_eq!(leaves(3), [0..2, 2..3, 3..4]);
    }

    #[test]
    fn spread_is_that_of_the_directions() {
        let at = |x: f64| Seen {
            weight: 1.0,
            marked: true,
            direction: DVec3::new(x, 1.0, 0.0).normalize(),
            ..Seen::default()
        };
        let moments = Moments::new(&[at(-0.1), at(0.1)]);
        assert!((moments.of(&(0..2)).variance() - 0.01).abs() < 2e-4);
        assert_eq!(moments.of(&(0..1)).variance(), 0.0);
    }
}

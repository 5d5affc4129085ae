//! The source kd-tree: compact clusters of like orientation, down to single sources (gibson §6).

use super::boxes::Box3;
use super::lights::Light;
use glam::Vec3;
use std::ops::Range;

/// What a node of a light tree holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Extent {
    /// Patches within a box, m.
    Patches(Box3),
    /// Distant sources whose directions lie within a box.
    Distant(Box3),
    /// Both.
    Both,
}

/// A node of a binary tree over lights.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LightNode {
    /// Lights below, in the order of the leaves.
    pub leaves: Range<u32>,
    /// Indices of the nodes below, which come later; `None`: one light.
    pub children: Option<[u32; 2]>,
    pub extent: Extent,
}

/// A binary tree over lights.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct LightTree {
    /// The root first. Empty where there is no light.
    pub nodes: Vec<LightNode>,
    /// Index of each leaf's light, in depth-first order.
    pub order: Vec<u32>,
}

/// How far two opposite normals count as apart, as a share of the diagonal of all patches.
const ORIENTATION: f32 = 1.0;

struct Builder<'a> {
    lights: &'a [Light],
    /// m per unit of normal.
    normal_scale: f32,
    nodes: Vec<LightNode>,
}

impl LightTree {
    /// Patches and distant sources in subtrees of their own, each split across the longest side of its box, which has
    /// six sides: position and normal.
    pub fn build(lights: &[Light]) -> Self {
        let (mut order, distant): (Vec<u32>, Vec<u32>) =
            (0..lights.len() as u32).partition(|&i| !lights[i as usize].is_distant());
        let room = Box3::of(order.iter().map(|&i| lights[i as usize].centre()));
        let patches = order.len();
        order.extend(distant);
        let normal_scale = ORIENTATION / 2.0 * room.size().length();
        let mut builder = Builder { lights, normal_scale, nodes: Vec::with_capacity(2 * lights.len()) };
        let all = order.len();
        if patches > 0 && patches < all {
            let leaves = 0..all as u32;
            builder.nodes.push(LightNode { leaves, children: None, extent: Extent::Both });
            let children =
                [builder.grow(&mut order[..patches], 0), builder.grow(&mut order[patches..], patches as u32)];
            builder.nodes[0].children = Some(children);
        } else if all > 0 {
            builder.grow(&mut order, 0);
        }
        Self { nodes: builder.nodes, order }
    }
}

impl Builder<'_> {
    /// Adds the node of some lights whose leaves begin at `first`; gives its index.
    fn grow(&mut self, members: &mut [u32], first: u32) -> u32 {
        let index = self.nodes.len();
        let light = |i: &u32| &self.lights[*i as usize];
        let bounds = members.iter().fold(Box3::EMPTY, |b, i| b.union(light(i).bounds()));
        let distant = light(&members[0]).is_distant();
        let extent = if distant { Extent::Distant(bounds) } else { Extent::Patches(bounds) };
        let leaves = first..first + members.len() as u32;
        let split = (members.len() > 1).then(|| self.split(members));
        self.nodes.push(LightNode { leaves, children: None, extent });
        if let Some(middle) = split {
            let (low, high) = members.split_at_mut(middle);
            let children = [self.grow(low, first), self.grow(high, first + middle as u32)];
            self.nodes[index].children = Some(children);
        }
        index as u32
    }

    /// Parts the members at the middle of the longest side; in halves where the middle does not part them, or so unevenly
    /// that the tree would grow deep. Neither part is empty.
    fn split(&self, members: &mut [u32]) -> usize {
        let key = |i: u32| {
            let light = &self.lights[i as usize];
            (light.centre(), light.normal() * self.normal_scale)
        };
        let positions = Box3::of(members.iter().map(|&i| key(i).0));
        let normals = Box3::of(members.iter().map(|&i| key(i).1));
        let (place, turn) = (positions.size(), normals.size());
        let by_normal = turn.max_element() > place.max_element();
        let (side, bounds) = if by_normal { (turn, normals) } else { (place, positions) };
        let axis = longest(side);
        let value = |i: u32| if by_normal { key(i).1[axis] } else { key(i).0[axis] };
        let middle = bounds.centre()[axis];
        let low = members.iter().filter(|&&i| value(i) < middle).count();
        if low.min(members.len() - low) * 32 >= members.len().max(32) {
            members.sort_by_key(|&i| value(i) >= middle);
            return low;
        }
        members.sort_by(|&a, &b| value(a).total_cmp(&value(b)).then(a.cmp(&b)));
        members.len() / 2
    }
}

fn longest(side: Vec3) -> usize {
    if side.x >= side.y && side.x >= side.z {
        0
    } else if side.y >= side.z {
        1
    } else {
        2
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::SourceKind;
    use crate::transfer::lights::Shape;
    use proptest::prelude::*;

    fn patch(at: Vec3, normal: Vec3) -> Light {
        let (u, v) = normal.any_orthonormal_pair();
        let shape = Shape::Patch { corners: [at, at + u * 0.1, at + v * 0.1], normal };
        Light { kind: SourceKind::Patch(0), radiance: [1.0; 3], shape }
    }

    fn sky(direction: Vec3) -> Light {
        let shape = Shape::Distant { direction, solid_angle: 0.1, angular_radius: 0.18 };
        Light { kind: SourceKind::Distant(0), radiance: [1.0; 3], shape }
    }

    fn check(tree: &LightTree, lights: &[Light]) {
        let mut seen: Vec<u32> = tree.order.clone();
        seen.sort_unstable();
        assert!(seen.iter().copied().eq(0..lights.len() as u32));
        for (i, node) in tree.nodes.iter().enumerate() {
            match node.children {
                None => assert_eq!(node.leaves.len(), 1),
                Some([a, b]) => {
                    assert!(a as usize > i && b as usize > i);
                    let (a, b) = (&tree.nodes[a as usize].leaves, &tree.nodes[b as usize].leaves);
                    assert_eq!((a.start, a.end, b.end), (node.leaves.start, b.start, node.leaves.end));
                }
            }
            for leaf in node.leaves.clone() {
                let light = &lights[tree.order[leaf as usize] as usize];
                let inside = |b: Box3| b.union(light.bounds()) == b;
                match node.extent {
                    Extent::Patches(b) => assert!(!light.is_distant() && inside(b)),
                    Extent::Distant(b) => assert!(light.is_distant() && inside(b)),
                    Extent::Both => assert_eq!(i, 0),
                }
            }
        }
    }

    proptest! {
        #[test]
        fn every_light_is_one_leaf_within_all_boxes_above(
            places in prop::collection::vec((-3.0..3.0f32, -3.0..3.0f32, -3.0..3.0f32), 0..60),
            directions in prop::collection::vec((-1.0..1.0f32, -1.0..1.0f32, 0.1..1.0f32), 0..20),
        ) {
            let unit = |(x, y, z)| Vec3::new(x, y, z).normalize_or(Vec3::X);
            let mut lights: Vec<_> = places.iter().map(|&(x, y, z)| patch(Vec3::new(x, y, z), unit((y, x, z)))).collect();
            lights.extend(directions.iter().map(|&d| sky(unit(d))));
            check(&LightTree::build(&lights), &lights);
        }
    }

    #[test]
    fn lights_at_one_place_are_halved() {
        let lights = vec![patch(Vec3::ONE, Vec3::Y); 1000];
        let tree = LightTree::build(&lights);
        check(&tree, &lights);
        let mut depth = vec![0; tree.nodes.len()];
        for (i, node) in tree.nodes.iter().enumerate() {
            node.children.iter().flatten().for_each(|&c| depth[c as usize] = depth[i] + 1);
        }
        assert_eq!(depth.iter().max(), Some(&10));
    }

    #[test]
    fn opposite_walls_are_parted_first() {
        let wall = |x: f32, n: Vec3| (0..16).map(move |i| patch(Vec3::new(x, 0.0, i as f32 * 0.1), n));
        let lights: Vec<_> = wall(0.0, Vec3::X).chain(wall(1.0, -Vec3::X)).collect();
        let tree = LightTree::build(&lights);
        let [a, _] = tree.nodes[0].children.unwrap();
        let side = |leaf: u32| tree.order[leaf as usize] < 16;
        let leaves = &tree.nodes[a as usize].leaves;
        assert_eq!(leaves.len(), 16);
        assert!(leaves.clone().all(|l| side(l) == side(leaves.start)));
    }

    #[test]
    fn boxes_of_directions_hold_their_discs() {
        let light = sky(Vec3::new(0.1, 0.99, 0.02).normalize());
        let b = light.bounds();
        for i in 0..500 {
            let Shape::Distant { direction, angular_radius, .. } = light.shape else { unreachable!() };
            let w = crate::transfer::sampling::in_cap(
                direction,
                angular_radius,
                crate::transfer::sampling::Shift::new(1, 1).point(i),
            );
            assert!(b.union(Box3::of([w])) == b, "{w} outside {b:?}");
        }
        assert_eq!(b.max.y, 1.0 + 1e-6);
    }
}

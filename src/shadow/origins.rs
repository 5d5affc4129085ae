//! Where the light of a cluster is taken to come from: stratified origins, each with a hard shadow of its own, so that
//! the shadow of a cluster has the penumbra that its extent asks for.
//!
//! The strata go on where the clusters end: nodes of the source tree, then parts of a source. The stratum whose one
//! hard shadow costs most is cut next. A hard shadow of weight w in place of a penumbra of angular width θ errs by about
//! w over a border of width θ: its squared error is w² θ. Where θ nears a radian the border is all of the shadow, and what
//! its origin sees grows or shrinks with the place it happens to have: w² θ (1 + θ²)², by trial in the lobby.

use super::projection::ShadowOrigin;
use super::representatives::{Moments, Seen, Sum};
use crate::illuminate::patch::LightModel;
use crate::transfer::{Source, SourceKind, SourceTree};
use glam::{DVec3, Vec2, Vec3};
use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::f64::consts::TAU;
use std::ops::Range;

/// An origin of a cluster's light.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Origin {
    /// Index into the clusters.
    pub cluster: u32,
    pub at: ShadowOrigin,
    /// Its weight within the cluster; those of a cluster sum to 1.
    pub weight: f64,
    /// Sources that it stands for, and its weight within those: less than 1 for a part of one source.
    pub leaves: Range<u32>,
    pub part: f64,
    /// Its share of all light that is lost; those of a frame sum to 1.
    pub share: f64,
    /// Angular width of what it stands for as seen from the object, rad.
    pub width: f64,
}

/// What the strata are cut from.
pub(crate) struct Strata<'a> {
    pub light: &'a LightModel,
    pub sources: &'a [Source],
    pub tree: &'a SourceTree,
    pub seen: &'a [Seen],
    pub moments: &'a Moments,
    /// Centre and radius of the object, m.
    pub centre: DVec3,
    pub radius: f64,
}

/// Part of the light.
#[derive(Clone, Copy)]
enum Piece {
    /// A node of the tree with more than one source.
    Node(u32),
    /// Part of a source patch.
    Triangle(u32, [DVec3; 3]),
    /// Part of a distant source's disc: squared radius over the disc's, and angle.
    Sector(u32, [f64; 2], [f64; 2]),
}

struct Stratum {
    cluster: u32,
    piece: Piece,
    weight: f64,
    part: f64,
    share: f64,
    width: f64,
    /// Breaks ties.
    number: u32,
}

/// A triangle's or a disc's standard deviation, times this, is about its width.
const WIDTHS: f64 = 3.464;
/// Few clusters are cut into at least so many strata: with 80 the energy of the shadow was off by up to 2 % in the test
/// rooms, with 160 by less than 1 %.
const LEAST: usize = 160;
/// Below this root of the summed squared errors no stratum is cut: no pixel would show it.
pub(crate) const FINE: f64 = 2e-3;

impl Stratum {
    fn cost(&self) -> f64 {
        self.share * self.share * self.width * (1.0 + self.width * self.width).powi(2)
    }
}

impl Ord for Stratum {
    fn cmp(&self, other: &Self) -> Ordering {
        self.cost().total_cmp(&other.cost()).then(other.number.cmp(&self.number))
    }
}

impl PartialOrd for Stratum {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Stratum {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Stratum {}

impl Strata<'_> {
    /// Origins of clusters (nodes of the tree), by cluster: one each, and more where they save most until there are
    /// `most`, or [`LEAST`]. With no more than one a cluster they lie at the strongest source's centre, as in the paper.
    pub fn origins(&self, clusters: &[u32], most: usize) -> Vec<Origin> {
        let total: f64 = clusters.iter().map(|&n| self.sum(n).lost).sum();
        if total <= 0.0 {
            return Vec::new();
        }
        let mut queue = BinaryHeap::with_capacity(most.min(1 << 16));
        let (mut number, mut left) = (0, 0.0);
        let mut add = |queue: &mut BinaryHeap<Stratum>, left: &mut f64, stratum: Stratum| {
            number += 1;
            let stratum = Stratum { width: self.width(stratum.piece), number, ..stratum };
            *left += stratum.cost();
            queue.push(stratum);
        };
        for (cluster, &node) in (0..).zip(clusters) {
            let (piece, share) = (self.piece(node), self.sum(node).lost / total);
            let stratum = Stratum { cluster, piece, weight: 1.0, part: 1.0, share, width: 0.0, number: 0 };
            add(&mut queue, &mut left, stratum);
        }
        let paper = most <= clusters.len();
        let most = if paper { most } else { most.max(LEAST) };
        while queue.len() < most && left > FINE * FINE {
            let Some(worst) = queue.pop() else { break };
            left -= worst.cost();
            for (piece, [weight, share]) in self.halves(worst.piece) {
                let part = if matches!(worst.piece, Piece::Node(_)) { 1.0 } else { worst.part * weight };
                let (weight, share) = (worst.weight * weight, worst.share * share);
                add(&mut queue, &mut left, Stratum { piece, weight, part, share, ..worst });
            }
        }
        let mut strata = queue.into_vec();
        strata.sort_by_key(|s| (s.cluster, self.leaves(s.piece).start, s.number));
        let origin = |s: Stratum| {
            let at = if paper { self.strongest(s.piece) } else { self.middle(s.piece) };
            let leaves = self.leaves(s.piece);
            Origin {
                cluster: s.cluster,
                at,
                weight: s.weight,
                leaves,
                part: s.part,
                share: s.share,
                width: s.width,
            }
        };
        strata.into_iter().map(origin).collect()
    }

    fn sum(&self, node: u32) -> Sum {
        self.moments.of(&self.tree.nodes[node as usize].leaves)
    }

    /// What a node holds: itself, or its one source as a shape. Branches without a marked source are skipped.
    fn piece(&self, mut node: u32) -> Piece {
        loop {
            let n = &self.tree.nodes[node as usize];
            let Some(children) = n.children else { return self.shape(n.leaves.start) };
            let holds = |c: u32| self.sum(c).count > 0;
            match children.map(holds) {
                [true, false] => node = children[0],
                [false, true] => node = children[1],
                _ => return Piece::Node(node),
            }
        }
    }

    fn leaves(&self, piece: Piece) -> Range<u32> {
        match piece {
            Piece::Node(node) => self.tree.nodes[node as usize].leaves.clone(),
            Piece::Triangle(source, _) | Piece::Sector(source, ..) => source..source + 1,
        }
    }

    fn shape(&self, source: u32) -> Piece {
        match self.sources[source as usize].kind {
            SourceKind::Patch(p) => {
                Piece::Triangle(source, self.light.mesh.corners(p as usize).map(|c| c.as_dvec3()))
            }
            SourceKind::Distant(_) => Piece::Sector(source, [0.0, 1.0], [0.0, TAU]),
        }
    }

    /// The two halves of a piece with their shares of its weight and of its loss.
    fn halves(&self, piece: Piece) -> [(Piece, [f64; 2]); 2] {
        match piece {
            Piece::Node(node) => {
                let children = self.tree.nodes[node as usize].children.unwrap_or([node; 2]);
                let [a, b] = children.map(|c| self.sum(c));
                let weight = a.weight / (a.weight + b.weight);
                let share = a.lost / (a.lost + b.lost);
                let pieces = children.map(|c| self.piece(c));
                [(pieces[0], [weight, share]), (pieces[1], [1.0 - weight, 1.0 - share])]
            }
            Piece::Triangle(source, [a, b, c]) => {
                // Across the longest edge.
                let lengths = [b.distance(c), c.distance(a), a.distance(b)];
                let [a, b, c] = match (0..3).max_by(|&i, &j| lengths[i].total_cmp(&lengths[j])) {
                    Some(1) => [b, c, a],
                    Some(2) => [c, a, b],
                    _ => [a, b, c],
                };
                let m = (b + c) / 2.0;
                [[a, b, m], [a, m, c]].map(|t| (Piece::Triangle(source, t), [0.5; 2]))
            }
            Piece::Sector(source, r2, phi) => {
                let (inner, outer) = (r2[0].sqrt(), r2[1].sqrt());
                let across = (phi[1] - phi[0]) * (inner + outer) / 2.0;
                let cut = |[low, high]: [f64; 2]| [[low, (low + high) / 2.0], [(low + high) / 2.0, high]];
                let parts = if across >= outer - inner {
                    cut(phi).map(|phi| Piece::Sector(source, r2, phi))
                } else {
                    cut(r2).map(|r2| Piece::Sector(source, r2, phi))
                };
                parts.map(|p| (p, [0.5; 2]))
            }
        }
    }

    /// Angular width as seen from the object, rad.
    fn width(&self, piece: Piece) -> f64 {
        let variance = match piece {
            Piece::Node(node) => self.sum(node).variance(),
            Piece::Triangle(_, t) => triangle_variance(t, self.centre, self.radius),
            Piece::Sector(source, r2, phi) => {
                let radius = self.disc_radius(source);
                let (inner, outer) = (r2[0].sqrt(), r2[1].sqrt());
                let across = (phi[1] - phi[0]).min(2.0) * (inner + outer) / 2.0;
                radius * radius * (across.powi(2) + (outer - inner).powi(2)) / 12.0
            }
        };
        WIDTHS * variance.sqrt()
    }

    fn disc_radius(&self, source: u32) -> f64 {
        match self.sources[source as usize].kind {
            SourceKind::Distant(d) => f64::from(self.light.distant[d as usize].angular_radius()),
            SourceKind::Patch(_) => 0.0,
        }
    }

    /// The middle of a piece: its light's centroid, which any linear change over the piece leaves right.
    fn middle(&self, piece: Piece) -> ShadowOrigin {
        match piece {
            Piece::Node(node) => {
                let sum = self.sum(node);
                if let Some(p) = sum.centroid() {
                    // Sources on both sides of the object have their centroid in it.
                    if p.distance(self.centre) > 1.5 * self.radius {
                        return ShadowOrigin::Point(p.as_vec3());
                    }
                } else if let Some(d) = sum.direction() {
                    return ShadowOrigin::Direction(d.as_vec3());
                }
                self.strongest(piece)
            }
            Piece::Triangle(source, t) => {
                let lift = match self.sources[source as usize].kind {
                    SourceKind::Patch(p) => self.light.mesh.normal(p as usize) * 1e-4,
                    SourceKind::Distant(_) => Vec3::ZERO,
                };
                ShadowOrigin::Point(((t[0] + t[1] + t[2]) / 3.0).as_vec3() + lift)
            }
            Piece::Sector(source, r2, phi) => {
                let SourceKind::Distant(d) = self.sources[source as usize].kind else {
                    return ShadowOrigin::Direction(Vec3::Y);
                };
                let axis = self.light.distant[d as usize].direction;
                // Centroid of a ring's sector.
                let half = (phi[1] - phi[0]) / 2.0;
                let radial = (r2[1].powf(1.5) - r2[0].powf(1.5)) / (r2[1] - r2[0]) * 2.0 / 3.0;
                let r = radial * half.sin().max(0.0) / half * self.disc_radius(source);
                let angle = phi[0] + half;
                let at = Vec2::new(angle.cos() as f32, angle.sin() as f32) * r.min(1.5).tan() as f32;
                let (x, y) = axis.any_orthonormal_pair();
                ShadowOrigin::Direction((axis + x * at.x + y * at.y).normalize())
            }
        }
    }

    /// The centre of the strongest source (gibson §8).
    fn strongest(&self, piece: Piece) -> ShadowOrigin {
        let Piece::Node(node) = piece else { return self.middle(piece) };
        let leaves = self.tree.nodes[node as usize].leaves.clone();
        let weight =
            |&i: &u32| self.seen[i as usize].weight * f64::from(u8::from(self.seen[i as usize].marked));
        let best = leaves.clone().max_by(|a, b| weight(a).total_cmp(&weight(b)).then(b.cmp(a)));
        self.middle(self.shape(best.unwrap_or(leaves.start)))
    }
}

/// Variance of the directions from `centre` to the points of a triangle, rad²; points within the object's radius count
/// as lying on it.
pub(crate) fn triangle_variance([a, b, c]: [DVec3; 3], centre: DVec3, radius: f64) -> f64 {
    let middle = (a + b + c) / 3.0;
    let r = middle.distance(centre).max(radius);
    let axis = (middle - centre).normalize_or_zero();
    // Second moment of a triangle about its centroid; only what lies across the view counts.
    let sum = [a, b, c].map(|p| (p - middle).length_squared() - (p - middle).dot(axis).powi(2));
    (sum.iter().sum::<f64>() / 12.0 / (r * r)).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::super::representatives::tests::balanced;
    use super::*;
    use crate::illuminate::patch::{DistantSource, Evidence, Patch};
    use proptest::prelude::*;

    fn light(patches: u32) -> (LightModel, Vec<Source>, Vec<Seen>) {
        let mut light = LightModel::default();
        let mut sources = Vec::new();
        let mut seen = Vec::new();
        for i in 0..patches {
            let base = light.mesh.vertices.len() as u32;
            let corner = Vec3::new(i as f32 * 0.3, 2.0, 0.0);
            light.mesh.vertices.extend([corner, corner + Vec3::X * 0.3, corner + Vec3::Z * 0.3]);
            light.mesh.normals.extend([-Vec3::Y; 3]);
            let vertices = [base, base + 1, base + 2];
            let (radiance, evidence) = ([1.0; 3], Evidence::Probe);
            light.mesh.patches.push(Patch { vertices, face: 0, radiance, reflectance: [0.5; 3], evidence });
            sources.push(Source { kind: SourceKind::Patch(i), power_share: 0.1, mean: 1.0 });
            let position = light.mesh.centroid(i as usize).as_dvec3();
            let own_variance =
                triangle_variance(light.mesh.corners(i as usize).map(|c| c.as_dvec3()), DVec3::ZERO, 0.1);
            let direction = position.normalize();
            seen.push(Seen {
                weight: 1.0 + f64::from(i),
                lost: 1.0 + f64::from(i),
                marked: true,
                direction,
                own_variance,
                position: Some(position),
            });
        }
        (light, sources, seen)
    }

    fn origins(
        light: &LightModel,
        sources: &[Source],
        seen: &[Seen],
        clusters: &[u32],
        most: usize,
    ) -> Vec<Origin> {
        let tree = balanced(sources.len() as u32);
        let moments = Moments::new(seen);
        let (centre, radius) = (DVec3::ZERO, 0.1);
        Strata { light, sources, tree: &tree, seen, moments: &moments, centre, radius }
            .origins(clusters, most)
    }

    proptest! {
        #[test]
        fn shares_are_kept_and_the_mean_position_too(patches in 1u32..20, most in 2usize..200) {
            let (light, sources, seen) = light(patches);
            let found = origins(&light, &sources, &seen, &[0], most);
            prop_assert!(found.len() <= most.max(LEAST));
            prop_assert!((found.iter().map(|o| o.share).sum::<f64>() - 1.0).abs() < 1e-9);
            let mean: DVec3 = found.iter().map(|o| match o.at {
                ShadowOrigin::Point(p) => p.as_dvec3() * o.share,
                ShadowOrigin::Direction(_) => panic!("all sources are near"),
            }).sum();
            let total: f64 = seen.iter().map(|s| s.weight).sum();
            let expected = seen.iter().map(|s| s.position.unwrap() * s.weight).sum::<DVec3>() / total;
            prop_assert!(mean.distance(expected) < 1e-3, "{} {}", mean, expected);
        }
    }

    #[test]
    fn one_origin_lies_at_the_strongest_source() {
        let (light, sources, seen) = light(8);
        let [one] = &origins(&light, &sources, &seen, &[0], 1)[..] else { panic!("one origin a cluster") };
        let ShadowOrigin::Point(p) = one.at else { panic!("a near source") };
        assert!(p.distance(light.mesh.centroid(7)) < 1e-3);
    }

    #[test]
    fn a_disc_is_covered_evenly() {
        let axis = Vec3::new(0.3, 0.8, -0.2).normalize();
        let solid_angle_sr = 3e-4;
        let mut light = LightModel::default();
        light.distant.push(DistantSource { direction: axis, solid_angle_sr, radiance: [1.0; 3] });
        let sources = [Source { kind: SourceKind::Distant(0), power_share: 1.0, mean: 1.0 }];
        let seen = [Seen {
            weight: 1.0,
            lost: 1.0,
            marked: true,
            direction: axis.as_dvec3(),
            own_variance: 1e-4,
            position: None,
        }];
        for most in [1, 2, 7, 16, 64] {
            let found = origins(&light, &sources, &seen, &[0], most);
            let directions = found.iter().map(|o| match o.at {
                ShadowOrigin::Direction(d) => (d, o.share as f32),
                ShadowOrigin::Point(_) => panic!("a distant source"),
            });
            let radius = light.distant[0].angular_radius();
            let mut mean = Vec3::ZERO;
            for (d, share) in directions {
                assert!(d.dot(axis) >= radius.cos() - 1e-6);
                mean += d * share;
            }
            assert!(mean.normalize().distance(axis) < 0.02 * radius, "{most}: {mean}");
        }
    }
}

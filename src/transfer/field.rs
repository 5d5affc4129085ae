//! Lights as seen from a point: exact form factors near by, clusters of lights far away.
//!
//! A cluster is taken as one where it lies wholly before the point's horizon and faces the point with all its lights, its
//! radius is at most a fifth of its distance, and it sends no more than a given bound. Its irradiance is then that of its
//! summed vector areas at its centroid of power, whose error falls with the square of radius over distance (below 2 ρ²
//! of the luminance for flat clusters, tested). Distant lights above the horizon add up exactly.

use super::boxes::Box3;
use super::form_factor;
use super::lights::{Light, Shape};
use super::lobe::Lobe;
use super::tree::{Extent, LightTree};
use glam::Vec3;
use std::f32::consts::PI;

/// Largest radius over distance of a cluster that is taken as one …
pub(super) const FAR: f32 = 0.2;
/// … of one light, whose exact form factor is to be had instead, …
const FAR_LIGHT: f32 = 0.05;
/// … and where only the order of magnitude counts.
const COARSE: f32 = 0.5;

/// Lights in the order of their tree's leaves, and what its nodes send.
#[derive(Debug, Clone, Default)]
pub(super) struct LightField {
    pub lights: Vec<Light>,
    pub tree: LightTree,
    clusters: Vec<Cluster>,
    /// Power of all leaves before each, and of all.
    power: Vec<f64>,
}

/// The lights below a node as one.
#[derive(Debug, Clone, Copy)]
struct Cluster {
    /// Radiance × area × normal, or radiance × solid angle × direction, of each channel.
    moment: [Vec3; 3],
    /// Centroid of power, m; unused for distant lights.
    centre: Vec3,
    /// Distance of the farthest corner of the box from there, m.
    radius: f32,
    normals: Box3,
}

/// A point that gathers light.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    /// Off the surface by [`super::gather::OFFSET_M`], m.
    pub position: Vec3,
    pub normal: Vec3,
    /// What it mirrors to the plate's camera.
    pub lobe: Option<Lobe>,
}

impl Point {
    /// Of its own for each place: the same rays for any order of work.
    pub fn seed(&self) -> u64 {
        let [x, y, z] = self.position.to_array().map(|c| u64::from(c.to_bits()));
        x.rotate_left(42) ^ y.rotate_left(21) ^ z
    }
}

impl LightField {
    pub fn new(lights: &[Light]) -> Self {
        let tree = LightTree::build(lights);
        let lights: Vec<Light> = tree.order.iter().map(|&i| lights[i as usize]).collect();
        let ends = lights.iter().scan(0.0, |sum, l| {
            *sum += l.power();
            Some(*sum)
        });
        let power: Vec<f64> = std::iter::once(0.0).chain(ends).collect();
        let cluster = |node: &super::tree::LightNode| {
            let members = &lights[node.leaves.start as usize..node.leaves.end as usize];
            let mut moment = [Vec3::ZERO; 3];
            let (mut centre, mut sum) = (Vec3::ZERO, 0.0f32);
            for l in members {
                let (area, weight) = (l.extent(), l.power() as f32);
                let vector = if l.is_distant() { l.centre() } else { l.normal() } * area;
                (0..3).for_each(|c| moment[c] += vector * l.radiance[c]);
                (centre, sum) = (centre + l.centre() * weight, sum + weight);
            }
            let Extent::Patches(bounds) = node.extent else {
                return Cluster { moment, centre: Vec3::ZERO, radius: 0.0, normals: Box3::EMPTY };
            };
            let centre = if sum > 0.0 { centre / sum } else { bounds.centre() };
            let radius = bounds.corners().iter().map(|c| c.distance(centre)).fold(0.0, f32::max);
            Cluster { moment, centre, radius, normals: Box3::of(members.iter().map(Light::normal)) }
        };
        let clusters = tree.nodes.iter().map(cluster).collect();
        Self { lights, tree, clusters, power }
    }

    /// A leaf below a node, the more often the stronger it is: `u` in 0..1.
    pub fn leaf(&self, node: u32, u: f32) -> usize {
        let leaves = &self.tree.nodes[node as usize].leaves;
        let (start, end) = (leaves.start as usize, leaves.end as usize);
        let at = self.power[start] + f64::from(u) * (self.power[end] - self.power[start]);
        start + self.power[start + 1..end].partition_point(|&p| p <= at)
    }
}

/// Whether a node sends anything to a point, and whether it may be taken as one light.
pub(super) enum Seen {
    Nothing,
    Near,
    /// Near, and its mirror image is seen.
    Mirrored(Lobe),
    /// Its irradiance with nothing between.
    Far([f32; 3]),
}

/// Irradiance from one light with nothing between.
pub(super) fn exact(light: &Light, p: &Point) -> [f32; 3] {
    let factor = match light.shape {
        Shape::Patch { corners, .. } => PI * form_factor::polygon(p.position, p.normal, &corners),
        Shape::Distant { direction, solid_angle, .. } => solid_angle * direction.dot(p.normal).max(0.0),
    };
    light.radiance.map(|c| c * factor)
}

/// What a node is to a point; `coarse`: only the order of magnitude counts, and no lobe.
pub(super) fn seen(field: &LightField, i: u32, p: &Point, coarse: bool) -> Seen {
    let (node, cluster) = (&field.tree.nodes[i as usize], &field.clusters[i as usize]);
    match node.extent {
        Extent::Both => Seen::Near,
        Extent::Distant(w) => {
            let (low, high) = support(w, p.normal);
            let mirrored = || mirrored(p, w.centre(), w.size().length() / 2.0, 1.0, coarse);
            if high <= 0.0 {
                Seen::Nothing
            } else if let Some(lobe) = mirrored() {
                Seen::Mirrored(lobe)
            } else if low >= 0.0 || coarse {
                Seen::Far(cluster.moment.map(|m| m.dot(p.normal).max(0.0)))
            } else {
                Seen::Near
            }
        }
        Extent::Patches(b) => {
            let b = Box3 { min: b.min - p.position, max: b.max - p.position };
            let (low, high) = support(b, p.normal);
            if high <= 0.0 {
                return Seen::Nothing;
            }
            let (away, towards) = facing(b, cluster.normals);
            if towards <= 0.0 {
                return Seen::Nothing;
            }
            let w = cluster.centre - p.position;
            let (height, square) = (w.dot(p.normal), w.length_squared());
            if let Some(lobe) = mirrored(p, w, cluster.radius, square.sqrt(), coarse) {
                return Seen::Mirrored(lobe);
            }
            let far = match (coarse, node.children) {
                (true, _) => COARSE,
                (false, None) => FAR_LIGHT,
                (false, Some(_)) => FAR,
            };
            let whole = low >= 0.7 * height && away >= 0.0 || coarse;
            if !whole || cluster.radius * cluster.radius > far * far * square {
                return Seen::Near;
            }
            let scale = height.max(0.0) / (square * square);
            Seen::Far(cluster.moment.map(|m| -m.dot(w).min(0.0) * scale))
        }
    }
}

/// The lobe of a point, if it adds to light from within a sphere around `w`; `distance` is that of the sphere's middle.
fn mirrored(p: &Point, w: Vec3, radius: f32, distance: f32, coarse: bool) -> Option<Lobe> {
    let lobe = p.lobe.filter(|_| !coarse)?;
    let direction = w.normalize_or_zero();
    (direction == Vec3::ZERO || lobe.reaches(direction, radius / distance)).then_some(lobe)
}

/// Least and largest dot product of a vector with those of a box.
fn support(b: Box3, n: Vec3) -> (f32, f32) {
    let (at, reach) = (b.centre().dot(n), (b.size() / 2.0).dot(n.abs()));
    (at - reach, at + reach)
}

/// Least and largest of −w·n for w and n of two boxes.
fn facing(w: Box3, n: Box3) -> (f32, f32) {
    let products = [w.min * n.min, w.min * n.max, w.max * n.min, w.max * n.max];
    let low = products.into_iter().fold(Vec3::INFINITY, Vec3::min);
    let high = products.into_iter().fold(Vec3::NEG_INFINITY, Vec3::max);
    (-high.element_sum(), -low.element_sum())
}

//! Ray queries on triangle soups (wraps obvhs).

mod screen;

pub use screen::Screen;

use glam::Vec3;
use obvhs::{
    BvhBuildParams,
    bvh2::builder::build_bvh2_from_tris,
    cwbvh::{CwBvh, builder::build_cwbvh_from_tris},
    ray::Ray,
    triangle::Triangle,
};
use std::time::Duration;

/// A ray's first meeting with the triangles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Index of the triangle as given to [`Bvh::new`].
    pub triangle: u32,
    /// Distance along the ray, in lengths of its direction.
    pub t: f32,
    /// Weights of the triangle's three vertices, which sum to 1.
    pub barycentric: [f32; 3],
}

/// obvhs takes the side of a slab from `direction < 0` and its inverse from the sign bit: −0 would split the two.
fn ray(origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> Ray {
    Ray::new(origin.into(), (direction + Vec3::ZERO).into(), t_min, t_max)
}

/// Bounding volume hierarchy over a fixed set of triangles.
pub struct Bvh {
    bvh: CwBvh,
    triangles: Vec<Triangle>,
}

impl Bvh {
    /// Builds over indexed triangles. An empty set is hit by no ray.
    pub fn new(vertices: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let triangles = corners(vertices, triangles);
        let bvh = build_cwbvh_from_tris(&triangles, BvhBuildParams::medium_build(), &mut Duration::default());
        Self { bvh, triangles }
    }

    /// The nearest triangle within `t_min..t_max`, from either side.
    pub fn closest(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> Option<Hit> {
        if self.triangles.is_empty() {
            return None;
        }
        let ray = ray(origin, direction, t_min, t_max);
        let mut hit = obvhs::ray::RayHit::none();
        self.bvh
            .ray_traverse(ray, &mut hit, |ray, i| {
                self.triangles[self.bvh.primitive_indices[i] as usize].intersect(ray)
            })
            .then(|| {
                let triangle = self.bvh.primitive_indices[hit.primitive_id as usize];
                Hit {
                    triangle,
                    t: hit.t,
                    barycentric: self.barycentric(triangle, origin + direction * hit.t),
                }
            })
    }

    /// Corners of all triangles, in the order given.
    pub fn triangles(&self) -> impl ExactSizeIterator<Item = [Vec3; 3]> {
        self.triangles.iter().map(|t| [t.v0, t.v1, t.v2].map(Vec3::from))
    }

    /// Whether anything lies on the segment from `a` to `b`, its ends excepted by the relative margin 1e-4.
    pub fn occluded(&self, a: Vec3, b: Vec3) -> bool {
        self.any_hit(a, b - a, 1e-4, 1.0 - 1e-4)
    }

    /// Whether anything lies within `t_min..t_max` of the ray.
    pub fn any_hit(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> bool {
        if self.triangles.is_empty() {
            return false;
        }
        let ray = ray(origin, direction, t_min, t_max);
        !self.bvh.ray_traverse_miss(ray, |ray, i| {
            self.triangles[self.bvh.primitive_indices[i] as usize].intersect(ray)
        })
    }

    fn barycentric(&self, triangle: u32, p: Vec3) -> [f32; 3] {
        let t = &self.triangles[triangle as usize];
        let (a, b, c) = (Vec3::from(t.v0), Vec3::from(t.v1), Vec3::from(t.v2));
        let n = (b - a).cross(c - a);
        let area = n.length_squared();
        if area == 0.0 {
            return [1.0, 0.0, 0.0];
        }
        let u = (c - b).cross(p - b).dot(n) / area;
        let v = (a - c).cross(p - c).dot(n) / area;
        [u, v, 1.0 - u - v]
    }
}

/// A hierarchy with two nodes below each, as the graphics processor walks it.
#[derive(Debug, Clone, Default)]
pub(crate) struct BinaryBvh {
    /// The first is the root; none where there are no triangles.
    pub nodes: Vec<BinaryNode>,
    /// In the order in which leaves name them.
    pub triangles: Vec<[Vec3; 3]>,
}

/// A box around what lies below.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BinaryNode {
    pub low: Vec3,
    pub high: Vec3,
    /// Of triangles; 0: two nodes lie below.
    pub count: u32,
    /// Of its triangles, or of the two nodes.
    pub first: u32,
}

impl BinaryBvh {
    /// Builds over indexed triangles.
    pub fn new(vertices: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let triangles = corners(vertices, triangles);
        if triangles.is_empty() {
            return Self::default();
        }
        let bvh = build_bvh2_from_tris(&triangles, BvhBuildParams::medium_build(), &mut Duration::default());
        let nodes = bvh.nodes.iter().map(|node| BinaryNode {
            low: node.aabb.min.into(),
            high: node.aabb.max.into(),
            count: node.prim_count,
            first: node.first_index,
        });
        let ordered = bvh.primitive_indices.iter().map(|&i| {
            let t = &triangles[i as usize];
            [t.v0, t.v1, t.v2].map(Vec3::from)
        });
        Self { nodes: nodes.collect(), triangles: ordered.collect() }
    }

    /// Most nodes from the root to a leaf.
    pub fn depth(&self) -> usize {
        let (mut deepest, mut waiting) = (0, vec![(0, 1)]);
        while let Some((node, depth)) = waiting.pop() {
            let Some(node) = self.nodes.get(node) else { continue };
            deepest = deepest.max(depth);
            if node.count == 0 {
                waiting.extend([0, 1].map(|i| (node.first as usize + i, depth + 1)));
            }
        }
        deepest
    }
}

fn corners(vertices: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Triangle> {
    let corner = |v: u32| vertices[v as usize].into();
    triangles.iter().map(|t| Triangle { v0: corner(t[0]), v1: corner(t[1]), v2: corner(t[2]) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_is_hit_inside_and_missed_outside() {
        let v = [Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y];
        let bvh = Bvh::new(&v, &[[0, 1, 2], [0, 2, 3]]);
        let hit = bvh.closest(Vec3::new(0.75, 0.25, 2.0), -Vec3::Z, 0.0, 10.0).unwrap();
        assert_eq!(hit.triangle, 0);
        assert!((hit.t - 2.0).abs() < 1e-6);
        let p: Vec3 = [0usize, 1, 2].iter().map(|&k| v[k] * hit.barycentric[k]).sum();
        assert!((p - Vec3::new(0.75, 0.25, 0.0)).length() < 1e-6);
        assert!(bvh.occluded(Vec3::new(0.2, 0.7, 1.0), Vec3::new(0.2, 0.7, -1.0)));
        assert!(!bvh.occluded(Vec3::new(1.2, 0.7, 1.0), Vec3::new(1.2, 0.7, -1.0)));
        assert!(
            !bvh.occluded(Vec3::new(0.2, 0.7, 1.0), Vec3::new(0.2, 0.7, 0.0)),
            "a segment may end on a surface"
        );
    }

    #[test]
    fn nothing_is_hit_in_an_empty_set() {
        let bvh = Bvh::new(&[], &[]);
        assert!(bvh.closest(Vec3::ZERO, Vec3::Z, 0.0, 1.0).is_none());
        assert!(!bvh.occluded(Vec3::ZERO, Vec3::Z));
    }
}

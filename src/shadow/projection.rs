//! Where shadow maps look from, and how they project.

use super::Occluder;
use crate::visibility::Bvh;
use glam::{DMat4, DVec3, DVec4, Mat4, Vec2, Vec3, Vec4};

/// Bounding box and sphere of an occluder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Least coordinates, m.
    pub min: Vec3,
    /// Largest coordinates, m.
    pub max: Vec3,
    /// Centre of the box, m.
    pub centre: Vec3,
    /// Distance from the centre to the farthest vertex, m.
    pub radius: f32,
}

impl Bounds {
    /// Of the vertices that triangles use.
    pub fn of(occluder: &Occluder) -> Self {
        let used = || occluder.triangles.iter().flatten().map(|&v| occluder.vertices[v as usize]);
        let min = used().fold(Vec3::INFINITY, Vec3::min);
        let max = used().fold(Vec3::NEG_INFINITY, Vec3::max);
        let centre = (min + max) / 2.0;
        let radius = used().map(|p| p.distance(centre)).fold(1e-4, f32::max);
        Self { min, max, centre, radius }
    }

    /// Whether a segment comes within `reach` of the sphere.
    pub fn near_segment(&self, from: Vec3, to: Vec3, reach: f32) -> bool {
        let (v, centre) = (to - from, self.centre - from);
        let along = (centre.dot(v) / v.length_squared().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
        (v * along).distance(centre) <= (self.radius + reach) * 1.001
    }

    fn corners(&self) -> [DVec3; 8] {
        // A flat object gets a little depth, so that every frustum has a volume.
        let pad = DVec3::splat(f64::from(self.radius) * 1e-3);
        let (a, b) = (self.min.as_dvec3() - pad, self.max.as_dvec3() + pad);
        std::array::from_fn(|i| DVec3::select(glam::BVec3::new(i & 1 > 0, i & 2 > 0, i & 4 > 0), b, a))
    }
}

/// Where the light of a shadow map comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ShadowOrigin {
    /// A point on a patch, m.
    Point(Vec3),
    /// A unit direction towards distant light.
    Direction(Vec3),
}

impl ShadowOrigin {
    /// Whether something stands between it and a position that lies off its surface.
    pub fn hidden_by(&self, bvh: &Bvh, position: Vec3) -> bool {
        match *self {
            Self::Point(origin) => bvh.occluded(position, origin),
            Self::Direction(direction) => bvh.any_hit(position, direction, 0.0, f32::INFINITY),
        }
    }
}

/// World to shadow map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Homogeneous world point to (column·w, row·w, depth·w, w): columns and rows in texels, depth 0 at the nearest
    /// and 1 at the farthest corner of the occluder's box. Depth is affine over the map for any plane.
    pub map_from_world: Mat4,
    /// Inverse transpose, which takes planes along.
    pub planes: Mat4,
}

/// The border of a map stays free of the occluder by this many texels, so that lookups outside are unshadowed.
const MARGIN: f64 = 2.0;
/// Widest half angle of a frustum, as a tangent; a source that needs more is too near for a map.
const WIDEST: f64 = 4.0;

impl Projection {
    /// Frustum (or box, for distant light) around the occluder, `size` texels on a side. `None` where the source is
    /// in or too near the occluder's box.
    pub fn fit(origin: ShadowOrigin, bounds: &Bounds, size: usize) -> Option<Self> {
        let centre = bounds.centre.as_dvec3();
        let (eye, forward) = match origin {
            ShadowOrigin::Point(p) => (p.as_dvec3(), (centre - p.as_dvec3()).try_normalize()?),
            ShadowOrigin::Direction(d) => (centre, -d.as_dvec3().try_normalize()?),
        };
        let (right, down) = forward.any_orthonormal_pair();
        let perspective = matches!(origin, ShadowOrigin::Point(_));
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for corner in bounds.corners() {
            let v = corner - eye;
            let z = v.dot(forward);
            if perspective && z <= 0.05 * f64::from(bounds.radius) {
                return None;
            }
            let w = if perspective { z } else { 1.0 };
            let p = DVec3::new(v.dot(right) / w, v.dot(down) / w, z);
            (low, high) = (low.min(p), high.max(p));
        }
        if perspective && low.truncate().abs().max(high.truncate().abs()).max_element() > WIDEST {
            return None;
        }
        let scale = (size as f64 - 2.0 * MARGIN) / (high - low).truncate();
        let (near, far) = (low.z, high.z);
        // Rows act on view coordinates (x, y, z, 1).
        let (column, row, depth, w);
        if perspective {
            w = DVec4::Z;
            depth = DVec4::new(0.0, 0.0, far, -far * near) / (far - near);
            column = DVec4::new(scale.x, 0.0, MARGIN - low.x * scale.x, 0.0);
            row = DVec4::new(0.0, scale.y, MARGIN - low.y * scale.y, 0.0);
        } else {
            w = DVec4::W;
            depth = DVec4::new(0.0, 0.0, 1.0, -near) / (far - near);
            column = DVec4::new(scale.x, 0.0, 0.0, MARGIN - low.x * scale.x);
            row = DVec4::new(0.0, scale.y, 0.0, MARGIN - low.y * scale.y);
        }
        let map_from_view = DMat4::from_cols(column, row, depth, w).transpose();
        let view_from_world = DMat4::from_cols(
            right.extend(-right.dot(eye)),
            down.extend(-down.dot(eye)),
            forward.extend(-forward.dot(eye)),
            DVec4::W,
        )
        .transpose();
        let map_from_world = map_from_view * view_from_world;
        let planes = map_from_world.inverse().transpose();
        let whole = map_from_world.is_finite() && planes.is_finite();
        whole.then(|| Self { map_from_world: map_from_world.as_mat4(), planes: planes.as_mat4() })
    }

    /// Column, row (texels), depth and w of a world point.
    pub fn project(&self, p: Vec3) -> Vec4 {
        self.map_from_world * p.extend(1.0)
    }

    /// What lies before the occluder or beside it: a point is on the map's side of all planes if each gives at least 0,
    /// the distance in m.
    fn sides(&self, size: usize) -> [Vec4; 5] {
        let row = |i| self.map_from_world.row(i);
        // A lookup reaches one texel beyond its point.
        let (low, high) = (MARGIN as f32 - 1.0, size as f32 - MARGIN as f32 + 1.0);
        let planes = [
            row(0) - row(3) * low,
            row(3) * high - row(0),
            row(1) - row(3) * low,
            row(3) * high - row(1),
            row(2),
        ];
        planes.map(|p| p / p.truncate().length().max(f32::MIN_POSITIVE))
    }
}

/// One shadow map to draw, or one origin to send rays to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapPlan {
    /// Index of the cluster of sources whose light it parts.
    pub cluster: u32,
    /// Where that light is taken to come from.
    pub origin: ShadowOrigin,
    /// Its share of the cluster's light.
    pub weight: f32,
    /// Which of [`OFFSETS`] in each pixel it is looked up at.
    pub offset: usize,
    /// Side of the map, texels.
    pub size: usize,
    /// How to draw it; `None`: too near for a map, use rays.
    pub projection: Option<Projection>,
    /// Planes around what the occluder can shadow.
    pub sides: [Vec4; 5],
    /// The occluder.
    pub bounds: Bounds,
}

/// Where in a pixel maps are looked up in turn, px from the centre: edges are smooth where the penumbra is narrower than
/// a pixel (each of eight rows and columns once).
pub const OFFSETS: [Vec2; 8] = [
    Vec2::new(0.0625, -0.1875),
    Vec2::new(-0.0625, 0.1875),
    Vec2::new(0.3125, 0.0625),
    Vec2::new(-0.1875, -0.3125),
    Vec2::new(-0.3125, 0.3125),
    Vec2::new(-0.4375, -0.0625),
    Vec2::new(0.1875, 0.4375),
    Vec2::new(0.4375, -0.4375),
];

impl MapPlan {
    /// A map of `size` texels a side around the occluder.
    pub fn new(
        cluster: u32,
        origin: ShadowOrigin,
        weight: f32,
        offset: usize,
        bounds: &Bounds,
        size: usize,
    ) -> Self {
        let projection = Projection::fit(origin, bounds, size);
        let sides = projection.map_or([Vec4::W; 5], |p| p.sides(size));
        Self { cluster, origin, weight, offset, size, projection, sides, bounds: *bounds }
    }

    /// Whether the occluder can shadow anything in a sphere; may say yes where it cannot.
    pub fn may_shadow(&self, centre: Vec3, radius: f32) -> bool {
        if let (None, ShadowOrigin::Point(p)) = (self.projection, self.origin) {
            return self.bounds.near_segment(centre, p, radius);
        }
        let reach = -radius * 1.001 - 1e-4;
        self.sides.iter().all(|side| side.dot(centre.extend(1.0)) >= reach)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cube(centre: Vec3, half: f32) -> Occluder {
        let vertices =
            (0..8).map(|i| centre + Vec3::new(s(i & 1), s(i >> 1 & 1), s(i >> 2 & 1)) * half).collect();
        fn s(bit: i32) -> f32 {
            2.0 * bit as f32 - 1.0
        }
        Occluder { vertices, triangles: vec![[0, 1, 2], [1, 2, 3], [4, 5, 6], [5, 6, 7]] }
    }

    proptest! {
        #[test]
        fn the_occluder_fills_the_map_and_stays_inside(
            x in -3.0..3.0f32, y in -3.0..3.0f32, z in -3.0..3.0f32, distant in any::<bool>(),
        ) {
            let occluder = cube(Vec3::new(0.5, 0.2, -0.3), 0.2);
            let from = Vec3::new(x, y, z);
            prop_assume!(from.distance(Vec3::new(0.5, 0.2, -0.3)) > 0.6 && from.length() > 0.1);
            let origin =
                if distant { ShadowOrigin::Direction(from.normalize()) } else { ShadowOrigin::Point(from) };
            let projection = Projection::fit(origin, &Bounds::of(&occluder), 64).unwrap();
            let points: Vec<Vec3> = occluder.vertices.iter().map(|&v| {
                let q = projection.project(v);
                q.truncate() / q.w
            }).collect();
            let (low, high) = points.iter().fold((points[0], points[0]), |(a, b), p| (a.min(*p), b.max(*p)));
            prop_assert!(low.x > 1.9 && low.y > 1.9 && high.x < 62.1 && high.y < 62.1);
            prop_assert!(high.x - low.x > 55.0 && high.y - low.y > 55.0, "the map is used");
            prop_assert!(low.z >= -1e-3 && high.z <= 1.001 && high.z - low.z > 0.9);
        }

        #[test]
        fn cones_never_cull_what_is_shadowed(
            x in -1.0..1.0f32, y in 0.5..2.0f32, z in -1.0..1.0f32, a in 0.0..1.0f32, b in 0.0..1.0f32, far in 1.0..4.0f32,
            distant in any::<bool>(),
        ) {
            let occluder = cube(Vec3::ZERO, 0.2);
            let from = Vec3::new(x, y, z);
            let origin =
                if distant { ShadowOrigin::Direction(from.normalize()) } else { ShadowOrigin::Point(from) };
            let plan = MapPlan::new(0, origin, 1.0, 0, &Bounds::of(&occluder), 32);
            let on = occluder.vertices[0].lerp(occluder.vertices[3], a).lerp(occluder.vertices[7], b);
            let behind = if distant { on - from.normalize() * far } else { from + (on - from) * far };
            prop_assert!(plan.may_shadow(behind, 0.01));
        }
    }

    #[test]
    fn rays_to_an_origin_at_the_object_are_culled_too() {
        let bounds = Bounds::of(&cube(Vec3::ZERO, 0.2));
        let plan = MapPlan::new(0, ShadowOrigin::Point(Vec3::new(3.0, 0.0, 0.0)), 1.0, 0, &bounds, 64);
        let plan = MapPlan { projection: None, ..plan };
        assert!(plan.may_shadow(Vec3::new(-2.0, 0.2, 0.0), 0.1));
        assert!(!plan.may_shadow(Vec3::new(-2.0, 2.0, 0.0), 0.1), "the segment passes beside the object");
    }

    #[test]
    fn what_lies_beside_or_before_the_occluder_is_culled() {
        let bounds = Bounds::of(&cube(Vec3::ZERO, 0.2));
        let plan = MapPlan::new(0, ShadowOrigin::Point(Vec3::Y * 2.0), 1.0, 0, &bounds, 64);
        assert!(plan.may_shadow(Vec3::Y * -1.0, 0.1));
        for p in [Vec3::Y, Vec3::Y * 3.0, Vec3::new(1.0, -1.0, 0.0), Vec3::new(0.0, -1.0, -1.0)] {
            assert!(!plan.may_shadow(p, 0.1), "{p}");
        }
    }

    #[test]
    fn a_source_inside_the_box_gets_no_map() {
        let bounds = Bounds::of(&cube(Vec3::ZERO, 0.2));
        assert!(Projection::fit(ShadowOrigin::Point(Vec3::new(0.1, 0.0, 0.0)), &bounds, 64).is_none());
        assert!(Projection::fit(ShadowOrigin::Point(Vec3::ZERO), &bounds, 64).is_none());
        assert!(Projection::fit(ShadowOrigin::Point(Vec3::new(0.21, 0.0, 0.0)), &bounds, 64).is_none());
    }
}

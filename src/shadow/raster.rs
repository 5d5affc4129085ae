//! Depth-only rasteriser for shadow maps, with the rules of graphics hardware: vertices on a 1/256-texel raster,
//! samples at texel centres, top-left edges, depth affine over the map.

use super::Occluder;
use super::lookup::slope;
use super::projection::Projection;
use glam::Vec3;

/// What a map holds where the occluder is not.
pub const EMPTY: f32 = 1.0;
/// A receiver must lie behind the occluder by this much of the depth range; covers rounding of the rasteriser.
pub const DEPTH_BIAS: f32 = 5e-4;
/// Steepest receiver plane that is followed within a texel, in depth ranges per map width.
pub const STEEPEST: f32 = 16.0;

/// Nearest depth of the occluder as seen from one origin.
#[derive(Debug, Clone, PartialEq)]
pub struct ShadowMap {
    /// How it was drawn.
    pub projection: Projection,
    /// Side, texels.
    pub size: usize,
    /// Row-major depths in 0..=1; [`EMPTY`] where the occluder is not.
    pub depth: Vec<f32>,
}

/// Draws the occluder.
pub fn rasterise(projection: &Projection, occluder: &Occluder, size: usize) -> ShadowMap {
    let mut depth = vec![EMPTY; size * size];
    let points: Vec<Point> = occluder.vertices.iter().map(|&v| Point::new(projection, v)).collect();
    for t in &occluder.triangles {
        triangle(t.map(|v| points[v as usize]), size, &mut depth);
    }
    ShadowMap { projection: *projection, size, depth }
}

const SUBTEXELS: i64 = 256;

#[derive(Clone, Copy)]
struct Point {
    x: i64,
    y: i64,
    depth: f32,
}

impl Point {
    fn new(projection: &Projection, v: Vec3) -> Self {
        let q = projection.project(v);
        let raster = |value: f32| (value / q.w * SUBTEXELS as f32).round_ties_even() as i64;
        Self { x: raster(q.x), y: raster(q.y), depth: q.z / q.w }
    }
}

fn triangle([a, mut b, mut c]: [Point; 3], size: usize, depth: &mut [f32]) {
    // Texels whose centres lie in the bounding box.
    let first = |least: i64| ((least - SUBTEXELS / 2 + SUBTEXELS - 1).div_euclid(SUBTEXELS)).max(0);
    let last = |most: i64| (most - SUBTEXELS / 2).div_euclid(SUBTEXELS).min(size as i64 - 1);
    let (x0, x1) = (first(a.x.min(b.x).min(c.x)), last(a.x.max(b.x).max(c.x)));
    let (y0, y1) = (first(a.y.min(b.y).min(c.y)), last(a.y.max(b.y).max(c.y)));
    if x0 > x1 || y0 > y1 {
        return;
    }
    let mut area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    if area == 0 {
        return;
    }
    if area < 0 {
        (b, c, area) = (c, b, -area);
    }
    let edges = [Edge::new(b, c), Edge::new(c, a), Edge::new(a, b)];
    let inverse = 1.0 / area as f32;
    for y in y0..=y1 {
        let centre = (x0 * SUBTEXELS + SUBTEXELS / 2, y * SUBTEXELS + SUBTEXELS / 2);
        let mut e = edges.map(|edge| edge.at(centre.0, centre.1));
        let row = &mut depth[y as usize * size..][x0 as usize..=x1 as usize];
        for texel in row {
            if e.iter().zip(&edges).all(|(e, edge)| e + edge.bias >= 0) {
                let (wb, wc) = (e[1] as f32 * inverse, e[2] as f32 * inverse);
                let z = a.depth + (b.depth - a.depth) * wb + (c.depth - a.depth) * wc;
                *texel = texel.min(z.clamp(0.0, 1.0));
            }
            for k in 0..3 {
                e[k] += edges[k].dx;
            }
        }
    }
}

/// Twice the signed area that a texel centre spans with an edge: positive inside.
#[derive(Clone, Copy)]
struct Edge {
    from: (i64, i64),
    dx: i64,
    dy: i64,
    /// 0 on top and left edges, −1 on the others, which do not own their points.
    bias: i64,
}

impl Edge {
    fn new(p: Point, q: Point) -> Self {
        let (dx, dy) = (p.y - q.y, q.x - p.x);
        // Rows grow downwards and the inside lies to the right: left edges go up, top edges go right.
        let top_left = dx > 0 || (dx == 0 && dy > 0);
        Self { from: (p.x, p.y), dx: dx * SUBTEXELS, dy, bias: if top_left { 0 } else { -1 } }
    }

    fn at(&self, x: i64, y: i64) -> i64 {
        self.dx / SUBTEXELS * (x - self.from.0) + self.dy * (y - self.from.1)
    }
}

impl ShadowMap {
    /// Share (0..=1) of the 2×2 texels around a receiver's projection in which the occluder lies before the
    /// receiver's plane (percentage-closer filtering, Reeves et al. 1987, with the receiver plane's depth in each texel,
    /// Isidoro 2006: no acne on the plane the object stands on, and no detached contact shadow).
    pub fn blocked(&self, position: Vec3, normal: Vec3) -> f32 {
        let q = self.projection.project(position);
        if q.w <= 1e-6 {
            return 0.0;
        }
        let (u, v, d) = (q.x / q.w - 0.5, q.y / q.w - 0.5, q.z / q.w);
        let (column, row) = (u.floor(), v.floor());
        let last = (self.size - 1) as f32;
        if !(column >= 0.0 && row >= 0.0 && column < last && row < last) || d <= 0.0 {
            return 0.0;
        }
        let at = row as usize * self.size + column as usize;
        let near = [0, 1, self.size, self.size + 1].map(|offset| self.depth[at + offset]);
        if near.iter().all(|&depth| depth >= EMPTY) {
            return 0.0;
        }
        let [du, dv] = slope(&self.projection, self.size, position, normal);
        let (fu, fv) = (u - column, v - row);
        let corner = d - DEPTH_BIAS - du * fu - dv * fv;
        let hit = |i: usize, depth: f32| if near[i] < depth.min(EMPTY) { 1.0 } else { 0.0 };
        let top = hit(0, corner) * (1.0 - fu) + hit(1, corner + du) * fu;
        let bottom = hit(2, corner + dv) * (1.0 - fu) + hit(3, corner + du + dv) * fu;
        top * (1.0 - fv) + bottom * fv
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shadow::{Bounds, ShadowOrigin};
    use proptest::prelude::*;

    fn quad(y: f32, half: f32) -> Occluder {
        let v = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        Occluder {
            vertices: v.iter().map(|&(x, z)| Vec3::new(x * half, y, z * half)).collect(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    fn map(occluder: &Occluder, origin: ShadowOrigin, size: usize) -> ShadowMap {
        rasterise(&Projection::fit(origin, &Bounds::of(occluder), size).unwrap(), occluder, size)
    }

    #[test]
    fn a_square_casts_a_square() {
        let shadow = map(&quad(1.0, 0.25), ShadowOrigin::Point(Vec3::new(0.0, 2.0, 0.0)), 128);
        let blocked = |x: f32| shadow.blocked(Vec3::new(x, 0.0, 0.1), Vec3::Y);
        assert_eq!(blocked(0.0), 1.0);
        assert_eq!(blocked(0.49), 1.0);
        assert_eq!(blocked(0.51), 0.0);
        assert_eq!(
            shadow.blocked(Vec3::new(0.0, 1.5, 0.0), Vec3::Y),
            0.0,
            "nearer to the light than the square"
        );
        assert_eq!(shadow.blocked(Vec3::new(0.0, 2.5, 0.0), -Vec3::Y), 0.0, "behind the light");
    }

    #[test]
    fn neighbouring_triangles_share_no_texel_and_leave_none() {
        // Depth that grows with every triangle drawn would show a texel drawn twice: count coverage instead.
        let projection = Projection { map_from_world: glam::Mat4::IDENTITY, planes: glam::Mat4::IDENTITY };
        let middle = Vec3::new(7.3, 8.1, 0.5);
        let ring: Vec<Vec3> = [(1.0, 1.0), (8.0, 2.5), (15.0, 1.0), (15.0, 15.0), (1.5, 15.0)]
            .iter()
            .map(|&(x, y)| Vec3::new(x, y, 0.5))
            .collect();
        let mut count = vec![0; 256];
        for i in 0..ring.len() {
            let vertices = vec![middle, ring[i], ring[(i + 1) % ring.len()]];
            let part = rasterise(&projection, &Occluder { vertices, triangles: vec![[0, 1, 2]] }, 16);
            part.depth.iter().zip(&mut count).for_each(|(d, n)| *n += (*d < EMPTY) as i32);
        }
        assert!(count.iter().all(|&n| n <= 1), "a shared edge belongs to one side");
        assert!((5..11).all(|y| (3..13).all(|x| count[y * 16 + x] == 1)), "no crack");
    }

    #[test]
    fn the_plane_that_an_object_stands_on_has_no_acne() {
        // The occluder lies in the receiver's plane: any shadow on it is acne.
        for origin in [Vec3::new(1.5, 0.4, 0.3), Vec3::new(0.1, 2.0, 0.2), Vec3::new(-3.0, 0.6, 2.0)] {
            for origin in [ShadowOrigin::Point(origin), ShadowOrigin::Direction(origin.normalize())] {
                let shadow = map(&quad(0.0, 0.2), origin, 64);
                for i in 0..1000 {
                    let (x, z) = ((i % 33) as f32 * 0.0133 - 0.21, (i / 33) as f32 * 0.0133 - 0.21);
                    let found = shadow.blocked(Vec3::new(x, 0.0, z), Vec3::Y);
                    assert_eq!(found, 0.0, "at {x} {z} from {origin:?}");
                }
            }
        }
    }

    #[test]
    fn the_shadow_of_a_standing_wall_begins_at_its_foot() {
        // A wall in the plane z = 0, light from +z: the shadow must start within 2 mm of the foot.
        let vertices = [(-0.2, 0.0), (0.2, 0.0), (0.2, 0.3), (-0.2, 0.3)].map(|(x, y)| Vec3::new(x, y, 0.0));
        let wall = Occluder { vertices: vertices.to_vec(), triangles: vec![[0, 1, 2], [0, 2, 3]] };
        for size in [128, 256] {
            let shadow = map(&wall, ShadowOrigin::Point(Vec3::new(0.3, 1.5, 1.5)), size);
            let texel = 0.4 / size as f32;
            for x in [-0.1, 0.0, 0.1] {
                assert_eq!(
                    shadow.blocked(Vec3::new(x, 0.0, -2.0 * texel - 1e-3), Vec3::Y),
                    1.0,
                    "contact at {x}"
                );
                assert_eq!(
                    shadow.blocked(Vec3::new(x, 0.0, 2.0 * texel + 1e-3), Vec3::Y),
                    0.0,
                    "lit side at {x}"
                );
            }
        }
    }

    proptest! {
        #[test]
        fn maps_agree_with_rays(
            x in -1.0..1.0f32, z in -1.0..1.0f32, lx in -1.0..1.0f32, lz in -1.0..1.0f32,
        ) {
            let occluder = quad(0.3, 0.25);
            let light = Vec3::new(lx, 2.0, lz);
            let receiver = Vec3::new(x, 0.0, z);
            let shadow = map(&occluder, ShadowOrigin::Point(light), 256);
            let at = receiver + (light - receiver) * 0.15;
            let inside = 0.25 - at.x.abs().max(at.z.abs());
            prop_assume!(inside.abs() > 0.005);
            let expected = if inside > 0.0 { 1.0 } else { 0.0 };
            prop_assert_eq!(shadow.blocked(receiver, Vec3::Y), expected);
        }
    }
}

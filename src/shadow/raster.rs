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

/// A projected vertex.
#[derive(Clone, Copy)]
pub(crate) struct Point {
    x: i64,
    y: i64,
    depth: f32,
}

impl Point {
    fn new(projection: &Projection, v: Vec3) -> Self {
        let q = projection.project(v);
        let inverse = 1.0 / q.w;
        Self::at(q.x * inverse, q.y * inverse, q.z * inverse)
    }

    /// Column and row, texels, and a value that is affine over the map.
    pub fn at(x: f32, y: f32, depth: f32) -> Self {
        let raster = |value: f32| rounded(value * SUBTEXELS as f32);
        Self { x: raster(x), y: raster(y), depth }
    }
}

/// To the nearest integer, ties to even: at 1.5 · 2²³ the last digit of f32 is 1. (`round_ties_even` is a call where there
/// is no SSE 4.1.)
fn rounded(value: f32) -> i64 {
    const ONES: f32 = 12_582_912.0;
    if value.abs() < 4_194_304.0 { (value + ONES - ONES) as i64 } else { value as i64 }
}

fn triangle(points: [Point; 3], size: usize, depth: &mut [f32]) {
    fragments(points, size, |texel, z| depth[texel] = depth[texel].min(z.clamp(0.0, 1.0)));
}

/// Calls `visit` with the index and the depth of each texel of a `size`² map whose centre a triangle covers.
pub(crate) fn fragments([a, mut b, mut c]: [Point; 3], size: usize, mut visit: impl FnMut(usize, f32)) {
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
        let row = y as usize * size;
        for texel in row + x0 as usize..=row + x1 as usize {
            if e.iter().zip(&edges).all(|(e, edge)| e + edge.bias >= 0) {
                let (wb, wc) = (e[1] as f32 * inverse, e[2] as f32 * inverse);
                visit(texel, a.depth + (b.depth - a.depth) * wb + (c.depth - a.depth) * wc);
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
    /// Whether the occluder lies before a receiver's plane in the texel onto which the receiver falls. Compared with the
    /// plane's depth at the texel's centre (Isidoro 2006), so that there is no acne on the plane that the object stands
    /// on and no gap at its foot. Nothing is filtered: the many origins' edges average out, and blur would not.
    pub fn blocked(&self, position: Vec3, normal: Vec3) -> bool {
        let q = self.projection.project(position);
        if q.w <= 1e-6 {
            return false;
        }
        let (u, v, d) = (q.x / q.w, q.y / q.w, q.z / q.w);
        let side = self.size as f32;
        if !(u >= 0.0 && v >= 0.0 && u < side && v < side) || d <= 0.0 {
            return false;
        }
        let (column, row) = (u as usize, v as usize);
        let depth = self.depth[row * self.size + column];
        if depth >= EMPTY {
            return false;
        }
        let [du, dv] = slope(&self.projection, self.size, position, normal);
        let plane = d + du * (column as f32 + 0.5 - u) + dv * (row as f32 + 0.5 - v);
        depth < plane - DEPTH_BIAS
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
        assert!(blocked(0.0) && blocked(0.49) && !blocked(0.51));
        assert!(!shadow.blocked(Vec3::new(0.0, 1.5, 0.0), Vec3::Y), "nearer to the light than the square");
        assert!(!shadow.blocked(Vec3::new(0.0, 2.5, 0.0), -Vec3::Y), "behind the light");
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
                    assert!(!found, "at {x} {z} from {origin:?}");
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
                let blocked = |z: f32| shadow.blocked(Vec3::new(x, 0.0, z), Vec3::Y);
                assert!(blocked(-2.0 * texel - 1e-3), "contact at {x}");
                assert!(!blocked(2.0 * texel + 1e-3), "lit side at {x}");
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
            prop_assert_eq!(shadow.blocked(receiver, Vec3::Y), inside > 0.0);
        }
    }
}

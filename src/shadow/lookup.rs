//! Shadow maps looked up for eight receivers at a time, and for whole tiles.

use super::projection::Projection;
use super::raster::{DEPTH_BIAS, EMPTY, STEEPEST, ShadowMap};
use super::tiles::{Pixel, Vector};
use glam::Vec3;
use wide::{CmpGt, CmpLt, f32x8, i32x8};

/// A map with the ranges of its depths at ever coarser cells, so that most tiles need no look at its texels.
pub(crate) struct Pyramid {
    pub map: ShadowMap,
    /// Least and largest depth of each cell, level after level; a cell of level l covers 2^(l+1) texels a side.
    ranges: Vec<[f32; 2]>,
    /// For each level its first cell and its side in cells.
    levels: Vec<(usize, usize)>,
}

/// What the occluder hides from a sphere of receivers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Cover {
    Nothing,
    Everything,
    Part,
}

impl Pyramid {
    pub fn new(map: ShadowMap) -> Self {
        let (mut ranges, mut levels) = (Vec::with_capacity(map.depth.len() / 2), Vec::new());
        let mut side = map.size;
        while side > 1 {
            let half = side.div_ceil(2);
            let (first, below) = (ranges.len(), levels.last().map(|&(first, _)| first));
            for y in 0..half {
                // The last cell of an odd side covers one texel only.
                let lines = [2 * y, (2 * y + 1).min(side - 1)];
                for x in 0..half {
                    let columns = [2 * x, (2 * x + 1).min(side - 1)];
                    let at = |line: usize, column: usize| match below {
                        None => [map.depth[line * side + column]; 2],
                        Some(first) => ranges[first + line * side + column],
                    };
                    let [a, b] = columns.map(|c| at(lines[0], c));
                    let [c, d] = columns.map(|c| at(lines[1], c));
                    let low = lesser(lesser(a[0], b[0]), lesser(c[0], d[0]));
                    let high = greater(greater(a[1], b[1]), greater(c[1], d[1]));
                    ranges.push([low, high]);
                }
            }
            levels.push((first, half));
            side = half;
        }
        Self { map, ranges, levels }
    }

    /// What of a sphere of receivers is hidden, by any of their normals; `Part` where that is not certain.
    pub fn cover(&self, centre: Vec3, radius: f32) -> Cover {
        let m = &self.map.projection.map_from_world;
        let q = self.map.projection.project(centre);
        let forward = m.row(3).truncate();
        let least_w = q.w - radius * forward.length();
        if least_w <= 1e-5 {
            return Cover::Part;
        }
        let at = q / q.w;
        let reach =
            |i: usize, value: f32| radius * (m.row(i).truncate() - forward * value).length() / least_w;
        let (du, dv, dd) = (reach(0, at.x), reach(1, at.y), reach(2, at.z));
        let side = self.map.size as f32;
        // A little more than the texels that a lookup can touch.
        let (u0, u1) = (at.x - du - 0.01, at.x + du + 0.01);
        let (v0, v1) = (at.y - dv - 0.01, at.y + dv + 0.01);
        if !(u1 >= 0.0 && v1 >= 0.0 && u0 <= side && v0 <= side) {
            return Cover::Nothing;
        }
        let [least, most] = self.range([u0, v0, u1, v1].map(|t| t.clamp(0.0, side - 1.0) as usize));
        // The receiver's plane may rise and fall within a texel.
        let slope = STEEPEST / self.map.size as f32 + 2.0 * DEPTH_BIAS;
        let inside = u0 >= 0.0 && v0 >= 0.0 && u1 <= side && v1 <= side;
        if least >= EMPTY || at.z + dd + slope <= least {
            Cover::Nothing
        } else if inside && most < EMPTY && at.z - dd - slope > most {
            Cover::Everything
        } else {
            Cover::Part
        }
    }

    /// Adds a weight to the vectors' lanes where the occluder hides them.
    pub fn add(
        &self,
        weight: f32x8,
        vectors: &[Vector],
        pixels: &[Pixel],
        offset: usize,
        sums: &mut [f32x8],
    ) {
        let mut plane: Option<(u32, OnPlane)> = None;
        for (vector, sum) in vectors.iter().zip(sums) {
            let pixel = &pixels[vector.pixels.start];
            let on = match &plane {
                Some((patch, on)) if *patch == pixel.patch => on,
                _ => {
                    let new = OnPlane::new(&self.map, pixel.position, pixel.normal);
                    &plane.insert((pixel.patch, new)).1
                }
            };
            *sum += weight & on.blocked(&vector.positions[offset]);
        }
    }

    /// A range that holds those of all texels in a rectangle, corners included.
    fn range(&self, [x0, y0, x1, y1]: [usize; 4]) -> [f32; 2] {
        let mut level = 0;
        while (x1 >> level) - (x0 >> level) > 1 || (y1 >> level) - (y0 >> level) > 1 {
            level += 1;
        }
        let at = |x: usize, y: usize| match level {
            0 => [self.map.depth[y * self.map.size + x]; 2],
            _ => {
                let (first, side) = self.levels[level - 1];
                self.ranges[first + y * side + x]
            }
        };
        let (x0, x1, y0, y1) = (x0 >> level, x1 >> level, y0 >> level, y1 >> level);
        let cells = [at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1)];
        cells.into_iter().fold(cells[0], |[a, b], [c, d]| [a.min(c), b.max(d)])
    }
}

/// Without the care for NaN that `f32::min` takes.
fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// A map as receivers of one plane look it up.
struct OnPlane<'a> {
    map: &'a ShadowMap,
    rows: [[f32; 4]; 4],
    slope: [f32; 2],
}

impl<'a> OnPlane<'a> {
    pub fn new(map: &'a ShadowMap, position: Vec3, normal: Vec3) -> Self {
        let m = &map.projection.map_from_world;
        let rows = [0, 1, 2, 3].map(|i| m.row(i).to_array());
        Self { map, rows, slope: slope(&map.projection, map.size, position, normal) }
    }

    /// [`ShadowMap::blocked`] for eight positions: all bits where it holds.
    pub fn blocked(&self, [x, y, z]: &[f32x8; 3]) -> f32x8 {
        let row = |i: usize| {
            let [a, b, c, d] = self.rows[i].map(f32x8::splat);
            x.mul_add(a, y.mul_add(b, z.mul_add(c, d)))
        };
        let w = row(3);
        let inverse = f32x8::ONE / w.fast_max(f32x8::splat(1e-6));
        // What falls outside meets the border of the map, which is empty.
        let last = f32x8::splat((self.map.size - 1) as f32);
        let texel = |t: f32x8| (t * inverse).fast_max(f32x8::ZERO).fast_min(last);
        let (u, v, d) = (texel(row(0)), texel(row(1)), row(2) * inverse);
        let (column, line): (i32x8, i32x8) = (u.fast_trunc_int(), v.fast_trunc_int());
        let at = (line * i32x8::splat(self.map.size as i32) + column).to_array();
        let depth = f32x8::new(at.map(|at| self.map.depth.get(at as usize).copied().unwrap_or(EMPTY)));
        let [du, dv] = self.slope.map(f32x8::splat);
        let (fu, fv) = (column.round_float() + f32x8::HALF - u, line.round_float() + f32x8::HALF - v);
        let plane = d + du * fu + dv * fv - f32x8::splat(DEPTH_BIAS);
        let before = depth.cmp_lt(plane) & depth.cmp_lt(f32x8::splat(EMPTY));
        before & w.cmp_gt(f32x8::splat(1e-6)) & d.cmp_gt(f32x8::ZERO)
    }
}

/// Change of a receiver plane's depth from column to column and from row to row, kept below [`STEEPEST`].
pub(super) fn slope(projection: &Projection, size: usize, position: Vec3, normal: Vec3) -> [f32; 2] {
    let plane = projection.planes * normal.extend(-normal.dot(position));
    let limit = STEEPEST / size as f32;
    let slope = |n: f32| if plane.z == 0.0 { 0.0 } else { (-n / plane.z).clamp(-limit, limit) };
    [slope(plane.x), slope(plane.y)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shadow::{Bounds, Occluder, ShadowOrigin, rasterise};
    use proptest::prelude::*;

    /// Two walls and a slab, so that depths, gaps and edges all occur.
    fn occluder() -> Occluder {
        let quads = [
            [[-0.2, 0.0, 0.0], [0.2, 0.0, 0.0], [0.2, 0.3, 0.0], [-0.2, 0.3, 0.0]],
            [[-0.2, 0.3, 0.0], [0.1, 0.3, 0.0], [0.1, 0.3, 0.3], [-0.2, 0.3, 0.3]],
            [[0.05, 0.0, 0.2], [0.2, 0.0, 0.25], [0.2, 0.2, 0.25], [0.05, 0.2, 0.2]],
        ];
        let vertices = quads.iter().flatten().map(|&p| Vec3::from(p)).collect();
        let triangles =
            (0..3).flat_map(|q| [[4 * q, 4 * q + 1, 4 * q + 2], [4 * q, 4 * q + 2, 4 * q + 3]]).collect();
        Occluder { vertices, triangles }
    }

    fn point() -> impl Strategy<Value = Vec3> {
        proptest::array::uniform3(-1.0..1.0f32).prop_map(|[x, y, z]| Vec3::new(x, 0.4 * y, z))
    }

    fn map(from: Vec3, distant: bool, size: usize) -> ShadowMap {
        let origin =
            if distant { ShadowOrigin::Direction(from.normalize()) } else { ShadowOrigin::Point(from) };
        let occluder = occluder();
        rasterise(&Projection::fit(origin, &Bounds::of(&occluder), size).unwrap(), &occluder, size)
    }

    proptest! {
        #[test]
        fn eight_lanes_agree_with_one(
            points in proptest::array::uniform8(point()), x in -2.0..2.0f32, z in -2.0..2.0f32, distant in any::<bool>(),
            size in 16usize..90,
        ) {
            let map = map(Vec3::new(x, 1.5, z), distant, size);
            // On one plane, as the receivers of a patch are.
            let normal = Vec3::new(0.1, 1.0, -0.2).normalize();
            let points = points.map(|p| p - normal * normal.dot(p - Vec3::new(0.0, 0.05, 0.0)));
            let lanes = [0, 1, 2].map(|k| f32x8::new(points.map(|p| p[k])));
            let found = (OnPlane::new(&map, points[0], normal).blocked(&lanes) & f32x8::ONE).to_array();
            for (p, found) in points.iter().zip(found) {
                // A receiver on the brink of a texel or of being blocked may fall to either side.
                let near = [Vec3::X, Vec3::Y, Vec3::Z].into_iter().flat_map(|d| [*p - d * 1e-5, *p + d * 1e-5]);
                let expected: Vec<bool> = near.map(|p| map.blocked(p, normal)).collect();
                prop_assert!(expected.contains(&(found == 1.0)), "{} {:?}", found, expected);
            }
        }

        #[test]
        fn cover_never_lies(
            centre in point(), radius in 0.001..0.3f32, x in -2.0..2.0f32, z in -2.0..2.0f32, distant in any::<bool>(),
            size in 16usize..90, inside in proptest::collection::vec(point(), 30), normal in point(),
        ) {
            let pyramid = Pyramid::new(map(Vec3::new(x, 1.5, z), distant, size));
            let cover = pyramid.cover(centre, radius);
            for p in inside {
                let p = centre + p.clamp_length_max(1.0) * radius;
                let blocked = pyramid.map.blocked(p, normal.normalize_or(Vec3::Y));
                match cover {
                    Cover::Nothing => prop_assert!(!blocked),
                    Cover::Everything => prop_assert!(blocked),
                    Cover::Part => {}
                }
            }
        }
    }

    #[test]
    fn most_spheres_are_certain() {
        let pyramid = Pyramid::new(map(Vec3::new(0.2, 2.0, 1.0), false, 64));
        let mut counts = [0; 3];
        for i in 0..60 * 60 {
            let p = Vec3::new((i % 60) as f32 / 30.0 - 1.0, -0.3, (i / 60) as f32 / 30.0 - 1.0);
            counts[pyramid.cover(p, 0.02) as usize] += 1;
        }
        assert!(counts[Cover::Everything as usize] > 100 && counts[Cover::Part as usize] < 500, "{counts:?}");
    }
}

//! Slices parallel to the light (eisemann2006, §3.4), all drawn in one pass: bit k of a texel says that something lies in
//! slice k.

use super::Frustum;
use crate::shadow::{Point, fragments};
use glam::Vec3;
use rayon::prelude::*;

/// Bits of a texel.
pub const MOST_SLICES: usize = 16;
/// What lies nearer to the light than this, m, is the light itself or the wall that it is set in.
const NEAR_M: f32 = 0.01;
/// Least depth of an object's slice, as a share of the farthest receiver's.
const THINNEST: f32 = 5e-3;
/// Triangles drawn at a time.
const BATCH: usize = 8192;

/// Depths from the light's plane, m, ascending: slice k spans `planes[k]..planes[k + 1]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Slices {
    planes: Vec<f32>,
}

impl Slices {
    /// Slices of equal depth from `near` to `far`, m.
    pub fn uniform(near: f32, far: f32, count: usize) -> Self {
        Self { planes: cuts(near.max(NEAR_M), far.max(NEAR_M), count.clamp(1, MOST_SLICES)).collect() }
    }

    /// Slices of equal depth over an object, from `object[0]` to `object[1]`, and one each for what lies before it and
    /// behind it as far as `far` (m), if there is room: the shadow of one object needs its own slices alone (the paper's
    /// future work). Fewer than `count` where they would be very thin: they would part what is one surface, or the two of
    /// a sheet.
    pub fn around(object: [f32; 2], far: f32, count: usize) -> Self {
        let count = count.clamp(1, MOST_SLICES);
        let thinnest = THINNEST * far;
        let near = (object[0] - thinnest / 4.0).max(NEAR_M);
        let end = (object[1] + thinnest / 4.0).min(far);
        let (before, behind) = (near > NEAR_M + thinnest, end + thinnest < far);
        let rest = usize::from(before) + usize::from(behind);
        if end <= near || count <= rest {
            return Self::uniform(NEAR_M, far, count);
        }
        let over = (((end - near) / thinnest) as usize).clamp(1, count - rest);
        let mut planes = Vec::with_capacity(count + 1);
        planes.extend(before.then_some(NEAR_M));
        planes.extend(cuts(near, end, over));
        planes.extend(behind.then_some(far));
        Self { planes }
    }

    /// Number of slices.
    pub fn count(&self) -> usize {
        self.planes.len() - 1
    }

    /// Depth of the side of a slice that is farther from the light, onto which all in it is projected, m.
    pub fn plane(&self, slice: usize) -> f32 {
        self.planes[slice + 1]
    }

    /// Where a slice begins and ends, m.
    pub(crate) fn span(&self, slice: usize) -> [f32; 2] {
        [self.planes[slice], self.planes[slice + 1]]
    }

    /// How a slice fades in behind it. Where slices differ the thinner of this one and the next sets the length.
    pub fn fade(&self, slice: usize) -> Fade {
        let end = self.planes[slice + 1];
        let next = self.planes.get(slice + 2).map_or(f32::INFINITY, |p| p - end);
        Fade { end, length: (end - self.planes[slice]).min(next) }
    }

    fn holding(&self, depth: f32) -> Option<usize> {
        let above = self.planes.iter().position(|p| *p > depth)?;
        above.checked_sub(1)
    }
}

fn cuts(from: f32, to: f32, count: usize) -> impl Iterator<Item = f32> {
    (0..=count).map(move |i| from + (to - from) * i as f32 / count as f32)
}

/// How much a slice counts for receivers behind it (§3.4, "self shadowing").
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fade {
    end: f32,
    /// From nothing to all, m.
    pub(crate) length: f32,
}

impl Fade {
    /// Nothing in the slice or before it, linearly more behind it, all from one slice's depth on: no receiver is hidden by its
    /// own surface, nor jumps where it crosses a plane.
    pub fn weight(&self, depth: f32) -> f32 {
        ((depth - self.end) / self.length).clamp(0.0, 1.0)
    }
}

/// What lies in each slice, by texel.
#[derive(Debug, Clone, PartialEq)]
pub struct Mask {
    /// Side, texels.
    pub size: usize,
    /// Number of slices.
    pub slices: usize,
    /// Row-major; bit k for slice k.
    pub bits: Vec<u16>,
}

impl Mask {
    /// Draws triangles (world, m), also edge-on and from behind: every surface blocks light.
    pub fn draw(
        frustum: &Frustum,
        slices: &Slices,
        size: usize,
        vertices: &[Vec3],
        triangles: &[[u32; 3]],
    ) -> Self {
        let points: Vec<Vec3> =
            vertices.par_iter().map(|&v| frustum.light_from_world.transform_point3(v)).collect();
        let empty = || Self { size, slices: slices.count(), bits: vec![0; size * size] };
        let draw = |mut mask: Self, part: &[[u32; 3]]| {
            for t in part {
                mask.triangle(frustum, slices, t.map(|v| points[v as usize]));
            }
            mask
        };
        let parts = triangles.par_chunks(BATCH).fold(empty, draw);
        parts.reduce_with(|a, b| a.with(&b)).unwrap_or_else(empty)
    }

    fn triangle(&mut self, frustum: &Frustum, slices: &Slices, corners: [Vec3; 3]) {
        let near = slices.planes[0];
        // 1 / (z + behind) is affine over the texture.
        let point = |q: Vec3| {
            let at = frustum.texel(q, self.size);
            Point::at(at.x, at.y, 1.0 / (q.z + frustum.behind))
        };
        let (low, high) = corners.iter().fold((f32::MAX, f32::MIN), |(a, b), q| (a.min(q.z), b.max(q.z)));
        let bit = |depth: f32| slices.holding(depth).map_or(0, |k| 1 << k);
        let whole = slices.holding(low) == slices.holding(high) && low >= near;
        let flat: u16 = bit(low);
        let (polygon, sides) = beyond(corners, near);
        for i in 2..sides {
            let points = [polygon[0], polygon[i - 1], polygon[i]].map(point);
            if whole {
                fragments(points, self.size, |texel, _| self.bits[texel] |= flat);
            } else {
                fragments(points, self.size, |texel, w| {
                    self.bits[texel] |= bit((1.0 / w - frustum.behind).clamp(low, high));
                });
            }
        }
    }

    /// Both.
    pub fn with(mut self, other: &Self) -> Self {
        self.bits.iter_mut().zip(&other.bits).for_each(|(a, b)| *a |= b);
        self
    }

    /// Each slice projected on the next one too, which closes the gaps where a thin surface passes from slice to slice
    /// (§3.4, "light leaks").
    pub fn closed(mut self) -> Self {
        let all = (1u32 << self.slices) - 1;
        self.bits.iter_mut().for_each(|b| *b |= (*b << 1) & all as u16);
        self
    }

    /// Whether something lies in a slice.
    pub fn holds(&self, slice: usize) -> bool {
        self.bits.iter().any(|b| b >> slice & 1 == 1)
    }

    /// 1 where a slice blocks.
    pub(super) fn texels(&self, slice: usize) -> impl Iterator<Item = u16> + '_ {
        self.bits.iter().map(move |b| b >> slice & 1)
    }
}

/// The part of a triangle at depths from `near` on: a polygon and its number of corners.
fn beyond(corners: [Vec3; 3], near: f32) -> ([Vec3; 4], usize) {
    let (mut out, mut count) = ([Vec3::ZERO; 4], 0);
    let mut push = |q| {
        out[count] = q;
        count += 1;
    };
    for i in 0..3 {
        let (a, b) = (corners[i], corners[(i + 1) % 3]);
        if a.z >= near {
            push(a);
        }
        if (a.z >= near) != (b.z >= near) {
            push(a.lerp(b, (near - a.z) / (b.z - a.z)));
        }
    }
    (out, count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn slices_ascend_and_hold_the_object(
            low in 0.0..4.0f32, depth in 0.0..1.0f32, beyond in 0.0..2.0f32, count in 1usize..20,
        ) {
            let far = low + depth + beyond + 0.02;
            let slices = Slices::around([low, low + depth], far, count);
            prop_assert!((1..=count.min(MOST_SLICES)).contains(&slices.count()), "{:?}", slices);
            prop_assert!(slices.planes.windows(2).all(|p| p[0] < p[1]), "{:?}", slices);
            let middle = low + depth / 2.0;
            prop_assert!(middle <= NEAR_M || slices.holding(middle).is_some(), "{} in {:?}", middle, slices);
        }

        #[test]
        fn a_slice_counts_more_the_farther_behind_it(
            count in 1usize..16, slice in 0usize..16, a in 0.0..3.0f32, b in 0.0..3.0f32,
        ) {
            let slices = Slices::uniform(0.0, 2.0, count);
            let fade = slices.fade(slice % count);
            prop_assert!(fade.weight(a.min(b)) <= fade.weight(a.max(b)));
            prop_assert_eq!(fade.weight(slices.plane(slice % count)), 0.0);
        }
    }

    #[test]
    fn a_sheet_is_one_slice() {
        let slices = Slices::around([1.5, 1.504], 3.0, 16);
        assert_eq!((slices.count(), slices.holding(1.5), slices.holding(1.504)), (3, Some(1), Some(1)));
    }
}

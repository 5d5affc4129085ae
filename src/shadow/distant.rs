//! Lookups in maps of light at infinity: a receiver's place in the map is affine in its position, and planes of one normal all
//! rise alike.

use super::lookup::slope;
use super::raster::{DEPTH_BIAS, EMPTY, ShadowMap};
use glam::{Quat, Vec3, Vec4};

/// A map as receivers of one normal look it up.
#[derive(Clone, Copy)]
pub struct DistantLookup<'a> {
    map: &'a ShadowMap,
    /// Give column, row and depth of a homogeneous point.
    rows: [Vec4; 3],
    slope: [f32; 2],
}

impl<'a> DistantLookup<'a> {
    /// For receivers of a unit normal, all moved by `shift` (m) before they are looked up. The map must be one of light at
    /// infinity.
    pub fn new(map: &'a ShadowMap, normal: Vec3, shift: Vec3) -> Self {
        Self::moved(map, Quat::IDENTITY, shift).facing(normal)
    }

    /// For receivers turned and then shifted (m) before they are looked up, which face the light.
    pub fn moved(map: &'a ShadowMap, turn: Quat, shift: Vec3) -> Self {
        let (m, back) = (&map.projection.map_from_world, turn.inverse());
        let moved = |row: Vec4| (back * row.truncate()).extend(row.dot(shift.extend(1.0)));
        Self { map, rows: [0, 1, 2].map(|i| moved(m.row(i))), slope: [0.0; 2] }
    }

    /// The same for receivers of a unit normal, as it is where they are looked up.
    pub fn facing(self, normal: Vec3) -> Self {
        Self { slope: slope(&self.map.projection, self.map.size, Vec3::ZERO, normal), ..self }
    }

    /// As [`ShadowMap::blocked`].
    pub fn blocked(&self, position: Vec3) -> bool {
        let p = position.extend(1.0);
        let [u, v, d] = [0, 1, 2].map(|i| self.rows[i].dot(p));
        let side = self.map.size as f32;
        if !(u >= 0.0 && v >= 0.0 && u < side && v < side) || d <= 0.0 {
            return false;
        }
        let (column, row) = (u as usize, v as usize);
        let depth = self.map.depth[row * self.map.size + column];
        let plane = d + self.slope[0] * (column as f32 + 0.5 - u) + self.slope[1] * (row as f32 + 0.5 - v);
        depth < EMPTY && depth < plane - DEPTH_BIAS
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shadow::{Bounds, Projection, ShadowOrigin, rasterise};
    use crate::synthetic::blob;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn all_agree_with_the_plain_lookup(
            x in -1.0..1.0f32, y in 0.2..1.0f32, z in -1.0..1.0f32, a in -0.5..0.5f32, b in -0.5..0.5f32, tilt in -0.5..0.5f32,
        ) {
            let object = blob(Vec3::Y * 0.3, 0.15, 0.1, 8);
            let light = ShadowOrigin::Direction(Vec3::new(x, y, z).normalize());
            let projection = Projection::fit(light, &Bounds::of(&object), 64).unwrap();
            let map = rasterise(&projection, &object, 64);
            let (at, normal) = (Vec3::new(a, 0.1 * a, b), Vec3::new(tilt, 1.0, 0.0).normalize());
            let shift = Vec3::new(0.1, 0.05, -0.02);
            let found = DistantLookup::new(&map, normal, shift).blocked(at - shift);
            // On the border of a texel rounding decides.
            let q = projection.project(at);
            prop_assume!([q.x, q.y].iter().all(|c| (c - c.round()).abs() > 1e-3));
            prop_assert_eq!(found, map.blocked(at, normal));
        }
    }
}

//! Visibility of a rectangular light from prefiltered slices (eisemann2006, §3.5): no caster is told from a receiver.

use super::{Filtered, Frustum, Mask, Slices};
use crate::config::{Combination, OcclusionFilter};
use glam::Vec3;

/// The occlusion textures of a light.
#[derive(Debug, Clone, PartialEq)]
pub struct OcclusionTextures {
    frustum: Frustum,
    slices: Slices,
    size: usize,
    filtered: Filtered,
    /// Slices with nothing in them need no lookup.
    holds: Vec<bool>,
}

impl OcclusionTextures {
    /// Prefilters what was drawn with this frustum and these slices.
    pub fn new(frustum: Frustum, slices: Slices, mask: &Mask, filter: OcclusionFilter) -> Self {
        let filtered = Filtered::new(mask, filter);
        let holds = (0..mask.slices).map(|k| mask.holds(k)).collect();
        Self { frustum, slices, size: mask.size, filtered, holds }
    }

    /// Visible share (0..=1) of the light at a point (world, m), by area of the light; 1 behind it.
    pub fn visibility(&self, position: Vec3, combination: Combination) -> f32 {
        let q = self.frustum.light.from_world(position);
        combination.visibility((0..self.slices.count()).map(|slice| self.shadow(slice, q)))
    }

    /// Share of the light that a slice blocks at a point given by the light's coordinates (eq. 1).
    fn shadow(&self, slice: usize, q: Vec3) -> f32 {
        let weight = self.slices.weight(slice, q.z);
        if weight == 0.0 || !self.holds[slice] {
            return 0.0;
        }
        weight * self.filtered.average(slice, self.frustum.kernel(q, self.slices.plane(slice), self.size))
    }
}

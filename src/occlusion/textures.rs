//! Visibility of a rectangular light from prefiltered slices (eisemann2006, §3.5): no caster is told from a receiver.

use super::{Fade, Filtered, Frustum, Mask, Section, Slices};
use crate::config::{Combination, OcclusionFilter};
use glam::{Affine3A, Vec3};

/// The occlusion textures of a light.
#[derive(Debug, Clone, PartialEq)]
pub struct OcclusionTextures {
    light_from_world: Affine3A,
    filtered: Filtered,
    /// Those that hold something.
    slices: Vec<Slice>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Slice {
    number: usize,
    fade: Fade,
    /// Onto which all in it is projected.
    section: Section,
}

impl OcclusionTextures {
    /// Prefilters what was drawn with this frustum and these slices.
    pub fn new(frustum: &Frustum, slices: &Slices, mask: &Mask, filter: OcclusionFilter) -> Self {
        let slice = |number| Slice {
            number,
            fade: slices.fade(number),
            section: frustum.section(slices.plane(number), mask.size),
        };
        Self {
            light_from_world: frustum.light_from_world,
            filtered: Filtered::new(mask, filter),
            slices: (0..mask.slices).filter(|&k| mask.holds(k)).map(slice).collect(),
        }
    }

    /// Visible share (0..=1) of the light at a point (world, m), by area of the light; 1 behind it.
    pub fn visibility(&self, position: Vec3, combination: Combination) -> f32 {
        let q = self.light_from_world.transform_point3(position);
        // What each slice blocks (eq. 1).
        let shadows = self.slices.iter().map(|slice| match slice.fade.weight(q.z) {
            0.0 => 0.0,
            weight => weight * self.filtered.average(slice.number, slice.section.kernel(q)),
        });
        combination.visibility(shadows)
    }
}

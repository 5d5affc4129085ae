//! Prefiltering of occlusion textures (eisemann2006, §3.2): the mean over any square in constant time.

use super::{Kernel, Mask, Mipmap, NBuffers, SummedArea};
use crate::config::OcclusionFilter;

/// Occlusion textures, ready for lookups.
#[derive(Debug, Clone, PartialEq)]
pub enum Filtered {
    /// Coarse and fast.
    Mipmap(Mipmap),
    /// The paper's choice.
    NBuffers(NBuffers),
    /// Exact.
    SummedArea(SummedArea),
}

impl Filtered {
    /// Prefilters all slices.
    pub fn new(mask: &Mask, filter: OcclusionFilter) -> Self {
        match filter {
            OcclusionFilter::Mipmap => Self::Mipmap(Mipmap::new(mask)),
            OcclusionFilter::NBuffers => Self::NBuffers(NBuffers::new(mask)),
            OcclusionFilter::SummedArea => Self::SummedArea(SummedArea::new(mask)),
        }
    }

    /// Share (0..=1) of a kernel that a slice blocks. Kernels are at least a texel wide.
    pub fn average(&self, slice: usize, kernel: Kernel) -> f32 {
        let kernel = Kernel { side: kernel.side.max(1.0), ..kernel };
        match self {
            Self::Mipmap(f) => f.average(slice, kernel),
            Self::NBuffers(f) => f.average(slice, kernel),
            Self::SummedArea(f) => f.average(slice, kernel),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{UVec2, Vec2};
    use proptest::prelude::*;

    const SIZE: usize = 32;

    /// Random texels in two slices.
    fn mask() -> impl Strategy<Value = Mask> {
        proptest::collection::vec(0u16..4, SIZE * SIZE).prop_map(|bits| Mask { size: SIZE, slices: 2, bits })
    }

    /// Area of each texel in the square, one by one.
    fn brute(mask: &Mask, slice: usize, kernel: Kernel) -> f32 {
        let (low, high) = (kernel.centre - kernel.side / 2.0, kernel.centre + kernel.side / 2.0);
        let overlap = |i: usize, k: usize| (high[k].min(i as f32 + 1.0) - low[k].max(i as f32)).max(0.0);
        let texels = mask.bits.iter().enumerate().filter(|(_, b)| *b >> slice & 1 == 1);
        let area: f32 = texels.map(|(i, _)| overlap(i % SIZE, 0) * overlap(i / SIZE, 1)).sum();
        area / kernel.side.powi(2)
    }

    fn boxed(corner: UVec2, side: u32) -> Kernel {
        Kernel { centre: corner.as_vec2() + side as f32 / 2.0, side: side as f32 }
    }

    proptest! {
        #[test]
        fn a_summed_area_table_gives_the_mean_over_any_square(
            mask in mask(), x in -4.0..36.0f32, y in -4.0..36.0f32, side in 1.0..40.0f32, slice in 0usize..2,
        ) {
            let kernel = Kernel { centre: Vec2::new(x, y), side };
            let found = SummedArea::new(&mask).average(slice, kernel);
            prop_assert!((found - brute(&mask, slice, kernel)).abs() < 1e-4);
        }

        #[test]
        fn n_buffers_give_the_mean_over_squares_of_powers_of_two_anywhere(
            mask in mask(), l in 0u32..6, x in 0u32..32, y in 0u32..32, slice in 0usize..2,
        ) {
            let side = 1 << l;
            let kernel = boxed(UVec2::new(x, y).min(UVec2::splat(32 - side)), side);
            let found = NBuffers::new(&mask).average(slice, kernel);
            prop_assert!((found - brute(&mask, slice, kernel)).abs() < 1e-6);
        }

        #[test]
        fn mipmaps_give_the_mean_over_texels_of_the_pyramid(
            mask in mask(), l in 0u32..6, x in 0u32..32, y in 0u32..32, slice in 0usize..2,
        ) {
            let side = 1 << l;
            let kernel = boxed(UVec2::new(x, y) / side * side, side);
            let found = Mipmap::new(&mask).average(slice, kernel);
            prop_assert!((found - brute(&mask, slice, kernel)).abs() < 1e-6);
        }

        #[test]
        fn between_sizes_and_places_filters_interpolate(
            mask in mask(), x in 8.0..24.0f32, y in 8.0..24.0f32, side in 1.0..8.0f32, slice in 0usize..2,
        ) {
            // Mipmaps: between the least and largest texel of the two levels around; N-buffers: likewise of their boxes.
            let kernel = Kernel { centre: Vec2::new(x, y), side };
            let levels = [side.log2().floor() as i32, side.log2().floor() as i32 + 1].map(|l| 1u32 << l);
            let texels = |side: u32, aligned: bool| {
                let step = if aligned { side } else { 1 };
                let from = ((kernel.centre - if aligned { side as f32 } else { side as f32 / 2.0 })
                    / step as f32).floor().max(Vec2::ZERO).as_uvec2() * step;
                (0..9u32).map(move |i| boxed((from + UVec2::new(i % 3, i / 3) * step).min(UVec2::splat(32 - side)), side))
            };
            for (filtered, aligned) in
                [(Filtered::new(&mask, OcclusionFilter::Mipmap), true), (Filtered::new(&mask, OcclusionFilter::NBuffers), false)]
            {
                let means: Vec<f32> =
                    levels.iter().flat_map(|s| texels(*s, aligned)).map(|k| brute(&mask, slice, k)).collect();
                let (low, high) = means.iter().fold((1.0f32, 0.0f32), |(a, b), m| (a.min(*m), b.max(*m)));
                let found = filtered.average(slice, kernel);
                prop_assert!(found >= low - 1e-5 && found <= high + 1e-5, "{} in {}..{}", found, low, high);
            }
        }
    }

    #[test]
    fn filters_keep_even_coverage() {
        for filter in OcclusionFilter::ALL {
            let full = Filtered::new(&Mask { size: 64, slices: 1, bits: vec![1; 64 * 64] }, filter);
            let none = Filtered::new(&Mask { size: 64, slices: 1, bits: vec![0; 64 * 64] }, filter);
            for side in [0.0, 0.3, 1.0, 3.7, 20.0, 64.0] {
                let kernel = Kernel { centre: Vec2::splat(32.0), side };
                assert!((full.average(0, kernel) - 1.0).abs() < 1e-5, "{filter:?}, side {side}");
                assert_eq!(none.average(0, kernel), 0.0, "{filter:?}, side {side}");
            }
        }
    }

    #[test]
    fn a_large_table_counts_every_texel() {
        // 2²² texels: an f32 sum would still hold them, a bilinear one of them hardly.
        let size = 2048;
        let mut bits = vec![1u16; size * size];
        bits[size * size - 1] = 0;
        let table = SummedArea::new(&Mask { size, slices: 1, bits });
        let last = Kernel { centre: Vec2::splat(size as f32 - 0.5), side: 1.0 };
        let before = Kernel { centre: Vec2::splat(size as f32 - 1.0), side: 2.0 };
        assert_eq!((table.average(0, last), table.average(0, before)), (0.0, 0.75));
    }
}

//! Summed-area tables (Crow 1984): the sum over any rectangle from its four corners (eisemann2006, §3.2).

use super::{Kernel, Mask};
use glam::Vec2;
use rayon::prelude::*;

/// A table for each slice. Sums are whole numbers, so that nothing is lost however large the texture.
#[derive(Debug, Clone, PartialEq)]
pub struct SummedArea {
    size: usize,
    /// By slice, row-major, size + 1 a side: number of blocking texels above and to the left of a texel's corner.
    sums: Vec<Vec<u32>>,
}

impl SummedArea {
    /// Of all slices.
    pub fn new(mask: &Mask) -> Self {
        let size = mask.size;
        let sums = (0..mask.slices).into_par_iter().map(|slice| sums(size, mask.texels(slice))).collect();
        Self { size, sums }
    }

    /// Share of a kernel that a slice blocks, exact: texels are squares. Outside the texture nothing blocks.
    pub fn average(&self, slice: usize, kernel: Kernel) -> f32 {
        let (low, high) = (kernel.centre - kernel.side / 2.0, kernel.centre + kernel.side / 2.0);
        let sum = self.sum(slice, high) - self.sum(slice, Vec2::new(low.x, high.y)) + self.sum(slice, low)
            - self.sum(slice, Vec2::new(high.x, low.y));
        (sum / f64::from(kernel.side).powi(2)).clamp(0.0, 1.0) as f32
    }

    /// Blocking texels above and to the left of a point, by their area: bilinear between corners is exact.
    fn sum(&self, slice: usize, at: Vec2) -> f64 {
        let at = at.clamp(Vec2::ZERO, Vec2::splat(self.size as f32));
        let (x, y) = ((at.x as usize).min(self.size - 1), (at.y as usize).min(self.size - 1));
        let (fx, fy) = (f64::from(at.x) - x as f64, f64::from(at.y) - y as f64);
        let corner = y * (self.size + 1) + x;
        let sums = &self.sums[slice];
        let row = |i: usize| f64::from(sums[i]) * (1.0 - fx) + f64::from(sums[i + 1]) * fx;
        row(corner) * (1.0 - fy) + row(corner + self.size + 1) * fy
    }
}

fn sums(size: usize, texels: impl Iterator<Item = u16>) -> Vec<u32> {
    let width = size + 1;
    let mut sums = vec![0u32; width * width];
    let (mut row, mut next) = (0, width + 1);
    for (i, texel) in texels.enumerate() {
        if i % size == 0 {
            (row, next) = (0, (i / size + 1) * width + 1);
        }
        row += u32::from(texel);
        sums[next] = sums[next - width] + row;
        next += 1;
    }
    sums
}

//! N-buffers (Décoret 2005): means over boxes of 2^l × 2^l texels at every place (eisemann2006, §3.2).

use super::{Kernel, Mask};
use glam::Vec2;
use rayon::prelude::*;

/// Levels for each slice.
#[derive(Debug, Clone, PartialEq)]
pub struct NBuffers {
    size: usize,
    /// By slice and level l, row-major: mean of the 2^l × 2^l texels from a texel on to the right and down, those outside
    /// the texture 0.
    levels: Vec<Vec<Vec<f32>>>,
}

impl NBuffers {
    /// Of all slices; the texture's side is a power of two.
    pub fn new(mask: &Mask) -> Self {
        let count = mask.size.ilog2() as usize + 1;
        let slice = |slice| {
            let mut levels: Vec<Vec<f32>> = Vec::with_capacity(count);
            levels.push(mask.texels(slice).map(f32::from).collect());
            for l in 1..count {
                levels.push(wider(&levels[l - 1], mask.size, 1 << (l - 1)));
            }
            levels
        };
        Self { size: mask.size, levels: (0..mask.slices).into_par_iter().map(slice).collect() }
    }

    /// Share of a kernel that a slice blocks: exact for sides that are powers of two and edges on texels', linear between
    /// places and between the two levels next in size.
    pub fn average(&self, slice: usize, kernel: Kernel) -> f32 {
        let levels = &self.levels[slice];
        let side = kernel.side.clamp(1.0, self.size as f32);
        let l = (side.log2() as usize).min(levels.len() - 1);
        let fine = self.at(&levels[l], 1 << l, kernel.centre);
        let Some(coarse) = levels.get(l + 1) else { return fine };
        let coarse = self.at(coarse, 2 << l, kernel.centre);
        fine + (coarse - fine) * (side / (1 << l) as f32 - 1.0)
    }

    /// Mean over a box around a point, moved to lie in the texture.
    fn at(&self, level: &[f32], side: usize, centre: Vec2) -> f32 {
        let last = self.size - side;
        let from = (centre - side as f32 / 2.0).clamp(Vec2::ZERO, Vec2::splat(last as f32));
        let (x, y) = (from.x as usize, from.y as usize);
        let (fx, fy) = (from.x - x as f32, from.y - y as f32);
        let value = |x: usize, y: usize| level[y.min(last) * self.size + x.min(last)];
        let row = |y: usize| value(x, y) * (1.0 - fx) + value(x + 1, y) * fx;
        row(y) * (1.0 - fy) + row(y + 1) * fy
    }
}

/// The next level: boxes of four.
fn wider(level: &[f32], size: usize, step: usize) -> Vec<f32> {
    let mut out = vec![0.0; size * size];
    let outside = vec![0.0; size];
    for (y, row) in out.chunks_exact_mut(size).enumerate() {
        let upper = &level[y * size..][..size];
        let lower = if y + step < size { &level[(y + step) * size..][..size] } else { &outside };
        for (texel, (a, b)) in row.iter_mut().zip(upper.iter().zip(lower)) {
            *texel = 0.25 * (a + b);
        }
        for (texel, (a, b)) in row.iter_mut().zip(upper[step..].iter().zip(&lower[step..])) {
            *texel += 0.25 * (a + b);
        }
    }
    out
}

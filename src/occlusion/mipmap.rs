//! Mipmaps (Williams 1983): means over texels of a pyramid (eisemann2006, §3.2).

use super::{Kernel, Mask};
use glam::Vec2;
use rayon::prelude::*;

/// A pyramid for each slice.
#[derive(Debug, Clone, PartialEq)]
pub struct Mipmap {
    size: usize,
    /// By slice and level l, row-major, size / 2^l a side.
    levels: Vec<Vec<Vec<f32>>>,
}

impl Mipmap {
    /// Of all slices; the texture's side is a power of two.
    pub fn new(mask: &Mask) -> Self {
        let slice = |slice| {
            let mut levels: Vec<Vec<f32>> = vec![mask.texels(slice).map(f32::from).collect()];
            let mut side = mask.size;
            while side > 1 {
                levels.extend(levels.last().map(|l| halved(l, side)));
                side /= 2;
            }
            levels
        };
        Self { size: mask.size, levels: (0..mask.slices).into_par_iter().map(slice).collect() }
    }

    /// Share of a kernel that a slice blocks, trilinear as graphics hardware has it: exact where the kernel is a texel of
    /// the pyramid, else linear between neighbours and in the logarithm of the side.
    pub fn average(&self, slice: usize, kernel: Kernel) -> f32 {
        let levels = &self.levels[slice];
        let lod = kernel.side.max(1.0).log2().min((levels.len() - 1) as f32);
        let l = lod as usize;
        let fine = self.at(&levels[l], l, kernel.centre);
        match levels.get(l + 1) {
            Some(coarse) => fine + (self.at(coarse, l + 1, kernel.centre) - fine) * (lod - l as f32),
            None => fine,
        }
    }

    fn at(&self, level: &[f32], l: usize, centre: Vec2) -> f32 {
        let side = self.size >> l;
        let at = (centre / (1 << l) as f32 - 0.5).clamp(Vec2::ZERO, Vec2::splat((side - 1) as f32));
        let (x, y) = (at.x as usize, at.y as usize);
        let (fx, fy) = (at.x - x as f32, at.y - y as f32);
        let value = |x: usize, y: usize| level[y.min(side - 1) * side + x.min(side - 1)];
        let row = |y: usize| value(x, y) * (1.0 - fx) + value(x + 1, y) * fx;
        row(y) * (1.0 - fy) + row(y + 1) * fy
    }
}

fn halved(level: &[f32], side: usize) -> Vec<f32> {
    let half = side / 2;
    let mut out = Vec::with_capacity(half * half);
    for y in 0..half {
        let (upper, lower) = (&level[2 * y * side..][..side], &level[(2 * y + 1) * side..][..side]);
        let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
        out.extend(pairs.map(|(a, b)| 0.25 * (a[0] + a[1] + b[0] + b[1])));
    }
    out
}

//! Prefiltered environments (Heidrich and Seidel 1999): the mean radiance under a kernel about every axis.

use super::environment::Environment;
use crate::image::{Image, Radiance, RadianceImage};
use crate::probe::latlong;
use glam::Vec3;
use rayon::prelude::*;

/// Means of an environment by direction of a kernel's axis: a `latlong` map.
#[derive(Debug, Clone)]
pub struct Prefiltered {
    map: RadianceImage,
}

impl Prefiltered {
    /// By direct summation over all texels. `kernel` is a function of the cosine of the angle α from the axis, of any scale,
    /// falls from there as 1 − n α²/2, and is 0 where the cosine is at most `cut`.
    pub fn new(environment: &Environment, n: f32, cut: f32, kernel: impl Fn(f32) -> f32 + Sync) -> Self {
        let (w, h) = environment.map.size();
        // A broad kernel needs few axes: lines between axes h apart cut h² n/8 off a peak, at most 2 % here.
        let width = ((16.0 * n.sqrt()) as usize).next_power_of_two().max(32);
        let (width, height) = (w.min(width), h.min(width / 2));
        let texels: Vec<(Vec3, f32)> = (0..w * h).map(|i| environment.texel(i)).collect();
        let mean = |i: usize| {
            let axis = latlong::direction((i % width) as f32 + 0.5, (i / width) as f32 + 0.5, width, height);
            let (mut sum, mut total) = ([0.0f64; 3], 0.0f64);
            for ((direction, solid_angle), radiance) in texels.iter().zip(environment.map.pixels()) {
                let cos = axis.dot(*direction).min(1.0);
                if cos > cut {
                    let weight = f64::from(kernel(cos) * solid_angle);
                    total += weight;
                    (0..3).for_each(|k| sum[k] += weight * f64::from(radiance.0[k]));
                }
            }
            if total > 0.0 {
                return Radiance(sum.map(|v| (v / total) as f32));
            }
            // A kernel narrower than a texel mirrors.
            let (x, y) = latlong::pixel(axis, w, h);
            environment.map.bilinear(f64::from(x), f64::from(y))
        };
        let pixels = (0..width * height).into_par_iter().map(mean).collect();
        Self { map: Image::from_pixels(width, height, pixels) }
    }

    /// The mean about a unit axis: bilinear, around the seam.
    pub fn radiance(&self, axis: Vec3) -> [f32; 3] {
        let (w, h) = self.map.size();
        let (x, y) = latlong::pixel(axis, w, h);
        let (fx, fy) = (x - 0.5, (y - 0.5).clamp(0.0, (h - 1) as f32));
        let (ax, ay) = (fx - fx.floor(), fy - fy.floor());
        let column = |k: i64| (fx.floor() as i64 + k).rem_euclid(w as i64) as usize;
        let row = |k: usize| (fy as usize + k).min(h - 1);
        let at = |i: i64, j: usize| self.map.at(column(i), row(j)).0;
        let (a, b, c, d) = (at(0, 0), at(1, 0), at(0, 1), at(1, 1));
        std::array::from_fn(|k| {
            (a[k] * (1.0 - ax) + b[k] * ax) * (1.0 - ay) + (c[k] * (1.0 - ax) + d[k] * ax) * ay
        })
    }
}

//! A rectangular light over a floor, with something between: what visibility is measured on.

use crate::config::{Combination, OcclusionFilter};
use crate::occlusion::{Frustum, Mask, OcclusionTextures, RectangularLight, Slices};
use crate::shadow::Occluder;
use crate::transfer::sampling::Shift;
use crate::visibility::Bvh;
use glam::Vec3;
use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};
use rayon::prelude::*;
use std::time::Instant;

/// Height of the light over the floor, m.
const LIGHT_M: f32 = 2.2;
/// Middle height and radius of the cloud of leaves, m.
const CLOUD_M: [f32; 2] = [1.1, 0.5];
/// Width and depth of the floor, m.
const FLOOR_M: [f32; 2] = [3.0, 2.25];
/// Points of the floor outside the shadow (reference above this) do not count.
const LIT: f32 = 0.98;

/// Light, occluder and the points of the floor, one a pixel, from the far left on.
pub struct Subject {
    pub occluder: Occluder,
    light: RectangularLight,
    floor: Vec<Vec3>,
}

/// Occlusion textures, and what it took to draw and to prefilter them, ms.
pub struct Made {
    pub textures: OcclusionTextures,
    pub draw_ms: f64,
    pub filter_ms: f64,
}

/// Leaves (rhombi of two triangles each), all together of an area (m²), in a ball, turned at random.
pub fn leaves(count: usize, area: f32) -> Occluder {
    let mut random = SmallRng::seed_from_u64(1);
    let mut out = Occluder::default();
    let half = (area / count as f32 / 2.0).sqrt();
    let mut unit = || {
        loop {
            let v = Vec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0f32)));
            if v.length_squared() <= 1.0 {
                return v;
            }
        }
    };
    for _ in 0..count {
        let middle = Vec3::Y * CLOUD_M[0] + unit() * CLOUD_M[1];
        let (u, v) = unit().normalize_or(Vec3::X).any_orthonormal_pair();
        let first = out.vertices.len() as u32;
        out.vertices.extend([u, v, -u, -v].map(|d| middle + d * half));
        out.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    out
}

/// The same laid flat at the cloud's middle height.
pub fn flat(mut leaves: Occluder) -> Occluder {
    leaves.vertices.iter_mut().for_each(|v| v.y = CLOUD_M[0]);
    leaves
}

/// One slice that ends where [`flat`] leaves lie.
pub fn flat_slice() -> Slices {
    let depth = LIGHT_M - CLOUD_M[0];
    Slices::uniform(depth - 0.1, depth + 1e-4, 1)
}

/// Slices of equal depth over the cloud.
pub fn cloud_slices(count: usize) -> Slices {
    let middle = LIGHT_M - CLOUD_M[0];
    Slices::uniform(middle - CLOUD_M[1] - 0.05, middle + CLOUD_M[1] + 0.05, count)
}

impl Subject {
    /// A square light of a side in m, and a floor of so many points.
    pub fn new(side: f32, occluder: Occluder, [width, height]: [usize; 2]) -> Self {
        let half = [Vec3::X, Vec3::Z].map(|v| v * side / 2.0);
        let point = |i: usize| {
            let at = |k: usize, n: usize| (k as f32 + 0.5) / n as f32 - 0.5;
            Vec3::new(at(i % width, width) * FLOOR_M[0], 0.0, at(i / width, height) * FLOOR_M[1])
        };
        Self {
            occluder,
            light: RectangularLight { centre: Vec3::Y * LIGHT_M, half, radiance: [1.0; 3] },
            floor: (0..width * height).map(point).collect(),
        }
    }

    /// Draws and prefilters.
    pub fn make(&self, slices: &Slices, size: usize, filter: OcclusionFilter, close: bool) -> Made {
        let frustum = Frustum::fit(&self.light, self.floor.iter().copied());
        let started = Instant::now();
        let mut mask = Mask::draw(&frustum, slices, size, &self.occluder.vertices, &self.occluder.triangles);
        if close {
            mask = mask.closed();
        }
        let draw_ms = started.elapsed().as_secs_f64() * 1e3;
        let started = Instant::now();
        let textures = OcclusionTextures::new(&frustum, slices, &mask, filter);
        Made { textures, draw_ms, filter_ms: started.elapsed().as_secs_f64() * 1e3 }
    }

    /// Visibility at each point, and the time that takes, ms.
    pub fn seen(&self, textures: &OcclusionTextures, rule: Combination) -> (Vec<f32>, f64) {
        let started = Instant::now();
        let seen = self.floor.par_iter().map(|&p| textures.visibility(p, rule)).collect();
        (seen, started.elapsed().as_secs_f64() * 1e3)
    }

    /// The same by rays from all over the light.
    pub fn traced(&self, rays: u32, seed: u64) -> (Vec<f32>, f64) {
        let bvh = Bvh::new(&self.occluder.vertices, &self.occluder.triangles);
        let started = Instant::now();
        let visibility = |(i, &p): (usize, &Vec3)| {
            let shift = Shift::new(seed, i as u64);
            let free = (0..rays).filter(|&k| !bvh.occluded(p, self.light.at(shift.point(k)))).count();
            free as f32 / rays as f32
        };
        let seen = self.floor.par_iter().enumerate().map(visibility).collect();
        (seen, started.elapsed().as_secs_f64() * 1e3)
    }
}

/// rms and mean of the error of visibility in the shadow.
pub fn errors(found: &[f32], reference: &[f32]) -> [f64; 2] {
    let inside = found.iter().zip(reference).filter(|(_, r)| **r < LIT).map(|(f, r)| f64::from(f - r));
    let (mut squares, mut sum, mut count) = (0.0, 0.0, 0.0f64);
    inside.for_each(|e| (squares, sum, count) = (squares + e * e, sum + e, count + 1.0));
    let count = count.max(1.0);
    [(squares / count).sqrt(), sum / count]
}

//! Radiance from pictures onto patches, by ray casting.

use super::patch::PatchMesh;
use crate::camera::Camera;
use crate::image::{Image, RadianceImage, luminance};
use crate::probe::{Environment, latlong};
use crate::visibility::Bvh;
use glam::Vec3;
use nalgebra::Point2;
use rayon::prelude::*;

/// Sub-rays along each side of a texel.
const SUB: usize = 2;
/// Radiance samples a patch needs for a mean.
const ENOUGH: u32 = 4;
/// Weight below which an environment texel tells nothing.
const MIN_WEIGHT: f32 = 0.25;

/// Radiance samples of a patch.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Samples {
    sum: [f64; 3],
    luminance: [f64; 2],
    /// Sum of weights: solid angle, sr, or area, m².
    pub weight: f64,
    /// How many.
    pub count: u32,
}

impl Samples {
    fn add(&mut self, radiance: [f32; 3], weight: f64) {
        (0..3).for_each(|k| self.sum[k] += weight * f64::from(radiance[k]));
        let l = f64::from(luminance(radiance));
        self.luminance[0] += weight * l;
        self.luminance[1] += weight * l * l;
        self.weight += weight;
        self.count += 1;
    }

    /// Weighted mean radiance; `None` without samples.
    pub fn mean(&self) -> Option<[f32; 3]> {
        (self.weight > 0.0).then(|| self.sum.map(|s| (s / self.weight) as f32))
    }

    /// Standard deviation of the luminance among the samples.
    pub fn deviation(&self) -> f64 {
        if self.weight <= 0.0 {
            return 0.0;
        }
        let mean = self.luminance[0] / self.weight;
        (self.luminance[1] / self.weight - mean * mean).max(0.0).sqrt()
    }
}

/// The environment carried onto a mesh.
pub struct Projected {
    /// What each patch received.
    pub samples: Vec<Samples>,
    /// Share of each texel whose rays meet no patch.
    pub free: Vec<f32>,
    /// Share of the power that meets patches from behind: above a few per cent the model does not enclose the probe.
    pub behind_share: f64,
}

/// Casts every texel's rays outwards from the ball; patches not met by enough of them look back into the environment.
pub fn from_probe(env: &Environment, mesh: &PatchMesh, bvh: &Bvh) -> Projected {
    let (w, h) = env.size();
    let hits: Vec<[Option<(u32, bool)>; SUB * SUB]> = (0..w * h)
        .into_par_iter()
        .map(|i| {
            std::array::from_fn(|s| {
                let at = |c: usize, k: usize| c as f32 + (k as f32 + 0.5) / SUB as f32;
                let d = latlong::direction(at(i % w, s % SUB), at(i / w, s / SUB), w, h);
                let hit = bvh.closest(env.origin[i], d, 0.0, f32::MAX)?;
                Some((hit.triangle, mesh.normal(hit.triangle as usize).dot(d) < 0.0))
            })
        })
        .collect();
    let mut samples = vec![Samples::default(); mesh.patches.len()];
    let mut free = vec![0.0; w * h];
    let (mut behind, mut all) = (0.0, 0.0);
    for (i, texel) in hits.iter().enumerate() {
        let weight = env.solid_angle(i) * f64::from(env.weight[i]) / (SUB * SUB) as f64;
        let radiance = env.radiance.pixels()[i].0;
        for hit in texel {
            all += weight * f64::from(luminance(radiance));
            match hit {
                None => free[i] += 1.0 / (SUB * SUB) as f32,
                Some((_, false)) => behind += weight * f64::from(luminance(radiance)),
                Some((patch, true)) if env.weight[i] > MIN_WEIGHT => {
                    samples[*patch as usize].add(radiance, weight);
                }
                Some(_) => {}
            }
        }
    }
    samples.par_iter_mut().enumerate().filter(|(_, s)| s.count < ENOUGH).for_each(|(i, s)| {
        if let Some(found) = look_back(env, mesh, bvh, i) {
            *s = found;
        }
    });
    Projected { samples, free, behind_share: if all > 0.0 { behind / all } else { 0.0 } }
}

/// Asks the environment for what it shows of a patch's points, where the ball sees at least half of them.
fn look_back(env: &Environment, mesh: &PatchMesh, bvh: &Bvh, i: usize) -> Option<Samples> {
    const POINTS: [[f32; 3]; 4] = [
        [1.0 / 3.0; 3],
        [2.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0],
        [1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0],
        [1.0 / 6.0, 1.0 / 6.0, 2.0 / 3.0],
    ];
    let mut samples = Samples::default();
    let corners = mesh.corners(i);
    for b in POINTS {
        let p = corners[0] * b[0] + corners[1] * b[1] + corners[2] * b[2];
        let texel = env.texel_towards(p);
        let origin = env.origin[texel];
        if env.weight[texel] > MIN_WEIGHT
            && mesh.normal(i).dot(origin - p) > 0.0
            && !bvh.any_hit(origin, p - origin, 0.0, 1.0 - 1e-3)
        {
            samples.add(env.radiance.pixels()[texel].0, f64::from(mesh.area(i)) / POINTS.len() as f64);
        }
    }
    (samples.count as usize >= POINTS.len() / 2).then_some(samples)
}

/// What the plate shows of each patch.
pub struct PlateSamples {
    /// Radiance by area seen, m².
    pub samples: Vec<Samples>,
    /// Area of the patch seen in clipped pixels, m².
    pub clipped_area: Vec<f64>,
}

/// Casts the plate's pixels onto the mesh. Pixels next to another face are left out: model and picture agree to a
/// pixel or two.
pub fn from_plate(
    camera: &Camera,
    plate: &RadianceImage,
    clipped: &Image<bool>,
    mesh: &PatchMesh,
    bvh: &Bvh,
) -> PlateSamples {
    let (w, h) = plate.size();
    let eye = camera.centre();
    let eye = Vec3::new(eye.x as f32, eye.y as f32, eye.z as f32);
    let focal = camera.intrinsics.focal_px;
    let hits: Vec<Option<(u32, f64)>> = (0..w * h)
        .into_par_iter()
        .map(|i| {
            let pixel = Point2::new((i % w) as f64 + 0.5, (i / w) as f64 + 0.5);
            let local = camera.intrinsics.direction(&pixel);
            let d = camera.world_from_camera * local.into_inner();
            let d = Vec3::new(d.x as f32, d.y as f32, d.z as f32);
            let hit = bvh.closest(eye, d, 1e-3, f32::MAX)?;
            let cosine = -f64::from(mesh.normal(hit.triangle as usize).dot(d));
            let solid_angle = local.z.powi(3) / (focal[0] * focal[1]);
            (cosine > 1e-3).then(|| (hit.triangle, solid_angle * f64::from(hit.t).powi(2) / cosine))
        })
        .collect();
    let face = |x: usize, y: usize| hits[y * w + x].map(|(t, _)| mesh.patches[t as usize].face);
    let mut out = PlateSamples {
        samples: vec![Samples::default(); mesh.patches.len()],
        clipped_area: vec![0.0; mesh.patches.len()],
    };
    for y in 1..h.saturating_sub(1) {
        for x in 1..w.saturating_sub(1) {
            let Some((patch, area)) = hits[y * w + x] else { continue };
            if (y - 1..=y + 1).any(|v| (x - 1..=x + 1).any(|u| face(u, v) != face(x, y))) {
                continue;
            }
            if *clipped.at(x, y) {
                out.clipped_area[patch as usize] += area;
            } else {
                out.samples[patch as usize].add(plate.at(x, y).0, area);
            }
        }
    }
    out
}

impl PlateSamples {
    /// Mean radiance of a patch that the plate covers well and unclipped.
    pub fn radiance(&self, mesh: &PatchMesh, i: usize) -> Option<[f32; 3]> {
        let s = &self.samples[i];
        let covered = s.weight > 0.5 * f64::from(mesh.area(i));
        (s.count >= ENOUGH && covered && self.clipped_area[i] < 0.1 * s.weight).then(|| s.mean()).flatten()
    }
}

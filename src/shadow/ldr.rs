//! The method `radiance-transfer-ldr`: the passes of [`super::RadianceTransfer`], subtracted from the plate's stored codes in
//! 8 bits by intensity transfers (Gibson et al. 2003, §7.1).

use super::intensity::{Set, TOP, deal, intensity_transfers, vertex_radiance};
use super::plan::Plan;
use super::radiance_transfer::Columns;
use super::tiles::{Pixel, Prepared, Vector};
use super::{Problem, Scene, Stored};
use crate::config::{Render, ShadowMethod};
use crate::image::{Code, CodeImage, Radiance, RadianceImage};
use ndarray::Axis;
use rand::{SeedableRng, rngs::SmallRng};
use rayon::prelude::*;
use wide::f32x8;

/// What of the method stays when the object moves.
pub(super) struct Ldr<'a> {
    stored: Stored<'a>,
    /// L_i, plate units, by receiver vertex.
    radiance: Vec<[f32; 3]>,
    /// By source; a cluster is in the set of its strongest one, so that it stays there from frame to frame.
    sets: Vec<Set>,
    /// Stored code over that of L_i, by vector of pixels.
    contrast: Vec<[f32x8; 3]>,
}

impl<'a> Ldr<'a> {
    /// `None` where the settings name another method.
    pub fn prepare(
        scene: &Scene<'a>,
        prepared: &Prepared,
        settings: &Render,
    ) -> Result<Option<Self>, Problem> {
        if settings.method != ShadowMethod::RadianceTransferLdr {
            return Ok(None);
        }
        let stored = scene.stored.ok_or(Problem::NoCodes)?;
        if stored.codes.size() != scene.plate.size() {
            return Err(Problem::Mismatch {
                what: "size of the photograph",
                found: format!("{:?} px", stored.codes.size()),
                expected: format!("{:?} px", scene.plate.size()),
            });
        }
        let shown =
            prepared.pixels.iter().map(|p| (p.vertices, p.weights, scene.plate.pixels()[p.index as usize].0));
        let radiance = vertex_radiance(scene.transfers.receivers.positions.len(), shown);
        let mut rng = SmallRng::seed_from_u64(settings.seed);
        let sets = deal(scene.transfers.sources.len(), settings.first_set_share, &mut rng);
        let mut ldr = Self { stored, radiance, sets, contrast: Vec::new() };
        ldr.contrast = prepared.vectors.iter().map(|v| ldr.contrast(&prepared.pixels, v)).collect();
        Ok(Some(ldr))
    }

    /// T. Whole code values: the differences of fractions would be below one half for faint sources, and be lost.
    fn tone(&self, radiance: [f32; 3]) -> [f32; 3] {
        self.stored.response.code_of(radiance).map(|c| (c * TOP).round())
    }

    fn contrast(&self, pixels: &[Pixel], vector: &Vector) -> [f32x8; 3] {
        let mut lanes = [[0.0f32; 8]; 3];
        for (lane, pixel) in pixels[vector.pixels.clone()].iter().enumerate() {
            let code = self.stored.codes.pixels()[pixel.index as usize].0;
            let around = pixel.vertices.map(|v| self.stored.response.code_of(self.radiance[v as usize]));
            for c in 0..3 {
                let mean: f32 = (0..3).map(|k| pixel.weights[k] * around[k][c]).sum();
                lanes[c][lane] = if mean > 0.0 { code[c] / mean } else { 0.0 };
            }
        }
        lanes.map(f32x8::new)
    }

    /// Turns what all clusters of a plan send to some vertices into what they take from the codes there.
    pub fn intensities(&self, scene: &Scene, plan: &Plan, vertices: &[u32], columns: &mut Columns) {
        let sources = &scene.transfers.sources;
        let marked = |k: usize| plan.clusters[k].clone().map(|j| j as usize).filter(|&j| plan.marked[j]);
        let mean = |k: usize| marked(k).map(|j| sources[j].mean).sum::<f64>();
        let set = |k: usize| {
            let strongest = marked(k).max_by(|&a, &b| sources[a].mean.total_cmp(&sources[b].mean));
            strongest.map_or(Set::First, |j| self.sets[j])
        };
        let mut order: Vec<(usize, Set, f64)> =
            (0..plan.clusters.len()).map(|k| (k, set(k), mean(k))).collect();
        order.sort_by(|a, b| b.2.total_cmp(&a.2));
        let rows: Vec<_> = columns.irradiance.axis_iter_mut(Axis(0)).collect();
        rows.into_par_iter().zip(vertices).for_each(|(mut row, &v)| {
            let (radiance, all) = (self.radiance[v as usize], scene.transfers.irradiance.row(v as usize));
            let part = |&(k, set, _): &(usize, Set, f64)| {
                let part = |c: usize| if all[c] > 0.0 { radiance[c] * row[(k, c)] / all[c] } else { 0.0 };
                (set, [0, 1, 2].map(part))
            };
            let parts: Vec<_> = order.iter().map(part).collect();
            let taken = intensity_transfers(radiance, parts, |radiance| self.tone(radiance));
            for (&(k, ..), taken) in order.iter().zip(taken) {
                (0..3).for_each(|c| row[(k, c)] = taken[c]);
            }
        });
    }

    /// What one pass takes from the codes of a vector of pixels: whole code values. `taken` is the interpolated intensity
    /// transfer times the share that is in shadow; it is scaled by the pixel's own code, since what a source takes from a
    /// code is about proportional to it. (The paper subtracts as much from a dark pixel of a texture as from a bright one.)
    pub fn pass(&self, vector: usize, channel: usize, taken: f32x8) -> f32x8 {
        (taken * self.contrast[vector][channel]).round()
    }

    /// The photograph after all passes, and the radiance that its response says is gone.
    pub fn subtract(&self, pixels: &[Pixel], taken: &[[f32; 3]]) -> (CodeImage, RadianceImage) {
        let (width, height) = self.stored.codes.size();
        let mut codes = self.stored.codes.clone();
        let mut epsilon = vec![Radiance::default(); width * height];
        for (pixel, taken) in pixels.iter().zip(taken).filter(|(_, taken)| **taken != [0.0; 3]) {
            let index = pixel.index as usize;
            let before = codes.pixels()[index].0;
            let after = [0, 1, 2].map(|c| ((before[c] * TOP).round() - taken[c]).max(0.0) / TOP);
            let (exposure, left) =
                (self.stored.response.exposure_of(before), self.stored.response.exposure_of(after));
            codes.pixels_mut()[index] = Code(after);
            epsilon[index] = Radiance([0, 1, 2].map(|c| exposure[c] - left[c]));
        }
        (codes, RadianceImage::from_pixels(width, height, epsilon))
    }
}

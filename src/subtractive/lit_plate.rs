//! The plate under a few lights: the unshadowed light is the photograph, the shadow buffer holds the irradiance that is hidden.
//!
//! ε(x) = B(x) S′(x) / E(x), with S the irradiance of the lights that the object hides and the scene model does not, and E
//! that of all light of the empty scene, which the radiance transfers know: the plate's reflectance and texture stay.

use super::{Casters, Light, ShadowBuffer, Surface, gather};
use crate::config::Render;
use crate::image::{Image, RadianceImage, luminance};
use crate::shadow::{Occluder, Pixel, Prepared, Problem, Removed, Scene};
use crate::visibility::Bvh;
use glam::Vec3;
use std::time::Instant;

/// What stays of a plate when the object and its lights change.
pub(crate) struct LitPlate<'a> {
    pub scene: Scene<'a>,
    pub prepared: Prepared,
    pub surfaces: Image<Option<Surface>>,
    /// The scene model.
    pub model: Bvh,
    /// Whether the model hides lights; else their light is taken to arrive.
    pub model_hides: bool,
    /// Whether half of the lights, doubled, stands for all, so that both halves tell the error to expect.
    pub halves_tell: bool,
    /// Side of a shadow map, texels.
    pub map_px: usize,
}

/// Rays to lights start so far off the model's surfaces, m.
const OFFSET_M: f32 = 1e-4;

impl<'a> LitPlate<'a> {
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        Ok(Self {
            scene: *scene,
            prepared: Prepared::new(scene, settings)?,
            surfaces: Surface::of_receivers(scene.receivers),
            model: Bvh::new(&scene.light.mesh.vertices, &scene.light.mesh.triangles()),
            model_hides: true,
            halves_tell: true,
            map_px: settings.shadow_map_px,
        })
    }

    /// What an object removes of lights, found at one pixel in `side`², and what maps, samples and the rest took, s.
    pub fn removed(&self, lights: &[Light], occluder: &Occluder, side: usize) -> (Removed, [f64; 3]) {
        let started = Instant::now();
        let casters = Casters::draw(lights, occluder, self.map_px);
        let drawn = started.elapsed().as_secs_f64();
        let find = |surfaces: &[Surface]| self.hidden(surfaces, lights, &casters);
        let buffer = ShadowBuffer::fill(&self.surfaces, side, find);
        let found = started.elapsed().as_secs_f64();
        let gone = buffer.resample(&self.surfaces, find);
        let values = self.prepared.pixels.iter().map(|p| gone.pixels()[p.index as usize]);
        let (blocked, differences): (Vec<[f32; 3]>, Vec<f32>) =
            values.map(|[r, g, b, difference]| ([r, g, b], difference)).unzip();
        let epsilon = self.prepared.epsilon(self.scene.plate, &blocked);
        let plate = self.scene.plate.pixels();
        let of_plate = |(pixel, difference): (&Pixel, f32)| {
            let all = luminance(pixel.irradiance);
            if all > 0.0 { difference / all * plate[pixel.index as usize].luminance() } else { 0.0 }
        };
        let differences: Vec<f32> = self.prepared.pixels.iter().zip(differences).map(of_plate).collect();
        let removed = self.stated(epsilon, [lights.len(), casters.maps()], &differences);
        (removed, [drawn, found - drawn, started.elapsed().as_secs_f64() - found])
    }

    /// Irradiance that the object hides from each of neighbouring surfaces, plate units, then the difference of what the two
    /// halves of the lights hide, as luminance.
    fn hidden(&self, surfaces: &[Surface], lights: &[Light], casters: &Casters) -> Vec<[f32; 4]> {
        let Some(first) = surfaces.first() else { return Vec::new() };
        let low = surfaces.iter().fold(first.position, |a, s| a.min(s.position));
        let high = surfaces.iter().fold(first.position, |a, s| a.max(s.position));
        let near = casters.near((low + high) / 2.0, low.distance(high) / 2.0);
        let hidden = |surface: &Surface| {
            let from = surface.position + surface.normal * OFFSET_M;
            let gone = |i: usize, direction: Vec3| {
                let arrives = || !self.model_hides || !lights[i].hidden_by(&self.model, from);
                if casters.hide(i, surface, direction) && arrives() { [1.0; 3] } else { [0.0; 3] }
            };
            let [a, b] = [1.0, -1.0].map(|sign| {
                let own = near.iter().copied().filter(|&i| half(i) == sign);
                gather(surface, None, lights, own, gone).irradiance
            });
            [a[0] + b[0], a[1] + b[1], a[2] + b[2], luminance(a) - luminance(b)]
        };
        surfaces.iter().map(hidden).collect()
    }

    /// ε by so many lights and maps with the error to expect, from the difference of what the halves of the lights remove of
    /// each receiver pixel, as luminance.
    pub fn stated(&self, epsilon: RadianceImage, [lights, maps]: [usize; 2], differences: &[f32]) -> Removed {
        let luminance = |p: &Pixel| epsilon.pixels()[p.index as usize].luminance();
        let expected_error =
            expected_error(self.prepared.pixels.iter().map(luminance).zip(differences.iter().copied()));
        Removed {
            epsilon,
            codes: None,
            noise: None,
            sources_used: lights,
            passes: lights,
            shadow_maps: maps,
            expected_error: expected_error.filter(|_| self.halves_tell),
            left_out_share: 0.0,
        }
    }
}

/// Relative shadow error to expect, from ε and the difference of what its two halves of the lights hide (luminance, by
/// pixel). Either half alone would, doubled, be a shadow of its own, and their mean, which is ε, lies half the difference
/// of those from each. It overestimates: errors of neighbouring strata cancel better than those of halves (tests see 1.5 to
/// 4 times the true error). What lights and shadow buffer do alike everywhere (the buffer's blur, light seen from the
/// object's middle only) is not in it.
fn expected_error(pairs: impl Iterator<Item = (f32, f32)>) -> Option<f64> {
    let [signal, error] = pairs.fold([0.0f64; 2], |[s, e], (epsilon, difference)| {
        [s + f64::from(epsilon).powi(2), e + f64::from(difference).powi(2)]
    });
    (signal > 0.0).then(|| (error / signal).sqrt())
}

/// To which half of the lights one belongs: every other one.
pub(crate) fn half(light: usize) -> f32 {
    if light.is_multiple_of(2) { 1.0 } else { -1.0 }
}

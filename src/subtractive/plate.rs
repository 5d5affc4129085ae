//! The shadow on the plate: the unshadowed light is the photograph, the shadow buffer holds the irradiance that is hidden.
//!
//! ε(x) = B(x) S′(x) / E(x), with S the irradiance of the lights that the object hides and the scene model does not, and E
//! that of all light of the empty scene, which the radiance transfers know: the plate's reflectance and texture stay.

use super::lights::lights_at;
use super::{Casters, Detail, Light, Pace, ShadowBuffer, Surface, gather};
use crate::config::Render;
use crate::image::{Image, RadianceImage, luminance};
use crate::shadow::{Bounds, Occluder, Prepared, Problem, Removed, Scene};
use crate::visibility::Bvh;
use glam::Vec3;
use std::time::Instant;

/// The method `subtractive`, prepared for a scene.
pub struct Subtractive<'a> {
    scene: Scene<'a>,
    settings: Render,
    surfaces: Image<Option<Surface>>,
    prepared: Prepared,
    model: Bvh,
    pace: Pace,
}

/// Rays to lights start so far off the model's surfaces, m.
const OFFSET_M: f32 = 1e-4;

impl<'a> Subtractive<'a> {
    /// What stays when the object moves.
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        check(settings)?;
        Ok(Self {
            scene: *scene,
            settings: settings.clone(),
            prepared: Prepared::new(scene, settings)?,
            surfaces: Surface::of_receivers(scene.receivers),
            model: Bvh::new(&scene.light.mesh.vertices, &scene.light.mesh.triangles()),
            pace: Pace::default(),
        })
    }

    /// ε of an object, with as much detail as the settings ask for and, if they give a time, as it allows.
    pub fn frame(&mut self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        let started = Instant::now();
        let detail = self.detail();
        let lights = self.lights(occluder, detail)?;
        let mut marks = vec![started.elapsed()];
        let casters = Casters::draw(&lights, occluder, self.settings.shadow_map_px);
        marks.push(started.elapsed());
        let find = |surfaces: &[Surface]| hidden(surfaces, &lights, &casters, &self.model);
        let buffer = ShadowBuffer::fill(&self.surfaces, detail.side, find);
        marks.push(started.elapsed());
        let gone = buffer.resample(&self.surfaces, find);
        let values = self.prepared.pixels.iter().map(|p| gone.pixels()[p.index as usize]);
        let (blocked, differences): (Vec<[f32; 3]>, Vec<f32>) =
            values.map(|[r, g, b, difference]| ([r, g, b], difference)).unzip();
        let epsilon = self.prepared.epsilon(self.scene.plate, &blocked);
        let pairs = self.prepared.pixels.iter().zip(&differences).map(|(pixel, difference)| {
            let (whole, all) = (self.scene.plate.pixels()[pixel.index as usize], luminance(pixel.irradiance));
            let share = if all > 0.0 { difference / all } else { 0.0 };
            [epsilon.pixels()[pixel.index as usize].luminance(), whole.luminance() * share]
        });
        let expected_error = expected_error(pairs);
        let [before, drawn, found] = [0, 1, 2].map(|i| marks[i].as_secs_f64());
        let rest = before + started.elapsed().as_secs_f64() - found;
        self.learn(detail, [rest, drawn - before, found - drawn]);
        Ok(removed(epsilon, &lights, casters.maps(), expected_error))
    }

    /// What the next frame may spend.
    pub(crate) fn detail(&self) -> Detail {
        Detail::chosen(&self.settings, &self.pace, self.prepared.pixels.len())
    }

    /// Takes note of what a frame took for all but maps and samples, for its maps, and for its samples, s.
    pub(crate) fn learn(&mut self, detail: Detail, seconds: [f64; 3]) {
        self.pace.learn(detail, self.prepared.pixels.len(), seconds);
    }

    /// Those of the environment at the object's place.
    pub(crate) fn lights(&self, occluder: &Occluder, detail: Detail) -> Result<Vec<Light>, Problem> {
        let place = Bounds::of(occluder).centre;
        let lights = lights_at(self.scene.light, &self.model, place, detail.lights, &self.settings);
        if lights.is_empty() { Err(Problem::Dark) } else { Ok(lights) }
    }

    pub(crate) fn prepared(&self) -> &Prepared {
        &self.prepared
    }

    pub(crate) fn scene(&self) -> &Scene<'a> {
        &self.scene
    }

    pub(crate) fn surfaces(&self) -> &Image<Option<Surface>> {
        &self.surfaces
    }

    pub(crate) fn settings(&self) -> &Render {
        &self.settings
    }
}

pub(crate) fn removed(
    epsilon: RadianceImage,
    lights: &[Light],
    maps: usize,
    expected_error: Option<f64>,
) -> Removed {
    Removed {
        epsilon,
        codes: None,
        noise: None,
        sources_used: lights.len(),
        passes: lights.len(),
        shadow_maps: maps,
        expected_error,
        left_out_share: 0.0,
    }
}

/// Relative shadow error to expect, from ε and the difference of what its two halves of the lights hide (luminance, by
/// pixel). Either half alone would, doubled, be a shadow of its own, and their mean, which is ε, lies half the difference
/// of those from each. It overestimates: errors of neighbouring strata cancel better than those of halves (tests see 1.5 to
/// 4 times the true error). What lights and shadow buffer do alike everywhere (the buffer's blur, light seen from the
/// object's middle only) is not in it.
pub(crate) fn expected_error(pairs: impl Iterator<Item = [f32; 2]>) -> Option<f64> {
    let [signal, error] = pairs.fold([0.0f64; 2], |[s, e], [epsilon, difference]| {
        [s + f64::from(epsilon).powi(2), e + f64::from(difference).powi(2)]
    });
    (signal > 0.0).then(|| (error / signal).sqrt())
}

/// To which half of the lights one belongs: every other one.
pub(crate) fn half(light: usize) -> f32 {
    if light.is_multiple_of(2) { 1.0 } else { -1.0 }
}

/// Irradiance that the object hides from each of neighbouring surfaces, plate units, then the difference of what the two
/// halves of the lights hide, as luminance.
fn hidden(surfaces: &[Surface], lights: &[Light], casters: &Casters, model: &Bvh) -> Vec<[f32; 4]> {
    let Some(first) = surfaces.first() else { return Vec::new() };
    let low = surfaces.iter().fold(first.position, |a, s| a.min(s.position));
    let high = surfaces.iter().fold(first.position, |a, s| a.max(s.position));
    let near = casters.near((low + high) / 2.0, low.distance(high) / 2.0);
    let hidden = |surface: &Surface| {
        let from = surface.position + surface.normal * OFFSET_M;
        let gone = |i: usize, direction: Vec3| {
            let gone = casters.hide(i, surface, direction) && !lights[i].hidden_by(model, from);
            if gone { [1.0; 3] } else { [0.0; 3] }
        };
        let [a, b] = [1.0, -1.0].map(|sign| {
            let own = near.iter().copied().filter(|&i| half(i) == sign);
            gather(surface, None, lights, own, gone).irradiance
        });
        [a[0] + b[0], a[1] + b[1], a[2] + b[2], luminance(a) - luminance(b)]
    };
    surfaces.iter().map(hidden).collect()
}

impl Detail {
    /// What the settings ask for.
    pub fn of(settings: &Render) -> Self {
        Self { lights: settings.lights, side: settings.pixels_per_sample.isqrt() }
    }

    /// As much of it as the time that they give for a frame allows for so many pixels of plate or object: each has half.
    pub(super) fn chosen(settings: &Render, pace: &Pace, pixels: usize) -> Self {
        let wanted = Self::of(settings);
        match settings.frame_ms {
            ms if ms > 0.0 => pace.choose(ms * 0.5e-3, wanted, pixels),
            _ => wanted,
        }
    }
}

fn check(settings: &Render) -> Result<(), Problem> {
    let refuse = |name, value: usize, range| Err(Problem::Setting { name, value: value.to_string(), range });
    let pixels = settings.pixels_per_sample;
    if settings.lights == 0 {
        return refuse("lights", settings.lights, "1 or more");
    }
    if ![1, 4, 16, 64, 256, 1024].contains(&pixels) {
        return refuse("pixels_per_sample", pixels, "1, 4, 16, 64, 256 or 1024");
    }
    Ok(())
}

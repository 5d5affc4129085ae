//! The shadow on the plate: the unshadowed light is the photograph, the shadow buffer holds the irradiance that is hidden.
//!
//! ε(x) = B(x) S′(x) / E(x), with S the irradiance of the lights that the object hides and the scene model does not, and E
//! that of all light of the empty scene, which the radiance transfers know: the plate's reflectance and texture stay.

use super::lights::lights_at;
use super::{Casters, Detail, Light, Pace, ShadowBuffer, Surface, gather};
use crate::config::Render;
use crate::image::{Image, Radiance};
use crate::shadow::{Bounds, Occluder, Problem, Removed, Scene};
use crate::visibility::Bvh;
use glam::Vec3;
use rayon::prelude::*;
use std::time::Instant;

/// The method `subtractive`, prepared for a scene.
pub struct Subtractive<'a> {
    scene: Scene<'a>,
    settings: Render,
    surfaces: Image<Option<Surface>>,
    /// Irradiance of the empty scene by pixel, plate units.
    irradiance: Vec<[f32; 3]>,
    /// Number of pixels that see a surface.
    seen: usize,
    model: Bvh,
    pace: Pace,
}

/// Rays to lights start so far off the model's surfaces, m.
const OFFSET_M: f32 = 1e-4;

impl<'a> Subtractive<'a> {
    /// What stays when the object moves.
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        scene.check()?;
        check(settings)?;
        let mesh = &scene.light.mesh;
        let surfaces = Surface::of_receivers(scene.receivers);
        let irradiance = scene.receivers.pixels.pixels().par_iter().map(|receiver| {
            let Some(receiver) = receiver else { return Ok([0.0; 3]) };
            scene.transfers.irradiance_on(receiver).ok_or_else(|| Problem::Mismatch {
                what: "patch seen by the plate",
                found: format!("patch {} has no transfers", receiver.patch),
                expected: format!("one of {} receiver patches", scene.transfers.receivers.patches.len()),
            })
        });
        Ok(Self {
            scene: *scene,
            settings: settings.clone(),
            irradiance: irradiance.collect::<Result<_, _>>()?,
            seen: surfaces.pixels().iter().flatten().count(),
            surfaces,
            model: Bvh::new(&mesh.vertices, &mesh.triangles()),
            pace: Pace::default(),
        })
    }

    /// ε of an object, with as much detail as the settings ask for and, if they give a time, as it allows.
    pub fn frame(&mut self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        let started = Instant::now();
        let wanted = Detail::of(&self.settings);
        let detail = match self.settings.frame_ms {
            ms if ms > 0.0 => self.pace.choose(ms * 1e-3, wanted, self.seen),
            _ => wanted,
        };
        let place = Bounds::of(occluder).centre;
        let lights = lights_at(self.scene.light, &self.model, place, detail.lights, &self.settings);
        if lights.is_empty() {
            return Err(Problem::Dark);
        }
        let mut marks = vec![started.elapsed()];
        let casters = Casters::draw(&lights, occluder, self.settings.shadow_map_px);
        marks.push(started.elapsed());
        let find = |surfaces: &[Surface]| hidden(surfaces, &lights, &casters, &self.model);
        let buffer = ShadowBuffer::fill(&self.surfaces, detail.side, find);
        marks.push(started.elapsed());
        let gone = buffer.resample(&self.surfaces, find);
        let (plate, (width, height)) = (self.scene.plate, self.scene.plate.size());
        let share = |gone: f32, all: f32| if all > 0.0 { (gone / all).clamp(0.0, 1.0) } else { 0.0 };
        let pixels = plate.pixels().iter().zip(gone.pixels()).zip(&self.irradiance);
        let epsilon = pixels.map(|((plate, gone), all)| {
            Radiance([0, 1, 2].map(|k| plate.0[k].max(0.0) * share(gone[k], all[k])))
        });
        let epsilon = Image::from_pixels(width, height, epsilon.collect());
        let [before, drawn, found] = [0, 1, 2].map(|i| marks[i].as_secs_f64());
        let rest = before + started.elapsed().as_secs_f64() - found;
        self.pace.learn(detail, self.seen, [rest, drawn - before, found - drawn]);
        Ok(Removed {
            epsilon,
            codes: None,
            noise: None,
            sources_used: lights.len(),
            passes: lights.len(),
            shadow_maps: casters.maps(),
            expected_error: None,
            left_out_share: 0.0,
        })
    }
}

/// Irradiance that the object hides from each of neighbouring surfaces, plate units.
fn hidden(surfaces: &[Surface], lights: &[Light], casters: &Casters, model: &Bvh) -> Vec<[f32; 3]> {
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
        gather(surface, None, lights, near.iter().copied(), gone).irradiance
    };
    surfaces.iter().map(hidden).collect()
}

impl Detail {
    /// What the settings ask for.
    pub fn of(settings: &Render) -> Self {
        Self { lights: settings.lights, side: settings.pixels_per_sample.isqrt() }
    }
}

fn check(settings: &Render) -> Result<(), Problem> {
    let refuse = |name, value: usize, range| Err(Problem::Setting { name, value: value.to_string(), range });
    let pixels = settings.pixels_per_sample;
    if settings.lights == 0 {
        return refuse("lights", settings.lights, "1 or more");
    }
    if !(16..=8192).contains(&settings.shadow_map_px) {
        return refuse("shadow_map_px", settings.shadow_map_px, "between 16 and 8192");
    }
    if ![1, 4, 16, 64, 256, 1024].contains(&pixels) {
        return refuse("pixels_per_sample", pixels, "1, 4, 16, 64, 256 or 1024");
    }
    Ok(())
}

//! The shadow on the plate: the unshadowed light is the photograph, the shadow buffer holds the irradiance that is hidden.
//!
//! ε(x) = B(x) S′(x) / E(x), with S the irradiance of the lights that the object hides and the scene model does not, and E
//! that of all light of the empty scene, which the radiance transfers know: the plate's reflectance and texture stay.

use super::lights::lights_at;
use super::{Casters, Detail, Light, Pace, ShadowBuffer, Surface, gather};
use crate::config::Render;
use crate::image::Image;
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
        let wanted = Detail::of(&self.settings);
        let detail = match self.settings.frame_ms {
            ms if ms > 0.0 => self.pace.choose(ms * 1e-3, wanted, self.prepared.pixels.len()),
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
        let blocked: Vec<[f32; 3]> =
            self.prepared.pixels.iter().map(|p| gone.pixels()[p.index as usize]).collect();
        let epsilon = self.prepared.epsilon(self.scene.plate, &blocked);
        let [before, drawn, found] = [0, 1, 2].map(|i| marks[i].as_secs_f64());
        let rest = before + started.elapsed().as_secs_f64() - found;
        self.pace.learn(detail, self.prepared.pixels.len(), [rest, drawn - before, found - drawn]);
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
    if ![1, 4, 16, 64, 256, 1024].contains(&pixels) {
        return refuse("pixels_per_sample", pixels, "1, 4, 16, 64, 256 or 1024");
    }
    Ok(())
}

//! The shadow on the plate: the unshadowed light is the photograph, the shadow buffer holds the share that is hidden.
//!
//! ε(x) = B(x) Σ_hidden E_i / Σ_all E_i over the lights i that the scene model leaves to x. A ratio, since the few lights
//! and the photograph do not agree on the absolute irradiance: where all lights are hidden, all light is gone.

use super::{Casters, Detail, Light, Pace, ShadowBuffer, Surface, gather, sample};
use crate::config::Render;
use crate::image::{Image, Radiance};
use crate::render::Environment;
use crate::shadow::{Bounds, Occluder, Problem, Removed, Scene};
use crate::visibility::Bvh;
use glam::Vec3;
use std::time::Instant;

/// The method `subtractive`, prepared for a scene.
pub struct Subtractive<'a> {
    scene: Scene<'a>,
    settings: Render,
    surfaces: Image<Option<Surface>>,
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
        Ok(Self {
            scene: *scene,
            settings: settings.clone(),
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
        let width = self.settings.environment_px.max(8);
        let environment = Environment::cast(self.scene.light, &self.model, place, width, width / 2);
        let lights = lights_at(&self.scene, &self.model, &environment, place, detail.lights, &self.settings);
        if lights.is_empty() {
            return Err(Problem::Dark);
        }
        let mut marks = vec![started.elapsed()];
        let casters = Casters::draw(&lights, occluder, self.settings.shadow_map_px);
        marks.push(started.elapsed());
        let find = |surfaces: &[Surface]| hidden_shares(surfaces, &lights, &casters, &self.model);
        let buffer = ShadowBuffer::fill(&self.surfaces, detail.side, find);
        marks.push(started.elapsed());
        let shares = buffer.resample(&self.surfaces, find);
        let (plate, (width, height)) = (self.scene.plate, self.scene.plate.size());
        let epsilon = plate.pixels().iter().zip(shares.pixels());
        let epsilon = epsilon.map(|(b, share)| Radiance([0, 1, 2].map(|k| b.0[k].max(0.0) * share[k])));
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

/// The lights of an environment made at `place` (m), on the scene model.
fn lights_at(
    scene: &Scene,
    model: &Bvh,
    environment: &Environment,
    place: Vec3,
    count: usize,
    settings: &Render,
) -> Vec<Light> {
    let sources = sample(&environment.map, count, settings.light_sampling);
    sources.iter().map(|source| Light::on_model(source, scene.light, model, place)).collect()
}

/// Share of the irradiance of each of neighbouring surfaces that the object hides.
fn hidden_shares(surfaces: &[Surface], lights: &[Light], casters: &Casters, model: &Bvh) -> Vec<[f32; 3]> {
    let Some(first) = surfaces.first() else { return Vec::new() };
    let low = surfaces.iter().fold(first.position, |a, s| a.min(s.position));
    let high = surfaces.iter().fold(first.position, |a, s| a.max(s.position));
    let near = casters.near((low + high) / 2.0, low.distance(high) / 2.0);
    surfaces
        .iter()
        .map(|surface| {
            let from = surface.position + surface.normal * OFFSET_M;
            let left = |i: usize| !lights[i].hidden_by(model, from);
            let mut hidden = vec![false; lights.len()];
            let gone = gather(surface, None, lights, near.iter().copied(), |i, direction| {
                hidden[i] = casters.hide(i, surface, direction) && left(i);
                shown(hidden[i])
            });
            if gone.irradiance == [0.0; 3] {
                return [0.0; 3];
            }
            let all = gather(surface, None, lights, 0..lights.len(), |i, _| shown(hidden[i] || left(i)));
            hidden_share(gone.irradiance, all.irradiance)
        })
        .collect()
}

/// White or black.
pub(super) fn shown(yes: bool) -> [f32; 3] {
    [if yes { 1.0 } else { 0.0 }; 3]
}

/// Part of the whole, by channel, 0 where there is nothing.
pub(super) fn hidden_share(part: [f32; 3], whole: [f32; 3]) -> [f32; 3] {
    [0, 1, 2].map(|k| if whole[k] > 0.0 { (part[k] / whole[k]).clamp(0.0, 1.0) } else { 0.0 })
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

//! The method `subtractive` on the plate: the environment's lights, and as much detail as time allows.

use super::lights::lights_at;
use super::lit_plate::LitPlate;
use super::{Detail, Light, Pace};
use crate::config::Render;
use crate::shadow::{Bounds, Occluder, Problem, Removed, Scene};
use std::time::Instant;

/// The method `subtractive`, prepared for a scene.
pub struct Subtractive<'a> {
    plate: LitPlate<'a>,
    settings: Render,
    pace: Pace,
}

impl<'a> Subtractive<'a> {
    /// What stays when the object moves.
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        check(settings)?;
        let plate = LitPlate::prepare(scene, settings)?;
        Ok(Self { plate, settings: settings.clone(), pace: Pace::default() })
    }

    /// ε of an object, with as much detail as the settings ask for and, if they give a time, as it allows.
    pub fn frame(&mut self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        let started = Instant::now();
        let detail = self.detail();
        let lights = self.lights(occluder, detail)?;
        let before = started.elapsed().as_secs_f64();
        let (removed, [maps, samples, rest]) = self.plate.removed(&lights, occluder, detail.side);
        self.learn(detail, [before + rest, maps, samples]);
        Ok(removed)
    }

    /// What the next frame may spend.
    pub(crate) fn detail(&self) -> Detail {
        Detail::chosen(&self.settings, &self.pace, self.plate.prepared.pixels.len())
    }

    /// Takes note of what a frame took for all but maps and samples, for its maps, and for its samples, s.
    pub(crate) fn learn(&mut self, detail: Detail, seconds: [f64; 3]) {
        self.pace.learn(detail, self.plate.prepared.pixels.len(), seconds);
    }

    /// Those of the environment at the object's place.
    pub(crate) fn lights(&self, occluder: &Occluder, detail: Detail) -> Result<Vec<Light>, Problem> {
        let place = Bounds::of(occluder).centre;
        let LitPlate { scene, model, .. } = &self.plate;
        let lights = lights_at(scene.light, model, place, detail.lights, &self.settings);
        if lights.is_empty() { Err(Problem::Dark) } else { Ok(lights) }
    }

    pub(crate) fn plate(&self) -> &LitPlate<'a> {
        &self.plate
    }

    /// Whether a time for each frame is to be kept.
    pub(crate) fn is_timed(&self) -> bool {
        self.settings.frame_ms > 0.0
    }
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

//! The method `subtractive` on the graphics processor.

use super::lit_plate::LitPlate;
use super::{Budget, Twin};
use crate::config::Render;
use crate::image::RadianceImage;
use crate::shadow::{Occluder, Problem, Removed, Scene};
use crate::subtractive;
use std::time::Instant;

/// The method with everything static on the device; only the object and its lights change from frame to frame.
pub struct Subtractive<'a> {
    /// The same method in plain Rust: finds the lights, chooses the detail.
    plain: subtractive::Subtractive<'a>,
    plate: LitPlate,
}

impl<'a> Subtractive<'a> {
    /// Uploads everything that does not depend on the object.
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        Self::prepare_within(scene, settings, Budget::default())
    }

    /// The same with less of the device.
    pub fn prepare_within(scene: &Scene<'a>, settings: &Render, budget: Budget) -> Result<Self, Problem> {
        let plain = subtractive::Subtractive::prepare(scene, settings)?;
        Ok(Self { plate: LitPlate::new(plain.plate(), budget)?, plain })
    }
}

impl Twin for Subtractive<'_> {
    fn adapter(&self) -> &str {
        self.plate.adapter()
    }

    /// With as much detail as the settings ask for and, if they give a time, as it allows.
    fn removed_radiance(&mut self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        let started = Instant::now();
        let detail = self.plain.detail();
        let lights = self.plain.lights(occluder, detail)?;
        let before = started.elapsed().as_secs_f64();
        let how = (detail.side, self.plain.is_timed());
        let (removed, [maps, samples, rest]) =
            self.plate.removed(self.plain.plate(), &lights, occluder, how)?;
        self.plain.learn(detail, [before + rest, maps, samples]);
        Ok(removed)
    }

    fn plain_radiance(&mut self, occluder: &Occluder) -> Result<Removed, Problem> {
        self.plain.frame(occluder)
    }

    fn plate(&self) -> &RadianceImage {
        self.plain.plate().scene.plate
    }
}

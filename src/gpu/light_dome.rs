//! The method `light-dome` on the graphics processor.

use super::lit_plate::LitPlate;
use super::{Budget, Twin};
use crate::config::Render;
use crate::dome;
use crate::image::RadianceImage;
use crate::shadow::{Occluder, Problem, Removed, Scene};

/// The method with everything static on the device; only the object and its dome change from frame to frame.
pub struct LightDome<'a> {
    /// The same method in plain Rust: makes the dome.
    plain: dome::LightDome<'a>,
    plate: LitPlate,
}

impl<'a> LightDome<'a> {
    /// Uploads everything that does not depend on the object.
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        Self::prepare_within(scene, settings, Budget::default())
    }

    /// The same with less of the device.
    pub fn prepare_within(scene: &Scene<'a>, settings: &Render, budget: Budget) -> Result<Self, Problem> {
        let plain = dome::LightDome::prepare(scene, settings)?;
        Ok(Self { plate: LitPlate::new(plain.plate(), budget)?, plain })
    }
}

impl Twin for LightDome<'_> {
    fn adapter(&self) -> &str {
        self.plate.adapter()
    }

    fn removed_radiance(&mut self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        let lights = self.plain.lights(occluder)?;
        let how = (dome::SIDE, false);
        Ok(self.plate.removed(self.plain.plate(), &lights, occluder, how)?.0)
    }

    fn plain_radiance(&mut self, occluder: &Occluder) -> Result<Removed, Problem> {
        self.plain.frame(occluder)
    }

    fn plate(&self) -> &RadianceImage {
        self.plain.plate().scene.plate
    }
}

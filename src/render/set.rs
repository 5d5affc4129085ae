//! Everything static that shades an object, so that it can be placed again and again.

use super::environment::Environment;
use super::layer::{Rendered, render};
use super::object::Object;
use super::shade::{Lighting, Shadowed};
use crate::camera::Camera;
use crate::config;
use crate::illuminate::patch::LightModel;
use crate::image::RadianceImage;
use crate::irradiance::{Beams, Volume};
use crate::visibility::Bvh;

/// What stays when the object moves.
#[derive(Clone, Copy)]
pub struct Set<'a> {
    /// Camera of the plate.
    pub camera: &'a Camera,
    /// The plate.
    pub plate: &'a RadianceImage,
    /// The light.
    pub light: &'a LightModel,
    /// Its patches, for rays.
    pub light_bvh: &'a Bvh,
    /// Irradiance of the empty scene.
    pub volume: &'a Volume,
    /// Triangles of the scene model.
    pub scene_bvh: &'a Bvh,
    /// How finely to shade.
    pub settings: &'a config::Render,
}

impl Set<'_> {
    /// The object as the plate's camera sees it, and the environment at its place. `removed` is its shadow on the plate.
    pub fn shade(&self, object: &Object, removed: &RadianceImage) -> (Rendered, Environment) {
        let [low, high] = object.bounds();
        let width = self.settings.environment_px.max(8);
        let environment = Environment::cast(self.light, self.light_bvh, (low + high) / 2.0, width, width / 2);
        let beams = Beams::new(&self.light.distant, self.light_bvh);
        let irradiance = |position, normal| self.volume.irradiance_with(&beams, position, normal);
        let shadowed = Shadowed { camera: self.camera, plate: self.plate, removed, scene: self.scene_bvh };
        let rays = self.settings.shading_rays;
        let lighting = Lighting::new(&irradiance, &environment, object, rays, Some(&shadowed));
        let (antialiasing, seed) = (self.settings.antialiasing, self.settings.seed);
        let rendered = render(object, self.camera, self.scene_bvh, &lighting, antialiasing, seed);
        (rendered, environment)
    }
}

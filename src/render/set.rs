//! Everything static that shades an object, so that it can be placed again and again.

use super::environment::Environment;
use super::layer::{Rendered, render};
use super::object::Object;
use super::reflected::Reflector;
use super::shade::{Lighting, Shadowed};
use crate::camera::Camera;
use crate::config::{self, ShadowMethod};
use crate::dome;
use crate::illuminate::patch::LightModel;
use crate::image::RadianceImage;
use crate::irradiance::{Beams, Volume};
use crate::shadow::Receivers;
use crate::subtractive::{Pace, render_object};
use crate::transfer::Transfers;
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
    /// Its distant light as a picture, if there is any.
    pub sky: Option<&'a RadianceImage>,
    /// Its patches, for rays.
    pub light_bvh: &'a Bvh,
    /// Irradiance of the empty scene.
    pub volume: &'a Volume,
    /// Triangles of the scene model.
    pub scene_bvh: &'a Bvh,
    /// What the plate's pixels look at.
    pub receivers: &'a Receivers,
    /// What lights them.
    pub transfers: &'a Transfers,
    /// How finely to shade.
    pub settings: &'a config::Render,
}

/// An object in its place.
pub struct Shaded {
    /// As the plate's camera sees it.
    pub rendered: Rendered,
    /// The environment at its place.
    pub environment: Environment,
    /// Radiance that the plate gains by its light, plate units.
    pub reflected: RadianceImage,
}

impl Set<'_> {
    /// Lights the object, and the scene by it. `removed` is its shadow on the plate, `pace` what earlier frames took of the
    /// method that shades by a time.
    pub fn shade(&self, object: &Object, removed: &RadianceImage, pace: &mut Pace) -> Shaded {
        let [low, high] = object.bounds();
        let width = self.settings.environment_px.max(8);
        let place = (low + high) / 2.0;
        let environment =
            Environment::cast_under(self.light, self.sky, self.light_bvh, place, width, width / 2);
        let beams = Beams::new(&self.light.distant, self.light_bvh);
        let irradiance = |position, normal| self.volume.irradiance_with(&beams, position, normal);
        let shadowed = Shadowed { camera: self.camera, plate: self.plate, removed, scene: self.scene_bvh };
        let rays = self.settings.shading_rays;
        let lighting = Lighting::new(&irradiance, &environment, object, rays, Some(&shadowed));
        let (antialiasing, seed) = (self.settings.antialiasing, self.settings.seed);
        let rendered = match self.settings.method {
            ShadowMethod::Subtractive => {
                render_object(self, object, &environment, &irradiance, &shadowed, pace)
            }
            ShadowMethod::LightDome => {
                dome::render_object(self, object, &environment, &irradiance, &shadowed)
            }
            _ => render(object, self.camera, self.scene_bvh, &lighting, antialiasing, seed),
        };
        let total = |receiver: &_| self.transfers.irradiance_on(receiver);
        let rays = self.settings.reflected_rays;
        let reflected = Reflector::new(object, &lighting, seed).onto(
            self.receivers,
            self.plate,
            self.scene_bvh,
            total,
            rays,
        );
        Shaded { rendered, environment, reflected }
    }
}

//! The method `light-dome` for stills: the scene model's environment at the object's place becomes the dome, all maps are
//! drawn, and what they hide (eq. 3) is subtracted from the plate.
//!
//! The plate is a phantom object (§V.D): ε = B R / E takes from it the share that R has of all its irradiance E.

use super::{CubeMap, Layout, lights};
use crate::config::Render;
use crate::illuminate::patch::LightModel;
use crate::render::Environment;
use crate::shadow::{Bounds, Occluder, Problem, Removed, Scene};
use crate::subtractive::{Light, LitPlate};
use crate::visibility::Bvh;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Side of the cube map from which the dome is downsampled, texels.
const CUBE: usize = 64;
/// R is found at each pixel.
pub(crate) const SIDE: usize = 1;

impl Layout {
    /// What the settings ask for.
    pub fn of(settings: &Render) -> Self {
        Self { texels: settings.dome_texels, centroid: settings.dome_centroid, splits: settings.dome_splits }
    }

    pub(crate) fn check(&self) -> Result<(), Problem> {
        if !self.texels.is_power_of_two() || self.texels > 32 {
            let value = self.texels.to_string();
            return Err(Problem::Setting { name: "dome_texels", value, range: "1, 2, 4, 8, 16 or 32" });
        }
        Ok(())
    }
}

/// The dome of a scene model's light at a place, m.
pub(super) fn lights_at(model: &LightModel, bvh: &Bvh, place: Vec3, settings: &Render) -> Vec<Light> {
    let width = settings.environment_px.max(8);
    let environment = Environment::cast(model, bvh, place, width, width / 2);
    let cube = CubeMap::from_latlong(&environment.map, CUBE);
    let dome = lights(&cube, Layout::of(settings), &mut BTreeSet::new());
    if settings.dome_at_infinity {
        return dome.iter().map(|l| Light::distant(&l.source)).collect();
    }
    let place_of = if settings.dome_centroid { Light::on_model } else { Light::along };
    dome.par_iter().map(|l| place_of(&l.stratum(), model, bvh, place)).collect()
}

/// The method `light-dome`, prepared for a scene.
pub struct LightDome<'a> {
    plate: LitPlate<'a>,
    settings: Render,
    /// Normals of all receivers.
    normals: Vec<Vec3>,
}

impl<'a> LightDome<'a> {
    /// What stays when the object moves.
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        Layout::of(settings).check()?;
        let mesh = &scene.light.mesh;
        let mut normals: Vec<Vec3> = Vec::new();
        for &patch in &scene.receivers.seen {
            let normal = mesh.normal(patch as usize);
            if normals.iter().all(|n| n.dot(normal) < 0.9999) {
                normals.push(normal);
            }
        }
        let plate = LitPlate {
            // Light at infinity is taken to arrive.
            model_hides: !settings.dome_at_infinity,
            // Texels are unlike, and every other one is not half of the light.
            halves_tell: false,
            ..LitPlate::prepare(scene, settings)?
        };
        Ok(Self { plate, settings: settings.clone(), normals })
    }

    /// ε of an object.
    pub fn frame(&self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        Ok(self.plate.removed(&self.lights(occluder)?, occluder, SIDE).0)
    }

    /// Those above the horizon of some receiver.
    pub(crate) fn lights(&self, occluder: &Occluder) -> Result<Vec<Light>, Problem> {
        let place = Bounds::of(occluder).centre;
        let LitPlate { scene, model, .. } = &self.plate;
        let mut lights = lights_at(scene.light, model, place, &self.settings);
        if lights.is_empty() {
            return Err(Problem::Dark);
        }
        lights.retain(|l| self.normals.iter().any(|n| n.dot(l.seen_from(place).0) > 0.0));
        Ok(lights)
    }

    pub(crate) fn plate(&self) -> &LitPlate<'a> {
        &self.plate
    }
}

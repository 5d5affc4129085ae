//! The method `light-dome` for stills: the scene model's environment at the object's place becomes the dome, all maps are
//! drawn, and what they hide (eq. 3) is subtracted from the plate.
//!
//! The plate is a phantom object (§V.D): ε = B R / E takes from it the share that R has of all its irradiance E.

use super::{CubeMap, Layout, lights};
use crate::config::Render;
use crate::illuminate::patch::LightModel;
use crate::render::Environment;
use crate::shadow::{Bounds, Occluder, Prepared, Problem, Removed, Scene};
use crate::subtractive::{Casters, Light, Surface, gather};
use crate::visibility::Bvh;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Side of the cube map from which the dome is downsampled, texels.
const CUBE: usize = 64;
/// Rays to lights start so far off the model's surfaces, m.
const OFFSET_M: f32 = 1e-4;

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
    let light = |l: &super::DomeLight| match settings.dome_at_infinity {
        true => Light::distant(&l.source),
        false => Light::on_model(&l.stratum(), model, bvh, place),
    };
    dome.iter().map(light).collect()
}

/// The method `light-dome`, prepared for a scene.
pub struct LightDome<'a> {
    scene: Scene<'a>,
    settings: Render,
    prepared: Prepared,
    model: Bvh,
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
        Ok(Self {
            scene: *scene,
            settings: settings.clone(),
            prepared: Prepared::new(scene, settings)?,
            model: Bvh::new(&mesh.vertices, &mesh.triangles()),
            normals,
        })
    }

    /// ε of an object.
    pub fn frame(&self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        let place = Bounds::of(occluder).centre;
        let mut lights = lights_at(self.scene.light, &self.model, place, &self.settings);
        if lights.is_empty() {
            return Err(Problem::Dark);
        }
        let above = |l: &Light| self.normals.iter().any(|n| n.dot(l.seen_from(place).0) > 0.0);
        lights.retain(above);
        let casters = Casters::draw(&lights, occluder, self.settings.shadow_map_px);
        let Prepared { pixels, tiles, .. } = &self.prepared;
        let blocked: Vec<Vec<[f32; 3]>> = tiles
            .par_iter()
            .map(|tile| {
                let near = casters.near(tile.centre, tile.radius);
                let gone = |p: &_| self.shadow_buffer(p, &lights, &casters, &near);
                pixels[tile.pixels.clone()].iter().map(gone).collect()
            })
            .collect();
        Ok(Removed {
            epsilon: self.prepared.epsilon(self.scene.plate, &blocked.concat()),
            codes: None,
            noise: None,
            sources_used: lights.len(),
            passes: lights.len(),
            shadow_maps: casters.maps(),
            expected_error: None,
            left_out_share: 0.0,
        })
    }

    /// R of a pixel: irradiance that the object hides and the scene model does not. Light at infinity is taken to arrive.
    fn shadow_buffer(
        &self,
        pixel: &crate::shadow::Pixel,
        lights: &[Light],
        casters: &Casters,
        near: &[usize],
    ) -> [f32; 3] {
        let surface = Surface {
            position: pixel.position,
            normal: pixel.normal,
            face_normal: pixel.normal,
            viewer: pixel.normal,
            material: 0,
            pixel_m: pixel.reach(),
        };
        let from = pixel.position + pixel.normal * OFFSET_M;
        let gone = |i: usize, direction: Vec3| {
            let arrives = || self.settings.dome_at_infinity || !lights[i].hidden_by(&self.model, from);
            if casters.hide(i, &surface, direction) && arrives() { [1.0; 3] } else { [0.0; 3] }
        };
        gather(&surface, None, lights, near.iter().copied(), gone).irradiance
    }
}

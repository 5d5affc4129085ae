//! The object in a still: I = (d − s) + sp (supan2006, eq. 4), with d its irradiance in the empty scene, s what it hides of the
//! dome from itself, sp the environment in its mirror direction, as wide as its gloss.

use super::plate::lights_at;
use crate::render::{
    Environment, IrradianceAt, Lobe, Object, Rendered, Sample, Scene, Set, Shadowed, render_with,
};
use crate::shadow::Occluder;
use crate::subtractive::{Casters, Surface, gather};
use crate::visibility::Bvh;
use std::collections::BTreeMap;
use std::f32::consts::PI;

/// The object as the plate's camera sees it. `irradiance` is that of the empty scene, `environment` the one at the object's
/// place; the object's own shadow on the scene dims the lights that lie in it.
pub(crate) fn render_object(
    set: &Set,
    object: &Object,
    environment: &Environment,
    irradiance: &IrradianceAt,
    shadowed: &Shadowed,
) -> Rendered {
    let settings = set.settings;
    let [low, high] = object.bounds();
    let place = (low + high) / 2.0;
    let lights = lights_at(set.light, set.light_bvh, place, settings);
    let left: Vec<_> = lights.iter().map(|l| shadowed.left(place, l.seen_from(place).0)).collect();
    let occluder = Occluder { vertices: object.vertices.clone(), triangles: object.triangles.clone() };
    let casters = Casters::on_itself(&lights, &occluder, settings.shadow_map_px);
    let bvh = Bvh::new(&object.vertices, &object.triangles);
    let scene = Scene::new(object, &bvh);
    let specular = object.materials.iter().filter(|m| m.is_specular());
    let lobes: BTreeMap<u32, Lobe> =
        specular.map(|m| (m.shininess.to_bits(), Lobe::new(environment, m.shininess))).collect();
    let radiance = |sample: &Sample| -> [f32; 3] {
        let surface = Surface::of_object(sample, 0.0);
        let from = surface.position + surface.face_normal * scene.offset;
        let hidden = gather(&surface, None, &lights, 0..lights.len(), |i, direction| {
            let gone = match casters.hide(i, &surface, direction) {
                true => [1.0; 3],
                false => left[i].map(|left| 1.0 - left),
            };
            let arrives = || settings.dome_at_infinity || !lights[i].hidden_by(set.light_bvh, from);
            if gone != [0.0; 3] && arrives() { gone } else { [0.0; 3] }
        });
        let open = irradiance(sample.position, sample.normal);
        let material = &object.materials[sample.material as usize];
        let cos = -sample.view.dot(sample.normal);
        let gloss = match lobes.get(&material.shininess.to_bits()).filter(|_| material.is_specular()) {
            Some(lobe) if cos > 0.0 => lobe.reflected(sample.view + sample.normal * (2.0 * cos), cos),
            _ => [0.0; 3],
        };
        [0, 1, 2].map(|k| {
            material.diffuse[k] / PI * (open[k] - hidden.irradiance[k]).max(0.0)
                + material.specular[k] * gloss[k]
        })
    };
    render_with(&scene, set.camera, set.scene_bvh, settings.antialiasing, settings.seed, |_, samples, _| {
        let mut sum = [0.0f32; 3];
        for sample in samples {
            let radiance = radiance(sample);
            (0..3).for_each(|k| sum[k] += radiance[k] / samples.len() as f32);
        }
        sum
    })
}

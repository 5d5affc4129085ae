//! The object by subtractive shadows: unshadowed light in full detail less what it hides from itself, at the detail of
//! the shadow buffer; or, to compare, added light by light.

use super::lights::lights_at;
use super::surface::pixel_angle;
use super::{Brdf, Casters, Detail, Light, Sent, ShadowBuffer, Surface, gather};
use crate::render::{
    Environment, IrradianceAt, Lobe, Material, Object, Rendered, Sample, Scene, Set, Shadowed, render_with,
    visible,
};
use crate::shadow::Occluder;
use crate::visibility::Bvh;
use std::collections::BTreeMap;
use std::f32::consts::PI;

/// A small object's shadow buffer gets at least so many samples, if it has the pixels: as many as the paper's coarsest.
const LEAST_SAMPLES: usize = 1000;

struct Lit<'a> {
    object: &'a Object,
    scene: &'a Bvh,
    lights: Vec<Light>,
    /// Share of each light that the object's shadow on the scene leaves.
    left: Vec<[f32; 3]>,
    casters: Casters,
    /// Distance by which rays leave the object, m.
    offset: f32,
}

/// The object as the plate's camera sees it. `irradiance` is that of the empty scene, `environment` the one at the
/// object's place; the object's own shadow on the scene dims the lights that lie in it. Light that the object sends to
/// itself is estimated, not traced.
pub(crate) fn render_object(
    set: &Set,
    object: &Object,
    environment: &Environment,
    irradiance: &IrradianceAt,
    shadowed: &Shadowed,
) -> Rendered {
    let settings = set.settings;
    let detail = Detail::of(settings);
    let [low, high] = object.bounds();
    let place = (low + high) / 2.0;
    let lights = lights_at(set.light, set.light_bvh, place, detail.lights, settings);
    let occluder = Occluder { vertices: object.vertices.clone(), triangles: object.triangles.clone() };
    let bvh = Bvh::new(&object.vertices, &object.triangles);
    let scene = Scene::new(object, &bvh);
    let lit = Lit {
        object,
        scene: set.light_bvh,
        left: lights.iter().map(|l| shadowed.left(place, l.seen_from(place).0)).collect(),
        casters: Casters::on_itself(&lights, &occluder, settings.shadow_map_px),
        lights,
        offset: scene.offset,
    };
    let pixel = pixel_angle(set.camera);
    let (antialiasing, seed) = (settings.antialiasing, settings.seed);
    if settings.additive {
        let lit = Lit { lights: lit.lights.iter().map(|l| l.as_point()).collect(), ..lit };
        return render_with(&scene, set.camera, set.scene_bvh, antialiasing, seed, |_, samples, _| {
            mean(samples, |sample| lit.added(&Surface::of_object(sample, pixel)))
        });
    }
    let surfaces =
        visible(&scene, set.camera, set.scene_bvh).map(|s| s.map(|s| Surface::of_object(&s, pixel)));
    let find = |surfaces: &[Surface]| -> Vec<[f32; 7]> { surfaces.iter().map(|s| lit.hidden(s)).collect() };
    let seen = surfaces.pixels().iter().flatten().count();
    let side =
        std::iter::successors(Some(detail.side), |s| Some(s / 2)).find(|s| seen >= LEAST_SAMPLES * s * s);
    let buffer = ShadowBuffer::fill(&surfaces, side.unwrap_or(1).max(1), find);
    let lobes: BTreeMap<u32, Lobe> = object
        .materials
        .iter()
        .filter(|m| m.is_specular())
        .map(|m| (m.shininess.to_bits(), Lobe::new(environment, m.shininess)))
        .collect();
    render_with(&scene, set.camera, set.scene_bvh, antialiasing, seed, |[x, y], samples, _| {
        let centre = surfaces.at(x, y).unwrap_or_else(|| Surface::of_object(&samples[0], pixel));
        let near = buffer.at(x, y, &centre);
        mean(samples, |sample| {
            let surface = Surface::of_object(sample, pixel);
            // Where parts of the object meet in a pixel, each has a shadow of its own.
            let entry = near.filter(|_| surface.adjoins(&centre)).unwrap_or_else(|| lit.hidden(&surface));
            let [a, b, c, d, e, f, own] = entry;
            let hidden = Sent::from_array([a, b, c, d, e, f]);
            let material = &object.materials[sample.material as usize];
            let open = irradiance(sample.position, sample.normal);
            let cos = -sample.view.dot(sample.normal);
            let gloss = match lobes.get(&material.shininess.to_bits()).filter(|_| material.is_specular()) {
                Some(lobe) if cos > 0.0 => lobe.reflected(sample.view + sample.normal * (2.0 * cos), cos),
                _ => [0.0; 3],
            };
            let sent = Sent {
                irradiance: [0, 1, 2].map(|k| {
                    // One bounce: what sends it is about as hidden as what receives it.
                    let bounce = open[k].max(0.0) * material.diffuse[k] * own * (1.0 - own);
                    (open[k] - hidden.irradiance[k]).max(0.0) + bounce
                }),
                gloss: [0, 1, 2].map(|k| (gloss[k] - hidden.gloss[k]).max(0.0)),
            };
            reflected(material, &sent)
        })
    })
}

fn mean(samples: &[Sample], radiance: impl Fn(&Sample) -> [f32; 3]) -> [f32; 3] {
    let mut sum = [0.0f32; 3];
    for sample in samples {
        let radiance = radiance(sample);
        (0..3).for_each(|k| sum[k] += radiance[k] / samples.len() as f32);
    }
    sum
}

fn reflected(material: &Material, sent: &Sent) -> [f32; 3] {
    [0, 1, 2].map(|k| material.diffuse[k] / PI * sent.irradiance[k] + material.specular[k] * sent.gloss[k])
}

impl Lit<'_> {
    fn brdf(&self, surface: &Surface) -> Option<Brdf> {
        let material = &self.object.materials[surface.material as usize];
        material.is_specular().then_some(Brdf::Phong { exponent: material.shininess })
    }

    /// Whether the scene leaves a light to a surface.
    fn reaches(&self, light: usize, surface: &Surface) -> bool {
        !self.lights[light].hidden_by(self.scene, surface.position + surface.face_normal * self.offset)
    }

    /// Share of a light that the object hides from a surface, of itself or where it falls on the scene.
    fn gone(&self, light: usize, surface: &Surface, direction: glam::Vec3) -> [f32; 3] {
        match self.casters.hide(light, surface, direction) {
            true => [1.0; 3],
            false => self.left[light].map(|left| 1.0 - left),
        }
    }

    /// An entry of the shadow buffer: hidden irradiance and gloss, and the share of the surface's half space (by cosine) in
    /// which it sees the object itself.
    fn hidden(&self, surface: &Surface) -> [f32; 7] {
        let (all, mut own) = (0..self.lights.len(), 0.0);
        let hidden = gather(surface, self.brdf(surface), &self.lights, all, |i, direction| {
            let gone = self.gone(i, surface, direction);
            if gone == [1.0; 3] {
                own += surface.normal.dot(direction) * self.lights[i].solid_angle_sr / PI;
            }
            if gone != [0.0; 3] && self.reaches(i, surface) { gone } else { [0.0; 3] }
        });
        let [a, b, c, d, e, f] = hidden.to_array();
        [a, b, c, d, e, f, own.min(1.0)]
    }

    /// Additive shadows: the radiance of all lights that arrive.
    fn added(&self, surface: &Surface) -> [f32; 3] {
        let all = 0..self.lights.len();
        let sent = gather(surface, self.brdf(surface), &self.lights, all, |i, direction| {
            let gone = self.gone(i, surface, direction);
            if self.reaches(i, surface) { gone.map(|g| 1.0 - g) } else { [0.0; 3] }
        });
        reflected(&self.object.materials[surface.material as usize], &sent)
    }
}

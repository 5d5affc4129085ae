//! The object by subtractive shadows: unshadowed light in full detail less what it hides from itself, at the detail of
//! the shadow buffer; or, to compare, added light by light.

use super::plate::{hidden_share, shown};
use super::surface::pixel_angle;
use super::{Brdf, Casters, Detail, Light, Sent, ShadowBuffer, Surface, gather, sample};
use crate::render::{
    Environment, IrradianceAt, Lobe, Material, Object, Rendered, Sample, Scene, Set, Shadowed, render_with,
    visible,
};
use crate::shadow::Occluder;
use crate::visibility::Bvh;
use std::collections::BTreeMap;
use std::f32::consts::PI;

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
/// itself is left out.
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
    let sources = sample(&environment.map, detail.lights, settings.light_sampling);
    let lights: Vec<Light> =
        sources.iter().map(|s| Light::on_model(s, set.light, set.light_bvh, place)).collect();
    let occluder = Occluder { vertices: object.vertices.clone(), triangles: object.triangles.clone() };
    let bvh = Bvh::new(&object.vertices, &object.triangles);
    let scene = Scene::new(object, &bvh);
    let lit = Lit {
        object,
        scene: set.light_bvh,
        left: sources.iter().map(|s| shadowed.left(place, s.direction)).collect(),
        casters: Casters::draw(&lights, &occluder, settings.shadow_map_px),
        lights,
        offset: scene.offset,
    };
    let pixel = pixel_angle(set.camera);
    let (antialiasing, seed) = (settings.antialiasing, settings.seed);
    if settings.additive {
        return render_with(&scene, set.camera, set.scene_bvh, antialiasing, seed, |_, samples, _| {
            mean(samples, |sample| lit.added(&Surface::of_object(sample, pixel)))
        });
    }
    let surfaces =
        visible(&scene, set.camera, set.scene_bvh).map(|s| s.map(|s| Surface::of_object(&s, pixel)));
    let find = |surfaces: &[Surface]| -> Vec<[f32; 6]> { surfaces.iter().map(|s| lit.hidden(s)).collect() };
    let buffer = ShadowBuffer::fill(&surfaces, detail.side, find);
    let lobes: BTreeMap<u32, Lobe> = object
        .materials
        .iter()
        .filter(|m| m.is_specular())
        .map(|m| (m.shininess.to_bits(), Lobe::new(environment, m.shininess)))
        .collect();
    render_with(&scene, set.camera, set.scene_bvh, antialiasing, seed, |[x, y], samples, _| {
        let centre = surfaces.at(x, y).unwrap_or_else(|| Surface::of_object(&samples[0], pixel));
        let near =
            if surfaces.at(x, y).is_some() || detail.side > 1 { buffer.at(x, y, &centre) } else { None };
        let hidden = Sent::from_array(near.unwrap_or_else(|| lit.hidden(&centre)));
        mean(samples, |sample| {
            let material = &object.materials[sample.material as usize];
            let open = irradiance(sample.position, sample.normal);
            let cos = -sample.view.dot(sample.normal);
            let gloss = match lobes.get(&material.shininess.to_bits()).filter(|_| material.is_specular()) {
                Some(lobe) if cos > 0.0 => lobe.reflected(sample.view + sample.normal * (2.0 * cos), cos),
                _ => [0.0; 3],
            };
            // The buffer holds the hidden share of the irradiance, and the hidden gloss itself.
            let left = |k: usize| open[k].max(0.0) * (1.0 - hidden.irradiance[k]);
            let sent = Sent {
                irradiance: [0, 1, 2].map(left),
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

    /// An entry of the shadow buffer: share of the irradiance, and gloss.
    fn hidden(&self, surface: &Surface) -> [f32; 6] {
        let (brdf, all) = (self.brdf(surface), || 0..self.lights.len());
        let hidden = gather(surface, brdf, &self.lights, all(), |i, direction| {
            let gone = self.gone(i, surface, direction);
            if gone != [0.0; 3] && self.reaches(i, surface) { gone } else { [0.0; 3] }
        });
        if hidden == Sent::default() {
            return [0.0; 6];
        }
        let whole = gather(surface, None, &self.lights, all(), |i, _| shown(self.reaches(i, surface)));
        Sent { irradiance: hidden_share(hidden.irradiance, whole.irradiance), ..hidden }.to_array()
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

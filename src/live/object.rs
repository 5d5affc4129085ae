//! The object in a film: I = (d − s) + sp (eq. 4), with d from the irradiance map and sp from the reflective environment map
//! (§IV), s what the object itself and real things hide.

use super::shadow::Dome;
use crate::camera::Camera;
use crate::dome::CubeMap;
use crate::image::Radiance;
use crate::render::{Layer, Object, Sample, Scene, render_with};
use crate::subtractive::Surface;
use crate::visibility::Bvh;
use glam::Vec3;
use std::f32::consts::PI;

/// Sides of the irradiance map, and of the environment that it is made from, texels.
const IRRADIANCE: usize = 12;
const COARSE: usize = 8;

/// The object as a camera sees it, by `side`² rays a pixel. `environment` is that at its place.
pub(super) fn render(
    dome: &Dome,
    camera: &Camera,
    environment: &CubeMap,
    object: &Object,
    opacity: f32,
    (side, seed): (usize, u64),
) -> Layer {
    let irradiance = environment.downsampled(environment.side() / COARSE).irradiance_map(IRRADIANCE);
    let mirrored: Vec<CubeMap> = object.materials.iter().map(|m| gloss(environment, m.shininess)).collect();
    let bvh = Bvh::new(&object.vertices, &object.triangles);
    let scene = Scene::new(object, &bvh);
    let on_itself = dome.maps.on_itself();
    let may = dome.may_be_hidden(object.bounds());
    let real = &dome.phantoms.bvh;
    let radiance = |samples: &[Sample]| {
        // What is hidden changes little within a pixel.
        let middle = Surface::of_object(&samples[samples.len() / 2], 0.0);
        let from = middle.position + middle.face_normal * scene.offset;
        let hidden = |i: usize, d: Vec3| may[i] && real.any_hit(from, d, 0.0, f32::INFINITY);
        let s = on_itself.shadow_buffer(&middle, hidden);
        let mut sum = [0.0f32; 3];
        for sample in samples {
            let material = &object.materials[sample.material as usize];
            let d = irradiance.bilinear(sample.normal);
            let sp = match material.is_specular() {
                true => {
                    let mirror = sample.view - sample.normal * (2.0 * sample.view.dot(sample.normal));
                    mirrored[sample.material as usize].bilinear(mirror)
                }
                false => [0.0; 3],
            };
            for k in 0..3 {
                let diffuse = material.diffuse[k] / PI * (d[k] - s[k]).max(0.0);
                sum[k] += (diffuse + material.specular[k] * sp[k]) / samples.len() as f32;
            }
        }
        sum
    };
    let layer = render_with(&scene, camera, real, side, seed, |_, samples, _| radiance(samples)).layer;
    if opacity >= 1.0 {
        return layer;
    }
    Layer {
        colour: layer.colour.map(|c| Radiance(c.0.map(|v| v * opacity))),
        coverage: layer.coverage.map(|a| (a * opacity).min(1.0)),
        depth: layer.depth,
    }
}

/// The environment as wide as a Phong lobe: texels of the lobe's solid angle, 4π/(n + 1).
fn gloss(environment: &CubeMap, shininess: f32) -> CubeMap {
    let side = (1.5 * (shininess + 1.0)).sqrt() / 3f32.sqrt();
    let fits =
        |factor: &usize| environment.side() as f32 / *factor as f32 >= side && environment.side() > *factor;
    let factor = [1, 2, 4, 8, 16].into_iter().filter(fits).max().unwrap_or(1);
    environment.downsampled(factor)
}

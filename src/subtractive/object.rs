//! The object by subtractive shadows: unshadowed light in full detail less what it hides from itself, at the detail of
//! the shadow buffer; or, to compare, added light by light.

use super::lights::lights_at;
use super::surface::pixel_angle;
use super::{Brdf, Casters, Detail, Light, Pace, Sent, ShadowBuffer, Surface, Unshadowed, gather, sample};
use crate::camera::Camera;
use crate::config::{self, Gloss, LightSampling};
use crate::render::{
    Environment, IrradianceAt, Material, Object, Rendered, Sample, Scene, Set, Shadowed, render_with, visible,
};
use crate::shadow::Occluder;
use crate::visibility::Bvh;
use glam::Vec3;
use nalgebra::Point2;
use std::f32::consts::PI;
use std::sync::Arc;
use std::time::Instant;

/// A small object's shadow buffer gets at least so many samples, if it has the pixels: as many as the paper's coarsest.
const LEAST_SAMPLES: usize = 1000;
/// Lights that stand for the whole environment in a radiance cache.
const CACHE_LIGHTS: usize = 2000;

struct Lit<'a> {
    object: &'a Object,
    scene: &'a Bvh,
    lights: Vec<Light>,
    /// Share of each light that the object's shadow on the scene leaves.
    left: Vec<[f32; 3]>,
    casters: Casters,
    /// By material; `None` where it is matt.
    brdfs: Vec<Option<Brdf>>,
    /// Distance by which rays leave the object, m.
    offset: f32,
}

/// The object as the plate's camera sees it. `irradiance` is that of the empty scene, `environment` the one at the
/// object's place; the object's own shadow on the scene dims the lights that lie in it. Light that the object sends to
/// itself is estimated, not traced. Where the settings give a time per frame, half of it is the object's, and `pace`, what
/// earlier frames took, says how much detail fits in it.
pub(crate) fn render_object(
    set: &Set,
    object: &Object,
    environment: &Environment,
    irradiance: &IrradianceAt,
    shadowed: &Shadowed,
    pace: &mut Pace,
) -> Rendered {
    let started = Instant::now();
    let settings = set.settings;
    let bvh = Bvh::new(&object.vertices, &object.triangles);
    let scene = Scene::new(object, &bvh);
    let pixel = pixel_angle(set.camera);
    let surfaces =
        visible(&scene, set.camera, set.scene_bvh).map(|s| s.map(|s| Surface::of_object(&s, pixel)));
    let seen = surfaces.pixels().iter().flatten().count();
    let detail = detail(settings, pace, seen);
    let [low, high] = object.bounds();
    let place = (low + high) / 2.0;
    let lights = lights_at(set.light, set.light_bvh, place, detail.lights, settings);
    let occluder = Occluder { vertices: object.vertices.clone(), triangles: object.triangles.clone() };
    let before = started.elapsed().as_secs_f64();
    let lit = Lit {
        object,
        scene: set.light_bvh,
        left: lights.iter().map(|l| shadowed.left(place, l.seen_from(place).0)).collect(),
        casters: Casters::on_itself(&lights, &occluder, settings.shadow_map_px),
        lights,
        brdfs: object.materials.iter().map(|m| brdf(m, settings)).collect(),
        offset: scene.offset,
    };
    let drawn = started.elapsed().as_secs_f64();
    let (antialiasing, seed) = (settings.antialiasing, settings.seed);
    if settings.additive {
        let lit = Lit { lights: lit.lights.iter().map(|l| l.as_point()).collect(), ..lit };
        return render_with(&scene, set.camera, set.scene_bvh, antialiasing, seed, |_, samples, _| {
            mean(samples, |sample| lit.added(&Surface::of_object(sample, pixel)))
        });
    }
    let find = |surfaces: &[Surface]| -> Vec<[f32; 7]> { surfaces.iter().map(|s| lit.hidden(s)).collect() };
    let buffer = ShadowBuffer::fill(&surfaces, detail.side, find);
    let found = started.elapsed().as_secs_f64();
    let unshadowed = unshadowed(&lit.brdfs, environment, (eye(set.camera) - place).normalize_or(Vec3::Y));
    let rendered =
        render_with(&scene, set.camera, set.scene_bvh, antialiasing, seed, |[x, y], samples, _| {
            let centre = surfaces.at(x, y).unwrap_or_else(|| Surface::of_object(&samples[0], pixel));
            let near = buffer.at(x, y, &centre);
            mean(samples, |sample| {
                let surface = Surface::of_object(sample, pixel);
                // Where parts of the object meet in a pixel, each has a shadow of its own.
                let entry = near.filter(|_| surface.adjoins(&centre)).unwrap_or_else(|| lit.hidden(&surface));
                let [a, b, c, d, e, f, own] = entry;
                let hidden = Sent::from_array([a, b, c, d, e, f]);
                let number = sample.material as usize;
                let material = &object.materials[number];
                let open = irradiance(sample.position, sample.normal);
                let gloss =
                    unshadowed[number].as_ref().map_or([0.0; 3], |u| u.gloss(sample.normal, -sample.view));
                let mut sent = Sent { irradiance: open, gloss }.less(&hidden);
                let arriving = open.into_iter().zip(material.diffuse);
                for (irradiance, (open, diffuse)) in sent.irradiance.iter_mut().zip(arriving) {
                    // One bounce: what sends it is about as hidden as what receives it.
                    *irradiance += open.max(0.0) * diffuse * own * (1.0 - own);
                }
                reflected(material, lit.brdfs[number], &sent)
            })
        });
    let rest = before + started.elapsed().as_secs_f64() - found;
    pace.learn(detail, seen, [rest, drawn - before, found - drawn]);
    rendered
}

/// What the shadow on an object of so many pixels may spend.
fn detail(settings: &config::Render, pace: &Pace, seen: usize) -> Detail {
    let detail = Detail::chosen(settings, pace, seen);
    let mut sides = std::iter::successors(Some(detail.side), |s| Some(s / 2));
    let side = sides.find(|s| seen >= LEAST_SAMPLES * s * s);
    Detail { side: side.unwrap_or(1).max(1), ..detail }
}

/// How a material's gloss is reflected; `None` where it has none. The facets' reflectance at normal incidence is that of the
/// brightest channel: their Fresnel term keeps the material's colour, which real metals lose towards grazing.
fn brdf(material: &Material, settings: &config::Render) -> Option<Brdf> {
    let roughness = material.roughness.unwrap_or(settings.roughness);
    let normal_reflectance = material.specular.into_iter().fold(0.0, f32::max);
    let phong = Brdf::Phong { exponent: material.shininess };
    let ggx = Brdf::Ggx { roughness, normal_reflectance };
    let brdf = match settings.gloss {
        Gloss::ByFile => {
            if material.roughness.is_some() {
                ggx
            } else {
                phong
            }
        }
        Gloss::Phong => phong,
        Gloss::TorranceSparrow => Brdf::TorranceSparrow { roughness, normal_reflectance },
        Gloss::Ggx => ggx,
    };
    material.is_specular().then_some(brdf)
}

/// By material; one that several share is prepared once.
fn unshadowed(
    brdfs: &[Option<Brdf>],
    environment: &Environment,
    viewer: Vec3,
) -> Vec<Option<Arc<Unshadowed>>> {
    let mut made: Vec<(Brdf, Arc<Unshadowed>)> = Vec::new();
    let mut many = None;
    let mut prepare = |brdf: Brdf| {
        if let Some((_, found)) = made.iter().find(|(b, _)| *b == brdf) {
            return found.clone();
        }
        let lights: &Vec<Light> = many.get_or_insert_with(|| {
            let strata = sample(&environment.map, CACHE_LIGHTS, LightSampling::Structured);
            strata.iter().map(Light::of_stratum).collect()
        });
        let new = Arc::new(Unshadowed::new(environment, brdf, viewer, lights));
        made.push((brdf, new.clone()));
        new
    };
    brdfs.iter().map(|brdf| brdf.map(&mut prepare)).collect()
}

/// Where a camera looks from, m.
fn eye(camera: &Camera) -> Vec3 {
    let [x, y] =
        [f64::from(camera.intrinsics.width_px), f64::from(camera.intrinsics.height_px)].map(|n| n / 2.0);
    let origin = camera.ray(&Point2::new(x, y)).origin.coords;
    Vec3::new(origin.x as f32, origin.y as f32, origin.z as f32)
}

fn mean(samples: &[Sample], radiance: impl Fn(&Sample) -> [f32; 3]) -> [f32; 3] {
    let mut sum = [0.0f32; 3];
    for sample in samples {
        let radiance = radiance(sample);
        (0..3).for_each(|k| sum[k] += radiance[k] / samples.len() as f32);
    }
    sum
}

fn reflected(material: &Material, brdf: Option<Brdf>, sent: &Sent) -> [f32; 3] {
    // Facets reflect what their Fresnel term says; of that a channel has its part.
    let scale = match brdf {
        Some(Brdf::TorranceSparrow { normal_reflectance, .. } | Brdf::Ggx { normal_reflectance, .. }) => {
            1.0 / normal_reflectance
        }
        _ => 1.0,
    };
    let specular = material.specular.map(|s| s * scale);
    [0, 1, 2].map(|k| material.diffuse[k] / PI * sent.irradiance[k] + specular[k] * sent.gloss[k])
}

impl Lit<'_> {
    fn brdf(&self, surface: &Surface) -> Option<Brdf> {
        self.brdfs[surface.material as usize]
    }

    /// Whether the scene leaves a light to a surface.
    fn reaches(&self, light: usize, surface: &Surface) -> bool {
        !self.lights[light].hidden_by(self.scene, surface.position + surface.face_normal * self.offset)
    }

    /// Share of a light that the object hides from a surface, of itself or where it falls on the scene.
    fn gone(&self, light: usize, surface: &Surface, direction: Vec3) -> [f32; 3] {
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
        reflected(&self.object.materials[surface.material as usize], self.brdf(surface), &sent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_frames_lower_the_objects_detail_and_quick_ones_raise_it() {
        let settings =
            config::Render { lights: 400, pixels_per_sample: 4, frame_ms: 100.0, ..Default::default() };
        let (wanted, seen) = (Detail::of(&settings), 100_000);
        let mut pace = Pace::default();
        // What a frame takes on a machine on which a light's map and a sample cost so much, s.
        let frame = |pace: &mut Pace, [map, sample]: [f64; 2]| {
            let detail = detail(&settings, pace, seen);
            let lights = detail.lights as f64;
            let samples = seen as f64 / (detail.side * detail.side) as f64;
            let seconds = [2e-3, lights * map, lights * samples * sample];
            pace.learn(detail, seen, seconds);
            (detail, 1e3 * seconds.iter().sum::<f64>())
        };
        let quick = [1e-5, 1e-10];
        let slow = [4e-4, 4e-8];
        let settled =
            |pace: &mut Pace, cost| (0..20).map(|_| frame(pace, cost)).last().unwrap_or((wanted, 0.0));
        let (first, _) = frame(&mut pace, quick);
        assert!(
            first.lights < wanted.lights && first.side > wanted.side,
            "little is spent while costs are unknown"
        );
        assert_eq!(settled(&mut pace, quick).0, wanted);
        let (detail, ms) = settled(&mut pace, slow);
        assert!(detail.lights < wanted.lights && detail.side > wanted.side, "{detail:?}");
        // The other half is the plate's.
        assert!(ms < 50.1 && ms > 25.0, "{ms} ms of 50 for {detail:?}");
        assert_eq!(settled(&mut pace, quick).0, wanted);
    }

    #[test]
    fn a_small_object_keeps_its_samples() {
        let settings = config::Render { pixels_per_sample: 1024, ..Default::default() };
        let side = |seen| detail(&settings, &Pace::default(), seen).side;
        assert_eq!([side(2_000_000), side(20_000), side(500)], [32, 4, 1]);
    }
}

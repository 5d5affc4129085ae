//! An object under an environment, and its pictures by many lights and by few.

use crate::camera::Camera;
use crate::illuminate::distant::Stratum;
use crate::image::{Image, Radiance, RadianceImage};
use crate::render::{Environment, Object, Scene, visible};
use crate::response::Response;
use crate::shadow::Occluder;
use crate::subtractive::{Brdf, Casters, Light, Sent, ShadowBuffer, Surface, Unshadowed, gather};
use crate::visibility::Bvh;
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::PI;
use std::time::Instant;

/// The paper's picture, px.
const SIZE: [u32; 2] = [1280, 800];
/// Side of a shadow map, texels.
const MAP_PX: usize = 512;
/// Lights whose maps are held at a time; no more than bits of a mask.
const BATCH: usize = 64;

/// What the object is made of: grey.
pub struct Material {
    pub name: &'static str,
    pub brdf: Brdf,
    pub diffuse: f32,
    pub specular: f32,
    /// Whether the unshadowed gloss comes from a prefiltered lobe; else from a radiance cache.
    pub prefiltered: bool,
}

/// The paper's two, and those whose unshadowed light comes from a radiance cache, GGX also by its prefiltered lobe.
pub const MATERIALS: [Material; 5] = [
    Material {
        name: "Phong, shininess 40",
        brdf: Brdf::Phong { exponent: 40.0 },
        diffuse: 0.3,
        specular: 0.5,
        prefiltered: true,
    },
    Material {
        name: "Phong, shininess 500",
        brdf: Brdf::Phong { exponent: 500.0 },
        diffuse: 0.3,
        specular: 0.5,
        prefiltered: true,
    },
    Material {
        name: "Torrance-Sparrow 0.2",
        brdf: Brdf::TorranceSparrow { roughness: 0.2, normal_reflectance: 0.5 },
        diffuse: 0.3,
        specular: 1.0,
        prefiltered: false,
    },
    Material {
        name: "GGX 0.2",
        brdf: Brdf::Ggx { roughness: 0.2, normal_reflectance: 0.5 },
        diffuse: 0.3,
        specular: 1.0,
        prefiltered: false,
    },
    Material {
        name: "GGX 0.2, prefiltered",
        brdf: Brdf::Ggx { roughness: 0.2, normal_reflectance: 0.5 },
        diffuse: 0.3,
        specular: 1.0,
        prefiltered: true,
    },
];

/// A picture and what it took.
pub struct Shot {
    pub picture: RadianceImage,
    pub ms: f64,
}

/// The object before the camera.
pub struct Subject {
    occluder: Occluder,
    surfaces: Image<Option<Surface>>,
    /// From the object's middle.
    viewer: Vec3,
}

impl Subject {
    /// Seen from the front and a little above.
    pub fn new(object: Object) -> Self {
        let [low, high] = object.bounds();
        let centre = (low + high) / 2.0;
        let radius = low.distance(high) / 2.0;
        let viewer = Vec3::new(0.35, 0.3, 1.0).normalize();
        let eye = centre + viewer * 4.0 * radius;
        let at = |v: Vec3| v.as_dvec3().to_array();
        // The bounding sphere fills the height.
        let focal = f64::from(SIZE[1]) / 2.0 * 4.0 * 0.95;
        let camera: Camera = crate::synthetic::camera(at(eye), at(centre), SIZE[0], SIZE[1], focal);
        let bvh = Bvh::new(&object.vertices, &object.triangles);
        let nothing = Bvh::new(&[], &[]);
        let samples = visible(&Scene::new(&object, &bvh), &camera, &nothing);
        let surfaces = samples.map(|s| s.map(|s| Surface::of_object(&s, (1.0 / focal) as f32)));
        let occluder = Occluder { vertices: object.vertices.clone(), triangles: object.triangles.clone() };
        Self { occluder, surfaces, viewer }
    }

    pub fn size(&self) -> (usize, usize) {
        self.surfaces.size()
    }

    pub fn triangles(&self) -> usize {
        self.occluder.triangles.len()
    }

    /// Pixels that show the object.
    pub fn shown(&self) -> usize {
        self.surfaces.pixels().iter().flatten().count()
    }

    /// Additive pictures by many lights, one a material.
    pub fn references(&self, lights: &[Stratum]) -> Vec<RadianceImage> {
        let mut sums = vec![vec![[0.0f32; 3]; self.surfaces.pixels().len()]; MATERIALS.len()];
        for batch in lights.chunks(BATCH) {
            let (lights, casters) = self.draw(batch, Light::as_point);
            // Looked up once for all materials.
            let mask = |surface: &Option<Surface>| {
                let Some(surface) = surface else { return 0 };
                let hidden = |i: &usize| casters.hide(*i, surface, lights[*i].seen_from(surface.position).0);
                (0..lights.len()).filter(hidden).fold(0u64, |mask, i| mask | 1 << i)
            };
            let hidden: Vec<u64> = self.surfaces.pixels().par_iter().map(mask).collect();
            for (sum, material) in sums.iter_mut().zip(&MATERIALS) {
                let part = self.added(&lights, material, |pixel, i, _| hidden[pixel] >> i & 1 == 1);
                sum.iter_mut().zip(part).for_each(|(s, p)| (0..3).for_each(|k| s[k] += p[k]));
            }
        }
        sums.into_iter().map(|pixels| self.picture(pixels)).collect()
    }

    /// The picture light by light.
    pub fn additive(&self, lights: &[Stratum], material: usize) -> Shot {
        let started = Instant::now();
        let (lights, casters) = self.draw(lights, Light::as_point);
        let picture = self.added(&lights, &MATERIALS[material], |pixel, i, direction| {
            self.surfaces.pixels()[pixel].is_some_and(|surface| casters.hide(i, &surface, direction))
        });
        let picture = self.picture(picture);
        Shot { picture, ms: started.elapsed().as_secs_f64() * 1e3 }
    }

    /// What does not depend on the number of shadow-casting lights.
    pub fn unshadowed(&self, environment: &Environment, material: usize, many: &[Stratum]) -> Unshadowed {
        let Material { brdf, prefiltered, .. } = MATERIALS[material];
        match brdf {
            Brdf::Ggx { roughness, normal_reflectance } if prefiltered => {
                Unshadowed::prefiltered(environment, roughness, normal_reflectance)
            }
            _ => {
                let many: Vec<Light> = many.iter().map(|s| Light::of_stratum(s).as_point()).collect();
                Unshadowed::new(environment, brdf, self.viewer, &many)
            }
        }
    }

    /// Unshadowed light less the shadow buffer, one sample in `side`² pixels.
    pub fn subtractive(
        &self,
        lights: &[Stratum],
        unshadowed: &Unshadowed,
        material: usize,
        side: usize,
    ) -> Shot {
        let started = Instant::now();
        let material = &MATERIALS[material];
        let (lights, casters) = self.draw(lights, |light| light);
        let find = |surfaces: &[Surface]| -> Vec<[f32; 6]> {
            let hidden = |surface: &Surface| {
                let share =
                    |i, direction| if casters.hide(i, surface, direction) { [1.0; 3] } else { [0.0; 3] };
                gather(surface, Some(material.brdf), &lights, 0..lights.len(), share).to_array()
            };
            surfaces.iter().map(hidden).collect()
        };
        let buffer = ShadowBuffer::fill(&self.surfaces, side, find).resample(&self.surfaces, find);
        let shade = |(surface, hidden): (&Option<Surface>, &[f32; 6])| {
            let Some(surface) = surface else { return [0.0; 3] };
            let open = Sent {
                irradiance: unshadowed.irradiance(surface.normal),
                gloss: unshadowed.gloss(surface.normal, surface.viewer),
            };
            material.reflect(&open.less(&Sent::from_array(*hidden)))
        };
        let pixels = self.surfaces.pixels().par_iter().zip(buffer.pixels()).map(shade).collect();
        Shot { picture: self.picture(pixels), ms: started.elapsed().as_secs_f64() * 1e3 }
    }

    fn draw(&self, lights: &[Stratum], of: fn(Light) -> Light) -> (Vec<Light>, Casters) {
        let lights: Vec<Light> = lights.iter().map(|stratum| of(Light::of_stratum(stratum))).collect();
        let casters = Casters::on_itself(&lights, &self.occluder, MAP_PX);
        (lights, casters)
    }

    /// Radiance by pixel of the lights that are not hidden from a pixel, by index and direction of a light.
    fn added(
        &self,
        lights: &[Light],
        material: &Material,
        hidden: impl Fn(usize, usize, Vec3) -> bool + Sync,
    ) -> Vec<[f32; 3]> {
        let shade = |(pixel, surface): (usize, &Option<Surface>)| {
            let Some(surface) = surface else { return [0.0; 3] };
            let share = |i, direction| if hidden(pixel, i, direction) { [0.0; 3] } else { [1.0; 3] };
            material.reflect(&gather(surface, Some(material.brdf), lights, 0..lights.len(), share))
        };
        self.surfaces.pixels().par_iter().enumerate().map(shade).collect()
    }

    fn picture(&self, pixels: Vec<[f32; 3]>) -> RadianceImage {
        let (width, height) = self.size();
        Image::from_pixels(width, height, pixels.into_iter().map(Radiance).collect())
    }

    /// Factor that makes the 99th percentile of a picture's largest channel white.
    pub fn exposure(&self, picture: &RadianceImage) -> f32 {
        let largest = |i: usize| picture.pixels()[i].0.into_iter().fold(0.0, f32::max);
        let mut values: Vec<f32> = self.inside().map(largest).collect();
        values.sort_by(f32::total_cmp);
        1.0 / values.get(values.len() * 99 / 100).copied().unwrap_or(1.0).max(f32::MIN_POSITIVE)
    }

    /// rms of display values.
    pub fn error(&self, picture: &RadianceImage, reference: &RadianceImage) -> f64 {
        let (exposure, srgb) = (self.exposure(reference), Response::srgb());
        let code = |p: Radiance| srgb.code_of(p.0.map(|v| (v * exposure).clamp(0.0, 1.0)));
        let pairs = self.inside().map(|i| (code(picture.pixels()[i]), code(reference.pixels()[i])));
        let squares = pairs.flat_map(|(a, b)| (0..3).map(move |k| f64::from(a[k] - b[k]).powi(2)));
        (squares.sum::<f64>() / (3 * self.shown().max(1)) as f64).sqrt()
    }

    /// rms of radiance differences over rms of the reference.
    pub fn relative(&self, picture: &RadianceImage, reference: &RadianceImage) -> f64 {
        let (mut error, mut signal) = (0.0, 0.0);
        for i in self.inside() {
            for (a, b) in picture.pixels()[i].0.iter().zip(reference.pixels()[i].0) {
                error += f64::from(a - b).powi(2);
                signal += f64::from(b).powi(2);
            }
        }
        if signal > 0.0 { (error / signal).sqrt() } else { 0.0 }
    }

    fn inside(&self) -> impl Iterator<Item = usize> + '_ {
        self.surfaces.pixels().iter().enumerate().filter(|(_, s)| s.is_some()).map(|(i, _)| i)
    }

    /// The object's box in the picture: left, top, right, bottom, px.
    pub fn window(&self) -> [usize; 4] {
        let width = self.size().0;
        self.inside().fold([usize::MAX, usize::MAX, 0, 0], |[a, b, c, d], i| {
            let (x, y) = (i % width, i / width);
            [a.min(x), b.min(y), c.max(x + 1), d.max(y + 1)]
        })
    }
}

impl Material {
    fn reflect(&self, sent: &Sent) -> [f32; 3] {
        [0, 1, 2].map(|k| self.diffuse / PI * sent.irradiance[k] + self.specular * sent.gloss[k])
    }
}

//! Light reflected by the object towards the camera.
//!
//! Diffuse: ρ/π E. The irradiance volume gives E without the object; what the object hides from itself is found with
//! rays in directions drawn from the environment at its place: E = E_volume · Σ visible / Σ all + E_bounce, so that an
//! unoccluded point has just the volume's irradiance. E_bounce is the light of the object's own surfaces, one bounce.

use super::cells::Cells;
use super::environment::Environment;
use super::object::Object;
use super::phong::Lobe;
use crate::camera::Camera;
use crate::image::RadianceImage;
use crate::visibility::Bvh;
use glam::Vec3;
use nalgebra::Point3;
use rand::rngs::SmallRng;
use std::collections::BTreeMap;
use std::f32::consts::PI;

/// Irradiance of the empty scene at a position (m) on a surface of unit normal, plate units.
pub type IrradianceAt<'a> = dyn Fn(Vec3, Vec3) -> [f32; 3] + Sync + 'a;

/// What lights the object.
pub struct Lighting<'a> {
    irradiance: &'a IrradianceAt<'a>,
    cells: Cells,
    lobes: BTreeMap<u32, Lobe>,
    shadowed: Option<&'a Shadowed<'a>>,
}

/// The object's own shadow on the scene, as the plate shows it: surfaces in it light the object less.
pub struct Shadowed<'a> {
    /// Camera of the plate.
    pub camera: &'a Camera,
    /// Radiance of the empty scene.
    pub plate: &'a RadianceImage,
    /// Radiance that the object removes from it.
    pub removed: &'a RadianceImage,
    /// Triangles of the scene model.
    pub scene: &'a Bvh,
}

/// A point of the object that the camera sees.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    pub position: Vec3,
    /// Shading normal, on the camera's side.
    pub normal: Vec3,
    /// Normal of the triangle, on the camera's side.
    pub face_normal: Vec3,
    /// Unit vector from the camera.
    pub view: Vec3,
    /// Index of the material.
    pub material: u32,
    /// Depth along the viewing axis, m.
    pub depth: f32,
}

impl<'a> Lighting<'a> {
    /// Prepares `cells` directions and the lobes of all materials.
    pub fn new(
        irradiance: &'a IrradianceAt<'a>,
        environment: &Environment,
        object: &Object,
        cells: usize,
        shadowed: Option<&'a Shadowed<'a>>,
    ) -> Self {
        let lobes = object
            .materials
            .iter()
            .filter(|m| m.is_specular())
            .map(|m| m.shininess)
            .map(|n| (n.to_bits(), n))
            .collect::<BTreeMap<_, _>>()
            .into_iter()
            .map(|(bits, n)| (bits, Lobe::new(environment, n)))
            .collect();
        Self { irradiance, cells: Cells::new(environment, cells.max(1)), lobes, shadowed }
    }
}

impl Shadowed<'_> {
    /// Share of the scene's radiance along a ray that the object's shadow leaves; 1 where the plate does not show it.
    pub(crate) fn left(&self, origin: Vec3, direction: Vec3) -> [f32; 3] {
        let Some(hit) = self.scene.closest(origin, direction, 0.0, f32::INFINITY) else { return [1.0; 3] };
        let p = origin + direction * hit.t;
        let Some(pixel) = self.camera.project(&Point3::from(p.as_dvec3().to_array())) else {
            return [1.0; 3];
        };
        let (w, h) = self.plate.size();
        if !(0.0..w as f64).contains(&pixel.x) || !(0.0..h as f64).contains(&pixel.y) {
            return [1.0; 3];
        }
        let centre = self.camera.centre();
        let eye = Vec3::new(centre.x as f32, centre.y as f32, centre.z as f32);
        if self.scene.any_hit(eye, p - eye, 1e-4, 1.0 - 1e-3) {
            return [1.0; 3];
        }
        let (x, y) = (pixel.x as usize, pixel.y as usize);
        let (b, e) = (self.plate.at(x, y).0, self.removed.at(x, y).0);
        std::array::from_fn(|k| if b[k] > 0.0 { (1.0 - e[k] / b[k]).clamp(0.0, 1.0) } else { 1.0 })
    }
}

/// The object, ready for rays.
pub(crate) struct Scene<'a> {
    pub object: &'a Object,
    pub bvh: &'a Bvh,
    /// Distance by which rays leave a surface, m.
    pub offset: f32,
}

impl Sample {
    /// A point of the surface that no camera looks at.
    pub fn of_surface(position: Vec3, normal: Vec3) -> Self {
        Self { position, normal, face_normal: normal, view: -normal, material: 0, depth: 0.0 }
    }
}

impl<'a> Scene<'a> {
    /// An object with its hierarchy.
    pub fn new(object: &'a Object, bvh: &'a Bvh) -> Self {
        let [low, high] = object.bounds();
        Self { object, bvh, offset: (high - low).length() * 1e-4 }
    }

    /// Shading and face normal of a triangle at barycentric weights, on the side of `-direction`.
    pub fn normals(&self, triangle: u32, weights: [f32; 3], direction: Vec3) -> (Vec3, Vec3) {
        let [a, b, c] = self.object.corners(triangle as usize);
        let face = (b - a).cross(c - a).normalize_or_zero();
        let corners = self.object.triangles[triangle as usize];
        let smooth: Vec3 = (0..3).map(|k| self.object.normals[corners[k] as usize] * weights[k]).sum();
        let side = if face.dot(direction) > 0.0 { -1.0 } else { 1.0 };
        (smooth.try_normalize().unwrap_or(face) * side, face * side)
    }

    /// Diffuse radiance of the object's own surface along a ray, without self-occlusion; `None` where it is missed.
    fn own_radiance(&self, lighting: &Lighting, origin: Vec3, direction: Vec3) -> Option<[f32; 3]> {
        let hit = self.bvh.closest(origin, direction, 0.0, f32::INFINITY)?;
        let position = origin + direction * hit.t;
        let (normal, _) = self.normals(hit.triangle, hit.barycentric, direction);
        let irradiance = (lighting.irradiance)(position, normal);
        let diffuse = self.object.materials[self.object.material_of[hit.triangle as usize] as usize].diffuse;
        Some(std::array::from_fn(|k| diffuse[k] / PI * irradiance[k].max(0.0)))
    }
}

/// Share of the environment that a pixel's samples see, and the irradiance that the object itself sends to them.
struct Gathered {
    visible: [f32; 3],
    bounce: [f32; 3],
}

/// The pixel's samples take turns: each direction is drawn once for the whole pixel.
fn gather(scene: &Scene, lighting: &Lighting, samples: &[Sample], rng: &mut SmallRng) -> Gathered {
    let (mut all, mut visible, mut bounce) = ([0.0f32; 3], [0.0f32; 3], [0.0f32; 3]);
    for (j, draw) in lighting.cells.draw(rng).enumerate() {
        let sample = &samples[j % samples.len()];
        let cos = sample.normal.dot(draw.direction);
        // Below the triangle's own plane a smooth normal asks for light that a flat face cannot get.
        if cos <= 0.0 || sample.face_normal.dot(draw.direction) <= 0.0 {
            continue;
        }
        let origin = sample.position + sample.face_normal * scene.offset;
        let weight = draw.weight * cos;
        let own = scene.own_radiance(lighting, origin, draw.direction);
        let left = match (own, lighting.shadowed) {
            (Some(_), _) => [0.0; 3],
            (None, Some(shadowed)) => shadowed.left(origin, draw.direction),
            (None, None) => [1.0; 3],
        };
        for k in 0..3 {
            all[k] += weight * draw.radiance[k];
            visible[k] += weight * draw.radiance[k] * left[k];
            bounce[k] += weight * own.map_or(0.0, |o| o[k]);
        }
    }
    let visible: [f32; 3] = std::array::from_fn(|k| if all[k] > 0.0 { visible[k] / all[k] } else { 1.0 });
    // What sends the bounce is about as occluded as what receives it.
    Gathered { visible, bounce: std::array::from_fn(|k| bounce[k] * visible[k]) }
}

impl Gathered {
    /// Irradiance of a point with these surroundings.
    fn irradiance(&self, lighting: &Lighting, sample: &Sample) -> [f32; 3] {
        let open = (lighting.irradiance)(sample.position, sample.normal);
        std::array::from_fn(|k| open[k].max(0.0) * self.visible[k] + self.bounce[k])
    }
}

/// Irradiance of a point of the object, what the object hides from it and sends to it counted, plate units.
pub(super) fn irradiance(
    scene: &Scene,
    lighting: &Lighting,
    sample: &Sample,
    rng: &mut SmallRng,
) -> [f32; 3] {
    gather(scene, lighting, std::slice::from_ref(sample), rng).irradiance(lighting, sample)
}

/// Mean radiance that the camera gets from a pixel's samples, plate units.
pub(super) fn shade(scene: &Scene, lighting: &Lighting, samples: &[Sample], rng: &mut SmallRng) -> [f32; 3] {
    let gathered = gather(scene, lighting, samples, rng);
    let mut sum = [0.0f32; 3];
    for sample in samples {
        let material = &scene.object.materials[sample.material as usize];
        let irradiance = gathered.irradiance(lighting, sample);
        (0..3).for_each(|k| sum[k] += material.diffuse[k] / PI * irradiance[k]);
        if let Some(lobe) =
            lighting.lobes.get(&material.shininess.to_bits()).filter(|_| material.is_specular())
        {
            let reflected = specular(scene, lighting, lobe, sample);
            (0..3).for_each(|k| sum[k] += material.specular[k] * reflected[k]);
        }
    }
    sum.map(|v| v / samples.len() as f32)
}

/// The lobe about the mirror direction; one ray tells whether the object itself or its shadow lies there.
fn specular(scene: &Scene, lighting: &Lighting, lobe: &Lobe, sample: &Sample) -> [f32; 3] {
    let cos = -sample.view.dot(sample.normal);
    if cos <= 0.0 {
        return [0.0; 3];
    }
    let axis = (sample.view + sample.normal * (2.0 * cos)).normalize();
    let origin = sample.position + sample.face_normal * scene.offset;
    if sample.face_normal.dot(axis) > 0.0
        && let Some(own) = scene.own_radiance(lighting, origin, axis)
    {
        return own.map(|v| v * lobe.albedo(cos));
    }
    let left = lighting.shadowed.map_or([1.0; 3], |s| s.left(origin, axis));
    let reflected = lobe.reflected(axis, cos);
    std::array::from_fn(|k| reflected[k] * left[k])
}

//! Lamps, windows and the sun: where the ball's picture and the light model show them, against the true environment.

use super::Judged;
use crate::error::{Context as _, Result};
use crate::illuminate::mesh::{FaceMesh, assemble};
use crate::image::{Radiance, RadianceImage, luminance};
use crate::probe::Environment;
use crate::render;
use crate::visibility::Bvh;
use glam::{DVec3, Vec3};
use std::collections::BTreeMap;

/// The probe blurs a lamp over its surroundings: its light is looked for within this angle of it, rad …
const REACH: f32 = 0.05;
/// … and what lies in a ring of that width around stands for what is not the lamp's.
const RING: f32 = 0.035;
/// Something must be so many times as bright as its surroundings to have a centroid.
const CONTRAST: f64 = 2.0;
/// The sun is brighter than this share of the brightest texel, and within this angle of it, rad.
const SUN: (f32, f32) = (0.05, 0.087);

/// How one lamp is seen.
pub(super) struct Lamp {
    pub name: String,
    /// Shift of its centroid in the ball's picture and in the light model, degrees.
    pub shift_deg: [f64; 2],
    /// Its light, above its surroundings, over the true one: in the ball's picture and in the light model.
    pub power: [f64; 2],
}

/// All emitters that stand out.
pub(super) fn judge(judged: &Judged) -> Result<Vec<Lamp>> {
    let environment = &judged.environment;
    let centre = environment.origin[0];
    let meshes: Vec<_> = judged.scene.faces.iter().map(FaceMesh::new).collect();
    let mesh = assemble(&meshes);
    let bvh = Bvh::new(&mesh.vertices, &mesh.triangles());
    let emitters = judged.truth.emitters().doing("reading the lamps of the truth")?;
    let mut regions: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    let (w, h) = environment.size();
    let texels = w * h;
    let mut open = Vec::new();
    for i in 0..texels {
        match bvh.closest(centre, environment.direction(i), 0.0, f32::MAX) {
            None => open.push(i),
            Some(hit) => {
                let face = &judged.scene.faces[mesh.patches[hit.triangle as usize].face as usize].name;
                let name = face.split('.').next().unwrap_or(face);
                if emitters.contains_key(name) {
                    regions.entry(name.into()).or_default().push(i);
                }
            }
        }
    }
    let bright = |i: usize| luminance(environment.radiance.pixels()[i].0);
    if let Some(top) = open.iter().copied().max_by(|a, b| bright(*a).total_cmp(&bright(*b))) {
        let middle = environment.direction(top);
        open.retain(|i| {
            bright(*i) > SUN.0 * bright(top) && environment.direction(*i).angle_between(middle) < SUN.1
        });
        regions.insert("sun".into(), open);
    }
    let in_ball = seen_from(&judged.seen, &judged.light_bvh, environment);
    let in_model = render::Environment::cast(&judged.light, &judged.light_bvh, centre, w, h).map;
    let lamp = |(name, region): (String, Vec<usize>)| {
        let around = Around::new(environment, &region);
        let (middle, truth) = around.centroid(environment, &environment.radiance)?;
        let mut lamp = Lamp { name, shift_deg: [180.0; 2], power: [0.0; 2] };
        for (k, map) in [&in_ball, &in_model].into_iter().enumerate() {
            if let Some((at, power)) = around.centroid(environment, map) {
                lamp.shift_deg[k] = at.angle_between(middle).to_degrees();
                lamp.power[k] = power / truth;
            }
        }
        Some(lamp)
    };
    Ok(regions.into_iter().filter_map(lamp).collect())
}

/// What the ball shows, as seen from the centre of another environment of the same scene.
fn seen_from(seen: &Environment, scene: &Bvh, from: &Environment) -> RadianceImage {
    let (w, h) = from.size();
    crate::image::Image::from_fn(w, h, |x, y| {
        let direction = from.direction(y * w + x);
        let centre = from.origin[0];
        let texel = match scene.closest(centre, direction, 0.0, f32::MAX) {
            Some(hit) => seen.texel_towards(centre + direction * hit.t),
            None => seen.texel(direction),
        };
        if seen.weight[texel] > 0.0 { seen.radiance.pixels()[texel] } else { Radiance::default() }
    })
}

/// Texels of a lamp with what the probe blurs over, and those of the ring around.
struct Around {
    lamp: Vec<usize>,
    ring: Vec<usize>,
}

impl Around {
    fn new(environment: &Environment, region: &[usize]) -> Self {
        let (w, h) = environment.size();
        let directions: Vec<Vec3> = region.iter().map(|i| environment.direction(*i)).collect();
        let sum = directions.iter().sum::<Vec3>().normalize_or(Vec3::Y);
        let radius = directions.iter().map(|d| d.angle_between(sum)).fold(0.0, f32::max);
        let (mut lamp, mut ring) = (Vec::new(), Vec::new());
        for i in 0..w * h {
            let d = environment.direction(i);
            if d.angle_between(sum) > radius + REACH + RING {
                continue;
            }
            let distance = directions.iter().map(|r| d.distance_squared(*r)).fold(f32::MAX, f32::min).sqrt();
            if distance < REACH {
                lamp.push(i);
            } else if distance < REACH + RING {
                ring.push(i);
            }
        }
        Self { lamp, ring }
    }

    /// Centroid and power of what is brighter than the ring, if it is much brighter.
    fn centroid(&self, environment: &Environment, map: &RadianceImage) -> Option<(DVec3, f64)> {
        let light = |i: &usize| f64::from(map.pixels()[*i].luminance()) * environment.solid_angle(*i);
        let angle = |i: &usize| environment.solid_angle(*i);
        let ring = self.ring.iter().map(light).sum::<f64>() / self.ring.iter().map(angle).sum::<f64>();
        let all: f64 = self.lamp.iter().map(light).sum();
        let back = ring * self.lamp.iter().map(angle).sum::<f64>();
        if !ring.is_finite() || all < CONTRAST * back {
            return None;
        }
        let excess = |i: &usize| (light(i) - ring * angle(i)).max(0.0);
        let moment: DVec3 = self.lamp.iter().map(|i| environment.direction(*i).as_dvec3() * excess(i)).sum();
        Some((moment.normalize_or_zero(), all - back))
    }
}

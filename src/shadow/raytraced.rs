//! The reference: stratified rays from all over every pixel.
//!
//! ε = B · E_blocked / E, with E_blocked = Σ_j L_j ∫ V_scene (1 − V_object) cos θ cos θ′ / r² dA over the sources that
//! the object's bounding sphere can hide from the pixel at all, and E the same integral without the object, from the same
//! samples, plus the interpolated irradiance of all other light. Neither the interpolation of the blocked transfers
//! between vertices nor their traversal, clusters or shadow maps enter; the transfers say only where samples are worth
//! taking.

use super::tiles::{Pixel, Prepared, Tile};
use super::{Bounds, Occluder, Problem, Removed, Scene};
use crate::config::Render;
use crate::illuminate::patch::Patch;
use crate::image::{Radiance, RadianceImage, luminance};
use crate::transfer::sampling::{Shift, in_cap, on_triangle};
use crate::transfer::{Finish, Lobe, SourceKind, Transfers};
use crate::visibility::Bvh;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// Samples leave a receiver by this much, m.
const OFFSET_M: f32 = 1e-4;
const BEYOND_M: f32 = 1e5;

struct Tracer<'a> {
    lights: Vec<Light>,
    transfers: &'a Transfers,
    patches: &'a [Patch],
    finish: Option<Finish<'a>>,
    scene: Bvh,
    object: Bvh,
    bounds: Bounds,
    settings: &'a Render,
}

/// What a tile's pixels may lose.
struct Lit<'a> {
    tile: &'a Tile,
    /// Sources that the object may hide from some of the pixels, ascending.
    sources: Vec<u32>,
    /// Irradiance from them at each of the tile's vertices, plate units.
    irradiance: Vec<Vec<[f32; 3]>>,
}

enum Shape {
    Patch { corners: [Vec3; 3], normal: Vec3, area: f32, centroid: Vec3, radius: f32 },
    Distant { direction: Vec3, solid_angle: f32, angular_radius: f32 },
}

struct Light {
    shape: Shape,
    radiance: [f32; 3],
}

/// One sample: its irradiance per channel, the segment to test, whether the object blocks it.
#[derive(Clone, Copy, Default)]
struct Sample {
    irradiance: [f32; 3],
    from: Vec3,
    target: Vec3,
    distant: bool,
    blocked: bool,
}

impl Sample {
    /// Adds what the receiver mirrors of it.
    fn mirror(&mut self, lobe: &Lobe) {
        let direction =
            if self.distant { self.target } else { (self.target - self.from).normalize_or_zero() };
        let weight = lobe.weight(direction);
        (0..3).for_each(|c| self.irradiance[c] *= weight[c]);
    }
}

/// ε by rays; the same for any number of threads, seeded by the settings.
pub fn raytraced(scene: &Scene, occluder: &Occluder, settings: &Render) -> Result<Removed, Problem> {
    occluder.check()?;
    if settings.rays < 2 {
        let value = settings.rays.to_string();
        return Err(Problem::Setting { name: "rays", value, range: "2 or more" });
    }
    let prepared = Prepared::registered(scene, settings)?;
    let tracer = Tracer::new(scene, occluder, settings);
    let found: Vec<[Radiance; 2]> = prepared
        .tiles
        .par_iter()
        .flat_map_iter(|tile| {
            let lit = tracer.lit(tile);
            let mut buffers = (Vec::new(), Vec::new());
            let halves = |pixel: &Pixel| {
                tracer.halves(pixel, &lit, scene.plate.pixels()[pixel.index as usize], &mut buffers)
            };
            prepared.pixels[tile.pixels.clone()].iter().map(halves).collect::<Vec<_>>()
        })
        .collect();
    let (width, height) = scene.plate.size();
    let mut epsilon = vec![Radiance::default(); width * height];
    let (mut error, mut signal) = (0.0, 0.0);
    for (pixel, [a, b]) in prepared.pixels.iter().zip(&found) {
        let index = pixel.index as usize;
        let mean = std::array::from_fn(|c| (a.0[c] + b.0[c]) / 2.0);
        epsilon[index] = Radiance(mean);
        if luminance(mean) > 0.02 * scene.plate.pixels()[index].luminance() {
            for (c, m) in mean.iter().enumerate() {
                error += f64::from((a.0[c] - b.0[c]) / 2.0).powi(2);
                signal += f64::from(*m).powi(2);
            }
        }
    }
    Ok(Removed {
        epsilon: RadianceImage::from_pixels(width, height, epsilon),
        codes: None,
        noise: Some(if signal > 0.0 { (error / signal).sqrt() } else { 0.0 }),
        sources_used: scene.transfers.sources.len(),
        passes: 0,
        shadow_maps: 0,
        expected_error: None,
        left_out_share: scene.transfers.left_out_share,
    })
}

impl<'a> Tracer<'a> {
    fn new(scene: &Scene<'a>, occluder: &Occluder, settings: &'a Render) -> Self {
        let mesh = &scene.light.mesh;
        let sources = &scene.transfers.sources;
        let shape = |kind| match kind {
            SourceKind::Patch(i) => {
                let i = i as usize;
                let (corners, centroid) = (mesh.corners(i), mesh.centroid(i));
                let radius = corners.iter().map(|c| c.distance(centroid)).fold(0.0, f32::max);
                Shape::Patch { corners, normal: mesh.normal(i), area: mesh.area(i), centroid, radius }
            }
            SourceKind::Distant(i) => {
                let d = &scene.light.distant[i as usize];
                let angular_radius = d.angular_radius();
                Shape::Distant { direction: d.direction, solid_angle: d.solid_angle_sr, angular_radius }
            }
        };
        let lights: Vec<Light> = sources
            .iter()
            .map(|s| Light { shape: shape(s.kind), radiance: s.radiance(scene.light) })
            .collect();
        Self {
            lights,
            transfers: scene.transfers,
            patches: &mesh.patches,
            finish: scene.finish,
            scene: Bvh::new(&mesh.vertices, &mesh.triangles()),
            object: Bvh::new(&occluder.vertices, &occluder.triangles),
            bounds: Bounds::of(occluder),
            settings,
        }
    }

    /// The light of a tile that the object may take.
    fn lit<'t>(&self, tile: &'t Tile) -> Lit<'t> {
        let mut all = vec![[0.0; 3]; self.lights.len()];
        let near = |j: &u32| self.can_hide(&self.lights[*j as usize], tile.centre, tile.radius);
        let sources: Vec<u32> = (0..self.lights.len() as u32).filter(near).collect();
        let mut irradiance = Vec::with_capacity(tile.vertices.len());
        if !sources.is_empty() {
            for &vertex in &tile.vertices {
                self.transfers.expand(vertex, &mut all);
                irradiance.push(sources.iter().map(|&j| all[j as usize]).collect());
            }
        }
        Lit { tile, sources, irradiance }
    }

    /// ε from the even and from the odd samples: two independent-enough answers whose difference tells the noise.
    fn halves(
        &self,
        pixel: &Pixel,
        lit: &Lit,
        plate: Radiance,
        (weights, samples): &mut (Vec<f32>, Vec<Sample>),
    ) -> [Radiance; 2] {
        let lobe = self
            .finish
            .and_then(|f| f.lobe(&self.patches[pixel.patch as usize], pixel.position, pixel.normal));
        let (total, rest) = self.pixel_weights(pixel, lit, weights);
        if total <= 0.0 {
            return [Radiance::default(); 2];
        }
        self.draw(pixel, lit, weights, total, samples);
        if let Some(lobe) = &lobe {
            samples.iter_mut().for_each(|s| s.mirror(lobe));
        }
        if !samples.iter().any(|s| s.blocked) {
            return [Radiance::default(); 2];
        }
        let (mut all, mut blocked) = ([[0.0f64; 3]; 2], [[0.0f64; 3]; 2]);
        for (i, sample) in samples.iter().enumerate() {
            let lit = Sample { from: sample.from + pixel.lit_from, ..*sample };
            if sample.irradiance == [0.0; 3] || hidden(&self.scene, &lit) {
                continue;
            }
            for c in 0..3 {
                all[i % 2][c] += f64::from(sample.irradiance[c]);
                blocked[i % 2][c] += if sample.blocked { f64::from(sample.irradiance[c]) } else { 0.0 };
            }
        }
        // E from all samples, so that both halves divide by the same number.
        [0, 1].map(|half| {
            Radiance(std::array::from_fn(|c| {
                let whole = all[0][c] + all[1][c] + rest[c];
                let share = if whole > 0.0 { (2.0 * blocked[half][c] / whole).min(1.0) } else { 0.0 };
                plate.0[c].max(0.0) * share as f32
            }))
        })
    }

    /// What each source that the object could hide sends to the pixel by the interpolated transfers; gives their sum
    /// (luminance) and the irradiance from all other light.
    fn pixel_weights(&self, pixel: &Pixel, lit: &Lit, weights: &mut Vec<f32>) -> (f64, [f64; 3]) {
        weights.clear();
        let (mut total, mut rest) = (0.0, pixel.irradiance.map(f64::from));
        if lit.sources.is_empty() {
            return (total, rest);
        }
        let corner = |v: u32| &lit.irradiance[lit.tile.vertices.partition_point(|&w| w < v)];
        let corners = pixel.vertices.map(corner);
        for (i, &j) in lit.sources.iter().enumerate() {
            let mut sent = [0.0; 3];
            for (corner, w) in corners.iter().zip(pixel.weights) {
                (0..3).for_each(|k| sent[k] += corner[i][k] * w.max(0.0));
            }
            let mut weight = luminance(sent);
            if weight > 0.0 && !self.can_hide(&self.lights[j as usize], pixel.position, pixel.reach()) {
                weight = 0.0;
            }
            if weight > 0.0 {
                total += f64::from(weight);
                (0..3).for_each(|k| rest[k] -= f64::from(sent[k]));
            }
            weights.push(weight);
        }
        (total, rest.map(|c| c.max(0.0)))
    }

    /// Whether the bounding spheres of object and source may overlap as seen from within a sphere around `x`.
    fn can_hide(&self, light: &Light, x: Vec3, reach: f32) -> bool {
        let cap = |v: Vec3, radius: f32| {
            let distance = v.length();
            (v / distance, (radius / distance).min(1.0), distance > radius)
        };
        let (object, sine, outside) = cap(self.bounds.centre - x, self.bounds.radius + reach);
        let (source, sine_source, outside_source) = match &light.shape {
            Shape::Patch { centroid, radius, .. } => cap(*centroid - x, *radius + reach),
            Shape::Distant { direction, angular_radius, .. } => {
                (*direction, angular_radius.sin(), *angular_radius < std::f32::consts::FRAC_PI_2)
            }
        };
        let cosine = |sine: f32| (1.0 - sine * sine).sqrt();
        let (p, q) = (cosine(sine), cosine(sine_source));
        !outside || !outside_source || object.dot(source) >= p * q - sine * sine_source - 1e-4
    }

    /// Samples in proportion to the weights, stratified over their cumulative sum.
    fn draw(&self, pixel: &Pixel, lit: &Lit, weights: &[f32], total: f64, samples: &mut Vec<Sample>) {
        let n = self.settings.rays;
        let shift = Shift::new(self.settings.seed, u64::from(pixel.index));
        let within = Shift::new(!self.settings.seed, u64::from(pixel.index));
        samples.clear();
        let (mut j, mut below) = (0, 0.0);
        for i in 0..n as u32 {
            let at = (f64::from(i) + f64::from(shift.jitter(i))) / n as f64 * total;
            while at >= below + f64::from(weights[j]) && j + 1 < weights.len() {
                below += f64::from(weights[j]);
                j += 1;
            }
            let offset = Vec2::new(within.jitter(2 * i), within.jitter(2 * i + 1)) - 0.5;
            let from = pixel.at(offset) + pixel.normal * OFFSET_M;
            let density = f64::from(weights[j]) / total * n as f64;
            let source = lit.sources[j] as usize;
            let sample =
                if density > 0.0 { self.sample(pixel, from, source, shift, i, density) } else { None };
            samples.push(sample.unwrap_or_default());
        }
    }

    fn sample(
        &self,
        pixel: &Pixel,
        from: Vec3,
        j: usize,
        shift: Shift,
        i: u32,
        density: f64,
    ) -> Option<Sample> {
        let light = &self.lights[j];
        let u = shift.point(i);
        let (kernel, target, distant) = match &light.shape {
            Shape::Patch { corners, normal, area, .. } => {
                let y = on_triangle(*corners, u);
                let w = y - from;
                let (cosine, cosine_source) = (w.dot(pixel.normal), -w.dot(*normal));
                if cosine <= 0.0 || cosine_source <= 0.0 {
                    return None;
                }
                (cosine * cosine_source / w.length_squared().powi(2) * area, y + normal * OFFSET_M, false)
            }
            Shape::Distant { direction, solid_angle, angular_radius } => {
                let w = in_cap(*direction, *angular_radius, u);
                (solid_angle * w.dot(pixel.normal).max(0.0), w, true)
            }
        };
        let irradiance = light.radiance.map(|c| (f64::from(c) * f64::from(kernel) / density) as f32);
        let mut sample = Sample { irradiance, from, target, distant, blocked: false };
        sample.blocked = self.near_object(&sample) && hidden(&self.object, &sample);
        Some(sample)
    }

    /// Whether the segment passes the object's bounding sphere.
    fn near_object(&self, sample: &Sample) -> bool {
        let from = sample.from;
        let (v, to) =
            (if sample.distant { sample.target } else { sample.target - from }, self.bounds.centre - from);
        let along = to.dot(v) / v.length_squared();
        let nearest = v * if sample.distant { along.max(0.0) } else { along.clamp(0.0, 1.0) };
        nearest.distance_squared(to) <= self.bounds.radius * self.bounds.radius
    }
}

fn hidden(bvh: &Bvh, sample: &Sample) -> bool {
    if sample.distant {
        bvh.any_hit(sample.from, sample.target, 0.0, BEYOND_M)
    } else {
        bvh.occluded(sample.from, sample.target)
    }
}

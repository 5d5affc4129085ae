//! Whether the light model explains the pictures that it was made from: the plate and the probe's picture predicted from it.
//!
//! The plate's radiance cannot be its own witness: each patch's reflectance was made to fit it. The plate is predicted with one
//! reflectance for each face instead, the median of its patches, so that what departs is light that the model has in the wrong
//! place (a shadow that it lacks, a lamp too faint on one side) or texture, and texture has no mean.

use super::build::{Plate, shines};
use super::patch::{Evidence, LightModel, PatchMesh};
use crate::image::{Image, Radiance, RadianceImage, luminance};
use crate::probe::{Environment, latlong};
use crate::visibility::Bvh;
use glam::Vec3;
use nalgebra::Point2;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f32::consts::PI;

/// Texels that the probe shows this well are compared.
const SURE: f32 = 0.95;
/// Residuals are no larger than this, stops.
const MOST_STOPS: f32 = 10.0;

/// Predictions and what the pictures have above them.
pub struct Check {
    /// The plate as the model explains it, plate units.
    pub plate: RadianceImage,
    /// Plate over prediction by luminance, stops; 0 where nothing is predicted.
    pub plate_residual: Image<f32>,
    /// The environment as seen from where the probe's rays start.
    pub probe: RadianceImage,
    /// Probe over prediction by luminance, stops; 0 where the probe does not see well.
    pub probe_residual: Image<f32>,
    /// Figures by name.
    pub figures: Vec<(&'static str, f64)>,
    /// The face whose patches depart most, by their mean, and by how many stops.
    pub worst_face: Option<(u32, f64)>,
}

/// Predicts both; `irradiance` is that of each patch.
pub fn check(
    light: &LightModel,
    irradiance: &[[f32; 3]],
    env: &Environment,
    distant: &RadianceImage,
    plate: Option<&Plate>,
) -> Check {
    let mesh = &light.mesh;
    let bvh = Bvh::new(&mesh.vertices, &mesh.triangles());
    let reflectance = by_face(light, irradiance);
    let lit = |i: usize, irradiance: [f32; 3]| -> Option<[f32; 3]> {
        let rho = reflectance.get(&mesh.patches[i].face)?;
        Some(std::array::from_fn(|k| rho[k] * irradiance[k] / PI))
    };
    let predicted = |i: usize| match shines(mesh.patches[i].radiance, irradiance[i]) {
        true => Some(mesh.patches[i].radiance),
        false => lit(i, irradiance[i]),
    };
    // Between the patches' middles, so that what the map shows is no mesh.
    let at_vertices = at_vertices(mesh, irradiance);
    let within = |i: usize, weights: [f32; 3]| match shines(mesh.patches[i].radiance, irradiance[i]) {
        true => Some(mesh.patches[i].radiance),
        false => {
            let corners = mesh.patches[i].vertices.map(|v| at_vertices[v as usize]);
            lit(i, std::array::from_fn(|k| (0..3).map(|c| weights[c] * corners[c][k]).sum()))
        }
    };
    let (picture, plate_residual) = match plate {
        Some(plate) => plate_picture(plate, mesh, &bvh, within),
        None => (Image::from_fn(0, 0, |_, _| Radiance::default()), Image::from_fn(0, 0, |_, _| 0.0)),
    };
    let (probe, probe_residual) = probe_picture(light, env, distant, &bvh);
    let mut figures = Vec::new();
    // By patch, so that texture averages out.
    let mut departures: Vec<Weighed> = (0..mesh.patches.len())
        .filter(|&i| {
            mesh.patches[i].evidence == Evidence::Plate && !shines(mesh.patches[i].radiance, irradiance[i])
        })
        .filter_map(|i| {
            let stops = stops(mesh.patches[i].radiance, predicted(i)?)?;
            let weight = f64::from(mesh.area(i));
            Some(Weighed { value: f64::from(stops), weight, face: mesh.patches[i].face })
        })
        .collect();
    let worst_face = worst(&departures);
    departures.iter_mut().for_each(|d| d.value = d.value.abs());
    for (name, share) in [("plate_residual_median_stops", 0.5), ("plate_residual_95_stops", 0.95)] {
        figures.extend(quantile(&mut departures, share).map(|v| (name, v)));
    }
    let mut seen: Vec<Weighed> = (0..env.weight.len())
        .filter(|&i| env.weight[i] > SURE)
        .map(|i| {
            let value = f64::from(probe_residual.pixels()[i].abs());
            Weighed { value, weight: env.solid_angle(i), face: 0 }
        })
        .collect();
    for (name, share) in [("probe_residual_median_stops", 0.5), ("probe_residual_95_stops", 0.95)] {
        figures.extend(quantile(&mut seen, share).map(|v| (name, v)));
    }
    let sum = |picture: &RadianceImage| -> f64 {
        (0..env.weight.len())
            .filter(|&i| env.weight[i] > SURE)
            .map(|i| f64::from(luminance(picture.pixels()[i].0)) * env.solid_angle(i))
            .sum()
    };
    let there = sum(&env.radiance);
    if there > 0.0 {
        figures.push(("predicted_over_probe_power", sum(&probe) / there));
    }
    Check { plate: picture, plate_residual, probe, probe_residual, figures, worst_face }
}

/// Irradiance at each vertex: the mean of the patches around, by area.
fn at_vertices(mesh: &PatchMesh, irradiance: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let mut sums = vec![([0.0f32; 3], 0.0f32); mesh.vertices.len()];
    for (i, patch) in mesh.patches.iter().enumerate() {
        let area = mesh.area(i);
        for v in patch.vertices {
            let (sum, all) = &mut sums[v as usize];
            (0..3).for_each(|k| sum[k] += area * irradiance[i][k]);
            *all += area;
        }
    }
    sums.into_iter().map(|(sum, all)| sum.map(|s| s / all.max(f32::MIN_POSITIVE))).collect()
}

/// A value of a part of a face.
#[derive(Clone, Copy)]
struct Weighed {
    value: f64,
    /// Area, m², or solid angle, sr.
    weight: f64,
    face: u32,
}

/// log2 of a ratio of luminances.
fn stops(seen: [f32; 3], predicted: [f32; 3]) -> Option<f32> {
    let (a, b) = (luminance(seen), luminance(predicted));
    (a > 0.0 && b > 0.0).then(|| (a / b).log2().clamp(-MOST_STOPS, MOST_STOPS))
}

/// Median reflectance of each face over its area that the plate shows and that does not shine; not bounded, so that what
/// does not fit shows.
fn by_face(light: &LightModel, irradiance: &[[f32; 3]]) -> BTreeMap<u32, [f32; 3]> {
    let mesh = &light.mesh;
    let mut all: BTreeMap<u32, [Vec<Weighed>; 3]> = BTreeMap::new();
    for (i, patch) in mesh.patches.iter().enumerate() {
        if patch.evidence != Evidence::Plate || shines(patch.radiance, irradiance[i]) {
            continue;
        }
        let channels = all.entry(patch.face).or_default();
        for k in (0..3).filter(|k| irradiance[i][*k] > 0.0) {
            let rho = PI * patch.radiance[k] / irradiance[i][k];
            let weight = f64::from(mesh.area(i));
            channels[k].push(Weighed { value: f64::from(rho), weight, face: patch.face });
        }
    }
    let median = |mut channels: [Vec<_>; 3]| {
        let [r, g, b] = &mut channels;
        Some([quantile(r, 0.5)? as f32, quantile(g, 0.5)? as f32, quantile(b, 0.5)? as f32])
    };
    all.into_iter().filter_map(|(face, channels)| Some((face, median(channels)?))).collect()
}

/// Value below which a share of the weight lies.
fn quantile(values: &mut [Weighed], share: f64) -> Option<f64> {
    values.sort_by(|a, b| a.value.total_cmp(&b.value));
    let all: f64 = values.iter().map(|v| v.weight).sum();
    let mut sum = 0.0;
    let at = values.iter().find(|v| {
        sum += v.weight;
        sum >= share * all
    });
    at.map(|v| v.value)
}

/// The face whose mean magnitude is largest.
fn worst(departures: &[Weighed]) -> Option<(u32, f64)> {
    let mut faces: BTreeMap<u32, [f64; 2]> = BTreeMap::new();
    for Weighed { value, weight, face } in departures {
        let sums = faces.entry(*face).or_default();
        sums[0] += value.abs() * weight;
        sums[1] += weight;
    }
    let means = faces.into_iter().map(|(face, [sum, area])| (face, sum / area));
    means.max_by(|a, b| a.1.total_cmp(&b.1))
}

fn plate_picture(
    plate: &Plate,
    mesh: &PatchMesh,
    bvh: &Bvh,
    predicted: impl Fn(usize, [f32; 3]) -> Option<[f32; 3]> + Sync,
) -> (RadianceImage, Image<f32>) {
    let (w, h) = plate.radiance.size();
    let pixels: Vec<(Radiance, f32)> = (0..w * h)
        .into_par_iter()
        .map(|i| {
            let ray = plate.camera.ray(&Point2::new((i % w) as f64 + 0.5, (i / w) as f64 + 0.5));
            let (o, d) = (ray.origin, ray.direction);
            let (o, d) =
                ([o.x, o.y, o.z].map(|v| v as f32).into(), Vec3::new(d.x as f32, d.y as f32, d.z as f32));
            let hit = bvh.closest(o, d, 1e-3, f32::MAX);
            let front = hit.filter(|h| mesh.normal(h.triangle as usize).dot(d) < 0.0);
            let Some(l) = front.and_then(|h| predicted(h.triangle as usize, h.barycentric)) else {
                return (Radiance::default(), 0.0);
            };
            let known = !plate.clipped.pixels()[i];
            let off = if known { stops(plate.radiance.pixels()[i].0, l).unwrap_or(0.0) } else { 0.0 };
            (Radiance(l), off)
        })
        .collect();
    let (radiance, residual) = pixels.into_iter().unzip();
    (Image::from_pixels(w, h, radiance), Image::from_pixels(w, h, residual))
}

fn probe_picture(
    light: &LightModel,
    env: &Environment,
    distant: &RadianceImage,
    bvh: &Bvh,
) -> (RadianceImage, Image<f32>) {
    let (w, h) = env.size();
    let texels: Vec<(Radiance, f32)> = (0..w * h)
        .into_par_iter()
        .map(|i| {
            let d = env.direction(i);
            let l = match bvh.closest(env.origin[i], d, 0.0, f32::MAX) {
                Some(hit) if light.mesh.normal(hit.triangle as usize).dot(d) < 0.0 => {
                    light.mesh.patches[hit.triangle as usize].radiance
                }
                Some(_) => [0.0; 3],
                None => latlong::lookup(distant, d).0,
            };
            let sure = env.weight[i] > SURE;
            let off = if sure { stops(env.radiance.pixels()[i].0, l).unwrap_or(0.0) } else { 0.0 };
            (Radiance(l), off)
        })
        .collect();
    let (radiance, residual) = texels.into_iter().unzip();
    (Image::from_pixels(w, h, radiance), Image::from_pixels(w, h, residual))
}

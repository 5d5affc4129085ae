//! How much of the picture's light an object can take from each source, before any shadow is drawn.

use super::origins::triangle_variance;
use super::representatives::Seen;
use super::tiles::Prepared;
use super::{Bounds, Scene};
use crate::image::luminance;
use crate::transfer::{Affected, SourceKind};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Most receiver vertices whose transfers are asked for.
const PROBES: usize = 64;

/// Every source as the object sees it, with the light that the object can take from it.
///
/// The light that source j loses is Σ_x B(x) E_j(x) / E(x) M_xj over the plate's pixels. M is not known yet; in its place
/// stands the share of the hemisphere that the object's bounding sphere covers at x. The sum runs over the receiver
/// vertices with the largest weights.
pub(crate) fn seen(scene: &Scene, prepared: &Prepared, affected: &Affected, bounds: &Bounds) -> Vec<Seen> {
    let (mesh, sources) = (&scene.light.mesh, &scene.transfers.sources);
    let (centre, radius) = (bounds.centre.as_dvec3(), f64::from(bounds.radius));
    let probes = probes(scene, prepared, affected, bounds);
    let weights = weights(scene, &probes);
    let mut seen: Vec<Seen> = sources
        .iter()
        .zip(weights)
        .map(|(source, weight)| {
            let (direction, own_variance, position) = match source.kind {
                SourceKind::Patch(p) => {
                    let corners = mesh.corners(p as usize).map(|c| c.as_dvec3());
                    let position = corners.iter().sum::<DVec3>() / 3.0;
                    let direction = (position - centre).normalize_or(DVec3::Y);
                    (direction, triangle_variance(corners, centre, radius), Some(position))
                }
                SourceKind::Distant(d) => {
                    let d = &scene.light.distant[d as usize];
                    (d.direction.as_dvec3(), f64::from(d.angular_radius()).powi(2) / 2.0, None)
                }
            };
            Seen { weight, marked: false, direction, own_variance, position }
        })
        .collect();
    let brightest = seen.iter().map(|s| s.weight).fold(0.0, f64::max);
    for &j in &affected.sources {
        let source = &mut seen[j as usize];
        source.marked = true;
        // None is left out for sending nothing to the probes: it may to what lies between them.
        let least = 1e-6 * sources[j as usize].power_share;
        source.weight = source.weight.max(if brightest > 0.0 { least * brightest } else { least });
    }
    seen
}

/// Receiver vertices with the light of the picture that the object may take there, per unit of irradiance.
fn probes(scene: &Scene, prepared: &Prepared, affected: &Affected, bounds: &Bounds) -> Vec<(u32, f64)> {
    let mut by_vertex = vec![0.0f64; scene.transfers.receivers.positions.len()];
    let is_affected = |patches: &[u32]| patches.iter().any(|p| affected.patches.binary_search(p).is_ok());
    for tile in prepared.tiles.iter().filter(|t| is_affected(&t.patches)) {
        // One pixel of each vector stands for it.
        for vector in &prepared.vectors[tile.vectors.clone()] {
            let pixel = &prepared.pixels[vector.pixels.start];
            let all = luminance(pixel.irradiance);
            if all <= 0.0 {
                continue;
            }
            let plate = scene.plate.pixels()[pixel.index as usize].luminance().max(0.0);
            let light =
                vector.pixels.len() as f32 * plate / all * covered(pixel.position, pixel.normal, bounds);
            for (v, w) in pixel.vertices.iter().zip(pixel.weights) {
                by_vertex[*v as usize] += f64::from(light * w.max(0.0));
            }
        }
    }
    let mut probes: Vec<(u32, f64)> = (0..).zip(by_vertex).filter(|(_, w)| *w > 0.0).collect();
    probes.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    probes.truncate(PROBES);
    probes
}

/// About the share of the hemisphere over a receiver that the object's bounding sphere covers.
fn covered(position: Vec3, normal: Vec3, bounds: &Bounds) -> f32 {
    let to = bounds.centre - position;
    // What lies behind the receiver's plane takes nothing from it.
    let above = (to.dot(normal) / bounds.radius + 1.0).clamp(0.0, 2.0) / 2.0;
    let sine2 = bounds.radius.powi(2) / to.length_squared().max(bounds.radius.powi(2));
    above * sine2
}

/// Luminance that each source sends to the probes, weighted.
fn weights(scene: &Scene, probes: &[(u32, f64)]) -> Vec<f64> {
    let count = scene.transfers.sources.len();
    let rows: Vec<Vec<f32>> = probes
        .par_iter()
        .map(|&(vertex, weight)| {
            let mut row = vec![[0.0f32; 3]; count];
            scene.transfers.expand(vertex, &mut row);
            row.into_iter().map(|c| luminance(c) * weight as f32).collect()
        })
        .collect();
    let mut sums = vec![0.0f64; count];
    for row in rows {
        sums.iter_mut().zip(row).for_each(|(s, w)| *s += f64::from(w));
    }
    sums
}

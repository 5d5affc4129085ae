//! Computes the transfers: exact form factors times ray-cast visibility.

use super::sampling::{Shift, in_cap, on_triangle};
use super::{Problem, Source, SourceKind, Transfers, form_factor};
use crate::config;
use crate::illuminate::patch::{DistantSource, LightModel, PatchMesh};
use crate::image::luminance;
use crate::shadow::Receivers;
use crate::visibility::Bvh;
use glam::Vec3;
use ndarray::Array2;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Rays leave a surface by this much, m: above rounding, below what a shadow shows.
const OFFSET_M: f32 = 5e-4;
/// Vertices move towards the middle of their patches by this share of the distance, so that one on the border of a
/// face looks past the wall that adjoins there.
const INSET: f32 = 0.02;
/// Rays towards distant light are this long, m.
const BEYOND_M: f32 = 1e5;

/// A receiver vertex as the rays see it.
#[derive(Clone, Copy)]
struct Vertex {
    position: Vec3,
    normal: Vec3,
    /// A third of the area of the receiver patches around it, m².
    area: f64,
}

/// Transfers from every light to the vertices of what the plate sees.
///
/// The common measure of patches and distant light is what they send to the receivers: the luminance of the
/// irradiance they cause, integrated over the receiver patches. (Gibson sorts by radiance, which would also keep
/// light that no receiver sees.) The strongest that together reach `source_share` of it make the source set; the
/// rest is counted in the total irradiance and reported. `advance` is called once per light.
pub fn solve(
    light: &LightModel,
    receivers: &Receivers,
    settings: &config::Transfer,
    advance: impl Fn() + Sync,
) -> Result<Transfers, Problem> {
    check(light, settings)?;
    let mesh = &light.mesh;
    let patches: BTreeSet<u32> = receivers.pixels.pixels().iter().flatten().map(|r| r.patch).collect();
    if patches.is_empty() {
        return Err(Problem::NoReceiver { patches: mesh.patches.len() });
    }
    let ids: BTreeSet<u32> = patches.iter().flat_map(|&p| mesh.patches[p as usize].vertices).collect();
    let ids: Vec<u32> = ids.into_iter().collect();
    let vertices = receiver_vertices(mesh, &patches, &ids);
    let bvh = Bvh::new(&mesh.vertices, &mesh.triangles());

    let kinds: Vec<SourceKind> = (0..mesh.patches.len() as u32)
        .map(SourceKind::Patch)
        .chain((0..light.distant.len() as u32).map(SourceKind::Distant))
        .collect();
    let lights: Vec<(SourceKind, [f32; 3])> = kinds
        .into_iter()
        .map(|kind| (kind, Source { kind, power_share: 0.0 }.radiance(light)))
        .filter(|(_, radiance)| radiance.iter().any(|&c| c > 0.0))
        .collect();
    let rows: Vec<Vec<f32>> = lights
        .par_iter()
        .map(|&(kind, _)| {
            let row = match kind {
                SourceKind::Patch(i) => patch_row(mesh, i as usize, &vertices, &bvh, settings.rays as u32),
                SourceKind::Distant(i) => {
                    distant_row(&light.distant[i as usize], i, &vertices, &bvh, settings.rays as u32)
                }
            };
            advance();
            row
        })
        .collect();

    let power: Vec<f64> = lights
        .iter()
        .zip(&rows)
        .map(|((_, radiance), row)| {
            let received: f64 = row.iter().zip(&vertices).map(|(&g, v)| f64::from(g) * v.area).sum();
            received * f64::from(luminance(*radiance))
        })
        .collect();
    let total: f64 = power.iter().sum();
    if total <= 0.0 {
        return Err(Problem::NoLight { sources: mesh.patches.len() + light.distant.len() });
    }
    let set = strongest(&power, settings.source_share);
    let share: f64 = set.iter().map(|&i| power[i]).sum::<f64>() / total;
    Ok(Transfers {
        sources: set.iter().map(|&i| Source { kind: lights[i].0, power_share: power[i] / total }).collect(),
        receiver_patches: patches.into_iter().collect(),
        transfer: Array2::from_shape_fn((set.len(), ids.len()), |(s, v)| rows[set[s]][v]),
        irradiance: total_irradiance(&lights, &rows, ids.len()),
        receiver_vertices: ids,
        left_out: power.iter().filter(|&&p| p > 0.0).count() - set.len(),
        left_out_share: (1.0 - share).max(0.0),
    })
}

fn check(light: &LightModel, settings: &config::Transfer) -> Result<(), Problem> {
    if !(settings.source_share > 0.0 && settings.source_share <= 1.0) {
        return Err(Problem::Share(settings.source_share));
    }
    if settings.rays == 0 {
        return Err(Problem::NoRays);
    }
    let patches = light.mesh.patches.iter().enumerate().map(|(i, p)| ("patch", i, p.radiance));
    let distant = light.distant.iter().enumerate().map(|(i, d)| ("distant source", i, d.radiance));
    match patches.chain(distant).find(|(_, _, r)| r.iter().any(|c| !(c.is_finite() && *c >= 0.0))) {
        Some((what, index, radiance)) => Err(Problem::Radiance { what, index, radiance }),
        None => Ok(()),
    }
}

/// Indices of the strongest that together reach `share` of the sum, strongest first; none that sends nothing.
fn strongest(power: &[f64], share: f64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..power.len()).filter(|&i| power[i] > 0.0).collect();
    order.sort_by(|&a, &b| power[b].total_cmp(&power[a]).then(a.cmp(&b)));
    if share >= 1.0 {
        return order;
    }
    let enough = share * order.iter().map(|&i| power[i]).sum::<f64>();
    let (mut sum, mut count) = (0.0, 0);
    while sum < enough && count < order.len() {
        sum += power[order[count]];
        count += 1;
    }
    order.truncate(count);
    order
}

fn receiver_vertices(mesh: &PatchMesh, receivers: &BTreeSet<u32>, ids: &[u32]) -> Vec<Vertex> {
    let mut middle = vec![(Vec3::ZERO, 0.0f32); mesh.vertices.len()];
    let mut area = vec![0.0f64; mesh.vertices.len()];
    for (i, patch) in mesh.patches.iter().enumerate() {
        for v in patch.vertices {
            let slot = &mut middle[v as usize];
            *slot = (slot.0 + mesh.centroid(i), slot.1 + 1.0);
            if receivers.contains(&(i as u32)) {
                area[v as usize] += f64::from(mesh.area(i)) / 3.0;
            }
        }
    }
    let vertex = |&id: &u32| {
        let (position, normal) = (mesh.vertices[id as usize], mesh.normals[id as usize]);
        let (sum, count) = middle[id as usize];
        let inset = (sum / count - position) * INSET;
        Vertex { position: position + inset + normal * OFFSET_M, normal, area: area[id as usize] }
    };
    ids.iter().map(vertex).collect()
}

fn patch_row(mesh: &PatchMesh, patch: usize, vertices: &[Vertex], bvh: &Bvh, rays: u32) -> Vec<f32> {
    let corners = mesh.corners(patch);
    let normal = mesh.normal(patch);
    let row = vertices.iter().enumerate().map(|(i, v)| {
        let f = form_factor::polygon(v.position, v.normal, &corners);
        if f == 0.0 {
            return 0.0;
        }
        let shift = Shift::new(patch as u64, i as u64);
        let sample = |k| {
            let y = on_triangle(corners, shift.point(k));
            let w = y - v.position;
            let weight = w.dot(v.normal).max(0.0) * (-w.dot(normal)).max(0.0) / w.length_squared().powi(2);
            (weight, y + normal * OFFSET_M)
        };
        let visible = visible_share(rays, sample, |y| !bvh.occluded(v.position, y));
        std::f32::consts::PI * f * visible
    });
    row.collect()
}

fn distant_row(source: &DistantSource, index: u32, vertices: &[Vertex], bvh: &Bvh, rays: u32) -> Vec<f32> {
    let radius = source.angular_radius();
    let row = vertices.iter().enumerate().map(|(i, v)| {
        let cosine = v.normal.dot(source.direction);
        if cosine <= 0.0 {
            return 0.0;
        }
        let shift = Shift::new(u64::from(index) | 1 << 40, i as u64);
        let sample = |k| {
            let w = in_cap(source.direction, radius, shift.point(k));
            (w.dot(v.normal).max(0.0), w)
        };
        let visible = visible_share(rays, sample, |w| !bvh.any_hit(v.position, w, 0.0, BEYOND_M));
        source.solid_angle_sr * cosine * visible
    });
    row.collect()
}

/// Share of a source that is visible: a third of the rays first, the others only where those disagree. `sample`
/// gives a point of the source with its weight in the form factor.
fn visible_share(rays: u32, sample: impl Fn(u32) -> (f32, Vec3), visible: impl Fn(Vec3) -> bool) -> f32 {
    let first = (rays / 3).max(2).min(rays);
    let (mut seen, mut all) = (0.0, 0.0);
    for k in 0..rays {
        if k >= first && all > 0.0 && (seen == 0.0 || seen == all) {
            break;
        }
        let (weight, target) = sample(k);
        if weight > 0.0 {
            all += weight;
            seen += if visible(target) { weight } else { 0.0 };
        }
    }
    if all > 0.0 { seen / all } else { 0.0 }
}

fn total_irradiance(lights: &[(SourceKind, [f32; 3])], rows: &[Vec<f32>], vertices: usize) -> Array2<f32> {
    let mut sums = vec![[0.0f64; 3]; vertices];
    for ((_, radiance), row) in lights.iter().zip(rows) {
        for (sum, &g) in sums.iter_mut().zip(row) {
            for c in 0..3 {
                sum[c] += f64::from(radiance[c]) * f64::from(g);
            }
        }
    }
    Array2::from_shape_fn((vertices, 3), |(v, c)| sums[v][c] as f32)
}

//! Computes the transfers: exact form factors times ray-cast visibility.

use super::lights::Light;
use super::links::{Cutter, Entry};
use super::sampling::{Shift, in_cap, on_triangle};
use super::tree::LightTree;
use super::{
    Links, Problem, ReceiverMesh, ShaftHierarchy, Source, SourceKind, SourceTree, Transfers, form_factor,
};
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
    /// A third of the area of the receiver triangles around it, m².
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
    let receivers = ReceiverMesh::new(mesh, patches.into_iter().collect());
    let vertices = receiver_vertices(mesh, &receivers);
    let bvh = Bvh::new(&mesh.vertices, &mesh.triangles());

    let lights = Light::all(light);
    let rows: Vec<Vec<f32>> = lights
        .par_iter()
        .map(|l| {
            let row = match l.kind {
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
        .map(|(l, row)| {
            let received: f64 = row.iter().zip(&vertices).map(|(&g, v)| f64::from(g) * v.area).sum();
            received * f64::from(luminance(l.radiance))
        })
        .collect();
    let total: f64 = power.iter().sum();
    if total <= 0.0 {
        return Err(Problem::NoLight { sources: mesh.patches.len() + light.distant.len() });
    }
    let set = strongest(&power, settings.source_share);
    let share: f64 = set.iter().map(|&i| power[i]).sum::<f64>() / total;
    let members: Vec<Light> = set.iter().map(|&i| lights[i]).collect();
    let light_tree = LightTree::build(&members);
    let area: f64 = vertices.iter().map(|v| v.area).sum();
    let ordered: Vec<usize> = light_tree.order.iter().map(|&i| set[i as usize]).collect();
    let sources: Vec<Source> = ordered
        .iter()
        .map(|&i| Source { kind: lights[i].kind, power_share: power[i] / total, mean: power[i] / area })
        .collect();
    let tree = SourceTree::of(&light_tree, &sources);
    let irradiance = total_irradiance(&lights, &rows, vertices.len());
    let cutter = Cutter { tree: &tree, tolerance: settings.link_tolerance };
    let mut leaves = vec![0; sources.len()];
    for (node, i) in tree.nodes.iter().zip(0..).filter(|(n, _)| n.children.is_none()) {
        leaves[node.leaves.start as usize] = i;
    }
    let cuts: Vec<Vec<Entry>> = (0..vertices.len())
        .map(|v| {
            let fine: Vec<Entry> = ordered
                .iter()
                .zip(&leaves)
                .filter(|&(&i, _)| rows[i][v] > 0.0)
                .map(|(&i, &leaf)| (leaf, lights[i].radiance.map(|c| c * rows[i][v])))
                .collect();
            cutter.coarsen(&fine, f64::from(luminance([0, 1, 2].map(|c| irradiance[(v, c)]))))
        })
        .collect();
    Ok(Transfers {
        links: Links::of(&cuts),
        sources,
        tree,
        receivers,
        irradiance,
        shafts: ShaftHierarchy::default(),
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

fn receiver_vertices(mesh: &PatchMesh, receivers: &ReceiverMesh) -> Vec<Vertex> {
    let mut middle = vec![(Vec3::ZERO, 0.0f32); receivers.positions.len()];
    for t in &receivers.triangles {
        let centroid = mesh.centroid(t.patch as usize);
        for v in t.vertices {
            let slot = &mut middle[v as usize];
            *slot = (slot.0 + centroid, slot.1 + 1.0);
        }
    }
    let areas = receivers.vertex_areas();
    let vertex = |v: usize| {
        let (position, normal) = (receivers.positions[v], receivers.normals[v]);
        let (sum, count) = middle[v];
        let inset = (sum / count - position) * INSET;
        Vertex { position: position + inset + normal * OFFSET_M, normal, area: areas[v] }
    };
    (0..receivers.positions.len()).map(vertex).collect()
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

fn total_irradiance(lights: &[Light], rows: &[Vec<f32>], vertices: usize) -> Array2<f32> {
    let mut sums = vec![[0.0f64; 3]; vertices];
    for (light, row) in lights.iter().zip(rows) {
        for (sum, &g) in sums.iter_mut().zip(row) {
            for c in 0..3 {
                sum[c] += f64::from(light.radiance[c]) * f64::from(g);
            }
        }
    }
    Array2::from_shape_fn((vertices, 3), |(v, c)| sums[v][c] as f32)
}

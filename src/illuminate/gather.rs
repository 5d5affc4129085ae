//! Irradiance at patches from all other patches and from distant light: strong patches by exact polygon form factors
//! with a visibility ray each, the rest by rays over the hemisphere.

use super::patch::{DistantSource, PatchMesh};
use crate::image::luminance;
use crate::transfer::form_factor;
use crate::visibility::Bvh;
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::PI;

/// Share of all patches' power that is gathered by form factors.
const STRONG_SHARE: f64 = 0.8;
/// Patches gathered by form factors, at most.
const MAX_STRONG: usize = 400;
/// Rays from each of a patch's points.
const RAYS: usize = 96;
/// Points on a patch, barycentric.
const POINTS: [[f32; 3]; 3] =
    [[2.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0], [1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0], [1.0 / 6.0, 1.0 / 6.0, 2.0 / 3.0]];
/// A ray that meets no patch, or a strong one.
const NOTHING: u32 = u32::MAX;

/// What every patch sees: geometry alone but for the choice of strong patches.
pub struct Gather {
    /// Irradiance of the strong patches and of distant light.
    direct: Vec<[f32; 3]>,
    /// For each patch the patches its rays meet.
    hits: Vec<Vec<u32>>,
}

impl Gather {
    /// Casts all rays. Patches are seen from their front alone; `known` tells whose radiance is known by now.
    pub fn new(
        mesh: &PatchMesh,
        distant: &[DistantSource],
        bvh: &Bvh,
        known: impl Fn(usize) -> bool,
    ) -> Self {
        let strong = strong_patches(mesh, known);
        let mut is_strong = vec![false; mesh.patches.len()];
        strong.iter().for_each(|&i| is_strong[i] = true);
        let (direct, hits) = (0..mesh.patches.len())
            .into_par_iter()
            .map(|i| {
                let mut sum = [0.0f64; 3];
                let mut hits = Vec::with_capacity(POINTS.len() * RAYS);
                let normal = mesh.normal(i);
                for (k, b) in POINTS.iter().enumerate() {
                    let corners = mesh.corners(i);
                    let p = corners[0] * b[0] + corners[1] * b[1] + corners[2] * b[2];
                    // Off the surface by a little, against meeting it again.
                    let p = p + normal * (1e-4 + 1e-5 * p.length());
                    for &j in strong.iter().filter(|&&j| j != i) {
                        let e = from_patch(mesh, bvh, p, normal, j);
                        (0..3).for_each(|c| sum[c] += f64::from(e[c]));
                    }
                    for s in distant {
                        let cosine = s.direction.dot(normal);
                        if cosine > 0.0 && !bvh.any_hit(p, s.direction, 0.0, f32::MAX) {
                            let share = f64::from(cosine * s.solid_angle_sr);
                            (0..3).for_each(|c| sum[c] += f64::from(s.radiance[c]) * share);
                        }
                    }
                    for r in 0..RAYS {
                        let d = cosine_direction(normal, r, RAYS, i * POINTS.len() + k);
                        hits.push(match bvh.closest(p, d, 0.0, f32::MAX) {
                            Some(hit)
                                if !is_strong[hit.triangle as usize]
                                    && mesh.normal(hit.triangle as usize).dot(d) < 0.0 =>
                            {
                                hit.triangle
                            }
                            _ => NOTHING,
                        });
                    }
                }
                (sum.map(|s| (s / POINTS.len() as f64) as f32), hits)
            })
            .unzip();
        Self { direct, hits }
    }

    /// Irradiance of every patch under the present radiances.
    pub fn irradiance(&self, mesh: &PatchMesh) -> Vec<[f32; 3]> {
        let patches = self.direct.par_iter().zip(&self.hits);
        patches
            .map(|(direct, hits)| {
                let mut sum = [0.0f64; 3];
                for &h in hits.iter().filter(|h| **h != NOTHING) {
                    let l = mesh.patches[h as usize].radiance;
                    (0..3).for_each(|c| sum[c] += f64::from(l[c]));
                }
                let scale = std::f64::consts::PI / hits.len().max(1) as f64;
                std::array::from_fn(|c| direct[c] + (sum[c] * scale) as f32)
            })
            .collect()
    }
}

/// Irradiance at a point from one patch: Lambert's formula where its middle can be seen.
fn from_patch(mesh: &PatchMesh, bvh: &Bvh, p: Vec3, normal: Vec3, j: usize) -> [f32; 3] {
    let to = mesh.centroid(j) - p;
    let factor = form_factor::polygon(p, normal, &mesh.corners(j));
    if factor == 0.0 || bvh.any_hit(p, to, 0.0, 1.0 - 1e-3) {
        return [0.0; 3];
    }
    mesh.patches[j].radiance.map(|l| l * factor * PI)
}

/// The patches of known radiance that send most, in falling order.
pub(crate) fn strong_patches(mesh: &PatchMesh, known: impl Fn(usize) -> bool) -> Vec<usize> {
    let power: Vec<f64> = (0..mesh.patches.len()).map(|i| super::power(mesh, i)).collect();
    let all: f64 = power.iter().sum();
    let mut order: Vec<usize> = (0..power.len()).filter(|&i| known(i) && power[i] > 0.0).collect();
    order.sort_by(|&a, &b| power[b].total_cmp(&power[a]).then(a.cmp(&b)));
    let mut sum = 0.0;
    // Diffuse surfaces of even radiance are many and harmless: only what stands out in radiance is worth a form factor.
    let mean = luminance_mean(mesh);
    order.retain(|&i| f64::from(luminance(mesh.patches[i].radiance)) > 3.0 * mean);
    order
        .into_iter()
        .take(MAX_STRONG)
        .take_while(|&i| {
            let more = sum < STRONG_SHARE * all;
            sum += power[i];
            more
        })
        .collect()
}

fn luminance_mean(mesh: &PatchMesh) -> f64 {
    let area: f64 = (0..mesh.patches.len()).map(|i| f64::from(mesh.area(i))).sum();
    (0..mesh.patches.len()).map(|i| super::power(mesh, i)).sum::<f64>() / area.max(f64::MIN_POSITIVE)
}

/// The `i`-th of `n` directions about a normal with density cosine / π: a Fibonacci set turned for each point.
fn cosine_direction(normal: Vec3, i: usize, n: usize, point: usize) -> Vec3 {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let turn = (point as f64 * 0.754_877_666_246_692_8).fract();
    let angle = (std::f64::consts::TAU * (i as f64 * GOLDEN + turn).fract()) as f32;
    let r2 = (i as f32 + 0.5) / n as f32;
    let (u, v) = normal.any_orthonormal_pair();
    (u * angle.cos() + v * angle.sin()) * r2.sqrt() + normal * (1.0 - r2).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illuminate::mesh::{FaceMesh, assemble};
    use crate::illuminate::room;

    fn room_mesh(edge: f64) -> PatchMesh {
        let faces: Vec<_> = room::faces(2.0, 2.0, 2.0)
            .iter()
            .map(|f| {
                let mut m = FaceMesh::new(f).unwrap();
                m.refine(|_| edge);
                Some(m)
            })
            .collect();
        assemble(&faces)
    }

    #[test]
    fn white_furnace() {
        let mut mesh = room_mesh(0.5);
        mesh.patches.iter_mut().for_each(|p| p.radiance = [2.0, 1.0, 0.5]);
        let bvh = Bvh::new(&mesh.vertices, &mesh.triangles());
        let gather = Gather::new(&mesh, &[], &bvh, |_| true);
        for e in gather.irradiance(&mesh) {
            assert!((e[0] / (2.0 * PI) - 1.0).abs() < 1e-3, "{}", e[0] / (2.0 * PI));
        }
    }

    #[test]
    fn form_factors_of_a_closed_room_sum_to_one() {
        let mesh = room_mesh(0.3);
        for i in (0..mesh.patches.len()).step_by(7) {
            let (p, normal) = (mesh.centroid(i), mesh.normal(i));
            let row: f64 = (0..mesh.patches.len())
                .filter(|&j| j != i && mesh.patches[j].face != mesh.patches[i].face)
                .map(|j| f64::from(form_factor::polygon(p, normal, &mesh.corners(j))))
                .sum();
            assert!((row - 1.0).abs() < 1e-3, "{row}");
        }
    }

    #[test]
    fn a_bright_ceiling_lights_the_floor_by_the_form_factor_of_a_cube() {
        let mut mesh = room_mesh(0.25);
        for p in mesh.patches.iter_mut().filter(|p| p.face == 1) {
            p.radiance = [1.0; 3];
        }
        let bvh = Bvh::new(&mesh.vertices, &mesh.triangles());
        let e = Gather::new(&mesh, &[], &bvh, |_| true).irradiance(&mesh);
        let (mut sum, mut area) = (0.0, 0.0);
        for (i, e) in e.iter().enumerate().filter(|(i, _)| mesh.patches[*i].face == 0) {
            sum += f64::from(e[0] * mesh.area(i));
            area += f64::from(mesh.area(i));
        }
        // Opposite sides of a cube: 0.1998 (Howell, C-11).
        let factor = sum / area / std::f64::consts::PI;
        assert!((factor / 0.1998 - 1.0).abs() < 0.01, "{factor}");
    }

    #[test]
    fn distant_light_reaches_what_faces_it() {
        let mut m = FaceMesh::new(&room::faces(2.0, 2.0, 2.0)[0]).unwrap();
        m.refine(|_| 0.5);
        let mesh = assemble(&[Some(m)]);
        let bvh = Bvh::new(&mesh.vertices, &mesh.triangles());
        let sun = DistantSource {
            direction: Vec3::new(0.6, 0.8, 0.0),
            solid_angle_sr: 1e-4,
            radiance: [1e4, 1e4, 0.0],
        };
        for e in Gather::new(&mesh, &[sun], &bvh, |_| true).irradiance(&mesh) {
            assert!((e[0] - 0.8).abs() < 1e-4 && e[2] == 0.0, "{e:?}");
        }
    }
}

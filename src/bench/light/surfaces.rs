//! Reflectance of the surfaces that the plate shows.

use super::Judged;
use crate::error::{Context as _, Result};
use crate::illuminate::mesh::{FaceMesh, assemble};
use crate::illuminate::patch::Evidence;
use crate::image::luminance;
use crate::visibility::Bvh;
use std::collections::BTreeMap;

/// A patch lies on a true surface that is nearer than this, m.
const NEAR_M: f32 = 0.04;
/// Smaller visible areas are left out, m².
const LEAST_M2: f64 = 0.005;

/// A surface of the true scene.
pub(super) struct Surface {
    pub name: String,
    /// Of the reflectance by luminance, median over the area that the plate shows.
    pub error: f64,
}

/// All that the plate shows enough of.
pub(super) fn judge(judged: &Judged) -> Result<Vec<Surface>> {
    let truth = judged.truth.reflectances().doing("reading the reflectances of the truth")?;
    let meshes: Vec<_> = judged.scene.faces.iter().map(FaceMesh::new).collect();
    let scene = assemble(&meshes);
    let bvh = Bvh::new(&scene.vertices, &scene.triangles());
    let mesh = &judged.light.mesh;
    let mut by_surface: BTreeMap<&str, Vec<(f64, f64)>> = BTreeMap::new();
    for (i, patch) in mesh.patches.iter().enumerate().filter(|(_, p)| p.evidence == Evidence::Plate) {
        let normal = mesh.normal(i);
        let from = mesh.centroid(i) + normal * NEAR_M;
        let Some(hit) = bvh.closest(from, -normal, 0.0, 2.0 * NEAR_M) else { continue };
        if scene.normal(hit.triangle as usize).dot(normal) < 0.9 {
            continue;
        }
        let face = &judged.scene.faces[scene.patches[hit.triangle as usize].face as usize].name;
        let primitive = face.split('.').next().unwrap_or(face);
        let Some(reflectance) = truth.get(primitive) else { continue };
        let there = luminance(reflectance.map(|r| r as f32));
        let error = f64::from(luminance(patch.reflectance) / there) - 1.0;
        by_surface.entry(face).or_default().push((error, f64::from(mesh.area(i))));
    }
    let surface = |(name, mut errors): (&str, Vec<(f64, f64)>)| {
        let area: f64 = errors.iter().map(|e| e.1).sum();
        errors.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut sum = 0.0;
        let median = errors.iter().find(|e| {
            sum += e.1;
            sum >= area / 2.0
        })?;
        (area > LEAST_M2).then(|| Surface { name: name.into(), error: median.0 })
    };
    Ok(by_surface.into_iter().filter_map(surface).collect())
}

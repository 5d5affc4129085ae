//! Faces without the vertices of their patches: for rays that only ask whether something stands between, a face is a few
//! triangles however finely its light is known.

use super::patch::PatchMesh;
use crate::model::polygon;
use glam::{DVec2, DVec3, Vec3};
use nalgebra::Point2;
use std::collections::BTreeMap;

/// A vertex this near to the line between its neighbours, as a share of the mesh's size, lies on it.
const STRAIGHT: f64 = 2e-6;
/// Largest share of its area that a face may gain or lose.
const SAME_AREA: f64 = 1e-4;

type Triangle = [u32; 3];

impl PatchMesh {
    /// Triangles (indices into [`PatchMesh::vertices`]) that cover what the patches cover, between the corners of the
    /// faces' outlines: a constrained Delaunay triangulation of each. Faces whose outlines touch themselves keep their
    /// patches.
    pub fn outlined(&self) -> Vec<Triangle> {
        let mut faces: BTreeMap<u32, Vec<Triangle>> = BTreeMap::new();
        for patch in &self.patches {
            faces.entry(patch.face).or_default().push(patch.vertices);
        }
        let size = self.vertices.iter().fold(0.0f32, |m, v| m.max(v.abs().max_element()));
        let straight = STRAIGHT * f64::from(size);
        let few = |patches: Vec<Triangle>| self.outlined_face(&patches, straight).unwrap_or(patches);
        faces.into_values().flat_map(few).collect()
    }

    fn outlined_face(&self, patches: &[Triangle], straight: f64) -> Option<Vec<Triangle>> {
        let next = outline(patches, |v| self.vertices[v as usize].as_dvec3(), straight)?;
        let corners: Vec<u32> = next.keys().copied().collect();
        let normal = self.normals[patches[0][0] as usize];
        let u = normal.any_orthonormal_vector();
        let [u, v] = [u, normal.cross(u)].map(Vec3::as_dvec3);
        let flat = |i: u32| {
            let p = self.vertices[i as usize].as_dvec3();
            DVec2::new(p.dot(u), p.dot(v))
        };
        let points: Vec<Point2<f64>> = corners.iter().map(|&i| Point2::from(flat(i).to_array())).collect();
        let place = |i: u32| corners.binary_search(&i).ok();
        let edges: Vec<[usize; 2]> =
            next.iter().map(|(&a, &b)| Some([place(a)?, place(b)?])).collect::<Option<_>>()?;
        let filled = polygon::fill(&points, &edges)?;
        let kept: Vec<Triangle> = filled.into_iter().map(|t| t.map(|k| corners[k])).collect();
        let area = |triangles: &[Triangle]| -> f64 {
            triangles.iter().map(|t| t.map(flat)).map(|[a, b, c]| (b - a).perp_dot(c - a) / 2.0).sum()
        };
        let (before, after) = (area(patches), area(&kept));
        ((after - before).abs() <= SAME_AREA * before).then_some(kept)
    }
}

/// The next corner after each around some triangles, without those on straight lines. `None`: the outline touches itself.
fn outline(
    triangles: &[Triangle],
    position: impl Fn(u32) -> DVec3,
    straight: f64,
) -> Option<BTreeMap<u32, u32>> {
    let mut edges: Vec<(u32, u32)> =
        triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).collect();
    edges.sort_unstable();
    let border = edges.iter().filter(|(a, b)| edges.binary_search(&(*b, *a)).is_err());
    let (mut next, mut previous) = (BTreeMap::new(), BTreeMap::new());
    for &(a, b) in border {
        if next.insert(a, b).or(previous.insert(b, a)).is_some() {
            return None;
        }
    }
    for vertex in next.keys().copied().collect::<Vec<_>>() {
        let (before, after) = (*previous.get(&vertex)?, *next.get(&vertex)?);
        let (p, q, r) = (position(before), position(vertex), position(after));
        let off = (q - p).cross(r - p).length() / (r - p).length();
        if (q - p).dot(r - q) > 0.0 && off <= straight {
            next.remove(&vertex);
            next.insert(before, after);
            previous.insert(after, before);
        }
    }
    Some(next)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::lobby;
    use crate::visibility::Bvh;
    use proptest::prelude::*;

    /// A tilted face of unit cells, two patches each, of which some are there.
    fn face(columns: u32, cells: &[bool]) -> PatchMesh {
        let mut mesh = PatchMesh::default();
        let rows = cells.len() as u32 / columns;
        let (x, z) = (Vec3::new(0.96, 0.28, 0.0), Vec3::new(0.0, 0.28, 0.96));
        let (u, v) = (z * rows as f32, x * columns as f32);
        crate::synthetic::face(&mut mesh, Vec3::ZERO, u, v, 1.0001, |_| [1.0; 3]);
        let kept: Vec<_> =
            mesh.patches.iter().enumerate().filter(|(i, _)| cells[i / 2]).map(|(_, &p)| p).collect();
        mesh.patches = kept;
        mesh
    }

    proptest! {
        #[test]
        fn rays_meet_the_same(columns in 1u32..5, cells in prop::collection::vec(prop::bool::weighted(0.8), 20)) {
            let mesh = face(columns, &cells[..(20 / columns * columns) as usize]);
            let few = mesh.outlined();
            prop_assert!(few.len() <= mesh.patches.len());
            let (a, b) = (Bvh::new(&mesh.vertices, &mesh.triangles()), Bvh::new(&mesh.vertices, &few));
            for i in 0..400 {
                let (s, t) = (0.137 + 0.31 * (i % 20) as f32, 0.071 + 1.13 * (i / 20) as f32);
                let from = Vec3::new(s, 30.0, t);
                prop_assert_eq!(a.any_hit(from, -Vec3::Y, 0.0, 99.0), b.any_hit(from, -Vec3::Y, 0.0, 99.0));
            }
        }
    }

    #[test]
    fn a_room_has_few_triangles_however_many_patches() {
        let counts = [1.0, 0.2].map(|edge| lobby(edge).mesh.outlined().len());
        assert_eq!(counts[0], counts[1]);
        assert!(counts[0] < 120, "{}", counts[0]);
    }

    #[test]
    fn a_face_with_a_hole_keeps_the_hole() {
        let mut cells = [true; 9];
        cells[4] = false;
        let few = face(3, &cells).outlined();
        assert_eq!(few.len(), 8);
    }
}

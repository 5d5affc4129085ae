//! Which nodes of a light tree nothing of the scene can hide from a cluster of receivers: no rays are needed there.

use super::boxes::Box3;
use super::field::LightField;
use super::lights::Shape;
use super::shaft::Shaft;
use super::tree::Extent;
use crate::illuminate::patch::PatchMesh;
use glam::Vec3;

/// The faces of a scene, each of which lies in a plane.
pub(super) struct Blockers {
    faces: Vec<Blocker>,
    /// Diagonal of the scene, m.
    size: f32,
}

struct Blocker {
    bounds: Box3,
    /// Unit normal and distance from the origin, m.
    plane: (Vec3, f32),
    area: f32,
}

/// Least and largest signed distance of a node's lights from planes, m (of distant lights: of their directions).
pub(super) struct Sides {
    /// [nodes × planes]
    distance: Vec<[f32; 2]>,
    /// The planes of the largest faces.
    planes: usize,
}

/// Numbers kept of the distances of nodes from planes at most.
const MOST_SIDES: usize = 4 << 20;
/// Nodes smaller than this share of the points' spread are not parted.
const SMALL_NODE: f32 = 1.5;
/// A point this near to a plane, as a share of the scene's diagonal, counts as on it.
const ON_PLANE: f32 = 2e-6;

impl Blockers {
    /// One for each face of a mesh.
    pub fn new(mesh: &PatchMesh) -> Self {
        let mut faces: Vec<Blocker> = Vec::new();
        let mut of_face = std::collections::BTreeMap::new();
        for (i, patch) in mesh.patches.iter().enumerate() {
            let normal = mesh.normal(i);
            let corners = mesh.corners(i);
            let at = *of_face.entry(patch.face).or_insert_with(|| {
                let plane = (normal, normal.dot(corners[0]));
                faces.push(Blocker { bounds: Box3::EMPTY, plane, area: 0.0 });
                faces.len() - 1
            });
            faces[at].bounds = faces[at].bounds.union(Box3::of(corners));
            faces[at].area += mesh.area(i);
        }
        faces.sort_by(|a, b| b.area.total_cmp(&a.area));
        let all = faces.iter().fold(Box3::EMPTY, |b, f| b.union(f.bounds));
        Self { faces, size: all.size().length() }
    }

    /// Where the nodes of a field lie to the largest faces.
    pub fn sides(&self, field: &LightField) -> Sides {
        let nodes = &field.tree.nodes;
        let planes = self.faces.len().min(MOST_SIDES / nodes.len().max(1));
        let mut distance = vec![[f32::INFINITY, f32::NEG_INFINITY]; nodes.len() * planes];
        for i in (0..nodes.len()).rev() {
            for (k, face) in self.faces[..planes].iter().enumerate() {
                let (normal, offset) = face.plane;
                let mut sides = [f32::INFINITY, f32::NEG_INFINITY];
                let mut add = |[low, high]: [f32; 2]| sides = [sides[0].min(low), sides[1].max(high)];
                match nodes[i].children {
                    Some(below) => below.iter().for_each(|&c| add(distance[c as usize * planes + k])),
                    None => match field.lights[nodes[i].leaves.start as usize].shape {
                        Shape::Patch { corners, .. } => {
                            corners.iter().for_each(|c| add([c.dot(normal) - offset; 2]));
                        }
                        Shape::Distant { direction, angular_radius, .. } => {
                            let angle = direction.dot(normal).clamp(-1.0, 1.0).acos();
                            let far = (angle + angular_radius).min(std::f32::consts::PI);
                            add([far.cos(), (angle - angular_radius).max(0.0).cos()]);
                        }
                    },
                }
                distance[i * planes + k] = sides;
            }
        }
        Sides { distance, planes }
    }

    /// Of each node of a field ([nodes]) whether all segments between it and the points pass free; only said of the
    /// topmost such nodes, which holds for all below.
    pub fn free(&self, field: &LightField, sides: &Sides, points: &[Vec3]) -> Vec<bool> {
        let mut free = vec![false; field.tree.nodes.len()];
        if free.is_empty() {
            return free;
        }
        let own: Vec<[f32; 2]> = self
            .faces
            .iter()
            .map(|f| {
                let distances = points.iter().map(|p| p.dot(f.plane.0) - f.plane.1);
                distances.fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], d| [a.min(d), b.max(d)])
            })
            .collect();
        let search = Search { blockers: self, field, sides, own, bounds: Box3::of(points.iter().copied()) };
        search.visit(0, &(0..self.faces.len() as u32).collect::<Vec<_>>(), &mut free);
        free
    }
}

struct Search<'a> {
    blockers: &'a Blockers,
    field: &'a LightField,
    sides: &'a Sides,
    /// Least and largest distance of the points from each face's plane, m.
    own: Vec<[f32; 2]>,
    bounds: Box3,
}

impl Search<'_> {
    fn visit(&self, node: u32, above: &[u32], free: &mut [bool]) {
        let n = &self.field.tree.nodes[node as usize];
        let shaft = Shaft::to(self.bounds, n.extent, f64::from(self.blockers.size) + 1.0);
        let may = |&&f: &&u32| {
            self.may_part(node, n.extent, f) && shaft.meets(self.blockers.faces[f as usize].bounds)
        };
        let left: Vec<u32> = above.iter().filter(may).copied().collect();
        if left.is_empty() {
            free[node as usize] = true;
        } else if let Some(below) = n.children.filter(|_| self.smaller_than(n.extent)) {
            below.iter().for_each(|&c| self.visit(c, &left, free));
        }
    }

    /// Whether the points are less spread than a node: else it is they for which faces stand between, and parting the node
    /// finds little more that is free.
    fn smaller_than(&self, extent: Extent) -> bool {
        match extent {
            Extent::Patches(b) => b.size().length() > SMALL_NODE * self.bounds.size().length(),
            Extent::Distant(_) | Extent::Both => true,
        }
    }

    /// Whether the face's plane has points and lights on different sides.
    fn may_part(&self, node: u32, extent: Extent, face: u32) -> bool {
        let f = face as usize;
        let on = ON_PLANE * self.blockers.size;
        let (sides, on_light) = match extent {
            _ if f < self.sides.planes => (self.sides.distance[node as usize * self.sides.planes + f], on),
            Extent::Patches(b) => {
                let (n, d) = self.blockers.faces[f].plane;
                let (at, reach) = (b.centre().dot(n) - d, (b.size() / 2.0).dot(n.abs()));
                ([at - reach, at + reach], on)
            }
            _ => return true,
        };
        let on_light = if matches!(extent, Extent::Patches(_)) { on_light } else { 0.0 };
        if matches!(extent, Extent::Both) {
            return true;
        }
        let [low, high] = self.own[f];
        let before = low >= -on && sides[0] >= -on_light;
        let behind = high <= on && sides[1] <= on_light;
        !(before || behind)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illuminate::patch::{Evidence, LightModel, Patch};
    use crate::transfer::lights::Light;
    use crate::visibility::Bvh;

    fn quad(mesh: &mut PatchMesh, corners: [Vec3; 4], radiance: f32) {
        let base = mesh.vertices.len() as u32;
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        let face = base / 4;
        mesh.vertices.extend(corners);
        mesh.normals.extend([normal; 4]);
        for [a, b, c] in [[0, 1, 2], [0, 2, 3]] {
            mesh.patches.push(Patch {
                vertices: [base + a, base + b, base + c],
                face,
                radiance: [radiance; 3],
                reflectance: [0.5; 3],
                evidence: Evidence::Plate,
            });
        }
    }

    /// A room turned by 30° whose walls look inwards, with a board in it.
    fn scene(board: bool) -> LightModel {
        let turn = glam::Quat::from_rotation_y(0.5);
        let mut mesh = PatchMesh::default();
        let v = |x: f32, y: f32, z: f32| turn * Vec3::new(x, y, z);
        let sides = [
            [v(-2., 0., -2.), v(-2., 0., 2.), v(2., 0., 2.), v(2., 0., -2.)],
            [v(-2., 3., -2.), v(2., 3., -2.), v(2., 3., 2.), v(-2., 3., 2.)],
            [v(-2., 0., -2.), v(-2., 3., -2.), v(-2., 3., 2.), v(-2., 0., 2.)],
            [v(2., 0., -2.), v(2., 0., 2.), v(2., 3., 2.), v(2., 3., -2.)],
            [v(-2., 0., -2.), v(2., 0., -2.), v(2., 3., -2.), v(-2., 3., -2.)],
            [v(-2., 0., 2.), v(-2., 3., 2.), v(2., 3., 2.), v(2., 0., 2.)],
        ];
        sides.into_iter().for_each(|s| quad(&mut mesh, s, 1.0));
        if board {
            quad(&mut mesh, [v(0.0, 1.0, 0.0), v(0.0, 1.0, 1.0), v(1.0, 1.0, 1.0), v(1.0, 1.0, 0.0)], 0.0);
        }
        LightModel { mesh, distant: Vec::new() }
    }

    fn free_leaves(light: &LightModel, points: &[Vec3]) -> (LightField, Vec<bool>) {
        let field = LightField::new(&Light::all(light));
        let blockers = Blockers::new(&light.mesh);
        let free = blockers.free(&field, &blockers.sides(&field), points);
        let mut all = free.clone();
        for (i, node) in field.tree.nodes.iter().enumerate() {
            node.children.iter().flatten().for_each(|&c| all[c as usize] |= all[i]);
        }
        let leaf = |(n, &f): (&crate::transfer::tree::LightNode, &bool)| (n.leaves.len() == 1).then_some(f);
        let leaves = field.tree.nodes.iter().zip(&all).filter_map(leaf).collect();
        (field, leaves)
    }

    #[test]
    fn an_empty_convex_room_needs_no_rays_however_it_is_turned() {
        let light = scene(false);
        let (field, free) = free_leaves(&light, &[Vec3::new(0.3, 5e-4, 0.2), Vec3::new(0.5, 5e-4, -0.4)]);
        assert_eq!(free.len(), field.lights.len());
        assert!(free.iter().all(|&f| f));
    }

    #[test]
    fn what_is_called_free_is_free() {
        let light = scene(true);
        let points = [Vec3::new(0.3, 5e-4, -0.3), Vec3::new(0.4, 5e-4, -0.5)];
        let (field, free) = free_leaves(&light, &points);
        let bvh = Bvh::new(&light.mesh.vertices, &light.mesh.triangles());
        let mut hidden = 0;
        for (l, free) in field.lights.iter().zip(&free) {
            let Shape::Patch { corners, normal } = l.shape else { unreachable!() };
            for k in 0..200 {
                let y = super::super::sampling::on_triangle(
                    corners,
                    super::super::sampling::Shift::new(0, 1).point(k),
                );
                let blocked = points.iter().any(|&p| bvh.occluded(p, y + normal * 5e-4));
                hidden += usize::from(blocked);
                assert!(!(blocked && *free));
            }
        }
        assert!(hidden > 0, "the board hides something");
        assert!(free.iter().filter(|&&f| f).count() >= 2, "walls on this side stay free");
    }
}

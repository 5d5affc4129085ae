//! The patch mesh: Delaunay refinement of each planar face (Ruppert 1995, on spade's triangulation), with edges as
//! long as a size field allows.

use super::patch::{Evidence, Patch, PatchMesh};
use crate::model::face::Face;
use glam::Vec3;
use nalgebra::{Point3, Vector3};
use spade::handles::FixedVertexHandle;
use spade::{DelaunayTriangulation, Point2, Triangulation};

/// Circumradius over shortest edge that is refined away: angles stay above 20.7° where the face's own corners allow.
const MAX_RATIO: f64 = std::f64::consts::SQRT_2;
/// Coordinates on a face are multiples of this, m: midpoints of a rectangle's sides then lie exactly on them.
const GRAIN_M: f64 = 1.0 / (1 << 24) as f64;
/// Faces nearer to each other than this lie in one plane, m.
const COPLANAR_M: f64 = 1e-3;
/// Patches on one face, at most.
const MAX_VERTICES: usize = 200_000;

/// A triangulated face that can be refined further.
#[derive(Debug, Clone)]
pub struct FaceMesh {
    origin: Point3<f64>,
    axes: [Vector3<f64>; 2],
    normal: Vec3,
    triangulation: DelaunayTriangulation<Point2<f64>>,
    /// Sides of the face as cut so far: pairs of vertices.
    sides: Vec<[FixedVertexHandle; 2]>,
}

/// A triangle in the face's own plane.
type Corners = [Point2<f64>; 3];

impl FaceMesh {
    /// A convex face without added vertices; `None` where it has no area.
    pub fn new(face: &Face) -> Option<Self> {
        let area_vector = face.area_vector();
        let extent = face.vertices.iter().map(|v| (v - face.vertices[0]).norm()).fold(0.0, f64::max);
        let area = area_vector.norm();
        if area.is_nan() || area <= 1e-6 * extent * extent {
            return None;
        }
        let normal = area_vector.normalize();
        let origin = face.vertices[0];
        let u = face.vertices.iter().map(|v| v - origin).find(|e| e.norm() > 1e-3 * extent)?;
        let u = (u - normal * u.dot(&normal)).normalize();
        let axes = [u, normal.cross(&u)];
        let mut triangulation = DelaunayTriangulation::new();
        let mut corners: Vec<FixedVertexHandle> = Vec::new();
        for v in &face.vertices {
            let p = Point2::new(grain((v - origin).dot(&axes[0])), grain((v - origin).dot(&axes[1])));
            let handle = triangulation.insert(p).ok()?;
            if corners.last() != Some(&handle) && corners.first() != Some(&handle) {
                corners.push(handle);
            }
        }
        if corners.len() < 3 {
            return None;
        }
        let sides = (0..corners.len()).map(|i| [corners[i], corners[(i + 1) % corners.len()]]).collect();
        let normal = Vec3::new(normal.x as f32, normal.y as f32, normal.z as f32);
        Some(Self { origin, axes, normal, triangulation, sides })
    }

    /// Moves the face.
    pub fn shift(&mut self, by: Vec3) {
        self.origin += Vector3::new(f64::from(by.x), f64::from(by.y), f64::from(by.z));
    }

    /// Position in the world, m.
    pub fn world(&self, p: Point2<f64>) -> Vec3 {
        let w = self.point(p);
        Vec3::new(w.x as f32, w.y as f32, w.z as f32)
    }

    /// Splits until no edge is longer than `size` at its triangle's middle (world, m), and no angle is needlessly small.
    pub fn refine(&mut self, size: impl Fn(Vec3) -> f64) {
        loop {
            let long = self.sides.iter().position(|s| {
                let [a, b] = s.map(|v| self.position(v));
                length(a, b) > size(self.world(middle(a, b)))
            });
            match long {
                Some(i) if self.triangulation.num_vertices() < MAX_VERTICES => self.split_side(i),
                _ => break,
            }
        }
        // Worst triangles first; a triangle is gone once its circumcircle holds another vertex.
        loop {
            let mut bad: Vec<(f64, Corners)> = self
                .triangles()
                .filter_map(|t| {
                    let excess = self.badness(&t, &size);
                    (excess > 1.0).then_some((excess, t))
                })
                .collect();
            if bad.is_empty() || self.triangulation.num_vertices() >= MAX_VERTICES {
                return;
            }
            bad.sort_by(|a, b| b.0.total_cmp(&a.0));
            let mut changed = false;
            for (_, t) in bad {
                changed |= self.remove(&t);
            }
            if !changed {
                return;
            }
        }
    }

    /// Above 1 for a triangle with an edge too long, or with an angle too small.
    fn badness(&self, t: &Corners, size: &impl Fn(Vec3) -> f64) -> f64 {
        let edges = [length(t[0], t[1]), length(t[1], t[2]), length(t[2], t[0])];
        let longest = edges.iter().fold(0.0, |a: f64, b| a.max(*b));
        let shortest = edges.iter().fold(f64::MAX, |a: f64, b| a.min(*b));
        let target = size(self.world(centroid(t)));
        let ratio = circumcircle(t).map_or(f64::MAX, |(_, r)| r / shortest);
        // An acute corner of the face cannot be refined away.
        let quality = if shortest > target / 8.0 { ratio / MAX_RATIO } else { 0.0 };
        (longest / target).max(quality)
    }

    /// Inserts the circumcentre, or halves the side that it encroaches upon.
    fn remove(&mut self, t: &Corners) -> bool {
        let Some((centre, radius)) = circumcircle(t) else { return false };
        if self
            .triangulation
            .nearest_neighbor(centre)
            .is_none_or(|v| length(v.position(), centre) < 0.999 * radius)
        {
            return false;
        }
        let encroached = self.sides.iter().position(|s| {
            let [a, b] = s.map(|v| self.position(v));
            let inside = (a.x - centre.x) * (b.x - centre.x) + (a.y - centre.y) * (b.y - centre.y);
            // The far side of a border edge counts as encroached too: the centre must lie within the face.
            let outside = (b.x - a.x) * (centre.y - a.y) - (b.y - a.y) * (centre.x - a.x) <= 0.0;
            inside < 0.0 || (outside && on_chord(a, b, centre, t))
        });
        match encroached {
            Some(i) => self.split_side(i),
            None if self.contains(centre) => {
                let centre = Point2::new(grain(centre.x), grain(centre.y));
                return self.triangulation.insert(centre).is_ok();
            }
            None => return self.triangulation.insert(centroid(t)).is_ok(),
        }
        true
    }

    fn contains(&self, p: Point2<f64>) -> bool {
        self.sides.iter().all(|s| {
            let [a, b] = s.map(|v| self.position(v));
            (b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x) > 0.0
        })
    }

    fn split_side(&mut self, i: usize) {
        let [a, b] = self.sides[i];
        let m = middle(self.position(a), self.position(b));
        if let Ok(m) = self.triangulation.insert(m)
            && m != a
            && m != b
        {
            self.sides[i] = [a, m];
            self.sides.push([m, b]);
        }
    }

    fn position(&self, v: FixedVertexHandle) -> Point2<f64> {
        self.triangulation.vertex(v).position()
    }

    /// Triangles with area; a side that is not along an axis may have rounded midpoints just off it.
    fn triangles(&self) -> impl Iterator<Item = Corners> + '_ {
        self.triangulation.inner_faces().map(|f| f.positions()).filter(has_area)
    }

    /// Of the face, m².
    fn area(&self) -> f64 {
        let start = self.position(self.sides[0][0]);
        let parts =
            self.sides.iter().map(|s| doubled_area(&[start, self.position(s[0]), self.position(s[1])]));
        parts.sum::<f64>() / 2.0
    }

    /// A point of the face, m.
    fn point(&self, p: Point2<f64>) -> Point3<f64> {
        self.origin + self.axes[0] * p.x + self.axes[1] * p.y
    }

    /// Whether both lie in one plane and look to the same side.
    fn lies_on(&self, other: &Self) -> bool {
        let normal = self.axes[0].cross(&self.axes[1]);
        let corners = || other.sides.iter().map(|s| other.point(other.position(s[0])));
        self.normal.dot(other.normal) > 0.0
            && corners().all(|c| (c - self.origin).dot(&normal).abs() < COPLANAR_M)
    }

    /// Whether a point of the plane lies on the face or its border.
    fn covers(&self, p: &Point3<f64>) -> bool {
        let p = Point2::new((p - self.origin).dot(&self.axes[0]), (p - self.origin).dot(&self.axes[1]));
        self.sides.iter().all(|s| {
            let [a, b] = s.map(|v| self.position(v));
            doubled_area(&[a, b, p]) > -COPLANAR_M * length(a, b)
        })
    }

    /// Appends the patches of this face that do not wholly lie under one of those `above`.
    fn append(&self, face: u32, above: &[&Self], mesh: &mut PatchMesh) {
        let base = mesh.vertices.len() as u32;
        for v in self.triangulation.vertices() {
            mesh.vertices.push(self.world(v.position()));
            mesh.normals.push(self.normal);
        }
        for f in self.triangulation.inner_faces().filter(|f| has_area(&f.positions())) {
            let corners = f.positions().map(|p| self.point(p));
            if above.iter().any(|other| corners.iter().all(|c| other.covers(c))) {
                continue;
            }
            mesh.patches.push(Patch {
                vertices: f.vertices().map(|v| base + v.fix().index() as u32),
                face,
                radiance: [0.0; 3],
                reflectance: [0.0; 3],
                evidence: Evidence::Gathered,
            });
        }
    }
}

/// All faces as patches; those without area are left out, and what wholly lies under a smaller face in the same plane (a lamp
/// drawn on the ceiling): light is there once.
pub fn assemble(faces: &[Option<FaceMesh>]) -> PatchMesh {
    let mut mesh = PatchMesh::default();
    for (i, face) in faces.iter().enumerate() {
        let Some(face) = face else { continue };
        let others = faces.iter().enumerate().filter(|(j, _)| *j != i);
        let above: Vec<&FaceMesh> = others
            .filter_map(|(j, other)| {
                let other = other.as_ref()?;
                let smaller = (other.area(), j) < (face.area(), i);
                (smaller && other.lies_on(face)).then_some(other)
            })
            .collect();
        face.append(i as u32, &above, &mut mesh);
    }
    mesh
}

/// Longest edge at a place: `max_edge_m`, and far from the world's origin a tenth of the distance.
pub fn graded(max_edge_m: f64, p: Vec3) -> f64 {
    max_edge_m.max(0.1 * f64::from(p.length()))
}

fn grain(x: f64) -> f64 {
    (x / GRAIN_M).round() * GRAIN_M
}

fn length(a: Point2<f64>, b: Point2<f64>) -> f64 {
    (a.x - b.x).hypot(a.y - b.y)
}

fn middle(a: Point2<f64>, b: Point2<f64>) -> Point2<f64> {
    Point2::new((a.x + b.x) / 2.0, (a.y + b.y) / 2.0)
}

fn centroid(t: &Corners) -> Point2<f64> {
    Point2::new((t[0].x + t[1].x + t[2].x) / 3.0, (t[0].y + t[1].y + t[2].y) / 3.0)
}

fn doubled_area(t: &Corners) -> f64 {
    (t[1].x - t[0].x) * (t[2].y - t[0].y) - (t[1].y - t[0].y) * (t[2].x - t[0].x)
}

fn has_area(t: &Corners) -> bool {
    let longest = length(t[0], t[1]).max(length(t[1], t[2])).max(length(t[2], t[0]));
    doubled_area(t) > 1e-6 * longest * longest
}

fn circumcircle(t: &Corners) -> Option<(Point2<f64>, f64)> {
    let [a, b, c] = t;
    let (bx, by, cx, cy) = (b.x - a.x, b.y - a.y, c.x - a.x, c.y - a.y);
    let d = 2.0 * (bx * cy - by * cx);
    if d.abs() < f64::MIN_POSITIVE {
        return None;
    }
    let (b2, c2) = (bx * bx + by * by, cx * cx + cy * cy);
    let centre = Point2::new(a.x + (cy * b2 - by * c2) / d, a.y + (bx * c2 - cx * b2) / d);
    let radius = length(centre, *a);
    radius.is_finite().then_some((centre, radius))
}

/// Whether the way from the triangle's middle to `centre` crosses the side from `a` to `b`.
fn on_chord(a: Point2<f64>, b: Point2<f64>, centre: Point2<f64>, t: &Corners) -> bool {
    let m = centroid(t);
    let side = |p: Point2<f64>| doubled_area(&[m, centre, p]);
    side(a) * side(b) <= 0.0
}

#[cfg(test)]
#[path = "mesh_tests.rs"]
mod tests;

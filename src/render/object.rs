//! Triangles with normals and materials, made from whatever a file holds.

use super::{Problem, normals};
use glam::Vec3;
use std::collections::HashMap;
use std::path::PathBuf;

/// Diffuse and Phong-specular reflection (Lafortune and Willems 1994); `diffuse + specular ≤ 1` per channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Diffuse reflectance, linear Rec. 709.
    pub diffuse: [f32; 3],
    /// Share of light reflected into the lobe at normal incidence, linear Rec. 709.
    pub specular: [f32; 3],
    /// Phong exponent.
    pub shininess: f32,
    /// α of GGX, where the file has it.
    pub roughness: Option<f32>,
}

impl Material {
    /// Brings the reflectances into `0..=1` and their sum to at most 1; says whether that changed anything.
    pub fn conserving(mut self) -> (Self, bool) {
        let before = self;
        let bounded = |v: f32| if v.is_finite() { v.clamp(0.0, 1.0) } else { 0.0 };
        self.diffuse = self.diffuse.map(bounded);
        self.specular = self.specular.map(bounded);
        self.shininess = if self.shininess.is_finite() { self.shininess.clamp(0.0, 1e5) } else { 1e5 };
        for k in 0..3 {
            let sum = self.diffuse[k] + self.specular[k];
            if sum > 1.0 {
                self.diffuse[k] /= sum;
                self.specular[k] /= sum;
            }
        }
        (self, self != before)
    }

    /// Whether anything is reflected specularly.
    pub fn is_specular(&self) -> bool {
        self.specular.iter().any(|s| *s > 0.0)
    }
}

/// A triangle as a file gives it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triangle {
    /// Indices into [`Soup::positions`], counter-clockwise seen from the front.
    pub positions: [u32; 3],
    /// Normals of the corners, where the file has them.
    pub normals: Option<[Vec3; 3]>,
    /// Index into [`Soup::materials`].
    pub material: u32,
}

/// A file's content, before it is checked.
#[derive(Debug, Clone, Default)]
pub struct Soup {
    /// Vertex positions, m.
    pub positions: Vec<Vec3>,
    /// Triangles; polygons come as fans.
    pub triangles: Vec<Triangle>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Further files that were read (materials, buffers).
    pub files: Vec<PathBuf>,
    /// What of the file was left out or mended.
    pub warnings: Vec<String>,
}

impl Soup {
    /// Refuses indices out of range and positions that are not finite.
    pub fn check(&self) -> Result<(), Problem> {
        let vertices = self.positions.len();
        for (triangle, t) in self.triangles.iter().enumerate() {
            for index in t.positions {
                let Some(p) = self.positions.get(index as usize) else {
                    return Err(Problem::IndexOutOfRange { triangle, index, vertices });
                };
                if !p.is_finite() {
                    return Err(Problem::NotFinite { vertex: index as usize, position: p.to_array() });
                }
            }
        }
        Ok(())
    }

    /// Adds a polygon as a fan.
    pub fn add_polygon(&mut self, positions: &[u32], normals: Option<&[Vec3]>, material: u32) {
        for i in 2..positions.len() {
            let corners = [0, i - 1, i];
            self.triangles.push(Triangle {
                positions: corners.map(|c| positions[c]),
                normals: normals.map(|n| corners.map(|c| n[c])),
                material,
            });
        }
    }
}

/// A checked mesh: finite, in range, without degenerate triangles, a unit normal at every vertex.
#[derive(Debug, Clone)]
pub struct Object {
    /// Vertices, m.
    pub vertices: Vec<Vec3>,
    /// Unit shading normals of the vertices.
    pub normals: Vec<Vec3>,
    /// Vertex indices, counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
    /// For each triangle the index of its material.
    pub material_of: Vec<u32>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Every edge joins exactly two triangles of the same orientation.
    pub closed: bool,
    /// Further files that were read.
    pub files: Vec<PathBuf>,
    /// What was mended or left out.
    pub warnings: Vec<String>,
}

impl Object {
    /// Checks a file's content; normals that it lacks are smooth across edges below `smooth_rad`.
    pub fn new(mut soup: Soup, smooth_rad: f32) -> Result<Self, Problem> {
        soup.check()?;
        weld(&mut soup);
        let total = soup.triangles.len();
        let positions = &soup.positions;
        soup.triangles.retain(|t| has_area(t.positions.map(|i| positions[i as usize])));
        let degenerate = total - soup.triangles.len();
        if soup.triangles.is_empty() {
            return Err(Problem::Empty { vertices: soup.positions.len(), triangles: total, degenerate });
        }
        let mut warnings = std::mem::take(&mut soup.warnings);
        if degenerate > 0 {
            warnings.push(format!("{degenerate} of {total} triangles have no area and were left out"));
        }
        let closed = examine_edges(&mut soup, &mut warnings);
        let corner_normals = normals::corner_normals(&soup, smooth_rad);
        let mut object = Self {
            vertices: Vec::new(),
            normals: Vec::new(),
            triangles: Vec::with_capacity(soup.triangles.len()),
            material_of: soup.triangles.iter().map(|t| t.material).collect(),
            materials: soup.materials,
            closed,
            files: soup.files,
            warnings,
        };
        let mut index_of = HashMap::new();
        for (t, normals) in soup.triangles.iter().zip(&corner_normals) {
            object.triangles.push(std::array::from_fn(|c| {
                let (p, n) = (t.positions[c], normals[c]);
                *index_of.entry((p, bits(n))).or_insert_with(|| {
                    object.vertices.push(soup.positions[p as usize]);
                    object.normals.push(n);
                    object.vertices.len() as u32 - 1
                })
            }));
        }
        Ok(object)
    }

    /// The same object elsewhere; the motion is rigid.
    pub fn moved(&self, motion: &glam::Affine3A) -> Self {
        let mut moved = self.clone();
        moved.vertices.iter_mut().for_each(|v| *v = motion.transform_point3(*v));
        moved.normals.iter_mut().for_each(|n| *n = motion.transform_vector3(*n));
        moved
    }

    /// Corners of triangle `i`, m.
    pub fn corners(&self, i: usize) -> [Vec3; 3] {
        self.triangles[i].map(|v| self.vertices[v as usize])
    }

    /// Lowest and highest coordinates, m.
    pub fn bounds(&self) -> [Vec3; 2] {
        bounds(&self.vertices)
    }
}

/// Lowest and highest coordinates of points.
pub(super) fn bounds(points: &[Vec3]) -> [Vec3; 2] {
    points.iter().fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[a, b], p| [a.min(*p), b.max(*p)])
}

fn bits(v: Vec3) -> [u32; 3] {
    // + 0 makes −0 and 0 one.
    (v + Vec3::ZERO).to_array().map(f32::to_bits)
}

/// Gives vertices at the same place one index: files often repeat them where normals or colours differ.
fn weld(soup: &mut Soup) {
    let mut first = HashMap::new();
    let same: Vec<u32> =
        (0u32..).zip(&soup.positions).map(|(i, p)| *first.entry(bits(*p)).or_insert(i)).collect();
    for t in &mut soup.triangles {
        t.positions = t.positions.map(|i| same[i as usize]);
    }
}

/// Thinner than 1e-6 of its longest edge a triangle has no direction in single precision.
fn has_area([a, b, c]: [Vec3; 3]) -> bool {
    let longest = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    longest > 0.0 && (b - a).cross(c - a).length() > 1e-6 * longest
}

/// Whether the mesh is closed; turns a closed mesh that is inside out.
fn examine_edges(soup: &mut Soup, warnings: &mut Vec<String>) -> bool {
    // Per undirected edge: triangles that run along it, and those against it.
    let mut edges: HashMap<(u32, u32), [u32; 2]> = HashMap::new();
    for t in &soup.triangles {
        let [a, b, c] = t.positions;
        for (i, j) in [(a, b), (b, c), (c, a)] {
            edges.entry((i.min(j), i.max(j))).or_default()[usize::from(i > j)] += 1;
        }
    }
    let non_manifold = edges.values().filter(|[along, against]| along + against > 2).count();
    if non_manifold > 0 {
        warnings
            .push(format!("{non_manifold} edges join more than two triangles; the mesh is used as it is"));
    }
    let closed = edges.values().all(|sides| *sides == [1, 1]);
    if closed {
        let volume: f64 = soup
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.positions.map(|i| soup.positions[i as usize].as_dvec3());
                a.dot(b.cross(c)) / 6.0
            })
            .sum();
        if volume < 0.0 {
            warnings.push("the mesh is inside out; its triangles were turned".into());
            for t in &mut soup.triangles {
                t.positions.swap(1, 2);
                if let Some(n) = &mut t.normals {
                    n.swap(1, 2);
                }
            }
        }
    }
    closed
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) fn tetrahedron() -> Soup {
        let mut soup = Soup {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
            materials: vec![Material {
                diffuse: [0.5; 3],
                specular: [0.0; 3],
                shininess: 1.0,
                roughness: None,
            }],
            ..Soup::default()
        };
        for t in [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]] {
            soup.add_polygon(&t, None, 0);
        }
        soup
    }

    #[test]
    fn degenerate_triangles_are_dropped_and_counted() {
        let mut soup = tetrahedron();
        soup.add_polygon(&[0, 1, 1], None, 0);
        soup.positions.push(Vec3::X * 0.5);
        soup.add_polygon(&[0, 4, 1], None, 0);
        let object = Object::new(soup, 0.5).unwrap();
        assert_eq!(object.triangles.len(), 4);
        assert_eq!(object.warnings, ["2 of 6 triangles have no area and were left out"]);
        assert!(object.closed);
    }

    #[test]
    fn bad_meshes_are_refused_with_numbers() {
        let empty = Soup { positions: vec![Vec3::ZERO], ..Soup::default() };
        assert_eq!(
            Object::new(empty, 0.5).unwrap_err().to_string(),
            "the mesh is empty: 1 vertices, 0 triangles, 0 of them without area"
        );
        let mut soup = tetrahedron();
        soup.triangles[2].positions[1] = 9;
        assert_eq!(
            Object::new(soup, 0.5).unwrap_err(),
            Problem::IndexOutOfRange { triangle: 2, index: 9, vertices: 4 }
        );
        let mut soup = tetrahedron();
        soup.positions[3].y = f32::NAN;
        assert!(matches!(Object::new(soup, 0.5), Err(Problem::NotFinite { vertex: 3, .. })));
    }

    #[test]
    fn a_non_manifold_mesh_is_accepted() {
        let mut soup = tetrahedron();
        soup.positions.push(-Vec3::ONE);
        soup.add_polygon(&[0, 1, 4], None, 0);
        let object = Object::new(soup, 0.5).unwrap();
        assert!(!object.closed);
        assert_eq!(object.triangles.len(), 5);
        assert!(object.warnings[0].contains("join more than two triangles"), "{:?}", object.warnings);
    }

    #[test]
    fn an_inside_out_mesh_is_turned() {
        let mut soup = tetrahedron();
        soup.triangles.iter_mut().for_each(|t| t.positions.swap(0, 1));
        let object = Object::new(soup, 0.1).unwrap();
        assert_eq!(object.warnings.len(), 1);
        let centre = Vec3::splat(0.2);
        for (i, t) in object.triangles.iter().enumerate() {
            assert!(object.normals[t[0] as usize].dot(object.corners(i)[0] - centre) > 0.0);
        }
    }

    #[test]
    fn reflectances_are_brought_to_conserve_energy() {
        let (m, changed) = Material {
            diffuse: [0.9, 0.2, -1.0],
            specular: [0.9, 0.2, f32::NAN],
            shininess: 10.0,
            roughness: None,
        }
        .conserving();
        assert!(changed);
        assert_eq!(m.diffuse, [0.5, 0.2, 0.0]);
        assert_eq!(m.specular, [0.5, 0.2, 0.0]);
    }
}

//! Planar faces: what the scene model is made of, once its primitives are fitted.

use glam::Vec3;
use nalgebra::{Point3, Unit, Vector3};
use serde::{Deserialize, Serialize};

/// A planar, convex polygon, counter-clockwise seen from its front.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Face {
    /// `primitive.side`, e.g. `room.floor`, `desk.top`.
    pub name: String,
    /// Corners in the world, m.
    pub vertices: Vec<Point3<f64>>,
    /// What it mirrors besides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gloss: Option<Gloss>,
}

/// A surface's Phong lobe.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gloss {
    /// Specular reflectance, 0..1.
    pub specular: [f32; 3],
    /// Phong exponent, 0 or more.
    pub shininess: f32,
}

impl Gloss {
    /// Whether it is what a surface can have.
    pub fn is_sound(&self) -> bool {
        self.specular.iter().all(|s| (0.0..=1.0).contains(s)) && (0.0..=1e6).contains(&self.shininess)
    }
}

impl Face {
    /// Newell's normal, scaled to the area (m²); robust for any planar polygon.
    pub fn area_vector(&self) -> Vector3<f64> {
        let n = self.vertices.len();
        (0..n)
            .map(|i| self.vertices[i].coords.cross(&self.vertices[(i + 1) % n].coords))
            .sum::<Vector3<f64>>()
            / 2.0
    }

    /// Unit normal on the front side.
    pub fn normal(&self) -> Unit<Vector3<f64>> {
        Unit::new_normalize(self.area_vector())
    }

    /// Area, m².
    pub fn area(&self) -> f64 {
        self.area_vector().norm()
    }
}

/// All faces as one triangle soup.
#[derive(Debug, Clone, Default)]
pub struct FaceTriangles {
    /// Corners in the world, m.
    pub vertices: Vec<Vec3>,
    /// Fans of the faces.
    pub triangles: Vec<[u32; 3]>,
    /// For each triangle the index of its face.
    pub face_of: Vec<u32>,
}

/// Fans every face.
pub fn triangulate(faces: &[Face]) -> FaceTriangles {
    let mut out = FaceTriangles::default();
    for (f, face) in faces.iter().enumerate() {
        let base = out.vertices.len() as u32;
        out.vertices.extend(face.vertices.iter().map(|p| Vec3::new(p.x as f32, p.y as f32, p.z as f32)));
        for i in 2..face.vertices.len() as u32 {
            out.triangles.push([base, base + i - 1, base + i]);
            out.face_of.push(f as u32);
        }
    }
    out
}

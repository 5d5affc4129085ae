//! All light by one shape: patches and distant sources.

use super::SourceKind;
use super::boxes::Box3;
use crate::illuminate::patch::LightModel;
use crate::image::luminance;
use glam::Vec3;

/// Where a light is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Shape {
    /// A triangle, m, that shines to the side of its unit normal.
    Patch { corners: [Vec3; 3], normal: Vec3 },
    /// A disc of the sky: unit direction towards it, sr, rad.
    Distant { direction: Vec3, solid_angle: f32, angular_radius: f32 },
}

/// A patch or a distant source.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Light {
    pub kind: SourceKind,
    /// Plate units.
    pub radiance: [f32; 3],
    pub shape: Shape,
}

impl Light {
    pub fn new(light: &LightModel, kind: SourceKind) -> Self {
        let (radiance, shape) = match kind {
            SourceKind::Patch(i) => {
                let (i, mesh) = (i as usize, &light.mesh);
                let shape = Shape::Patch { corners: mesh.corners(i), normal: mesh.normal(i) };
                (mesh.patches[i].radiance, shape)
            }
            SourceKind::Distant(i) => {
                let d = &light.distant[i as usize];
                let (direction, solid_angle) = (d.direction, d.solid_angle_sr);
                (d.radiance, Shape::Distant { direction, solid_angle, angular_radius: d.angular_radius() })
            }
        };
        Self { kind, radiance, shape }
    }

    /// All lights of a model that shine.
    pub fn all(light: &LightModel) -> Vec<Self> {
        let patches = (0..light.mesh.patches.len() as u32).map(SourceKind::Patch);
        let distant = (0..light.distant.len() as u32).map(SourceKind::Distant);
        patches
            .chain(distant)
            .map(|kind| Self::new(light, kind))
            .filter(|l| l.radiance.iter().any(|&c| c > 0.0))
            .collect()
    }

    pub fn is_distant(&self) -> bool {
        matches!(self.shape, Shape::Distant { .. })
    }

    /// Box around its points, m, or around its directions.
    pub fn bounds(&self) -> Box3 {
        match self.shape {
            Shape::Patch { corners, .. } => Box3::of(corners),
            Shape::Distant { direction, angular_radius, .. } => {
                let reach = |c: f32| {
                    let from_axis = c.clamp(-1.0, 1.0).acos();
                    let low = (from_axis + angular_radius).min(std::f32::consts::PI).cos();
                    (low, (from_axis - angular_radius).max(0.0).cos())
                };
                let [x, y, z] = direction.to_array().map(reach);
                Box3 { min: Vec3::new(x.0, y.0, z.0), max: Vec3::new(x.1, y.1, z.1) }.grown(1e-6)
            }
        }
    }

    /// Centroid, m, or direction.
    pub fn centre(&self) -> Vec3 {
        match self.shape {
            Shape::Patch { corners: [a, b, c], .. } => (a + b + c) / 3.0,
            Shape::Distant { direction, .. } => direction,
        }
    }

    /// Where it shines to; 0 for distant light.
    pub fn normal(&self) -> Vec3 {
        match self.shape {
            Shape::Patch { normal, .. } => normal,
            Shape::Distant { .. } => Vec3::ZERO,
        }
    }

    /// Area, m², or solid angle, sr.
    pub fn extent(&self) -> f32 {
        match self.shape {
            Shape::Patch { corners: [a, b, c], .. } => (b - a).cross(c - a).length() / 2.0,
            Shape::Distant { solid_angle, .. } => solid_angle,
        }
    }

    /// Luminance × area, or luminance × solid angle.
    pub fn power(&self) -> f64 {
        f64::from(luminance(self.radiance)) * f64::from(self.extent())
    }
}

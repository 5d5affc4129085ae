//! What the ball showed: radiance by direction, with the ray along which each direction was seen.

use super::latlong;
use crate::artefact::exr::Planes;
use crate::image::{Image, Radiance, RadianceImage, luminance};
use glam::Vec3;

/// An equirectangular environment (OpenEXR `latlong`), each texel with its ray's origin on the ball.
#[derive(Debug, Clone, PartialEq)]
pub struct Environment {
    /// Radiance by direction, plate units.
    pub radiance: RadianceImage,
    /// Where on the ball the ray starts, world, m.
    pub origin: Vec<Vec3>,
    /// 1 where the ball shows the direction, 0 in the blind cone behind it, between at the outline's edge.
    pub weight: Vec<f32>,
}

impl Environment {
    /// Width and height, texels.
    pub fn size(&self) -> (usize, usize) {
        self.radiance.size()
    }

    /// Direction at the centre of texel `i`.
    pub fn direction(&self, i: usize) -> Vec3 {
        let (w, h) = self.size();
        latlong::direction((i % w) as f32 + 0.5, (i / w) as f32 + 0.5, w, h)
    }

    /// Solid angle of texel `i`, sr.
    pub fn solid_angle(&self, i: usize) -> f64 {
        let (w, h) = self.size();
        latlong::texel_solid_angle(i / w, w, h)
    }

    /// The texel that holds a direction.
    pub fn texel(&self, direction: Vec3) -> usize {
        let (w, h) = self.size();
        let (x, y) = latlong::pixel(direction, w, h);
        (y.max(0.0) as usize).min(h - 1) * w + (x.max(0.0) as usize).min(w - 1)
    }

    /// The texel that shows a point of the world. The ray's origin on the ball depends on its direction: three rounds settle
    /// it far below a texel.
    pub fn texel_towards(&self, point: Vec3) -> usize {
        let mut texel = self.texel((point - self.origin[0]).normalize_or(Vec3::Y));
        for _ in 0..3 {
            texel = self.texel((point - self.origin[texel]).normalize_or(Vec3::Y));
        }
        texel
    }

    /// Power per projected area from all directions, `∫ L dΩ`, by luminance.
    pub fn power(&self) -> f64 {
        let texels = self.radiance.pixels().iter().enumerate();
        texels.map(|(i, l)| f64::from(luminance(l.0)) * self.solid_angle(i)).sum()
    }

    /// The planes of `environment.exr`: R, G, B; X, Y, Z; weight.
    pub fn to_planes(&self) -> Planes {
        let origin = |k: usize| self.origin.iter().map(|o| o[k]).collect();
        Planes::from_radiance(&self.radiance)
            .with("X", origin(0))
            .with("Y", origin(1))
            .with("Z", origin(2))
            .with("weight", self.weight.clone())
    }

    /// From the planes of `environment.exr`; `None` if one is missing or the map is not twice as wide as high.
    pub fn from_planes(planes: &Planes) -> Option<Self> {
        let (x, y, z) = (planes.plane("X")?, planes.plane("Y")?, planes.plane("Z")?);
        let origin = (0..x.len()).map(|i| Vec3::new(x[i], y[i], z[i])).collect();
        let weight = planes.plane("weight")?.to_vec();
        (planes.width == 2 * planes.height).then_some(())?;
        Some(Self { radiance: planes.radiance()?, origin, weight })
    }

    /// An environment seen from one point, as a function of direction: for tests and for light that is known.
    pub fn from_fn(width: usize, origin: Vec3, f: impl Fn(Vec3) -> [f32; 3]) -> Self {
        let (w, h) = (width, width / 2);
        let radiance = Image::from_fn(w, h, |x, y| {
            Radiance(f(latlong::direction(x as f32 + 0.5, y as f32 + 0.5, w, h)))
        });
        Self { radiance, origin: vec![origin; w * h], weight: vec![1.0; w * h] }
    }
}

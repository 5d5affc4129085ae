//! Fisheye lenses: how far from the middle of the picture a direction is seen.

use super::{Environment, Unwrapped, latlong};
use crate::dome::Fisheye;
use crate::image::{Image, Radiance, RadianceImage, luminance};
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Towards the border of its field a lens vignettes and blurs: it is trusted fully this far inside, rad.
const BORDER: f64 = 0.02;
/// Samples along each side of a texel.
const SAMPLES: usize = 4;
/// A radius is found to this accuracy, focal lengths.
const CLOSE: f64 = 1e-10;

/// Distance r from the picture's middle, in focal lengths, of a direction at θ from the axis.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Projection {
    /// r = θ
    #[default]
    Equidistant,
    /// r = 2 sin θ/2: equal solid angles have equal areas.
    Equisolid,
    /// r = 2 tan θ/2: shapes are kept.
    Stereographic,
    /// r = θ (1 + k₁θ² + k₂θ⁴ + k₃θ⁶ + k₄θ⁸), as OpenCV calibrates (Kannala and Brandt 2006).
    Calibrated([f64; 4]),
}

impl Projection {
    /// r of an angle θ, rad.
    pub fn radius(self, angle: f64) -> f64 {
        match self {
            Self::Equidistant => angle,
            Self::Equisolid => 2.0 * (angle / 2.0).sin(),
            Self::Stereographic => 2.0 * (angle / 2.0).tan(),
            Self::Calibrated(k) => {
                let t = angle * angle;
                angle * (1.0 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3]))))
            }
        }
    }

    /// θ of a distance r; nothing where the lens shows nothing.
    pub fn angle(self, radius: f64) -> Option<f64> {
        match self {
            Self::Equidistant => Some(radius),
            Self::Equisolid => (radius <= 2.0).then(|| 2.0 * (radius / 2.0).asin()),
            Self::Stereographic => Some(2.0 * (radius / 2.0).atan()),
            Self::Calibrated(_) => {
                // The first angle of that radius: bisection up to where the radius is passed.
                let mut high =
                    (1..=64).map(|i| PI * f64::from(i) / 64.0).find(|a| self.radius(*a) >= radius)?;
                let mut low = high - PI / 64.0;
                while high - low > CLOSE {
                    let middle = 0.5 * (low + high);
                    if self.radius(middle) < radius { low = middle } else { high = middle }
                }
                Some(0.5 * (low + high))
            }
        }
    }
}

/// What a fisheye's picture shows, as an environment `width` px wide around the lens's place, world.
pub fn unwrap(
    lens: &Fisheye,
    place: Vec3,
    picture: &RadianceImage,
    clipped: &Image<bool>,
    width: usize,
) -> Unwrapped {
    let (width, height) = (width / 2 * 2, width / 2);
    let (w, h) = (picture.width() as f64, picture.height() as f64);
    let texels: Vec<([f32; 3], f32, f32)> = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let (mut sum, mut weights, mut lost) = ([0.0f64; 3], 0.0, 0.0);
            for s in 0..SAMPLES * SAMPLES {
                let at = |c: usize, k: usize| c as f32 + (k as f32 + 0.5) / SAMPLES as f32;
                let d =
                    latlong::direction(at(i % width, s % SAMPLES), at(i / width, s / SAMPLES), width, height);
                let Some(([x, y], angle)) = lens.pixel(d) else { continue };
                if !(0.0..w).contains(&x) || !(0.0..h).contains(&y) {
                    continue;
                }
                let weight = ((lens.half_field - angle) / BORDER).clamp(0.0, 1.0);
                let radiance = picture.bilinear(x, y).0;
                (0..3).for_each(|k| sum[k] += weight * f64::from(radiance[k].max(0.0)));
                lost += weight * f64::from(u8::from(*clipped.at(x as usize, y as usize)));
                weights += weight;
            }
            let mean = |v: f64| if weights > 0.0 { (v / weights) as f32 } else { 0.0 };
            (sum.map(mean), (weights / (SAMPLES * SAMPLES) as f64) as f32, mean(lost))
        })
        .collect();
    let solid_angle = |i: usize| latlong::texel_solid_angle(i / width, width, height);
    let power = |i: usize| f64::from(luminance(texels[i].0)) * solid_angle(i);
    let all: f64 = (0..texels.len()).map(power).sum();
    let lost: f64 = (0..texels.len()).map(|i| power(i) * f64::from(texels[i].2)).sum();
    let shown: f64 = (0..texels.len()).map(|i| solid_angle(i) * f64::from(texels[i].1)).sum();
    Unwrapped {
        clipped_power_share: if all > 0.0 { lost / all } else { 0.0 },
        blind_share: 1.0 - shown / (4.0 * PI),
        environment: Environment {
            radiance: Image::from_pixels(width, height, texels.iter().map(|t| Radiance(t.0)).collect()),
            origin: vec![place; width * height],
            weight: texels.iter().map(|t| t.1).collect(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Mat3;
    use proptest::prelude::*;

    const ALL: [Projection; 4] = [
        Projection::Equidistant,
        Projection::Equisolid,
        Projection::Stereographic,
        Projection::Calibrated([-0.02, 0.003, -0.001, 0.0001]),
    ];

    proptest! {
        #[test]
        fn angle_inverts_radius(angle in 0.0..1.6f64) {
            for lens in ALL {
                let again = lens.angle(lens.radius(angle)).unwrap();
                prop_assert!((again - angle).abs() < 1e-8, "{lens:?} {angle} {again}");
            }
        }
    }

    #[test]
    fn each_lens_shows_the_same_light() {
        let sky = |d: Vec3| {
            [1.0 + 0.5 * d.x, 1.0 + 0.3 * d.z, if d.angle_between(Vec3::Y) < 0.3 { 9.0 } else { 0.2 }]
        };
        for projection in ALL {
            let edge = projection.radius(1.5);
            let lens = Fisheye {
                projection,
                focal_px: 150.0 / edge,
                centre_px: [150.0; 2],
                half_field: 1.5,
                world_from_camera: Mat3::from_cols(Vec3::NEG_X, Vec3::Z, Vec3::Y),
            };
            let picture = Image::from_fn(300, 300, |x, y| {
                let d = lens.direction(x as f64 + 0.5, y as f64 + 0.5);
                Radiance(d.map_or([0.0; 3], sky))
            });
            let clipped = Image::from_fn(300, 300, |_, _| false);
            let seen = unwrap(&lens, Vec3::ZERO, &picture, &clipped, 128);
            let shown = 0.5 * (1.0 - 1.5f64.cos());
            assert!((seen.blind_share - (1.0 - shown)).abs() < 0.01, "{}", seen.blind_share);
            for i in 0..128 * 64 {
                let d = seen.environment.direction(i);
                let near_edge = d.angle_between(Vec3::Y) > 1.4;
                if near_edge || (d.angle_between(Vec3::Y) - 0.3).abs() < 0.08 {
                    continue;
                }
                let (a, b) = (seen.environment.radiance.pixels()[i].0, sky(d));
                assert!((0..3).all(|k| (a[k] - b[k]).abs() < 0.03), "{projection:?} {d} {a:?} {b:?}");
            }
        }
    }
}

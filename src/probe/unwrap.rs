//! From the ball's picture to the environment it reflects, by exact perspective geometry: for every direction the
//! point on the ball that reflects it to the camera, and the pixel that saw that point.

use super::{Environment, ProbeFit, Problem, latlong};
use crate::config;
use crate::image::{Image, Radiance, RadianceImage, luminance};
use glam::Vec3;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Reflections closer to the outline than this mix with what stands behind the ball, px.
const BLIND_PX: f64 = 1.0;
/// From here on a reflection is trusted fully, px from the outline.
const SURE_PX: f64 = 2.0;

/// The environment and what was lost in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Unwrapped {
    /// Radiance by direction.
    pub environment: Environment,
    /// Share of the environment's power that comes from pixels clipped in every exposure: it is brighter than that.
    pub clipped_power_share: f64,
    /// Share of the sphere that the ball does not show.
    pub blind_share: f64,
}

/// Point on the ball that reflects light from `direction` to the eye. Fixed point of "the normal halves the angle
/// between the view and the light", which contracts by radius / distance.
pub fn reflection_point(
    eye: &Point3<f64>,
    centre: &Point3<f64>,
    radius_m: f64,
    direction: &Vector3<f64>,
) -> Option<Point3<f64>> {
    let mut view = (eye - centre).normalize();
    let mut point = *centre;
    for _ in 0..50 {
        let normal = (view + direction).try_normalize(1e-9)?;
        let next = centre + normal * radius_m;
        let moved = (next - point).norm();
        point = next;
        view = (eye - point).normalize();
        if moved < 1e-9 * radius_m {
            break;
        }
    }
    Some(point)
}

/// Unwraps a merged picture of the ball; `clipped` marks pixels that no exposure holds.
pub fn unwrap(
    fit: &ProbeFit,
    picture: &RadianceImage,
    clipped: &Image<bool>,
    settings: &config::Probe,
) -> Result<Unwrapped, Problem> {
    if !settings.reflectivity.iter().all(|r| *r > 0.0 && *r <= 1.0) {
        return Err(Problem::Reflectivity(settings.reflectivity));
    }
    if settings.width_px < 16 {
        return Err(Problem::Width(settings.width_px));
    }
    let (width, height) = (settings.width_px / 2 * 2, settings.width_px / 2);
    let texels: Vec<Texel> = (0..width * height)
        .into_par_iter()
        .map(|i| texel(fit, picture, clipped, settings, (i % width, i / width), (width, height)))
        .collect();
    let solid_angle = |i: usize| latlong::texel_solid_angle(i / width, width, height);
    let power = |i: usize| f64::from(luminance(texels[i].radiance)) * solid_angle(i);
    let all: f64 = (0..texels.len()).map(power).sum();
    let lost: f64 = (0..texels.len()).map(|i| power(i) * f64::from(texels[i].clipped)).sum();
    let shown: f64 = (0..texels.len()).map(|i| solid_angle(i) * f64::from(texels[i].weight)).sum();
    Ok(Unwrapped {
        clipped_power_share: if all > 0.0 { lost / all } else { 0.0 },
        blind_share: 1.0 - shown / (4.0 * std::f64::consts::PI),
        environment: Environment {
            radiance: Image::from_pixels(
                width,
                height,
                texels.iter().map(|t| Radiance(t.radiance)).collect(),
            ),
            origin: texels.iter().map(|t| t.origin).collect(),
            weight: texels.iter().map(|t| t.weight).collect(),
        },
    })
}

struct Texel {
    radiance: [f32; 3],
    origin: Vec3,
    weight: f32,
    clipped: f32,
}

fn texel(
    fit: &ProbeFit,
    picture: &RadianceImage,
    clipped: &Image<bool>,
    settings: &config::Probe,
    (x, y): (usize, usize),
    (width, height): (usize, usize),
) -> Texel {
    let eye = fit.camera.centre();
    // Two samples per pixel where a texel spans many: at the ball's middle, a pixel turns the reflection by 2/R rad.
    let texel_px = std::f64::consts::TAU / width as f64 * fit.diameter_px / 4.0;
    let n = ((2.0 * texel_px).ceil() as usize).clamp(3, 32);
    let (mut sum, mut weights, mut lost) = ([0.0f64; 3], 0.0, 0.0);
    for s in 0..n * n {
        let at = |i: usize, k: usize| i as f32 + (k as f32 + 0.5) / n as f32;
        let d = latlong::direction(at(x, s % n), at(y, s / n), width, height);
        let d = Vector3::new(f64::from(d.x), f64::from(d.y), f64::from(d.z));
        let Some(point) = reflection_point(&eye, &fit.centre, fit.radius_m, &d) else { continue };
        let cosine = (eye - point).normalize().dot(&((point - fit.centre) / fit.radius_m)).clamp(0.0, 1.0);
        // In the picture the ball is nearly a disc, and the point lies at the sine of its angle from its middle.
        let from_outline_px = 0.5 * fit.diameter_px * (1.0 - (1.0 - cosine * cosine).sqrt());
        let weight = ((from_outline_px - BLIND_PX) / (SURE_PX - BLIND_PX)).clamp(0.0, 1.0);
        let Some(pixel) = fit.camera.project(&point) else { continue };
        let (w, h) = (picture.width() as f64, picture.height() as f64);
        if weight <= 0.0 || pixel.x < 0.0 || pixel.y < 0.0 || pixel.x > w || pixel.y > h {
            continue;
        }
        let radiance = picture.bilinear(pixel.x, pixel.y).0;
        (0..3).for_each(|k| sum[k] += weight * f64::from(radiance[k].max(0.0)) / settings.reflectivity[k]);
        let (px, py) =
            ((pixel.x as usize).min(picture.width() - 1), (pixel.y as usize).min(picture.height() - 1));
        lost += weight * f64::from(u8::from(*clipped.at(px, py)));
        weights += weight;
    }
    let d = latlong::direction(x as f32 + 0.5, y as f32 + 0.5, width, height);
    let d = Vector3::new(f64::from(d.x), f64::from(d.y), f64::from(d.z));
    let origin =
        reflection_point(&eye, &fit.centre, fit.radius_m, &d).unwrap_or(fit.centre + d * fit.radius_m);
    Texel {
        radiance: if weights > 0.0 { sum.map(|s| (s / weights) as f32) } else { [0.0; 3] },
        origin: Vec3::new(origin.x as f32, origin.y as f32, origin.z as f32),
        weight: (weights / (n * n) as f64) as f32,
        clipped: if weights > 0.0 { (lost / weights) as f32 } else { 0.0 },
    }
}

#[cfg(test)]
#[path = "unwrap_tests.rs"]
mod tests;

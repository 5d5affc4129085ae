//! Prefiltered environments (Heidrich and Seidel 1999): the mean radiance under a kernel about every axis.

use super::environment::Environment;
use crate::artefact::exr::Planes;
use crate::illuminate::patch::LightModel;
use crate::image::{Image, Radiance, RadianceImage};
use crate::probe::latlong;
use crate::subtractive::ggx_distribution as distribution;
use crate::visibility::Bvh;
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::PI;

/// Roughness α of GGX, and exponents of Phong, of the levels of `prefiltered.exr`.
const ROUGHNESS: [f32; 4] = [0.1, 0.2, 0.4, 0.8];
const EXPONENTS: [f32; 4] = [1000.0, 200.0, 50.0, 10.0];

/// Width of `prefiltered.exr`, px.
const WIDTH: usize = 128;

/// The planes of `prefiltered.exr`: the environment at a place, cast from the patch mesh and a picture of
/// the distant light, and under each lobe.
pub fn prefiltered(light: &LightModel, sky: Option<&RadianceImage>, place: Vec3) -> Planes {
    let bvh = Bvh::new(&light.mesh.vertices, &light.mesh.triangles());
    levels(&Environment::cast_under(light, sky, &bvh, place, WIDTH, WIDTH / 2))
}

/// An environment under each lobe as seen head-on, normalised, by direction of the lobe's axis; layers `ggx_ALPHA` and
/// `phong_EXPONENT`.
fn levels(environment: &Environment) -> Planes {
    let (width, height) = environment.map.size();
    let mut planes = Planes::from_radiance(&environment.map);
    let ggx = ROUGHNESS.map(|a| (format!("ggx_{a}"), Prefiltered::ggx(environment, a)));
    let phong = EXPONENTS.map(|n| (format!("phong_{n}"), Prefiltered::phong(environment, n)));
    for (name, level) in ggx.into_iter().chain(phong) {
        let means: Vec<[f32; 3]> =
            (0..width * height).map(|i| level.radiance(environment.texel(i).0)).collect();
        for (k, channel) in ["R", "G", "B"].into_iter().enumerate() {
            planes = planes.with(&format!("{name}.{channel}"), means.iter().map(|m| m[k]).collect());
        }
    }
    planes
}

/// Means of an environment by direction of a kernel's axis: a `latlong` map.
#[derive(Debug, Clone)]
pub struct Prefiltered {
    map: RadianceImage,
}

impl Prefiltered {
    /// By direct summation over all texels. `kernel` is a function of the cosine of the angle α from the axis, of any scale,
    /// falls from there as 1 − n α²/2, and is 0 where the cosine is at most `cut`.
    pub fn new(environment: &Environment, n: f32, cut: f32, kernel: impl Fn(f32) -> f32 + Sync) -> Self {
        let (w, h) = environment.map.size();
        // A broad kernel needs few axes: lines between axes h apart cut h² n/8 off a peak, at most 2 % here.
        let width = ((16.0 * n.sqrt()) as usize).next_power_of_two().max(32);
        let (width, height) = (w.min(width), h.min(width / 2));
        let texels: Vec<(Vec3, f32)> = (0..w * h).map(|i| environment.texel(i)).collect();
        let mean = |i: usize| {
            let axis = latlong::direction((i % width) as f32 + 0.5, (i / width) as f32 + 0.5, width, height);
            let (mut sum, mut total) = ([0.0f64; 3], 0.0f64);
            // Rows that a narrow kernel reaches.
            let (polar, reach) = (axis.y.clamp(-1.0, 1.0).acos(), cut.clamp(-1.0, 1.0).acos());
            let row = |angle: f32| (angle / PI * h as f32).clamp(0.0, h as f32);
            let rows = row(polar - reach).floor() as usize * w..row(polar + reach).ceil() as usize * w;
            let near = texels[rows.clone()].iter().zip(&environment.map.pixels()[rows]);
            for ((direction, solid_angle), radiance) in near {
                let cos = axis.dot(*direction).min(1.0);
                if cos > cut {
                    let weight = f64::from(kernel(cos) * solid_angle);
                    total += weight;
                    (0..3).for_each(|k| sum[k] += weight * f64::from(radiance.0[k]));
                }
            }
            if total > 0.0 {
                return Radiance(sum.map(|v| (v / total) as f32));
            }
            // A kernel narrower than a texel mirrors.
            latlong::lookup(&environment.map, axis)
        };
        let pixels = (0..width * height).into_par_iter().map(mean).collect();
        Self { map: Image::from_pixels(width, height, pixels) }
    }

    /// Under GGX's lobe of roughness α, seen along the normal.
    pub fn ggx(environment: &Environment, roughness: f32) -> Self {
        // The facet that mirrors a light at an angle from the normal stands at half of it.
        let kernel = |cos: f32| distribution(((1.0 + cos) / 2.0).sqrt(), roughness) * cos;
        Self::new(environment, roughness.max(1e-3).powi(-2), 0.0, kernel)
    }

    /// Under Phong's lobe, cosⁿ of the angle from the axis.
    pub fn phong(environment: &Environment, exponent: f32) -> Self {
        let cut = 1e-6f32.powf(1.0 / exponent.max(1e-3));
        Self::new(environment, exponent, cut, |cos| cos.powf(exponent))
    }

    /// The mean about a unit axis: bilinear, around the seam.
    pub fn radiance(&self, axis: Vec3) -> [f32; 3] {
        latlong::lookup(&self.map, axis).0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_keep_even_light_and_spread_a_lamp_the_more_the_rougher() {
        let even = Environment { map: Image::from_fn(64, 32, |_, _| Radiance([2.0, 1.0, 0.5])) };
        for (name, plane) in &levels(&even).channels {
            let truth = if name.ends_with('R') {
                2.0
            } else if name.ends_with('G') {
                1.0
            } else {
                0.5
            };
            assert!(plane.iter().all(|v| (v / truth - 1.0).abs() < 1e-3), "{name}");
        }
        let towards = Vec3::new(0.6, 0.64, 0.48).normalize();
        let lamp = |i: usize| latlong::direction((i % 64) as f32 + 0.5, (i / 64) as f32 + 0.5, 64, 32);
        let lit = Environment {
            map: Image::from_fn(64, 32, |x, y| {
                Radiance([if lamp(y * 64 + x).angle_between(towards) < 0.15 { 100.0 } else { 0.0 }; 3])
            }),
        };
        let planes = levels(&lit);
        let peak = |name: &str| planes.plane(name).unwrap().iter().copied().fold(0.0, f32::max);
        let peaks: Vec<f32> =
            ["R", "ggx_0.1.R", "ggx_0.2.R", "ggx_0.4.R", "ggx_0.8.R"].iter().map(|n| peak(n)).collect();
        assert!(peaks.windows(2).all(|p| p[0] > p[1]) && peaks[4] > 0.0, "{peaks:?}");
        assert!(peak("phong_1000.R") > peak("phong_10.R"));
    }
}

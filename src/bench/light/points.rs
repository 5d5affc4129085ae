//! Irradiance at the ball and at the truth's points.

use super::Judged;
use crate::error::{Context as _, Result};
use crate::image::luminance;
use crate::irradiance::Beams;
use crate::render;
use crate::sh;
use glam::Vec3;

/// Normals over which irradiance is compared: many more than harmonics.
const NORMALS: usize = 256;

/// Errors over the truth's points.
pub(super) struct Errors {
    /// RMS over points, normals and channels, of the true RMS.
    pub all: f64,
    /// The largest at one point.
    pub worst: f64,
    pub worst_at: Vec3,
    /// Excess of all irradiance.
    pub bias: f64,
}

/// Harmonics of irradiance at all points of the truth.
pub(super) fn judge(judged: &Judged) -> Result<Errors> {
    let points = judged.truth.irradiance(judged.scale).doing("reading the irradiance of the truth")?;
    let beams = Beams::new(&judged.light.distant, &judged.light_bvh);
    let mut errors = Errors { all: 0.0, worst: 0.0, worst_at: Vec3::ZERO, bias: 0.0 };
    let (mut square, mut signal, mut found, mut there) = (0.0, 0.0, 0.0, 0.0);
    for point in &points {
        let (soft, hard) = (judged.volume.harmonics(point.position), beams.harmonics(point.position));
        let all = std::array::from_fn(|i| std::array::from_fn(|k| soft[i][k] + hard[i][k]));
        let irradiance = sh::convolved(&all);
        let (mut d, mut s) = (0.0, 0.0);
        for i in 0..NORMALS {
            let normal = sh::sphere_direction(i, NORMALS);
            let (ours, truth) = (sh::evaluate(&irradiance, normal), point.on(normal));
            for k in 0..3 {
                let (a, b) = (f64::from(ours[k]), f64::from(truth[k]));
                d += (a - b).powi(2);
                s += b * b;
                found += a;
                there += b;
            }
        }
        if d / s > errors.worst {
            (errors.worst, errors.worst_at) = (d / s, point.position);
        }
        square += d;
        signal += s;
    }
    errors.worst = errors.worst.sqrt();
    errors.all = (square / signal).sqrt();
    errors.bias = found / there - 1.0;
    Ok(errors)
}

/// Relative error, by luminance, of irradiance at the ball's centre on surfaces along ±x, ±y, ±z.
pub(super) fn axes(judged: &Judged) -> [f64; 6] {
    let truth = render::Environment { map: judged.environment.radiance.clone() };
    let (w, h) = judged.environment.size();
    let centre = judged.environment.origin[0];
    let ours = render::Environment::cast(&judged.light, &judged.light_bvh, centre, w, h);
    [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z].map(|axis| {
        let [a, b] = [&ours, &truth].map(|e| f64::from(luminance(e.irradiance(axis))));
        a / b - 1.0
    })
}

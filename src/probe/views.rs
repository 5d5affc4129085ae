//! Several views of one ball: what one hides, another shows. Weighted by resolution; the blind cone, and the part of each view that
//! shows who took it, are left to the others.

use super::{Environment, ProbeFit, Unwrapped};
use crate::image::{Image, Radiance, luminance};
use glam::Vec3;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// The photographer counts so little that another view takes over wherever there is one.
const PHOTOGRAPHER_WEIGHT: f64 = 1e-4;
/// Weights run over from one view to the other within this share of the photographer's angle.
const SOFT: f64 = 0.5;
/// Both views must show a direction this well to be compared there.
const SURE: f32 = 0.95;
/// Azimuths that are tried, and the steps of the search that follows, rad.
const AZIMUTHS: usize = 72;
const FIRST_STEP: f64 = 0.06;
const LAST_STEP: f64 = 5e-4;

/// One view, unwrapped.
#[derive(Debug, Clone)]
pub struct View {
    /// Camera and ball.
    pub fit: ProbeFit,
    /// What it shows.
    pub seen: Unwrapped,
}

impl View {
    /// Direction towards the camera.
    fn towards_camera(&self) -> Vec3 {
        let d = (self.fit.camera.centre() - self.fit.centre).normalize();
        Vec3::new(d.x as f32, d.y as f32, d.z as f32)
    }

    /// Weight of a texel: resolution, blind cone, photographer within `angle`, rad.
    fn weight(&self, i: usize, camera: Vec3, angle: f64) -> f64 {
        let environment = &self.seen.environment;
        let d = environment.direction(i);
        let trust = f64::from(environment.weight[i]) * self.fit.blur(d).powi(-2);
        let inside = (1.0 + SOFT - f64::from(d.angle_between(camera)) / angle.max(1e-9)) / SOFT;
        let photographer = inside.clamp(0.0, 1.0);
        trust * (1.0 - photographer * (1.0 - PHOTOGRAPHER_WEIGHT))
    }
}

/// All views as one environment; `photographer` is the angle around the direction to each camera that shows who took it, rad.
/// A single view stays as it is.
pub fn combine(views: &[View], photographer: f64) -> Option<Unwrapped> {
    let first = views.first()?;
    if views.len() == 1 {
        return Some(first.seen.clone());
    }
    let (w, h) = first.seen.environment.size();
    let cameras: Vec<Vec3> = views.iter().map(View::towards_camera).collect();
    let texels: Vec<(Radiance, Vec3, f32)> = (0..w * h)
        .into_par_iter()
        .map(|i| {
            let weights: Vec<f64> =
                views.iter().zip(&cameras).map(|(v, c)| v.weight(i, *c, photographer)).collect();
            let all: f64 = weights.iter().sum();
            let best = (0..views.len()).max_by(|a, b| weights[*a].total_cmp(&weights[*b])).unwrap_or(0);
            let origin = views[best].seen.environment.origin[i];
            if all <= 0.0 {
                return (Radiance::default(), origin, 0.0);
            }
            let mut sum = [0.0f64; 3];
            for (v, weight) in views.iter().zip(&weights) {
                let l = v.seen.environment.radiance.pixels()[i].0;
                (0..3).for_each(|k| sum[k] += weight * f64::from(l[k]));
            }
            let shown = views.iter().map(|v| v.seen.environment.weight[i]).fold(0.0, f32::max);
            (Radiance(sum.map(|s| (s / all) as f32)), origin, shown)
        })
        .collect();
    let environment = Environment {
        radiance: Image::from_pixels(w, h, texels.iter().map(|t| t.0).collect()),
        origin: texels.iter().map(|t| t.1).collect(),
        weight: texels.iter().map(|t| t.2).collect(),
    };
    let shown: f64 = (0..w * h).map(|i| environment.solid_angle(i) * f64::from(environment.weight[i])).sum();
    Some(Unwrapped {
        clipped_power_share: views.iter().map(|v| v.seen.clipped_power_share).fold(0.0, f64::max),
        blind_share: 1.0 - shown / (4.0 * std::f64::consts::PI),
        environment,
    })
}

/// Median luminance of a view over that of another where both show the same, outside of both photographers.
pub fn ratio(a: &View, b: &View, photographer: f64) -> Option<f64> {
    let cameras = [a.towards_camera(), b.towards_camera()];
    let (x, y) = (&a.seen.environment, &b.seen.environment);
    let sure = |i: &usize| {
        let clear = |c: &Vec3| f64::from(x.direction(*i).angle_between(*c)) > (1.0 + SOFT) * photographer;
        x.weight[*i] > SURE && y.weight[*i] > SURE && cameras.iter().all(clear)
    };
    let light = |e: &Environment, i: usize| f64::from(luminance(e.radiance.pixels()[i].0));
    let mut ratios: Vec<f64> = (0..x.weight.len())
        .filter(sure)
        .map(|i| light(x, i) / light(y, i))
        .filter(|r| r.is_finite() && *r > 0.0)
        .collect();
    ratios.sort_by(f64::total_cmp);
    ratios.get(ratios.len() / 2).copied()
}

/// A view's camera turned about the ball's centre.
pub fn turned(fit: &ProbeFit, turn: &UnitQuaternion<f64>) -> ProbeFit {
    let centre = Translation3::from(fit.centre.coords);
    let about = centre * turn * centre.inverse();
    let mut fit = fit.clone();
    let pose: Isometry3<f64> = about * fit.camera.world_from_camera;
    fit.camera.world_from_camera = pose;
    fit
}

/// The turn that brings what a view shows over what another shows, and how well they then agree (correlation of log
/// luminance): all azimuths are tried, then the best is refined about three axes.
pub fn turn(view: &View, onto: &View, photographer: f64) -> (UnitQuaternion<f64>, f64) {
    let maps = [onto, view].map(Logarithms::new);
    let cameras = [onto, view].map(View::towards_camera);
    let score = |turn: &UnitQuaternion<f64>| correlation(&maps, cameras, photographer, turn);
    let about = |axis: usize, angle: f64| {
        let mut v = Vector3::zeros();
        v[axis] = angle;
        UnitQuaternion::new(v)
    };
    let step = std::f64::consts::TAU / AZIMUTHS as f64;
    let start = (0..AZIMUTHS).map(|i| about(1, i as f64 * step)).map(|t| (score(&t), t));
    let Some((mut best, mut turn)) = start.max_by(|a, b| a.0.total_cmp(&b.0)) else {
        return (UnitQuaternion::identity(), 0.0);
    };
    let mut step = FIRST_STEP;
    while step > LAST_STEP {
        let tries = (0..6).map(|k| about(k / 2, if k % 2 == 0 { step } else { -step }) * turn);
        match tries.map(|t| (score(&t), t)).max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((better, t)) if better > best => (best, turn) = (better, t),
            _ => step /= 2.0,
        }
    }
    (turn, best)
}

/// Log luminance of an environment; nothing where it is not shown.
struct Logarithms<'a> {
    environment: &'a Environment,
    values: Vec<f32>,
}

impl<'a> Logarithms<'a> {
    fn new(view: &'a View) -> Self {
        let environment = &view.seen.environment;
        let values = environment.radiance.pixels().iter().map(|p| p.luminance().max(1e-6).ln()).collect();
        Self { environment, values }
    }

    fn at(&self, d: Vec3) -> Option<f32> {
        let (w, h) = self.environment.size();
        let mut sum = 0.0;
        for (i, weight) in super::latlong::neighbours(d, w, h) {
            if self.environment.weight[i] < SURE {
                return None;
            }
            sum += weight * self.values[i];
        }
        Some(sum)
    }
}

fn correlation(
    [onto, view]: &[Logarithms; 2],
    cameras: [Vec3; 2],
    photographer: f64,
    turn: &UnitQuaternion<f64>,
) -> f64 {
    let back = turn.inverse();
    let clear = |d: Vec3, camera: Vec3| f64::from(d.angle_between(camera)) > (1.0 + SOFT) * photographer;
    let mut sums = [0.0f64; 6];
    for i in 0..onto.values.len() {
        let d = onto.environment.direction(i);
        let b = back * Vector3::new(f64::from(d.x), f64::from(d.y), f64::from(d.z));
        let b = Vec3::new(b.x as f32, b.y as f32, b.z as f32);
        if onto.environment.weight[i] < SURE || !clear(d, cameras[0]) || !clear(b, cameras[1]) {
            continue;
        }
        let Some(y) = view.at(b) else { continue };
        let (x, y, w) = (f64::from(onto.values[i]), f64::from(y), onto.environment.solid_angle(i));
        for (sum, v) in sums.iter_mut().zip([1.0, x, y, x * x, y * y, x * y]) {
            *sum += w * v;
        }
    }
    let [n, x, y, xx, yy, xy] = sums;
    let spread = (xx / n - (x / n).powi(2)) * (yy / n - (y / n).powi(2));
    if n > 0.0 && spread > 0.0 { (xy / n - x * y / (n * n)) / spread.sqrt() } else { 0.0 }
}

#[cfg(test)]
#[path = "views_tests.rs"]
mod tests;

//! A light that no exposure of the probe holds: how much of it is missing shows in the ball's own shadow.
//!
//! A point x of the surface around the ball has radiance B = ρ/π (E_rest + g E_clipped), E_clipped being the irradiance
//! of the clipped pixels as they were measured and g ≥ 1 the gain sought. Where the ball hides the light only E_rest is
//! left; that tells ρ, and the lit surface beside the shadow then tells g. What the ball hides of all other light, and
//! what it reflects onto the surface, is taken into account; all light counts as distant.

use super::consistency::Surface;
use super::unwrap::{self, Unwrapped};
use super::{Environment, ProbeFit, Problem, mirror_ball};
use crate::config;
use crate::image::{Image, Radiance, RadianceImage};
use crate::merge::{Merged, median};
use nalgebra::{Point2, Point3, Vector3};
use rand::{Rng, SeedableRng, rngs::SmallRng};
use rayon::prelude::*;

/// A texel that sends more than this share of all power is a source of its own; the rest is summed in coarse cells.
const STRONG_SHARE: f64 = 1e-3;
/// Texels of the environment along each side of a coarse cell.
const CELL: usize = 8;
/// Clipped light further spread than this (angle from its middle, rad) casts no single shadow.
const MAX_SPREAD: f64 = 0.2;
/// A light lower than this (sine of its elevation) throws its shadow too far.
const MIN_ELEVATION: f64 = 0.15;
/// The lit surface is taken up to this angle from the ball's limb, rad: near the shadow, so that the texture is the same.
const LIT_WITHIN: f64 = 0.5;
/// Beyond so many radii from the ball nothing is compared.
const REACH: f64 = 4.0;
/// Pixels needed in shadow and in light.
const MIN_PIXELS: usize = 60;
/// Of so many pixels (about) of the picture the irradiance is found.
const PIXELS: f64 = 3000.0;
/// Resamplings of the bootstrap.
const RESAMPLES: u64 = 200;
/// The light must stand out of its own uncertainty by this factor.
const MIN_SIGNIFICANCE: f64 = 3.0;

/// Of a smaller share of all power nothing is said where it cannot be restored.
const UNIMPORTANT: f64 = 0.01;

/// What the clipped pixels must be multiplied by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gain {
    /// Per channel, as estimated: below 1 by noise alone.
    pub gain: [f64; 3],
    /// Standard deviation, by bootstrap over parts of the surface.
    pub sigma: [f64; 3],
    /// Pixels compared, in shadow and in light.
    pub pixels: [usize; 2],
}

impl Gain {
    /// What the clipped pixels are multiplied by: at least 1.
    pub fn applied(&self) -> [f64; 3] {
        self.gain.map(|g| g.max(1.0))
    }
}

/// Why the shadow tells nothing.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Unusable {
    /// More lights than one, or a large one.
    #[error("the clipped light is {:.0}° wide or there are several", 2.0 * .0.to_degrees())]
    Spread(f64),
    /// Below or near the horizon.
    #[error("the clipped light stands too low to cast a shadow beside the ball")]
    Low,
    /// Hidden by the ball, off the picture, on the grid.
    #[error(
        "{0} px show the ball's shadow and {1} px lit surface beside it, {MIN_PIXELS} of each are needed"
    )]
    FewPixels(usize, usize),
    /// Nothing is darker where the shadow should be.
    #[error("the surface shows no shadow of the ball where that light would cast it")]
    NoShadow,
}

/// Light from one direction.
struct Source {
    direction: Vector3<f64>,
    /// Radiance × solid angle.
    power: [f64; 3],
}

/// A point of the surface that the picture shows.
struct Sample {
    radiance: [f64; 3],
    rest: [f64; 3],
    clipped: [f64; 3],
    lit: bool,
    /// Part of the surface it lies in.
    block: (i32, i32),
}

/// Gives the light that no exposure holds the power that its shadow tells, and never less than was measured; says what
/// the shadow tells, or why it tells nothing.
pub fn restore(
    fit: &ProbeFit,
    merged: &Merged,
    surface: &Surface,
    settings: &config::Probe,
    unwrapped: &mut Unwrapped,
) -> Result<Result<Gain, Unusable>, Problem> {
    let (w, h) = merged.radiance.size();
    let only = Image::from_fn(w, h, |x, y| {
        if *merged.clipped.at(x, y) { *merged.radiance.at(x, y) } else { Radiance::default() }
    });
    let lost = unwrap::unwrap(fit, &only, &merged.clipped, settings)?.environment;
    let environment = &mut unwrapped.environment;
    let found = gain(fit, &merged.radiance, [environment, &lost], surface, settings.reflectivity);
    if let Ok(found) = &found {
        let gain = found.applied();
        for (l, part) in environment.radiance.pixels_mut().iter_mut().zip(lost.radiance.pixels()) {
            (0..3).for_each(|k| l.0[k] += (gain[k] - 1.0) as f32 * part.0[k]);
        }
    }
    Ok(found)
}

/// What a person should know of light that no exposure holds; `share` is its part of all power as measured.
pub fn warning(share: f64, found: &Result<Gain, Unusable>) -> Option<String> {
    let percent = 100.0 * share;
    match found {
        Ok(found) => {
            let [r, g, b] = found.applied();
            let sigma = found.sigma.into_iter().fold(0.0, f64::max);
            Some(format!(
                "{percent:.0} % of the light is clipped in every exposure of the probe; by the ball's shadow it was \
                 raised by {r:.2} {g:.2} {b:.2} (± {sigma:.2}): a shorter exposure would be surer"
            ))
        }
        Err(why) if share > UNIMPORTANT => Some(format!(
            "{percent:.0} % of the light is clipped in every exposure of the probe, so there is more, and the ball's \
             shadow does not tell how much: {why}; add a shorter exposure"
        )),
        Err(_) => None,
    }
}

/// Estimates the gain. `all` is the environment as measured, `clipped` what of it comes from clipped pixels.
fn gain(
    fit: &ProbeFit,
    picture: &RadianceImage,
    [all, clipped]: [&Environment; 2],
    surface: &Surface,
    reflectivity: [f64; 3],
) -> Result<Gain, Unusable> {
    let lost = sources(clipped, None);
    let rest = sources(all, Some(clipped));
    let middle: Vector3<f64> = lost.iter().map(|s| s.direction * s.power.iter().sum::<f64>()).sum();
    let middle = middle.try_normalize(1e-12).ok_or(Unusable::Low)?;
    let spread = lost.iter().map(|s| s.direction.angle(&middle)).fold(0.0, f64::max);
    if spread > MAX_SPREAD {
        return Err(Unusable::Spread(spread));
    }
    if middle.y < MIN_ELEVATION {
        return Err(Unusable::Low);
    }
    let ball = Ball { centre: fit.centre, radius: fit.radius_m, reflectivity };
    let samples: Vec<Sample> = visible(fit, picture, surface)
        .into_par_iter()
        .filter_map(|(x, radiance)| {
            let lit = ball.side(&x, &middle, spread)?;
            let block = |v: f64| (2.0 * v / fit.radius_m).floor() as i32;
            Some(Sample {
                radiance,
                rest: ball.irradiance(&x, &rest),
                clipped: ball.irradiance(&x, &lost),
                lit,
                block: (block(x.x), block(x.z)),
            })
        })
        .collect();
    let (bright, dark): (Vec<Sample>, Vec<Sample>) = samples.into_iter().partition(|s| s.lit);
    if bright.len() < MIN_PIXELS || dark.len() < MIN_PIXELS {
        return Err(Unusable::FewPixels(dark.len(), bright.len()));
    }
    let gain =
        [0, 1, 2].map(|k| solve(&dark.iter().collect::<Vec<_>>(), &bright.iter().collect::<Vec<_>>(), k));
    let sigma = bootstrap(&dark, &bright);
    if (0..3).any(|k| !gain[k].is_finite() || gain[k] < MIN_SIGNIFICANCE * sigma[k]) {
        return Err(Unusable::NoShadow);
    }
    Ok(Gain { gain, sigma, pixels: [dark.len(), bright.len()] })
}

/// The gain by one channel: reflectance from the shadow, then the light's share in the lit surface.
fn solve(dark: &[&Sample], bright: &[&Sample], k: usize) -> f64 {
    let reflectance = median(dark.iter().map(|s| s.radiance[k] / s.rest[k].max(1e-12)).collect());
    let reflectance = reflectance.unwrap_or(f64::NAN);
    let gain = |s: &&Sample| (s.radiance[k] / reflectance - s.rest[k]) / s.clipped[k].max(1e-12);
    median(bright.iter().map(gain).collect()).unwrap_or(f64::NAN)
}

/// Standard deviation of the gain when the parts of the surface are drawn anew: neighbouring pixels share their texture.
fn bootstrap<'a>(dark: &'a [Sample], bright: &'a [Sample]) -> [f64; 3] {
    fn blocks(samples: &[Sample]) -> Vec<Vec<&Sample>> {
        let mut blocks = std::collections::BTreeMap::<_, Vec<&Sample>>::new();
        samples.iter().for_each(|s| blocks.entry(s.block).or_default().push(s));
        blocks.into_values().collect()
    }
    let (dark, bright) = (blocks(dark), blocks(bright));
    let gains: Vec<[f64; 3]> = (0..RESAMPLES)
        .into_par_iter()
        .map(|seed| {
            let mut rng = SmallRng::seed_from_u64(seed);
            let mut draw = |blocks: &[Vec<&'a Sample>]| -> Vec<&'a Sample> {
                let chosen = (0..blocks.len()).map(|_| rng.random_range(0..blocks.len()));
                chosen.flat_map(|i| blocks[i].iter().copied()).collect()
            };
            let (d, b) = (draw(&dark), draw(&bright));
            [0, 1, 2].map(|k| solve(&d, &b, k))
        })
        .collect();
    [0, 1, 2].map(|k| {
        let mean = gains.iter().map(|g| g[k]).sum::<f64>() / gains.len() as f64;
        let square = gains.iter().map(|g| (g[k] - mean).powi(2)).sum::<f64>();
        (square / (gains.len() - 1) as f64).sqrt()
    })
}

/// The environment (less a part of it) as sources: strong texels alone, the rest in coarse cells.
fn sources(env: &Environment, less: Option<&Environment>) -> Vec<Source> {
    let (w, h) = env.size();
    let limit = STRONG_SHARE * env.power();
    let mut cells = vec![(Vector3::zeros(), [0.0; 3]); w.div_ceil(CELL) * h.div_ceil(CELL)];
    let mut sources = Vec::new();
    for i in 0..w * h {
        let (l, solid_angle, d) = (env.radiance.pixels()[i].0, env.solid_angle(i), env.direction(i));
        let direction = Vector3::new(f64::from(d.x), f64::from(d.y), f64::from(d.z));
        let part = less.map_or([0.0; 3], |e| e.radiance.pixels()[i].0);
        let power: [f64; 3] = std::array::from_fn(|k| f64::from((l[k] - part[k]).max(0.0)) * solid_angle);
        let sum: f64 = power.iter().sum();
        if sum > limit {
            sources.push(Source { direction, power });
        } else if sum > 0.0 {
            let cell = &mut cells[i / w / CELL * w.div_ceil(CELL) + i % w / CELL];
            cell.0 += direction * sum;
            (0..3).for_each(|k| cell.1[k] += power[k]);
        }
    }
    let cells =
        cells.into_iter().filter_map(|(d, power)| Some(Source { direction: d.try_normalize(0.0)?, power }));
    sources.extend(cells);
    sources
}

/// Points of the surface that the picture shows, off the grid and off the ball's image, with their radiance.
fn visible(fit: &ProbeFit, picture: &RadianceImage, surface: &Surface) -> Vec<(Point3<f64>, [f64; 3])> {
    let (w, h) = picture.size();
    // The compared region is about as large as REACH balls across.
    let step = (0.5 * REACH * fit.diameter_px / PIXELS.sqrt()).max(1.0) as usize;
    let margin = 0.1 * fit.radius_m;
    let mut points = Vec::new();
    for y in (0..h).step_by(step) {
        for x in (0..w).step_by(step) {
            let pixel = Point2::new(x as f64 + 0.5, y as f64 + 0.5);
            let ray = fit.camera.ray(&pixel);
            let d = ray.direction.into_inner();
            if d.y > -0.05 {
                continue;
            }
            let p = ray.origin + d * ((surface.height_m - ray.origin.y) / d.y);
            let on_board = surface
                .board_half_m
                .is_some_and(|[hx, hz]| p.x.abs() < hx + margin && p.z.abs() < hz + margin);
            let far = (p - fit.centre).norm() > REACH * fit.radius_m;
            let ball = mirror_ball::reflected_ray(&fit.camera, &fit.centre, 1.05 * fit.radius_m, &pixel);
            if !on_board && !far && ball.is_none() {
                points.push((p, picture.at(x, y).0.map(f64::from)));
            }
        }
    }
    points
}

struct Ball {
    centre: Point3<f64>,
    radius: f64,
    reflectivity: [f64; 3],
}

impl Ball {
    /// Whether a light of the given angular reach about `towards` is wholly seen (`true`) or wholly hidden at x; `None`
    /// in the penumbra, far from the shadow, and before the ball, where it throws its bright reflections.
    fn side(&self, x: &Point3<f64>, towards: &Vector3<f64>, reach: f64) -> Option<bool> {
        let to_ball = self.centre - x;
        let from_limb = towards.angle(&to_ball) - (self.radius / to_ball.norm()).min(1.0).asin();
        let behind = towards.x * to_ball.x + towards.z * to_ball.z > 0.0;
        match from_limb {
            a if a < -reach => Some(false),
            a if behind && a > reach && a < reach + LIT_WITHIN => Some(true),
            _ => None,
        }
    }

    /// Irradiance on the horizontal surface at x: what comes past the ball, and what comes by way of it.
    fn irradiance(&self, x: &Point3<f64>, sources: &[Source]) -> [f64; 3] {
        let mut sum = [0.0; 3];
        let to_ball = self.centre - x;
        for s in sources {
            let along = to_ball.dot(&s.direction);
            let hidden = along > 0.0 && to_ball.norm_squared() - along * along < self.radius * self.radius;
            let direct = if hidden { 0.0 } else { s.direction.y.max(0.0) };
            let mirrored = self.mirrored(x, &s.direction);
            (0..3).for_each(|k| sum[k] += s.power[k] * (direct + self.reflectivity[k] * mirrored));
        }
        sum
    }

    /// Irradiance at x by way of the ball under parallel light of unit irradiance: the reflected wavefront has the focal
    /// lengths R cos i / 2 and R / (2 cos i) and thins out from there.
    fn mirrored(&self, x: &Point3<f64>, direction: &Vector3<f64>) -> f64 {
        let Some(p) = unwrap::reflection_point(x, &self.centre, self.radius, direction) else { return 0.0 };
        let normal = (p - self.centre) / self.radius;
        let (cosine, path) = (normal.dot(direction), x - p);
        let t = path.norm();
        if cosine <= 1e-6 || path.dot(&normal) <= 0.0 || t <= 0.0 {
            return 0.0;
        }
        let (a, b) = (0.5 * self.radius * cosine, 0.5 * self.radius / cosine);
        a * b / ((a + t) * (b + t)) * (-path.y / t).max(0.0)
    }
}

#[cfg(test)]
#[path = "clipped_tests.rs"]
mod tests;

//! Finds a mirror ball of known radius that stands on a known horizontal surface: a coarse search for its outline over
//! all places the camera sees; of the best, the one whose mirror image of the surface agrees with the surface itself.

use super::consistency::{Consistency, Surface};
use super::{ProbeFit, Problem, edge, outline};
use crate::camera::Camera;
use crate::config::{self, ProbeSource};
use crate::image::{Image, RadianceImage};
use nalgebra::{Point2, Point3, Vector2};
use rayon::prelude::*;

/// The ball must be that large in the picture, px.
pub const MIN_DIAMETER_PX: f64 = 20.0;
/// Correlation of the mirror image with the surface below which a place is not taken for the ball's.
pub const MIN_AGREEMENT: f64 = 0.8;
/// Share of the outline that may lie outside the picture.
pub(super) const MAX_OUTSIDE: f64 = 0.02;
/// Spacing of the coarse search in the picture, px.
const STEP_PX: usize = 3;
/// Places whose mirror image is looked at.
const PROMISING: usize = 4000;
/// Places kept by the coarse search.
const CANDIDATES: usize = 60;
/// Of these, places that are judged on all their pixels.
const FINALISTS: usize = 8;
/// Outline points of the coarse search and of the refinement.
const COARSE: usize = 96;
const FINE: usize = 240;
/// Fainter edges (difference over mean) are taken for noise.
const MIN_CONTRAST: f64 = 0.15;
/// How far an edge may lie from the outline, px.
const EDGE_REACH_PX: f64 = 1.5;
/// Share of the outline that must show an edge: a mirror ball fades into its surroundings, but not all around.
const MIN_SUPPORT: f64 = 0.25;
/// Contrast beyond which an edge counts no more: reflected lamps must not outvote the rest of the outline.
const CAP: f64 = 0.3;

/// Finds the ball that stands on `surface`.
pub fn find(
    camera: &Camera,
    picture: &RadianceImage,
    surface: &Surface,
    settings: &config::Probe,
) -> Result<ProbeFit, Problem> {
    let radius_m = settings.radius_m;
    let reflectivity = settings.reflectivity[1];
    if !(settings.reflectivity.iter().all(|r| *r > 0.0 && *r <= 1.0)) {
        return Err(Problem::Reflectivity(settings.reflectivity));
    }
    if !(radius_m.is_finite() && radius_m > 0.0) {
        return Err(Problem::Radius(radius_m));
    }
    let centre_height_m = surface.height_m + radius_m;
    let above = camera.centre().y - centre_height_m;
    if above <= 0.0 {
        return Err(Problem::CameraBelow(above));
    }
    let luminance = picture.map(|p| p.luminance().max(0.0));
    let view = View { camera, luminance: &luminance, radius_m, height_m: centre_height_m };
    let consistency = Consistency {
        camera,
        luminance: &luminance,
        surface: *surface,
        radius_m,
        reflectivity,
        floor: noise_floor(&luminance),
    };
    let mut climbed: Vec<_> = view
        .coarse(&consistency)
        .into_par_iter()
        .map(|start| consistency.climb(start, centre_height_m, 400))
        .collect();
    climbed.sort_by(|a, b| b.0.total_cmp(&a.0));
    climbed.truncate(FINALISTS);
    // Few pixels agree by chance, places half outside the picture too, and a regular floor agrees with itself: the
    // finalists are judged on all their pixels, and by the reflectivity that they show.
    let best = climbed
        .into_iter()
        .filter_map(|(_, at)| consistency.refine(at, centre_height_m))
        .map(|(at, a)| {
            let off = 0.25 * view.outside(at) + (a.gain / reflectivity).ln().abs();
            (a.correlation - off, at, a)
        })
        .max_by(|a, b| a.0.total_cmp(&b.0));
    let not_found = |agreement| Problem::NotFound { agreement, needed: MIN_AGREEMENT };
    let (_, at, agreement) = best.ok_or(not_found(0.0))?;
    if agreement.correlation < MIN_AGREEMENT {
        return Err(not_found(agreement.correlation));
    }
    let outline = view.outline(at, FINE).unwrap_or_default();
    let outside = view.outside(at);
    if outside > MAX_OUTSIDE {
        return Err(Problem::CutOff { outside });
    }
    let diameter_px = 2.0 * outline::radius_px(&outline);
    if diameter_px < MIN_DIAMETER_PX {
        return Err(Problem::TooSmall { diameter_px, needed_px: MIN_DIAMETER_PX });
    }
    let (outline_rms_px, outline_support) = view.edges(at);
    if outline_support < MIN_SUPPORT {
        return Err(Problem::NoOutline { support: outline_support, needed: MIN_SUPPORT });
    }
    Ok(ProbeFit {
        source: ProbeSource::Ball,
        photographs: Vec::new(),
        camera: camera.clone(),
        centre: view.centre(at),
        radius_m,
        outline_rms_px,
        outline_support: Some(outline_support),
        mirror_correlation: Some(agreement.correlation),
        reflectivity_seen: Some(agreement.gain),
        centre_sigma_m: [agreement.sigma_m[0], 0.0, agreement.sigma_m[1]],
        diameter_px,
    })
}

struct View<'a> {
    camera: &'a Camera,
    luminance: &'a Image<f32>,
    radius_m: f64,
    height_m: f64,
}

impl View<'_> {
    fn centre(&self, at: Vector2<f64>) -> Point3<f64> {
        Point3::new(at.x, self.height_m, at.y)
    }

    fn outline(&self, at: Vector2<f64>, count: usize) -> Option<Vec<Point2<f64>>> {
        outline::project(self.camera, &self.centre(at), self.radius_m, count)
    }

    /// Share of the outline outside the picture.
    fn outside(&self, at: Vector2<f64>) -> f64 {
        let (w, h) = self.luminance.size();
        self.outline(at, FINE).map_or(1.0, |points| outline::share_outside(&points, w, h))
    }

    /// The best places: the picture's logarithm changes across the outline, and the mirror image agrees at a glance.
    fn coarse(&self, consistency: &Consistency) -> Vec<Vector2<f64>> {
        let log = logarithm(self.luminance);
        let (width, height) = self.luminance.size();
        let columns = width / STEP_PX;
        let mut scores: Vec<(f64, Point2<f64>, Vector2<f64>)> = (0..columns * (height / STEP_PX))
            .into_par_iter()
            .filter_map(|i| {
                let pixel = Point2::new(
                    ((i % columns) * STEP_PX) as f64 + 1.5,
                    ((i / columns) * STEP_PX) as f64 + 1.5,
                );
                let ray = self.camera.ray(&pixel);
                let t = (self.height_m - ray.origin.y) / ray.direction.y;
                if !(t.is_finite() && t > 0.0) {
                    return None;
                }
                let p = ray.origin + ray.direction.into_inner() * t;
                let at = Vector2::new(p.x, p.z);
                Some((self.score(&log, at)?, pixel, at))
            })
            .collect();
        scores.sort_by(|a, b| b.0.total_cmp(&a.0));
        scores.truncate(PROMISING);
        scores.par_iter_mut().for_each(|s| s.0 += consistency.agreement(&self.centre(s.2), 250));
        scores.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut kept: Vec<(f64, Point2<f64>, Vector2<f64>)> = Vec::new();
        for s in scores {
            if kept.len() == CANDIDATES {
                break;
            }
            if kept.iter().all(|k| (k.1 - s.1).norm() > 2.5 * STEP_PX as f64) {
                kept.push(s);
            }
        }
        kept.into_iter().map(|(_, _, at)| at).collect()
    }

    /// Mean over the outline of the contrast across it beyond that on either side, capped.
    fn score(&self, log: &Image<f32>, at: Vector2<f64>) -> Option<f64> {
        let points = self.outline(at, COARSE)?;
        let (w, h) = log.size();
        let radius_px = outline::radius_px(&points);
        if radius_px < 0.4 * MIN_DIAMETER_PX || outline::share_outside(&points, w, h) > 0.5 {
            return None;
        }
        // Steps across the outline: as wide as the coarse search is wrong, but within the ball.
        let step = (STEP_PX as f64).min(radius_px / 5.0);
        let (mut sum, mut seen) = (0.0, 0usize);
        for (p, n) in with_normals(&points) {
            if p.x < 0.0 || p.y < 0.0 || p.x > w as f64 || p.y > h as f64 {
                continue;
            }
            let l = |k: f64| f64::from(edge::sample(log, &(p + n * (k * step))));
            let [out2, out1, in1, in2] = [2.0, 0.8, -0.8, -2.0].map(l);
            let texture = 0.5 * ((out2 - out1).abs() + (in2 - in1).abs());
            sum += ((out1 - in1).abs() - texture).clamp(0.0, CAP) / CAP;
            seen += 1;
        }
        Some(sum / seen.max(COARSE / 2) as f64)
    }

    /// Distance of strong edges from the outline, rms in px, and the share of the outline that has one.
    fn edges(&self, at: Vector2<f64>) -> (f64, f64) {
        let points = self.outline(at, FINE).unwrap_or_default();
        let distances: Vec<f64> = with_normals(&points)
            .filter_map(|(p, n)| edge::find(self.luminance, &p, &n, EDGE_REACH_PX))
            .filter(|e| e.contrast > MIN_CONTRAST && e.offset_px.abs() < EDGE_REACH_PX)
            .map(|e| e.offset_px)
            .collect();
        let count = distances.len() as f64;
        let rms = (distances.iter().map(|d| d * d).sum::<f64>() / count.max(1.0)).sqrt();
        (rms, count / points.len().max(1) as f64)
    }
}

/// Outline points with their outward unit normals in the picture.
fn with_normals(points: &[Point2<f64>]) -> impl Iterator<Item = (Point2<f64>, Vector2<f64>)> + '_ {
    let n = points.len();
    let middle = points.iter().fold(Vector2::zeros(), |s, p| s + p.coords) / n as f64;
    (0..n).map(move |i| {
        let along = points[(i + 1) % n] - points[(i + n - 1) % n];
        let normal = Vector2::new(along.y, -along.x).normalize();
        let outward = normal.dot(&(points[i].coords - middle)).signum();
        (points[i], normal * outward)
    })
}

/// A fiftieth of the median: below it, differences are noise.
fn noise_floor(luminance: &Image<f32>) -> f32 {
    let mut sorted = luminance.pixels().to_vec();
    sorted.sort_by(f32::total_cmp);
    (0.02 * sorted[sorted.len() / 2]).max(f32::MIN_POSITIVE)
}

/// Logarithm of the luminance, averaged over 3 × 3 px; the floor keeps noise in the dark from counting as contrast.
fn logarithm(luminance: &Image<f32>) -> Image<f32> {
    let floor = noise_floor(luminance);
    let (w, h) = luminance.size();
    Image::from_fn(w, h, |x, y| {
        let (mut sum, mut count) = (0.0, 0.0);
        for yy in y.saturating_sub(1)..(y + 2).min(h) {
            for xx in x.saturating_sub(1)..(x + 2).min(w) {
                sum += (luminance.at(xx, yy) + floor).ln();
                count += 1.0;
            }
        }
        sum / count
    })
}

#[cfg(test)]
#[path = "find_tests.rs"]
mod tests;

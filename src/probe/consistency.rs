//! The ball mirrors the surface it stands on, and the camera sees that surface directly too: the place where both
//! agree is the ball's place. Far sharper than the outline, along which a mirror ball fades into its surroundings
//! (at grazing incidence it shows what lies just behind it, dimmed by its reflectivity).

use super::edge::sample;
use super::{mirror_ball, outline};
use crate::camera::Camera;
use crate::config::{self, ProbeCamera};
use crate::image::Image;
use nalgebra::{Matrix3, Point2, Point3, Vector2, Vector3};
use rayon::prelude::*;

/// The horizontal surface the ball stands on, and the printed grid on it around the world's origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Height of the surface in the world, m.
    pub height_m: f64,
    /// Half the printed grid's extent along the world's x and z; its face is at height 0.
    pub board_half_m: Option<[f64; 2]>,
}

impl Surface {
    /// The surface that the settings tell of; with the printed grid where the probe's photographs show it.
    pub fn new(settings: &config::Probe, grid: &config::Calibrate) -> Self {
        // The squares around the inner corners, and a margin of half a square.
        let half = |corners: u32| f64::from(corners + 2) * grid.square_m / 2.0;
        Self {
            height_m: settings.support_m.unwrap_or(-grid.thickness_m),
            board_half_m: (settings.camera == ProbeCamera::Grid).then(|| grid.inner_corners.map(half)),
        }
    }

    /// Where a ray going down meets it.
    fn meet(&self, origin: &Point3<f64>, d: &Vector3<f64>) -> Option<Point3<f64>> {
        if d.y > -1e-3 {
            return None;
        }
        let at = |height: f64| origin + d * ((height - origin.y) / d.y);
        if let Some([hx, hz]) = self.board_half_m {
            let p = at(0.0);
            if p.x.abs() < hx && p.z.abs() < hz {
                return Some(p);
            }
        }
        (origin.y > self.height_m).then(|| at(self.height_m))
    }
}

/// Picture, camera and surface against which a place of the ball is tried.
pub struct Consistency<'a> {
    /// The view.
    pub camera: &'a Camera,
    /// Linear luminance.
    pub luminance: &'a Image<f32>,
    /// The surface mirrored.
    pub surface: Surface,
    /// Radius of the ball, m.
    pub radius_m: f64,
    /// Reflectivity of the ball.
    pub reflectivity: f64,
    /// Added before the logarithm, so that noise in the dark does not count.
    pub floor: f32,
}

/// How well mirror and direct view agree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Correlation of the logarithms over the pixels that mirror a visible part of the surface.
    pub correlation: f64,
    /// Mirrored over direct luminance, robust mean: the reflectivity as seen.
    pub gain: f64,
    /// Standard deviation of the centre along x and z, m.
    pub sigma_m: [f64; 2],
}

/// Sub-rays along each side of a pixel: the mirror makes its surroundings small.
const SUB: usize = 3;
/// The outermost part of the ball shows too much in one pixel.
const RIM: f64 = 0.95;

impl Consistency<'_> {
    /// Pixels inside the outline, at most about `count` of them.
    fn pixels(&self, centre: &Point3<f64>, count: usize) -> Vec<(usize, usize)> {
        let Some(points) = outline::project(self.camera, centre, self.radius_m, 32) else {
            return Vec::new();
        };
        let (w, h) = self.luminance.size();
        let low = points.iter().fold(Point2::new(f64::MAX, f64::MAX), |a, p| a.inf(p));
        let high = points.iter().fold(Point2::new(f64::MIN, f64::MIN), |a, p| a.sup(p));
        let step =
            (outline::radius_px(&points) * (std::f64::consts::PI / count as f64).sqrt()).ceil().max(1.0);
        let range = |a: f64, b: f64, n: usize| {
            (a.max(0.0) as usize..(b.max(0.0) as usize).min(n)).step_by(step as usize)
        };
        range(low.y, high.y, h)
            .flat_map(|y| range(low.x, high.x, w).map(move |x| (x, y)))
            .filter(|&(x, y)| {
                let p = Point2::new(x as f64 + 0.5, y as f64 + 0.5);
                mirror_ball::reflected_ray(self.camera, centre, RIM * self.radius_m, &p).is_some()
            })
            .collect()
    }

    /// Luminance of the visible surface that a ball at `centre` mirrors into a pixel; `None` where it mirrors
    /// anything else, or the surface where the camera does not see it.
    fn mirrored(&self, centre: &Point3<f64>, (x, y): (usize, usize), sub: usize) -> Option<f64> {
        let (w, h) = (self.luminance.width() as f64, self.luminance.height() as f64);
        let mut sum = 0.0;
        for s in 0..sub * sub {
            let at = |i: usize, k: usize| i as f64 + (k as f64 + 0.5) / sub as f64;
            let pixel = Point2::new(at(x, s % sub), at(y, s / sub));
            let ray = mirror_ball::reflected_ray(self.camera, centre, self.radius_m, &pixel)?;
            let p = self.surface.meet(&ray.origin, &ray.direction)?;
            let q = self.camera.project(&p)?;
            let hidden = mirror_ball::reflected_ray(self.camera, centre, 1.03 * self.radius_m, &q).is_some();
            if hidden || q.x < 1.0 || q.y < 1.0 || q.x > w - 1.0 || q.y > h - 1.0 {
                return None;
            }
            sum += f64::from(sample(self.luminance, &q));
        }
        Some(sum / (sub * sub) as f64)
    }

    fn log(&self, l: f64) -> f64 {
        (l + f64::from(self.floor)).ln()
    }

    /// Correlation of mirrored and direct logarithms over about `count` pixels, less what the mean ratio differs from the
    /// reflectivity: a plain floor agrees with itself too, but undimmed. 0 where there are too few pixels.
    pub fn agreement(&self, centre: &Point3<f64>, count: usize) -> f64 {
        let (correlation, log_gain) = self.compare(centre, count);
        correlation - (log_gain - self.reflectivity.ln()).abs().min(0.5)
    }

    /// Correlation of mirrored and direct logarithms and their mean difference.
    fn compare(&self, centre: &Point3<f64>, count: usize) -> (f64, f64) {
        let pixels = self.pixels(centre, count);
        let (mut n, mut a, mut b, mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for &(x, y) in &pixels {
            let Some(direct) = self.mirrored(centre, (x, y), SUB) else { continue };
            let (u, v) = (self.log(direct), self.log(f64::from(*self.luminance.at(x, y))));
            (n, a, b, aa, ab, bb) = (n + 1.0, a + u, b + v, aa + u * u, ab + u * v, bb + v * v);
        }
        if n < 30.0 || n < 0.05 * pixels.len() as f64 {
            return (0.0, 0.0);
        }
        // Noise alone must not correlate: a variance of (2 %)² is added on either side.
        let noise = 4e-4;
        let (va, vb) = (aa / n - (a / n).powi(2) + noise, bb / n - (b / n).powi(2) + noise);
        ((ab / n - a * b / (n * n)) / (va * vb).sqrt(), (b - a) / n)
    }

    /// Climbs to the best agreement near `start`: a search over ± 2.5 px, then by compass search down to 0.2 px.
    pub fn climb(&self, start: Vector2<f64>, height_m: f64, count: usize) -> (f64, Vector2<f64>) {
        let centre = |at: Vector2<f64>| Point3::new(at.x, height_m, at.y);
        let value = |at: Vector2<f64>| self.agreement(&centre(at), count);
        let Some(points) = outline::project(self.camera, &centre(start), self.radius_m, 32) else {
            return (0.0, start);
        };
        let pixel_m = self.radius_m / outline::radius_px(&points);
        let best_of = |at: Vector2<f64>, step: f64, reach: i32| {
            (-reach..=reach)
                .flat_map(|x| (-reach..=reach).map(move |z| Vector2::new(f64::from(x), f64::from(z))))
                .map(|d| at + d * step)
                .map(|p| (value(p), p))
                .max_by(|a, b| a.0.total_cmp(&b.0))
                .unwrap_or((0.0, at))
        };
        let mut step = 1.25 * pixel_m;
        let (mut best, mut at) = best_of(start, step, 2);
        while step > 0.2 * pixel_m {
            let (v, p) = best_of(at, step, 1);
            if v > best {
                (best, at) = (v, p);
            } else {
                step /= 2.0;
            }
        }
        (best, at)
    }

    /// Gauss–Newton with Tukey weights on `ln mirrored − ln direct − ln gain` over all pixels of the ball.
    pub fn refine(&self, start: Vector2<f64>, height_m: f64) -> Option<(Vector2<f64>, Agreement)> {
        let centre = |at: Vector2<f64>| Point3::new(at.x, height_m, at.y);
        let pixels = self.pixels(&centre(start), 20_000);
        let delta = 2e-3 * self.radius_m;
        let (mut at, mut log_gain) = (start, 0.0);
        let mut sigma_m = [0.0; 2];
        for _ in 0..8 {
            let rows: Vec<(f64, Vector3<f64>)> = pixels
                .par_iter()
                .filter_map(|&pixel| {
                    let seen = self.log(f64::from(*self.luminance.at(pixel.0, pixel.1)));
                    let l = |dx: f64, dz: f64| {
                        Some(self.log(self.mirrored(&centre(at + Vector2::new(dx, dz)), pixel, SUB)?))
                    };
                    let slope = Vector3::new(
                        (l(delta, 0.0)? - l(-delta, 0.0)?) / (2.0 * delta),
                        (l(0.0, delta)? - l(0.0, -delta)?) / (2.0 * delta),
                        1.0,
                    );
                    Some((seen - l(0.0, 0.0)?, slope))
                })
                .collect();
            if rows.len() < 40 {
                return None;
            }
            let mut residuals: Vec<f64> = rows.iter().map(|r| r.0).collect();
            if sigma_m[0] == 0.0 {
                residuals.sort_by(f64::total_cmp);
                log_gain = residuals[residuals.len() / 2];
            }
            let mut sizes: Vec<f64> = rows.iter().map(|r| (r.0 - log_gain).abs()).collect();
            sizes.sort_by(f64::total_cmp);
            let scale = 1.4826 * sizes[sizes.len() / 2] + 1e-6;
            let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
            for (r, slope) in &rows {
                let e = r - log_gain;
                let w = (1.0 - (e / (4.685 * scale)).powi(2)).max(0.0).powi(2);
                a += slope * slope.transpose() * w;
                b += slope * (e * w);
            }
            let inverse = a.try_inverse()?;
            let step = inverse * b;
            at += step.xy() * (0.05 * self.radius_m / step.xy().norm().max(1e-12)).min(1.0);
            log_gain += step.z;
            sigma_m = [0, 1].map(|i| scale * inverse[(i, i)].max(0.0).sqrt());
            if step.xy().norm() < 1e-6 {
                break;
            }
        }
        let (correlation, _) = self.compare(&centre(at), 4000);
        Some((at, Agreement { correlation, gain: log_gain.exp(), sigma_m }))
    }
}

//! Marks as sight lines: where a corner should be, how far off it is in pixels.

use super::feature::Feature;
use crate::camera::{Camera, Ray};
use crate::probe::mirror_ball;
use nalgebra::{Matrix2, Point2, Point3, Vector2, Vector3};
use std::f64::consts::TAU;

/// The mirror ball.
#[derive(Debug, Clone, Copy)]
pub struct Ball {
    /// Its centre, m.
    pub centre: Point3<f64>,
    /// Its radius, m.
    pub radius_m: f64,
}

/// A marked pixel, seen directly or in the ball.
#[derive(Debug, Clone)]
pub enum Sight<'a> {
    /// Seen in the photograph.
    Direct {
        /// By this camera.
        camera: &'a Camera,
        /// Here, px.
        pixel: Point2<f64>,
    },
    /// Seen in the ball.
    Reflected {
        /// The ray back from the ball.
        ray: Ray,
        /// Two directions across the ray.
        across: [Vector3<f64>; 2],
        /// Pixels for a turn of the ray by these, px/rad.
        px_per_rad: Matrix2<f64>,
    },
}

/// How far a mark is from what it refers to, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Miss {
    /// From a point.
    Point(Vector2<f64>),
    /// From a curve, along which it may be anywhere; the sign says on which side.
    Curve(f64),
}

impl Miss {
    /// Its length, px.
    pub fn length(&self) -> f64 {
        match self {
            Self::Point(e) => e.norm(),
            Self::Curve(d) => d.abs(),
        }
    }

    /// Appends what a least-squares fit makes small.
    pub fn push(&self, to: &mut Vec<f64>) {
        match self {
            Self::Point(e) => to.extend([e.x, e.y]),
            Self::Curve(d) => to.push(*d),
        }
    }
}

/// Places on a rim that are tried, and steps from the best of them.
const PLACES: usize = 24;
const STEPS: usize = 6;

/// Step of the finite differences that give the local pixel scale of the ball, px.
const STEP_PX: f64 = 0.25;

impl<'a> Sight<'a> {
    /// A mark seen in the ball; `None` beside it or at its very rim.
    pub fn reflected(camera: &Camera, ball: &Ball, pixel: Point2<f64>) -> Option<Self> {
        let at = |dx: f64, dy: f64| {
            mirror_ball::reflected_ray(camera, &ball.centre, ball.radius_m, &(pixel + Vector2::new(dx, dy)))
        };
        let ray = at(0.0, 0.0)?;
        let d = ray.direction.into_inner();
        let helper = if d.y.abs() < 0.9 { Vector3::y() } else { Vector3::x() };
        let a = d.cross(&helper).normalize();
        let across = [a, d.cross(&a)];
        let change = |dx: f64, dy: f64| -> Option<Vector2<f64>> {
            let (plus, minus) = (at(dx, dy)?, at(-dx, -dy)?);
            let change = (plus.direction.into_inner() - minus.direction.into_inner()) / (2.0 * STEP_PX);
            Some(Vector2::new(change.dot(&across[0]), change.dot(&across[1])))
        };
        let rad_per_px = Matrix2::from_columns(&[change(STEP_PX, 0.0)?, change(0.0, STEP_PX)?]);
        Some(Self::Reflected { ray, across, px_per_rad: rad_per_px.try_inverse()? })
    }

    /// The ray on which the corner should lie.
    pub fn ray(&self) -> Ray {
        match self {
            Self::Direct { camera, pixel } => camera.ray(pixel),
            Self::Reflected { ray, .. } => *ray,
        }
    }

    /// How far a point is off, px; `None` behind the camera.
    pub fn error(&self, point: &Point3<f64>) -> Option<Vector2<f64>> {
        match self {
            Self::Direct { camera, pixel } => Some(camera.project(point)? - pixel),
            Self::Reflected { ray, across, px_per_rad } => {
                let to = (point - ray.origin).try_normalize(1e-12)?;
                let (sine, cosine) = (to.cross(&ray.direction).norm(), to.dot(&ray.direction));
                // The angle, not its sine, so that a point on the far side is further off than one abeam.
                let stretch = if sine > 1e-9 { sine.atan2(cosine) / sine } else { 1.0 };
                Some(px_per_rad * Vector2::new(to.dot(&across[0]), to.dot(&across[1])) * stretch)
            }
        }
    }

    /// How far the mark is off a feature; `None` where that is behind the camera, or the camera within the cylinder.
    pub fn miss(&self, feature: &Feature) -> Option<Miss> {
        match feature {
            Feature::Point(point) => self.error(point).map(Miss::Point),
            Feature::Edge(ends) => self.off_edge(ends).map(Miss::Curve),
            Feature::Rim { centre, radii } => {
                self.off_rim(&|a: f64| centre + radii[0] * a.cos() + radii[1] * a.sin()).map(Miss::Curve)
            }
            Feature::Side { axis, radii, right } => {
                let eye = self.ray().origin;
                let radius = radii[0].norm();
                let to = eye - axis[0];
                let (x, z) = (to.dot(&radii[0]) / radius, to.dot(&radii[1]) / radius);
                // Seen from the eye the tangents stand this far from the direction towards it.
                let half = (radius / x.hypot(z)).acos();
                if half.is_nan() {
                    return None;
                }
                let turn = if *right { -half } else { half };
                let (sin, cos) = (z.atan2(x) + turn).sin_cos();
                let out = radii[0] * cos + radii[1] * sin;
                let [a, b] = axis.map(|end| self.error(&(end + out)));
                let (a, b) = (a?, b?);
                let along = (b - a).try_normalize(1e-9)?;
                Some(Miss::Curve(-along.perp(&a)))
            }
        }
    }

    /// Signed distance from a line, px, where the ray passes it.
    fn off_edge(&self, [a, b]: &[Point3<f64>; 2]) -> Option<f64> {
        let ray = self.ray();
        let (d, along, from) = (ray.direction.into_inner(), (b - a).try_normalize(1e-9)?, a - ray.origin);
        let cos = d.dot(&along);
        let sine2 = 1.0 - cos * cos;
        if sine2 < 1e-12 {
            return None;
        }
        let nearest = a + along * ((cos * d.dot(&from) - along.dot(&from)) / sine2);
        let step = along * (1e-4 * (nearest - ray.origin).norm());
        let [before, there, after] = [nearest - step, nearest, nearest + step].map(|p| self.error(&p));
        Some((after? - before?).try_normalize(1e-12)?.perp(&there?))
    }

    /// Signed distance from a closed curve, px.
    fn off_rim(&self, curve: &impl Fn(f64) -> Point3<f64>) -> Option<f64> {
        let at = |a: f64| self.error(&curve(a));
        let step = TAU / PLACES as f64;
        let tried: Vec<Vector2<f64>> = (0..PLACES).map(|k| at(step * k as f64)).collect::<Option<_>>()?;
        let (best, _) =
            tried.iter().enumerate().min_by(|a, b| a.1.norm_squared().total_cmp(&b.1.norm_squared()))?;
        let mut angle = step * best as f64;
        let derivative = |a: f64| -> Option<Vector2<f64>> { Some((at(a + 1e-4)? - at(a - 1e-4)?) / 2e-4) };
        for _ in 0..STEPS {
            // Gauss and Newton: where the curve is nearest, the way there stands across it.
            let (e, d) = (at(angle)?, derivative(angle)?);
            angle -= (e.dot(&d) / d.norm_squared().max(1e-12)).clamp(-step, step);
        }
        let (e, d) = (at(angle)?, derivative(angle)?);
        Some(d.try_normalize(1e-9)?.perp(&e))
    }

    /// Linear equations that a point on the ray fulfils, `rows · point = right`, weighted so that their error is about
    /// one in pixels for a point at the given distance.
    pub fn equations(&self, distance: f64) -> [(Vector3<f64>, f64); 2] {
        let ray = self.ray();
        let d = ray.direction.into_inner();
        let helper = if d.y.abs() < 0.9 { Vector3::y() } else { Vector3::x() };
        let a = d.cross(&helper).normalize();
        let weight = match self {
            Self::Direct { camera, .. } => camera.intrinsics.focal_px[0],
            Self::Reflected { px_per_rad, .. } => px_per_rad.norm() / 2f64.sqrt(),
        } / distance.max(1e-3);
        [a, d.cross(&a)].map(|n| (n * weight, n.dot(&ray.origin.coords) * weight))
    }
}

/// Root mean square distance, px.
pub fn rms_px(misses: &[Miss]) -> f64 {
    (misses.iter().map(|m| m.length().powi(2)).sum::<f64>() / misses.len().max(1) as f64).sqrt()
}

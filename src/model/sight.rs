//! Marks as sight lines: where a corner should be, how far off it is in pixels.

use crate::camera::{Camera, Ray};
use crate::probe::mirror_ball;
use nalgebra::{DVector, Matrix2, Point2, Point3, Vector2, Vector3};

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

/// Root mean square length of errors that are stored in pairs, px.
pub fn rms_px(errors: &DVector<f64>) -> f64 {
    (2.0 * errors.norm_squared() / errors.len().max(1) as f64).sqrt()
}

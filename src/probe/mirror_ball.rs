//! Exact perspective mirror-ball geometry: finite ball, finite distance.

use crate::camera::{Camera, Ray};
use nalgebra::{Point2, Point3, Unit};

/// The ray along which light travelled to the ball before it was reflected to `pixel`, reversed: its origin lies on
/// the ball, its direction points to where the light came from. `None` where the pixel misses the ball.
pub fn reflected_ray(
    camera: &Camera,
    centre: &Point3<f64>,
    radius_m: f64,
    pixel: &Point2<f64>,
) -> Option<Ray> {
    let Ray { origin, direction } = camera.ray(pixel);
    let to_centre = centre - origin;
    let along = to_centre.dot(&direction);
    let discriminant = along * along - to_centre.norm_squared() + radius_m * radius_m;
    if discriminant < 0.0 || along < 0.0 {
        return None;
    }
    let point = origin + direction.into_inner() * (along - discriminant.sqrt());
    let normal = (point - centre) / radius_m;
    let d = direction.into_inner();
    Some(Ray { origin: point, direction: Unit::new_normalize(d - normal * (2.0 * d.dot(&normal))) })
}

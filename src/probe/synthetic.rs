//! Pictures of a mirror ball in a known environment, for tests.

use super::mirror_ball::reflected_ray;
use crate::camera::{Camera, Intrinsics};
use crate::image::{Image, Radiance, RadianceImage};
use nalgebra::{Isometry3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// A camera at `eye` that looks at `target`, upright.
pub fn look_at(intrinsics: Intrinsics, eye: Point3<f64>, target: Point3<f64>) -> Camera {
    let forward = (target - eye).normalize();
    let right = forward.cross(&Vector3::y()).normalize();
    let down = forward.cross(&right);
    let rotation = Rotation3::from_basis_unchecked(&[right, down, forward]);
    Camera {
        intrinsics,
        world_from_camera: Isometry3::from_parts(
            Translation3::from(eye.coords),
            UnitQuaternion::from_rotation_matrix(&rotation),
        ),
    }
}

/// Renders the ball on a floor at height 0 with `n × n` rays a pixel; `light` is the environment at infinity, `floor`
/// the floor's radiance by place.
pub fn render(
    camera: &Camera,
    centre: &Point3<f64>,
    radius_m: f64,
    reflectivity: f32,
    light: impl Fn(Vector3<f64>) -> [f32; 3] + Sync,
    floor: impl Fn(f64, f64) -> [f32; 3] + Sync,
    n: usize,
) -> RadianceImage {
    use rayon::prelude::*;
    let (w, h) = (camera.intrinsics.width_px as usize, camera.intrinsics.height_px as usize);
    let along = |origin: Point3<f64>, d: Vector3<f64>| {
        let t = -origin.y / d.y;
        if t > 0.0 && t < 20.0 { floor(origin.x + t * d.x, origin.z + t * d.z) } else { light(d) }
    };
    let pixels = (0..w * h)
        .into_par_iter()
        .map(|i| {
            let mut sum = [0.0f32; 3];
            for s in 0..n * n {
                let pixel = Point2::new(
                    (i % w) as f64 + ((s % n) as f64 + 0.5) / n as f64,
                    (i / w) as f64 + ((s / n) as f64 + 0.5) / n as f64,
                );
                let (l, share) = match reflected_ray(camera, centre, radius_m, &pixel) {
                    Some(ray) => (along(ray.origin, ray.direction.into_inner()), reflectivity),
                    None => {
                        let ray = camera.ray(&pixel);
                        (along(ray.origin, ray.direction.into_inner()), 1.0)
                    }
                };
                (0..3).for_each(|k| sum[k] += l[k] * share / (n * n) as f32);
            }
            Radiance(sum)
        })
        .collect();
    Image::from_pixels(w, h, pixels)
}

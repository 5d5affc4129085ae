//! Pinhole cameras with Brown–Conrady distortion. Frames and pixels as in the crate's conventions.

mod derivatives;
mod uncertainty;

pub use derivatives::{LENS, POSE, Projected, moved};
pub use uncertainty::{CameraCovariance, LensCovariance, SharedCovariance, focal_alone};

use nalgebra::{Isometry3, Point2, Point3, Unit, Vector3};
use serde::{Deserialize, Serialize};

/// Inner orientation. Pixels are continuous, (0, 0) the outer corner of the top-left pixel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Image width, px.
    pub width_px: u32,
    /// Image height, px.
    pub height_px: u32,
    /// Focal length along x and y, px.
    pub focal_px: [f64; 2],
    /// Principal point, px.
    pub principal_point_px: [f64; 2],
    /// k1, k2, p1, p2, k3 in OpenCV's order, on normalised coordinates.
    pub distortion: [f64; 5],
}

/// A camera in the world: inner orientation and pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Inner orientation.
    pub intrinsics: Intrinsics,
    /// Pose: camera frame (+X right, +Y down, +Z forward) to world frame (+Y up), metres.
    pub world_from_camera: Isometry3<f64>,
}

/// A half line in the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Start, m.
    pub origin: Point3<f64>,
    /// Direction of unit length.
    pub direction: Unit<Vector3<f64>>,
}

impl Intrinsics {
    /// A distortion-free camera with square pixels and a central principal point.
    pub fn pinhole(width_px: u32, height_px: u32, focal_px: f64) -> Self {
        Self {
            width_px,
            height_px,
            focal_px: [focal_px; 2],
            principal_point_px: [width_px as f64 / 2.0, height_px as f64 / 2.0],
            distortion: [0.0; 5],
        }
    }

    /// Normalised undistorted coordinates (X/Z, Y/Z) to distorted ones.
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    }

    /// Inverse of [`Self::distort`] by fixed-point iteration.
    pub fn undistort(&self, [xd, yd]: [f64; 2]) -> [f64; 2] {
        let (mut x, mut y) = (xd, yd);
        for _ in 0..20 {
            let [ex, ey] = self.distort([x, y]);
            if [ex, ey] == [xd, yd] {
                break;
            }
            (x, y) = (x + xd - ex, y + yd - ey);
        }
        [x, y]
    }

    /// Point in the camera frame to pixel; `None` behind the camera.
    pub fn project(&self, p: &Point3<f64>) -> Option<Point2<f64>> {
        if p.z <= 1e-9 {
            return None;
        }
        let [x, y] = self.distort([p.x / p.z, p.y / p.z]);
        Some(Point2::new(
            self.focal_px[0] * x + self.principal_point_px[0],
            self.focal_px[1] * y + self.principal_point_px[1],
        ))
    }

    /// Direction in the camera frame seen at a pixel.
    pub fn direction(&self, pixel: &Point2<f64>) -> Unit<Vector3<f64>> {
        let [x, y] = self.undistort([
            (pixel.x - self.principal_point_px[0]) / self.focal_px[0],
            (pixel.y - self.principal_point_px[1]) / self.focal_px[1],
        ]);
        Unit::new_normalize(Vector3::new(x, y, 1.0))
    }
}

impl Camera {
    /// Centre of projection in the world, m.
    pub fn centre(&self) -> Point3<f64> {
        Point3::from(self.world_from_camera.translation.vector)
    }

    /// World point to pixel; `None` behind the camera.
    pub fn project(&self, p: &Point3<f64>) -> Option<Point2<f64>> {
        self.intrinsics.project(&self.world_from_camera.inverse_transform_point(p))
    }

    /// The ray in the world seen at a pixel.
    pub fn ray(&self, pixel: &Point2<f64>) -> Ray {
        Ray {
            origin: self.centre(),
            direction: Unit::new_normalize(
                self.world_from_camera * self.intrinsics.direction(pixel).into_inner(),
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn project_inverts_ray(x in 0.0..640.0f64, y in 0.0..480.0f64, depth in 0.1..50.0f64) {
            let mut intrinsics = Intrinsics::pinhole(640, 480, 590.0);
            intrinsics.distortion = [-0.2, 0.05, 0.001, -0.002, 0.01];
            let camera = Camera {
                intrinsics,
                world_from_camera: Isometry3::new(Vector3::new(1.0, 2.0, -3.0), Vector3::new(0.3, -1.2, 2.0)),
            };
            let ray = camera.ray(&Point2::new(x, y));
            let p = camera.project(&(ray.origin + ray.direction.into_inner() * depth)).unwrap();
            prop_assert!((p - Point2::new(x, y)).norm() < 1e-6);
        }
    }
}

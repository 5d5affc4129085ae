//! How pixels move with the point that is seen, the camera's pose and its lens.

use super::Intrinsics;
use nalgebra::{
    Isometry3, Matrix2, Matrix2x3, Point2, Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector2,
    Vector3,
};

/// Parameters of a lens, in the order of derivatives and covariances: focal length along x and y (px), principal point (px),
/// k1, k2, p1, p2, k3.
pub const LENS: usize = 9;
/// Parameters of a pose: a shift of the camera along the world's axes (m), then a turn of it about them (rad).
pub const POSE: usize = 6;

/// A pixel with its derivatives.
#[derive(Debug, Clone)]
pub struct Projected {
    /// Where the point is seen, px.
    pub pixel: Point2<f64>,
    /// By the point in the camera frame, px/m.
    pub by_point: Matrix2x3<f64>,
    /// By the parameters of the lens.
    pub by_lens: SMatrix<f64, 2, LENS>,
}

impl Projected {
    /// By the pose of a camera, from which the point lies at `seen` (world axes, m).
    pub fn by_pose(
        &self,
        world_from_camera: &UnitQuaternion<f64>,
        seen: &Vector3<f64>,
    ) -> SMatrix<f64, 2, POSE> {
        let by_world = self.by_point * world_from_camera.inverse().to_rotation_matrix().matrix();
        let mut by_pose = SMatrix::<f64, 2, POSE>::zeros();
        by_pose.fixed_columns_mut::<3>(0).copy_from(&-by_world);
        by_pose.fixed_columns_mut::<3>(3).copy_from(&(by_world * seen.cross_matrix()));
        by_pose
    }
}

/// A pose, moved by its parameters.
pub fn moved(world_from_camera: &Isometry3<f64>, by: &SVector<f64, POSE>) -> Isometry3<f64> {
    let shift = Vector3::new(by[0], by[1], by[2]);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(by[3], by[4], by[5]));
    Isometry3::from_parts(
        Translation3::from(world_from_camera.translation.vector + shift),
        turn * world_from_camera.rotation,
    )
}

impl Intrinsics {
    /// As [`Self::project`], with derivatives.
    pub fn project_with_derivatives(&self, p: &Point3<f64>) -> Option<Projected> {
        if p.z <= 1e-9 {
            return None;
        }
        let (x, y) = (p.x / p.z, p.y / p.z);
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        // Of the radial factor by r².
        let slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
        let mixed = 2.0 * (x * y * slope + p1 * x + p2 * y);
        let by_ideal = Matrix2::new(
            radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            mixed,
            mixed,
            radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        let [f, g] = self.focal_px;
        let focal = Matrix2::from_diagonal(&Vector2::new(f, g));
        let ideal_by_point = Matrix2x3::new(1.0, 0.0, -x, 0.0, 1.0, -y) / p.z;
        let [xd, yd] = self.distort([x, y]);
        let by_distortion = [
            [x * r2, x * r2 * r2, 2.0 * x * y, r2 + 2.0 * x * x, x * r2 * r2 * r2],
            [y * r2, y * r2 * r2, r2 + 2.0 * y * y, 2.0 * x * y, y * r2 * r2 * r2],
        ];
        let mut by_lens = SMatrix::<f64, 2, LENS>::zeros();
        (by_lens[(0, 0)], by_lens[(1, 1)]) = (xd, yd);
        (by_lens[(0, 2)], by_lens[(1, 3)]) = (1.0, 1.0);
        for k in 0..5 {
            (by_lens[(0, 4 + k)], by_lens[(1, 4 + k)]) = (f * by_distortion[0][k], g * by_distortion[1][k]);
        }
        let [cx, cy] = self.principal_point_px;
        Some(Projected {
            pixel: Point2::new(f * xd + cx, g * yd + cy),
            by_point: focal * by_ideal * ideal_by_point,
            by_lens,
        })
    }

    /// The lens with each parameter changed.
    pub fn changed(&self, by: &SVector<f64, LENS>) -> Self {
        Self {
            focal_px: [self.focal_px[0] + by[0], self.focal_px[1] + by[1]],
            principal_point_px: [self.principal_point_px[0] + by[2], self.principal_point_px[1] + by[3]],
            distortion: std::array::from_fn(|k| self.distortion[k] + by[4 + k]),
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn derivatives_are_those_of_differences(
            x in -0.5..0.5f64, y in -0.4..0.4f64, z in 0.5..3.0f64, k in 0..LENS, turn in prop::array::uniform3(-2.0..2.0f64),
        ) {
            let mut lens = Intrinsics::pinhole(640, 480, 590.0);
            lens.focal_px[1] = 600.0;
            lens.distortion = [-0.2, 0.05, 0.001, -0.002, 0.01];
            let p = Point3::new(x * z, y * z, z);
            let at = lens.project_with_derivatives(&p).unwrap();
            prop_assert!((at.pixel - lens.project(&p).unwrap()).norm() < 1e-9);
            let h = 1e-6;
            let by = SVector::<f64, LENS>::ith(k, h);
            let slope = (lens.changed(&by).project(&p).unwrap() - lens.changed(&-by).project(&p).unwrap()) / (2.0 * h);
            prop_assert!((slope - at.by_lens.column(k)).norm() < 1e-5 * (1.0 + slope.norm()));
            let world_from_camera = Isometry3::new(Vector3::new(1.0, 2.0, -3.0), Vector3::from(turn));
            let point = world_from_camera * p;
            let seen = |h: f64| {
                let by = SVector::<f64, POSE>::ith(k % POSE, h);
                let camera = Camera { intrinsics: lens.clone(), world_from_camera: moved(&world_from_camera, &by) };
                camera.project(&point).unwrap()
            };
            let slope = (seen(h) - seen(-h)) / (2.0 * h);
            let by_pose = at.by_pose(&world_from_camera.rotation, &(point.coords - world_from_camera.translation.vector));
            prop_assert!((slope - by_pose.column(k % POSE)).norm() < 1e-4 * (1.0 + slope.norm()));
        }
    }
}

//! How well a camera is known, and what follows for where it sees a point.

use super::derivatives::{LENS, POSE};
use super::{Camera, Intrinsics};
use nalgebra::{DMatrix, Matrix2, Point3, SMatrix};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Covariance of a lens' parameters, in the order of [`LENS`].
pub type LensCovariance = SMatrix<f64, LENS, LENS>;

/// Covariance of a camera's parameters: those of the lens ([`LENS`]), then those of the pose ([`POSE`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraCovariance(pub SMatrix<f64, { LENS + POSE }, { LENS + POSE }>);

impl CameraCovariance {
    /// Of a matrix of that size.
    pub fn new(covariance: &DMatrix<f64>) -> Self {
        Self(SMatrix::from_fn(|i, j| 0.5 * (covariance[(i, j)] + covariance[(j, i)])))
    }

    /// Standard deviation of a parameter.
    pub fn sigma(&self, parameter: usize) -> f64 {
        self.0[(parameter, parameter)].max(0.0).sqrt()
    }

    /// Of the camera's centre, along the world's axes, m.
    pub fn position_sigma_m(&self) -> [f64; 3] {
        std::array::from_fn(|k| self.sigma(LENS + k))
    }

    /// Of its turn about the world's axes, rad.
    pub fn rotation_sigma_rad(&self) -> [f64; 3] {
        std::array::from_fn(|k| self.sigma(LENS + 3 + k))
    }

    /// Covariance of the pixel at which a point of the world is seen, px²; `None` behind the camera.
    pub fn of_pixel(&self, camera: &Camera, point: &Point3<f64>) -> Option<Matrix2<f64>> {
        let pose = &camera.world_from_camera;
        let seen = camera.intrinsics.project_with_derivatives(&pose.inverse_transform_point(point))?;
        let by_pose = seen.by_pose(&pose.rotation, &(point.coords - pose.translation.vector));
        let mut by_all = SMatrix::<f64, 2, { LENS + POSE }>::zeros();
        by_all.fixed_columns_mut::<LENS>(0).copy_from(&seen.by_lens);
        by_all.fixed_columns_mut::<POSE>(LENS).copy_from(&by_pose);
        Some(by_all * self.0 * by_all.transpose())
    }

    /// Standard deviation of that pixel in the direction in which it is known worst, px.
    pub fn pixel_sigma_px(&self, camera: &Camera, point: &Point3<f64>) -> Option<f64> {
        Some(self.of_pixel(camera, point)?.symmetric_eigenvalues().max().max(0.0).sqrt())
    }
}

/// Covariance of cameras that share a lens: the lens' parameters, then those of each place's pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SharedCovariance {
    /// Photographs by the place they were taken from.
    pub places: BTreeMap<String, usize>,
    /// Of [`LENS`] parameters, then [`POSE`] for each place.
    pub covariance: DMatrix<f64>,
}

impl SharedCovariance {
    /// Of photographs from one place.
    pub fn of_one(files: impl IntoIterator<Item = String>, camera: &CameraCovariance) -> Self {
        let covariance = DMatrix::from_fn(LENS + POSE, LENS + POSE, |i, j| camera.0[(i, j)]);
        Self { places: files.into_iter().map(|f| (f, 0)).collect(), covariance }
    }

    /// Where the pose of a place stands in it.
    pub fn pose(place: usize) -> usize {
        LENS + POSE * place
    }

    /// Of one place's camera.
    pub fn camera(&self, place: usize) -> CameraCovariance {
        let at = |k: usize| if k < LENS { k } else { Self::pose(place) + k - LENS };
        CameraCovariance(SMatrix::from_fn(|i, j| self.covariance[(at(i), at(j))]))
    }
}

/// Of a focal length alone, the same along x and y.
pub fn focal_alone(sigma_px: f64) -> LensCovariance {
    let mut covariance = LensCovariance::zeros();
    covariance.fixed_view_mut::<2, 2>(0, 0).fill(sigma_px * sigma_px);
    covariance
}

impl Intrinsics {
    /// The parameters in the order of [`LENS`].
    pub fn parameters(&self) -> [f64; LENS] {
        let ([f, g], [x, y], [k1, k2, p1, p2, k3]) =
            (self.focal_px, self.principal_point_px, self.distortion);
        [f, g, x, y, k1, k2, p1, p2, k3]
    }
}

#[cfg(test)]
mod tests {
    use super::super::moved;
    use super::*;
    use nalgebra::{Isometry3, SVector, Vector3};
    use rand::{Rng, SeedableRng, rngs::SmallRng};

    #[test]
    fn cameras_drawn_by_their_covariance_see_points_with_the_deviation_predicted() {
        let mut random = SmallRng::seed_from_u64(5);
        let mut normal = || (0..12).map(|_| random.random_range(-0.5..0.5_f64)).sum::<f64>();
        // A root of the covariance with all parameters mixed, each in its own unit.
        let units = [2.0, 2.0, 1.0, 1.0, 1e-3, 1e-3, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3];
        let root = DMatrix::from_fn(15, 15, |i, _| units[i] * normal() / 15f64.sqrt());
        let covariance = CameraCovariance::new(&(&root * root.transpose()));
        let camera = Camera {
            intrinsics: Intrinsics::pinhole(640, 480, 590.0),
            world_from_camera: Isometry3::new(Vector3::new(0.3, 1.2, 2.0), Vector3::new(-0.5, 0.2, 0.1)),
        };
        let point = camera.world_from_camera * Point3::new(0.5, 0.3, 2.5);
        let middle = camera.project(&point).unwrap();
        let mut scatter = Matrix2::zeros();
        const DRAWS: usize = 20_000;
        for _ in 0..DRAWS {
            let by = &root * DMatrix::from_fn(15, 1, |_, _| normal());
            let drawn = Camera {
                intrinsics: camera.intrinsics.changed(&SVector::<f64, LENS>::from_fn(|i, _| by[i])),
                world_from_camera: moved(
                    &camera.world_from_camera,
                    &SVector::<f64, POSE>::from_fn(|i, _| by[LENS + i]),
                ),
            };
            let off = drawn.project(&point).unwrap() - middle;
            scatter += off * off.transpose() / DRAWS as f64;
        }
        let predicted = covariance.of_pixel(&camera, &point).unwrap();
        assert!((scatter - predicted).amax() < 0.05 * predicted.amax(), "{scatter} {predicted}");
        let sigma = covariance.pixel_sigma_px(&camera, &point).unwrap();
        assert!((sigma * sigma / scatter.symmetric_eigenvalues().max() - 1.0).abs() < 0.05);
    }
}

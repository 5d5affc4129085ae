//! Marked vanishing lines as geometry, and a pose from them alone.

use super::vanishing::{self, EdgeFit, Placing, RoomEdges};
use super::{PosedCamera, Problem, world_from_grid};
use crate::annotations::{Axis, VanishingLines};
use crate::camera::{Camera, Intrinsics};
use nalgebra::{Isometry3, Point2, Translation3, UnitQuaternion};

/// Pixel as an ideal lens would have it.
pub(super) fn undistorted(intrinsics: &Intrinsics, [x, y]: [f64; 2]) -> Point2<f64> {
    let ([f, g], [cx, cy]) = (intrinsics.focal_px, intrinsics.principal_point_px);
    let [x, y] = intrinsics.undistort([(x - cx) / f, (y - cy) / g]);
    Point2::new(f * x + cx, g * y + cy)
}

/// The marked edges, freed of distortion.
pub fn edges_of(lines: &VanishingLines, intrinsics: &Intrinsics) -> RoomEdges {
    let edges = |lines: &[[f64; 4]]| {
        let edge = |[a, b, c, d]: &[f64; 4]| [[*a, *b], [*c, *d]].map(|p| undistorted(intrinsics, p));
        lines.iter().map(edge).collect()
    };
    RoomEdges { along: [edges(&lines.x), edges(&lines.y), edges(&lines.z)] }
}

/// What places the camera by the marks of origin and length.
pub(super) fn placing(lines: &VanishingLines, intrinsics: &Intrinsics) -> Result<Placing, Problem> {
    let (origin, scale) = lines.origin.zip(lines.scale.as_ref()).ok_or(Problem::NoOriginOrScale)?;
    Ok(Placing::Marks {
        origin: undistorted(intrinsics, origin),
        length: [scale.from, scale.to].map(|p| undistorted(intrinsics, p)),
        axis: match scale.axis {
            Axis::X => 0,
            Axis::Y => 1,
            Axis::Z => 2,
        },
        length_m: scale.length_m,
    })
}

/// Pose from orientation and what places the camera (tutorial §3). The room's frame takes the place of the grid's.
pub fn pose_from_lines(
    placing: &Placing,
    fit: &EdgeFit,
    intrinsics: &Intrinsics,
    sigma_px: f64,
) -> Result<PosedCamera, Problem> {
    let principal = Point2::from(intrinsics.principal_point_px);
    let centre = vanishing::camera_centre(placing, fit.room.focal_px, principal, &fit.room.camera_from_room)?;
    let sigma = vanishing::camera_centre_sigma(placing, fit, principal, sigma_px)?;
    let grid_from_camera = Isometry3::from_parts(
        Translation3::from(centre),
        UnitQuaternion::from_rotation_matrix(&fit.room.camera_from_room.inverse()),
    );
    let world_from_camera = world_from_grid() * grid_from_camera;
    // Turns are known in the camera frame; in the world's they mix.
    let turn = world_from_camera.rotation.to_rotation_matrix();
    let turn = turn.matrix();
    let covariance = turn * fit.covariance.fixed_view::<3, 3>(1, 1) * turn.transpose();
    Ok(PosedCamera {
        camera: Camera { intrinsics: intrinsics.clone(), world_from_camera },
        rms_px: fit.rms_px,
        // (x, y, z) of the room is (x, −z, y) of the world.
        position_sigma_m: [sigma[0], sigma[2], sigma[1]],
        rotation_sigma_rad: std::array::from_fn(|k| covariance[(k, k)].max(0.0).sqrt()),
        rival_rms_px: None,
    })
}

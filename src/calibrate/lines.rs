//! Marked vanishing lines as geometry, and a pose from them alone.

use super::vanishing::{self, EdgeFit, Placing, RoomEdges};
use super::{PosedCamera, Problem, world_from_grid};
use crate::annotations::{Axis, VanishingLines};
use crate::camera::{Camera, CameraCovariance, Intrinsics, LENS, POSE};
use nalgebra::{DMatrix, Isometry3, Point2, Translation3, UnitQuaternion};

/// Pixel as an ideal lens would have it.
pub fn undistorted(intrinsics: &Intrinsics, [x, y]: [f64; 2]) -> Point2<f64> {
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
    let (centre_by_all, of_all) = vanishing::camera_centre_errors(placing, fit, principal, sigma_px)?;
    let grid_from_camera = Isometry3::from_parts(
        Translation3::from(centre),
        UnitQuaternion::from_rotation_matrix(&fit.room.camera_from_room.inverse()),
    );
    let world_from_camera = world_from_grid() * grid_from_camera;
    // Lens and pose by the focal length, the room's turn in the camera frame, and the marks.
    let mut by_all = DMatrix::zeros(LENS + POSE, of_all.ncols());
    by_all.view_mut((0, 0), (2, 1)).fill(1.0);
    // Principal point and k1.
    [(2, 4), (3, 5), (4, 6)].iter().for_each(|at| by_all[*at] = 1.0);
    let turn = world_from_grid().rotation.to_rotation_matrix();
    by_all.rows_mut(LENS, 3).copy_from(&(turn.matrix() * centre_by_all));
    let turn = world_from_camera.rotation.to_rotation_matrix();
    by_all.view_mut((LENS + 3, 1), (3, 3)).copy_from(&-turn.matrix());
    let covariance = &by_all * of_all * by_all.transpose();
    Ok(PosedCamera {
        camera: Camera { intrinsics: intrinsics.clone(), world_from_camera },
        rms_px: fit.rms_px,
        covariance: Some(CameraCovariance::new(&covariance)),
        rival_rms_px: None,
    })
}

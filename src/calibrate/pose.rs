//! The pose of a view: a bundle of the grid's corners and the room's vanishing lines.

use super::vanishing::{self, RoomEdges};
use super::{PosedCamera, Problem, world_from_grid};
use crate::camera::{self, Camera, CameraCovariance, Intrinsics, LENS, LensCovariance, POSE};
use crate::least_squares::{self, Fit, Loss};
use crate::vision::{self, BoardView};
use nalgebra::{DMatrix, DVector, Isometry3, Point3, SVector, Vector3};

/// What is seen from one place.
pub struct View<'a> {
    /// The lens.
    pub intrinsics: &'a Intrinsics,
    /// How well the lens is known; 0 where it is not.
    pub lens_covariance: &'a LensCovariance,
    /// The grid, in as many photographs as were taken from there.
    pub boards: &'a [BoardView],
    /// Accuracy of a corner along x or y, px; the fit's own scatter counts if it is larger.
    pub corner_sigma_px: f64,
    /// Edges of the room, with the accuracy of a mark, px. The room is turned about the vertical against the grid.
    pub edges: Option<(&'a RoomEdges, f64)>,
}

/// A pose with what the edges say about it.
#[derive(Debug, Clone)]
pub struct ViewPose {
    /// The pose.
    pub posed: PosedCamera,
    /// Turn of the room's x direction against the grid's, rad.
    pub room_yaw: Option<f64>,
    /// Distance of the edges' ends from the fit, rms in px.
    pub edge_rms_px: Option<f64>,
}

/// Fits the pose. Both solutions of the planar ambiguity are followed to the end; the better one is returned, the other's
/// error noted.
pub fn fit(view: &View) -> Result<ViewPose, Problem> {
    let first = view.boards.first().ok_or(Problem::NoGridInPlate)?;
    let starts = vision::planar_poses(first, view.intrinsics)?;
    let mut fits = Vec::new();
    let mut failure = Problem::NoPose;
    for camera_from_grid in starts {
        let start = world_from_grid() * camera_from_grid.inverse();
        match fit_from(view, start) {
            Ok(fit) => fits.push(fit),
            Err(e) => failure = e,
        }
    }
    fits.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut fits = fits.into_iter();
    let (_, mut best) = fits.next().ok_or(failure)?;
    // The two starts may end in one minimum.
    best.posed.rival_rms_px = fits
        .map(|(_, other)| other.posed)
        .find(|o| {
            o.camera.world_from_camera.rotation.angle_to(&best.posed.camera.world_from_camera.rotation) > 1e-3
        })
        .map(|o| o.rms_px);
    Ok(best)
}

/// Pose from 6 parameters: shift of the centre (world, m) and turn about it (world, rad), from a start.
fn moved(start: &Isometry3<f64>, x: &[f64]) -> Isometry3<f64> {
    camera::moved(start, &SVector::<f64, POSE>::from_column_slice(x))
}

/// Covariance of lens and pose: that of the pose for a lens that is known, and how the pose follows the lens, on whose parameters
/// the residuals of the fit depend by `by_lens`.
fn covariance(fit: &Fit, by_lens: &DMatrix<f64>, lens: &LensCovariance) -> CameraCovariance {
    let follows = fit.gain.rows(0, POSE) * by_lens;
    let mut from_lens = DMatrix::identity(LENS + POSE, LENS);
    from_lens.rows_mut(LENS, POSE).copy_from(&follows);
    let mut all = &from_lens * lens * from_lens.transpose();
    let mut of_pose = all.view_mut((LENS, LENS), (POSE, POSE));
    of_pose += fit.covariance.view((0, 0), (POSE, POSE));
    CameraCovariance::new(&all)
}

/// Differences of residuals by each parameter of the lens.
fn by_lens(
    lens: &Intrinsics,
    residuals: impl Fn(&Intrinsics) -> Option<DVector<f64>>,
) -> Option<DMatrix<f64>> {
    let columns = (0..LENS).map(|k| {
        let h = if k < 4 { 1e-3 } else { 1e-6 };
        let by = SVector::<f64, LENS>::ith(k, h);
        Some((residuals(&lens.changed(&by))? - residuals(&lens.changed(&-by))?) / (2.0 * h))
    });
    Some(DMatrix::from_columns(&columns.collect::<Option<Vec<_>>>()?))
}

fn names() -> Vec<String> {
    [
        "the camera's x",
        "the camera's y",
        "the camera's z",
        "the tilt",
        "the heading",
        "the roll",
        "the room's turn",
    ]
    .map(String::from)
    .to_vec()
}

/// How far the corners of boards that lie on the grid's plane are off, x and y of each, px; `None` with one behind the camera.
pub(super) fn corner_errors(boards: &[BoardView], camera: &Camera) -> Option<Vec<f64>> {
    let mut errors = Vec::new();
    for (board, pixel) in boards.iter().flat_map(|b| b.board.iter().zip(&b.pixels)) {
        let e = camera.project(&(world_from_grid() * Point3::new(board.x, board.y, 0.0)))? - pixel;
        errors.extend([e.x, e.y]);
    }
    Some(errors)
}

/// Root mean square of distances whose x and y follow each other.
pub(super) fn rms_distance(errors: &[f64]) -> f64 {
    (2.0 * errors.iter().map(|e| e * e).sum::<f64>() / errors.len().max(1) as f64).sqrt()
}

/// Residuals of edges in a room turned by `yaw` against the grid, px.
pub(super) fn edge_errors(edges: &RoomEdges, camera: &Camera, yaw: f64) -> Vec<f64> {
    let lens = &camera.intrinsics;
    let ([f, g], [cx, cy]) = (lens.focal_px, lens.principal_point_px);
    let (sin, cos) = yaw.sin_cos();
    let room = [Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0), Vector3::z()];
    let vanishing = room.map(|d| {
        let d = camera.world_from_camera.inverse() * (world_from_grid() * d);
        Vector3::new(f * d.x + cx * d.z, g * d.y + cy * d.z, d.z)
    });
    let each = edges.along.iter().zip(vanishing);
    each.flat_map(|(edges, v)| edges.iter().map(move |e| vanishing::edge_residual(&v, e))).collect()
}

fn fit_from(view: &View, start: Isometry3<f64>) -> Result<(f64, ViewPose), Problem> {
    let posed = |lens: &Intrinsics, pose: &Isometry3<f64>| Camera {
        intrinsics: lens.clone(),
        world_from_camera: *pose,
    };
    let corner_errors =
        |lens: &Intrinsics, pose: &Isometry3<f64>| corner_errors(view.boards, &posed(lens, pose));
    let alone = |lens: &Intrinsics, x: &DVector<f64>| {
        corner_errors(lens, &moved(&start, x.as_slice())).map(DVector::from_vec)
    };
    let grid_fit = least_squares::minimise(
        &|x: &DVector<f64>| alone(view.intrinsics, x),
        &names(),
        &[0.0; POSE],
        Loss::Squares,
    )?;
    let solved = |fit: &Fit, start: &Isometry3<f64>, by_lens: &DMatrix<f64>| -> Option<PosedCamera> {
        let world_from_camera = moved(start, &fit.parameters.as_slice()[..POSE]);
        let errors = corner_errors(view.intrinsics, &world_from_camera)?;
        Some(PosedCamera {
            camera: posed(view.intrinsics, &world_from_camera),
            rms_px: rms_distance(&errors),
            covariance: Some(covariance(fit, by_lens, view.lens_covariance)),
            rival_rms_px: None,
        })
    };
    let Some((edges, edge_sigma)) = view.edges else {
        let by_lens = by_lens(view.intrinsics, |lens| alone(lens, &grid_fit.parameters));
        let posed = by_lens.and_then(|by| solved(&grid_fit, &start, &by)).ok_or(Problem::NoPose)?;
        return Ok((grid_fit.cost(), ViewPose { posed, room_yaw: None, edge_rms_px: None }));
    };

    let start = moved(&start, grid_fit.parameters.as_slice());
    let corner_sigma = view.corner_sigma_px.max(grid_fit.rms);
    let edge_errors =
        |lens: &Intrinsics, pose: &Isometry3<f64>, yaw: f64| edge_errors(edges, &posed(lens, pose), yaw);
    // Huber's cost of the edges alone finds the room's turn; the directions have no sign.
    let cost = |yaw: f64| -> f64 {
        let errors = edge_errors(view.intrinsics, &start, yaw);
        errors.iter().map(|e| (e / edge_sigma).abs().min(100.0)).sum()
    };
    let turns = (0..180).map(|k| f64::from(k).to_radians());
    let yaw = turns.min_by(|a, b| cost(*a).total_cmp(&cost(*b))).unwrap_or(0.0);
    let residuals = |lens: &Intrinsics, x: &DVector<f64>| {
        let pose = moved(&start, &x.as_slice()[..POSE]);
        let mut r = corner_errors(lens, &pose)?;
        r.iter_mut().for_each(|e| *e /= corner_sigma);
        r.extend(edge_errors(lens, &pose, x[POSE]).iter().map(|e| e / edge_sigma));
        Some(DVector::from_vec(r))
    };
    let first = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, yaw];
    let fit = least_squares::minimise(
        &|x: &DVector<f64>| residuals(view.intrinsics, x),
        &names(),
        &first,
        Loss::Huber(vanishing::ROBUST),
    )?;
    let by_lens = by_lens(view.intrinsics, |lens| residuals(lens, &fit.parameters));
    let found = by_lens.and_then(|by| solved(&fit, &start, &by)).ok_or(Problem::NoPose)?;
    let errors = edge_errors(view.intrinsics, &found.camera.world_from_camera, fit.parameters[POSE]);
    let edge_rms_px = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len().max(1) as f64).sqrt();
    Ok((
        fit.cost(),
        ViewPose { posed: found, room_yaw: Some(fit.parameters[POSE]), edge_rms_px: Some(edge_rms_px) },
    ))
}

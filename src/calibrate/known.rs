//! What is known of the plate's camera apart from the scene's primitives, as residuals of a larger fit.

use super::pose::{corner_errors, edge_errors};
use super::solve::{self, Evidence, Solution};
use super::vanishing::StatedFocal;
use super::{PosedCamera, edges_of, world_from_grid};
use crate::annotations::{Axis, Scale, VanishingLines};
use crate::camera::{Camera, CameraCovariance, LENS, LensCovariance, POSE, focal_alone, moved};
use crate::config::{self, PoseSource};
use crate::vision::BoardView;
use nalgebra::{DMatrix, DVector, Point2, Point3, SVector, SymmetricEigen, Vector3};

/// A direction of a covariance below this share of the largest one, all deviations being scaled to 1, is held.
const HELD: f64 = 1e-9;
/// Where the camera's height alone places it, the accuracy of that height, as a share, and of where the origin is seen, px: they
/// choose the frame.
const HEIGHT_SIGMA: f64 = 1e-3;
const ORIGIN_SIGMA_PX: f64 = 0.05;

/// Evidence of the plate's camera, and what may change of it.
pub(super) struct Known<'a> {
    /// Where it starts.
    start: Camera,
    /// Changes of lens and pose (rows, in the order of [`LENS`] and [`POSE`]) by what is fitted.
    pub directions: DMatrix<f64>,
    /// So many of these, the first ones, are standard deviations of what is known already.
    prior: usize,
    boards: &'a [BoardView],
    corner_sigma_px: f64,
    /// Marked edges.
    lines: Option<&'a VanishingLines>,
    line_sigma_px: f64,
    /// The room is turned so against the grid, rad; 0 and held where its frame is the grid's.
    yaw: f64,
    turned: bool,
    placing: Option<Placing>,
    stated: Option<StatedFocal>,
}

/// What places the camera where no board does.
enum Placing {
    Marks { origin: [f64; 2], scale: Scale },
    Height { looks_at: [f64; 2], height_m: f64 },
}

impl<'a> Known<'a> {
    /// From what the plate's camera was found without primitives.
    pub fn new(found: &'a Solution, evidence: &Evidence<'a>, settings: &config::Calibrate) -> Option<Self> {
        let start = found.plate.camera.clone();
        let boards = &found.used.boards[..];
        let marked = evidence.lines.filter(|lines| lines.has_edges());
        let by_lines = found.lens.is_none() && marked.is_some() && found.focal_source != "exif";
        // Edges that are found lean, all in one way: of these only the camera's covariance is known.
        if boards.is_empty() && !by_lines {
            let directions = deviations(&found.plate.covariance.as_ref()?.0);
            let prior = directions.ncols();
            return Some(Self::of(start, directions, prior));
        }
        let own = found.used.room_yaw.or(found.edges.as_ref().map(|e| {
            let x = start.world_from_camera * (e.room.camera_from_room * Vector3::x());
            let x = world_from_grid().inverse() * x;
            x.y.atan2(x.x)
        }));
        let lines = marked.filter(|_| (by_lines || settings.pose == PoseSource::Both) && own.is_some());
        let of_lens =
            if by_lines { free_lens(&start, settings) } else { of_prior(found, evidence, settings) };
        let mut directions = DMatrix::zeros(LENS + POSE, of_lens.ncols() + POSE);
        directions.view_mut((0, 0), of_lens.shape()).copy_from(&of_lens);
        directions.view_mut((LENS, of_lens.ncols()), (POSE, POSE)).fill_with_identity();
        let prior = if by_lines { 0 } else { of_lens.ncols() };
        let of_lens_rms = found.lens.as_ref().map_or(0.0, |l| l.fit.rms_px);
        Some(Self {
            boards,
            corner_sigma_px: of_lens_rms.max(found.plate.rms_px) / 2f64.sqrt(),
            lines,
            line_sigma_px: settings.mark_sigma_px,
            yaw: if boards.is_empty() { 0.0 } else { own.unwrap_or(0.0) },
            turned: lines.is_some() && !boards.is_empty(),
            placing: if boards.is_empty() { Some(placing(evidence, settings)?) } else { None },
            stated: solve::stated_focal(evidence, settings).filter(|_| by_lines),
            ..Self::of(start, directions, prior)
        })
    }

    fn of(start: Camera, directions: DMatrix<f64>, prior: usize) -> Self {
        Self {
            start,
            directions,
            prior,
            boards: &[],
            corner_sigma_px: 1.0,
            lines: None,
            line_sigma_px: 1.0,
            yaw: 0.0,
            turned: false,
            placing: None,
            stated: None,
        }
    }

    /// Parameters besides the camera's own: the room's turn; of a known length where it starts, in the grid's plane, m.
    pub fn names(&self) -> Vec<String> {
        let scaled = matches!(self.placing, Some(Placing::Marks { .. }));
        let own = [(self.turned, "the room's turn", 1), (scaled, "the start of the known length", 2)];
        let own = own.into_iter().filter(|o| o.0).flat_map(|(_, name, count)| vec![name; count]);
        own.chain(vec!["the camera"; self.directions.ncols()]).map(String::from).collect()
    }

    /// Where these start.
    pub fn first(&self) -> Vec<f64> {
        let mut first = if self.turned { vec![self.yaw] } else { Vec::new() };
        if let Some(Placing::Marks { scale, .. }) = &self.placing {
            let ray = self.start.ray(&Point2::from(scale.from));
            let at = ray.origin + ray.direction.into_inner() * (-ray.origin.y / ray.direction.y);
            let at = world_from_grid().inverse() * at;
            first.extend([at.x, at.y]);
        }
        first.extend(vec![0.0; self.directions.ncols()]);
        first
    }

    /// The camera by the parameters, which come last of those of [`Self::names`].
    pub fn camera(&self, x: &[f64]) -> Camera {
        let own = &x[x.len() - self.directions.ncols()..];
        let by = &self.directions * DVector::from_column_slice(own);
        let lens = SVector::<f64, LENS>::from_fn(|k, _| by[k]);
        let pose = SVector::<f64, POSE>::from_fn(|k, _| by[LENS + k]);
        Camera {
            intrinsics: self.start.intrinsics.changed(&lens),
            world_from_camera: moved(&self.start.world_from_camera, &pose),
        }
    }

    /// Residuals in standard deviations; `None` with a mark behind the camera.
    pub fn rows(&self, x: &[f64], camera: &Camera) -> Option<Vec<f64>> {
        let from = x.len() - self.directions.ncols();
        let (extra, own) = x.split_at(from);
        let mut rows = own[..self.prior].to_vec();
        let corners = corner_errors(self.boards, camera)?;
        rows.extend(corners.iter().map(|e| e / self.corner_sigma_px));
        if let Some(lines) = self.lines {
            let yaw = if self.turned { extra[0] } else { 0.0 };
            let edges = edges_of(lines, &camera.intrinsics);
            rows.extend(edge_errors(&edges, camera, yaw).iter().map(|e| e / self.line_sigma_px));
        }
        let mut push = |point: Vector3<f64>, at: [f64; 2], sigma_px: f64| {
            let e = camera.project(&(world_from_grid() * Point3::from(point)))? - Point2::from(at);
            rows.extend([e.x / sigma_px, e.y / sigma_px]);
            Some(())
        };
        match &self.placing {
            Some(Placing::Marks { origin, scale }) => {
                let [u, v] = [extra[extra.len() - 2], extra[extra.len() - 1]];
                let along = match scale.axis {
                    Axis::X => Vector3::x(),
                    Axis::Y => Vector3::y(),
                    Axis::Z => Vector3::z(),
                };
                let foot = Vector3::new(u, v, 0.0);
                push(Vector3::zeros(), *origin, self.line_sigma_px)?;
                push(foot, scale.from, self.line_sigma_px)?;
                push(foot + along * scale.length_m, scale.to, self.line_sigma_px)?;
            }
            Some(Placing::Height { looks_at, height_m }) => {
                push(Vector3::zeros(), *looks_at, ORIGIN_SIGMA_PX)?;
                rows.push((camera.centre().y / height_m - 1.0) / HEIGHT_SIGMA);
            }
            None => {}
        }
        let focal = camera.intrinsics.focal_px[0];
        rows.extend(self.stated.map(|s| (focal / s.focal_px).ln() / s.relative_sigma));
        Some(rows)
    }

    /// The camera with its accuracy and what is left of the boards' residuals.
    pub fn posed(&self, before: &PosedCamera, camera: Camera, covariance: CameraCovariance) -> PosedCamera {
        let corners = corner_errors(self.boards, &camera).filter(|c| !c.is_empty());
        PosedCamera {
            rms_px: corners.map_or(before.rms_px, |c| super::pose::rms_distance(&c)),
            camera,
            covariance: Some(covariance),
            rival_rms_px: before.rival_rms_px,
        }
    }
}

fn placing(evidence: &Evidence, settings: &config::Calibrate) -> Option<Placing> {
    let marked = evidence.lines.and_then(|l| l.origin.zip(l.scale.clone()));
    let height_m = settings.camera_height_m;
    let looks_at = [f64::from(evidence.width_px) / 2.0, 0.75 * f64::from(evidence.height_px)];
    match marked {
        Some((origin, scale)) => Some(Placing::Marks { origin, scale }),
        None => (height_m > 0.0).then_some(Placing::Height { looks_at, height_m }),
    }
}

/// Of a lens that lines tell: focal length, and what else they were asked for.
fn free_lens(start: &Camera, settings: &config::Calibrate) -> DMatrix<f64> {
    let mut columns = vec![(vec![0, 1], start.intrinsics.focal_px[0] * 0.01)];
    if settings.solve_principal_point {
        columns.extend([(vec![2], 1.0), (vec![3], 1.0)]);
    }
    if settings.plumb_lines && start.intrinsics.distortion[0] != 0.0 {
        columns.push((vec![4], 0.01));
    }
    let mut directions = DMatrix::zeros(LENS, columns.len());
    for (column, (rows, unit)) in columns.iter().enumerate() {
        rows.iter().for_each(|row| directions[(*row, column)] = *unit);
    }
    directions
}

/// Of a lens that was known before: from photographs of the grid, or a focal length by its accuracy.
fn of_prior(found: &Solution, evidence: &Evidence, settings: &config::Calibrate) -> DMatrix<f64> {
    match &found.lens {
        Some(lens) => deviations(&lens.fit.covariance),
        None => {
            let stated = solve::stated_focal(evidence, settings).map(|s| s.relative_sigma * s.focal_px);
            let covariance: LensCovariance = focal_alone(found.focal_sigma_px.or(stated).unwrap_or(0.0));
            deviations(&covariance)
        }
    }
}

/// Directions across each other in which a covariance has a deviation of 1; none in which it has none.
fn deviations<const N: usize>(covariance: &nalgebra::SMatrix<f64, N, N>) -> DMatrix<f64> {
    let sigma: Vec<f64> = (0..N).map(|k| covariance[(k, k)].max(0.0).sqrt()).collect();
    let scaled = DMatrix::from_fn(N, N, |i, j| {
        let product = sigma[i] * sigma[j];
        if product > 0.0 { covariance[(i, j)] / product } else { 0.0 }
    });
    let eigen = SymmetricEigen::new(scaled);
    let largest = eigen.eigenvalues.max();
    let kept: Vec<usize> = (0..N).filter(|&k| eigen.eigenvalues[k] > HELD * largest.max(HELD)).collect();
    DMatrix::from_fn(N, kept.len(), |i, k| {
        sigma[i] * eigen.eigenvectors[(i, kept[k])] * eigen.eigenvalues[kept[k]].sqrt()
    })
}

//! Lens and poses from views of flat boards at once (Zhang 2000): Levenberg and Marquardt's steps over all corners, the poses
//! eliminated view by view (Triggs et al., *Bundle Adjustment – A Modern Synthesis*, 2000, §6.1), with the full covariance.

use super::{Problem, board};
use crate::camera::{Intrinsics, LENS, LensCovariance, POSE, moved};
use crate::vision::{self, BoardView};
use nalgebra::{DMatrix, DVector, Isometry3, Point3, SMatrix, SVector};

/// What a lens model leaves free; a part that is not free is zero, central, or equal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FreeLens {
    /// Two focal lengths instead of one.
    pub aspect: bool,
    /// Principal point off the image centre.
    pub principal_point: bool,
    /// k1, k2, k3.
    pub radial: [bool; 3],
    /// p1, p2.
    pub tangential: bool,
}

impl FreeLens {
    /// Everything free.
    pub const ALL: Self = Self { aspect: true, principal_point: true, radial: [true; 3], tangential: true };

    /// Changes of the lens by its free parameters, one a column.
    fn columns(self) -> DMatrix<f64> {
        let [k1, k2, k3] = self.radial;
        let (aspect, centre, tangential) = (self.aspect, self.principal_point, self.tangential);
        let free = [true, aspect, centre, centre, k1, k2, tangential, tangential, k3];
        let kept: Vec<usize> = (0..LENS).filter(|k| free[*k]).collect();
        let mut columns = DMatrix::zeros(LENS, kept.len());
        kept.iter().enumerate().for_each(|(column, k)| columns[(*k, column)] = 1.0);
        if !aspect {
            columns[(1, 0)] = 1.0;
        }
        columns
    }

    /// `start` with nothing that is not free.
    fn bound(self, start: &Intrinsics) -> Intrinsics {
        let plain = Intrinsics::pinhole(start.width_px, start.height_px, start.focal_px[0]);
        let d = start.distortion;
        let keep = |free: bool, value: f64| if free { value } else { 0.0 };
        Intrinsics {
            focal_px: if self.aspect { start.focal_px } else { plain.focal_px },
            principal_point_px: if self.principal_point {
                start.principal_point_px
            } else {
                plain.principal_point_px
            },
            distortion: [
                keep(self.radial[0], d[0]),
                keep(self.radial[1], d[1]),
                keep(self.tangential, d[2]),
                keep(self.tangential, d[3]),
                keep(self.radial[2], d[4]),
            ],
            ..plain
        }
    }
}

/// A calibrated lens with the boards' poses.
#[derive(Debug, Clone)]
pub struct Bundle {
    /// Inner orientation.
    pub intrinsics: Intrinsics,
    /// Its covariance, by the residuals' scatter; 0 of what was held.
    pub covariance: LensCovariance,
    /// Of each view.
    pub board_from_camera: Vec<Isometry3<f64>>,
    /// Distance of all corners from where they should be seen, rms in px.
    pub rms_px: f64,
    /// The same for each view.
    pub view_rms_px: Vec<f64>,
    /// How far the poses are from telling the lens apart from themselves: by so many times the focal length is known worse than it
    /// would be were everything else known, over its length in widths of the picture, in proportion to which that grows.
    pub condition: f64,
}

impl Bundle {
    /// Standard deviation of a parameter.
    pub fn sigma(&self, parameter: usize) -> f64 {
        self.covariance[(parameter, parameter)].max(0.0).sqrt()
    }
}

/// Iterations at most, and the decrease of the cost, as a share of it, below which they end.
const MOST: usize = 100;
const SETTLED: f64 = 1e-12;

/// Fits what is free of a lens, and the poses, from a first lens on.
pub fn fit(views: &[BoardView], start: &Intrinsics, free: FreeLens) -> Result<Bundle, Problem> {
    let start = free.bound(start);
    let poses = views
        .iter()
        .map(|view| Ok(vision::planar_poses(view, &start)?.first().ok_or(Problem::NoPose)?.inverse()));
    let poses = poses.collect::<Result<Vec<_>, Problem>>()?;
    let mut at = State { intrinsics: start, poses };
    let columns = free.columns();
    let mut normal = Normal::of(views, &at, &columns).ok_or(Problem::NoPose)?;
    let mut damping = 1e-3;
    for _ in 0..MOST {
        let Some(step) = normal.step(damping) else {
            damping *= 10.0;
            continue;
        };
        let next = at.moved(&step, &columns);
        let better = Normal::of(views, &next, &columns).filter(|n| n.cost < normal.cost);
        let Some(better) = better else {
            damping *= 10.0;
            if damping > 1e12 {
                break;
            }
            continue;
        };
        let gained = 1.0 - better.cost / normal.cost.max(f64::MIN_POSITIVE);
        (at, normal) = (next, better);
        damping = (damping * 0.1).max(1e-12);
        if gained < SETTLED {
            break;
        }
    }
    normal.finished(views, at, &columns)
}

/// Focal length of square pixels about the middle of the picture by the boards' homographies: the images of two of the plane's
/// directions at right angles, and of equal length (Zhang 2000, eq. 3 and 4); `None` where all boards face the camera.
pub fn first_focal_px(views: &[BoardView], width_px: u32, height_px: u32) -> Option<f64> {
    let (mut top, mut bottom) = (0.0, 0.0);
    for view in views {
        let mut h = board::homography(view)?;
        let [cx, cy] = [f64::from(width_px) / 2.0, f64::from(height_px) / 2.0];
        for k in 0..3 {
            h[(0, k)] -= cx * h[(2, k)];
            h[(1, k)] -= cy * h[(2, k)];
        }
        let [a, b] = [0, 1].map(|k| h.column(k).clone_owned());
        let size = a.xy().norm() * b.xy().norm();
        // p / f² + q = 0.
        let rows = [
            (a.xy().dot(&b.xy()), a.z * b.z),
            (0.5 * (a.xy().norm_squared() - b.xy().norm_squared()), 0.5 * (a.z * a.z - b.z * b.z)),
        ];
        for (p, q) in rows {
            top -= p * q / (size * size);
            bottom += p * p / (size * size);
        }
    }
    let inverse_square = top / bottom;
    let focal = inverse_square.sqrt().recip();
    let plausible = 0.2..20.0;
    (focal.is_finite() && plausible.contains(&(focal / f64::from(width_px.max(height_px))))).then_some(focal)
}

/// Lens and poses.
struct State {
    intrinsics: Intrinsics,
    poses: Vec<Isometry3<f64>>,
}

impl State {
    fn moved(&self, (lens, poses): &(DVector<f64>, Vec<SVector<f64, POSE>>), columns: &DMatrix<f64>) -> Self {
        let by = SVector::<f64, LENS>::from_iterator((columns * lens).iter().copied());
        let poses = self.poses.iter().zip(poses).map(|(pose, by)| moved(pose, by)).collect();
        Self { intrinsics: self.intrinsics.changed(&by), poses }
    }
}

/// Normal equations: of the lens, and of each view's pose alone and with the lens.
struct Normal {
    cost: f64,
    of_views: Vec<f64>,
    lens: DMatrix<f64>,
    lens_right: DVector<f64>,
    poses: Vec<OfPose>,
}

struct OfPose {
    square: SMatrix<f64, POSE, POSE>,
    /// Lens by pose.
    mixed: DMatrix<f64>,
    right: SVector<f64, POSE>,
}

impl Normal {
    /// `None` where a corner lies behind the camera.
    fn of(views: &[BoardView], at: &State, columns: &DMatrix<f64>) -> Option<Self> {
        let mut square = LensCovariance::zeros();
        let mut right = SVector::<f64, LENS>::zeros();
        let (mut of_views, mut poses) = (Vec::new(), Vec::new());
        for (view, pose) in views.iter().zip(&at.poses) {
            let mut mixed = SMatrix::<f64, LENS, POSE>::zeros();
            let mut of_pose = SMatrix::<f64, POSE, POSE>::zeros();
            let mut pose_right = SVector::<f64, POSE>::zeros();
            let mut cost = 0.0;
            for (board, seen) in view.board.iter().zip(&view.pixels) {
                let point = Point3::new(board.x, board.y, 0.0);
                let p = at.intrinsics.project_with_derivatives(&pose.inverse_transform_point(&point))?;
                let off = seen - p.pixel;
                let by_pose = p.by_pose(&pose.rotation, &(point.coords - pose.translation.vector));
                cost += off.norm_squared();
                square += p.by_lens.tr_mul(&p.by_lens);
                right += p.by_lens.tr_mul(&off);
                mixed += p.by_lens.tr_mul(&by_pose);
                of_pose += by_pose.tr_mul(&by_pose);
                pose_right += by_pose.tr_mul(&off);
            }
            of_views.push(cost);
            let mixed = columns.tr_mul(&mixed);
            poses.push(OfPose {
                square: of_pose,
                mixed: DMatrix::from_column_slice(columns.ncols(), POSE, mixed.as_slice()),
                right: pose_right,
            });
        }
        let cost: f64 = of_views.iter().sum();
        let lens = columns.tr_mul(&square) * columns;
        let lens_right = columns.tr_mul(&right);
        cost.is_finite().then(|| Self {
            cost,
            of_views,
            lens: DMatrix::from_column_slice(columns.ncols(), columns.ncols(), lens.as_slice()),
            lens_right: DVector::from_column_slice(lens_right.as_slice()),
            poses,
        })
    }

    /// The lens' equations without the poses, and what takes a pose out of them.
    fn reduced(&self, damping: f64) -> Option<Reduced> {
        let damped = 1.0 + damping;
        let mut square = self.lens.clone();
        (0..square.nrows()).for_each(|k| square[(k, k)] *= damped);
        let mut right = self.lens_right.clone();
        let mut inverses = Vec::with_capacity(self.poses.len());
        for pose in &self.poses {
            let mut own = pose.square;
            (0..POSE).for_each(|k| own[(k, k)] *= damped);
            let inverse = own.cholesky()?.inverse();
            let taken = &pose.mixed * inverse;
            square -= &taken * pose.mixed.transpose();
            right -= &taken * pose.right;
            inverses.push(inverse);
        }
        Some(Reduced { square, right, inverses })
    }

    fn step(&self, damping: f64) -> Option<(DVector<f64>, Vec<SVector<f64, POSE>>)> {
        let reduced = self.reduced(damping)?;
        let lens = reduced.square.cholesky()?.solve(&reduced.right);
        let of_pose = |(pose, inverse): (&OfPose, &SMatrix<f64, POSE, POSE>)| {
            let rest =
                pose.right - SVector::<f64, POSE>::from_iterator(pose.mixed.tr_mul(&lens).iter().copied());
            inverse * rest
        };
        let poses = self.poses.iter().zip(&reduced.inverses).map(of_pose).collect();
        Some((lens, poses))
    }

    fn finished(&self, views: &[BoardView], at: State, columns: &DMatrix<f64>) -> Result<Bundle, Problem> {
        let open = Problem::PosesAlike { condition: f64::INFINITY, limit: super::lens::MAX_CONDITION };
        let reduced = self.reduced(0.0).ok_or(open.clone())?;
        let corners: usize = views.iter().map(|v| v.pixels.len()).sum();
        let freedom = (2 * corners).saturating_sub(columns.ncols() + POSE * views.len()).max(1);
        let inverse = reduced.square.cholesky().ok_or(open)?.inverse();
        let lens = &at.intrinsics;
        let condition =
            (self.lens[(0, 0)] * inverse[(0, 0)]).sqrt() * f64::from(lens.width_px) / lens.focal_px[0];
        let covariance = columns * inverse * columns.transpose() * (self.cost / freedom as f64);
        let rms = |cost: f64, count: usize| (cost / count.max(1) as f64).sqrt();
        Ok(Bundle {
            intrinsics: at.intrinsics,
            covariance: LensCovariance::from_iterator(covariance.iter().copied()),
            board_from_camera: at.poses,
            rms_px: rms(self.cost, corners),
            view_rms_px: self
                .of_views
                .iter()
                .zip(views)
                .map(|(cost, view)| rms(*cost, view.pixels.len()))
                .collect(),
            condition,
        })
    }
}

struct Reduced {
    square: DMatrix<f64>,
    right: DVector<f64>,
    /// Of each pose's own equations.
    inverses: Vec<SMatrix<f64, POSE, POSE>>,
}

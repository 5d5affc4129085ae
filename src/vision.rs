//! OpenCV, and nothing but OpenCV: chessboard corners, line segments, markers, lens calibration, poses of a plane and of points, video,
//! and its own merging of exposures, which insitu is measured beside.
//!
//! OpenCV counts pixel centres as integers; the shift by half a pixel is made here and nowhere else.

pub mod hdr;
mod markers;
mod segments;
mod video;

use crate::camera::Intrinsics;
use crate::image::Image;
use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};
use opencv::core::{Mat, Point2d, Point2f, Point3d, Point3f, Size, TermCriteria, Vector};
use opencv::prelude::{MatTraitConst, MatTraitConstManual, VectorToVec};
use opencv::{calib3d, imgproc};

pub use markers::{Expected, Marker, marker_cells, markers};
pub use segments::line_segments;
pub use video::{VideoReader, VideoWriter};

/// OpenCV failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// Its own message.
    #[error("OpenCV: {0}")]
    OpenCv(String),
    /// No such set of markers.
    #[error("there is no dictionary of markers `{0}`")]
    Dictionary(String),
    /// A marker that its dictionary does not hold.
    #[error("the dictionary has {count} markers, and none with the number {id}")]
    Marker {
        /// Its number.
        id: u32,
        /// Markers in the dictionary.
        count: u32,
    },
    /// A camera device that is not there, or is in use.
    #[error("camera {0} cannot be opened")]
    Camera(u32),
    /// A video that cannot be read or written.
    #[error("{0}")]
    Video(&'static str),
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::OpenCv(_) => {
                "check that the grid photographs are sharp and the number of corners is right".into()
            }
            Self::Dictionary(name) => markers::nearest(name),
            Self::Marker { .. } => "take another dictionary, or markers with smaller numbers".into(),
            Self::Camera(_) => {
                "plug it in, close what else uses it, and check its number (on Linux 0 is /dev/video0); frames may also come as \
                 a video file or a folder of pictures"
                    .into()
            }
            Self::Video(_) => {
                "check it with a video player; frames may also come as a folder of pictures".into()
            }
        }
    }
}

impl From<opencv::Error> for Problem {
    fn from(e: opencv::Error) -> Self {
        Self::OpenCv(e.message.trim().to_string())
    }
}

/// Pixel of an OpenCV coordinate: its pixel centres are integers, ours lie at +0.5.
const HALF: f64 = 0.5;

/// Inner corners of a chessboard in scan order along its `inner[0]` side, px; `None` if it is not seen whole.
///
/// Tried in turn: the sector-based detector (Duda and Frese 2018) on the enlarged picture, with shadows lifted, as it
/// is; then the classic one with its corners refined by gradients. Enlarging a small picture halves the error.
pub fn chessboard_corners(image: &Image<u8>, inner: [u32; 2]) -> Result<Option<Vec<Point2<f64>>>, Problem> {
    // Enlarging does what `CALIB_CB_ACCURACY` does, four times faster.
    let quick = calib3d::CALIB_CB_NORMALIZE_IMAGE;
    let thorough = quick | calib3d::CALIB_CB_EXHAUSTIVE;
    let unenlarged = thorough | calib3d::CALIB_CB_ACCURACY;
    let pattern = Size::new(inner[0] as i32, inner[1] as i32);
    let pictures = pictures(image)?;
    let enlargement = enlargement(image);
    let mut corners = Vector::<Point2f>::new();
    for (enlargement, flags) in [(enlargement, quick), (enlargement, thorough), (1.0, unenlarged)] {
        for picture in &pictures {
            let picture = enlarge(picture, enlargement)?;
            if calib3d::find_chessboard_corners_sb(&picture, pattern, &mut corners, flags)? {
                return Ok(Some(points(&corners, enlargement)));
            }
        }
    }
    for picture in &pictures {
        if let Some(corners) = classic(picture, pattern, refinement_window)? {
            return Ok(Some(corners));
        }
    }
    Ok(None)
}

/// A rectangle of a chessboard's inner corners.
pub struct CornerRows {
    /// Corners in a row.
    pub columns: usize,
    /// Row by row, px.
    pub pixels: Vec<Point2<f64>>,
}

/// Rectangles of a chessboard's inner corners, at least three by three: guesses, some of whose corners may be none, by the
/// sector-based detector.
pub fn chessboard_parts(image: &Image<u8>) -> Result<Vec<CornerRows>, Problem> {
    let flags = calib3d::CALIB_CB_NORMALIZE_IMAGE | calib3d::CALIB_CB_LARGER;
    let (least, mut parts) = (Size::new(3, 3), Vec::new());
    let mut enlargements = vec![enlargement(image), 1.0];
    enlargements.dedup();
    for enlargement in enlargements {
        for picture in pictures(image)? {
            let picture = enlarge(&picture, enlargement)?;
            let (mut corners, mut meta) = (Vector::<Point2f>::new(), Mat::default());
            calib3d::find_chessboard_corners_sb_with_meta(&picture, least, &mut corners, flags, &mut meta)?;
            let columns = meta.cols().max(0) as usize;
            if columns > 0 && corners.len() == columns * meta.rows() as usize {
                parts.push(CornerRows { columns, pixels: points(&corners, enlargement) });
            }
        }
    }
    Ok(parts)
}

/// The picture as it is, and with its shadows lifted.
fn pictures(image: &Image<u8>) -> Result<[Mat; 2], Problem> {
    let lifted = image.map(|v| (255.0 * (f64::from(*v) / 255.0).sqrt()).round() as u8);
    Ok([matrix(image)?, matrix(&lifted)?])
}

fn enlargement(image: &Image<u8>) -> f64 {
    (ENLARGED_PX / image.width().max(image.height()) as f64).round().clamp(1.0, 4.0)
}

/// The same as OpenCV's sample `calibration` finds them: by the classic detector, refined within 11 px whatever the squares' size.
pub fn sample_corners(image: &Image<u8>, inner: [u32; 2]) -> Result<Option<Vec<Point2<f64>>>, Problem> {
    classic(&matrix(image)?, Size::new(inner[0] as i32, inner[1] as i32), |_| 11)
}

fn classic(
    picture: &Mat,
    pattern: Size,
    window: impl Fn(&Vector<Point2f>) -> i32,
) -> Result<Option<Vec<Point2<f64>>>, Problem> {
    let flags = calib3d::CALIB_CB_ADAPTIVE_THRESH | calib3d::CALIB_CB_NORMALIZE_IMAGE;
    let mut corners = Vector::<Point2f>::new();
    if !calib3d::find_chessboard_corners(picture, pattern, &mut corners, flags)? {
        return Ok(None);
    }
    let window = window(&corners);
    let none = Size::new(-1, -1);
    imgproc::corner_sub_pix(picture, &mut corners, Size::new(window, window), none, stop()?)?;
    Ok(Some(points(&corners, 1.0)))
}

/// Length of the longer side to which small pictures are enlarged, px.
const ENLARGED_PX: f64 = 1920.0;

fn enlarge(picture: &Mat, enlargement: f64) -> Result<Mat, Problem> {
    let mut out = Mat::default();
    if enlargement > 1.0 {
        let size = Size::default();
        imgproc::resize(picture, &mut out, size, enlargement, enlargement, imgproc::INTER_CUBIC)?;
    } else {
        out = picture.clone();
    }
    Ok(out)
}

/// Half a window that holds no second corner.
fn refinement_window(corners: &Vector<Point2f>) -> i32 {
    let points = corners.to_vec();
    let spacing =
        points.windows(2).map(|p| (p[1].x - p[0].x).hypot(p[1].y - p[0].y)).fold(f32::MAX, f32::min);
    ((spacing / 2.5) as i32).clamp(1, 11)
}

fn points(corners: &Vector<Point2f>, enlargement: f64) -> Vec<Point2<f64>> {
    let ours = |v: f32| (f64::from(v) + HALF) / enlargement;
    corners.iter().map(|p| Point2::new(ours(p.x), ours(p.y))).collect()
}

fn matrix(image: &Image<u8>) -> Result<Mat, Problem> {
    let view = Mat::new_rows_cols_with_data(image.height() as i32, image.width() as i32, image.pixels())?;
    Ok(view.try_clone()?)
}

fn stop() -> Result<TermCriteria, Problem> {
    let count_and_step = opencv::core::TermCriteria_COUNT | opencv::core::TermCriteria_EPS;
    Ok(TermCriteria::new(count_and_step, 200, 1e-12)?)
}

/// Corners of a flat board seen in one photograph.
#[derive(Debug, Clone)]
pub struct BoardView {
    /// In the board's plane, m.
    pub board: Vec<Point2<f64>>,
    /// In the photograph, px.
    pub pixels: Vec<Point2<f64>>,
}

/// OpenCV's own fit of a lens to views of a board, which insitu's is measured beside, and the rms of its residuals, px. `focal_px`
/// starts it; `square`: pixels are known to be square.
pub fn calibrate_lens(
    views: &[BoardView],
    width_px: u32,
    height_px: u32,
    focal_px: f64,
    square: bool,
) -> Result<(Intrinsics, f64), Problem> {
    let board =
        views.iter().map(|v| v.board.iter().map(|p| Point3f::new(p.x as f32, p.y as f32, 0.0)).collect());
    let board: Vector<Vector<Point3f>> = board.collect();
    let theirs = |p: &Point2<f64>| Point2f::new((p.x - HALF) as f32, (p.y - HALF) as f32);
    let pixels: Vector<Vector<Point2f>> =
        views.iter().map(|v| v.pixels.iter().map(theirs).collect()).collect();
    let start = Intrinsics::pinhole(width_px, height_px, focal_px);
    let (mut matrix, mut distortion) = (camera_matrix(&start)?, distortion(&start)?);
    let (mut rotations, mut translations) = (Vector::<Mat>::new(), Vector::<Mat>::new());
    let flags = calib3d::CALIB_USE_INTRINSIC_GUESS | if square { calib3d::CALIB_FIX_ASPECT_RATIO } else { 0 };
    let size = Size::new(width_px as i32, height_px as i32);
    let rms_px = calib3d::calibrate_camera(
        &board,
        &pixels,
        size,
        &mut matrix,
        &mut distortion,
        &mut rotations,
        &mut translations,
        flags,
        TermCriteria::new(
            opencv::core::TermCriteria_COUNT | opencv::core::TermCriteria_EPS,
            30,
            f64::EPSILON,
        )?,
    )?;
    let (k, d) = (numbers(&matrix, 9)?, numbers(&distortion, 5)?);
    let intrinsics = Intrinsics {
        width_px,
        height_px,
        focal_px: [k[0], k[4]],
        principal_point_px: [k[2] + HALF, k[5] + HALF],
        distortion: [d[0], d[1], d[2], d[3], d[4]],
    };
    Ok((intrinsics, rms_px))
}

/// Corners moved to where the gradients around them ask for (Förstner and Gülch 1987), px; `window`: half its side, px.
pub fn refined_corners(
    image: &Image<u8>,
    corners: &[Point2<f64>],
    window: i32,
) -> Result<Vec<Point2<f64>>, Problem> {
    let theirs = |p: &Point2<f64>| Point2f::new((p.x - HALF) as f32, (p.y - HALF) as f32);
    let within = |p: &Point2<f64>| {
        let margin = f64::from(window) + 2.0;
        p.x > margin
            && p.y > margin
            && p.x < image.width() as f64 - margin
            && p.y < image.height() as f64 - margin
    };
    // OpenCV refuses all where one is outside.
    let inside: Vec<usize> = (0..corners.len()).filter(|k| within(&corners[*k])).collect();
    let mut moved: Vector<Point2f> = inside.iter().map(|k| theirs(&corners[*k])).collect();
    let mut refined = vec![Point2::new(f64::NAN, f64::NAN); corners.len()];
    if inside.is_empty() {
        return Ok(refined);
    }
    let none = Size::new(-1, -1);
    let picture = Mat::new_rows_cols_with_data(image.height() as i32, image.width() as i32, image.pixels())?;
    imgproc::corner_sub_pix(&picture, &mut moved, Size::new(window, window), none, stop()?)?;
    for (k, p) in inside.into_iter().zip(points(&moved, 1.0)) {
        refined[k] = p;
    }
    Ok(refined)
}

/// The poses that a flat board can have, `camera_from_board`, the better fitting first: infinitesimal plane-based pose
/// estimation (Collins and Bartoli 2014), which finds both minima of the two-fold ambiguity.
pub fn planar_poses(view: &BoardView, intrinsics: &Intrinsics) -> Result<Vec<Isometry3<f64>>, Problem> {
    let board: Vector<Point3d> = view.board.iter().map(|p| Point3d::new(p.x, p.y, 0.0)).collect();
    let pixels: Vector<Point2d> = view.pixels.iter().map(|p| Point2d::new(p.x - HALF, p.y - HALF)).collect();
    let (mut rotations, mut translations) = (Vector::<Mat>::new(), Vector::<Mat>::new());
    calib3d::solve_pnp_generic(
        &board,
        &pixels,
        &camera_matrix(intrinsics)?,
        &distortion(intrinsics)?,
        &mut rotations,
        &mut translations,
        false,
        calib3d::SolvePnPMethod::SOLVEPNP_IPPE,
        &Mat::default(),
        &Mat::default(),
        &mut Mat::default(),
    )?;
    let mut poses = Vec::new();
    for (r, t) in rotations.iter().zip(&translations) {
        let (r, t) = (Vector3::from_vec(numbers(&r, 3)?), Vector3::from_vec(numbers(&t, 3)?));
        if r.iter().chain(t.iter()).all(|v| v.is_finite()) {
            poses.push(Isometry3::from_parts(Translation3::from(t), UnitQuaternion::from_scaled_axis(r)));
        }
    }
    Ok(poses)
}

/// Pose of a camera that sees points, four or more, at pixels: camera from the points' frame (Terzakis and Lourakis, *A Consistently
/// Fast and Globally Optimal Solution to the Perspective-n-Point Problem*, 2020).
pub fn pose_of_points(
    points: &[Point3<f64>],
    pixels: &[Point2<f64>],
    intrinsics: &Intrinsics,
) -> Result<Option<Isometry3<f64>>, Problem> {
    if points.len() < 4 || points.len() != pixels.len() {
        return Ok(None);
    }
    let points: Vector<Point3d> = points.iter().map(|p| Point3d::new(p.x, p.y, p.z)).collect();
    let pixels: Vector<Point2d> = pixels.iter().map(|p| Point2d::new(p.x - HALF, p.y - HALF)).collect();
    let (mut r, mut t) = (Mat::default(), Mat::default());
    let found = calib3d::solve_pnp(
        &points,
        &pixels,
        &camera_matrix(intrinsics)?,
        &distortion(intrinsics)?,
        &mut r,
        &mut t,
        false,
        calib3d::SOLVEPNP_SQPNP,
    )?;
    let (r, t) = (Vector3::from_vec(numbers(&r, 3)?), Vector3::from_vec(numbers(&t, 3)?));
    let sound = found && r.iter().chain(t.iter()).all(|v| v.is_finite());
    Ok(sound.then(|| Isometry3::from_parts(Translation3::from(t), UnitQuaternion::from_scaled_axis(r))))
}

fn camera_matrix(i: &Intrinsics) -> Result<Mat, Problem> {
    let [cx, cy] = i.principal_point_px.map(|c| c - HALF);
    Ok(Mat::from_slice_2d(&[[i.focal_px[0], 0.0, cx], [0.0, i.focal_px[1], cy], [0.0, 0.0, 1.0]])?)
}

fn distortion(i: &Intrinsics) -> Result<Mat, Problem> {
    Ok(Mat::from_slice_2d(&[i.distortion])?)
}

/// The first `n` numbers of a matrix of doubles.
fn numbers(m: &Mat, n: usize) -> Result<Vec<f64>, Problem> {
    let data = m.data_typed::<f64>()?;
    data.get(..n)
        .map(<[f64]>::to_vec)
        .ok_or_else(|| Problem::OpenCv(format!("{} numbers instead of {n}", data.len())))
}

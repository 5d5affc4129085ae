//! The whole calibration: which evidence there is decides what lens and pose come from.

use super::vanishing::{self, Edge, EdgeFit, Inner, Placing, RoomEdges, StatedFocal};
use super::{PosedCamera, Problem, board, edges_of, lens, lines, manhattan, pose, pose_from_lines};
use crate::annotations::VanishingLines;
use crate::camera::{Intrinsics, LensCovariance, focal_alone};
use crate::config::{self, PoseSource};
use crate::image::Image;
use crate::vision::{self, BoardView};
use nalgebra::Point2;
use rayon::prelude::*;

/// All evidence.
pub struct Evidence<'a> {
    /// Width of all photographs, px.
    pub width_px: u32,
    /// Height of all photographs, px.
    pub height_px: u32,
    /// Photographs of the grid for the lens, with their names.
    pub grids: &'a [(String, Image<u8>)],
    /// Photographs of the grid from the plate's place.
    pub plate_grids: &'a [(String, Image<u8>)],
    /// Focal length that EXIF or settings state, px.
    pub stated_focal_px: Option<f64>,
    /// Edges marked in a photograph from the plate's place, and what places the camera.
    pub lines: Option<&'a VanishingLines>,
    /// The plate, in which edges are searched where none are marked and nothing else gives lens or pose.
    pub plate: Option<&'a Image<u8>>,
}

/// Lens and pose of the plate, and how good they are.
#[derive(Debug, Clone)]
pub struct Solution {
    /// The plate's pose, with the lens.
    pub plate: PosedCamera,
    /// Where the focal length comes from: `grid`, `vanishing_lines`, `vanishing_lines and exif`, `exif`.
    pub focal_source: &'static str,
    /// Standard deviation of the focal length, px, where known.
    pub focal_sigma_px: Option<f64>,
    /// The lens from grid photographs.
    pub lens: Option<lens::Lens>,
    /// Focal length and orientation from the lines alone.
    pub edges: Option<EdgeFit>,
    /// Distance of the lines' ends from the whole fit, rms in px.
    pub edge_rms_px: Option<f64>,
    /// What was done in spite of a defect.
    pub warnings: Vec<String>,
    /// What the pose was found from.
    pub(super) used: Used,
}

/// Evidence of the plate's pose.
#[derive(Debug, Clone, Default)]
pub(super) struct Used {
    /// Boards seen from the plate's place; none where the pose comes from lines.
    pub boards: Vec<BoardView>,
    /// Turn of the room's x direction against the grid's, rad, where marked lines and boards were fitted together.
    pub room_yaw: Option<f64>,
    /// Why the lines alone would be refused.
    pub open: Option<Problem>,
}

/// Distortion of fewer standard deviations is taken as none.
const SIGNIFICANT: f64 = 3.0;
/// Lines that miss their vanishing points by more than this many standard deviations of a mark (rms) are refused.
const MAX_EDGE_SIGMA: f64 = 6.0;

/// Finds the lens, then the plate's pose.
pub fn solve(evidence: &Evidence, settings: &config::Calibrate) -> Result<Solution, Problem> {
    start(evidence, settings, false)
}

/// The same; where marked lines leave the focal length `open`, what they say of it all the same.
pub(super) fn start(
    evidence: &Evidence,
    settings: &config::Calibrate,
    open: bool,
) -> Result<Solution, Problem> {
    board::check(settings)?;
    let mut warnings = Vec::new();
    let lens = fit_lens(evidence, settings, &mut warnings);
    let (width, height) = (evidence.width_px, evidence.height_px);
    let guess = evidence.stated_focal_px.unwrap_or(f64::from(width.max(height)));
    let mut intrinsics = match &lens {
        Ok(lens) => lens.fit.intrinsics.clone(),
        Err(_) => Intrinsics::pinhole(width, height, guess),
    };

    let diagonal = f64::from(width).hypot(f64::from(height));
    let centre = Point2::from(intrinsics.principal_point_px);
    let stated = stated_focal(evidence, settings);
    let marked = evidence.lines.filter(|lines| lines.has_edges()).map(|lines| edges_of(lines, &intrinsics));
    let wanted = lens.is_err() || settings.pose == PoseSource::VanishingLines;
    let searched = evidence.plate.filter(|_| marked.is_none() && wanted);
    let found = searched.map(|plate| {
        let known = lens
            .as_ref()
            .ok()
            .map(|_| StatedFocal { focal_px: intrinsics.focal_px[0], relative_sigma: SURE });
        search(plate, &intrinsics, diagonal, known.or(stated))
    });
    let asked = Inner { principal_point: settings.solve_principal_point, distortion: settings.plumb_lines };
    let mut insignificant = None;
    let mut used = Used::default();
    let edge_fit = marked.as_ref().map(|edges| {
        let stated = stated.filter(|_| lens.is_err());
        let sigma_px = settings.mark_sigma_px;
        // A lens from the grid needs no more.
        let inner = if lens.is_ok() { Inner::default() } else { asked };
        let mut fit = vanishing::fit_open(edges, centre, diagonal, sigma_px, stated, inner)?;
        if inner.distortion && fit.k1.abs() < SIGNIFICANT * fit.k1_sigma() {
            insignificant = Some(format!(
                "the lines show no distortion that is significant: k1 = {:.3} ± {:.3} is taken as 0",
                fit.k1,
                fit.k1_sigma()
            ));
            let inner = Inner { distortion: false, ..inner };
            fit = vanishing::fit_open(edges, centre, diagonal, sigma_px, stated, inner)?;
        }
        if let Err(problem) = fit.clone().certain() {
            if !open || lens.is_ok() {
                return Err(problem);
            }
            used.open = Some(problem);
        }
        let limit_px = MAX_EDGE_SIGMA * settings.mark_sigma_px;
        if fit.rms_px > limit_px {
            return Err(Problem::EdgesDisagree { rms_px: fit.rms_px, limit_px });
        }
        Ok(fit)
    });
    warnings.extend(insignificant);
    if let Some(Ok(found)) = &found {
        warnings.push(found.told());
    }
    let edge_fit = edge_fit.or(found.map(|found| found.and_then(|f| f.fit.certain())));

    let (focal_source, focal_sigma_px, lens) = match (lens, &edge_fit) {
        (Ok(lens), _) => ("grid", Some(lens.focal_sigma_px()), Some(lens)),
        (Err(problem), Some(Ok(fit))) => {
            warnings.push(format!("focal length from the vanishing lines, not from the grid: {problem}"));
            intrinsics.focal_px = [fit.room.focal_px; 2];
            intrinsics.principal_point_px = [fit.centre.x, fit.centre.y];
            intrinsics.distortion = [fit.k1, 0.0, 0.0, 0.0, 0.0];
            let source = match stated {
                Some(stated) => {
                    warnings.extend(disagreement(&stated, marked.as_ref(), settings, &intrinsics));
                    "vanishing_lines and exif"
                }
                None => "vanishing_lines",
            };
            (source, Some(fit.focal_sigma_px()), None)
        }
        (Err(problem), lines) if evidence.stated_focal_px.is_some() => {
            warnings.push(format!("focal length as stated by EXIF or settings, unchecked: {problem}"));
            if let Some(Err(problem)) = lines {
                warnings.push(format!("nor do the vanishing lines give it: {problem}"));
            }
            ("exif", None, None)
        }
        (Err(_), Some(Err(_))) => {
            return Err(edge_fit.and_then(Result::err).unwrap_or(Problem::NoFocal));
        }
        (Err(Problem::FewGrids { found: 0 }), None) => return Err(Problem::NoFocal),
        (Err(problem), None) => return Err(problem),
    };
    if let Some(Err(problem)) = &edge_fit {
        warnings.push(format!("the vanishing lines give no focal length: {problem}"));
    }
    let (edge_fit, lines_problem) = match edge_fit {
        Some(Ok(fit)) => (Some(fit), None),
        Some(Err(problem)) => (None, Some(problem)),
        None => (None, None),
    };
    let fit_of_marks = edge_fit.as_ref().filter(|_| marked.is_some());
    if let Some(fit) = fit_of_marks.filter(|f| f.worst.2 > 2.0 * vanishing::ROBUST) {
        let axis = ["x", "y", "z"][fit.worst.0];
        warnings.push(format!(
            "line {} along {axis} misses its vanishing point by {:.1} σ",
            fit.worst.1 + 1,
            fit.worst.2
        ));
    }

    let (plate, edge_rms_px) = match settings.pose {
        PoseSource::VanishingLines => {
            if let Some(problem) = lines_problem {
                return Err(problem);
            }
            (lines_alone(evidence, &intrinsics, edge_fit.as_ref(), settings)?, None)
        }
        source => {
            let boards = plate_boards(evidence, settings, &mut warnings);
            match boards {
                Err(_) if source == PoseSource::Both && is_placed(evidence, settings) => {
                    (lines_alone(evidence, &intrinsics, edge_fit.as_ref(), settings)?, None)
                }
                boards => {
                    let edges = marked.as_ref().filter(|_| source == PoseSource::Both);
                    let alone = focal_sigma_px.or(stated.map(|s| s.relative_sigma * s.focal_px));
                    let of_lens = match &lens {
                        Some(lens) => lens.fit.covariance,
                        None => focal_alone(alone.unwrap_or(0.0)),
                    };
                    used.boards = boards?;
                    let found =
                        from_grid(&used.boards, &intrinsics, &of_lens, lens.as_ref(), edges, settings)?;
                    used.room_yaw = found.room_yaw;
                    (found.posed, found.edge_rms_px)
                }
            }
        }
    };
    if let Some(rival) = plate.rival_rms_px.filter(|_| plate.is_ambiguous()) {
        warnings.push(format!(
            "the grid is too small to tell its two possible tilts apart ({:.3} and {rival:.3} px); mark vanishing lines",
            plate.rms_px
        ));
    }
    if let Some(rms) = edge_rms_px.filter(|rms| *rms > 3.0 * settings.mark_sigma_px) {
        warnings.push(format!("grid and vanishing lines disagree: the lines are {rms:.1} px off (rms)"));
    }
    Ok(Solution { plate, focal_source, focal_sigma_px, lens, edges: edge_fit, edge_rms_px, warnings, used })
}

/// Whether anything but a grid can say where the camera is.
fn is_placed(evidence: &Evidence, settings: &config::Calibrate) -> bool {
    evidence.lines.is_some_and(|lines| lines.origin.is_some()) || settings.camera_height_m > 0.0
}

/// A focal length that is not to be moved: its relative standard deviation.
const SURE: f64 = 1e-6;

/// Searches the plate for edges along the room's directions.
fn search(
    plate: &Image<u8>,
    intrinsics: &Intrinsics,
    diagonal_px: f64,
    stated: Option<StatedFocal>,
) -> Result<manhattan::Found, Problem> {
    let segments = vision::line_segments(plate)?;
    let ideal: Vec<Edge> =
        segments.iter().map(|s| s.map(|p| lines::undistorted(intrinsics, [p.x, p.y]))).collect();
    manhattan::find(&ideal, Point2::from(intrinsics.principal_point_px), diagonal_px, stated)
}

/// The focal length of EXIF or settings with its accuracy.
pub(super) fn stated_focal(evidence: &Evidence, settings: &config::Calibrate) -> Option<StatedFocal> {
    let relative_sigma = settings.stated_focal_sigma;
    let focal_px = evidence.stated_focal_px.filter(|_| relative_sigma.is_finite() && relative_sigma > 0.0)?;
    Some(StatedFocal { focal_px, relative_sigma })
}

/// Whether the lines alone ask for another focal length than the stated one.
fn disagreement(
    stated: &StatedFocal,
    edges: Option<&RoomEdges>,
    settings: &config::Calibrate,
    intrinsics: &Intrinsics,
) -> Option<String> {
    let centre = Point2::from(intrinsics.principal_point_px);
    let diagonal = f64::from(intrinsics.width_px).hypot(f64::from(intrinsics.height_px));
    let alone = vanishing::focal_from_edges(edges?, centre, diagonal, settings.mark_sigma_px).ok()?;
    let (sigma, stated_sigma) = (alone.focal_sigma_px(), stated.relative_sigma * stated.focal_px);
    let off = (alone.room.focal_px - stated.focal_px).abs() / sigma.hypot(stated_sigma);
    (off > 2.0).then(|| {
        format!(
            "the vanishing lines alone give a focal length of {:.0} ± {sigma:.0} px, EXIF or settings state {:.0} ± \
             {stated_sigma:.0} px: they are combined by these accuracies",
            alone.room.focal_px, stated.focal_px
        )
    })
}

fn fit_lens(
    evidence: &Evidence,
    settings: &config::Calibrate,
    warnings: &mut Vec<String>,
) -> Result<lens::Lens, Problem> {
    let found: Vec<_> = evidence.grids.par_iter().map(|(_, image)| board::find(image, settings)).collect();
    let (mut views, mut names) = (Vec::new(), Vec::new());
    for ((name, _), view) in evidence.grids.iter().zip(found) {
        match view {
            Ok(view) => {
                views.push(view);
                names.push(name);
            }
            Err(problem) => warnings.push(format!("{name} is not used: {problem}")),
        }
    }
    let lens = lens::fit(&views, evidence.width_px, evidence.height_px, evidence.stated_focal_px)?;
    for k in &lens.outliers {
        warnings.push(format!("{} is not used: its corners fit much worse than the others'", names[*k]));
    }
    let (rms_px, limit_px) = (lens.fit.rms_px, settings.max_rms_px);
    if rms_px > limit_px { Err(Problem::Reprojection { rms_px, limit_px }) } else { Ok(lens) }
}

fn plate_boards(
    evidence: &Evidence,
    settings: &config::Calibrate,
    warnings: &mut Vec<String>,
) -> Result<Vec<BoardView>, Problem> {
    let mut boards = Vec::new();
    let mut failure = Problem::NoGridInPlate;
    for (name, image) in evidence.plate_grids {
        match board::find_oriented(image, settings) {
            Ok(view) => boards.push(view),
            Err(problem) => {
                warnings.push(format!("{name} does not give the pose: {problem}"));
                failure = problem;
            }
        }
    }
    if boards.is_empty() { Err(failure) } else { Ok(boards) }
}

fn from_grid(
    boards: &[BoardView],
    intrinsics: &Intrinsics,
    lens_covariance: &LensCovariance,
    lens: Option<&lens::Lens>,
    edges: Option<&RoomEdges>,
    settings: &config::Calibrate,
) -> Result<pose::ViewPose, Problem> {
    let view = pose::View {
        intrinsics,
        lens_covariance,
        boards,
        corner_sigma_px: lens.map_or(0.0, |lens| lens.fit.rms_px / 2f64.sqrt()),
        edges: edges.map(|edges| (edges, settings.mark_sigma_px)),
    };
    let found = pose::fit(&view)?;
    let (rms_px, limit_px) = (found.posed.rms_px, settings.max_rms_px);
    if rms_px > limit_px { Err(Problem::Reprojection { rms_px, limit_px }) } else { Ok(found) }
}

fn lines_alone(
    evidence: &Evidence,
    intrinsics: &Intrinsics,
    edge_fit: Option<&EdgeFit>,
    settings: &config::Calibrate,
) -> Result<PosedCamera, Problem> {
    let fit = edge_fit.ok_or(Problem::NoGridInPlate)?;
    // The orientation belongs to the focal length it was fitted with.
    let intrinsics = Intrinsics { focal_px: [fit.room.focal_px; 2], ..intrinsics.clone() };
    let placing =
        match evidence.lines.filter(|lines| lines.origin.is_some() || settings.camera_height_m == 0.0) {
            Some(lines) => lines::placing(lines, &intrinsics)?,
            None if settings.camera_height_m > 0.0 => {
                let looks_at =
                    Point2::new(f64::from(evidence.width_px) / 2.0, 0.75 * f64::from(evidence.height_px));
                Placing::Height { looks_at, height_m: settings.camera_height_m }
            }
            None => return Err(Problem::NoOriginOrScale),
        };
    pose_from_lines(&placing, fit, &intrinsics, settings.mark_sigma_px)
}

//! Vanishing points, marked and found: focal length and directions against those of photographs with known ones (York Urban
//! Line Segment Database: Denis, Elder and Estrada 2008), and the focal length of captures from the plate alone.

use crate::calibrate::manhattan;
use crate::calibrate::vanishing::{self, Edge, Inner, RoomEdges, StatedFocal};
use crate::calibrate::{Problem, grey_of};
use crate::config::Role;
use crate::driver::validate;
use crate::error::{Context as _, Error, FileContext, Result};
use crate::exposure::decode;
use crate::printer::Printer;
use crate::stage::Workspace;
use crate::vision;
use nalgebra::{Matrix3, Point2, Vector3};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Thresholds of the angle accuracy, degrees.
const THRESHOLDS: [f64; 3] = [3.0, 5.0, 10.0];
/// Accuracy of the database's labelled lines, px.
const LABEL_SIGMA_PX: f64 = 1.0;
const DOING: &str = "reading known directions";
/// How a known focal length is told: its relative standard deviation.
const KNOWN: f64 = 1e-6;

/// A photograph with known directions: an entry of `*ground_truth.json`.
#[derive(Deserialize)]
struct Entry {
    image: String,
    /// Focal length, px.
    f_px: f64,
    /// Principal point, px, the centre of the top-left pixel at (1, 1).
    pp_matlab_1based: [f64; 2],
    /// Unit directions in the camera frame, y up: those of the labelled lines each by itself …
    vp_columns: [[f64; 3]; 3],
    /// … and the nearest orthogonal ones.
    vp_orthogonal_columns: [[f64; 3]; 3],
    /// Ends of labelled lines, px, the centre of the top-left pixel at (1, 1) …
    #[serde(default)]
    lines: Option<Vec<[f64; 4]>>,
    /// … and the direction of each, 1 to 3.
    #[serde(default)]
    line_vp: Option<Vec<usize>>,
}

impl Entry {
    fn centre(&self) -> Point2<f64> {
        ours(self.pp_matlab_1based)
    }

    fn labelled(&self) -> Option<RoomEdges> {
        let mut edges = RoomEdges::default();
        for (line, direction) in self.lines.as_ref()?.iter().zip(self.line_vp.as_ref()?) {
            let edge: Edge = [ours([line[0], line[1]]), ours([line[2], line[3]])];
            edges.along.get_mut(direction.wrapping_sub(1))?.push(edge);
        }
        Some(edges)
    }
}

/// A pixel of theirs, which counts centres from 1, as ours.
fn ours([x, y]: [f64; 2]) -> Point2<f64> {
    Point2::new(x - 0.5, y - 0.5)
}

/// Errors of all photographs of a folder.
#[derive(Default)]
struct Errors {
    /// Of focal lengths from labelled lines and from found ones, %.
    labelled: Vec<f64>,
    searched: Vec<f64>,
    /// Of the found ones, in their own standard deviations.
    in_sigmas: Vec<f64>,
    /// Angles between directions found and known, degrees: those known each by itself, and as orthogonal ones.
    single: Vec<f64>,
    orthogonal: Vec<f64>,
    /// The orthogonal ones from labelled lines: what the labels allow.
    of_labels: Vec<f64>,
    /// Of segments and directions, ms.
    ms: Vec<f64>,
}

/// Prints one table for each folder that has a `*ground_truth.json`, then one of captures.
pub(super) fn print(paths: &[PathBuf], printer: &Printer) -> Result<()> {
    let mut captures = Vec::new();
    for path in paths {
        match truth_of(path)? {
            Some(truth) => folder(path, &truth, printer)?,
            None => captures.push(path.clone()),
        }
    }
    if captures.is_empty() { Ok(()) } else { of_captures(&captures, printer) }
}

fn truth_of(folder: &Path) -> Result<Option<PathBuf>> {
    if !folder.is_dir() {
        return Ok(None);
    }
    let files = std::fs::read_dir(folder).at("looking for the known directions", folder)?;
    Ok(files.flatten().map(|f| f.path()).find(|p| p.to_string_lossy().ends_with("ground_truth.json")))
}

fn folder(path: &Path, truth: &Path, printer: &Printer) -> Result<()> {
    let text = std::fs::read_to_string(truth).at(DOING, truth)?;
    let entries: Vec<Entry> = serde_json::from_str(&text)
        .map_err(|e| Error::file(DOING, truth, e.to_string(), "docs/cameras.md says what the file holds"))?;
    printer.data(&format!(
        "\n{}: focal length from labelled lines; directions found with the focal length known; both found; segments and grouping",
        validate::name(path)
    ));
    printer.data(&format!(
        "{:<16}{:>26}{:>26}{:>26}{:>10}",
        "photograph", "labelled", "angles to known, degrees", "found", "ms"
    ));
    let mut all = Errors::default();
    for entry in entries.iter().filter(|e| path.join(&e.image).exists()) {
        one(path, entry, &mut all, printer)?;
    }
    let share = |angles: &[f64], limit: f64| {
        let recall: f64 = angles.iter().map(|e| (1.0 - e / limit).max(0.0)).sum();
        100.0 * recall / angles.len().max(1) as f64
    };
    for (name, angles) in [
        ("orthogonal", &all.orthogonal),
        ("each by itself", &all.single),
        ("labels against orthogonal", &all.of_labels),
    ] {
        let cells: String = THRESHOLDS.iter().map(|t| format!("{:>8.1}", share(angles, *t))).collect();
        let within: String = THRESHOLDS
            .iter()
            .map(|t| {
                let n = angles.iter().filter(|e| *e <= t).count();
                format!("{:>8.1}", 100.0 * n as f64 / angles.len().max(1) as f64)
            })
            .collect();
        printer.data(&format!("{name:<28} angle accuracy @3/5/10 degrees{cells}   within them, %{within}"));
    }
    printer.data(&format!(
        "median error of the focal length: labelled {:.2} %, found {:.2} % (χ² {}); median time {:.0} ms",
        median(&all.labelled),
        median(&all.searched),
        chi_squared(&all.in_sigmas),
        median(&all.ms)
    ));
    Ok(())
}

/// The middle one, of an even count the mean of the middle two: of so few photographs these can be far apart.
fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    if n == 0 { f64::NAN } else { (sorted[(n - 1) / 2] + sorted[n / 2]) / 2.0 }
}

/// Sum of squares of errors in standard deviations, and how many: about as many where the deviations are right.
fn chi_squared(in_sigmas: &[f64]) -> String {
    format!("{:.1} of {}", in_sigmas.iter().map(|e| e * e).sum::<f64>(), in_sigmas.len())
}

fn one(folder: &Path, entry: &Entry, all: &mut Errors, printer: &Printer) -> Result<()> {
    let file = folder.join(&entry.image);
    let picture = grey_of(&decode(&file)?);
    let diagonal = (picture.width() as f64).hypot(picture.height() as f64);
    let centre = entry.centre();
    let known = StatedFocal { focal_px: entry.f_px, relative_sigma: KNOWN };

    let started = Instant::now();
    let segments = vision::line_segments(&picture).doing("finding line segments")?;
    let found = manhattan::find(&segments, centre, diagonal, Some(known));
    let ms = 1e3 * started.elapsed().as_secs_f64();
    all.ms.push(ms);
    let angles = match &found {
        Ok(found) => {
            let turn = found.fit.room.camera_from_room.matrix();
            all.single.extend(angles_to(turn, &entry.vp_columns));
            let orthogonal = angles_to(turn, &entry.vp_orthogonal_columns);
            all.orthogonal.extend(orthogonal);
            format!("{:.2} {:.2} {:.2}", orthogonal[0], orthogonal[1], orthogonal[2])
        }
        Err(problem) => {
            all.single.extend([90.0; 3]);
            all.orthogonal.extend([90.0; 3]);
            problem.to_string()
        }
    };
    let error = |focal_px: f64| 100.0 * (focal_px / entry.f_px - 1.0);
    let labelled = match entry.labelled() {
        None => "-".into(),
        Some(edges) => {
            if let Ok(fit) =
                vanishing::fit_edges(&edges, centre, diagonal, LABEL_SIGMA_PX, Some(known), Inner::default())
            {
                all.of_labels
                    .extend(angles_to(fit.room.camera_from_room.matrix(), &entry.vp_orthogonal_columns));
            }
            match vanishing::focal_from_edges(&edges, centre, diagonal, LABEL_SIGMA_PX) {
                Ok(fit) => {
                    all.labelled.push(error(fit.room.focal_px).abs());
                    focal(error(fit.room.focal_px), &fit)
                }
                Err(problem) => refused(&problem),
            }
        }
    };
    let alone = manhattan::find(&segments, centre, diagonal, None).and_then(|f| f.fit.certain());
    let searched = match alone {
        Ok(fit) => {
            all.searched.push(error(fit.room.focal_px).abs());
            all.in_sigmas.push((fit.room.focal_px - entry.f_px) / fit.focal_sigma_px());
            focal(error(fit.room.focal_px), &fit)
        }
        Err(problem) => refused(&problem),
    };
    printer.data(&format!("{:<16}{labelled:>26}{angles:>26}{searched:>26}{ms:>10.0}", entry.image));
    Ok(())
}

fn refused(problem: &Problem) -> String {
    match problem {
        Problem::FocalOpen { condition, .. } => format!("refused (condition {condition:.1})"),
        other => format!("refused: {other}"),
    }
}

fn focal(error: f64, fit: &vanishing::EdgeFit) -> String {
    format!("{error:+.2} ± {:.2} %", 100.0 * fit.focal_sigma_px() / fit.room.focal_px)
}

/// Angles between the room's directions and the known ones in the pairing that fits best, degrees.
fn angles_to(camera_from_room: &Matrix3<f64>, known: &[[f64; 3]; 3]) -> [f64; 3] {
    const PAIRINGS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    // Their y points up.
    let known = known.map(|d| Vector3::new(d[0], -d[1], d[2]).normalize());
    let angle = |a: usize, b: usize| {
        let cosine = camera_from_room.column(a).dot(&known[b]).abs();
        cosine.min(1.0).acos().to_degrees()
    };
    let paired = PAIRINGS.map(|p| std::array::from_fn(|k| angle(p[k], k)));
    let sum = |angles: &[f64; 3]| angles.iter().sum::<f64>();
    paired.into_iter().min_by(|a, b| sum(a).total_cmp(&sum(b))).unwrap_or_default()
}

/// The focal length of captures' plates, with neither marks nor EXIF, against their truth.
fn of_captures(paths: &[PathBuf], printer: &Printer) -> Result<()> {
    printer.data(&format!("\n{:<28}{:>16}{:>26}", "plate alone", "true, px", "found"));
    let mut in_sigmas = Vec::new();
    for settings in validate::settings_under(paths)? {
        let workspace = Workspace::open(&settings)?;
        let own = settings.file_name().is_some_and(|n| n == "pipeline.toml");
        let Some(truth) = workspace.pipeline.evaluate.truth.as_ref().filter(|_| own) else { continue };
        let path = workspace.base.join(truth);
        let text = std::fs::read_to_string(&path).at(DOING, &path)?;
        let truth: serde_json::Value = serde_json::from_str(&text).map_err(|e| {
            Error::file(DOING, &path, e.to_string(), "give the truth.json of a rendered capture")
        })?;
        let Some(focal_px) = truth["intrinsics"]["fx"].as_f64() else { continue };
        let photos = workspace.base.join(&workspace.pipeline.ingest.photos);
        for name in workspace.pipeline.ingest.roles.get(&Role::Plate).into_iter().flatten() {
            let picture = grey_of(&decode(&photos.join(name))?);
            let size = [picture.width() as f64, picture.height() as f64];
            let segments = vision::line_segments(&picture).doing("finding line segments")?;
            let centre = Point2::new(size[0] / 2.0, size[1] / 2.0);
            let found = manhattan::find(&segments, centre, size[0].hypot(size[1]), None);
            let cell = match found.and_then(|f| f.fit.certain()) {
                Ok(fit) => {
                    in_sigmas.push((fit.room.focal_px - focal_px) / fit.focal_sigma_px());
                    focal(100.0 * (fit.room.focal_px / focal_px - 1.0), &fit)
                }
                Err(problem) => refused(&problem),
            };
            let name = format!("{} {name}", validate::name(&settings));
            printer.data(&format!("{name:<28}{focal_px:>16.1}{cell:>26}"));
        }
    }
    printer.data(&format!("χ² {}", chi_squared(&in_sigmas)));
    Ok(())
}

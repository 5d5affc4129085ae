//! Lenses and poses from printed grids: photographs of a chessboard against the lens that OpenCV's sample found, markers against
//! listed corners, captures against their truth; time beside OpenCV's `calibrateCamera` on the same corners.

use super::{percentile, spread};
use crate::calibrate::bundle::{self, FreeLens};
use crate::calibrate::{Evidence, board, grey_of, lens, solve};
use crate::camera::{Camera, Intrinsics};
use crate::config::{self, PoseSource, Role};
use crate::driver::validate;
use crate::error::{Context as _, Error, FileContext, Result};
use crate::evaluate::references::truth_at;
use crate::exposure::{self, decode};
use crate::image::Image;
use crate::printer::Printer;
use crate::stage::Workspace;
use crate::vision::{self, BoardView};
use nalgebra::Point2;
use std::path::{Path, PathBuf};
use std::time::Instant;

const DOING: &str = "reading a known lens";
/// Runs in turn of which the median time counts.
const RUNS: usize = 9;
/// A photograph of OpenCV's documentation with markers of the dictionary 6x6_250, and where they are by OpenCV, px, the top-left
/// pixel's centre at 0.
const MARKED: &str = "singlemarkersoriginal.jpg";
const LISTED: [(u32, [[f64; 2]; 4]); 6] = [
    (23, [[298.0, 185.0], [334.0, 186.0], [335.0, 212.0], [297.0, 211.0]]),
    (40, [[359.0, 310.0], [404.0, 310.0], [410.0, 350.0], [362.0, 350.0]]),
    (62, [[233.0, 273.0], [190.0, 273.0], [196.0, 241.0], [237.0, 241.0]]),
    (98, [[427.0, 255.0], [469.0, 256.0], [477.0, 289.0], [434.0, 288.0]]),
    (124, [[425.0, 163.0], [430.0, 186.0], [394.0, 186.0], [390.0, 162.0]]),
    (203, [[195.0, 155.0], [230.0, 155.0], [227.0, 178.0], [190.0, 178.0]]),
];

/// A lens that OpenCV's sample `calibration` found, and the grid.
struct Known {
    intrinsics: Intrinsics,
    rms_px: f64,
    grid: config::Calibrate,
}

/// Prints a table for each folder that has an `NAME_intrinsics.yml` beside photographs `NAME*.jpg`, then one of captures.
pub(super) fn print(paths: &[PathBuf], printer: &Printer) -> Result<()> {
    let mut captures = Vec::new();
    for path in paths {
        match known_in(path)? {
            Some(file) => folder(path, &file, printer)?,
            None => captures.push(path.clone()),
        }
    }
    if captures.is_empty() { Ok(()) } else { of_captures(&captures, printer) }
}

fn known_in(folder: &Path) -> Result<Option<PathBuf>> {
    if !folder.is_dir() {
        return Ok(None);
    }
    let files = std::fs::read_dir(folder).at("looking for a known lens", folder)?;
    Ok(files.flatten().map(|f| f.path()).find(|p| p.to_string_lossy().ends_with("_intrinsics.yml")))
}

impl Known {
    fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).at(DOING, path)?;
        let bad = |what: &str| {
            Error::file(
                DOING,
                path,
                format!("lacks {what}"),
                "give what OpenCV's sample `calibration` writes",
            )
        };
        let after = |key: &str| {
            let start = text.find(&format!("{key}:")).ok_or_else(|| bad(key))? + key.len() + 1;
            Ok::<_, Error>(&text[start..])
        };
        let number = |key: &str| {
            let word = after(key)?.split_whitespace().next().unwrap_or_default();
            word.parse::<f64>().map_err(|_| bad(key))
        };
        let list = |key: &str, count: usize| {
            let rest = after(key)?;
            let inside = rest.split_once("data: [").and_then(|(_, r)| r.split_once(']')).map(|(d, _)| d);
            let all: Option<Vec<f64>> =
                inside.map(|d| d.split(',').filter_map(|v| v.trim().parse().ok()).collect());
            all.filter(|a| a.len() == count).ok_or_else(|| bad(key))
        };
        let (k, d) = (list("camera_matrix", 9)?, list("distortion_coefficients", 5)?);
        let size = [number("image_width")?, number("image_height")?].map(|s| s as u32);
        Ok(Self {
            intrinsics: Intrinsics {
                width_px: size[0],
                height_px: size[1],
                focal_px: [k[0], k[4]],
                // OpenCV counts pixels from the centre of the first one.
                principal_point_px: [k[2] + 0.5, k[5] + 0.5],
                distortion: [d[0], d[1], d[2], d[3], d[4]],
            },
            rms_px: number("avg_reprojection_error")?,
            grid: config::Calibrate {
                inner_corners: [number("board_width")? as u32, number("board_height")? as u32],
                square_m: number("square_size")?,
                disc: config::Disc::None,
                ..Default::default()
            },
        })
    }
}

fn folder(path: &Path, file: &Path, printer: &Printer) -> Result<()> {
    let known = Known::read(file)?;
    let name = file.file_name().unwrap_or_default().to_string_lossy().replace("_intrinsics.yml", "");
    let (mut views, mut of_sample, mut hidden) = (Vec::new(), Vec::new(), Hidden::default());
    for photo in exposure::list(path)?.iter().filter(|p| p.starts_with(&name) && p.ends_with(".jpg")) {
        let image = grey_of(&decode(&path.join(photo))?);
        match board::find(&image, &known.grid) {
            Ok(view) => {
                hidden.add(&image, &view, &known.grid);
                let pixels = vision::sample_corners(&image, known.grid.inner_corners).doing(DOING)?;
                let board = board::corner_positions(&known.grid);
                of_sample.extend(pixels.map(|pixels| BoardView { pixels, board }));
                views.push(view);
            }
            Err(problem) => printer.data(&format!("{photo}: {problem}")),
        }
    }
    printer.data(&format!(
        "\n{}, {name}: {} views; published: rms {:.3} px\n{:<26}{:>20}{:>20}{:>38}{:>8}{:>12}{:>26}",
        validate::name(path),
        views.len(),
        known.rms_px,
        "",
        "focal length, px",
        "principal point",
        "distortion",
        "rms, px",
        "largest, %",
        "ms"
    ));
    lens_row("published", &known.intrinsics, known.rms_px, &known, &[], printer);
    let [width, height] = [known.intrinsics.width_px, known.intrinsics.height_px];
    let start = bundle::first_focal_px(&views, width, height).unwrap_or(f64::from(width));
    let pinhole = Intrinsics::pinhole(width, height, start);
    let square = FreeLens { aspect: false, ..FreeLens::ALL };
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    for _ in 0..RUNS {
        let started = Instant::now();
        bundle::fit(&views, &pinhole, square).doing("fitting a lens")?;
        ours.push(1e3 * started.elapsed().as_secs_f64());
        let started = Instant::now();
        vision::calibrate_lens(&views, width, height, start, true).doing("fitting a lens by OpenCV")?;
        theirs.push(1e3 * started.elapsed().as_secs_f64());
    }
    let fit = bundle::fit(&views, &pinhole, square).doing("fitting a lens")?;
    lens_row("insitu, square pixels", &fit.intrinsics, fit.rms_px, &known, &ours, printer);
    let (by_opencv, rms) =
        vision::calibrate_lens(&views, width, height, start, true).doing("fitting a lens by OpenCV")?;
    lens_row("OpenCV, the same corners", &by_opencv, rms, &known, &theirs, printer);
    let start = Intrinsics::pinhole(width, height, start);
    let sample = bundle::fit(&of_sample, &start, square).doing("fitting a lens")?;
    lens_row("insitu, sample's corners", &sample.intrinsics, sample.rms_px, &known, &[], printer);
    let stage = lens::fit(&views, width, height, None).doing("fitting a lens")?;
    lens_row("insitu, as the stage does", &stage.fit.intrinsics, stage.fit.rms_px, &known, &[], printer);
    printer.data(&format!(
        "standard deviations by our corners: focal length {:.2} px, principal point {:.2} {:.2} px; condition number {:.1}; the stage leaves out {} views{}",
        fit.sigma(0), fit.sigma(2), fit.sigma(3), fit.condition, stage.outliers.len(),
        if stage.dropped.is_empty() { String::new() } else { format!(" and {}", stage.dropped.join(", ")) }
    ));
    hidden.print(printer);
    if path.join(MARKED).exists() { markers(&path.join(MARKED), printer) } else { Ok(()) }
}

/// What is found of grids in photographs in which a grey disc hides a part of them, against the grid found whole.
#[derive(Default)]
struct Hidden {
    pictures: usize,
    found: usize,
    /// Another grid is.
    elsewhere: usize,
    /// Corners farther than a square from the disc, and how many of those are found.
    seen: usize,
    of_seen: usize,
    /// Distances of all corners found, px.
    off_px: Vec<f64>,
}

impl Hidden {
    /// Hides every so many corners one, with what is within so many squares of it.
    const EVERY: usize = 13;
    const SQUARES: f64 = 1.5;

    fn add(&mut self, image: &Image<u8>, whole: &BoardView, grid: &config::Calibrate) {
        let side = (whole.pixels[1] - whole.pixels[0]).norm();
        for middle in whole.pixels.iter().step_by(Self::EVERY) {
            let reach = Self::SQUARES * side;
            let covered = Image::from_fn(image.width(), image.height(), |x, y| {
                let here = Point2::new(x as f64 + 0.5, y as f64 + 0.5);
                if (here - middle).norm() < reach { 128 } else { *image.at(x, y) }
            });
            self.pictures += 1;
            let Ok(view) = board::find(&covered, grid) else { continue };
            // Either way round.
            let [as_is, turned] = [1.0, -1.0].map(|sign| {
                let at = |b: &Point2<f64>| whole.board.iter().position(|w| (w - b * sign).norm() < 1e-9);
                let pairs = view.board.iter().zip(&view.pixels);
                pairs.filter_map(|(b, p)| Some((p - whole.pixels[at(b)?]).norm())).collect::<Vec<f64>>()
            });
            let sum = |off: &[f64]| off.iter().sum::<f64>();
            let off = if sum(&as_is) < sum(&turned) { as_is } else { turned };
            // The same grid may be seen elsewhere, on a screen.
            if off.iter().all(|off| *off > side) {
                self.elsewhere += 1;
                continue;
            }
            self.found += 1;
            self.off_px.extend(off);
            let far = whole.pixels.iter().filter(|p| (*p - middle).norm() > reach + side);
            let near = |p: &Point2<f64>| view.pixels.iter().any(|q| (p - q).norm() < 0.25 * side);
            let far: Vec<bool> = far.map(near).collect();
            self.seen += far.len();
            self.of_seen += far.iter().filter(|found| **found).count();
        }
    }

    fn print(mut self, printer: &Printer) {
        if self.off_px.is_empty() {
            return;
        }
        self.off_px.sort_by(f64::total_cmp);
        let share = |of| percentile(&self.off_px, of);
        printer.data(&format!(
            "a disc of {} squares' radius over the grid: {} of {} found, another one in {}; {} of {} corners that are a square away from it; off by {:.3} px \
             in the middle, {:.2} px at 95 %, {:.2} px at most",
            Self::SQUARES, self.found, self.pictures, self.elsewhere, self.of_seen, self.seen, share(0.5), share(0.95), share(1.0)
        ));
    }
}

/// `largest`: of the relative differences of focal length and principal point to the published ones.
fn lens_row(name: &str, lens: &Intrinsics, rms_px: f64, known: &Known, ms: &[f64], printer: &Printer) {
    let parts =
        |i: &Intrinsics| [i.focal_px[0], i.focal_px[1], i.principal_point_px[0], i.principal_point_px[1]];
    let off = parts(lens)
        .iter()
        .zip(parts(&known.intrinsics))
        .map(|(a, b)| (a / b - 1.0).abs())
        .fold(0.0, f64::max);
    let [f, g] = lens.focal_px;
    let [x, y] = lens.principal_point_px;
    let [k1, k2, p1, p2, k3] = lens.distortion;
    let time = if ms.is_empty() {
        String::new()
    } else {
        let [middle, least, most] = spread(&mut ms.to_vec());
        format!("{middle:.1} ({least:.1}–{most:.1})")
    };
    printer.data(&format!(
        "{name:<26}{:>20}{:>20}{:>38}{rms_px:>8.3}{:>12.3}{time:>26}",
        format!("{f:.2} {g:.2}"),
        format!("{x:.2} {y:.2}"),
        format!("{k1:.3} {k2:.3} {p1:.4} {p2:.4} {k3:.3}"),
        100.0 * off
    ));
}

fn markers(file: &Path, printer: &Printer) -> Result<()> {
    let found = vision::markers(&grey_of(&decode(file)?), "6x6_250", None).doing("finding markers")?;
    let mut off: Vec<f64> = Vec::new();
    for (id, corners) in LISTED {
        let Some(marker) = found.iter().find(|m| m.id == id) else {
            printer.data(&format!("marker {id} is not found"));
            continue;
        };
        // Listed corners count from the centre of the first pixel.
        let miss = |(p, [x, y]): (&Point2<f64>, [f64; 2])| (p.x - 0.5 - x).hypot(p.y - 0.5 - y);
        off.extend(marker.corners.iter().zip(corners).map(miss));
    }
    if !off.is_empty() {
        let [middle, _, most] = spread(&mut off);
        printer.data(&format!(
            "{MARKED}: {} corners, against those listed to whole pixels: median {middle:.2} px, largest {most:.2} px",
            off.len()
        ));
    }
    Ok(())
}

/// Lens and pose of captures' plates from the grid alone, against their truth.
fn of_captures(paths: &[PathBuf], printer: &Printer) -> Result<()> {
    printer.data(&format!(
        "\n{:<16}{:>20}{:>26}{:>14}{:>12}",
        "grid alone", "focal length, %", "position, % of distance", "rotation, °", "condition"
    ));
    for settings in validate::settings_under(paths)? {
        let workspace = Workspace::open(&settings)?;
        let own = settings.file_name().is_some_and(|n| n == "pipeline.toml");
        let Some(truth) = workspace.pipeline.evaluate.truth.as_ref().filter(|_| own) else { continue };
        let truth = truth_at(&workspace.base.join(truth))?;
        let plate = truth.plate_file().doing("reading the truth of a capture")?;
        let truth = truth.camera(plate).doing("reading the truth of a capture")?;
        let (camera, condition) = by_grid(&workspace, &truth)?;
        let focal = 100.0 * (camera.intrinsics.focal_px[0] / truth.intrinsics.focal_px[0] - 1.0);
        let position = 100.0 * (camera.centre() - truth.centre()).norm() / truth.centre().coords.norm();
        let turn = camera.world_from_camera.rotation.angle_to(&truth.world_from_camera.rotation).to_degrees();
        printer.data(&format!(
            "{:<16}{focal:>+20.3}{position:>26.3}{turn:>14.3}{condition:>12.1}",
            validate::name(&settings)
        ));
    }
    Ok(())
}

fn by_grid(workspace: &Workspace, truth: &Camera) -> Result<(Camera, f64)> {
    let folder = workspace.base.join(&workspace.pipeline.ingest.photos);
    let names = exposure::list(&folder)?;
    let pictures = |role: Role| -> Result<Vec<(String, Image<u8>)>> {
        let patterns = workspace.pipeline.ingest.roles.get(&role).cloned().unwrap_or_default();
        let chosen = names.iter().filter(|n| patterns.iter().any(|p| exposure::glob(p, n)));
        chosen.map(|n| Ok((n.clone(), grey_of(&decode(&folder.join(n))?)))).collect()
    };
    let (grids, plate_grids) = (pictures(Role::Grid)?, pictures(Role::PlateWithGrid)?);
    let evidence = Evidence {
        width_px: truth.intrinsics.width_px,
        height_px: truth.intrinsics.height_px,
        grids: &grids,
        plate_grids: &plate_grids,
        stated_focal_px: None,
        lines: None,
        plate: None,
    };
    let settings = config::Calibrate { pose: PoseSource::Grid, ..workspace.pipeline.calibrate.clone() };
    let found = solve(&evidence, &settings).doing("calibrating by the grid")?;
    let condition = found.lens.as_ref().map_or(f64::NAN, |l| l.fit.condition);
    Ok((found.plate.camera, condition))
}

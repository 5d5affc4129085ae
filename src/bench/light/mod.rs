//! Light from the probe against the truth of rendered captures: where lamps and windows are seen and how much light comes from
//! them, irradiance at the ball and at points of the room, reflectance of the surfaces that the plate shows.

pub(super) mod ball;
mod lamps;
pub(super) mod panorama;
mod points;
mod surfaces;
pub(super) mod volume;

use super::breakdown::{COLUMNS, true_workspace_to};
use super::truth::has_truth;
use crate::artefact::{exr, remake};
use crate::driver::run::Range;
use crate::driver::truth::TrueStage;
use crate::driver::validate;
use crate::error::{Context as _, Error, Result};
use crate::evaluate::Truth;
use crate::evaluate::references::truth_at;
use crate::illuminate::patch::LightModel;
use crate::illuminate::read_light;
use crate::irradiance::Volume;
use crate::model::Scene;
use crate::printer::Printer;
use crate::probe::Environment;
use crate::stage::Workspace;
use crate::visibility::Bvh;
use lamps::Lamp;
use std::path::{Path, PathBuf};

/// The true camera and scene given, light by ours.
const LIGHT_OURS: (&str, &[TrueStage]) =
    ("light", &[TrueStage::Merge, TrueStage::Probe, TrueStage::Illuminate]);

/// What is wanted of light by ours with the true camera and scene: degrees, and shares.
const GOALS: [f64; 4] = [1.0, 0.05, 0.08, 0.10];

/// A capture's truth, and the light that some stages of ours made.
struct Judged {
    truth: Truth,
    /// Plate units in one unit of the truth.
    scale: f64,
    scene: Scene,
    /// The true environment at the ball's centre, plate units.
    environment: Environment,
    seen: Environment,
    light: LightModel,
    light_bvh: Bvh,
    volume: Volume,
}

impl Judged {
    fn read(file: &Path, name: &str, ours: &[TrueStage]) -> Result<Self> {
        let range = Range { to: Some("irradiance".into()), ..Range::default() };
        let workspace = true_workspace_to(file, name, ours, &range)?;
        let path = workspace.pipeline.evaluate.truth.clone().unwrap_or_default();
        let path = workspace.base.join(path);
        let truth = truth_at(&path)?;
        let doing = || format!("reading the light of {}", path.display());
        let scale = truth.plate_scale(truth.plate_file().doing(doing())?).doing(doing())?;
        let map = truth.environment_file().doing(doing())?;
        let map = path.with_file_name(Path::new(map).file_name().unwrap_or_default());
        let centre = truth.probe("", 2).doing(doing())?.centre;
        let environment = truth.environment(&exr::read_radiance(&map)?, scale, centre).doing(doing())?;
        let light = read_light(&workspace.folder("illuminate"))?;
        Ok(Self {
            scale,
            scene: truth.scene().doing(doing())?,
            environment,
            seen: read_environment(&workspace)?,
            light_bvh: Bvh::new(&light.mesh.vertices, &light.mesh.triangles()),
            light,
            volume: Volume::read(&workspace.folder("irradiance").join("irradiance.ply"))?,
            truth,
        })
    }
}

fn read_environment(workspace: &Workspace) -> Result<Environment> {
    let path = workspace.folder("probe").join("environment.exr");
    let planes = exr::read(&path)?;
    Environment::from_planes(&planes).ok_or_else(|| {
        Error::file("reading a picture", &path, "lacks planes that it must have", remake(&path))
    })
}

/// All figures of one light.
struct Figures {
    lamps: Vec<Lamp>,
    /// Relative error of irradiance at the ball along ±x, ±y, ±z.
    axes: [f64; 6],
    points: points::Errors,
    surfaces: Vec<surfaces::Surface>,
}

impl Figures {
    fn of(judged: &Judged) -> Result<Self> {
        Ok(Self {
            lamps: lamps::judge(judged)?,
            axes: points::axes(judged),
            points: points::judge(judged)?,
            surfaces: surfaces::judge(judged)?,
        })
    }

    /// Worst shift of a lamp (degrees) in the ball's picture and in the light model, worst axis, error at points, worst point,
    /// median surface, worst surface.
    fn row(&self) -> [f64; 7] {
        let worst = |values: &mut dyn Iterator<Item = f64>| values.map(f64::abs).fold(0.0, f64::max);
        let mut errors: Vec<f64> = self.surfaces.iter().map(|s| s.error.abs()).collect();
        errors.sort_by(f64::total_cmp);
        [
            worst(&mut self.lamps.iter().map(|l| l.shift_deg[0])),
            worst(&mut self.lamps.iter().map(|l| l.shift_deg[1])),
            worst(&mut self.axes.iter().copied()),
            self.points.all,
            self.points.worst,
            errors.get(errors.len() / 2).copied().unwrap_or(f64::NAN),
            errors.last().copied().unwrap_or(f64::NAN),
        ]
    }
}

/// Prints a block for each settings file with truth.
pub(super) fn print(settings: &[PathBuf], printer: &Printer) -> Result<()> {
    printer.data("\nlight against the truth: lamps: largest shift of a lamp's or window's centroid as seen in the ball and by the light model, °;");
    printer.data("axes: largest error of irradiance at the ball's centre on six axes, %; points: error of irradiance in harmonics at the truth's");
    printer.data("points, relative RMS over all and at the worst, %; surfaces: error of reflectance, median and worst of the surfaces in the plate, %");
    printer.data("rows: the stages whose result is ours (light: merge, probe, illuminate; all: from the photographs alone)");
    for file in settings {
        if !has_truth(file)? {
            printer.data(&format!("{}  without a true picture: left out", validate::name(file)));
            continue;
        }
        printer.data(&format!(
            "\n{:<16}{:>14}{:>14}{:>10}{:>10}{:>8}{:>12}{:>8}",
            validate::name(file),
            "lamps in ball",
            "in the model",
            "axes",
            "points",
            "worst",
            "surfaces",
            "worst"
        ));
        let mut details = Vec::new();
        for (name, ours) in COLUMNS.into_iter().take(6).chain([LIGHT_OURS, COLUMNS[6]]) {
            let figures = Figures::of(&Judged::read(file, name, ours)?)?;
            let [ball, model, axes, points, point, surfaces, surface] = figures.row();
            printer.data(&format!(
                "{name:<16}{ball:>14.2}{model:>14.2}{:>10.1}{:>10.1}{:>8.1}{:>12.1}{:>8.1}",
                100.0 * axes,
                100.0 * points,
                100.0 * point,
                100.0 * surfaces,
                100.0 * surface
            ));
            if name == LIGHT_OURS.0 || ours.len() == TrueStage::ALL.len() {
                details.push((name, figures));
            }
        }
        let [lamp, axis, point, surface] = GOALS;
        printer.data(&format!(
            "{:<16}{lamp:>14.2}{lamp:>14.2}{:>10.1}{:>10.1}{:>8}{:>12.1}",
            "goal of light",
            100.0 * axis,
            100.0 * point,
            "",
            100.0 * surface
        ));
        for (name, figures) in &details {
            print_details(name, figures, printer);
        }
    }
    Ok(())
}

fn print_details(name: &str, figures: &Figures, printer: &Printer) {
    for lamp in &figures.lamps {
        let [ball, model] = lamp.shift_deg;
        let [ball_power, model_power] = lamp.power.map(|p| 100.0 * (p - 1.0));
        printer.data(&format!(
            "  {name}: {} seen {ball:.2}° off in the ball, {model:.2}° in the model, its light {ball_power:+.1} %, {model_power:+.1} %",
            lamp.name
        ));
    }
    let axes: Vec<String> = ["+x", "−x", "+y", "−y", "+z", "−z"]
        .iter()
        .zip(figures.axes)
        .map(|(axis, e)| format!("{axis} {:+.1}", 100.0 * e))
        .collect();
    printer.data(&format!("  {name}: irradiance at the ball, %: {}", axes.join(", ")));
    let [x, y, z] = figures.points.worst_at.to_array();
    printer.data(&format!(
        "  {name}: worst point at {x:.2} {y:.2} {z:.2}; energy of all points {:+.1} %",
        100.0 * figures.points.bias
    ));
    let surfaces: Vec<String> =
        figures.surfaces.iter().map(|s| format!("{} {:+.0}", s.name, 100.0 * s.error)).collect();
    printer.data(&format!("  {name}: reflectance, %: {}", surfaces.join(", ")));
}

//! `insitu truth`: the truth of a rendered capture in the place of stages' results, so that what follows runs on it.

use super::run;
use crate::artefact::{exr, json};
use crate::calibrate::Cameras;
use crate::config::Role;
use crate::error::{Context as _, Error, Result};
use crate::evaluate::Truth;
use crate::evaluate::references::read_truth;
use crate::exposure::Capture;
use crate::illuminate::{build::Known, put_light};
use crate::image::{Radiance, RadianceImage};
use crate::merge::Merged;
use crate::model::{self, Scene};
use crate::printer::Printer;
use crate::stage::{self, Context, STAGES, State, Workspace};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A stage whose result the truth can give.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum TrueStage {
    /// Radiance of the plate as rendered.
    Merge,
    /// Lens and pose as rendered.
    Calibrate,
    /// The environment as rendered at the ball's centre.
    Probe,
    /// All primitives.
    Model,
    /// Radiance of lamps, windows and sky; needs the true model, whose faces it names.
    Illuminate,
}

impl TrueStage {
    /// All of them, in running order.
    pub const ALL: [Self; 5] = [Self::Merge, Self::Calibrate, Self::Probe, Self::Model, Self::Illuminate];

    /// Name of the stage.
    pub fn name(self) -> &'static str {
        match self {
            Self::Merge => "merge",
            Self::Calibrate => "calibrate",
            Self::Probe => "probe",
            Self::Model => "model",
            Self::Illuminate => "illuminate",
        }
    }
}

/// Figure that marks a result as truth in `stage.json`.
const MARK: &str = "truth";

/// Writes true results into `work`; prints the folders.
pub fn truth(settings: &Path, work: &Path, stages: &[TrueStage], printer: &Printer) -> Result<()> {
    let workspace = Workspace::open_in(settings, Some(work))?;
    write(&workspace, stages, printer)?;
    stages.iter().for_each(|s| printer.data(&workspace.folder(s.name()).display().to_string()));
    Ok(())
}

/// Makes true results of `stages`, and lets the other stages up to the last of them run as ever.
pub fn write(workspace: &Workspace, stages: &[TrueStage], printer: &Printer) -> Result<()> {
    if stages.contains(&TrueStage::Illuminate) && !stages.contains(&TrueStage::Model) {
        return Err(Error::Usage {
            problem: "true light lies on the faces of the true model".into(),
            hint: "name `model` among the stages too".into(),
        });
    }
    let wanted = |name: &str| stages.iter().find(|s| s.name() == name);
    let Some(last) = STAGES.iter().rposition(|s| wanted(s.name).is_some()) else { return Ok(()) };
    for row in &STAGES[..=last] {
        let Some(stage) = wanted(row.name) else {
            run::run_stage(workspace, row, is_true(workspace, row.name), printer)?;
            continue;
        };
        if stage::state(workspace, row) == State::Fresh && is_true(workspace, row.name) {
            printer.say(&format!("{:<11} true", row.name));
            continue;
        }
        printer.say(&format!("{:<11} taken from the truth", row.name));
        stage::run(workspace, row.name, printer, |ctx| {
            let truth = Source::read(ctx)?;
            ctx.figure(MARK, true);
            match stage {
                TrueStage::Merge => truth.merge(ctx),
                TrueStage::Calibrate => truth.calibrate(ctx),
                TrueStage::Probe => truth.probe(ctx),
                TrueStage::Model => truth.model(ctx),
                TrueStage::Illuminate => truth.illuminate(ctx),
            }
        })?;
    }
    Ok(())
}

fn is_true(workspace: &Workspace, stage: &str) -> bool {
    workspace.manifest(stage).is_ok_and(|m| m.figures.contains_key(MARK))
}

/// `truth.json`, and the pictures beside it.
struct Source {
    truth: Truth,
    path: PathBuf,
}

impl Source {
    fn read(ctx: &Context) -> Result<Self> {
        match (read_truth(ctx)?, &ctx.pipeline.evaluate.truth) {
            (Some(truth), Some(path)) => Ok(Self { truth, path: path.clone() }),
            _ => Err(Error::Usage {
                problem: "the settings name no truth".into(),
                hint: "give `evaluate.truth`, the truth.json of a rendered capture".into(),
            }),
        }
    }

    fn doing(&self) -> String {
        format!("taking results from {}", self.path.display())
    }

    /// A picture of the truth in plate units; its name stands in `truth.json` with the capture's folder.
    fn picture(&self, ctx: &Context, file: &str) -> Result<RadianceImage> {
        let name = Path::new(file).file_name().unwrap_or_default();
        exr::read_radiance(&ctx.user_file(&self.path.with_file_name(name))?)
    }

    /// Plate units in one unit of the truth, and the plate's file.
    fn plate(&self, ctx: &Context) -> Result<(f64, String)> {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        let file = capture.plate()?.file.clone();
        Ok((self.truth.plate_scale(&file).doing(self.doing())?, file))
    }

    fn merge(&self, ctx: &Context) -> Result<()> {
        let (scale, file) = self.plate(ctx)?;
        let empty = self.truth.empty_file(&file).doing(self.doing())?;
        let plate = self.picture(ctx, empty)?.map(|p| Radiance(p.0.map(|v| v * scale as f32)));
        exr::write(&ctx.output("plate.exr"), &Merged::from_linear(&plate).planes(), exr::Kind::Picture)
    }

    fn calibrate(&self, ctx: &Context) -> Result<()> {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        json::write(&ctx.output("cameras.json"), &self.cameras(&capture)?)
    }

    /// The plates', and those of photographs from beside the first.
    fn cameras(&self, capture: &Capture) -> Result<Cameras> {
        let plate = capture.plate()?.file.clone();
        let roles = [Role::Plate, Role::Brackets, Role::PlateWithGrid];
        let posed: BTreeMap<_, _> = roles
            .iter()
            .flat_map(|role| capture.with_role(*role))
            .map(|photo| &photo.file)
            .map(|file| self.truth.posed_camera(file).map(|posed| (file.clone(), posed)))
            .collect::<std::result::Result<_, _>>()
            .doing(self.doing())?;
        let cameras = Cameras::new(plate, posed, Some(0.0));
        cameras.ok_or_else(|| Error::Bug("the plate has no pose".into()))
    }

    fn probe(&self, ctx: &Context) -> Result<()> {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        let (scale, plate) = self.plate(ctx)?;
        let file = capture.with_role(Role::Probe).next().map_or(plate, |p| p.file.clone());
        let map = self.picture(ctx, self.truth.environment_file().doing(self.doing())?)?;
        let fit = self.truth.probe(&file, map.width()).doing(self.doing())?;
        let environment = self.truth.environment(&map, scale, fit.centre).doing(self.doing())?;
        json::write(&ctx.output("probe.json"), &fit)?;
        exr::write(&ctx.output("environment.exr"), &environment.to_planes(), exr::Kind::LatLong)
    }

    fn model(&self, ctx: &Context) -> Result<()> {
        let scene = self.truth.scene().doing(self.doing())?;
        json::write(&ctx.output("scene.json"), &scene)?;
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        model::export(ctx, &scene, &self.cameras(&capture)?, &capture.photos, &[])
    }

    fn illuminate(&self, ctx: &Context) -> Result<()> {
        let plate = self.truth.plate_file().doing(self.doing())?;
        let scale = self.truth.plate_scale(plate).doing(self.doing())?;
        let emitters = self.truth.emitters().doing(self.doing())?;
        let sky = match self.truth.sky_file() {
            None => None,
            Some(file) => {
                let map = self.picture(ctx, file)?;
                Some(self.truth.environment(&map, scale, Default::default()).doing(self.doing())?)
            }
        };
        let faces = |scene: &Scene| {
            let radiance = |name: &str| {
                let name = name.split('.').next().unwrap_or(name);
                emitters.get(name).map(|l| l.map(|v| (v * scale) as f32))
            };
            let faces = scene.faces.iter().enumerate();
            faces.filter_map(|(i, f)| Some((i as u32, radiance(&f.name)?))).collect()
        };
        put_light(ctx, |scene| Ok(Known { faces: faces(scene), sky }))
    }
}

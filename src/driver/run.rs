//! `insitu run`: starts the stages' own programs in order, as a user would.

use crate::error::{Error, FileContext, Result};
use crate::printer::{Printer, Verbosity};
use crate::stage::{self, STAGES, Stage, State, Workspace};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Which stages to run.
#[derive(Debug, Clone, Default)]
pub struct Range {
    /// First stage to look at.
    pub from: Option<String>,
    /// Last stage to run.
    pub to: Option<String>,
    /// Run even what is fresh.
    pub force: bool,
}

impl Range {
    fn stages(&self) -> Result<&'static [Stage]> {
        let index = |name: &Option<String>, default: usize| match name {
            None => Ok(default),
            Some(name) => STAGES.iter().position(|s| s.name == name).ok_or_else(|| unknown_stage(name)),
        };
        let (first, last) = (index(&self.from, 0)?, index(&self.to, STAGES.len() - 1)?);
        if first > last {
            return Err(Error::Usage {
                problem: format!("stage `{}` comes after `{}`", STAGES[first].name, STAGES[last].name),
                hint: "exchange --from and --to".into(),
            });
        }
        Ok(&STAGES[first..=last])
    }
}

fn unknown_stage(name: &str) -> Error {
    let names: Vec<_> = STAGES.iter().map(|s| s.name).collect();
    let nearest =
        names.iter().max_by(|a, b| strsim::jaro_winkler(name, a).total_cmp(&strsim::jaro_winkler(name, b)));
    Error::Usage {
        problem: format!("no stage `{name}`; the stages are {}", names.join(", ")),
        hint: nearest.map_or(String::new(), |n| format!("did you mean `{n}`?")),
    }
}

/// Runs what is not fresh; prints the products of the last stage.
pub fn run(settings: &Path, work: Option<&Path>, range: &Range, printer: &Printer) -> Result<()> {
    let workspace = Workspace::open_in(settings, work)?;
    stages(&workspace, range, printer)?;
    for product in ["composite/augmented.png", "composite/augmented.exr", "evaluate/report.html"] {
        let path = workspace.work.join(product);
        if path.exists() {
            printer.data(&path.display().to_string());
        }
    }
    Ok(())
}

/// Runs what is not fresh.
pub fn stages(workspace: &Workspace, range: &Range, printer: &Printer) -> Result<()> {
    range.stages()?.iter().try_for_each(|stage| run_stage(workspace, stage, range.force, printer))
}

pub(super) fn run_stage(workspace: &Workspace, stage: &Stage, force: bool, printer: &Printer) -> Result<()> {
    let why = match stage::state(workspace, stage) {
        State::Fresh if !force => {
            printer.say(&format!("{:<11} fresh", stage.name));
            return Ok(());
        }
        State::Fresh => "forced".to_string(),
        State::Stale(why) | State::Missing(why) => why,
    };
    printer.say(&format!("{:<11} {} ({why})", stage.name, stage.about));
    let program = program(stage.name)?;
    let mut command = Command::new(&program);
    command.arg(&workspace.settings_file);
    if workspace.elsewhere {
        command.arg("--work").arg(&workspace.work);
    }
    match printer.verbosity() {
        Verbosity::Quiet => command.arg("--quiet"),
        Verbosity::Verbose => command.arg("--verbose"),
        Verbosity::Normal => &mut command,
    };
    let status = command.status().at("starting the stage", &program)?;
    if status.success() {
        return Ok(());
    }
    Err(Error::Stage { stage: stage.name, code: status.code() })
}

/// The program of a stage lies beside this one.
fn program(stage: &str) -> Result<PathBuf> {
    let own = std::env::current_exe().at("looking for the stages' programs", Path::new("insitu"))?;
    let path = own.with_file_name(format!("insitu-{stage}"));
    if path.exists() {
        return Ok(path);
    }
    Err(Error::file(
        "starting the stage",
        &path,
        "no such program",
        "build all programs with `cargo build --release`",
    ))
}

//! What each stage adds to the error against a capture's truth: all stages true, then one at a time by ours.

use super::truth::has_truth;
use crate::artefact::json;
use crate::driver::run::{self, Range};
use crate::driver::truth::{self, TrueStage};
use crate::driver::validate;
use crate::error::Result;
use crate::evaluate::Report;
use crate::printer::{Printer, Verbosity};
use crate::stage::Workspace;
use std::path::{Path, PathBuf};

use TrueStage::{Calibrate, Illuminate, Merge, Model, Probe};

/// Name of a column, and the stages whose result is ours. The true light lies on the true model and knows the lamps: a
/// model or probe of ours can only be judged with the light that `illuminate` finds by it.
pub(super) const COLUMNS: [(&str, &[TrueStage]); 7] = [
    ("none", &[]),
    ("calibrate", &[Calibrate]),
    ("merge", &[Merge]),
    ("illuminate", &[Illuminate]),
    ("probe+", &[Probe, Illuminate]),
    ("model+", &[Model, Illuminate]),
    ("all", &TrueStage::ALL),
];

/// Prints a line for each settings file: relative shadow error and energy bias with some stages by ours.
pub(super) fn print(settings: &[PathBuf], printer: &Printer) -> Result<()> {
    printer.data("\nrelative shadow error, shadow energy bias (%), by the stages whose result is ours and not the truth's;");
    printer.data("`+`: with illuminate; all: ingest and response too; noise: of the truth");
    let head: String = COLUMNS.iter().map(|(name, _)| format!("{name:>16}")).collect();
    let width = settings.iter().map(|s| validate::name(s).len()).max().unwrap_or(0).max(7);
    printer.data(&format!("{:<width$}{head}{:>8}", "capture", "noise"));
    for file in settings {
        if !has_truth(file)? {
            printer.data(&format!("{:<width$}  without a true picture: left out", validate::name(file)));
            continue;
        }
        let mut line = format!("{:<width$}", validate::name(file));
        let mut noise = None;
        for (name, ours) in COLUMNS {
            let report = judge(file, name, ours)?;
            let figure = |name: &str| report.figures.iter().find(|f| f.name == name).and_then(|f| f.value);
            let cell = match (figure("relative_shadow_error"), figure("shadow_energy_bias")) {
                (Some(error), Some(bias)) => format!("{error:.3} {:>+6.1}", 100.0 * bias),
                _ => "-".into(),
            };
            line += &format!("{cell:>16}");
            noise = noise.or(figure("reference_noise"));
        }
        line += &noise.map_or(format!("{:>8}", "-"), |n| format!("{n:>8.3}"));
        printer.data(&line);
    }
    Ok(())
}

/// Runs a settings file with some stages by ours, in a work folder of its own.
fn judge(file: &Path, name: &str, ours: &[TrueStage]) -> Result<Report> {
    let workspace = true_workspace(file, name, ours)?;
    json::read(&workspace.folder("evaluate").join("report.json"))
}

/// A finished run whose stages are the truth's but for `ours`; where all are ours, the usual one.
pub(super) fn true_workspace(file: &Path, name: &str, ours: &[TrueStage]) -> Result<Workspace> {
    true_workspace_to(file, name, ours, &Range::default())
}

/// The same, with the stages of a range.
pub(super) fn true_workspace_to(
    file: &Path,
    name: &str,
    ours: &[TrueStage],
    range: &Range,
) -> Result<Workspace> {
    let usual = Workspace::open(file)?;
    let stages: Vec<_> = TrueStage::ALL.into_iter().filter(|s| !ours.contains(s)).collect();
    let quiet = Printer::new(Verbosity::Quiet);
    if stages.is_empty() {
        run::stages(&usual, range, &quiet)?;
        return Ok(usual);
    }
    let folder = usual.work.join("truth").join(name.trim_end_matches('+'));
    let workspace = Workspace::open_in(file, Some(&folder))?;
    truth::write(&workspace, &stages, &quiet)?;
    run::stages(&workspace, range, &quiet)?;
    Ok(workspace)
}

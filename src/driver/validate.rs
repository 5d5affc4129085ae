//! `insitu validate`: every capture under some folders, its errors against the bounds it states.

use super::run::{self, Range};
use crate::artefact::json;
use crate::error::{Error, FileContext, Result};
use crate::evaluate::Report;
use crate::printer::{Printer, Verbosity};
use crate::stage::Workspace;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The settings files of one folder, which share its work folder: `pipeline.toml` and those that extend it. They run
/// one after the other, so that what they have in common is done once.
#[derive(Debug)]
struct Capture {
    settings: Vec<PathBuf>,
}

/// What came of one settings file.
enum Outcome {
    Judged(Report),
    Skipped(String),
    Failed(String),
}

/// Runs all captures, `jobs` at a time, and prints the table. Whether all kept their bounds.
pub fn validate(folders: &[PathBuf], jobs: usize, force: bool, printer: &Printer) -> Result<bool> {
    let mut captures = Vec::new();
    for folder in folders {
        if !folder.is_dir() {
            return Err(Error::file("looking for captures", folder, "no such folder", "check the name"));
        }
        find(folder, &mut captures)?;
    }
    if captures.is_empty() {
        return Err(Error::Usage {
            problem: format!("no pipeline.toml under {}", list(folders)),
            hint: "write one with `insitu new FOLDER`".into(),
        });
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(jobs.max(1))
        .build()
        .map_err(|e| Error::Bug(format!("starting threads: {e}")))?;
    let bar = printer.progress("captures", captures.iter().map(|c| c.settings.len() as u64).sum());
    let outcomes: Vec<(String, Outcome)> = pool.install(|| {
        use rayon::prelude::*;
        captures
            .par_iter()
            .flat_map_iter(|capture| {
                capture.settings.iter().map(|settings| {
                    let outcome = judge(settings, force).unwrap_or_else(|e| {
                        printer.error(&e);
                        Outcome::Failed(e.to_string())
                    });
                    bar.inc(1);
                    (name(settings), outcome)
                })
            })
            .collect()
    });
    bar.finish_and_clear();
    Ok(print(&outcomes, printer))
}

/// The settings files that some paths mean: files themselves, and all under folders.
pub(crate) fn settings_under(paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut all = Vec::new();
    for path in paths {
        if path.is_dir() {
            let mut captures = Vec::new();
            find(path, &mut captures)?;
            all.extend(captures.into_iter().flat_map(|c| c.settings));
        } else {
            all.push(path.clone());
        }
    }
    Ok(all)
}

fn list(folders: &[PathBuf]) -> String {
    folders.iter().map(|f| f.display().to_string()).collect::<Vec<_>>().join(", ")
}

/// `folder/pipeline.toml` is named by its folder, others by folder and file; without a folder by the file.
pub(crate) fn name(settings: &Path) -> String {
    let folder = settings.parent().and_then(Path::file_name).map(|f| f.to_string_lossy());
    let stem = settings.file_stem().unwrap_or_default().to_string_lossy();
    match folder {
        Some(folder) if stem == "pipeline" => folder.into_owned(),
        Some(folder) => format!("{folder}/{stem}"),
        None => stem.into_owned(),
    }
}

fn find(folder: &Path, captures: &mut Vec<Capture>) -> Result<()> {
    let mut settings = Vec::new();
    let mut below = Vec::new();
    for entry in std::fs::read_dir(folder).at("looking for captures", folder)? {
        let path = entry.at("looking for captures", folder)?.path();
        if path.is_dir() {
            below.push(path);
        } else if path.file_name().is_some_and(|n| n == "pipeline.toml") || extends(&path) {
            settings.push(path);
        }
    }
    if !settings.is_empty() {
        settings.sort();
        captures.push(Capture { settings });
    }
    below.sort();
    below.iter().try_for_each(|b| find(b, captures))
}

/// Whether this is a settings file that extends another one.
fn extends(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "toml")
        && std::fs::read_to_string(path).is_ok_and(|text| {
            text.parse::<toml::Table>().is_ok_and(|table| table.get("extends").is_some_and(|v| v.is_str()))
        })
}

fn judge(settings: &Path, force: bool) -> Result<Outcome> {
    let workspace = Workspace::open(settings)?;
    let photos = workspace.base.join(&workspace.pipeline.ingest.photos);
    if !photos.is_dir() {
        return Ok(Outcome::Skipped(format!("no photographs in {}", photos.display())));
    }
    let quiet = Printer::new(Verbosity::Quiet);
    run::stages(&workspace, &Range { force, ..Range::default() }, &quiet)?;
    keep(&workspace, settings)?;
    Ok(Outcome::Judged(json::read(&workspace.folder("evaluate").join("report.json"))?))
}

/// The next settings file of the folder writes over `composite` and `evaluate`: keeps what a person looks at.
fn keep(workspace: &Workspace, settings: &Path) -> Result<()> {
    let stem = settings.file_stem().unwrap_or_default();
    let folder = workspace.work.join("validated").join(stem);
    std::fs::create_dir_all(&folder).at("keeping the report", &folder)?;
    for (stage, file) in
        [("composite", "augmented.png"), ("evaluate", "report.html"), ("evaluate", "report.csv")]
    {
        let from = workspace.folder(stage).join(file);
        std::fs::copy(&from, folder.join(file)).at("keeping the report", &from)?;
    }
    Ok(())
}

/// One line a settings file, one column a bounded figure; whether all passed.
fn print(outcomes: &[(String, Outcome)], printer: &Printer) -> bool {
    let mut columns: BTreeMap<String, ()> = BTreeMap::new();
    for (_, outcome) in outcomes {
        if let Outcome::Judged(report) = outcome {
            columns.extend(report.figures.iter().filter(|f| f.bound.is_some()).map(|f| (f.name.clone(), ())));
        }
    }
    let width = outcomes.iter().map(|(n, _)| n.len()).max().unwrap_or(0).max(7);
    let mut all = true;
    for (i, name) in columns.keys().enumerate() {
        printer.data(&format!("[{}] {name}", i + 1));
    }
    let head: String = (1..=columns.len()).map(|i| format!("{:>18}", format!("[{i}]"))).collect();
    printer.data(&format!("{:<width$}{head}  result", "capture"));
    for (name, outcome) in outcomes {
        let (cells, result) = match outcome {
            Outcome::Judged(report) => {
                let passed = report.figures.iter().all(|f| f.passed != Some(false));
                all &= passed;
                let cell = |column: &String| match report.figures.iter().find(|f| f.name == *column) {
                    Some(f) if f.bound.is_some() => {
                        let mark = if f.passed == Some(false) { "!" } else { " " };
                        let value = f.value.map_or("none".into(), |v| format!("{v:.3}"));
                        format!("{:>18}", format!("{value}/{}{mark}", f.bound.unwrap_or_default()))
                    }
                    _ => format!("{:>18}", "-"),
                };
                (
                    columns.keys().map(cell).collect::<String>(),
                    if passed { "passed" } else { "FAILED" }.to_string(),
                )
            }
            Outcome::Skipped(why) => (String::new(), format!("skipped: {why}")),
            Outcome::Failed(why) => {
                all = false;
                (String::new(), format!("FAILED: {why}"))
            }
        };
        printer.data(&format!("{name:<width$}{cells}  {result}"));
    }
    all
}

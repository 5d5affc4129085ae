//! The command line of a stage: the same for all of them.

use crate::error::{Error, Result};
use crate::printer::{Printer, Verbosity};
use crate::stage::{self, Context, Workspace};
use clap::Parser;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::{Mutex, PoisonError};

/// Arguments of every stage.
#[derive(Debug, Parser)]
#[command(version)]
pub struct StageArguments {
    /// Settings file; everything else is named in it.
    #[arg(default_value = "pipeline.toml")]
    pub pipeline: PathBuf,
    /// Work folder in the place of the one that the settings name.
    #[arg(long, value_name = "DIR")]
    pub work: Option<PathBuf>,
    /// Say nothing but errors.
    #[arg(long, short)]
    pub quiet: bool,
    /// Say the stage's figures.
    #[arg(long, short)]
    pub verbose: bool,
}

/// Verbosity from the two switches.
pub fn printer(quiet: bool, verbose: bool) -> Printer {
    Printer::new(match (quiet, verbose) {
        (true, _) => Verbosity::Quiet,
        (_, true) => Verbosity::Verbose,
        _ => Verbosity::Normal,
    })
}

/// The `main` of a stage's program: parses, runs, explains. Prints the folder of the result.
pub fn stage_main(name: &'static str, body: impl FnOnce(&Context) -> Result<()>) -> ExitCode {
    let about = stage::find(name).map_or("", |s| s.about);
    let command = <StageArguments as clap::CommandFactory>::command().name(name).about(about);
    let matches = command.get_matches();
    let arguments = match <StageArguments as clap::FromArgMatches>::from_arg_matches(&matches) {
        Ok(arguments) => arguments,
        Err(e) => e.exit(),
    };
    let printer = printer(arguments.quiet, arguments.verbose);
    let opened = Workspace::open_in(&arguments.pipeline, arguments.work.as_deref());
    let outcome = opened.and_then(|workspace| {
        // Guarded inside `run`, so that what the stage left is cleared and the earlier result stays.
        stage::run(&workspace, name, &printer, |ctx| guard(|| body(ctx)))?;
        printer.detail(&format!("wrote {}", workspace.folder(name).display()));
        Ok(())
    });
    exit(&printer, outcome)
}

/// What the last panic said, and where.
static PANIC: Mutex<Option<String>> = Mutex::new(None);

/// Turns a panic, which is always a fault of ours, into an error.
pub fn guard<T>(body: impl FnOnce() -> Result<T>) -> Result<T> {
    std::panic::set_hook(Box::new(|info| {
        let text = info.payload_as_str().unwrap_or("a panic");
        let place = info.location().map_or(String::new(), |l| format!(" ({}:{})", l.file(), l.line()));
        // The first one is the cause.
        PANIC.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(format!("{text}{place}"));
    }));
    catch_unwind(AssertUnwindSafe(body)).unwrap_or_else(|_| {
        let message = PANIC.lock().unwrap_or_else(PoisonError::into_inner).take();
        Err(Error::Bug(message.unwrap_or_else(|| "a panic".into())))
    })
}

/// Turns an outcome into the exit status, saying what went wrong.
pub fn exit(printer: &Printer, outcome: Result<()>) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            printer.error(&e);
            ExitCode::from(e.exit_code())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::Workspace;

    #[test]
    fn a_panic_in_a_stage_is_our_fault_and_leaves_the_earlier_result() {
        let folder = tempfile::tempdir().unwrap();
        let settings = folder.path().join("pipeline.toml");
        std::fs::write(&settings, "").unwrap();
        let workspace = Workspace::open(&settings).unwrap();
        let printer = printer(true, false);
        let stage = |text: &'static str, fails: bool| {
            stage::run(&workspace, "ingest", &printer, |ctx| {
                guard(|| {
                    std::fs::write(ctx.output("capture.json"), text).unwrap();
                    // In another thread, as rayon's are.
                    let sum: usize = rayon::join(|| if fails { [1][text.len()] } else { 1 }, || 1).0;
                    assert_eq!(sum, 1);
                    Ok(())
                })
            })
        };
        stage("whole", false).unwrap();
        let e = stage("half done", true).unwrap_err();
        assert_eq!(e.exit_code(), 3);
        assert!(
            e.to_string().starts_with("index out of bounds: the len is 1 but the index is 9 (src"),
            "{e}"
        );
        assert!(e.to_string().ends_with("; this is a fault of insitu, not of your data"), "{e}");
        let kept = std::fs::read_to_string(workspace.folder("ingest").join("capture.json")).unwrap();
        assert_eq!(kept, "whole");
        assert!(!workspace.work.join(".ingest.part").exists());
    }
}

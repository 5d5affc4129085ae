//! The command line of a stage: the same for all of them.

use crate::error::Result;
use crate::printer::{Printer, Verbosity};
use crate::stage::{self, Context, Workspace};
use clap::Parser;
use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of every stage.
#[derive(Debug, Parser)]
#[command(version)]
pub struct StageArguments {
    /// Settings file; everything else is named in it.
    #[arg(default_value = "pipeline.toml")]
    pub pipeline: PathBuf,
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
    let outcome = Workspace::open(&arguments.pipeline)
        .and_then(|workspace| stage::run(&workspace, name, &printer, body).map(|_| workspace.folder(name)));
    exit(&printer, outcome.map(|folder| printer.detail(&format!("wrote {}", folder.display()))))
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

//! The program `insitu`: runs stages in order, says what is fresh, validates captures in batch, starts new ones.

pub(crate) mod live;
mod new;
pub(crate) mod run;
mod status;
pub(crate) mod truth;
pub(crate) mod validate;

use crate::bench;
use crate::cli;
use crate::error::Result;
use clap::{Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;

pub use new::{CaptureSheet, describe, roles_of_sheet, set, vanishing_lines};

/// From a photo set to a photograph with a synthetic object standing in it.
#[derive(Debug, Parser)]
#[command(name = "insitu", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
    /// Say nothing but errors and results.
    #[arg(long, short, global = true)]
    quiet: bool,
    /// Say each stage's figures.
    #[arg(long, short, global = true)]
    verbose: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run all stages whose inputs or settings have changed.
    Run {
        /// Settings file.
        #[arg(default_value = "pipeline.toml")]
        pipeline: PathBuf,
        /// First stage to look at; those before it are taken as they are.
        #[arg(long, value_name = "STAGE")]
        from: Option<String>,
        /// Last stage to run.
        #[arg(long, value_name = "STAGE")]
        to: Option<String>,
        /// Run even what is fresh.
        #[arg(long)]
        force: bool,
        /// Work folder in the place of the one that the settings name.
        #[arg(long, value_name = "DIR")]
        work: Option<PathBuf>,
    },
    /// Put the truth of a rendered capture (`evaluate.truth`) in the place of stages' results: `insitu run --work DIR` goes
    /// on from there.
    Truth {
        /// Settings file.
        #[arg(default_value = "pipeline.toml")]
        pipeline: PathBuf,
        /// Which stages; the others up to the last of them run as ever.
        #[arg(long, value_enum, value_delimiter = ',', default_values_t = truth::TrueStage::ALL)]
        stages: Vec<truth::TrueStage>,
        /// Work folder for the results.
        #[arg(long, value_name = "DIR")]
        work: PathBuf,
    },
    /// Say what is fresh, stale or missing, and why.
    Status {
        /// Settings file.
        #[arg(default_value = "pipeline.toml")]
        pipeline: PathBuf,
    },
    /// Run every capture found and hold its errors to the bounds it states.
    Validate {
        /// Folders to search for `pipeline.toml` and the settings files that extend it.
        #[arg(required = true)]
        folders: Vec<PathBuf>,
        /// Captures run at the same time.
        #[arg(long, default_value_t = 2)]
        jobs: usize,
        /// Run even what is fresh.
        #[arg(long)]
        force: bool,
    },
    /// Write a commented `pipeline.toml` for a folder of photographs, filled from their EXIF.
    New {
        /// Folder of the photographs; the settings are written into it.
        folder: PathBuf,
    },
    /// Put the object into a film or the frames of a camera, by markers and a mirror ball or a fisheye lens (`[live]`).
    Live {
        /// Settings file.
        #[arg(default_value = "pipeline.toml")]
        pipeline: PathBuf,
    },
    /// Measure speed and error: of each stage, of a frame, of the shadow methods, against the truth.
    Bench {
        /// Settings files, and folders to search for them.
        #[arg(default_value = "pipeline.toml")]
        pipelines: Vec<PathBuf>,
        /// Frames to time for each back end.
        #[arg(long, default_value_t = 10)]
        frames: usize,
        /// Only these tables.
        #[arg(long = "table", value_enum)]
        tables: Vec<bench::Table>,
        /// Folder of environment maps (latlong, .hdr or .exr) for the table `subtractive`.
        #[arg(long, value_name = "DIR")]
        environments: Option<PathBuf>,
        /// Folder for the pictures and plots of the tables that have some.
        #[arg(long, value_name = "DIR")]
        pictures: Option<PathBuf>,
    },
    /// Time and memory of one program on a folder of frames; the table `radiometry` starts it.
    #[command(hide = true)]
    MergeCost {
        /// Which program.
        program: String,
        /// Folder of the frames.
        folder: PathBuf,
    },
}

/// The `main` of the program.
pub fn main() -> ExitCode {
    cli::guard(|| Ok(start())).unwrap_or_else(|e| cli::exit(&cli::printer(false, false), Err(e)))
}

fn start() -> ExitCode {
    let arguments = Arguments::parse();
    let printer = cli::printer(arguments.quiet, arguments.verbose);
    let outcome: Result<()> = match arguments.command {
        Command::Run { pipeline, from, to, force, work } => {
            run::run(&pipeline, work.as_deref(), &run::Range { from, to, force }, &printer)
        }
        Command::Truth { pipeline, stages, work } => truth::truth(&pipeline, &work, &stages, &printer),
        Command::Status { pipeline } => status::status(&pipeline, &printer),
        Command::Validate { folders, jobs, force } => {
            match validate::validate(&folders, jobs, force, &printer) {
                Ok(true) => Ok(()),
                Ok(false) => return ExitCode::FAILURE,
                Err(e) => Err(e),
            }
        }
        Command::Live { pipeline } => live::live(&pipeline, &printer),
        Command::New { folder } => new::new(&folder, &printer),
        Command::Bench { pipelines, frames, tables, environments, pictures } => {
            bench::bench(&pipelines, frames, &tables, environments.as_deref(), pictures.as_deref(), &printer)
        }
        Command::MergeCost { program, folder } => bench::merge_cost(&program, &folder, &printer),
    };
    cli::exit(&printer, outcome)
}

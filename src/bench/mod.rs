//! `insitu bench`: what each stage costs, what a frame costs when the object moves and all else is reused, and what
//! each setting of a shadow method costs against its error.

mod accuracy;
mod frames;
mod statics;

use crate::driver::run::{self, Range};
use crate::error::{Error, Result};
use crate::printer::Printer;
use crate::stage::{STAGES, Workspace};
use statics::Static;
use std::path::Path;

/// A table of the benchmark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Table {
    /// Time and memory of each stage.
    Stages,
    /// Time of a frame, for both back ends.
    Frames,
    /// Speed against error of the shadow methods.
    Accuracy,
}

/// Runs what is stale, then prints the tables asked for; all of them where none is named.
pub fn bench(settings: &Path, frames: usize, tables: &[Table], printer: &Printer) -> Result<()> {
    if frames == 0 {
        return Err(Error::Usage {
            problem: "no frames to time".into(),
            hint: "ask for --frames 1 or more".into(),
        });
    }
    let workspace = Workspace::open(settings)?;
    run::stages(&workspace, &Range::default(), printer)?;
    let wanted = |table| tables.is_empty() || tables.contains(&table);
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    printer.data(&format!("{threads} threads; times in ms"));
    if wanted(Table::Stages) {
        print_stages(&workspace, printer)?;
    }
    let statics = Static::read(&workspace)?;
    if wanted(Table::Frames) {
        frames::print(&statics, &workspace, frames, printer)?;
    }
    if wanted(Table::Accuracy) {
        accuracy::print(&statics, &workspace, frames, printer)?;
    }
    Ok(())
}

fn print_stages(workspace: &Workspace, printer: &Printer) -> Result<()> {
    printer.data(&format!("\n{:<12}{:>10}{:>12}", "stage", "time", "memory MiB"));
    for stage in STAGES {
        let manifest = workspace.manifest(stage.name)?;
        let (time, memory) = (manifest.wall_s * 1e3, manifest.peak_memory_mib);
        printer.data(&format!("{:<12}{time:>10.0}{memory:>12.0}", stage.name));
    }
    Ok(())
}

/// Median, least and largest of some times, ms.
fn spread(ms: &mut [f64]) -> [f64; 3] {
    ms.sort_by(f64::total_cmp);
    [ms[ms.len() / 2], ms[0], ms[ms.len() - 1]]
}

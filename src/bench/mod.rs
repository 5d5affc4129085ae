//! `insitu bench`: what each stage costs, what a frame costs when the object moves and all else is reused, what each
//! setting of a shadow method costs against its error, and what 8 bits cost.

mod accuracy;
mod frames;
mod intensity;
mod ldr;
mod plot;
mod statics;

use crate::driver::run::{self, Range};
use crate::error::{Error, FileContext, Result};
use crate::printer::Printer;
use crate::stage::{STAGES, Workspace};
use statics::Static;
use std::path::{Path, PathBuf};

/// A table of the benchmark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Table {
    /// Time and memory of each stage.
    Stages,
    /// Time of a frame, for both back ends.
    Frames,
    /// Speed against error of the shadow methods.
    Accuracy,
    /// Error of intensity transfers (gibson, Figure 3), over all captures named, with a plot.
    Intensity,
    /// The 8-bit method against radiance, in code values.
    Ldr,
}

/// What a plain `insitu bench` prints.
const USUAL: [Table; 3] = [Table::Stages, Table::Frames, Table::Accuracy];

/// Runs what is stale, then prints the tables asked for, the usual ones where none is named.
/// `pictures` is a folder for what tables draw.
pub fn bench(
    settings: &[PathBuf],
    frames: usize,
    tables: &[Table],
    pictures: Option<&Path>,
    printer: &Printer,
) -> Result<()> {
    if frames == 0 {
        return Err(Error::Usage {
            problem: "no frames to time".into(),
            hint: "ask for --frames 1 or more".into(),
        });
    }
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    let workspaces = settings.iter().map(|s| Workspace::open(s)).collect::<Result<Vec<_>>>()?;
    workspaces.iter().try_for_each(|w| run::stages(w, &Range::default(), printer))?;
    for table in if tables.is_empty() { &USUAL } else { tables } {
        match table {
            Table::Intensity => intensity::print(&workspaces, pictures, printer)?,
            Table::Ldr => ldr::print(&workspaces, pictures, printer)?,
            Table::Stages | Table::Frames | Table::Accuracy => {
                for workspace in &workspaces {
                    let file = workspace.settings_file.display();
                    printer.data(&format!("{file}: {threads} threads; times in ms"));
                    match table {
                        Table::Stages => print_stages(workspace, printer)?,
                        Table::Frames => {
                            frames::print(&Static::read(workspace)?, workspace, frames, printer)?
                        }
                        _ => accuracy::print(&Static::read(workspace)?, workspace, frames, printer)?,
                    }
                }
            }
        }
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

/// A capture is called by its folder.
fn capture_name(workspace: &Workspace) -> Result<String> {
    let folder = workspace.base.canonicalize().at("finding the name of the capture", &workspace.base)?;
    Ok(folder.file_name().unwrap_or_default().to_string_lossy().into_owned())
}

/// Median, least and largest of some times, ms.
fn spread(ms: &mut [f64]) -> [f64; 3] {
    ms.sort_by(f64::total_cmp);
    [ms[ms.len() / 2], ms[0], ms[ms.len() - 1]]
}

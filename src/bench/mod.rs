//! `insitu bench`: what each stage costs, what a frame costs when the object moves and all else is reused, what each
//! setting of a shadow method costs against its error, what 8 bits cost, and where the error against a capture's truth
//! comes from.

mod blender;
mod breakdown;
mod cost;
mod dome;
mod frames;
mod gpu;
mod grids;
mod growth;
mod intensity;
mod joint;
mod ldr;
mod light;
mod methods;
mod model;
mod occlusion;
mod passes;
mod plot;
mod radiometry;
mod rooms;
mod statics;
mod subject;
mod subtractive;
mod triptych;
mod truth;
mod vanishing;

use crate::driver::run::{self, Range};
use crate::driver::validate;
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
    /// Error against passes, on captures and on a synthetic lobby.
    Passes,
    /// What moving the object costs, on a synthetic lobby.
    Cost,
    /// What a frame costs on the graphics processor, by its own clock, and how far it lies from the CPU's.
    Gpu,
    /// How pre-processing grows with the number of patches.
    Growth,
    /// Error of intensity transfers (gibson, Figure 3), over all captures named, with a plot.
    Intensity,
    /// The 8-bit method against radiance, in code values.
    Ldr,
    /// Light from the probe against the truth: where lamps are seen, irradiance, reflectance, by stage.
    Light,
    /// The probe's environment of the settings named against published maps of the same place, `latlon.hdr` beside them.
    Panorama,
    /// A mirror ball of ours where a real one stood, beside the photograph of that: the shadow's ratio, with pictures.
    Ball,
    /// Building an irradiance volume: growth with patches and points, and against ray casting in Mitsuba.
    Volume,
    /// What each stage adds to the error against a capture's truth.
    Breakdown,
    /// The methods against a capture's truth, with the true scene model.
    Truth,
    /// All methods by their knobs: cost, and error against rays and against a capture's truth.
    Methods,
    /// Subtractive and additive shadows by lights and sampling detail (decoro2008, Figures 3 and 5), on the environments of
    /// a folder, with a plot.
    Subtractive,
    /// Occlusion textures by filter, by rule of combination, by triangles and by the light's size (eisemann2006, Figures 2
    /// and 3), with a plot.
    Occlusion,
    /// The light dome by lights: time on a film (supan2006, Table 1), errors on captures (Figure 6), the film beside its truth.
    Dome,
    /// Vanishing points, marked and found, against known ones: takes folders of photographs with a `*ground_truth.json`, and
    /// rendered captures.
    Vanishing,
    /// The scene model: time of a first fit and as a mark is dragged, by primitives; its corners against a capture's truth.
    Model,
    /// The scene as Blender opens it against our camera, where Blender is installed.
    Blender,
    /// Response and merged radiance against the truth, beside OpenCV and pfstools; takes folders of exposures, too.
    Radiometry,
    /// Lenses and poses from printed grids against known ones, time beside OpenCV; takes folders with `*_intrinsics.yml`, and
    /// rendered captures.
    Grids,
    /// Response and merging on ten frames of 12 megapixels beside OpenCV: time and memory; takes folders, too.
    MergeCost,
    /// How the response varies with samples, size, exposures and seed, against its own band; takes folders, too.
    Stability,
}

impl Table {
    /// Folders of photographs have no settings, and some tables need none.
    fn needs_settings(self) -> bool {
        !matches!(
            self,
            Self::Radiometry
                | Self::MergeCost
                | Self::Grids
                | Self::Stability
                | Self::Vanishing
                | Self::Volume
                | Self::Model
                | Self::Blender
        )
    }
}

/// What a plain `insitu bench` prints.
const USUAL: [Table; 3] = [Table::Stages, Table::Frames, Table::Passes];

/// Runs what is stale, then prints the tables asked for, the usual ones where none is named.
/// `environments` is a folder of environment maps, `pictures` one for what tables draw.
pub fn bench(
    paths: &[PathBuf],
    frames: usize,
    tables: &[Table],
    environments: Option<&Path>,
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
    let needed = tables.is_empty() || tables.iter().any(|t| t.needs_settings());
    let settings = if needed { validate::settings_under(paths)? } else { Vec::new() };
    if let Some(folder) = pictures {
        std::fs::create_dir_all(folder).at("making a folder for pictures", folder)?;
    }
    for table in if tables.is_empty() { &USUAL } else { tables } {
        match table {
            Table::Passes => passes::print(&settings, frames, pictures, printer)?,
            Table::Cost => cost::print(frames, printer)?,
            Table::Gpu => gpu::print(&settings, frames, printer)?,
            Table::Growth => growth::print(pictures, printer)?,
            Table::Intensity => intensity::print(&ready(&settings, printer)?, pictures, printer)?,
            Table::Ldr => ldr::print(&settings, &ready(&settings, printer)?, pictures, printer)?,
            Table::Light => light::print(&settings, printer)?,
            Table::Panorama => light::panorama::print(&settings, environments, printer)?,
            Table::Ball => light::ball::print(&settings, pictures, printer)?,
            Table::Volume => light::volume::print(printer)?,
            Table::Breakdown => breakdown::print(&settings, printer)?,
            Table::Truth => truth::print(&settings, pictures, printer)?,
            Table::Blender => blender::print(printer)?,
            Table::Model => {
                let settings = validate::settings_under(paths)?;
                model::print(&settings, printer)?;
                rooms::print(&settings, printer)?;
            }
            Table::Methods => methods::print(&settings, frames, printer)?,
            Table::Subtractive => subtractive::print(&settings, environments, pictures, printer)?,
            Table::Radiometry => radiometry::print(paths, printer)?,
            Table::Grids => grids::print(paths, printer)?,
            Table::MergeCost => radiometry::print_cost(paths, printer)?,
            Table::Vanishing => vanishing::print(paths, printer)?,
            Table::Stability => radiometry::print_stability(paths, printer)?,
            Table::Occlusion => occlusion::print(&settings, frames, pictures, printer)?,
            Table::Dome => dome::print(&settings, frames, pictures, printer)?,
            Table::Stages | Table::Frames => {
                for (file, workspace) in settings.iter().zip(ready(&settings, printer)?) {
                    printer.data(&format!("{}: {threads} threads; times in ms", validate::name(file)));
                    match table {
                        Table::Stages => print_stages(&workspace, printer)?,
                        _ => frames::print(&Static::read(&workspace)?, &workspace, frames, printer)?,
                    }
                }
            }
        }
    }
    Ok(())
}

/// Merges a folder of large frames by one program and prints seconds and peak memory: a process of the table `merge-cost`.
pub fn merge_cost(program: &str, folder: &Path, printer: &Printer) -> Result<()> {
    radiometry::merge_cost(program, folder, printer)
}

/// Runs what is stale of each settings file.
fn ready(settings: &[PathBuf], printer: &Printer) -> Result<Vec<Workspace>> {
    let workspaces = settings.iter().map(|s| Workspace::open(s)).collect::<Result<Vec<_>>>()?;
    workspaces.iter().try_for_each(|w| run::stages(w, &Range::default(), printer))?;
    Ok(workspaces)
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

/// The value below which a share of ascending ones lies; 0 of none.
fn percentile(ascending: &[f64], share: f64) -> f64 {
    let at = (share * ascending.len().saturating_sub(1) as f64).round() as usize;
    ascending.get(at).copied().unwrap_or(0.0)
}

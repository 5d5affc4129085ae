//! The one table of stages, and how a stage runs: declared reads, a manifest written last, an atomic folder.
//!
//! A stage writes into `work/.NAME.part`; when all is whole the folder takes the place of `work/NAME`. A stage that
//! is killed leaves the earlier result.

mod freshness;

pub use freshness::{State, state};

use crate::artefact::json::{self, JsonArtefact};
use crate::artefact::remake;
use crate::config::Pipeline;
use crate::error::{Error, FileContext, Result};
use crate::printer::Printer;
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// One row of the way of the data.
#[derive(Debug, Clone, Copy)]
pub struct Stage {
    /// Name of the stage, its folder, its table in `pipeline.toml`; its program is `insitu-NAME`.
    pub name: &'static str,
    /// Raised when the same inputs give another result.
    pub version: u32,
    /// Stages whose artefacts it reads.
    pub reads: &'static [&'static str],
    /// Settings of other stages that it goes by, too: tables of `pipeline.toml`, or keys of them.
    pub settings: &'static [&'static str],
    /// What it does, for `--help`.
    pub about: &'static str,
}

impl Stage {
    /// All settings that it goes by, its own table first.
    pub fn all_settings(&self) -> Vec<&'static str> {
        std::iter::once(self.name).chain(self.settings.iter().copied()).collect()
    }
}

/// All stages in running order.
pub const STAGES: &[Stage] = &[
    Stage {
        name: "ingest",
        version: 2,
        reads: &[],
        settings: &["calibrate.inner_corners"],
        about: "read photographs and EXIF, sort them by role",
    },
    Stage {
        name: "response",
        version: 3,
        reads: &["ingest"],
        settings: &["calibrate.inner_corners"],
        about: "fit the camera response curve",
    },
    Stage {
        name: "merge",
        version: 4,
        reads: &["ingest", "response"],
        settings: &["response.exposures_from_pixels"],
        about: "merge the plate's exposures",
    },
    Stage {
        name: "calibrate",
        version: 5,
        reads: &["ingest"],
        settings: &["model.mark_sigma_px", "model.max_rms_px"],
        about: "find lens and camera poses",
    },
    Stage {
        name: "probe",
        version: 5,
        reads: &["ingest", "response", "calibrate"],
        settings: &["response.exposures_from_pixels", "merge", "calibrate"],
        about: "merge the probe's exposures, find the ball, unwrap it",
    },
    Stage {
        name: "model",
        version: 2,
        reads: &["ingest", "calibrate", "probe"],
        settings: &["calibrate.thickness_m"],
        about: "fit primitives to the marks",
    },
    Stage {
        name: "illuminate",
        version: 4,
        reads: &["merge", "calibrate", "probe", "model"],
        settings: &[],
        about: "carry the probe's radiance onto a patch mesh",
    },
    Stage {
        name: "irradiance",
        version: 4,
        reads: &["illuminate"],
        settings: &["calibrate.thickness_m", "probe.support_m"],
        about: "build the irradiance volume",
    },
    Stage {
        name: "transfer",
        version: 4,
        reads: &["calibrate", "model", "illuminate"],
        settings: &[],
        about: "radiance transfers from sources to receivers",
    },
    Stage {
        name: "render",
        version: 5,
        reads: &["ingest", "response", "merge", "calibrate", "model", "illuminate", "irradiance", "transfer"],
        settings: &[],
        about: "shade the object, evaluate the shadow method",
    },
    Stage {
        name: "composite",
        version: 2,
        reads: &["ingest", "response", "merge", "render"],
        settings: &["render.path"],
        about: "put object and shadow into the plate",
    },
    Stage {
        name: "evaluate",
        version: 1,
        reads: &[
            "ingest",
            "response",
            "merge",
            "calibrate",
            "probe",
            "model",
            "illuminate",
            "irradiance",
            "transfer",
            "render",
            "composite",
        ],
        settings: &["composite.exposure_ev"],
        about: "judge the result against a reference",
    },
];

/// The row of a stage.
pub fn find(name: &str) -> Option<&'static Stage> {
    STAGES.iter().find(|s| s.name == name)
}

/// Anything a stage has read, by what its result depends on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Input {
    /// BLAKE3 of the whole file.
    File(String),
    /// BLAKE3 of an image's size and EXIF: what [`crate::exposure::Header`] holds.
    Header(String),
    /// BLAKE3 of the names in a folder.
    Listing(String),
    /// Looked for and not there.
    Absent,
}

/// `stage.json`: how a result was made.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Manifest {
    /// Stage name.
    pub stage: String,
    /// Stage version.
    pub stage_version: u32,
    /// Version of insitu.
    pub program: String,
    /// Settings used, by table or key.
    pub settings: serde_json::Value,
    /// What was read, by path relative to the settings file.
    pub inputs: BTreeMap<String, Input>,
    /// BLAKE3 of what was written, by name.
    pub outputs: BTreeMap<String, String>,
    /// Wall time, s.
    pub wall_s: f64,
    /// Largest resident set, MiB.
    pub peak_memory_mib: f64,
    /// What was done in spite of a defect.
    pub warnings: Vec<String>,
    /// The stage's own figures, units in their names.
    pub figures: BTreeMap<String, serde_json::Value>,
}

impl JsonArtefact for Manifest {
    const FORMAT: &'static str = "insitu-stage";
    const VERSION: u32 = 2;
}

/// Name of the manifest in a stage's folder.
pub const MANIFEST: &str = "stage.json";

/// Where a run reads and writes.
#[derive(Debug, Clone)]
pub struct Workspace {
    /// The settings file.
    pub settings_file: PathBuf,
    /// Folder of the settings file.
    pub base: PathBuf,
    /// Work folder.
    pub work: PathBuf,
    /// Whether that is another one than the settings name.
    pub elsewhere: bool,
    /// The settings.
    pub pipeline: Pipeline,
}

impl Workspace {
    /// Reads the settings and fixes the folders.
    pub fn open(settings_file: &Path) -> Result<Self> {
        let pipeline = Pipeline::read(settings_file)?;
        let base = match settings_file.parent() {
            Some(p) if p != Path::new("") => p.to_path_buf(),
            _ => PathBuf::from("."),
        };
        let work = base.join(&pipeline.work);
        Ok(Self { settings_file: settings_file.to_path_buf(), base, work, elsewhere: false, pipeline })
    }

    /// As [`Self::open`], with another work folder if one is given.
    pub fn open_in(settings_file: &Path, work: Option<&Path>) -> Result<Self> {
        let mut workspace = Self::open(settings_file)?;
        if let Some(work) = work {
            // Manifests name inputs from the settings' folder on: only a whole path stays the same from there.
            workspace.work = std::path::absolute(work).at("looking for the work folder", work)?;
            workspace.elsewhere = true;
        }
        Ok(workspace)
    }

    /// Folder of a stage's result.
    pub fn folder(&self, stage: &str) -> PathBuf {
        self.work.join(stage)
    }

    /// The manifest of a finished stage; an earlier result hidden by a killed exchange of folders is brought back.
    pub fn manifest(&self, stage: &str) -> Result<Manifest> {
        let (folder, old) = (self.folder(stage), self.work.join(format!(".{stage}.old")));
        if !folder.exists() && old.exists() {
            std::fs::rename(&old, &folder).at("restoring an earlier result", &folder)?;
        }
        json::read(&folder.join(MANIFEST))
    }

    fn key(&self, path: &Path) -> String {
        path.strip_prefix(&self.base).unwrap_or(path).display().to_string()
    }
}

/// What a stage's function works with.
pub struct Context<'a> {
    /// Settings.
    pub pipeline: &'a Pipeline,
    /// Folder of the settings file: paths in it are relative to this.
    pub base: &'a Path,
    /// Progress and messages.
    pub printer: &'a Printer,
    workspace: &'a Workspace,
    stage: &'static Stage,
    part: PathBuf,
    inputs: RefCell<BTreeMap<String, Input>>,
    warnings: RefCell<Vec<String>>,
    figures: RefCell<BTreeMap<String, serde_json::Value>>,
}

impl Context<'_> {
    /// Path of an artefact of an earlier stage, which must be declared in [`STAGES`].
    pub fn artefact(&self, stage: &str, file: &str) -> Result<PathBuf> {
        if !self.stage.reads.contains(&stage) {
            return Err(Error::Bug(format!(
                "stage {} reads {stage}/{file} without declaring it",
                self.stage.name
            )));
        }
        let folder = self.workspace.folder(stage);
        let needs = format!("{} needs {file}", self.stage.name);
        if let Err(e) = self.workspace.manifest(stage) {
            let hint = format!("run `insitu run --to {}`", self.stage.name);
            let never = Error::file(&needs, &folder, format!("stage `{stage}` has not finished"), hint);
            return Err(if folder.join(MANIFEST).exists() { e } else { never });
        }
        let path = folder.join(file);
        if !path.exists() {
            return Err(Error::file(needs, &path, "is not there any more", remake(&path)));
        }
        self.file(&path)
    }

    /// Whether a declared earlier stage wrote this file.
    pub fn has_artefact(&self, stage: &str, file: &str) -> bool {
        self.workspace.manifest(stage).is_ok_and(|m| m.outputs.contains_key(file))
    }

    /// A file that a user gave, named in the settings or by `capture.json`; its content enters the digest.
    pub fn user_file(&self, relative: &Path) -> Result<PathBuf> {
        let path = self.base.join(relative);
        let doing = format!("opening an input of stage `{}`", self.stage.name);
        std::fs::File::open(&path).at(&doing, &path)?;
        self.file(&path)
    }

    /// Records an input of another kind than a whole file.
    pub fn depends_on(&self, path: &Path, input: Input) {
        self.inputs.borrow_mut().insert(self.workspace.key(path), input);
    }

    fn file(&self, path: &Path) -> Result<PathBuf> {
        self.depends_on(path, Input::File(digest_file(path)?));
        Ok(path.to_path_buf())
    }

    /// Where to write an artefact.
    pub fn output(&self, file: &str) -> PathBuf {
        self.part.join(file)
    }

    /// What was done in spite of a defect: goes to the terminal, `stage.json` and the report.
    pub fn warn(&self, message: impl Into<String>) {
        let message = message.into();
        self.printer.warn(&message);
        self.warnings.borrow_mut().push(message);
    }

    /// A figure of the stage's own; its unit stands in its name.
    pub fn figure(&self, name: &str, value: impl Serialize) {
        let value = serde_json::to_value(value).unwrap_or_default();
        self.printer.detail(&format!("{name}: {value}"));
        self.figures.borrow_mut().insert(name.into(), value);
    }

    /// Manifest of a declared earlier stage, for its warnings and figures.
    pub fn manifest(&self, stage: &str) -> Result<Manifest> {
        self.artefact(stage, MANIFEST)?;
        self.workspace.manifest(stage)
    }
}

/// Runs a stage whatever the state of its result.
pub fn run(
    workspace: &Workspace,
    name: &str,
    printer: &Printer,
    body: impl FnOnce(&Context) -> Result<()>,
) -> Result<Manifest> {
    let stage = find(name).ok_or_else(|| Error::Bug(format!("no stage `{name}`")))?;
    let started = Instant::now();
    let part = workspace.work.join(format!(".{name}.part"));
    if part.exists() {
        std::fs::remove_dir_all(&part).at("clearing what a killed run left", &part)?;
    }
    std::fs::create_dir_all(&part).at("making the work folder", &part)?;
    let context = Context {
        pipeline: &workspace.pipeline,
        base: &workspace.base,
        printer,
        workspace,
        stage,
        part: part.clone(),
        inputs: RefCell::default(),
        warnings: RefCell::default(),
        figures: RefCell::default(),
    };
    let outcome = body(&context);
    if let Err(e) = outcome {
        // The earlier result stays; what this run left is of no use.
        let _ = std::fs::remove_dir_all(&part);
        return Err(e);
    }
    let manifest = Manifest {
        stage: name.into(),
        stage_version: stage.version,
        program: env!("CARGO_PKG_VERSION").into(),
        settings: workspace.pipeline.settings(&stage.all_settings()),
        inputs: context.inputs.take(),
        outputs: digest_folder(&part)?,
        wall_s: started.elapsed().as_secs_f64(),
        peak_memory_mib: peak_memory_mib(),
        warnings: context.warnings.take(),
        figures: context.figures.take(),
    };
    json::write(&part.join(MANIFEST), &manifest)?;
    exchange(&part, &workspace.folder(name), &workspace.work.join(format!(".{name}.old")))?;
    Ok(manifest)
}

/// Puts `part` in the place of `folder`; at every moment one whole result is under `folder` or `old`.
fn exchange(part: &Path, folder: &Path, old: &Path) -> Result<()> {
    if folder.exists() {
        if old.exists() {
            std::fs::remove_dir_all(old).at("clearing an older result", old)?;
        }
        std::fs::rename(folder, old).at("putting an earlier result aside", folder)?;
    }
    std::fs::rename(part, folder).at("putting the result in place", folder)?;
    if old.exists() {
        std::fs::remove_dir_all(old).at("clearing an older result", old)?;
    }
    Ok(())
}

/// BLAKE3 of a file's content.
pub fn digest_file(path: &Path) -> Result<String> {
    let mut hasher = blake3::Hasher::new();
    let mut file = std::fs::File::open(path).at("reading", path)?;
    std::io::copy(&mut file, &mut hasher).at("reading", path)?;
    Ok(hasher.finalize().to_hex().to_string())
}

fn digest_folder(folder: &Path) -> Result<BTreeMap<String, String>> {
    let mut digests = BTreeMap::new();
    for entry in std::fs::read_dir(folder).at("reading", folder)? {
        let entry = entry.at("reading", folder)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if name != MANIFEST && entry.path().is_file() {
            digests.insert(name, digest_file(&entry.path())?);
        }
    }
    Ok(digests)
}

/// Largest resident set since the start or [`reset_peak_memory`], MiB; 0 where the system does not tell.
pub(crate) fn peak_memory_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    line.and_then(|l| l.trim().trim_end_matches(" kB").parse::<f64>().ok()).map_or(0.0, |kib| kib / 1024.0)
}

/// Counts the peak from here on (Linux).
pub(crate) fn reset_peak_memory() {
    // Where that is not allowed the peak stays the earlier one, which is an upper bound.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// Time that all threads have computed since the start, s; 0 where the system does not tell.
pub(crate) fn cpu_time_s() -> f64 {
    /// Linux counts in hundredths of a second.
    const TICKS: f64 = 100.0;
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The second field is the program's name in parentheses; utime and stime are fields 14 and 15.
    let fields = text.rsplit(") ").next().unwrap_or_default().split(' ').skip(11);
    fields.take(2).filter_map(|f| f.parse::<f64>().ok()).sum::<f64>() / TICKS
}

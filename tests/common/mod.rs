//! A copy of the office fixture with settings that run fast, and the programs to run on it.
#![allow(dead_code)]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// Coarse patches and few rays: enough to go through every stage.
const FAST: &str = r#"
extends = "pipeline.toml"

[probe]
width_px = 256

[illuminate]
max_edge_m = 0.5
min_edge_m = 0.2

[irradiance]
spacing_m = 0.5
rays = 512

[transfer]
source_share = 0.7
rays = 2

[render]
antialiasing = 2
shadow_map_px = 64
"#;

/// A capture in a folder of its own.
pub struct Capture {
    folder: TempDir,
}

impl Capture {
    /// Copies the office fixture.
    pub fn office() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        copy(&Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/office"), folder.path());
        std::fs::write(folder.path().join("fast.toml"), FAST).expect("writing fast.toml");
        Self { folder }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn settings(&self) -> PathBuf {
        self.path("fast.toml")
    }

    /// Adds lines to the settings.
    pub fn set(&self, text: &str) {
        std::fs::write(self.settings(), format!("{FAST}{text}")).expect("writing fast.toml");
    }

    /// Replaces a piece of the settings file.
    pub fn replace(&self, file: &str, old: &str, new: &str) {
        let text = std::fs::read_to_string(self.path(file)).expect("reading settings");
        assert!(text.contains(old), "{file} has no {old:?}");
        std::fs::write(self.path(file), text.replacen(old, new, 1)).expect("writing settings");
    }

    /// `insitu run fast.toml ARGUMENTS`.
    pub fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_insitu"));
        command.arg("run").arg(self.settings()).args(arguments).output().expect("starting insitu")
    }

    /// Runs and returns the stages that were not fresh.
    pub fn ran(&self, arguments: &[&str]) -> Vec<String> {
        let output = self.run(arguments);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        stages_run(&output)
    }
}

/// Names of the stages that a run did not find fresh, from its lines.
pub fn stages_run(output: &Output) -> Vec<String> {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    text.lines()
        .filter(|l| !l.starts_with("warning") && !l.trim_end().ends_with(" fresh"))
        .filter_map(|l| l.split_whitespace().next())
        .filter(|name| insitu::stage::find(name).is_some())
        .map(String::from)
        .collect()
}

pub fn copy(from: &Path, to: &Path) {
    for entry in std::fs::read_dir(from).expect("reading a fixture") {
        let entry = entry.expect("reading a fixture");
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            if entry.file_name() != "work" {
                std::fs::create_dir_all(&target).expect("making a folder");
                copy(&entry.path(), &target);
            }
        } else {
            std::fs::copy(entry.path(), &target).expect("copying a fixture");
        }
    }
}

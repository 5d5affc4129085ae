//! How a stage runs: what it may read, what a failure leaves, what makes a result stale.

use insitu::error::Error;
use insitu::printer::{Printer, Verbosity};
use insitu::stage::{self, Input, State, Workspace};
use std::path::Path;

const PRINTER: fn() -> Printer = || Printer::new(Verbosity::Quiet);

fn workspace(folder: &Path) -> Workspace {
    let settings = folder.join("pipeline.toml");
    std::fs::write(&settings, "").unwrap();
    std::fs::write(folder.join("photo.txt"), "one").unwrap();
    Workspace::open(&settings).unwrap()
}

/// A stage that copies a file given by the user.
fn ingest(workspace: &Workspace) {
    let run = stage::run(workspace, "ingest", &PRINTER(), |ctx| {
        let text = std::fs::read(ctx.user_file(Path::new("photo.txt"))?).unwrap();
        std::fs::write(ctx.output("capture.json"), text).unwrap();
        ctx.figure("photographs", 1);
        ctx.warn("a defect");
        Ok(())
    });
    run.unwrap();
}

fn state(workspace: &Workspace) -> State {
    stage::state(workspace, stage::find("ingest").unwrap())
}

#[test]
fn the_manifest_says_how_a_result_was_made() {
    let folder = tempfile::tempdir().unwrap();
    let workspace = workspace(folder.path());
    ingest(&workspace);
    let manifest = workspace.manifest("ingest").unwrap();
    let digest = blake3::hash(b"one").to_hex().to_string();
    assert_eq!(manifest.inputs["photo.txt"], Input::File(digest.clone()));
    assert_eq!(manifest.outputs["capture.json"], digest);
    assert_eq!(
        (manifest.warnings.as_slice(), &manifest.figures["photographs"]),
        (["a defect".to_string()].as_slice(), &1.into())
    );
    assert!(manifest.peak_memory_mib > 0.0);
    assert_eq!(state(&workspace), State::Fresh);
}

#[test]
fn inputs_settings_and_outputs_make_stale() {
    let folder = tempfile::tempdir().unwrap();
    let mut workspace = workspace(folder.path());
    assert_eq!(state(&workspace), State::Missing("never run".into()));
    ingest(&workspace);
    std::fs::write(folder.path().join("photo.txt"), "two").unwrap();
    assert_eq!(state(&workspace), State::Stale("photo.txt changed".into()));
    std::fs::write(folder.path().join("photo.txt"), "one").unwrap();
    std::fs::write(workspace.folder("ingest").join("capture.json"), "other").unwrap();
    assert_eq!(state(&workspace), State::Stale("output capture.json is not as it was written".into()));
    ingest(&workspace);
    workspace.pipeline.ingest.focal_mm = Some(35.0);
    assert_eq!(state(&workspace), State::Stale("setting ingest.focal_mm changed".into()));
}

#[test]
fn settings_of_another_stage_make_stale_the_stages_that_go_by_them() {
    let folder = tempfile::tempdir().unwrap();
    let mut workspace = workspace(folder.path());
    let state = |workspace: &Workspace, name| stage::state(workspace, stage::find(name).unwrap());
    for name in ["merge", "probe", "calibrate"] {
        stage::run(&workspace, name, &PRINTER(), |_| Ok(())).unwrap();
    }
    workspace.pipeline.merge.clip = 0.9;
    workspace.pipeline.response.exposures_from_pixels = false;
    workspace.pipeline.response.samples = 5;
    let merge = "setting merge.clip, response.exposures_from_pixels changed";
    assert_eq!(state(&workspace, "merge"), State::Stale(merge.into()));
    let probe = "setting response.exposures_from_pixels, merge.clip changed";
    assert_eq!(state(&workspace, "probe"), State::Stale(probe.into()));
    assert_eq!(state(&workspace, "calibrate"), State::Fresh);
}

#[test]
fn a_failure_keeps_the_earlier_result() {
    let folder = tempfile::tempdir().unwrap();
    let workspace = workspace(folder.path());
    ingest(&workspace);
    let before = std::fs::read(workspace.folder("ingest").join("stage.json")).unwrap();
    let failed = stage::run(&workspace, "ingest", &PRINTER(), |ctx| {
        std::fs::write(ctx.output("capture.json"), "half").unwrap();
        Err(Error::Bug("made up".into()))
    });
    assert!(failed.is_err());
    assert_eq!(std::fs::read(workspace.folder("ingest").join("stage.json")).unwrap(), before);
    assert_eq!(state(&workspace), State::Fresh);
}

#[test]
fn an_exchange_of_folders_cut_short_is_mended() {
    let folder = tempfile::tempdir().unwrap();
    let workspace = workspace(folder.path());
    ingest(&workspace);
    // What a kill between the two renames leaves.
    std::fs::rename(workspace.folder("ingest"), workspace.work.join(".ingest.old")).unwrap();
    assert_eq!(state(&workspace), State::Fresh);
    assert!(workspace.folder("ingest").join("capture.json").exists());
}

#[test]
fn an_undeclared_read_is_our_fault() {
    let folder = tempfile::tempdir().unwrap();
    let workspace = workspace(folder.path());
    ingest(&workspace);
    let run = stage::run(&workspace, "irradiance", &PRINTER(), |ctx| {
        ctx.artefact("ingest", "capture.json").map(drop)
    });
    let error = run.unwrap_err();
    assert!(error.to_string().contains("without declaring it"), "{error}");
    assert_eq!(error.exit_code(), 3);
}

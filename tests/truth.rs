//! `insitu truth`: true results that the stages after them take for their own.

mod common;

use common::{Capture, stages_run};
use insitu::artefact::json;
use insitu::calibrate::Cameras;
use insitu::evaluate::references::truth_at;
use insitu::illuminate::read_light;
use insitu::image::luminance;
use insitu::model::Scene;
use std::process::{Command, Output};

fn truth(capture: &Capture, stages: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_insitu"));
    command
        .arg("truth")
        .arg(capture.settings())
        .args(["--stages", stages, "--work"])
        .arg(capture.path("true"));
    command.output().unwrap()
}

#[test]
fn true_results_stand_and_what_follows_runs_on_them() {
    let capture = Capture::office();
    let output = truth(&capture, "merge,calibrate,probe,model,illuminate");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(
        stages_run(&output),
        ["ingest", "response", "merge", "calibrate", "probe", "model", "illuminate"]
    );
    assert!(!capture.path("work").exists(), "the usual work folder is left alone");

    let truth_json = truth_at(&capture.path("truth/truth.json")).unwrap();
    let cameras: Cameras = json::read(&capture.path("true/calibrate/cameras.json")).unwrap();
    assert_eq!(cameras.plate_camera(), &truth_json.camera("plate_000.jpg").unwrap());
    let scene: Scene = json::read(&capture.path("true/model/scene.json")).unwrap();
    let scale = truth_json.plate_scale("plate_000.jpg").unwrap();
    let light = read_light(&capture.path("true/illuminate")).unwrap();
    for (name, radiance) in truth_json.emitters().unwrap() {
        let of_lamp = |face: u32| scene.faces[face as usize].name == name;
        let mut patches = light.mesh.patches.iter().filter(|p| of_lamp(p.face)).peekable();
        assert!(patches.peek().is_some(), "{name} has no patch");
        for p in patches {
            let expected = luminance(radiance.map(|v| (v * scale) as f32));
            assert!((luminance(p.radiance) / expected - 1.0).abs() < 1e-5, "{name} shines as it does");
        }
    }

    let work = capture.path("true");
    let work = work.to_str().unwrap();
    assert_eq!(capture.ran(&["--to", "irradiance", "--work", work]), ["irradiance"]);
    // With another truth the results are stale, and made anew.
    capture.replace("truth/truth.json", "\"seed\": 1", "\"seed\": 2");
    let output = truth(&capture, "merge,calibrate");
    assert_eq!(stages_run(&output), ["merge", "calibrate"], "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn what_cannot_be_true_is_refused() {
    let capture = Capture::office();
    let output = truth(&capture, "illuminate");
    assert_eq!(output.status.code(), Some(2));
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(message.contains("true light lies on the faces of the true model"), "{message}");
    capture.replace("pipeline.toml", "truth = \"truth/truth.json\"\n", "");
    let output = truth(&capture, "merge");
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("the settings name no truth"), "{message}");
}

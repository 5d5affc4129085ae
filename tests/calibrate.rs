//! Camera from the plate alone: nothing marked, no grid.

use insitu::artefact::json;
use insitu::calibrate::Cameras;
use nalgebra::{Matrix3, Vector3};
use std::path::Path;

/// Focal length and pose of a fixture's plate by a settings file that names nothing but the plate, with the camera's height.
fn plate_alone(fixture: &str) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(fixture);
    let truth: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(root.join("truth/truth.json")).unwrap()).unwrap();
    let images = truth["images"].as_array().unwrap();
    let plate = images.iter().find(|image| image["file"] == "plate_000.jpg").unwrap();
    let number = |v: &serde_json::Value| v.as_f64().unwrap();
    // Theirs: z up, Xc = R Xw + t.
    let rotation = Matrix3::from_fn(|r, c| number(&plate["R"][r][c]));
    let shift = Vector3::from_fn(|r, _| number(&plate["t"][r]));
    let height_m = -(rotation.transpose() * shift).z;

    let folder = tempfile::tempdir().unwrap();
    let photos = root.join("photos");
    std::fs::write(
        folder.path().join("pipeline.toml"),
        format!(
            "[ingest]\nphotos = {photos:?}\n[ingest.roles]\nplate = [\"plate_000.jpg\"]\n\
             [calibrate]\npose = \"vanishing_lines\"\ncamera_height_m = {height_m}\n"
        ),
    )
    .unwrap();
    for stage in [env!("CARGO_BIN_EXE_insitu-ingest"), env!("CARGO_BIN_EXE_insitu-calibrate")] {
        assert_cmd::Command::new(stage).current_dir(folder.path()).assert().success();
    }
    let cameras: Cameras = json::read(&folder.path().join("work/calibrate/cameras.json")).unwrap();
    let camera = cameras.plate_camera();
    let focal = number(&truth["intrinsics"]["fx"]);
    let error = camera.intrinsics.focal_px[0] / focal - 1.0;
    assert!(error.abs() < 0.03, "{fixture}: focal length {:+.2} %", 100.0 * error);
    let up = camera.world_from_camera.inverse() * Vector3::y();
    let off = up.angle(&(rotation * Vector3::z())).to_degrees();
    assert!(off < 0.5, "{fixture}: the vertical is {off:.2}° off");
    assert!((camera.centre().y - height_m).abs() < 1e-6, "{fixture}: {}", camera.centre());
}

#[test]
fn a_room_calibrates_its_camera() {
    plate_alone("office");
}

#[test]
fn a_room_lit_by_a_lamp_does_too() {
    plate_alone("tablelamp");
}

#[test]
fn a_wall_and_boxes_outdoors_do_too() {
    plate_alone("sunlit");
}

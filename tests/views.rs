//! Photographs whose names tell nothing: roles by what they show.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

/// The office's photographs, under numbers in a scrambled order.
#[test]
fn a_mixed_folder_is_sorted_by_content() {
    let photos = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/office/photos");
    let folder = tempfile::tempdir().unwrap();
    let mut names: Vec<String> = std::fs::read_dir(&photos)
        .unwrap()
        .map(|e| e.unwrap().file_name().to_string_lossy().into_owned())
        .filter(|n| n.ends_with(".jpg") && !n.starts_with("plate_001"))
        .collect();
    names.sort();
    let mut was = BTreeMap::new();
    for (i, name) in names.iter().enumerate() {
        let new = format!("DSC_{:04}.JPG", 1000 + i * 37 % names.len());
        std::fs::copy(photos.join(name), folder.path().join(&new)).unwrap();
        was.insert(new, name.clone());
    }
    assert_eq!(was.len(), names.len(), "numbers are used once");
    let output = Command::new(env!("CARGO_BIN_EXE_insitu"))
        .args(["--quiet", "new"])
        .arg(folder.path())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = std::fs::read_to_string(folder.path().join("pipeline.toml")).unwrap();
    let settings: toml::Table = text.parse().unwrap();
    let with_role = |role: &str| {
        let files = settings["ingest"]["roles"][role].as_array().unwrap();
        let mut files: Vec<&str> = files.iter().map(|f| was[f.as_str().unwrap()].as_str()).collect();
        files.sort_unstable();
        files
    };
    let named =
        |start: &str| names.iter().map(String::as_str).filter(|n| n.starts_with(start)).collect::<Vec<_>>();
    assert_eq!(with_role("probe"), named("probe_"));
    assert_eq!(with_role("plate_with_grid"), named("grid_with_probe"));
    assert_eq!(with_role("grid"), named("calib_"));
    // The brightest bracket is white all over, and no date says what it was taken with. The plate is one more bracket: which
    // of the two of one exposure is the plate, nothing tells.
    let brackets: Vec<&str> =
        named("brackets_").into_iter().filter(|n| !n.starts_with("brackets_06")).collect();
    let mut place = with_role("brackets");
    place.extend(with_role("plate"));
    place.sort_unstable();
    assert_eq!(place, [brackets, named("plate_")].concat());
}

//! Whole captures from their photographs alone, held to the bounds they state, by the program that users run.

mod common;

use std::path::Path;
use std::process::Command;

#[test]
fn every_fixture_keeps_its_bounds() {
    let folder = tempfile::tempdir().unwrap();
    common::copy(&Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures"), folder.path());
    let output =
        Command::new(env!("CARGO_BIN_EXE_insitu")).arg("validate").arg(folder.path()).output().unwrap();
    let table = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{table}\n{errors}");
    for capture in ["office", "office/raised", "tablelamp", "tablelamp/raised", "sunlit", "sunlit/raised"] {
        let row = table.lines().find(|l| l.split_whitespace().next() == Some(capture));
        let row = row.unwrap_or_else(|| panic!("no row for {capture} in\n{table}"));
        assert!(row.ends_with("passed"), "{row}");
    }

    // A bound that cannot be kept must fail, or the table would mean nothing.
    let settings = folder.path().join("office/raised.toml");
    let text = std::fs::read_to_string(&settings).unwrap();
    std::fs::write(&settings, text + "\n[evaluate.bounds]\nrelative_shadow_error = 0.0001\n").unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_insitu"))
        .arg("validate")
        .arg(folder.path().join("office"))
        .output()
        .unwrap();
    let table = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(1), "{table}");
    assert!(table.lines().any(|l| l.starts_with("office/raised") && l.ends_with("FAILED")), "{table}");
}

//! Whatever goes wrong, earlier results stay; what can be done in spite of a defect is done.

use super::cases::{case, check, results, run, said, spoilt};
use super::spoil::Spoil::{self, *};
use std::path::Path;
use std::process::Command;

#[test]
fn nothing_is_lost_where_nothing_can_be_written() {
    check(&[
        case(
            "work below a file",
            &[Write("case.toml", "extends = \"pipeline.toml\"\nwork = \"object.obj/work\"\n")],
            "ingest",
            1,
            "making the work folder: ./object.obj/work/.ingest.part: Not a directory (os error 20)",
            "choose a writable folder with `work`",
        ),
        case(
            "work is a file",
            &[Write("case.toml", "extends = \"pipeline.toml\"\nwork = \"object.obj\"\n")],
            "ingest",
            1,
            "making the work folder: ./object.obj/.ingest.part: Not a directory (os error 20)",
            "choose a writable folder with `work`",
        ),
    ]);
}

/// Runs a stage that must succeed, with this warning.
fn warned(spoils: &[Spoil], program: &str, warning: &str) {
    let folder = spoilt(spoils);
    let output = run(folder.path(), program);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && text.contains(warning), "{program}: {text}");
}

#[test]
fn what_can_be_done_in_spite_of_a_defect_is_done_with_a_warning() {
    const OBJECT: Spoil =
        Set("[render]\nobject = \"o.obj\"\nantialiasing = 1\nshading_rays = 16\nposition_m = [0.1, 0, 0]\n");
    // Three triangles on one edge, and one turned the other way.
    let fan = "v 0 0 0\nv 0 0 0.1\nv 0.1 0 0\nv 0 0.1 0\nv -0.1 0 0\nf 1 2 3\nf 1 2 4\nf 1 2 5\n";
    warned(
        &[Write("o.obj", fan), OBJECT],
        "render",
        "1 edges join more than two triangles; the mesh is used as it is",
    );
    let sliver = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 3\nf 1 2 4\nf 1 1 2\nf 1 3 4\n";
    warned(&[Write("o.obj", sliver), OBJECT], "render", "1 of 4 triangles have no area and were left out");
    let equal = "[ingest]\nexposure = [{ file = \"brackets_00.jpg\", time_s = 0.1 }, { file = \"brackets_01.jpg\", time_s = 0.1 }]\n";
    warned(
        &[Set(equal)],
        "ingest",
        "brackets_00.jpg and brackets_01.jpg (brackets) have equal exposures: they are averaged",
    );
}

#[test]
fn marks_that_appear_or_go_make_results_stale() {
    let folder = spoilt(&[]);
    let of = |stage: &str| {
        let output = run(folder.path(), "insitu status fast.toml");
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        text.lines().find(|l| l.starts_with(stage)).map(str::to_string).unwrap_or_default()
    };
    assert_eq!(of("calibrate"), "calibrate   fresh");
    Remove("annotations.toml").apply(folder.path());
    assert_eq!(of("calibrate"), "calibrate   stale    annotations.toml cannot be read any more");
    assert!(run(folder.path(), "insitu run fast.toml --from calibrate --to calibrate").status.success());
    assert_eq!(of("calibrate"), "calibrate   fresh");
    Write("annotations.toml", "").apply(folder.path());
    assert_eq!(of("calibrate"), "calibrate   stale    annotations.toml is there now");
}

/// A limit on the size of files stands for a full disk.
#[cfg(unix)]
#[test]
fn a_full_disk_leaves_earlier_results_whole() {
    for (stage, error) in [
        ("merge", "writing: ./work/.merge.part/plate.exr: File too large (os error 27)"),
        ("transfer", "writing: ./work/.transfer.part/sources.npy: File too large (os error 27)"),
        ("irradiance", "writing: ./work/.irradiance.part/irradiance.ply: File too large (os error 27)"),
        ("composite", "writing: ./work/.composite.part/augmented.exr: File too large (os error 27)"),
    ] {
        let folder = spoilt(&[]);
        let before = results(folder.path());
        let program = Path::new(env!("CARGO_BIN_EXE_insitu")).with_file_name(format!("insitu-{stage}"));
        let script = format!("trap '' XFSZ; ulimit -f 8; exec {} fast.toml", program.display());
        let output = Command::new("bash").args(["-c", &script]).current_dir(folder.path()).output();
        let output = output.expect("starting bash");
        assert_eq!(said(&output), [error, "free some disk space, then run again: earlier results are kept"]);
        assert_eq!(output.status.code(), Some(1));
        assert_eq!(results(folder.path()), before, "{stage}");
    }
}

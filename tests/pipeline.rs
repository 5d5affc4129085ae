//! The driver on a whole capture: what reruns, what does not, and what a killed stage leaves.

mod common;

use common::{Capture, stages_run};
use insitu::stage::STAGES;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

fn names_from(first: &str) -> Vec<String> {
    STAGES.iter().skip_while(|s| s.name != first).map(|s| s.name.to_string()).collect()
}

/// One capture goes through all of it, since a first run is what costs time.
#[test]
fn only_what_changed_reruns() {
    let capture = Capture::office();
    assert_eq!(capture.ran(&[]), names_from("ingest"), "a first run does everything");
    for product in
        ["composite/augmented.png", "composite/augmented.exr", "evaluate/report.html", "model/scene.glb"]
    {
        assert!(capture.path("work").join(product).exists(), "{product} is missing");
    }
    assert_eq!(capture.ran(&[]), Vec::<String>::new(), "a second run does nothing");

    let status =
        Command::new(env!("CARGO_BIN_EXE_insitu")).arg("status").arg(capture.settings()).output().unwrap();
    let text = String::from_utf8_lossy(&status.stdout).into_owned();
    assert_eq!(text.matches(" fresh").count(), STAGES.len(), "{text}");

    capture.set("position_m = [0.1, 0.1, -0.002]\n");
    let status =
        Command::new(env!("CARGO_BIN_EXE_insitu")).arg("status").arg(capture.settings()).output().unwrap();
    let text = String::from_utf8_lossy(&status.stdout).into_owned();
    assert!(text.contains("render      stale    setting render.position_m changed"), "{text}");
    assert!(text.contains("composite   stale    waits for render"), "{text}");
    assert_eq!(capture.ran(&[]), names_from("render"), "moving the object reruns render onward");

    let photo = capture.path("photos/probe_05.jpg");
    let mut picture = image::open(&photo).unwrap().to_rgb8();
    picture.put_pixel(3, 3, image::Rgb([9, 9, 9]));
    rewrite_jpeg(&photo, &picture);
    assert_eq!(capture.ran(&[]), names_from("probe"), "a changed probe photograph reruns probe onward");

    std::fs::write(capture.path("work/irradiance/irradiance.ply"), "cut short").unwrap();
    assert_eq!(capture.ran(&[])[0], "irradiance", "a spoilt output is made anew");

    assert_eq!(capture.ran(&["--force", "--from", "composite", "--to", "composite"]), ["composite"]);

    let place = "position_m = [0.1, 0.1, -0.002]";
    let path = "[{ position_m = [0.1, 0.1, -0.002] }, { position_m = [0.2, 0.0, 0.1], rotation_deg = 40.0 }]";
    capture.set(&format!("{place}\nrotation_deg = 0.0\npath = {path}\n"));
    assert_eq!(capture.ran(&["--to", "composite"]), ["render", "composite"]);
    let picture = |name: &str| image::open(capture.path("work/composite").join(name)).unwrap().to_rgb8();
    let (still, first, second) =
        (picture("augmented.png"), picture("frame_0000.png"), picture("frame_0001.png"));
    let difference = |a: &image::RgbImage, b: &image::RgbImage| {
        let sum: u64 = a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        sum as f64 / a.as_raw().len() as f64
    };
    assert!(difference(&still, &first) < 0.02, "the first pose is where the object stands");
    assert!(difference(&still, &second) > 0.2, "the second is not");
}

/// New pixels under the photograph's own header.
fn rewrite_jpeg(path: &Path, picture: &image::RgbImage) {
    let old = std::fs::read(path).unwrap();
    let mut new = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut new, 95).encode_image(picture).unwrap();
    // Segments FFE1 of the old file (EXIF) go behind the start marker of the new one.
    let mut at = 2;
    let mut exif = Vec::new();
    while old[at] == 0xff && old[at + 1] != 0xda {
        let length = 2 + usize::from(u16::from_be_bytes([old[at + 2], old[at + 3]]));
        if old[at + 1] == 0xe1 {
            exif.extend_from_slice(&old[at..at + length]);
        }
        at += length;
    }
    let whole = [&new[..2], &exif, &new[2..]].concat();
    std::fs::write(path, whole).unwrap();
}

#[test]
fn a_killed_stage_leaves_the_earlier_result() {
    let capture = Capture::office();
    capture.ran(&["--to", "illuminate"]);
    let manifest = capture.path("work/illuminate/stage.json");
    let before = std::fs::read(&manifest).unwrap();

    // Patches so small that the stage is still at work when it is killed.
    capture.replace(
        "fast.toml",
        "max_edge_m = 0.5\nmin_edge_m = 0.2",
        "max_edge_m = 0.04\nmin_edge_m = 0.02",
    );
    let mut run = Command::new(env!("CARGO_BIN_EXE_insitu"))
        .args(["run", "--force", "--from", "illuminate", "--to", "illuminate"])
        .arg(capture.settings())
        .process_group(0)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let part = capture.path("work/.illuminate.part");
    while !part.exists() {
        std::thread::sleep(Duration::from_millis(2));
        assert!(run.try_wait().unwrap().is_none(), "the stage ended before it could be killed");
    }
    // The whole group: driver and stage. The shell's own kill needs no package.
    Command::new("sh").arg("-c").arg(format!("kill -s KILL -- -{}", run.id())).status().unwrap();
    run.wait().unwrap();

    assert!(part.exists(), "the killed stage had begun to write");
    assert_eq!(std::fs::read(&manifest).unwrap(), before, "the earlier result is whole");
    capture.replace(
        "fast.toml",
        "max_edge_m = 0.04\nmin_edge_m = 0.02",
        "max_edge_m = 0.5\nmin_edge_m = 0.2",
    );
    let output = capture.run(&["--to", "irradiance"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(stages_run(&output), ["irradiance"], "the earlier result still stands");
    assert_eq!(capture.ran(&["--force", "--from", "illuminate", "--to", "illuminate"]), ["illuminate"]);
    assert!(!part.exists());
}

//! `scene.glb` as Blender opens it: where its camera sees the scene's corners, against where ours does.

use crate::camera::Camera;
use crate::error::{Error, FileContext, Result};
use crate::model::gltf::{self, OPEN_IN_BLENDER, View};
use crate::model::{Face, FittedPrimitive, Scene};
use crate::printer::Printer;
use crate::synthetic;
use nalgebra::Point3;
use std::path::Path;
use std::process::Command;

/// The program.
const BLENDER: &str = "blender";
/// Run in it.
const SCRIPT: &str = include_str!("blender_vertices.py");

/// Prints the largest distance for pictures of several shapes.
pub(super) fn print(printer: &Printer) -> Result<()> {
    printer.data("\nscene.glb opened in Blender by open_in_blender.py: largest distance of a corner from where our camera sees it");
    if Command::new(BLENDER).arg("--version").output().is_err() {
        printer.data("Blender is not installed (apt-get install blender): left out");
        return Ok(());
    }
    let lens = |width, height| synthetic::camera([-1.2, 1.4, 2.2], [0.2, 0.3, -0.6], width, height, 700.0);
    let mut cropped = lens(640, 480);
    // The lower left of a larger picture.
    cropped.intrinsics.principal_point_px = [520.0, 90.0];
    let mut shifted = lens(480, 640);
    shifted.intrinsics.principal_point_px = [263.5, 289.0];
    let mut oblong = lens(640, 480);
    oblong.intrinsics.focal_px = [700.0, 560.0];
    for (name, camera) in [
        ("landscape", lens(640, 480)),
        ("portrait", lens(480, 640)),
        ("cropped", cropped),
        ("portrait, principal point off the middle", shifted),
        ("pixels a quarter higher than wide", oblong),
    ] {
        printer.data(&format!("{name:<42}{:>10.4} px", worst(&camera)?));
    }
    Ok(())
}

/// A box and a wall.
fn scene() -> Scene {
    let quad = |name: &str, corners: [[f64; 3]; 4]| Face {
        name: name.into(),
        vertices: corners.map(Point3::from).to_vec(),
        gloss: None,
    };
    let faces = vec![
        quad("box.front", [[-0.3, 0.0, 0.2], [0.4, 0.0, 0.2], [0.4, 0.5, 0.2], [-0.3, 0.5, 0.2]]),
        quad("box.top", [[-0.3, 0.5, 0.2], [0.4, 0.5, 0.2], [0.4, 0.5, -0.4], [-0.3, 0.5, -0.4]]),
        quad("wall", [[-1.5, 0.0, -1.5], [1.8, 0.0, -1.5], [1.8, 2.0, -1.5], [-1.5, 2.0, -1.5]]),
    ];
    let primitive = |name: &str| FittedPrimitive {
        name: name.into(),
        kind: crate::annotations::Kind::Quad,
        parent: None,
        size_m: vec![],
        size_sigma_m: vec![],
        corner_sigma_m: 0.0,
        marks: 0,
        rms_px: 0.0,
        faces: Vec::new(),
    };
    Scene { primitives: vec![primitive("box"), primitive("wall")], faces, rms_px: 0.0 }
}

fn worst(camera: &Camera) -> Result<f64> {
    let folder = tempfile::tempdir().at("making a folder for Blender", Path::new("."))?;
    let file = |name: &str| folder.path().join(name);
    let write =
        |name: &str, text: &str| std::fs::write(file(name), text).at("writing for Blender", &file(name));
    let scene = scene();
    gltf::write(&file("scene.glb"), &scene, &[View { name: "plate", camera, picture: None }], &[])?;
    write("open_in_blender.py", OPEN_IN_BLENDER)?;
    write("blender_vertices.py", SCRIPT)?;
    let corners: Vec<Point3<f64>> = scene.faces.iter().flat_map(|f| f.vertices.clone()).collect();
    let points: Vec<[f64; 3]> = corners.iter().map(|p| [p.x, p.y, p.z]).collect();
    write("points.json", &serde_json::to_string(&points).map_err(|e| Error::Bug(e.to_string()))?)?;
    let run = Command::new(BLENDER)
        .args(["-b", "-P"])
        .arg(file("blender_vertices.py"))
        .arg("--")
        .arg(folder.path())
        .output()
        .at("running Blender", &file("blender_vertices.py"))?;
    let read = std::fs::read_to_string(file("seen.json")).ok();
    let seen =
        read.and_then(|text| serde_json::from_str::<serde_json::Value>(&text).ok()).ok_or_else(|| {
            let said = String::from_utf8_lossy(&run.stderr);
            let last = said.lines().last().unwrap_or("nothing").to_string();
            Error::file(
                "opening a scene in Blender",
                &file("scene.glb"),
                format!("gave no result; it said: {last}"),
                "run Blender by hand",
            )
        })?;
    let numbers = |key: &str| -> Vec<Vec<f64>> {
        let rows = seen[key].as_array().cloned().unwrap_or_default();
        rows.iter().map(|r| r.as_array().into_iter().flatten().filter_map(|v| v.as_f64()).collect()).collect()
    };
    let mut worst: f64 = 0.0;
    for (corner, there) in corners.iter().zip(numbers("seen")) {
        let here = camera.project(corner).ok_or_else(|| Error::Bug("a corner behind the camera".into()))?;
        worst = worst.max((here.x - there[0]).hypot(here.y - there[1]));
    }
    // What was imported stands where it should.
    for there in numbers("corners") {
        let at = Point3::new(there[0], there[1], there[2]);
        let nearest = corners.iter().map(|c| (c - at).norm()).fold(f64::INFINITY, f64::min);
        worst = worst.max(nearest * camera.intrinsics.focal_px[0] / (at - camera.centre()).norm());
    }
    Ok(worst)
}

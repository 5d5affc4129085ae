//! Rooms found in plates without a mark, against the true ones.

use super::breakdown::true_workspace_to;
use super::model::{extent, shell};
use super::truth::has_truth;
use crate::annotations::Annotations;
use crate::artefact::json;
use crate::calibrate::Cameras;
use crate::camera::Camera;
use crate::config;
use crate::driver::run::Range;
use crate::driver::truth::TrueStage;
use crate::driver::validate;
use crate::error::{Context as _, Result};
use crate::evaluate::references::truth_at;
use crate::exposure::{Capture, decode};
use crate::model::{self, Face, FaceSource, Scene, Views, room};
use crate::printer::Printer;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const DOING: &str = "finding the room in a plate";

/// Prints the table: the plate with the camera that calibrate found, and the second place of each capture with the true one.
pub(super) fn print(settings: &[PathBuf], printer: &Printer) -> Result<()> {
    printer.data("\nrooms found in plates without a mark: distance of faces from the camera, m; error in % of the room's longest side");
    printer.data(&format!(
        "{:<12}{:<16}{:<10}{:>8}{:>8}{:>8}{:>8}",
        "capture", "plate", "face", "true", "found", "± σ", "error"
    ));
    for file in settings {
        if !has_truth(file)? {
            continue;
        }
        let range = Range { to: Some("calibrate".into()), ..Range::default() };
        let workspace = true_workspace_to(file, "all", &TrueStage::ALL, &range)?;
        let capture: Capture = json::read(&workspace.folder("ingest").join("capture.json"))?;
        let cameras: Cameras = json::read(&workspace.folder("calibrate").join("cameras.json"))?;
        let path = workspace.base.join(workspace.pipeline.evaluate.truth.clone().unwrap_or_default());
        let truth = truth_at(&path)?;
        let scene = truth.scene().doing(DOING)?;
        let ground_y = -workspace.pipeline.calibrate.thickness_m;
        let second = truth.camera(SECOND).doing(DOING)?;
        for (plate, camera) in [(cameras.plate.as_str(), cameras.plate_camera()), (SECOND, &second)] {
            let photograph = workspace.base.join(&capture.photos).join(plate);
            let head = format!("{:<12}{plate:<16}", validate::name(file));
            for line in judged(&photograph, camera, ground_y, &workspace.pipeline.model, &scene)? {
                printer.data(&format!("{head}{line}"));
            }
        }
    }
    Ok(())
}

/// The plate's second place in rendered captures.
const SECOND: &str = "plate_001.jpg";

/// A line for each face, or why there is none.
fn judged(
    plate: &Path,
    camera: &Camera,
    ground_y: f64,
    settings: &config::Model,
    truth: &Scene,
) -> Result<Vec<String>> {
    let text = "[[primitive]]\nname = \"room\"\nkind = \"room\"\nyaw = \"free\"\nsearch = true\n";
    let wanted: Annotations = config::parse(text, Path::new("annotations.toml"))?;
    let searched =
        room::searched(&wanted.primitive, ("plate", camera), || decode(plate), ground_y, settings)?;
    let (primitives, rooms) = match searched {
        Ok(found) => found,
        Err(problem) => return Ok(vec![problem.to_string()]),
    };
    let cameras = BTreeMap::from([("plate".to_string(), camera.clone())]);
    let views = Views { cameras: &cameras, ball: None, ground_y, rooms: &rooms };
    let scene = model::fit(&primitives, &views, settings).doing(DOING)?;
    let mut lines = Vec::new();
    for face in scene.primitives.iter().flat_map(|p| &p.faces) {
        let named = |f: &&Face| f.name.ends_with(&format!(".{}", face.side));
        let Some(own) = scene.faces.iter().find(named) else { continue };
        let cosine = |f: &Face| f.normal().dot(&own.normal());
        let shells = truth.faces.iter().filter(|f| shell(&f.name));
        let there = shells.max_by(|a, b| cosine(a).total_cmp(&cosine(b)));
        let distance = there.map(|f| (camera.centre() - f.vertices[0]).dot(&f.normal()));
        let error = distance.map(|d| 100.0 * (face.distance_m - d) / extent(truth));
        let told = match face.source {
            FaceSource::Presumed => "  presumed".to_string(),
            _ => error.map_or("  outdoors".into(), |e| format!("{e:>+8.2}")),
        };
        lines.push(format!(
            "{:<10}{:>8.3}{:>8.3}{:>8.3}{told}",
            face.side,
            distance.unwrap_or(f64::NAN),
            face.distance_m,
            face.sigma_m
        ));
    }
    Ok(lines)
}

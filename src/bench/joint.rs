//! Cameras and primitives in one solution against cameras found before the primitives, by a capture's truth: with the lens from
//! photographs of the grid, and with none of these, from marked lines and EXIF.

use super::model::{corner_errors, extent};
use super::truth::has_truth;
use crate::annotations::Annotations;
use crate::artefact::json;
use crate::calibrate::joint::{self, Found, Scene};
use crate::calibrate::{Evidence, grey_of};
use crate::camera::Camera;
use crate::config::{self, Role};
use crate::driver::validate;
use crate::error::{Context as _, Result};
use crate::evaluate::references::truth_at;
use crate::exposure::{Capture, Photo, decode};
use crate::image::Image;
use crate::model::{Fitter, Views, sight::Ball};
use crate::printer::Printer;
use crate::probe::ProbeFit;
use crate::stage::Workspace;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Prints the table.
pub(super) fn print(settings: &[PathBuf], printer: &Printer) -> Result<()> {
    printer.data(
        "\ncameras found before the primitives (alone) and together with them (joint); errors of the plate's focal length (%), position (%",
    );
    printer.data(
        "of its distance) and direction (°), of those of a further photograph without grid; corners as above",
    );
    printer.data(&format!(
        "{:<12}{:<8}{:<8}{:>8}{:>10}{:>10}{:>12}{:>8}{:>18}{:>8}",
        "capture",
        "lens",
        "cameras",
        "focal",
        "position",
        "rotation",
        "further",
        "",
        "corners, worst",
        "median"
    ));
    for file in settings {
        let own = file.file_name().is_some_and(|n| n == "pipeline.toml");
        if own && has_truth(file)? {
            capture(file, printer)?;
        }
    }
    Ok(())
}

fn capture(file: &Path, printer: &Printer) -> Result<()> {
    let workspace = Workspace::open(file)?;
    let folder = workspace.base.join(&workspace.pipeline.ingest.photos);
    let capture: Capture = json::read(&workspace.folder("ingest").join("capture.json"))?;
    let probe: ProbeFit = json::read(&workspace.folder("probe").join("probe.json"))?;
    let annotations = Annotations::read(&workspace.base.join(&workspace.pipeline.annotations))?;
    let path = workspace.base.join(workspace.pipeline.evaluate.truth.clone().unwrap_or_default());
    let truth = truth_at(&path)?;
    let doing = || format!("reading the truth of {}", validate::name(file));
    let true_scene = truth.scene().doing(doing())?;
    let plate = capture.plate()?;
    let greys = |role| -> Result<Vec<(String, Image<u8>)>> {
        let photos = capture.with_role(role);
        photos.map(|p| Ok((p.file.clone(), grey_of(&decode(&folder.join(&p.file))?)))).collect()
    };
    let (grids, plate_grids) = (greys(Role::Grid)?, greys(Role::PlateWithGrid)?);
    let here: Vec<String> = std::iter::once(plate)
        .chain(capture.with_role(Role::PlateWithGrid))
        .map(|p: &Photo| p.file.clone())
        .collect();
    let others = capture.with_role(Role::Plate).map(|p| p.file.clone()).filter(|f| *f != plate.file);
    let scene = Scene {
        primitives: &annotations.primitive,
        ground_y: -workspace.pipeline.calibrate.thickness_m,
        settings: &workspace.pipeline.model,
        here: &here,
        others: &others.collect::<Vec<_>>(),
    };
    for (lens, grids) in [("grid", &grids[..]), ("lines", &[])] {
        for (cameras, together) in [("alone", false), ("joint", true)] {
            let evidence = Evidence {
                width_px: plate.width_px,
                height_px: plate.height_px,
                grids,
                plate_grids: &plate_grids,
                stated_focal_px: capture.approximate_focal_px(plate),
                lines: annotations.vanishing_lines.as_ref(),
                plate: None,
            };
            let settings = config::Calibrate { joint: together, ..workspace.pipeline.calibrate.clone() };
            let found = joint::solve(&evidence, &settings, &scene).doing("finding cameras")?;
            let [focal, position, rotation] =
                errors(&found.solution.plate.camera, &truth.camera(&plate.file).doing(doing())?);
            let further = match found.others.iter().next() {
                Some((file, posed)) => {
                    let [_, position, rotation] = errors(&posed.camera, &truth.camera(file).doing(doing())?);
                    [format!("{position:.3}"), format!("{rotation:.3}")]
                }
                None => ["-", "-"].map(String::from),
            };
            let corners = corner_errors(&modelled(&found, &scene, &here, &capture, &probe)?, &true_scene);
            let percent = |k: usize| 100.0 * corners.get(k).map_or(f64::NAN, |e| e.0) / extent(&true_scene);
            let (worst, median) = (percent(corners.len().saturating_sub(1)), percent(corners.len() / 2));
            printer.data(&format!(
                "{:<12}{lens:<8}{cameras:<8}{focal:>+8.3}{position:>10.3}{rotation:>10.3}{:>12}{:>8}{worst:>18.2}{median:>8.2}  {}",
                validate::name(file),
                further[0],
                further[1],
                corners.last().map_or("", |c| &c.1)
            ));
            for warning in found.solution.warnings.iter().filter(|w| w.contains("mark") && w.contains("px")) {
                printer.data(&format!("{:<28}{warning}", ""));
            }
        }
    }
    Ok(())
}

/// Focal length and position, %, direction, degrees.
fn errors(found: &Camera, truth: &Camera) -> [f64; 3] {
    let (a, b) = (&found.world_from_camera, &truth.world_from_camera);
    [
        100.0 * (found.intrinsics.focal_px[0] / truth.intrinsics.focal_px[0] - 1.0),
        100.0 * (found.centre() - truth.centre()).norm() / truth.centre().coords.norm(),
        a.rotation.angle_to(&b.rotation).to_degrees(),
    ]
}

/// The scene as the stage `model` has it by these cameras; marks in photographs without a pose are left out.
fn modelled(
    found: &Found,
    scene: &Scene,
    here: &[String],
    capture: &Capture,
    probe: &ProbeFit,
) -> Result<crate::model::Scene> {
    let plate = &found.solution.plate.camera;
    let mut cameras: BTreeMap<String, Camera> = here.iter().map(|f| (f.clone(), plate.clone())).collect();
    cameras.extend(found.others.iter().map(|(f, posed)| (f.clone(), posed.camera.clone())));
    cameras.extend(capture.with_role(Role::Probe).map(|p| (p.file.clone(), probe.camera.clone())));
    let mut primitives = scene.primitives.to_vec();
    primitives.iter_mut().for_each(|p| p.marks.retain(|m| cameras.contains_key(&m.image)));
    let ball = Some(Ball { centre: probe.centre, radius_m: probe.radius_m });
    let views = Views { cameras: &cameras, ball, ground_y: scene.ground_y, rooms: &[] };
    let doing = "fitting the scene";
    Fitter::new(&primitives, &views, scene.settings).doing(doing)?.scene().doing(doing)
}

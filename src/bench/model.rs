//! The scene model: how fast a marked scene is solved, at first and as a mark is dragged, and how far its corners lie from the
//! true scene's; cameras with and without it are in [`super::joint`].

use super::breakdown::true_workspace_to;
use super::spread;
use super::truth::has_truth;
use crate::annotations::{Annotations, Kind, Mark, Primitive};
use crate::artefact::json;
use crate::camera::Camera;
use crate::config;
use crate::driver::run::Range;
use crate::driver::truth::TrueStage;
use crate::driver::validate;
use crate::error::{Context as _, Result};
use crate::evaluate::references::truth_at;
use crate::model::{Fitter, Scene, Views};
use crate::printer::Printer;
use nalgebra::Point3;
use rand::{Rng, SeedableRng, rngs::SmallRng};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Primitives of the scenes that are timed.
const COUNTS: [usize; 4] = [10, 20, 30, 60];
/// Moves of a mark for each.
const DRAGS: usize = 200;

/// Prints these tables, and that of cameras and primitives in one solution; all but the first for captures that have a truth.
pub(super) fn print(settings: &[PathBuf], printer: &Printer) -> Result<()> {
    printer.data(
        "\na synthetic room with boxes on boxes, all their corners marked with 1 px of noise; times in ms",
    );
    printer.data(&format!(
        "{:>10}{:>12}{:>8}{:>12}{:>10}{:>10}{:>10}",
        "primitives", "parameters", "marks", "first fit", "a drag", "least", "most"
    ));
    for count in COUNTS {
        printer.data(&timed(count)?);
    }
    printer.data("\ndistance of the corners of modelled primitives from the nearest true corner, % of the room's longest side;");
    printer.data(
        "camera and probe true or ours; spheres and grounds, which are modelled otherwise, are left out",
    );
    let head = format!(
        "{:<12}{:>12}{:>10}{:>12}{:>10}  {}",
        "capture", "true, worst", "median", "ours, worst", "median", "worst"
    );
    printer.data(&head);
    for file in settings {
        if has_truth(file)? {
            printer.data(&judged(file)?);
        }
    }
    super::joint::print(settings, printer)
}

fn timed(count: usize) -> Result<String> {
    let (primitives, cameras) = crowded(count)?;
    let views = Views { cameras: &cameras, ball: None, ground_y: 0.0, rooms: &[] };
    let settings = config::Model::default();
    let doing = "fitting a synthetic scene";
    let started = Instant::now();
    let mut fitter = Fitter::new(&primitives, &views, &settings).doing(doing)?;
    let scene = fitter.scene().doing(doing)?;
    let first = started.elapsed().as_secs_f64() * 1e3;
    let mut times = Vec::with_capacity(DRAGS);
    for i in 0..DRAGS {
        // A mark of each primitive in turn, carried around a circle of three pixels.
        let primitive = &primitives[i % primitives.len()];
        let mark = i % primitive.marks.len();
        let (sin, cos) = (i as f64 * 0.7).sin_cos();
        let [x, y] = primitive.marks[mark].at;
        let started = Instant::now();
        fitter.drag(&primitive.name, mark, [x + 3.0 * cos, y + 3.0 * sin]);
        times.push(started.elapsed().as_secs_f64() * 1e3);
        fitter.drag(&primitive.name, mark, [x, y]);
    }
    let [middle, least, most] = spread(&mut times);
    let marks: usize = scene.primitives.iter().map(|p| p.marks).sum();
    Ok(format!(
        "{count:>10}{:>12}{marks:>8}{first:>12.1}{middle:>10.2}{least:>10.2}{most:>10.2}",
        fitter.parameters()
    ))
}

/// A room with `count` primitives in all, boxes in rows on its floor and one on each, and two cameras.
fn crowded(count: usize) -> Result<(Vec<Primitive>, BTreeMap<String, Camera>)> {
    let cameras = BTreeMap::from([
        ("a".to_string(), crate::synthetic::camera([-2.5, 2.3, 3.4], [0.0, 0.4, -1.0], 1600, 1200, 1100.0)),
        ("b".to_string(), crate::synthetic::camera([2.4, 2.2, 3.4], [0.0, 0.4, -1.0], 1600, 1200, 1100.0)),
    ]);
    let mut rng = SmallRng::seed_from_u64(7);
    let mut all = vec![named("room", "room", None)?];
    // Its front is behind the cameras.
    all[0].size_m = vec![0.0, 0.0, 8.0];
    // Middle of the bottom and size, m.
    let mut places: Vec<([f64; 3], [f64; 3])> = vec![([0.0, 0.0, -0.5], [6.0, 2.6, 8.0])];
    for k in 0..count - 1 {
        let (stand, on) = (k / 2, k % 2 == 1);
        if on {
            let (at, size) = places[places.len() - 1];
            let small = [0.5 * size[0], 0.12, 0.6 * size[2]];
            places.push(([at[0] + 0.04, at[1] + size[1], at[2] - 0.03], small));
            all.push(named(&format!("box{k}"), "box", Some(&format!("box{}", k - 1)))?);
        } else {
            let (x, z) = (-2.2 + 0.85 * (stand % 6) as f64, 0.6 - 0.75 * (stand / 6) as f64);
            places.push(([x, 0.0, z], [0.45, 0.3 + 0.05 * (stand % 4) as f64, 0.4]));
            all.push(named(&format!("box{k}"), "box", Some("room"))?);
        }
    }
    for (primitive, (at, size)) in all.iter_mut().zip(&places) {
        for (image, camera) in &cameras {
            for corner in ["---", "+--", "-+-", "++-", "--+", "+-+", "-++", "+++"] {
                let sign = |k: usize| if corner.as_bytes()[k] == b'+' { 1.0 } else { -1.0 };
                let half = |k: usize| sign(k) * size[k] / 2.0;
                let point =
                    Point3::new(at[0] + half(0), at[1] + (sign(1) + 1.0) / 2.0 * size[1], at[2] + half(2));
                let Some(pixel) = camera.project(&point) else { continue };
                let inside = (0.0..1600.0).contains(&pixel.x) && (0.0..1200.0).contains(&pixel.y);
                if inside {
                    primitive.marks.push(Mark {
                        corner: corner.into(),
                        image: image.clone(),
                        at: [pixel.x + gaussian(&mut rng), pixel.y + gaussian(&mut rng)],
                        sigma_px: None,
                        reflection: false,
                    });
                }
            }
        }
    }
    Ok((all, cameras))
}

/// A standard normal number (Box and Muller 1958).
fn gaussian(rng: &mut SmallRng) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

fn named(name: &str, kind: &str, parent: Option<&str>) -> Result<Primitive> {
    let parent = parent.map_or(String::new(), |p| format!("parent = \"{p}\"\n"));
    let text = format!("[[primitive]]\nname = \"{name}\"\nkind = \"{kind}\"\n{parent}");
    let mut read: Annotations = config::parse(&text, Path::new("annotations.toml"))?;
    Ok(read.primitive.remove(0))
}

/// A line for a capture.
fn judged(file: &Path) -> Result<String> {
    let range = Range { to: Some("model".into()), ..Range::default() };
    let mut line = format!("{:<12}", validate::name(file));
    let mut last = String::new();
    for (name, ours) in
        [("model+", &[TrueStage::Model, TrueStage::Illuminate] as &[_]), ("all", &TrueStage::ALL)]
    {
        let workspace = true_workspace_to(file, name, ours, &range)?;
        let scene: Scene = json::read(&workspace.folder("model").join("scene.json"))?;
        let path = workspace.base.join(workspace.pipeline.evaluate.truth.clone().unwrap_or_default());
        let truth = truth_at(&path)?.scene().doing(format!("reading the scene of {}", path.display()))?;
        let errors = corner_errors(&scene, &truth);
        let longest = extent(&truth);
        let percent = |k: usize| 100.0 * errors.get(k).map_or(f64::NAN, |e| e.0) / longest;
        let worst = errors.len().saturating_sub(1);
        line += &format!("{:>12.2}{:>10.2}", percent(worst), percent(errors.len() / 2));
        last = errors.last().map_or(String::new(), |e| e.1.clone());
    }
    Ok(format!("{line}  {last}"))
}

/// Distance of each corner of primitives that the truth has, too, from the nearest true corner, m, with their names; the largest last.
pub(super) fn corner_errors(scene: &Scene, truth: &Scene) -> Vec<(f64, String)> {
    let mut errors = Vec::new();
    for primitive in &scene.primitives {
        let of = |scene: &Scene, is: &dyn Fn(&str) -> bool| -> Vec<Point3<f64>> {
            let own = scene.faces.iter().filter(|f| f.name.split('.').next().is_some_and(is));
            own.flat_map(|f| f.vertices.clone()).collect()
        };
        let there = match primitive.kind {
            Kind::Ground => continue,
            Kind::Room => of(truth, &|name| shell(name)),
            kind if truth.primitives.iter().any(|p| p.name == primitive.name && p.kind == kind) => {
                of(truth, &|name| name == primitive.name)
            }
            _ => continue,
        };
        for corner in of(scene, &|name| name == primitive.name) {
            let nearest = there.iter().map(|t| (t - corner).norm()).fold(f64::INFINITY, f64::min);
            errors.extend(nearest.is_finite().then(|| (nearest, primitive.name.clone())));
        }
    }
    errors.sort_by(|a, b| a.0.total_cmp(&b.0));
    errors
}

/// What the truth calls the inside of a room.
pub(super) fn shell(name: &str) -> bool {
    ["floor", "ceiling", "wall"].iter().any(|part| name.starts_with(part))
}

/// Longest side of the box around a scene's room; outdoors around all that stands there, m.
pub(super) fn extent(scene: &Scene) -> f64 {
    let room: Vec<_> = scene.faces.iter().filter(|f| shell(&f.name)).flat_map(|f| &f.vertices).collect();
    let standing = scene.faces.iter().filter(|f| f.name != "ground").flat_map(|f| &f.vertices).collect();
    let corners = if room.is_empty() { standing } else { room };
    let side = |k: usize| {
        let values = corners.iter().map(|p| p[k]);
        values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min)
    };
    (0..3).map(side).fold(0.0, f64::max)
}

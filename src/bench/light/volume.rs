//! Building an irradiance volume: how it grows with patches and points, and against plain ray casting in Mitsuba that
//! reaches the same error.

use super::super::subject::exponent;
use crate::artefact::npy;
use crate::error::{Context as _, Error, FileContext, Result};
use crate::illuminate::patch::LightModel;
use crate::irradiance::{Grid, Volume};
use crate::printer::Printer;
use crate::sh;
use crate::synthetic::{lobby, lobby_of};
use glam::Vec3;
use ndarray::Array2;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

/// The volume and the room of the comparison.
const SIZE: [usize; 3] = [20, 10, 20];
const PATCHES: usize = 2000;
/// Rays of each point, and those of the reference.
const RAYS: usize = 256;
const REFERENCE_RAYS: usize = 1 << 16;
/// Mitsuba traces about so many of the points, evenly chosen, within so many seconds; its time is scaled to all of them.
const THEIR_POINTS: usize = 400;
const THEIR_SECONDS: f64 = 150.0;
/// What growth is looked at.
const MORE_PATCHES: [usize; 5] = [500, 1000, 2000, 4000, 8000];
const MORE_POINTS: [[usize; 3]; 4] = [[10, 5, 10], [20, 5, 10], [20, 10, 10], [20, 10, 20]];
/// Interpreter with Mitsuba in it, where `python3` has none.
const PYTHON: &str = "INSITU_PYTHON";

fn grid(light: &LightModel, size: [usize; 3]) -> Grid {
    let vertices = &light.mesh.vertices;
    let (low, high) = vertices.iter().fold((Vec3::MAX, Vec3::MIN), |(a, b), v| (a.min(*v), b.max(*v)));
    let (low, high) = (low + Vec3::splat(0.25), high - Vec3::splat(0.25));
    let cells = Vec3::from_array(size.map(|n| (n - 1).max(1) as f32));
    Grid { origin: low, spacing: (high - low) / cells, size }
}

/// Relative RMS error of irradiance in harmonics, over points where both are open.
fn error(volume: &Volume, reference: &Volume) -> f64 {
    let (mut square, mut signal) = (0.0, 0.0);
    for (a, b) in volume.open().zip(reference.open()) {
        let (a, b) = (sh::convolved(&a.1), sh::convolved(&b.1));
        for (a, b) in a.as_flattened().iter().zip(b.as_flattened()) {
            square += f64::from(a - b).powi(2);
            signal += f64::from(*b).powi(2);
        }
    }
    (square / signal).sqrt()
}

/// Prints growth and comparison.
pub(in crate::bench) fn print(printer: &Printer) -> Result<()> {
    let [x, y, z] = SIZE;
    printer.data(&format!(
        "\nirradiance volume of the lobby, {RAYS} rays a point and strong patches one by one: time, s"
    ));
    let build = |light: &LightModel, size, rays| {
        let started = Instant::now();
        let volume = Volume::on_grid(light, grid(light, size), rays).doing("building the volume")?;
        Ok::<_, Error>((volume, started.elapsed().as_secs_f64()))
    };
    let mut times = Vec::new();
    printer.data(&format!("{:>10}{:>10}{:>10}", "patches", "points", "time, s"));
    for patches in MORE_PATCHES {
        let light = lobby(lobby_of(patches));
        let (_, seconds) = build(&light, SIZE, RAYS)?;
        let patches = light.mesh.patches.len();
        printer.data(&format!("{patches:>10}{:>10}{seconds:>10.2}", x * y * z));
        times.push((patches as f64, seconds));
    }
    printer.data(&format!("grows by patches^{:.2}", exponent(&times)));
    let light = lobby(lobby_of(PATCHES));
    times.clear();
    for size in MORE_POINTS {
        let (_, seconds) = build(&light, size, RAYS)?;
        let points: usize = size.iter().product();
        printer.data(&format!("{:>10}{points:>10}{seconds:>10.2}", light.mesh.patches.len()));
        times.push((points as f64, seconds));
    }
    printer.data(&format!("grows by points^{:.2}", exponent(&times)));
    let reference =
        Volume::by_rays(&light, grid(&light, SIZE), REFERENCE_RAYS).doing("building the volume")?;
    let (volume, seconds) = build(&light, SIZE, RAYS)?;
    let off = error(&volume, &reference);
    printer.data(&format!(
        "{x}×{y}×{z} points, {} patches: {seconds:.2} s, error {:.2} % against {REFERENCE_RAYS} rays",
        light.mesh.patches.len(),
        100.0 * off
    ));
    let folder = tempfile::tempdir().at("making a folder for Mitsuba", Path::new("."))?;
    let stride = (reference.open_nodes() / THEIR_POINTS).max(1);
    let scale = reference.open_nodes() as f64 / reference.open_nodes().div_ceil(stride) as f64;
    write(folder.path(), &light, &reference, stride)?;
    match mitsuba(folder.path(), off) {
        Ok(mut rows) => {
            printer.data(&format!("Mitsuba: one point in {stride}, its times {scale:.1} times what it took"));
            rows.iter_mut().for_each(|row| row[1] *= scale);
            for [rays, time, error] in &rows {
                printer.data(&format!(
                    "Mitsuba: {rays:>8} rays a point: {time:>8.2} s, error {:.2} %",
                    100.0 * error
                ));
            }
            if let Some([rays, time, error]) = rows.last() {
                let reached = if *error <= off { "the same error" } else { "a larger error" };
                printer.data(&format!(
                    "Mitsuba by {rays} rays a point takes {:.1} times as long for {reached}",
                    time / seconds
                ));
            }
        }
        Err(why) => printer.data(&format!(
            "Mitsuba: left out ({why}); `pip install mitsuba`, and {PYTHON}=python with it, lets it compare"
        )),
    }
    Ok(())
}

/// What Mitsuba's script reads: the mesh, and one in `stride` points with their reference.
fn write(folder: &Path, light: &LightModel, reference: &Volume, stride: usize) -> Result<()> {
    let mesh = &light.mesh;
    let put = |name: &str, width: usize, values: Vec<f32>| {
        let rows = values.len() / width;
        let array = Array2::from_shape_vec((rows, width), values).map_err(|e| Error::Bug(e.to_string()))?;
        npy::write(&folder.join(format!("{name}.npy")), &array)
    };
    put("vertices", 3, mesh.vertices.iter().flat_map(|v| v.to_array()).collect())?;
    put("triangles", 3, mesh.triangles().into_iter().flatten().map(|i| i as f32).collect())?;
    put("normals", 3, (0..mesh.patches.len()).flat_map(|i| mesh.normal(i).to_array()).collect())?;
    put("radiance", 3, mesh.patches.iter().flat_map(|p| p.radiance).collect())?;
    let chosen = || reference.open().step_by(stride);
    put("points", 3, chosen().flat_map(|(at, _)| at.to_array()).collect())?;
    let flat: Vec<f32> = chosen().flat_map(|(_, c)| c.as_flattened().to_vec()).collect();
    put("reference", 3 * sh::COUNT, flat)
}

/// Rays, seconds and error of each run.
fn mitsuba(folder: &Path, error: f64) -> std::result::Result<Vec<[f64; 3]>, String> {
    let python = std::env::var(PYTHON).unwrap_or("python3".into());
    let script = include_str!("mitsuba_volume.py");
    let output = Command::new(&python)
        .args(["-c", script])
        .arg(folder)
        .arg(error.to_string())
        .arg(THEIR_SECONDS.to_string())
        .output()
        .map_err(|e| format!("{python}: {e}"))?;
    let text = String::from_utf8_lossy(&output.stdout);
    let rows: Vec<[f64; 3]> = text
        .lines()
        .filter_map(|line| {
            let numbers: Vec<f64> = line.split(' ').filter_map(|n| n.parse().ok()).collect();
            numbers.try_into().ok()
        })
        .collect();
    if rows.is_empty() {
        let errors = String::from_utf8_lossy(&output.stderr);
        return Err(errors.lines().last().unwrap_or("it printed nothing").into());
    }
    Ok(rows)
}

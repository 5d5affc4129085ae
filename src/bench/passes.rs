//! Speed against error: the number of passes, and rays, against the ray-traced reference on the same scene model.

use super::plot::{self, Axis, DISTINCT, Line, Panel};
use super::subject::{LobbyTransfers, Subject};
use super::{Static, spread};
use crate::driver::run::{self, Range};
use crate::driver::validate;
use crate::error::Result;
use crate::printer::Printer;
use crate::stage::Workspace;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Numbers of passes; 0 for one a source.
const PASSES: [usize; 6] = [10, 20, 50, 100, 200, 0];
/// Rays per pixel of the ray-traced rows.
const RAYS: [usize; 2] = [16, 64];
/// The reference's noise is to be below this share of the least error shown.
const NOISE_SHARE: f64 = 0.5;
/// Patches of the lobby, and width of its picture, px.
const LOBBY: (usize, u32) = (2000, 640);

/// Passes, error and time of each row, for the plot.
type Curve = Vec<[f64; 3]>;

/// Prints a table for each settings file and one for the lobby; draws the curves into a folder, if one is given.
pub(super) fn print(
    settings: &[PathBuf],
    frames: usize,
    pictures: Option<&Path>,
    printer: &Printer,
) -> Result<()> {
    printer.data(&format!(
        "\nrelative shadow error against raytraced, where it removes more than 2 %; frame time in ms (cpu, {frames} frames)"
    ));
    let mut curves: Vec<(String, Curve)> = Vec::new();
    for file in settings {
        let workspace = Workspace::open(file)?;
        run::stages(&workspace, &Range::default(), printer)?;
        let statics = Static::read(&workspace)?;
        let subject = Subject::capture(validate::name(file), &statics, &workspace.pipeline.render);
        curves.push((subject.name.clone(), table(&subject, frames, printer)?));
    }
    let made = LobbyTransfers::new(LOBBY.0, LOBBY.1)?;
    let lobby = Subject::lobby(&made);
    curves.push((lobby.name.clone(), table(&lobby, frames, printer)?));
    if let Some(folder) = pictures {
        let path = folder.join("passes.svg");
        draw(&path, &curves)?;
        printer.data(&path.display().to_string());
    }
    Ok(())
}

fn table(subject: &Subject, frames: usize, printer: &Printer) -> Result<Curve> {
    let shots = PASSES.iter().map(|&n| subject.passes(n, frames)).collect::<Result<Vec<_>>>()?;
    let judged: Vec<_> = shots.iter().map(|s| &s.removed.epsilon).collect();
    let reference = subject.reference(NOISE_SHARE, &judged)?;
    let (width, height) = subject.scene.plate.size();
    printer.data(&format!(
        "\n{}: {width}×{height} px, {} sources, {} patches; noise of the reference {:.4}",
        subject.name,
        subject.scene.transfers.sources.len(),
        subject.scene.light.mesh.patches.len(),
        reference.noise.unwrap_or(0.0)
    ));
    printer.data(&format!(
        "{:<24}{:>7}{:>9}{:>9}{:>9}{:>9}{:>10}{:>9}",
        "method", "maps", "time", "min", "max", "error", "expected", "bias %"
    ));
    let mut curve: Curve = Vec::new();
    for mut shot in shots {
        // Small source sets have fewer sources than passes are asked for.
        if curve.last().is_some_and(|last| last[0] == shot.removed.passes as f64) {
            continue;
        }
        let (error, bias) = subject.errors(&shot.removed.epsilon, &reference.epsilon);
        let [time, low, high] = spread(&mut shot.ms);
        let expected = shot.removed.expected_error.map_or("-".into(), |e| format!("{e:.4}"));
        let name = format!("{} passes", shot.removed.passes);
        printer.data(&format!(
            "{name:<24}{:>7}{time:>9.1}{low:>9.1}{high:>9.1}{error:>9.4}{expected:>10}{:>+9.2}",
            shot.removed.shadow_maps,
            100.0 * bias
        ));
        curve.push([shot.removed.passes as f64, error, time]);
    }
    for rays in RAYS {
        let started = Instant::now();
        let removed = subject.traced(rays, subject.settings.seed)?;
        let time = 1e3 * started.elapsed().as_secs_f64();
        let (error, bias) = subject.errors(&removed.epsilon, &reference.epsilon);
        let name = format!("raytraced {rays} rays");
        printer.data(&format!(
            "{name:<24}{:>7}{time:>9.1}{time:>9.1}{time:>9.1}{error:>9.4}{:>10}{:>+9.2}",
            "-",
            "-",
            100.0 * bias
        ));
    }
    Ok(curve)
}

fn draw(path: &Path, curves: &[(String, Curve)]) -> Result<()> {
    let lines = |x: usize| {
        let line = |(i, (name, curve)): (usize, &(String, Curve))| Line {
            label: name.clone(),
            colour: DISTINCT[i % DISTINCT.len()],
            points: curve.iter().map(|row| (row[x], row[1])).collect(),
        };
        curves.iter().enumerate().map(line).collect()
    };
    let panel = |title: &str, label: &str, x| Panel {
        title: title.into(),
        x: Axis::log(label),
        y: Axis::log("relative shadow error"),
        lines: lines(x),
    };
    let panels =
        [panel("Error against passes", "passes", 0), panel("Error against time of a frame", "time, ms", 2)];
    plot::write_svg(path, &panels, 2)
}

//! How pre-processing grows with the number of patches.

use super::plot::{self, Axis, DISTINCT, Line, Panel};
use super::subject::{exponent, transfer_settings};
use crate::error::{Context as _, Result};
use crate::printer::Printer;
use crate::stage::{cpu_time_s, peak_memory_mib, reset_peak_memory};
use crate::synthetic::{Lobby, lobby_of};
use crate::transfer::solve;
use std::path::Path;
use std::time::Instant;

/// Patches of the lobby.
const PATCHES: [usize; 7] = [250, 500, 1000, 2000, 5000, 10_000, 20_000];
/// Width of its picture, px.
const WIDTH: u32 = 640;
/// Gibson et al. 2003, §9: pre-processing of 2,000 patches or so, s.
const PAPER_S: f64 = 15.0;
/// Memory that the largest may take, MiB.
const MOST_MIB: f64 = 2048.0;

/// Prints a line for each size, and the fitted exponents.
pub(super) fn print(pictures: Option<&Path>, printer: &Printer) -> Result<()> {
    printer.data(
        "\npre-processing of the lobby: sets, transfers, hierarchies, shafts; memory above that before",
    );
    printer.data(&format!(
        "{:>8}{:>10}{:>10}{:>10}{:>11}{:>9}{:>11}{:>10}{:>10}",
        "patches", "receivers", "vertices", "sources", "links", "shafts", "time, s", "CPU, s", "MiB"
    ));
    let (mut times, mut cpu_times, mut memories) = (Vec::new(), Vec::new(), Vec::new());
    reset_peak_memory();
    let before = peak_memory_mib();
    for wanted in PATCHES {
        let Lobby { light, receivers, .. } = Lobby::new(lobby_of(wanted), WIDTH);
        let patches = light.mesh.patches.len() as f64;
        reset_peak_memory();
        let (started, cpu) = (Instant::now(), cpu_time_s());
        let transfers = solve(&light, &receivers, &transfer_settings(), || {})
            .doing(format!("finding the transfers of {patches} patches"))?;
        let time = started.elapsed().as_secs_f64();
        let (memory, cpu) = (peak_memory_mib() - before, cpu_time_s() - cpu);
        printer.data(&format!(
            "{patches:>8}{:>10}{:>10}{:>10}{:>11}{:>9}{time:>11.2}{cpu:>10.2}{memory:>10.0}",
            transfers.receivers.patches.len(),
            transfers.receivers.positions.len(),
            transfers.sources.len(),
            transfers.links.node.len(),
            transfers.shaft_counts().shafts,
        ));
        times.push((patches, time));
        cpu_times.push((patches, cpu));
        memories.push((patches, memory));
    }
    printer.data(&format!(
        "time grows by patches^{:.2}, CPU time by patches^{:.2}, memory by patches^{:.2}",
        exponent(&times),
        exponent(&cpu_times),
        exponent(&memories)
    ));
    let at = |points: &[(f64, f64)], n: usize| {
        let i = PATCHES.iter().position(|p| *p == n).unwrap_or(0);
        points[i].1
    };
    let (time, memory) = (at(&times, 2000), at(&memories, 20_000));
    printer.data(&format!(
        "2,000 patches: {time:.2} s; a fifth of the paper's {PAPER_S} s is {:.1} s",
        PAPER_S / 5.0
    ));
    printer.data(&format!("20,000 patches: {memory:.0} MiB of {MOST_MIB:.0} MiB"));
    if let Some(folder) = pictures {
        let path = folder.join("growth.svg");
        draw(&path, &times, &memories)?;
        printer.data(&path.display().to_string());
    }
    Ok(())
}

fn draw(path: &Path, times: &[(f64, f64)], memories: &[(f64, f64)]) -> Result<()> {
    let panel = |title: &str, y: &str, points: &[(f64, f64)]| Panel {
        title: title.into(),
        x: Axis::log("patches"),
        y: Axis::log(y),
        lines: vec![Line {
            label: format!("patches^{:.2}", exponent(points)),
            colour: DISTINCT[0],
            points: points.to_vec(),
        }],
    };
    let panels =
        [panel("Time of pre-processing", "time, s", times), panel("Peak memory", "memory, MiB", memories)];
    plot::write_svg(path, &panels, 2)
}

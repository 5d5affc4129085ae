//! What moving the object costs: the time until the new ε is there, beside rays, a plain loop, and the paper.

use super::spread;
use super::subject::{LobbyTransfers, Subject, line};
use crate::config::Render;
use crate::error::{Context as _, Result};
use crate::printer::Printer;
use crate::shadow::{Bounds, Caster, RadianceTransfer};
use crate::synthetic::Lobby;
use crate::transfer::{SourceKind, Traversal};
use glam::Vec3;
use std::time::Instant;

/// Width of the picture, px: 800×600.
const WIDTH: u32 = 800;
/// Patches of the lobby.
const PATCHES: usize = 2000;
/// Passes, and triangles of the object in shadow maps.
const PASSES: usize = 50;
const TRIANGLES: usize = 500;
/// Passes between which the time is to be linear.
const SERIES: [usize; 5] = [10, 20, 50, 100, 200];
/// Sizes between which the time is to stay.
const SIZES: [usize; 3] = [500, 2000, 8000];
/// Places of the object at which the traversal is timed.
const PLACES: usize = 20;
/// … and at which all pairs are tested.
const PLACES_OF_PAIRS: usize = 3;

/// Prints all of it.
pub(super) fn print(frames: usize, printer: &Printer) -> Result<()> {
    let made = LobbyTransfers::new(PATCHES, WIDTH)?;
    let mut subject = Subject::lobby(&made);
    subject.settings = Render { passes: PASSES, caster_triangles: TRIANGLES, ..subject.settings };
    let (width, height) = subject.scene.plate.size();
    let caster = Caster::new(&subject.occluder, TRIANGLES);
    printer.data(&format!(
        "\n{}: {width}×{height} px, {} sources; object of {} triangles, {} in shadow maps; cpu, medians of {frames} frames",
        subject.name,
        subject.scene.transfers.sources.len(),
        subject.occluder.triangles.len(),
        caster.occluder.triangles.len()
    ));
    let frame = methods(&subject, &caster, frames, printer)?;
    passes(&subject, frames, printer)?;
    sizes(frames, printer)?;
    traversal(&subject, printer);
    let counts = made.transfers.shaft_counts();
    printer.data("\nGibson et al. 2003, on what there was then: 14-35 frames/s, 10-40 ms of traversal, 15-30 s of pre-processing,");
    printer.data(&format!(
        "47,000-102,000 leaf shafts, 9 MB; here: {:.1} frames/s, {} leaf shafts of {} shafts, {:.1} MB",
        1e3 / frame,
        counts.leaves,
        counts.shafts,
        (counts.shafts * counts.bytes_per_shaft) as f64 / 1e6
    ));
    Ok(())
}

/// Ours, the plain loop with the same answer, and rays with the same error. Gives the time of ours, ms.
fn methods(subject: &Subject, caster: &Caster, frames: usize, printer: &Printer) -> Result<f64> {
    let mut shot = subject.passes(PASSES, frames)?;
    let [ours, low, high] = spread(&mut shot.ms);
    let reference = subject.reference(0.5, &[&shot.removed.epsilon])?;
    let (error, bias) = subject.errors(&shot.removed.epsilon, &reference.epsilon);
    printer.data(&format!(
        "{:<28}{:>10}{:>10}{:>10}{:>9}{:>9}{:>8}",
        "method", "ms", "min", "max", "error", "bias %", "ratio"
    ));
    let row = |name: &str, [time, low, high]: [f64; 3], (error, bias): (f64, f64)| {
        printer.data(&format!(
            "{name:<28}{time:>10.1}{low:>10.1}{high:>10.1}{error:>9.4}{:>+9.2}{:>8.1}",
            100.0 * bias,
            time / ours
        ));
    };
    row(&format!("radiance-transfer, {PASSES}"), [ours, low, high], (error, bias));

    let plain =
        RadianceTransfer::prepare(&subject.scene, &subject.settings).doing("preparing the plain loop")?;
    let mut ms = Vec::new();
    let mut found = None;
    for _ in 0..frames.min(3) {
        let started = Instant::now();
        found = Some(plain.removed_radiance_plainly(&caster.occluder).doing("looping plainly")?);
        ms.push(1e3 * started.elapsed().as_secs_f64());
    }
    if let Some(found) = found {
        row("plain loop", spread(&mut ms), subject.errors(&found.epsilon, &reference.epsilon));
    }

    // The error of rays falls by the root of their number: the number that gives ours, from a first guess.
    let trace = |rays: usize| -> Result<(f64, (f64, f64))> {
        let started = Instant::now();
        let traced = subject.traced(rays, subject.settings.seed)?;
        let ms = 1e3 * started.elapsed().as_secs_f64();
        Ok((ms, subject.errors(&traced.epsilon, &reference.epsilon)))
    };
    let mut rays = 64;
    let mut result = trace(rays)?;
    for _ in 0..2 {
        let wanted = (rays as f64 * (result.1.0 / error).powi(2)).round().clamp(2.0, 4096.0) as usize;
        if wanted.abs_diff(rays) * 10 <= rays {
            break;
        }
        rays = wanted;
        result = trace(rays)?;
    }
    row(&format!("raytraced, {rays} rays"), [result.0; 3], result.1);
    printer.data(&format!(
        "noise of the reference {:.4}; goals: the plain loop takes 5 times as long, rays 10 times",
        reference.noise.unwrap_or(0.0)
    ));
    Ok(ours)
}

fn passes(subject: &Subject, frames: usize, printer: &Printer) -> Result<()> {
    // Few passes draw as many maps as their clusters need at least, so that the time is linear in the maps.
    let (mut points, mut cells) = (Vec::new(), String::new());
    for n in SERIES {
        let mut shot = subject.passes(n, frames)?;
        let (maps, ms) = (shot.removed.shadow_maps, spread(&mut shot.ms)[0]);
        cells += &format!("  {} ({maps}): {ms:.1}", shot.removed.passes);
        points.push((maps as f64, ms));
    }
    let (slope, start) = line(&points);
    let off = points.iter().map(|(n, ms)| (ms / (start + slope * n) - 1.0).abs()).fold(0.0, f64::max);
    printer.data(&format!("\nms by passes (of so many maps){cells}"));
    printer.data(&format!("fitted {start:.1} ms + {slope:.3} ms a map, off by {:.0} % at most", 100.0 * off));
    Ok(())
}

fn sizes(frames: usize, printer: &Printer) -> Result<()> {
    let mut cells = String::new();
    for patches in SIZES {
        let made = LobbyTransfers::new(patches, WIDTH)?;
        let mut subject = Subject::lobby(&made);
        subject.settings = Render { caster_triangles: TRIANGLES, ..subject.settings };
        let mut shot = subject.passes(PASSES, frames)?;
        let (ms, traversed) = (spread(&mut shot.ms)[0], traverse(&subject, false).shafts);
        cells += &format!("  {}: {ms:.1} ({traversed:.2})", made.lobby.light.mesh.patches.len());
    }
    printer.data(&format!("ms by patches (of which traversal){cells}"));
    Ok(())
}

/// Medians over some places of the object, ms, all on one thread.
struct Traversed {
    /// Down the shaft hierarchy.
    shafts: f64,
    /// A shaft for each pair of a source and a receiver patch.
    pairs: f64,
    /// For each pair the segment between the middles against the object's box: the least that a test can be, and too little,
    /// for it misses what passes beside the middles.
    segments: f64,
    /// Sources found, on average, by shafts, and by segments.
    found: [f64; 2],
}

fn traverse(subject: &Subject, with_pairs: bool) -> Traversed {
    let (transfers, mesh) = (subject.scene.transfers, &subject.scene.light.mesh);
    let receivers: Vec<Vec3> =
        transfers.receivers.patches.iter().map(|&p| mesh.centroid(p as usize)).collect();
    let sources: Vec<Vec3> = transfers
        .sources
        .iter()
        .map(|s| match s.kind {
            SourceKind::Patch(i) => mesh.centroid(i as usize),
            SourceKind::Distant(i) => 1e4 * subject.scene.light.distant[i as usize].direction,
        })
        .collect();
    let (mut shafts, mut pairs, mut segments, mut found) = (Vec::new(), Vec::new(), Vec::new(), [0.0; 2]);
    let mut traversal = Traversal::default();
    let timed = |ms: &mut Vec<f64>, work: &mut dyn FnMut() -> usize| {
        let started = Instant::now();
        let found = std::hint::black_box(work());
        ms.push(1e3 * started.elapsed().as_secs_f64());
        found as f64 / PLACES as f64
    };
    for place in 0..PLACES {
        let angle = place as f32 * 2.4;
        let at = [0.3 + 1.2 * angle.cos(), 0.2 + 0.8 * angle.sin()];
        let Bounds { min, max, .. } = Bounds::of(&Lobby::object(at, 0.0));
        found[0] += timed(&mut shafts, &mut || traversal.affected(transfers, min, max).sources.len());
        if with_pairs && place < PLACES_OF_PAIRS {
            timed(&mut pairs, &mut || transfers.affected_by_pairs(min, max).sources.len());
        }
        if with_pairs {
            found[1] += timed(&mut segments, &mut || {
                let met = |s: &Vec3| receivers.iter().filter(|r| crosses(*s, **r, min, max)).count() > 0;
                sources.iter().filter(|s| met(s)).count()
            });
        }
    }
    let median = |mut ms: Vec<f64>| if ms.is_empty() { f64::NAN } else { spread(&mut ms)[0] };
    Traversed { shafts: median(shafts), pairs: median(pairs), segments: median(segments), found }
}

/// Whether a segment meets a box: slabs.
fn crosses(a: Vec3, b: Vec3, min: Vec3, max: Vec3) -> bool {
    let inverse = (b - a).recip();
    let (near, far) = ((min - a) * inverse, (max - a) * inverse);
    near.min(far).max_element().max(0.0) <= near.max(far).min_element().min(1.0)
}

fn traversal(subject: &Subject, printer: &Printer) {
    let t = traverse(subject, true);
    let (sources, receivers) =
        (subject.scene.transfers.sources.len(), subject.scene.transfers.receivers.patches.len());
    printer.data(&format!("\ntraversal {:.3} ms, {:.0} of {sources} sources found", t.shafts, t.found[0]));
    printer.data(&format!(
        "all pairs of {sources} sources and {receivers} receivers: {:.1} ms by shafts, {:.0} times as long (goal 50); {:.1} ms by segments between middles, {:.0} times ({:.0} sources)",
        t.pairs,
        t.pairs / t.shafts,
        t.segments,
        t.segments / t.shafts,
        t.found[1]
    ));
}

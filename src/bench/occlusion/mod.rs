//! The experiments of eisemann2006: three filters (Figure 2), three rules of combination on foliage (Figure 3), and cost by
//! number of triangles and by size of the light, all against rays; then the method on the captures named.

mod captures;
mod subject;

use self::subject::{Subject, cloud_slices, errors, flat, flat_slice, leaves};
use super::plot::{self, Axis, DISTINCT, Line, Panel};
use super::spread;
use crate::composite::write_png;
use crate::config::{Combination, OcclusionFilter};
use crate::error::Result;
use crate::image::{Code, Image};
use crate::occlusion::Slices;
use crate::printer::Printer;
use crate::shadow::Occluder;
use crate::synthetic::blob;
use glam::Vec3;
use std::path::{Path, PathBuf};

/// Points of the floor where errors are measured, and of the paper's picture, where lookups are timed.
const JUDGED: [usize; 2] = [160, 120];
const PICTURE: [usize; 2] = [800, 600];
/// Rays a point of the reference.
const REFERENCE: u32 = 1024;
/// … and of the ray-traced times.
const RAYS: u32 = 64;
/// Side of the light, m, where nothing else is said.
const LIGHT_M: f32 = 0.6;
/// Leaves and their area, m².
const CLOUD: (usize, f32) = (500, 1.5);
/// What the paper's Figure 2 prints (GeForce 7800), ms: mipmap, N-buffers, summed-area table at 256² and 512².
const PAPER_MS: [[&str; 2]; 3] = [["<1", "<1"], ["3", "11"], ["32", "139"]];
const FILTERS: [&str; 3] = ["mipmap", "N-buffers", "summed-area"];
const RESOLUTIONS: [usize; 2] = [256, 512];
/// Numbers of triangles, and sides of the light, m.
const TRIANGLES: [usize; 4] = [1000, 10_000, 100_000, 1_000_000];
const SIDES_M: [f32; 6] = [0.05, 0.1, 0.2, 0.5, 1.0, 2.0];

/// Prints all tables; draws plots and strips of floor seen from above into a folder, if one is given.
pub(super) fn print(
    settings: &[PathBuf],
    frames: usize,
    pictures: Option<&Path>,
    printer: &Printer,
) -> Result<()> {
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    printer.data(&format!(
        "\na square light over a floor, leaves between; error of visibility in the shadow against {REFERENCE} rays a point; \
         cpu, {threads} threads, medians of {frames} runs"
    ));
    filters(frames, pictures, printer)?;
    rules(pictures, printer)?;
    cost(frames, pictures, printer)?;
    captures::print(settings, frames, printer)
}

/// Visibility by rays, and the rms of its noise.
fn reference(subject: &Subject) -> (Vec<f32>, f64) {
    let (a, b) = (subject.traced(REFERENCE, 1).0, subject.traced(REFERENCE, 2).0);
    let noise = errors(&a, &b)[0] / 2f64.sqrt();
    (a, noise)
}

/// Figure 2.
fn filters(frames: usize, pictures: Option<&Path>, printer: &Printer) -> Result<()> {
    let cloud = || leaves(CLOUD.0, CLOUD.1);
    let sheet = Subject::new(LIGHT_M, flat(cloud()), JUDGED);
    let subject = Subject::new(LIGHT_M, cloud(), JUDGED);
    let (references, noise): (Vec<_>, Vec<_>) = [&sheet, &subject].map(reference).into_iter().unzip();
    let picture = Subject::new(LIGHT_M, cloud(), PICTURE);
    printer.data(&format!(
        "\nFigure 2: time to prefilter 4 textures (one RGBA texture) and 16, lookups of 16 at 800×600 points, ms; rms errors (noise \
         {:.4}, {:.4})\n{:<14}{:>6}{:>10}{:>8}{:>10}{:>10}{:>12}{:>12}",
        noise[0],
        noise[1],
        "filter", "side", "4", "paper", "16", "lookups", "one sheet", "16 slices"
    ));
    let mut strip = vec![references[0].clone()];
    for (i, &side) in RESOLUTIONS.iter().enumerate() {
        for (f, filter) in OcclusionFilter::ALL.into_iter().enumerate() {
            let time = |count| {
                let run = |_| picture.make(&cloud_slices(count), side, filter, false).filter_ms;
                median((0..frames).map(run))
            };
            let made = picture.make(&cloud_slices(16), side, filter, false);
            let lookups = median((0..frames).map(|_| picture.seen(&made.textures, Combination::Product).1));
            let found = [(&sheet, flat_slice()), (&subject, cloud_slices(16))].map(|(s, slices)| {
                s.seen(&s.make(&slices, side, filter, false).textures, Combination::Product).0
            });
            let [one, all] = [0, 1].map(|k| errors(&found[k], &references[k])[0]);
            printer.data(&format!(
                "{:<14}{side:>6}{:>10.1}{:>8}{:>10.1}{lookups:>10.1}{one:>12.4}{all:>12.4}",
                FILTERS[f],
                time(4),
                PAPER_MS[f][i],
                time(16)
            ));
            if side == RESOLUTIONS[0] {
                strip.push(found[0].clone());
            }
        }
    }
    show(pictures, "occlusion_filters.png", &strip, printer)
}

/// Figure 3.
fn rules(pictures: Option<&Path>, printer: &Printer) -> Result<()> {
    let subjects: [(&str, Occluder); 3] = [
        ("leaves", leaves(CLOUD.0, CLOUD.1)),
        ("dense leaves", leaves(4 * CLOUD.0, 4.0 * CLOUD.1)),
        ("a closed blob", blob(Vec3::Y * 1.1, 0.4, 0.15, 40)),
    ];
    printer.data(&format!(
        "\nFigure 3: rms and mean (+ too light) of the error by rule; summed-area 512²; closed: slices projected on the next\n\
         {:<16}{:>7}{:>8}{:>17}{:>17}{:>17}{:>17}{:>17}",
        "occluder", "slices", "noise", "maximum", "sum", "their mean", "product", "product, closed"
    ));
    for (name, occluder) in subjects {
        let subject = Subject::new(LIGHT_M, occluder, JUDGED);
        let (reference, noise) = reference(&subject);
        for count in [4, 8, 16] {
            let slices = cloud_slices(count);
            let made = |close| subject.make(&slices, 512, OcclusionFilter::SummedArea, close).textures;
            let (open, closed) = (made(false), made(true));
            let by = |rule| subject.seen(&open, rule).0;
            let (maximum, sum) = (by(Combination::Maximum), by(Combination::Sum));
            let mean: Vec<f32> = maximum.iter().zip(&sum).map(|(a, b)| (a + b) / 2.0).collect();
            let product = by(Combination::Product);
            let shown = [maximum, sum, mean, product, subject.seen(&closed, Combination::Product).0];
            let cells: String = (shown.iter().map(|s| errors(s, &reference)))
                .map(|[rms, bias]| format!("{:>17}", format!("{rms:.3} {bias:+.3}")))
                .collect();
            printer.data(&format!("{name:<16}{count:>7}{noise:>8.4}{cells}"));
            if count == 16 {
                let strip = [&reference, &shown[0], &shown[1], &shown[3]].map(Clone::clone);
                let file = format!("occlusion_{}.png", name.replace(' ', "_"));
                show(pictures, &file, &strip, printer)?;
            }
        }
    }
    Ok(())
}

/// Times of one row, ms: drawing, prefiltering and lookups with summed-area tables, then with N-buffers, and of rays.
struct Cost {
    x: f64,
    exact: [f64; 3],
    buffers: [f64; 3],
    rays: f64,
    /// rms, and the reference's noise.
    error: [f64; 2],
}

impl Cost {
    fn measure(x: f64, side: f32, occluder: &Occluder, frames: usize) -> Self {
        let picture = Subject::new(side, occluder.clone(), PICTURE);
        let judged = Subject::new(side, occluder.clone(), JUDGED);
        let slices: Slices = cloud_slices(16);
        let time = |filter| {
            let mut parts = [Vec::new(), Vec::new(), Vec::new()];
            for _ in 0..frames {
                let made = picture.make(&slices, 512, filter, false);
                let lookups = picture.seen(&made.textures, Combination::Product).1;
                parts.iter_mut().zip([made.draw_ms, made.filter_ms, lookups]).for_each(|(p, ms)| p.push(ms));
            }
            parts.map(|p| median(p.into_iter()))
        };
        let found = judged.make(&slices, 512, OcclusionFilter::SummedArea, false).textures;
        let found = judged.seen(&found, Combination::Product).0;
        let (reference, noise) = reference(&judged);
        let scale = (PICTURE[0] * PICTURE[1]) as f64 / (JUDGED[0] * JUDGED[1]) as f64;
        Self {
            x,
            exact: time(OcclusionFilter::SummedArea),
            buffers: time(OcclusionFilter::NBuffers),
            rays: judged.traced(RAYS, 3).1 * scale,
            error: [errors(&found, &reference)[0], noise],
        }
    }

    fn tell(&self, name: &str, printer: &Printer) {
        let cells = |t: [f64; 3]| format!("{:>9.1}{:>9.1}{:>9.1}", t[0], t[1], t[2]);
        let sums = [self.exact, self.buffers].map(|t| t.iter().sum::<f64>());
        printer.data(&format!(
            "{name:<18}{}{:>9.1}{}{:>9.1}{:>10.0}{:>9.4}{:>9.4}",
            cells(self.exact),
            sums[0],
            cells(self.buffers),
            sums[1],
            self.rays,
            self.error[0],
            self.error[1]
        ));
    }
}

fn cost(frames: usize, pictures: Option<&Path>, printer: &Printer) -> Result<()> {
    let head = |what: &str| {
        let part = format!("{:>9}{:>9}{:>9}{:>9}", "draw", "filter", "look up", "all");
        printer.data(&format!("{what:<18}{part}{part}{:>10}{:>9}{:>9}", "64 rays", "rms", "noise"));
    };
    printer.data(
        "\nCost of 16 slices of 512² at 800×600 points, ms: summed-area tables, then N-buffers; 64 rays a point beside \
         (from a 25th of them);\nthe paper (GeForce 7800, N-buffers): 40-50 ms, “almost the same in all our tests”",
    );
    head("triangles");
    let by_triangles: Vec<Cost> = TRIANGLES
        .iter()
        .map(|&n| {
            let row = Cost::measure(n as f64, LIGHT_M, &leaves(n / 2, CLOUD.1), frames);
            row.tell(&n.to_string(), printer);
            row
        })
        .collect();
    head("side of the light");
    let cloud = leaves(TRIANGLES[1] / 2, CLOUD.1);
    let by_side: Vec<Cost> = SIDES_M
        .iter()
        .map(|&m| {
            let row = Cost::measure(f64::from(m), m, &cloud, frames);
            row.tell(&format!("{m} m"), printer);
            row
        })
        .collect();
    let Some(folder) = pictures else { return Ok(()) };
    let path = folder.join("occlusion.svg");
    let panel = |title: &str, label: &str, rows: &[Cost]| {
        let line = |label: &str, k: usize, y: &dyn Fn(&Cost) -> f64| Line {
            label: label.into(),
            colour: DISTINCT[k],
            points: rows.iter().map(|r| (r.x, y(r))).collect(),
        };
        Panel {
            title: title.into(),
            x: Axis::log(label),
            y: Axis::log("time, ms"),
            lines: vec![
                line("draw", 0, &|r| r.exact[0]),
                line("prefilter", 1, &|r| r.exact[1]),
                line("look up", 2, &|r| r.exact[2]),
                line("64 rays a point", 6, &|r| r.rays),
            ],
        }
    };
    let panels = [
        panel("Summed-area tables: cost against triangles", "triangles", &by_triangles),
        panel("Cost against the light's side", "side, m", &by_side),
    ];
    plot::write_svg(&path, &panels, 2)?;
    printer.data(&path.display().to_string());
    Ok(())
}

fn median(ms: impl Iterator<Item = f64>) -> f64 {
    let mut ms: Vec<f64> = ms.collect();
    spread(&mut ms)[0]
}

/// Visibilities of the floor side by side, as grey.
fn show(pictures: Option<&Path>, name: &str, strip: &[Vec<f32>], printer: &Printer) -> Result<()> {
    let Some(folder) = pictures else { return Ok(()) };
    let [width, height] = JUDGED;
    let image = Image::from_fn(strip.len() * width, height, |x, y| {
        Code([strip[x / width][y * width + x % width].max(0.0).powf(1.0 / 2.2); 3])
    });
    let path = folder.join(name);
    write_png(&path, &image)?;
    printer.data(&path.display().to_string());
    Ok(())
}

//! The experiments of decoro2008, Figures 3 and 5: pictures by few lights, additive and subtractive, against one by 1,000.
//!
//! A picture's error is the rms difference of its display values (sRGB codes, 0..1, exposed so that the reference's 99th
//! percentile is white) over the pixels that show the object: the paper states an rms, but not on what.

mod subject;

use self::subject::{MATERIALS, Shot, Subject};
use super::plot::{self, Axis, DISTINCT, Line, Panel};
use crate::composite::write_png;
use crate::config::LightSampling;
use crate::error::{Error, FileContext, Result};
use crate::exposure::{Photograph, decode};
use crate::image::{Code, Image, RadianceImage};
use crate::printer::Printer;
use crate::render::Environment;
use crate::response::Response;
use crate::stage::Workspace;
use crate::subtractive::sample;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Lights of the reference.
const REFERENCE: usize = 1000;
/// Illumination detail.
const LIGHTS: [usize; 5] = [15, 20, 30, 40, 100];
/// Sides of the squares of pixels that share a sample: sampling detail 1, 1/16, 1/1024.
const SIDES: [usize; 3] = [1, 4, 32];
/// Lights of the pictures written.
const SHOWN: usize = 40;
/// By material and lights, what the paper's Figure 3 prints: rms by additive and by subtractive shadows, sampling detail 1.
const PAPER: [(usize, usize, [f64; 2]); 2] = [(0, 40, [0.069, 0.026]), (1, 100, [0.093, 0.039])];

/// Error and time (ms) of the additive picture, then of the subtractive ones by [`SIDES`].
type Row = [[f64; 2]; 1 + SIDES.len()];

/// Prints a table for each material, means over all environments of a folder, with the object of the first settings file.
pub(super) fn print(
    settings: &[PathBuf],
    environments: Option<&Path>,
    pictures: Option<&Path>,
    printer: &Printer,
) -> Result<()> {
    let environments = read(environments)?;
    let workspace = Workspace::open(&settings[0])?;
    let render = &workspace.pipeline.render;
    let object = crate::render::load_object(&workspace.base.join(&render.object), render)?;
    let subject = Subject::new(object);
    let mut rows = vec![vec![[[0.0; 2]; 1 + SIDES.len()]; LIGHTS.len()]; MATERIALS.len()];
    let mut beside = Vec::new();
    for (name, environment) in &environments {
        let started = Instant::now();
        let many = sample(&environment.map, REFERENCE, LightSampling::Structured);
        let references = subject.references(&many);
        printer.detail(&format!("{name}: references in {:.1} s", started.elapsed().as_secs_f64()));
        for (m, reference) in references.iter().enumerate() {
            let unshadowed = subject.unshadowed(environment, m, &many);
            for (l, &count) in LIGHTS.iter().enumerate() {
                let lights = sample(&environment.map, count, LightSampling::Structured);
                let mut shots = vec![subject.additive(&lights, m)];
                shots.extend(SIDES.map(|side| subject.subtractive(&lights, &unshadowed, m, side)));
                for (k, shot) in shots.iter().enumerate() {
                    rows[m][l][k][0] += subject.error(&shot.picture, reference) / environments.len() as f64;
                    rows[m][l][k][1] += shot.ms / environments.len() as f64;
                }
                if count == SHOWN {
                    beside.push((name.clone(), m, errors(&subject, &shots, reference)));
                    if let Some(folder) = pictures.filter(|_| m < PAPER.len()) {
                        let path = folder.join(format!("subtractive_{name}_{m}.png"));
                        write_png(&path, &strip(&subject, reference, &shots))?;
                        printer.data(&path.display().to_string());
                    }
                }
            }
        }
    }
    tell(&subject, environments.len(), &rows, printer);
    tell_environments(&beside, printer);
    if let Some(folder) = pictures {
        let path = folder.join("subtractive.svg");
        draw(&path, &rows)?;
        printer.data(&path.display().to_string());
    }
    Ok(())
}

/// Display and relative radiance errors of each shot.
fn errors(subject: &Subject, shots: &[Shot], reference: &RadianceImage) -> Vec<[f64; 2]> {
    let errors = |s: &Shot| [subject.error(&s.picture, reference), subject.relative(&s.picture, reference)];
    shots.iter().map(errors).collect()
}

/// The `latlong` maps of a folder, with mean luminance 1.
fn read(folder: Option<&Path>) -> Result<Vec<(String, Environment)>> {
    let hint = "name a folder of latlong .hdr or .exr files: --environments DIR";
    let folder = folder.ok_or_else(|| Error::Usage {
        problem: "the table `subtractive` needs environments".into(),
        hint: hint.into(),
    })?;
    let doing = "looking for environments";
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).at(doing, folder)? {
        let path = entry.at(doing, folder)?.path();
        let known = |e: &std::ffi::OsStr| e.eq_ignore_ascii_case("hdr") || e.eq_ignore_ascii_case("exr");
        files.extend(path.extension().is_some_and(known).then_some(path));
    }
    files.sort();
    if files.is_empty() {
        return Err(Error::file(doing, folder, "holds no .hdr or .exr file", hint));
    }
    let stem = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    files.iter().map(|path| Ok((stem(path), environment(path)?))).collect()
}

fn environment(path: &Path) -> Result<Environment> {
    let refuse = |what: &str, hint: &str| Err(Error::file("reading an environment", path, what, hint));
    let Photograph::Linear(map) = decode(path)? else {
        return refuse("is not linear", "give it as Radiance .hdr or OpenEXR");
    };
    if map.width() != 2 * map.height() {
        return refuse("is not twice as wide as high", "give a latlong (equirectangular) map");
    }
    let environment = Environment { map };
    let texels = environment.map.pixels().iter().enumerate();
    let power: f32 = texels.map(|(i, p)| p.luminance().max(0.0) * environment.texel(i).1).sum();
    if power <= 0.0 {
        return refuse("is black", "give an environment with light in it");
    }
    let scale = 4.0 * std::f32::consts::PI / power;
    let map = environment.map.map(|p| crate::image::Radiance(p.0.map(|v| v.max(0.0) * scale)));
    Ok(Environment { map })
}

fn side_name(side: usize) -> String {
    if side == 1 { "1".into() } else { format!("1/{}", side * side) }
}

fn tell(subject: &Subject, environments: usize, rows: &[Vec<Row>], printer: &Printer) {
    let (width, height) = subject.size();
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    printer.data(&format!(
        "\nrms error of display values against {REFERENCE} lights, and time of a frame in ms ({threads} threads, one run each); \
         means over {environments} environments;\n{width}×{height} px, {} of them of the object, {} triangles; ratio: \
         subtractive over additive; paper: decoro2008, Figure 3",
        subject.shown(),
        subject.triangles()
    ));
    for (m, rows) in rows.iter().enumerate() {
        let head: String = SIDES.map(|s| format!("{:>20}", format!("subtractive {}", side_name(s)))).concat();
        printer.data(&format!("\n{:<24}{:>16}{head}{:>8}  paper", MATERIALS[m].name, "additive", "ratio"));
        for (&lights, row) in LIGHTS.iter().zip(rows) {
            let cell = |[error, ms]: [f64; 2]| format!("{error:.3} {ms:>8.0}");
            let cells: String = row[1..].iter().map(|c| format!("{:>20}", cell(*c))).collect();
            let paper = PAPER.iter().find(|p| (p.0, p.1) == (m, lights)).map_or(String::new(), |p| {
                let [a, s] = p.2;
                format!("  {a:.3} → {s:.3}, ratio {:.2}", s / a)
            });
            let (name, ratio) = (format!("{lights} lights"), row[1][0] / row[0][0]);
            printer.data(&format!("{name:<24}{:>16}{cells}{ratio:>8.2}{paper}", cell(row[0])));
        }
    }
}

fn tell_environments(beside: &[(String, usize, Vec<[f64; 2]>)], printer: &Printer) {
    printer.data(&format!(
        "\n{SHOWN} lights, by environment: rms of display values, then rms of radiance over that of the reference; additive, \
         subtractive {}",
        SIDES.map(side_name).join(", ")
    ));
    for (name, m, errors) in beside {
        let line = |k: usize| errors.iter().map(|e| format!("{:>8.3}", e[k])).collect::<String>();
        printer.data(&format!("{name:<12}{:<24}{}    {}", MATERIALS[*m].name, line(0), line(1)));
    }
}

/// Reference, additive, subtractive at full and at 1/16 sampling detail.
fn strip(subject: &Subject, reference: &RadianceImage, shots: &[Shot]) -> Image<Code> {
    let exposure = subject.exposure(reference);
    let [left, top, right, bottom] = subject.window();
    let pictures = [reference, &shots[0].picture, &shots[1].picture, &shots[2].picture];
    let (width, srgb) = (right - left, Response::srgb());
    Image::from_fn(pictures.len() * width, bottom - top, |x, y| {
        let radiance = pictures[x / width].at(left + x % width, top + y).0;
        Code(srgb.code_of(radiance.map(|v| v * exposure)))
    })
}

fn draw(path: &Path, rows: &[Vec<Row>]) -> Result<()> {
    let panel = |m: usize, by_time: bool| {
        let line = |k: usize| Line {
            label: if k == 0 {
                "additive".into()
            } else {
                format!("subtractive, {}", side_name(SIDES[k - 1]))
            },
            colour: DISTINCT[k % DISTINCT.len()],
            points: LIGHTS
                .iter()
                .zip(&rows[m])
                .map(|(&l, row)| (if by_time { row[k][1] } else { l as f64 }, row[k][0]))
                .collect(),
        };
        let mut lines: Vec<Line> = (0..1 + SIDES.len()).map(line).collect();
        let paper = PAPER.iter().filter(|p| p.0 == m && !by_time);
        lines.extend(paper.flat_map(|&(_, lights, errors)| {
            ["paper, additive", "paper, subtractive"].into_iter().zip(errors).enumerate().map(
                move |(k, (label, error))| Line {
                    label: label.into(),
                    colour: DISTINCT[5 + k],
                    points: vec![(lights as f64, error)],
                },
            )
        }));
        Panel {
            title: format!(
                "{}: error against {}",
                MATERIALS[m].name,
                if by_time { "time" } else { "lights" }
            ),
            x: if by_time { Axis::log("time of a frame, ms") } else { Axis::linear("lights") },
            y: Axis::linear("rms of display values"),
            lines,
        }
    };
    let panels: Vec<Panel> = (0..MATERIALS.len()).flat_map(|m| [panel(m, false), panel(m, true)]).collect();
    plot::write_svg(path, &panels, 2)
}

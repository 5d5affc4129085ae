//! The experiments of supan2006: time against the number of lights (Table 1) on a film, quality against it (Figure 6) on the
//! captures named and in a lobby, each plain, with lights at centroids and with bright texels split; the film beside its truth.

use super::Static;
use super::spread;
use super::subject::{LobbyTransfers, Subject};
use crate::composite::write_png;
use crate::config::{Render, ShadowMethod};
use crate::driver::live::{Film, session};
use crate::driver::run::{self, Range};
use crate::driver::validate;
use crate::error::{Context as _, Result};
use crate::exposure::{Photograph, decode};
use crate::image::{Code, CodeImage, Image};
use crate::printer::Printer;
use crate::shadow::Session;
use crate::stage::Workspace;
use std::path::{Path, PathBuf};

/// Lights, and what the paper's Table 1 prints, frames/s (GeForce 7800 GT).
const TABLE_1: [(usize, usize, &str); 6] =
    [(0, 4, "35"), (8, 4, "32"), (48, 4, "21"), (64, 8, "15"), (192, 8, ""), (240, 8, "")];
/// Frames of the film are enlarged for Table 1: to 800×600 from 400×300 px.
const ENLARGED: usize = 2;
/// Frames timed after the first ones, in which all maps are drawn.
const FIRST: usize = 2;
/// Rays a pixel of the reference.
const REFERENCE: usize = 512;
/// Texels a face.
const TEXELS: [usize; 3] = [2, 4, 8];
const SPLITS: usize = 16;
/// Frames shown of a film.
const SHOWN: [usize; 2] = [29, 59];

/// Prints what the settings files are good for: those with markers are films, the others captures.
pub(super) fn print(
    settings: &[PathBuf],
    frames: usize,
    pictures: Option<&Path>,
    printer: &Printer,
) -> Result<()> {
    let mut strip: Vec<Vec<CodeImage>> = Vec::new();
    let mut timed = false;
    for file in settings {
        let workspace = Workspace::open(file)?;
        if workspace.pipeline.live.board.is_none() && workspace.pipeline.live.markers.is_empty() {
            run::stages(&workspace, &Range::default(), printer)?;
            let statics = Static::read(&workspace)?;
            let name = validate::name(file);
            quality(&Subject::capture(name, &statics, &workspace.pipeline.render), frames, printer)?;
            continue;
        }
        if !timed {
            times(&workspace, frames, printer)?;
            let lobby = LobbyTransfers::new(2000, 320)?;
            quality(&Subject::lobby(&lobby), frames, printer)?;
            timed = true;
        }
        strip.push(film(&workspace, &validate::name(file), printer)?);
    }
    let (Some(folder), Some(first)) = (pictures, strip.first()) else { return Ok(()) };
    let truth = SHOWN.map(|i| truth_of(&settings[settings.len() - 1], i));
    let mut columns: Vec<Vec<CodeImage>> = Vec::new();
    if let [Some(a), Some(b)] = truth {
        columns.push(vec![a, b]);
    }
    columns.extend(strip.iter().cloned());
    let (w, h) = first[0].size();
    let sheet =
        Image::from_fn(columns.len() * w, SHOWN.len() * h, |x, y| *columns[x / w][y / h].at(x % w, y % h));
    let path = folder.join("dome.png");
    write_png(&path, &sheet)?;
    printer.data(&path.display().to_string());
    Ok(())
}

/// A frame with the object in it, where the film has it.
fn truth_of(settings: &Path, frame: usize) -> Option<CodeImage> {
    let path = settings.parent()?.join(format!("truth/{frame:04}.jpg"));
    match decode(&path).ok()? {
        Photograph::Codes(codes) => Some(codes),
        Photograph::Linear(_) => None,
    }
}

/// Table 1.
fn times(workspace: &Workspace, frames: usize, printer: &Printer) -> Result<()> {
    let mut film = Film::open(workspace)?;
    let mut shown = Vec::new();
    while let Some((frame, _)) = film.next()?
        && shown.len() < frames + FIRST
    {
        shown.push(enlarged(&frame));
    }
    let Some(first) = shown.first() else { return Ok(()) };
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    let (width, height) = first.size();
    printer.data(&format!(
        "\nTable 1: a frame of the film at {width}×{height} px, ms (medians of {frames}; cpu, {threads} threads), one map drawn a \
         frame\n{:>7}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>10}{:>9}{:>12}{:>9}",
        "lights", "pose", "light", "maps", "shadow", "object", "all", "frames/s", "÷ none", "paper fps", "÷ none"
    ));
    let mut none = 0.0;
    for (count, texels, paper) in TABLE_1 {
        let mut pipeline = workspace.pipeline.clone();
        pipeline.live.focal_px *= ENLARGED as f64;
        pipeline.live.most_lights = Some(count);
        pipeline.live.maps_per_frame = 1;
        let splits = if count > 192 { SPLITS } else { 0 };
        pipeline.render =
            Render { dome_texels: texels, dome_splits: splits, dome_centroid: true, ..pipeline.render };
        let workspace = Workspace { pipeline, ..workspace.clone() };
        let mut live = session(&workspace, (width, height), None)?;
        let (mut parts, mut lights) = ([(); 6].map(|()| Vec::new()), 0);
        for (i, frame) in shown.iter().enumerate() {
            let output = live.frame(frame, None).doing("putting the object into the film")?;
            let t = output.timing;
            let times = [t.pose, t.light, t.maps, t.shadow, t.object];
            if i >= FIRST {
                parts.iter_mut().zip(times).for_each(|(part, ms)| part.push(ms));
                parts[5].push(times.iter().sum());
            }
            lights = lights.max(output.lights);
        }
        let ms = parts.each_mut().map(|p| spread(p)[0]);
        if count == 0 {
            none = ms[5];
        }
        let rate = paper.parse::<f64>().map_or(String::new(), |fps| format!("{:.2}", 35.0 / fps));
        let cells: String = ms.iter().map(|ms| format!("{ms:>9.1}")).collect();
        printer.data(&format!(
            "{lights:>7}{cells}{:>10.1}{:>9.2}{paper:>12}{rate:>9}",
            1e3 / ms[5],
            ms[5] / none
        ));
    }
    Ok(())
}

fn enlarged(frame: &CodeImage) -> CodeImage {
    let linear = frame.map(|c| crate::image::Radiance(c.0));
    let at = |i: usize| (i as f64 + 0.5) / ENLARGED as f64;
    Image::from_fn(ENLARGED * frame.width(), ENLARGED * frame.height(), |x, y| {
        Code(linear.bilinear(at(x), at(y)).0)
    })
}

/// Figure 6, in numbers.
fn quality(subject: &Subject, frames: usize, printer: &Printer) -> Result<()> {
    let reference = subject.traced(REFERENCE, subject.settings.seed ^ 0x5eed)?;
    printer.data(&format!(
        "\n{}: relative shadow error and energy bias against {REFERENCE} rays a pixel (noise {:.3}); ms, medians of {frames} frames",
        subject.name,
        reference.noise.unwrap_or(0.0)
    ));
    printer.data(&format!(
        "{:<10}{:<22}{:>8}{:>9}{:>9}{:>9}{:>10}{:>9}{:>9}{:>9}",
        "a face", "lights", "number", "ms", "error", "bias %", "infinity:", "ms", "error", "bias %"
    ));
    for texels in TEXELS {
        for (name, centroid, splits) in [
            ("in the middle (paper)", false, 0),
            ("at centroids", true, 0),
            ("and brightest split", true, SPLITS),
        ] {
            let mut cells = String::new();
            for dome_at_infinity in [false, true] {
                let settings = Render {
                    method: ShadowMethod::LightDome,
                    dome_texels: texels,
                    dome_centroid: centroid,
                    dome_splits: splits,
                    dome_at_infinity,
                    ..subject.settings.clone()
                };
                let mut session =
                    Session::prepare(&subject.scene, &settings).doing("preparing the shadow method")?;
                let mut frame = || session.frame(&subject.occluder).doing("finding the shadow");
                let removed = frame()?.removed;
                let mut ms = (0..frames).map(|_| Ok(1e3 * frame()?.seconds)).collect::<Result<Vec<_>>>()?;
                let (error, bias) = subject.errors(&removed.epsilon, &reference.epsilon);
                if dome_at_infinity {
                    cells += &format!("{:>10}", "");
                } else {
                    cells += &format!("{:>8}", removed.sources_used);
                }
                cells += &format!("{:>9.1}{error:>9.3}{:>+9.1}", spread(&mut ms)[0], 100.0 * bias);
            }
            printer.data(&format!("{:<10}{name:<22}{cells}", format!("{texels}×{texels}")));
        }
    }
    Ok(())
}

/// Runs a film through; gives the frames shown.
fn film(workspace: &Workspace, name: &str, printer: &Printer) -> Result<Vec<CodeImage>> {
    let mut film = Film::open(workspace)?;
    let (mut live, mut shown, mut ms, mut lights) = (None, Vec::new(), Vec::new(), 0);
    let mut count = 0;
    while let Some((frame, other)) = film.next()? {
        if live.is_none() {
            live = Some(session(workspace, frame.size(), other.as_ref().map(CodeImage::size))?);
        }
        let Some(live) = &mut live else { continue };
        let output = live.frame(&frame, other.as_ref()).doing("putting the object into the film")?;
        let t = output.timing;
        ms.push(t.pose + t.light + t.maps + t.shadow + t.object);
        lights = lights.max(output.lights);
        if SHOWN.contains(&count) {
            shown.push(output.picture);
        }
        count += 1;
    }
    printer.data(&format!(
        "\n{name}: {count} frames, up to {lights} lights, {:.1} ms a frame",
        if ms.is_empty() { 0.0 } else { spread(&mut ms)[0] }
    ));
    Ok(shown)
}

//! The experiments of supan2006: time against the number of lights (Table 1) on a film, quality against it (Figure 6) on the
//! captures named and in a lobby, each plain, with lights at centroids and with bright texels split; the film beside its truth.

mod film;
mod quality;

use self::film::{SHOWN, film, series, truth_of, with_lights};
use self::quality::quality;
use super::subject::{LobbyTransfers, Subject};
use super::triptych::write_sheet;
use super::{Static, spread};
use crate::composite::write_png;
use crate::driver::live::{Film, session};
use crate::driver::run::{self, Range};
use crate::driver::validate;
use crate::error::{Context as _, Result};
use crate::image::{Code, CodeImage, Image};
use crate::printer::Printer;
use crate::stage::Workspace;
use std::path::{Path, PathBuf};

/// Lights, and what the paper's Table 1 prints, frames/s (GeForce 7800 GT).
const TABLE_1: [(usize, usize, &str); 6] =
    [(0, 4, "35"), (8, 4, "32"), (48, 4, "21"), (64, 8, "15"), (192, 8, ""), (240, 8, "")];
/// Frames of the film are enlarged for Table 1: to 800×600 from 400×300 px.
const ENLARGED: usize = 2;
/// Frames timed after the first ones, in which all maps are drawn.
const FIRST: usize = 2;
const SPLITS: usize = 16;

/// Prints what the settings files are good for: those with markers are films, the others captures.
pub(super) fn print(
    settings: &[PathBuf],
    frames: usize,
    pictures: Option<&Path>,
    printer: &Printer,
) -> Result<()> {
    let mut strip: Vec<Vec<CodeImage>> = Vec::new();
    let mut timed = false;
    let mut sheet: Vec<Vec<(String, CodeImage)>> = Vec::new();
    for file in settings {
        let workspace = Workspace::open(file)?;
        if workspace.pipeline.live.board.is_none() && workspace.pipeline.live.markers.is_empty() {
            run::stages(&workspace, &Range::default(), printer)?;
            let statics = Static::read(&workspace)?;
            let name = validate::name(file);
            let subject = Subject::capture(name, &statics, &workspace.pipeline.render);
            sheet.push(quality(&subject, frames, printer)?);
            continue;
        }
        if !timed {
            times(&workspace, frames, printer)?;
            let lobby = LobbyTransfers::new(2000, 320)?;
            quality(&Subject::lobby(&lobby), frames, printer)?;
            sheet.splice(0..0, series(&workspace, file, printer)?);
            timed = true;
        }
        strip.push(film(&workspace, &validate::name(file), printer)?);
    }
    let Some(folder) = pictures else { return Ok(()) };
    let path = folder.join("dome_lights.jpg");
    write_sheet(&path, &sheet)?;
    printer.data(&path.display().to_string());
    let Some(first) = strip.first() else { return Ok(()) };
    let truth = SHOWN.map(|i| truth_of(&settings[settings.len() - 1], i));
    let mut columns: Vec<Vec<CodeImage>> = Vec::new();
    if let [Some(a), Some(b)] = truth {
        columns.push(vec![a, b]);
    }
    columns.extend(strip.iter().cloned());
    let (w, h) = first[0].size();
    let strip =
        Image::from_fn(columns.len() * w, SHOWN.len() * h, |x, y| *columns[x / w][y / h].at(x % w, y % h));
    let path = folder.join("dome.png");
    write_png(&path, &strip)?;
    printer.data(&path.display().to_string());
    Ok(())
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
        let mut workspace = with_lights(workspace, count, texels);
        workspace.pipeline.live.focal_px *= ENLARGED as f64;
        workspace.pipeline.live.maps_per_frame = 1;
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

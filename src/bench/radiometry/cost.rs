//! Time and memory on large frames, each program in a process of its own.

use super::subject::Subject;
use crate::bench::spread;
use crate::config;
use crate::error::{Context as _, Error, FileContext, Result};
use crate::exposure::{Frame, Room, Stored, decode_each};
use crate::merge::{Problem, ROOM, merge_in_bands};
use crate::printer::Printer;
use crate::response::{Sampled, fit_sampled};
use crate::stage::{cpu_time_s, peak_memory_mib};
use crate::vision::hdr::{Exposures, Method};
use image::{ExtendedColorType, ImageEncoder, RgbImage, codecs::jpeg::JpegEncoder, imageops};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

const FRAMES: usize = 10;
const SIZE: (u32, u32) = (4000, 3000);
const DOING: &str = "timing large frames";
const LIST: &str = "exposures.txt";

/// The programs, by the names that [`merge_cost`] knows; how often each runs.
const PROGRAMS: [&str; 2] = ["insitu", "opencv-debevec"];
const RUNS: usize = 3;

/// Prints a line for each program: seconds by the clock and of the processor, and peak memory, from JPEG files to radiance, medians
/// of runs in turn; and what they are against OpenCV's `CalibrateDebevec` and `MergeDebevec`.
pub(super) fn print(subject: &Subject, printer: &Printer) -> Result<()> {
    let folder = tempfile::tempdir().at(DOING, Path::new("a temporary folder"))?;
    enlarge(subject, folder.path())?;
    printer.data(&format!(
        "\n{}: {FRAMES} frames enlarged to {}×{} px, from JPEG files to radiance; each {RUNS} times in a process of its own, in turn\n{:<16}{:>20}{:>8}{:>14}{:>8}{:>12}{:>8}",
        subject.name, SIZE.0, SIZE.1, "", "s", "ratio", "processor, s", "ratio", "peak, MiB", "ratio"
    ));
    let mut costs: [[Vec<f64>; 3]; PROGRAMS.len()] = Default::default();
    for _ in 0..RUNS {
        for (program, cost) in PROGRAMS.iter().zip(&mut costs) {
            cost.iter_mut().zip(measured(program, folder.path())?).for_each(|(all, one)| all.push(one));
        }
    }
    let costs = costs.map(|cost| cost.map(|mut all| spread(&mut all)));
    for (program, cost) in PROGRAMS.iter().zip(&costs) {
        let [[s, least, most], [processor, ..], [memory, ..]] = *cost;
        let ratio = |k: usize| cost[k][0] / costs[1][k][0];
        printer.data(&format!(
            "{program:<16}{:>20}{:>8.2}{processor:>14.1}{:>8.2}{memory:>12.0}{:>8.2}",
            format!("{s:.1} ({least:.1}–{most:.1})"),
            ratio(0),
            ratio(1),
            ratio(2)
        ));
    }
    Ok(())
}

/// Seconds, processor's seconds and MiB of a program's run.
fn measured(program: &str, folder: &Path) -> Result<[f64; 3]> {
    let own = std::env::current_exe().at(DOING, folder)?;
    let output = Command::new(&own).args(["merge-cost", program]).arg(folder).output().at(DOING, &own)?;
    let text = String::from_utf8_lossy(&output.stdout);
    let numbers: Vec<f64> = text.split_whitespace().filter_map(|w| w.parse().ok()).collect();
    numbers[..].try_into().map_err(|_| {
        Error::Bug(format!("{program} told no cost: {}", String::from_utf8_lossy(&output.stderr).trim()))
    })
}

fn enlarge(subject: &Subject, folder: &Path) -> Result<()> {
    let mut list = String::new();
    for (i, (image, exposure)) in
        subject.images.iter().zip(&subject.exposures).cycle().take(FRAMES).enumerate()
    {
        let bytes = image.pixels().iter().flat_map(|p| p.0.map(|v| (v * 255.0).round() as u8)).collect();
        let small = RgbImage::from_raw(image.width() as u32, image.height() as u32, bytes);
        let small = small.ok_or_else(|| Error::Bug("a frame has another size than it says".into()))?;
        let large = imageops::resize(&small, SIZE.0, SIZE.1, imageops::FilterType::Triangle);
        let path = folder.join(format!("{i}.jpg"));
        let file = std::io::BufWriter::new(std::fs::File::create(&path).at(DOING, &path)?);
        JpegEncoder::new_with_quality(file, 95)
            .write_image(large.as_raw(), SIZE.0, SIZE.1, ExtendedColorType::Rgb8)
            .map_err(|e| Error::file(DOING, &path, e, "free some disk space"))?;
        list += &format!("{exposure}\n");
    }
    let path = folder.join(LIST);
    std::fs::write(&path, list).at(DOING, &path)
}

/// One program's cost on a folder that [`print`] has filled: seconds, processor's seconds, MiB.
pub(in crate::bench) fn merge_cost(program: &str, folder: &Path, printer: &Printer) -> Result<()> {
    let list = folder.join(LIST);
    let text = std::fs::read_to_string(&list).at(DOING, &list)?;
    let exposures = text.lines().filter_map(|l| l.parse::<f64>().ok());
    let files: Vec<(PathBuf, f64)> =
        exposures.enumerate().map(|(i, e)| (folder.join(format!("{i}.jpg")), e)).collect();
    let (started, before) = (Instant::now(), cpu_time_s());
    match program {
        "insitu" => ours(&files)?,
        "opencv-debevec" => theirs(&files)?,
        other => {
            return Err(Error::Usage {
                problem: format!("no program `{other}`"),
                hint: format!("one of {}", PROGRAMS.join(", ")),
            });
        }
    }
    let seconds = started.elapsed().as_secs_f64();
    printer.data(&format!("{seconds} {} {}", cpu_time_s() - before, peak_memory_mib()));
    Ok(())
}

fn ours(files: &[(PathBuf, f64)]) -> Result<()> {
    let (paths, exposures): (Vec<PathBuf>, Vec<f64>) = files.iter().cloned().unzip();
    let room = Room::new(ROOM);
    let read = |i: usize, stored: Stored| {
        let sampled = Sampled::new(&Frame { codes: &stored, exposure: exposures[i] }).at(DOING, &paths[i])?;
        Ok((room.keep(stored).at(DOING, &paths[i])?, sampled))
    };
    let (kept, sampled): (Vec<_>, Vec<_>) = decode_each(&paths, read, || ())?.into_iter().unzip();
    let response = fit_sampled(&sampled, &config::Response::default()).doing("fitting the response")?;
    let frames: Vec<Frame> = (kept.iter().zip(&response.exposures))
        .map(|(codes, e)| Frame { codes: codes.as_ref(), exposure: e.used })
        .collect();
    let take = |band: crate::merge::Band| {
        std::hint::black_box(band.merged.radiance.pixels());
        Ok::<_, Problem>(())
    };
    merge_in_bands(&frames, &response, 1.0, &config::Merge::default(), take).doing("merging")?;
    Ok(())
}

fn theirs(files: &[(PathBuf, f64)]) -> Result<()> {
    let files: Vec<(&Path, f64)> = files.iter().map(|(p, e)| (p.as_path(), *e)).collect();
    let exposures = Exposures::read(&files).doing("reading by OpenCV")?;
    std::hint::black_box(exposures.merge_for_cost(Method::Debevec).doing("merging by OpenCV")?);
    Ok(())
}

//! A folder of exposures without settings.

use super::subject::Subject;
use crate::error::{Error, FileContext, Result};
use crate::exposure::{self, Exposure, Header, Photograph, decode};
use crate::image::{Code, CodeImage, Image};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const DOING: &str = "reading a folder of exposures";

/// The exposures of a folder; of the folders in it, where it has no photographs of its own.
pub(super) fn subjects(folder: &Path) -> Result<Vec<Subject>> {
    let mut names = exposure::list(folder)?;
    names.retain(|name| exposure::is_readable(name.as_ref()));
    let mut by_folder: BTreeMap<PathBuf, Vec<PathBuf>> = BTreeMap::new();
    for name in &names {
        let path = folder.join(name);
        by_folder.entry(path.parent().unwrap_or(folder).to_path_buf()).or_default().push(path);
    }
    let subjects: Vec<Subject> = by_folder
        .iter()
        .map(|(folder, files)| subject(folder, files))
        .filter_map(Result::transpose)
        .collect::<Result<_>>()?;
    if subjects.is_empty() {
        return Err(Error::file(
            DOING,
            folder,
            "holds no two exposures of one view",
            "name a folder of bracketed photographs",
        ));
    }
    Ok(subjects)
}

/// Exposures stated by EXIF, by a list of HDRShop's, or by names that are times (`1:30.jpg`, `0.4.jpg`), s.
fn subject(folder: &Path, files: &[PathBuf]) -> Result<Option<Subject>> {
    let listed = hdrshop_list(folder)?;
    let mut members: Vec<(PathBuf, Header, f64)> = Vec::new();
    let mut published = Vec::new();
    for path in files {
        let header = Header::read(path)?;
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if header.linear {
            published.push(path.clone());
            continue;
        }
        let of_exif = || {
            let exposure = Exposure {
                time_s: header.time_s?,
                f_number: header.f_number.unwrap_or(1.0),
                iso: header.iso.unwrap_or(100.0),
            };
            Some(exposure.scale())
        };
        if let Some(exposure) = listed.get(&stem).copied().or_else(of_exif).or_else(|| time_of(&stem)) {
            members.push((path.clone(), header, exposure));
        }
    }
    let members = one_view(members);
    if members.len() < 2 {
        return Ok(None);
    }
    let mut remarks = Vec::new();
    let sizes = members.iter().map(|(_, h, _)| h.upright_size());
    let size = sizes.clone().fold((u32::MAX, u32::MAX), |a, b| (a.0.min(b.0), a.1.min(b.1)));
    if sizes.clone().any(|s| s != size) {
        remarks.push(format!("crops of several sizes, scaled to {}×{} px", size.0, size.1));
    }
    let images = members.iter().map(|(path, ..)| Ok(scaled(&decode(path)?.codes(path)?, size)));
    let images = images.collect::<Result<Vec<_>>>()?;
    let mut reference = None;
    for path in published {
        match decode(&path)? {
            Photograph::Linear(image) if image.size() == images[0].size() => reference = Some(image),
            _ => {}
        }
    }
    let parts: Vec<_> =
        folder.components().rev().take(2).map(|c| c.as_os_str().to_string_lossy().into_owned()).collect();
    let short = parts.first().map_or(String::new(), Clone::clone);
    Ok(Some(Subject {
        name: short,
        files: members.iter().map(|(p, ..)| p.clone()).collect(),
        exposures: members.iter().map(|(_, _, e)| *e).collect(),
        images,
        truth: None,
        published: reference,
        remarks,
    }))
}

/// The photographs most alike in size, of distinct exposures: others show something else.
fn one_view(members: Vec<(PathBuf, Header, f64)>) -> Vec<(PathBuf, Header, f64)> {
    // Crops of one thing differ by a few per cent.
    let alike = |a: &Header, b: &Header| {
        let (a, b) = (a.upright_size(), b.upright_size());
        a.0.abs_diff(b.0) * 12 < a.0.max(b.0) && a.1.abs_diff(b.1) * 12 < a.1.max(b.1)
    };
    let group = |first: &(PathBuf, Header, f64)| -> Vec<(PathBuf, Header, f64)> {
        members.iter().filter(|m| alike(&first.1, &m.1)).cloned().collect()
    };
    members.iter().map(group).max_by_key(Vec::len).unwrap_or_default()
}

/// Bilinear, for crops that differ by a few pixels.
fn scaled(image: &CodeImage, (width, height): (u32, u32)) -> CodeImage {
    let (w, h) = image.size();
    if (w, h) == (width as usize, height as usize) {
        return image.clone();
    }
    let at = |i: usize, from: usize, to: usize| {
        let x = ((i as f32 + 0.5) * from as f32 / to as f32 - 0.5).clamp(0.0, (from - 1) as f32);
        (x as usize, (x as usize + 1).min(from - 1), x.fract())
    };
    Image::from_fn(width as usize, height as usize, |x, y| {
        let ((x0, x1, a), (y0, y1, b)) = (at(x, w, width as usize), at(y, h, height as usize));
        let mix = |p: &Code, q: &Code, t: f32| Code(std::array::from_fn(|k| p.0[k] * (1.0 - t) + q.0[k] * t));
        mix(&mix(image.at(x0, y0), image.at(x1, y0), a), &mix(image.at(x0, y1), image.at(x1, y1), a), b)
    })
}

/// Exposure by stem from a list as HDRShop writes it: name, 1/time, f-stop, gain in dB (3 dB double), ND stops.
fn hdrshop_list(folder: &Path) -> Result<BTreeMap<String, f64>> {
    let mut listed = BTreeMap::new();
    for entry in std::fs::read_dir(folder).at(DOING, folder)? {
        let path = entry.at(DOING, folder)?.path();
        if !path.to_string_lossy().ends_with("hdr_image_list.txt") {
            continue;
        }
        let text = std::fs::read_to_string(&path).at(DOING, &path)?;
        for line in text.lines().filter(|l| !l.starts_with('#')) {
            let words: Vec<&str> = line.split_whitespace().collect();
            let [name, numbers @ ..] = words.as_slice() else { continue };
            let numbers: Vec<f64> = numbers.iter().filter_map(|w| w.parse().ok()).collect();
            if let [speed, f_number, gain, nd] = numbers[..] {
                let stem = Path::new(name).file_stem().unwrap_or_default().to_string_lossy().into_owned();
                listed.insert(stem, (gain / 3.0 - nd).exp2() / speed / (f_number * f_number));
            }
        }
    }
    Ok(listed)
}

/// `1:30` and `1_30` are 1/30 s, `0.4` and `15` are seconds.
fn time_of(stem: &str) -> Option<f64> {
    let time = match stem.split_once([':', '_']) {
        Some((a, b)) => a.parse::<f64>().ok()? / b.parse::<f64>().ok()?,
        None => stem.parse().ok()?,
    };
    (time.is_finite() && time > 0.0).then_some(time)
}

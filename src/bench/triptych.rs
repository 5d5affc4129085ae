//! Pictures side by side, labelled: truth, ours and their difference, or any.

use super::truth::Verdict;
use crate::composite::view;
use crate::error::{Error, FileContext, Result};
use crate::evaluate::errors::difference;
use crate::evaluate::{error_map, range};
use crate::image::{Code, CodeImage, Image};
use font8x8::UnicodeFonts;
use std::path::Path;

/// Height of the band with the labels, px.
const BAND_PX: usize = 24;
/// Letters are drawn so many times their 8×8 bits.
const LETTER: usize = 2;
/// The difference's ends of scale, as a share of the deepest removal.
const AMPLIFIED: f32 = 0.25;
/// JPEG quality.
const QUALITY: u8 = 80;

/// Writes a JPEG; `encode` maps radiance to display codes.
pub(super) fn write(
    path: &Path,
    name: &str,
    verdict: &Verdict,
    encode: impl Fn([f32; 3]) -> [f32; 3],
) -> Result<()> {
    let comparison = &verdict.comparison;
    let truth = &comparison.with;
    // ε* = B − T; B − T + (T − C) is ours, whose error is known: its range is that of the shadow.
    let in_region = |image: &crate::image::RadianceImage| {
        let (w, h) = image.size();
        Image::from_fn(w, h, |x, y| {
            if *comparison.shadow_region.at(x, y) { *image.at(x, y) } else { Default::default() }
        })
    };
    let shadow = range(&in_region(&difference(&verdict.plate, truth)));
    let most = AMPLIFIED * shadow;
    let pictures = [
        (format!("{name}: truth"), view(truth, 0.0, &encode)),
        ("ours".to_string(), view(&verdict.composite, 0.0, &encode)),
        (
            format!("red too dark, blue too light, +-{most:.3}"),
            error_map(&difference(truth, &verdict.composite), most).image,
        ),
    ];
    write_sheet(path, &[pictures.into()])
}

/// Writes rows of labelled pictures, all of one size, as a JPEG.
pub(super) fn write_sheet(path: &Path, rows: &[Vec<(String, CodeImage)>]) -> Result<()> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let Some((w, h)) = rows.first().and_then(|row| Some(row.first()?.1.size())) else { return Ok(()) };
    // Narrow pictures have small letters.
    let longest = rows.iter().flatten().map(|(label, _)| label.len()).max().unwrap_or(0);
    let letter = if 8 * LETTER * longest + 8 <= w { LETTER } else { 1 };
    let mut sheet = Image::from_fn(columns * w, rows.len() * (h + BAND_PX), |_, _| Code([1.0; 3]));
    for (j, row) in rows.iter().enumerate() {
        let top = j * (h + BAND_PX);
        for (k, (label, picture)) in row.iter().enumerate() {
            for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
                *sheet.at_mut(k * w + x, top + BAND_PX + y) = *picture.at(x, y);
            }
            draw(&mut sheet, label, (k * w + 4, top + (BAND_PX - 8 * letter) / 2), (k + 1) * w, letter);
        }
    }
    std::fs::write(path, jpeg(&sheet)?).at("writing", path)
}

/// Draws text from the left upper corner on, as far as `end`.
fn draw(sheet: &mut CodeImage, text: &str, (left, top): (usize, usize), end: usize, scale: usize) {
    for (n, letter) in text.chars().enumerate() {
        let Some(rows) = font8x8::BASIC_FONTS.get(letter) else { continue };
        for (y, row) in rows.iter().enumerate() {
            for x in (0..8).filter(|x| row >> x & 1 == 1) {
                for (dy, dx) in (0..scale).flat_map(|dy| (0..scale).map(move |dx| (dy, dx))) {
                    let (px, py) = (left + (8 * n + x) * scale + dx, top + y * scale + dy);
                    if px < end && py < sheet.height() {
                        *sheet.at_mut(px, py) = Code([0.0; 3]);
                    }
                }
            }
        }
    }
}

fn jpeg(sheet: &CodeImage) -> Result<Vec<u8>> {
    let bytes: Vec<u8> =
        sheet.pixels().iter().flat_map(|p| p.0.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8)).collect();
    let mut out = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut out, QUALITY);
    encoder
        .encode(&bytes, sheet.width() as u32, sheet.height() as u32, image::ExtendedColorType::Rgb8)
        .map_err(|e| Error::Bug(format!("encoding a JPEG: {e}")))?;
    Ok(out)
}

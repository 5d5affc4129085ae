//! Pixels of a photograph, turned upright.

use super::header::{Header, supported};
use super::raw;
use super::{Photograph, Rows, Samples, Stored, no_codes};
use crate::artefact::exr;
use crate::error::{Error, FileContext, Result};
use crate::image::{Image, Radiance};
use image::metadata::Orientation;
use image::{DynamicImage, ImageFormat, ImageReader};
use std::path::Path;

const DOING: &str = "decoding a photograph";
const COPY_AGAIN: &str = "copy the file again from the camera, or leave it out of the roles";

/// Decodes JPEG, PNG and TIFF of 8 or 16 bits and cameras' RAW files to codes, Radiance HDR, OpenEXR and float TIFF to linear radiance. Grey
/// is taken as equal R, G, B. EXIF orientation is applied.
pub fn decode(path: &Path) -> Result<Photograph> {
    if is_exr(path) {
        return exr::read_radiance(path).map(Photograph::Linear);
    }
    let (image, header) = upright(path)?;
    if !header.linear {
        let whole = |stored: Stored| stored.rows(0..stored.height).at(DOING, path);
        return whole(stored(image, &header)).map(Photograph::Codes);
    }
    let (width, height) = (image.width() as usize, image.height() as usize);
    let rgb = image.into_rgb32f();
    let pixels: Vec<_> = rgb.pixels().map(|p| Radiance(p.0)).collect();
    if let Some(i) = pixels.iter().position(|p| p.0.iter().any(|v| !v.is_finite())) {
        let problem = format!("is {:?} at pixel ({}, {})", pixels[i].0, i % width, i / width);
        return Err(Error::file(DOING, path, problem, "every sample must be a finite number"));
    }
    Ok(Photograph::Linear(Image::from_pixels(width, height, pixels)))
}

/// Decodes a photograph to codes as its file holds them, which need less memory; a linear picture is refused.
pub fn decode_stored(path: &Path) -> Result<Stored> {
    if is_exr(path) {
        return Err(no_codes(path));
    }
    let (image, header) = upright(path)?;
    if header.linear { Err(no_codes(path)) } else { Ok(stored(image, &header)) }
}

fn is_exr(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("exr"))
}

fn stored(image: DynamicImage, header: &Header) -> Stored {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let samples = if header.bits > 8 {
        Samples::Sixteen(image.into_rgb16().into_raw())
    } else {
        Samples::Eight(image.into_rgb8().into_raw())
    };
    Stored { width, height, samples }
}

/// The whole picture with its header.
fn upright(path: &Path) -> Result<(DynamicImage, Header)> {
    let (mut image, header) = if raw::is_raw(path) { raw::developed(path)? } else { stored_picture(path)? };
    image.apply_orientation(Orientation::from_exif(header.orientation).unwrap_or(Orientation::NoTransforms));
    Ok((image, header))
}

/// The picture as its file holds it.
fn stored_picture(path: &Path) -> Result<(DynamicImage, Header)> {
    let header = Header::read(path)?;
    let bytes = std::fs::read(path).at(DOING, path)?;
    let reader = ImageReader::new(std::io::Cursor::new(&bytes)).with_guessed_format().at(DOING, path)?;
    let format = supported(reader.format(), path)?;
    // The JPEG decoder fills what is missing with grey and says nothing.
    if format == ImageFormat::Jpeg && !jpeg_is_whole(&bytes) {
        return Err(Error::file(
            DOING,
            path,
            "truncated JPEG: the end-of-image marker is missing",
            COPY_AGAIN,
        ));
    }
    let image = reader
        .decode()
        .map_err(|e| Error::file(DOING, path, format!("damaged or cut short ({e})"), COPY_AGAIN))?;
    opaque(&image, path)?;
    Ok((image, header))
}

/// Colour under a transparent pixel means nothing, so alpha can go only where it is 1 everywhere.
fn opaque(image: &DynamicImage, path: &Path) -> Result<()> {
    if !image.color().has_alpha() {
        return Ok(());
    }
    let clear = image.to_rgba16().pixels().filter(|p| p.0[3] < u16::MAX).count();
    if clear == 0 {
        return Ok(());
    }
    let all = image.width() as usize * image.height() as usize;
    let problem = format!("{clear} of {all} pixels are transparent");
    Err(Error::file(DOING, path, problem, "export the photograph without an alpha channel"))
}

/// Whether the end-of-image marker follows the first scan. Within a scan 0xFF is always followed by 0x00 or a restart
/// marker (ITU-T T.81, B.1.1.5); a thumbnail's own marker lies before, within a segment that is skipped.
fn jpeg_is_whole(bytes: &[u8]) -> bool {
    const START_OF_SCAN: u8 = 0xDA;
    const END: u8 = 0xD9;
    let mut at = 2;
    while let Some(&[0xFF, marker, high, low]) = bytes.get(at..at + 4) {
        if marker == 0xFF {
            at += 1; // fill byte
            continue;
        }
        at += 2 + usize::from(u16::from_be_bytes([high, low]));
        if marker == START_OF_SCAN {
            return bytes.get(at..).is_some_and(|scan| scan.windows(2).any(|w| w == [0xFF, END]));
        }
    }
    false
}

#[cfg(test)]
mod tests;

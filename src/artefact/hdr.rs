//! Radiance HDR pictures (Ward 1991), for tools that take their environment from one: shared exponents, 8 bits a channel.

use crate::error::{Error, FileContext, Result};
use crate::image::RadianceImage;
use image::Rgb;
use image::codecs::hdr::HdrEncoder;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Writes a picture, top row first.
pub fn write(path: &Path, picture: &RadianceImage) -> Result<()> {
    let doing = "writing a picture";
    let mut file = BufWriter::new(std::fs::File::create(path).at(doing, path)?);
    let pixels: Vec<Rgb<f32>> = picture.pixels().iter().map(|p| Rgb(p.0.map(|v| v.max(0.0)))).collect();
    let (width, height) = picture.size();
    HdrEncoder::new(&mut file)
        .encode(&pixels, width, height)
        .map_err(|e| Error::file(doing, path, e, "check the disk's space"))?;
    file.flush().at(doing, path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Image, Radiance};

    #[test]
    fn twelve_decades_come_back_within_a_step() {
        let picture = Image::from_fn(40, 20, |x, y| Radiance([10f32.powi(x as i32 % 12 - 6), 1.0, y as f32]));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("environment.hdr");
        write(&path, &picture).unwrap();
        let again = image::open(&path).unwrap().into_rgb32f();
        for (p, q) in picture.pixels().iter().zip(again.pixels()) {
            let top = p.0.into_iter().fold(0.0, f32::max);
            assert!((0..3).all(|k| (p.0[k] - q.0[k]).abs() <= top / 128.0), "{p:?} {q:?}");
        }
    }
}

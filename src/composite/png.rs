//! Codes as 8-bit PNG.

use crate::error::{Error, FileContext, Result};
use crate::image::CodeImage;
use std::path::Path;

/// Writes an 8-bit RGB PNG; codes that came from 8 bits come out as they were.
pub fn write_png(path: &Path, image: &CodeImage) -> Result<()> {
    std::fs::write(path, encode_png(image)?).at("writing", path)
}

/// An 8-bit RGB PNG in memory.
pub(crate) fn encode_png(image: &CodeImage) -> Result<Vec<u8>> {
    let bytes: Vec<u8> =
        image.pixels().iter().flat_map(|p| p.0.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8)).collect();
    let mut png = std::io::Cursor::new(Vec::new());
    let (width, height) = (image.width() as u32, image.height() as u32);
    image::write_buffer_with_format(
        &mut png,
        &bytes,
        width,
        height,
        image::ExtendedColorType::Rgb8,
        image::ImageFormat::Png,
    )
    .map_err(|e| Error::Bug(format!("encoding a PNG: {e}")))?;
    Ok(png.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Code, Image};

    #[test]
    fn eight_bits_come_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        let image = Image::from_fn(16, 16, |x, y| Code([(16 * y + x) as f32 / 255.0, 0.0, 1.0]));
        write_png(&path, &image).unwrap();
        let read = image::open(&path).unwrap().into_rgb8();
        for (i, p) in read.pixels().enumerate() {
            assert_eq!(p.0, [i as u8, 0, 255]);
        }
    }
}

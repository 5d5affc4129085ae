//! What an image file says of itself before its pixels are decoded.

use super::profile::foreign;
use super::raw;
use crate::error::{Error, FileContext, Result};
use exif::{Exif, In, Tag, Value};
use image::{ImageDecoder, ImageFormat, ImageReader};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Size, depth and EXIF of an image file. EXIF numbers stand as they were found, sensible or not.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Header {
    /// Width as stored, px.
    pub width_px: u32,
    /// Height as stored, px.
    pub height_px: u32,
    /// Bits per sample.
    pub bits: u32,
    /// Holds linear radiance (EXR, HDR, float TIFF).
    pub linear: bool,
    /// A camera's RAW file: its codes follow the sRGB curve exactly ([`super::raw`]).
    pub raw: bool,
    /// EXIF orientation, 1 to 8; 1 is upright.
    pub orientation: u8,
    /// Exposure time, s.
    pub time_s: Option<f64>,
    /// f-number.
    pub f_number: Option<f64>,
    /// ISO speed.
    pub iso: Option<f64>,
    /// Focal length, mm.
    pub focal_mm: Option<f64>,
    /// Focal length of the same field of view on 35 mm film, mm.
    pub focal_35mm_mm: Option<f64>,
    /// When it was taken.
    pub date: Option<String>,
    /// Maker and model of the camera.
    pub camera: Option<String>,
    /// Lens.
    pub lens: Option<String>,
    /// Colour profile that it has embedded, where its primaries are not those of sRGB.
    pub profile: Option<String>,
}

const DOING: &str = "reading the header of a photograph";

impl Header {
    /// Reads a header; no pixel is decoded.
    pub fn read(path: &Path) -> Result<Self> {
        let file = File::open(path).at(DOING, path)?;
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("exr")) {
            return exr_header(path);
        }
        if raw::is_raw(path) {
            return raw::header(path);
        }
        let damaged = |e: image::ImageError| {
            Error::file(
                DOING,
                path,
                format!("damaged or cut short ({e})"),
                "copy the file again from the camera",
            )
        };
        let reader = ImageReader::new(BufReader::new(file)).with_guessed_format().at(DOING, path)?;
        let format = supported(reader.format(), path)?;
        let mut decoder = reader.into_decoder().map_err(damaged)?;
        // A profile that cannot be read is as good as none.
        let profile = decoder.icc_profile().ok().flatten().and_then(|icc| foreign(&icc));
        let (width_px, height_px) = decoder.dimensions();
        let colour = decoder.color_type();
        let bits = 8 * u32::from(colour.bytes_per_pixel()) / u32::from(colour.channel_count());
        let header = Self {
            width_px,
            height_px,
            bits,
            linear: format == ImageFormat::Hdr || bits == 32,
            orientation: 1,
            profile,
            ..Self::default()
        };
        let mut file = BufReader::new(File::open(path).at(DOING, path)?);
        let exif = exif::Reader::new()
            .continue_on_error(true)
            .read_from_container(&mut file)
            .or_else(|e| e.distill_partial_result(|_| {}));
        // A file without EXIF, or with none that can be read, is a photograph all the same.
        Ok(exif.map_or(header.clone(), |exif| header.with_exif(&exif)))
    }

    /// `(width, height)` once turned upright, px.
    pub fn upright_size(&self) -> (u32, u32) {
        match self.orientation {
            5..=8 => (self.height_px, self.width_px),
            _ => (self.width_px, self.height_px),
        }
    }

    fn with_exif(mut self, exif: &Exif) -> Self {
        let value = |tag| exif.get_field(tag, In::PRIMARY).map(|f| &f.value);
        let number = |tag| value(tag).and_then(number);
        let text = |tag| value(tag).and_then(text);
        // APEX values (EXIF 2.3, annex C) stand in where the plain ones are missing.
        let apex_time = || number(Tag::ShutterSpeedValue).map(|tv| (-tv).exp2());
        let apex_aperture = || number(Tag::ApertureValue).map(|av| (av / 2.0).exp2());
        self.time_s = number(Tag::ExposureTime).or_else(apex_time);
        // Lenses without contacts write 0.
        self.f_number = number(Tag::FNumber).or_else(apex_aperture).filter(|n| *n > 0.0);
        self.iso = number(Tag::PhotographicSensitivity).filter(|s| *s > 0.0);
        self.focal_mm = number(Tag::FocalLength).filter(|f| *f > 0.0);
        self.focal_35mm_mm = number(Tag::FocalLengthIn35mmFilm).filter(|f| *f > 0.0);
        let orientation = number(Tag::Orientation).unwrap_or(1.0);
        self.orientation = if (1.0..=8.0).contains(&orientation) { orientation as u8 } else { 1 };
        self.date = text(Tag::DateTimeOriginal);
        self.lens = text(Tag::LensModel);
        let camera: Vec<_> = [text(Tag::Make), text(Tag::Model)].into_iter().flatten().collect();
        self.camera = (!camera.is_empty()).then(|| camera.join(" "));
        self
    }
}

/// BLAKE3 of what `ingest` takes from an image file: its size, bit depth and EXIF. Pixels do not enter.
pub fn header_digest(path: &Path) -> Result<String> {
    Header::read(path)?.digest()
}

impl Header {
    /// BLAKE3 of this header.
    pub fn digest(&self) -> Result<String> {
        let text = serde_json::to_vec(self).map_err(|e| Error::Bug(e.to_string()))?;
        Ok(blake3::hash(&text).to_hex().to_string())
    }
}

/// The format, if insitu decodes it.
pub(super) fn supported(format: Option<ImageFormat>, path: &Path) -> Result<ImageFormat> {
    match format {
        Some(f @ (ImageFormat::Jpeg | ImageFormat::Png | ImageFormat::Tiff | ImageFormat::Hdr)) => Ok(f),
        _ => Err(Error::file(
            DOING,
            path,
            "is not a JPEG, PNG, TIFF, Radiance HDR or OpenEXR image",
            "export it as JPEG or 16-bit TIFF, or leave it out of the roles",
        )),
    }
}

fn exr_header(path: &Path) -> Result<Header> {
    let damaged =
        |e: String| Error::file(DOING, path, format!("damaged or cut short ({e})"), "write it again");
    let meta = ::exr::meta::MetaData::read_from_file(path, false).map_err(|e| damaged(e.to_string()))?;
    let layer = meta.headers.first().ok_or_else(|| damaged("no layer".into()))?;
    let (width_px, height_px) = (layer.layer_size.width() as u32, layer.layer_size.height() as u32);
    Ok(Header { width_px, height_px, bits: 32, linear: true, orientation: 1, ..Header::default() })
}

fn number(value: &Value) -> Option<f64> {
    let number = match value {
        Value::Rational(v) => v.first()?.to_f64(),
        Value::SRational(v) => v.first()?.to_f64(),
        Value::Double(v) => *v.first()?,
        Value::Float(v) => f64::from(*v.first()?),
        _ => f64::from(value.get_uint(0)?),
    };
    // 0/0 is how some cameras write "unknown"; it says as little as 0.
    Some(if number.is_finite() { number } else { 0.0 })
}

fn text(value: &Value) -> Option<String> {
    let Value::Ascii(lines) = value else { return None };
    let text = String::from_utf8_lossy(lines.first()?).trim_matches(['\0', ' ']).to_string();
    (!text.is_empty()).then_some(text)
}

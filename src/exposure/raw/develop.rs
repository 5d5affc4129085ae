//! RAW files through rawler.

use crate::error::{Error, Result};
use crate::exposure::Header;
use crate::response::Response;
use image::{DynamicImage, ImageBuffer, Rgb};
use nalgebra::Matrix3;
use rawler::decoders::{Decoder, RawDecodeParams};
use rawler::formats::tiff::Rational;
use rawler::imgop::chromatic_adaption::adapt_bradford;
use rawler::imgop::develop::{Intermediate, ProcessingStep, RawDevelop};
use rawler::imgop::xyz::Illuminant;
use rawler::imgop::{Dim2, sensor::SensorType};
use rawler::rawimage::{BlackLevel, RawPhotometricInterpretation, WhiteLevel};
use rawler::rawsource::RawSource;
use rawler::{RawImage, RawlerError};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// Readings from this share of the white level on count as saturated.
const SATURATED: f32 = 0.99;
/// So far interpolation carries a saturated reading, px.
const REACH: usize = 2;
/// XYZ of D65 white 1 from linear Rec. 709 (IEC 61966-2-1).
const XYZ_FROM_REC709: [[f64; 3]; 3] =
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]];
/// Illuminants of cameras' matrices, the nearest to D65 first.
const ILLUMINANTS: [Illuminant; 7] = [
    Illuminant::D65,
    Illuminant::D55,
    Illuminant::D50,
    Illuminant::D75,
    Illuminant::C,
    Illuminant::B,
    Illuminant::A,
];

/// rawler panics where a file is none that it knows: that is an error like any other.
pub(super) fn guarded<T>(
    doing: &str,
    path: &Path,
    f: impl FnOnce(&Path) -> std::result::Result<T, String>,
) -> Result<T> {
    let outcome = catch_unwind(AssertUnwindSafe(|| f(path)));
    outcome.unwrap_or_else(|_| Err("rawler cannot make sense of it".into())).map_err(|problem| {
        let hint =
            "copy the file again from the camera, or develop all photographs alike to 16-bit TIFF in sRGB";
        Error::file(doing, path, problem, hint)
    })
}

fn said(e: RawlerError) -> String {
    e.to_string()
}

fn opened(path: &Path) -> std::result::Result<(RawSource, Box<dyn Decoder>), String> {
    let source = RawSource::new(path).map_err(|e| e.to_string())?;
    let decoder = rawler::get_decoder(&source).map_err(said)?;
    Ok((source, decoder))
}

pub(super) fn header(path: &Path) -> std::result::Result<Header, String> {
    let (source, decoder) = opened(path)?;
    let all = RawDecodeParams::default();
    let raw = decoder.raw_image(&source, &all, true).map_err(said)?;
    let about = decoder.raw_metadata(&source, &all).map_err(said)?;
    let exif = about.exif;
    let Dim2 { w, h } = raw.crop_area.or(raw.active_area).map_or(raw.dim(), |area| area.d);
    let number = |r: &Rational| f64::from(r.n) / f64::from(r.d);
    let positive = |v: f64| (v.is_finite() && v > 0.0).then_some(v);
    let iso = exif.iso_speed.or(exif.recommended_exposure_index);
    let iso = exif.iso_speed_ratings.map(f64::from).filter(|s| *s < 65_535.0).or(iso.map(f64::from));
    let camera = format!("{} {}", about.make, about.model).trim().to_string();
    Ok(Header {
        width_px: w as u32,
        height_px: h as u32,
        bits: 16,
        raw: true,
        orientation: exif.orientation.filter(|o| (1..=8).contains(o)).unwrap_or(1) as u8,
        time_s: exif.exposure_time.as_ref().map(number),
        f_number: exif.fnumber.as_ref().map(number).and_then(positive),
        iso: iso.and_then(positive),
        focal_mm: exif.focal_length.as_ref().map(number).and_then(positive),
        date: exif.date_time_original,
        lens: exif.lens_model,
        camera: (!camera.is_empty()).then_some(camera),
        ..Header::default()
    })
}

pub(super) fn develop(path: &Path) -> std::result::Result<DynamicImage, String> {
    let (source, decoder) = opened(path)?;
    let mut raw = decoder.raw_image(&source, &RawDecodeParams::default(), false).map_err(said)?;
    let known = match &raw.photometric {
        RawPhotometricInterpretation::Cfa(c) => {
            raw.cpp == 1 && c.cfa.is_rgb() && matches!(c.sensor, SensorType::Bayer | SensorType::Xtrans)
        }
        RawPhotometricInterpretation::LinearRaw => raw.cpp == 3,
        RawPhotometricInterpretation::BlackIsZero => false,
    };
    if !known {
        return Err("its sensor has other colours than red, green and blue".into());
    }
    level_channels(&mut raw);
    let (rec709_from_camera, white) = rec709_from_camera(&raw)?;
    let steps = [
        ProcessingStep::Rescale,
        ProcessingStep::Demosaic,
        ProcessingStep::FujiRotate,
        ProcessingStep::CropActiveArea,
        ProcessingStep::CropDefault,
    ];
    let Intermediate::ThreeColor(camera) =
        RawDevelop::new_with(&steps).develop_intermediate(&raw).map_err(said)?
    else {
        return Err("its colours cannot be interpolated".into());
    };
    let (width, height) = (camera.width, camera.height);
    let pixels = camera.pixels();
    let saturated: Vec<bool> = pixels.iter().map(|p| p.iter().any(|v| *v >= SATURATED)).collect();
    let near = |x: usize, y: usize| {
        let columns = x.saturating_sub(REACH)..(x + REACH + 1).min(width);
        (y.saturating_sub(REACH)..(y + REACH + 1).min(height))
            .any(|v| saturated[v * width..][columns.clone()].iter().any(|s| *s))
    };
    let srgb = Response::srgb();
    let code = |x: u32, y: u32| {
        let (x, y) = (x as usize, y as usize);
        if near(x, y) {
            return Rgb([u16::MAX; 3]);
        }
        let p = pixels[y * width + x];
        let balanced = nalgebra::Vector3::from_fn(|c, _| f64::from(p[c]) * white[c]);
        let linear = rec709_from_camera * balanced;
        let codes = srgb.code_of([0, 1, 2].map(|c: usize| linear[c].max(0.0) as f32));
        Rgb(codes.map(|c| (c * 65_535.0).round() as u16))
    };
    Ok(DynamicImage::ImageRgb16(ImageBuffer::from_fn(width as u32, height as u32, code)))
}

/// One black and one white level for all channels, written out for each.
fn level_channels(raw: &mut RawImage) {
    let channels = raw.cpp;
    if let ([black], true) = (&raw.blacklevel.levels[..], channels > 1) {
        raw.blacklevel = BlackLevel::new(&vec![*black; channels], 1, 1, channels);
    }
    if let ([white], true) = (&raw.whitelevel.0[..], channels > 1) {
        raw.whitelevel = WhiteLevel::new(vec![*white; channels]);
    }
}

/// Rec. 709 from the camera's channels in which daylight is white, and the factors that make it so, the least one 1.
fn rec709_from_camera(raw: &RawImage) -> std::result::Result<(Matrix3<f64>, [f64; 3]), String> {
    let (illuminant, flat) =
        raw.color_matrix_find_first(ILLUMINANTS).ok_or("the matrix of its colours is not known")?;
    let rows: Vec<[f32; 3]> = flat.chunks_exact(3).map(|r| [r[0], r[1], r[2]]).collect();
    let rows: [[f32; 3]; 3] = rows.try_into().map_err(|_| "the matrix of its colours is not one of three")?;
    let rows = match illuminant {
        Illuminant::D65 => rows,
        other => adapt_bradford(&other, &Illuminant::D65, &rows),
    };
    let camera_from_xyz = Matrix3::from_fn(|i, j| f64::from(rows[i][j]));
    let camera_from_rec709 = camera_from_xyz * Matrix3::from_fn(|i, j| XYZ_FROM_REC709[i][j]);
    let daylight = [0, 1, 2].map(|i| camera_from_rec709.row(i).sum());
    let most = daylight.iter().copied().fold(0.0, f64::max);
    let balanced = Matrix3::from_fn(|i, j| camera_from_rec709[(i, j)] / daylight[i]);
    match balanced.try_inverse() {
        Some(inverse) if daylight.iter().all(|d| *d > 0.0) => Ok((inverse, daylight.map(|d| most / d))),
        _ => Err("the matrix of its colours cannot be inverted".into()),
    }
}

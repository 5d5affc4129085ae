//! Photographs as files: headers, EXIF exposure, roles, decoding.
//!
//! Stage `ingest` looks at headers and names alone and writes a [`Capture`]; the pixels are decoded by the stages
//! that use them, through [`load`], so that each reruns only when a photograph of its own changes.

mod assemble;
mod decode;
mod guess;
mod header;
mod problem;
mod profile;
mod raw;
mod roles;
mod rows;
mod views;

pub use assemble::assemble;
pub use decode::{decode, decode_stored};
pub use guess::{Seen, guess, look};
pub use header::{Header, header_digest};
pub use problem::{Problem, role_name};
pub use raw::is_readable;
pub use roles::{Assignment, assign, derive, glob, list, listing_digest};
pub use rows::{Room, Rows, Samples, Spooled, Stored, Strip};
pub use views::Thumbnail;

use crate::artefact::json::JsonArtefact;
use crate::config::Role;
use crate::error::{Error, Result};
use crate::image::{CodeImage, RadianceImage};
use crate::stage::Context;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// How much light a photograph gathered. Aperture and speed that are not known, since they did not change, stand
/// as f/1 and ISO 100.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Exposure {
    /// Exposure time, s.
    pub time_s: f64,
    /// f-number.
    pub f_number: f64,
    /// ISO speed.
    pub iso: f64,
}

impl Exposure {
    /// Exposure t · S / N², S = ISO/100: exposure of the sensor for a unit of radiance, up to one constant.
    pub fn scale(&self) -> f64 {
        self.time_s * (self.iso / 100.0) / (self.f_number * self.f_number)
    }
}

/// A photograph as `ingest` knows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Photo {
    /// File name, relative to the folder of the photographs.
    pub file: String,
    /// What it is for.
    pub role: Role,
    /// Width after EXIF orientation, px.
    pub width_px: u32,
    /// Height after EXIF orientation, px.
    pub height_px: u32,
    /// How it was exposed, where known.
    pub exposure: Option<Exposure>,
    /// Focal length, mm.
    pub focal_mm: Option<f64>,
    /// Focal length of the same field of view on 35 mm film, mm.
    pub focal_35mm_mm: Option<f64>,
    /// Holds linear radiance (EXR, HDR) and not codes of a camera.
    pub linear: bool,
    /// Developed from a camera's RAW file: its codes follow the sRGB curve.
    #[serde(default)]
    pub raw: bool,
    /// Maker and model of the camera.
    pub camera: Option<String>,
}

/// All photographs by role: `ingest/capture.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Capture {
    /// Folder of the photographs, relative to the settings file.
    pub photos: PathBuf,
    /// The photographs, by role and then name. One file may stand here twice, as plate and as one of the brackets.
    pub images: Vec<Photo>,
    /// Width of the sensor, mm.
    pub sensor_width_mm: Option<f64>,
}

impl JsonArtefact for Capture {
    const FORMAT: &'static str = "insitu-capture";
    const VERSION: u32 = 1;
}

/// Diagonal of 35 mm film, mm, which the 35 mm equivalent focal length refers to (CIPA DCG-001).
const FILM_DIAGONAL_MM: f64 = 43.267;

impl Capture {
    /// The photographs of a role.
    pub fn with_role(&self, role: Role) -> impl Iterator<Item = &Photo> {
        self.images.iter().filter(move |photo| photo.role == role)
    }

    /// The photograph to augment.
    pub fn plate(&self) -> Result<&Photo> {
        let plate = self.with_role(Role::Plate).next();
        plate.ok_or_else(|| Error::Data {
            doing: "finding the plate".into(),
            problem: Box::new(Problem::NoPlate),
        })
    }

    /// Exposure of the plate, the unit of all radiance; 1 where no photograph of the capture states any.
    pub fn plate_exposure(&self) -> Result<f64> {
        Ok(self.plate()?.exposure.map_or(1.0, |e| e.scale()))
    }

    /// Focal length in pixels as the lens and sensor are said to be: from the sensor's width (along the longer side),
    /// or else from the 35 mm equivalent. Good to a few per cent.
    pub fn approximate_focal_px(&self, photo: &Photo) -> Option<f64> {
        let (width, height) = (f64::from(photo.width_px), f64::from(photo.height_px));
        match (photo.focal_mm, self.sensor_width_mm, photo.focal_35mm_mm) {
            (Some(focal), Some(sensor), _) => Some(focal / sensor * width.max(height)),
            (_, _, Some(focal)) => Some(focal / FILM_DIAGONAL_MM * width.hypot(height)),
            _ => None,
        }
    }
}

/// A decoded photograph.
#[derive(Debug, Clone, PartialEq)]
pub enum Photograph {
    /// What a camera stored.
    Codes(CodeImage),
    /// Linear radiance, in the units of its file.
    Linear(RadianceImage),
}

impl Photograph {
    /// `(width, height)`, px.
    pub fn size(&self) -> (usize, usize) {
        match self {
            Self::Codes(image) => image.size(),
            Self::Linear(image) => image.size(),
        }
    }

    /// The code values; a linear picture is refused.
    pub fn codes(self, path: &Path) -> Result<CodeImage> {
        match self {
            Self::Codes(image) => Ok(image),
            Self::Linear(_) => Err(no_codes(path)),
        }
    }
}

fn no_codes(path: &Path) -> Error {
    Error::file(
        "reading code values",
        path,
        "holds linear radiance, not the codes of a camera",
        "give JPEG, PNG or TIFF photographs here; EXR and HDR can be the plate or the probe",
    )
}

/// One exposure of a view.
#[derive(Clone, Copy)]
pub struct Frame<'a> {
    /// What the camera stored.
    pub codes: &'a dyn Rows,
    /// [`Exposure::scale`].
    pub exposure: f64,
}

/// Decodes a photograph of the capture for a stage: its content enters the stage's digest, its size must be what
/// `ingest` saw.
pub fn load(ctx: &Context, capture: &Capture, photo: &Photo) -> Result<Photograph> {
    let path = ctx.user_file(&capture.photos.join(&photo.file))?;
    let photograph = decode(&path)?;
    check_size(&path, photo, photograph.size())?;
    Ok(photograph)
}

/// Photographs that are decoded at a time, at most.
const AT_ONCE: usize = 4;

/// Decodes photographs with codes, as their files hold them, some at a time, and makes something of each; in their order.
pub fn decode_each<T: Send>(
    paths: &[PathBuf],
    make: impl Fn(usize, Stored) -> Result<T> + Sync,
    mut done: impl FnMut(),
) -> Result<Vec<T>> {
    let mut made = Vec::with_capacity(paths.len());
    while made.len() < paths.len() {
        let first = made.len();
        let last = (first + rayon::current_num_threads().clamp(1, AT_ONCE)).min(paths.len());
        let one = |i: usize| make(i, decode_stored(&paths[i])?);
        let group: Vec<Result<T>> = (first..last).into_par_iter().map(one).collect();
        for one in group {
            made.push(one?);
            done();
        }
    }
    Ok(made)
}

/// The same for a stage: as [`load`].
pub fn load_each<T: Send>(
    ctx: &Context,
    capture: &Capture,
    photos: &[&Photo],
    saying: &str,
    make: impl Fn(&Photo, Stored) -> Result<T> + Sync,
) -> Result<Vec<T>> {
    let paths = photos.iter().map(|photo| ctx.user_file(&capture.photos.join(&photo.file)));
    let paths = paths.collect::<Result<Vec<PathBuf>>>()?;
    let bar = ctx.printer.progress(saying, photos.len() as u64);
    let checked = |i: usize, stored: Stored| {
        check_size(&paths[i], photos[i], stored.size())?;
        make(photos[i], stored)
    };
    let made = decode_each(&paths, checked, || bar.inc(1));
    bar.finish_and_clear();
    made
}

fn check_size(path: &Path, photo: &Photo, (width, height): (usize, usize)) -> Result<()> {
    if (width, height) == (photo.width_px as usize, photo.height_px as usize) {
        return Ok(());
    }
    Err(Error::file(
        "reading a photograph",
        path,
        format!("is {width}×{height} px, was {}×{} px at ingest", photo.width_px, photo.height_px),
        "run again from stage `ingest`",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn photo(width_px: u32, height_px: u32) -> Photo {
        Photo {
            file: "a.jpg".into(),
            role: Role::Plate,
            width_px,
            height_px,
            exposure: None,
            focal_mm: Some(20.0),
            focal_35mm_mm: Some(30.0),
            linear: false,
            raw: false,
            camera: None,
        }
    }

    #[test]
    fn exposure_counts_time_aperture_and_speed() {
        let a = Exposure { time_s: 0.01, f_number: 4.0, iso: 400.0 };
        let b = Exposure { time_s: 0.04, f_number: 8.0, iso: 400.0 };
        assert!((a.scale() - 0.04 / 16.0).abs() < 1e-15 && (a.scale() - b.scale()).abs() < 1e-15);
    }

    #[test]
    fn focal_length_is_the_same_in_portrait() {
        let capture = |sensor| Capture { photos: "p".into(), images: vec![], sensor_width_mm: sensor };
        for sensor in [Some(24.0), None] {
            let landscape = capture(sensor).approximate_focal_px(&photo(3000, 2000)).unwrap();
            assert_eq!(capture(sensor).approximate_focal_px(&photo(2000, 3000)).unwrap(), landscape);
            assert!((landscape - 2500.0).abs() < 1.0, "{landscape}");
        }
    }
}

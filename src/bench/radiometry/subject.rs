//! What the first stages are measured on: the brackets of a capture, or a folder of exposures of one view.

use super::folder;
use crate::artefact::{exr, json};
use crate::config::Role;
use crate::driver::run::{self, Range};
use crate::driver::validate;
use crate::error::{Error, FileContext, Result};
use crate::exposure::{Capture, Frame, decode};
use crate::image::{CodeImage, Image, Radiance, RadianceImage};
use crate::printer::Printer;
use crate::stage::Workspace;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Exposures of one view with what is known of them.
pub(super) struct Subject {
    pub name: String,
    pub files: Vec<PathBuf>,
    pub images: Vec<CodeImage>,
    /// t · S / N² of each.
    pub exposures: Vec<f64>,
    pub truth: Option<Truth>,
    /// A radiance map that others published, each channel up to a factor.
    pub published: Option<RadianceImage>,
    /// What was done to make the exposures comparable.
    pub remarks: Vec<String>,
}

/// The truth of a rendered capture.
pub(super) struct Truth {
    /// Relative exposure at each 8-bit code, per channel.
    pub curves: [Vec<f64>; 3],
    /// Radiance for which an exposure of 1 gives relative exposure 1.
    pub radiance: RadianceImage,
}

impl Subject {
    /// Those of a path: settings files, folders of captures, or a folder of exposures.
    pub fn under(path: &Path, printer: &Printer) -> Result<Vec<Self>> {
        let settings = validate::settings_under(&[path.to_path_buf()])?;
        if settings.is_empty() {
            return folder::subjects(path);
        }
        // Settings that extend others place the object elsewhere: their brackets are the same.
        let own = settings
            .iter()
            .filter(|s| s.file_name().is_some_and(|n| n == "pipeline.toml") || settings.len() == 1);
        own.map(|s| Self::of_capture(s, printer)).filter_map(Result::transpose).collect()
    }

    /// The brackets of a capture, or else its probe's exposures; `None` where its photographs are not there.
    fn of_capture(settings: &Path, printer: &Printer) -> Result<Option<Self>> {
        let workspace = Workspace::open(settings)?;
        let photos = workspace.base.join(&workspace.pipeline.ingest.photos);
        if !photos.is_dir() {
            printer.data(&format!("{}: no photographs: left out", validate::name(settings)));
            return Ok(None);
        }
        run::stages(&workspace, &Range { to: Some("ingest".into()), ..Range::default() }, printer)?;
        let capture: Capture = json::read(&workspace.folder("ingest").join("capture.json"))?;
        let role = if capture.with_role(Role::Brackets).count() > 1 { Role::Brackets } else { Role::Probe };
        let (mut files, mut exposures, mut images) = (Vec::new(), Vec::new(), Vec::new());
        for photo in capture.with_role(role).filter(|p| !p.linear) {
            let path = photos.join(&photo.file);
            images.push(decode(&path)?.codes(&path)?);
            exposures.push(photo.exposure.map_or(1.0, |e| e.scale()));
            files.push(path);
        }
        let truth = workspace.pipeline.evaluate.truth.as_ref().map(|p| workspace.base.join(p));
        let truth = truth.filter(|_| role == Role::Brackets).map(|p| Truth::read(&p)).transpose()?;
        let name = validate::name(settings);
        Ok(Some(Self { name, files, images, exposures, truth, published: None, remarks: Vec::new() }))
    }

    pub fn frames(&self) -> Vec<Frame<'_>> {
        self.images.iter().zip(&self.exposures).map(|(codes, e)| Frame { codes, exposure: *e }).collect()
    }
}

impl Truth {
    fn read(path: &Path) -> Result<Self> {
        const DOING: &str = "reading the truth of a capture";
        let shape = || {
            Error::file(
                DOING,
                path,
                "lacks response, exposure_constant_K or empty_exr",
                "give the truth.json of a rendered capture",
            )
        };
        let text = std::fs::read_to_string(path).at(DOING, path)?;
        let value: Value = serde_json::from_str(&text).map_err(|_| shape())?;
        let numbers =
            |v: &Value| v.as_array().map(|a| a.iter().filter_map(Value::as_f64).collect::<Vec<_>>());
        let x = numbers(&value["response"]["x"]).ok_or_else(shape)?;
        let curve = |k: usize| {
            let y = numbers(&value["response"]["y_rgb"][k]).filter(|y| y.len() == x.len() && y.len() > 1);
            Ok::<_, Error>(inverse(&x, &y.ok_or_else(shape)?))
        };
        let curves = [curve(0)?, curve(1)?, curve(2)?];
        let unit = value["exposure_constant_K"].as_f64().ok_or_else(shape)? as f32;
        let name = value["empty_exr"].as_str().and_then(|n| Path::new(n).file_name()).ok_or_else(shape)?;
        let empty = exr::read_radiance(&path.with_file_name(name))?;
        Ok(Self { curves, radiance: empty.map(|p| Radiance(p.0.map(|v| v * unit))) })
    }

    /// Whether a channel of a pixel has a code from 10 to 245 in one of the frames.
    pub fn well_exposed(&self, exposures: &[f64]) -> Image<[bool; 3]> {
        let ranges = self.curves.each_ref().map(|c| c[10]..c[245]);
        self.radiance.map(|p| {
            std::array::from_fn(|k| exposures.iter().any(|e| ranges[k].contains(&(f64::from(p.0[k]) * e))))
        })
    }
}

/// x at each 8-bit code for y(x) tabulated.
fn inverse(x: &[f64], y: &[f64]) -> Vec<f64> {
    let of = |code: f64| {
        let above = y.partition_point(|v| *v <= code).clamp(1, y.len() - 1);
        let (y0, y1) = (y[above - 1], y[above]);
        x[above - 1] + (x[above] - x[above - 1]) * ((code - y0) / (y1 - y0).max(1e-12)).clamp(0.0, 1.0)
    };
    (0..256).map(|z| of(f64::from(z) / 255.0)).collect()
}

//! OpenCV and pfstools on the same exposures.

use super::subject::Subject;
use crate::error::{Error, FileContext, Result};
use crate::image::{Image, Radiance, RadianceImage};
use crate::vision;
use crate::vision::hdr::{Exposures, Method};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

/// What a program makes of exposures.
pub(super) struct Made {
    /// Relative exposure at each 8-bit code, where the program tells.
    pub curves: Option<[Vec<f64>; 3]>,
    pub radiance: RadianceImage,
    pub seconds: f64,
}

/// The programs measured beside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Peer {
    OpenCv(Method),
    /// `pfshdrcalibrate`.
    Pfstools(&'static str),
}

pub(super) const PEERS: [Peer; 4] = [
    Peer::OpenCv(Method::Debevec),
    Peer::OpenCv(Method::Robertson),
    Peer::Pfstools("robertson"),
    Peer::Pfstools("mitsunaga"),
];

impl Peer {
    pub fn name(self) -> String {
        match self {
            Self::OpenCv(method) => format!("OpenCV {method:?}"),
            Self::Pfstools(method) => format!("pfstools {method}"),
        }
    }

    /// Runs it; a message where it is not installed or fails.
    pub fn make(self, subject: &Subject) -> Result<Result<Made, String>> {
        match self {
            Self::OpenCv(method) => Ok(open_cv(subject, method).map_err(|e| format!("failed: {e}"))),
            Self::Pfstools(method) => pfstools(subject, method),
        }
    }
}

fn open_cv(subject: &Subject, method: Method) -> Result<Made, vision::Problem> {
    let pictures: Vec<_> =
        subject.images.iter().zip(&subject.exposures).map(|(image, e)| (bytes(image), *e)).collect();
    let started = Instant::now();
    let merged = Exposures::new(&pictures)?.merge(method)?;
    let seconds = started.elapsed().as_secs_f64();
    Ok(Made { curves: Some(merged.curves), radiance: merged.radiance, seconds })
}

fn bytes(image: &crate::image::CodeImage) -> Image<[u8; 3]> {
    image.map(|c| c.0.map(|v| (v * 255.0).round() as u8))
}

/// Hands the frames over as PNG, with a script that states time, aperture and speed; takes radiance back as HDR and the
/// curve as it saves it.
fn pfstools(subject: &Subject, method: &'static str) -> Result<Result<Made, String>> {
    const DOING: &str = "handing exposures to pfstools";
    if ["pfsinhdrgen", "pfshdrcalibrate", "pfsout"]
        .iter()
        .any(|p| Command::new(p).arg("--help").stdout(Stdio::null()).stderr(Stdio::null()).status().is_err())
    {
        return Ok(Err("not installed (`apt-get install pfstools`)".into()));
    }
    let folder = tempfile::tempdir().at(DOING, Path::new("a temporary folder"))?;
    let mut script = String::new();
    for (i, (image, exposure)) in subject.images.iter().zip(&subject.exposures).enumerate() {
        let path = folder.path().join(format!("{i:02}.png"));
        crate::composite::write_png(&path, image)?;
        // All of the exposure stands as time: f/1 at ISO 100.
        script += &format!("{} {} 1 100 0\n", path.display(), 1.0 / exposure);
    }
    let write = folder.path().join("frames.hdrgen");
    std::fs::write(&write, script).at(DOING, &write)?;
    let started = Instant::now();
    let line = format!("pfsinhdrgen frames.hdrgen | pfshdrcalibrate -c {method} -s curve.m | pfsout out.exr");
    let output = Command::new("sh")
        .arg("-c")
        .arg(line)
        .current_dir(folder.path())
        .output()
        .at(DOING, folder.path())?;
    let seconds = started.elapsed().as_secs_f64();
    let (curve, out) = (folder.path().join("curve.m"), folder.path().join("out.exr"));
    if !out.exists() {
        let said = String::from_utf8_lossy(&output.stderr).trim().lines().last().unwrap_or("").to_string();
        return Ok(Err(format!("failed: {said}")));
    }
    let radiance = match read_any(&out) {
        Ok(radiance) => radiance,
        Err(e) => return Ok(Err(e.to_string())),
    };
    let curves = std::fs::read_to_string(curve).ok().and_then(|text| saved_curve(&text));
    Ok(Ok(Made { curves, radiance, seconds }))
}

/// Its pictures may hold infinities, which our own reader refuses.
fn read_any(path: &Path) -> Result<RadianceImage> {
    use exr::prelude::{ReadChannels, ReadLayers};
    let bad = |e: exr::error::Error| {
        Error::file("reading what pfstools wrote", path, e.to_string(), "check pfstools")
    };
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .map_err(bad)?;
    let size = image.layer_data.size;
    let plane = |name: &str| -> Vec<f32> {
        let list = &image.layer_data.channel_data.list;
        list.iter()
            .find(|c| c.name == *name)
            .map_or(vec![0.0; size.0 * size.1], |c| c.sample_data.values_as_f32().collect())
    };
    let (r, g, b) = (plane("R"), plane("G"), plane("B"));
    Ok(Image::from_pixels(size.0, size.1, (0..r.len()).map(|i| Radiance([r[i], g[i], b[i]])).collect()))
}

/// Matlab matrices with rows of log10 exposure, code, exposure: one a channel.
fn saved_curve(text: &str) -> Option<[Vec<f64>; 3]> {
    let mut curves: Vec<Vec<f64>> = Vec::new();
    for line in text.lines() {
        if line.starts_with("# name:") {
            curves.push(Vec::new());
        }
        let numbers: Vec<f64> = line.split_whitespace().filter_map(|w| w.parse().ok()).collect();
        if let ([_, _, exposure], Some(curve)) = (&numbers[..], curves.last_mut()) {
            curve.push(*exposure);
        }
    }
    curves.retain(|c| c.len() == 256);
    curves.try_into().ok()
}

//! OpenEXR images: 32-bit float channels, Rec. 709 chromaticities, provenance in the header.

use super::remake;
use crate::error::{Error, Result};
use crate::image::{Image, Radiance, RadianceImage};
use ::exr::prelude as exr;
use std::path::Path;

/// Named planes of one size, in the order given.
#[derive(Debug, Clone, PartialEq)]
pub struct Planes {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Channel name and row-major samples.
    pub channels: Vec<(String, Vec<f32>)>,
}

impl Planes {
    /// The `R G B` planes of an image.
    pub fn from_radiance(image: &RadianceImage) -> Self {
        let channels = ["R", "G", "B"]
            .iter()
            .enumerate()
            .map(|(k, name)| (name.to_string(), image.pixels().iter().map(|p| p.0[k]).collect()))
            .collect();
        Self { width: image.width(), height: image.height(), channels }
    }

    /// Adds a plane.
    pub fn with(mut self, name: &str, samples: Vec<f32>) -> Self {
        assert_eq!(samples.len(), self.width * self.height, "sample count of plane {name}");
        self.channels.push((name.into(), samples));
        self
    }

    /// The samples of a plane.
    pub fn plane(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|(n, _)| n == name).map(|(_, s)| s.as_slice())
    }

    /// The `R G B` planes as an image.
    pub fn radiance(&self) -> Option<RadianceImage> {
        let (r, g, b) = (self.plane("R")?, self.plane("G")?, self.plane("B")?);
        let pixels = (0..r.len()).map(|i| Radiance([r[i], g[i], b[i]])).collect();
        Some(Image::from_pixels(self.width, self.height, pixels))
    }
}

/// What an EXR file is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A picture taken by a camera, or a layer of one.
    Picture,
    /// An equirectangular environment (sets the `envmap` attribute to `latlong`).
    LatLong,
}

/// Writes planes with ZIP compression.
pub fn write(path: &Path, planes: &Planes, kind: Kind) -> Result<()> {
    let list = planes
        .channels
        .iter()
        .map(|(name, samples)| exr::AnyChannel::new(name.as_str(), exr::FlatSamples::F32(samples.clone())))
        .collect::<Vec<_>>();
    let mut layer = exr::Layer::new(
        (planes.width, planes.height),
        exr::LayerAttributes {
            software_name: Some(concat!("insitu ", env!("CARGO_PKG_VERSION")).into()),
            ..Default::default()
        },
        exr::Encoding::SMALL_LOSSLESS,
        exr::AnyChannels::sort(list.into_iter().collect()),
    );
    if kind == Kind::LatLong {
        layer.attributes.environment_map = Some(exr::attribute::EnvironmentMap::LatitudeLongitude);
    }
    let mut image = exr::Image::from_layer(layer);
    image.attributes.chromaticities = Some(exr::attribute::Chromaticities {
        red: exr::Vec2(0.64, 0.33),
        green: exr::Vec2(0.30, 0.60),
        blue: exr::Vec2(0.15, 0.06),
        white: exr::Vec2(0.3127, 0.3290),
    });
    use exr::WritableImage;
    image.write().to_file(path).map_err(|e| match e {
        exr::Error::Io(e) => {
            let attempt: std::io::Result<()> = Err(e);
            crate::error::FileContext::at(attempt, "writing", path).expect_err("an error stays one")
        }
        e => Error::Bug(format!("writing {}: {e}", path.display())),
    })
}

/// Reads all planes; refuses damaged files and samples that are not finite.
pub fn read(path: &Path) -> Result<Planes> {
    use exr::{ReadChannels, ReadLayers};
    let refuse = |problem: String, hint: &str| Error::file("reading an EXR", path, problem, hint);
    let image = exr::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .map_err(|e| match e {
            exr::Error::Io(e) if e.kind() == std::io::ErrorKind::NotFound => {
                refuse("no such file".into(), "check the name, or run the stage that writes it")
            }
            exr::Error::NotSupported(e) => {
                refuse(format!("not supported ({e})"), "save it with ZIP, PIZ or no compression")
            }
            e => refuse(format!("damaged or cut short ({e})"), &remake(path)),
        })?;
    let size = image.layer_data.size;
    let mut channels = Vec::new();
    for channel in &image.layer_data.channel_data.list {
        let samples: Vec<f32> = channel.sample_data.values_as_f32().collect();
        if let Some(i) = samples.iter().position(|s| !s.is_finite()) {
            return Err(refuse(
                format!(
                    "channel {} is {} at pixel ({}, {})",
                    channel.name,
                    samples[i],
                    i % size.0,
                    i / size.0
                ),
                &match remake(path) {
                    again if again.starts_with("run") => again,
                    _ => "repair or leave out the file: every sample must be a finite number".into(),
                },
            ));
        }
        channels.push((channel.name.to_string(), samples));
    }
    Ok(Planes { width: size.0, height: size.1, channels })
}

/// Writes an `R G B` picture.
pub fn write_radiance(path: &Path, image: &RadianceImage) -> Result<()> {
    write(path, &Planes::from_radiance(image), Kind::Picture)
}

/// Reads an `R G B` picture.
pub fn read_radiance(path: &Path) -> Result<RadianceImage> {
    let planes = read(path)?;
    planes.radiance().ok_or_else(|| {
        let names: Vec<_> = planes.channels.iter().map(|(n, _)| n.as_str()).collect();
        Error::file(
            "reading an EXR",
            path,
            format!("has channels {}, expected R, G, B", names.join(", ")),
            remake(path),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture() -> RadianceImage {
        Image::from_fn(7, 5, |x, y| Radiance([x as f32 * 0.1, y as f32 * 1e6, 1e-12 * (x + y) as f32]))
    }

    #[test]
    fn radiance_survives_exactly() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.exr");
        write_radiance(&path, &picture()).unwrap();
        assert_eq!(read_radiance(&path).unwrap(), picture());
    }

    #[test]
    fn nan_is_refused_with_its_pixel() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.exr");
        let mut image = picture();
        image.at_mut(3, 2).0[1] = f32::NAN;
        write_radiance(&path, &image).unwrap();
        let message = read_radiance(&path).unwrap_err().to_string();
        assert!(message.contains("channel G is NaN at pixel (3, 2)"), "{message}");
    }

    #[test]
    fn a_file_cut_short_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.exr");
        write_radiance(&path, &picture()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        let message = read_radiance(&path).unwrap_err().to_string();
        assert!(message.contains("damaged or cut short"), "{message}");
    }
}

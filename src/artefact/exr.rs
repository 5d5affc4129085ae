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
        exr::LayerAttributes { software_name: Some(SOFTWARE.into()), ..Default::default() },
        exr::Encoding::SMALL_LOSSLESS,
        exr::AnyChannels::sort(list.into_iter().collect()),
    );
    if kind == Kind::LatLong {
        layer.attributes.environment_map = Some(exr::attribute::EnvironmentMap::LatitudeLongitude);
    }
    let mut image = exr::Image::from_layer(layer);
    image.attributes.chromaticities = Some(CHROMATICITIES);
    use exr::WritableImage;
    image.write().to_file(path).map_err(|e| not_written(e, path))
}

/// Writes planes of the given names a band of rows at a time, from the top down: `fill` gets what takes a band.
pub fn write_in_bands<T>(
    path: &Path,
    (width, height): (usize, usize),
    names: &[&str],
    fill: impl FnOnce(&mut dyn FnMut(&Planes) -> Result<()>) -> Result<T>,
) -> Result<T> {
    use ::exr::block::writer::ChunksWriter;
    use ::exr::block::{UncompressedBlock, enumerate_ordered_header_block_indices};
    use ::exr::meta::attribute::{ChannelDescription, LineOrder, SampleType};
    use ::exr::meta::{BlockDescription, header::Header};
    use rayon::prelude::*;
    let file = crate::error::FileContext::at(std::fs::File::create(path), "writing", path)?;
    let mut sorted = names.to_vec();
    sorted.sort_unstable();
    let channels = sorted.iter().map(|n| ChannelDescription::named(*n, SampleType::F32)).collect();
    let mut header = Header::new("".into(), (width, height), channels).with_encoding(
        exr::Compression::ZIP16,
        BlockDescription::ScanLines,
        LineOrder::Increasing,
    );
    header.own_attributes.software_name = Some(SOFTWARE.into());
    header.shared_attributes.chromaticities = Some(CHROMATICITIES);
    let mut outcome = None;
    let written = ::exr::block::write(
        std::io::BufWriter::new(file),
        std::iter::once(header).collect(),
        true,
        |meta, out| {
            let mut blocks =
                enumerate_ordered_header_block_indices(&meta.headers).collect::<Vec<_>>().into_iter();
            let mut waiting: Vec<u8> = Vec::new();
            let row = sorted.len() * width * size_of::<f32>();
            let mut failed = None;
            let mut take = |band: &Planes| {
                for y in 0..band.height {
                    for name in &sorted {
                        let plane = band
                            .plane(name)
                            .ok_or_else(|| Error::Bug(format!("a band without plane {name}")))?;
                        waiting.extend_from_slice(bytemuck::cast_slice(&plane[y * width..(y + 1) * width]));
                    }
                }
                let mut whole = Vec::new();
                let mut used = 0;
                while let Some((_, index)) = blocks.as_slice().first()
                    && waiting.len() - used >= index.pixel_size.height() * row
                {
                    let bytes = index.pixel_size.height() * row;
                    let data = waiting[used..used + bytes].to_vec();
                    used += bytes;
                    whole.extend(blocks.next().map(|(at, index)| (at, UncompressedBlock { index, data })));
                }
                waiting.drain(..used);
                let packed = whole
                    .into_par_iter()
                    .map(|(at, block)| Ok((at, block.compress_to_chunk(&meta.headers)?)));
                let packed = packed.collect::<exr::Result<Vec<_>>>();
                let written = packed
                    .and_then(|all| all.into_iter().try_for_each(|(at, chunk)| out.write_chunk(at, chunk)));
                written.map_err(|e| {
                    let problem = format!("{e}");
                    failed = Some(e);
                    Error::Bug(format!("writing {}: {problem}", path.display()))
                })
            };
            outcome = Some(fill(&mut take));
            match (failed, &outcome) {
                (Some(e), _) => Err(e),
                (None, Some(Ok(_))) => Ok(()),
                _ => Err(exr::Error::Aborted),
            }
        },
    );
    match (written, outcome) {
        (Ok(()), Some(done)) => done,
        (Err(exr::Error::Aborted), Some(Err(e))) => Err(e),
        (Err(e), _) => Err(not_written(e, path)),
        (Ok(()), None) => Err(Error::Bug(format!("writing {}: nothing was written", path.display()))),
    }
}

fn not_written(e: exr::Error, path: &Path) -> Error {
    match e {
        exr::Error::Io(e) => {
            let attempt: std::io::Result<()> = Err(e);
            crate::error::FileContext::at(attempt, "writing", path).expect_err("an error stays one")
        }
        e => Error::Bug(format!("writing {}: {e}", path.display())),
    }
}

const SOFTWARE: &str = concat!("insitu ", env!("CARGO_PKG_VERSION"));
/// Rec. 709.
const CHROMATICITIES: exr::attribute::Chromaticities = exr::attribute::Chromaticities {
    red: exr::Vec2(0.64, 0.33),
    green: exr::Vec2(0.30, 0.60),
    blue: exr::Vec2(0.15, 0.06),
    white: exr::Vec2(0.3127, 0.3290),
};

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
    fn bands_make_the_same_file_as_the_whole() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.exr");
        let image = Image::from_fn(9, 53, |x, y| Radiance([x as f32, y as f32, (x * y) as f32]));
        let band = |y0: usize, y1: usize| Image::from_fn(9, y1 - y0, |x, y| *image.at(x, y0 + y));
        let sum = write_in_bands(&path, (9, 53), &["R", "G", "B"], |take| {
            for (y0, y1) in [(0, 1), (1, 33), (33, 50), (50, 53)] {
                take(&Planes::from_radiance(&band(y0, y1)))?;
            }
            Ok(7)
        });
        assert_eq!(sum.unwrap(), 7);
        assert_eq!(read_radiance(&path).unwrap(), image);
        let early = write_in_bands(&path, (9, 53), &["R"], |_| Err::<(), _>(Error::Bug("stopped".into())));
        assert!(early.unwrap_err().to_string().starts_with("stopped"));
    }

    #[test]
    fn the_compression_that_blender_writes_is_read() {
        use super::exr::WritableImage;
        let dir = tempfile::tempdir().unwrap();
        for (name, compression) in [("a", exr::Compression::DWAA(None)), ("b", exr::Compression::DWAB(None))]
        {
            let path = dir.path().join(name);
            let smooth =
                Image::from_fn(70, 50, |x, y| Radiance([0.5 + x as f32 * 0.01, 1.0 + y as f32 * 0.1, 3.0]));
            let list = (0..3).map(|k| {
                let samples = smooth.pixels().iter().map(|p| p.0[k]).collect();
                exr::AnyChannel::new(["R", "G", "B"][k], exr::FlatSamples::F32(samples))
            });
            let encoding = exr::Encoding { compression, ..exr::Encoding::SMALL_LOSSLESS };
            let layer = exr::Layer::new(
                (70, 50),
                Default::default(),
                encoding,
                exr::AnyChannels::sort(list.collect()),
            );
            exr::Image::from_layer(layer).write().to_file(&path).unwrap();
            let read = read_radiance(&path).unwrap();
            for (a, b) in read.pixels().iter().zip(smooth.pixels()) {
                assert!((0..3).all(|k| (a.0[k] / b.0[k] - 1.0).abs() < 0.02), "{a:?} {b:?}");
            }
        }
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

//! Camera RAW: the sensor's linear readings, developed without taste.
//!
//! Black level and white level to 0 and 1, colours interpolated (rawler: pixel grouping for Bayer, bilinear for X-Trans),
//! the camera's matrix to Rec. 709 (DNG specification 1.6, ch. 6). White is that of daylight, D65, whatever white balance the
//! camera was set to, so that all frames are alike; 1 is where a daylight white saturates its first channel. Where one
//! channel saturates, all count as saturated, since the matrix would mix it into the others. Codes are stored in 16 bits by
//! the sRGB curve, which is then the response exactly: nothing is fitted.
//!
//! rawler is under the LGPL, so this is in programs built with the feature `raw` alone.

#[cfg(feature = "raw")]
mod develop;

use super::Header;
#[cfg(not(feature = "raw"))]
use crate::error::Error;
use crate::error::Result;
use image::DynamicImage;
use std::path::Path;

/// Extensions of cameras' RAW files.
pub(super) const EXTENSIONS: [&str; 17] = [
    "dng", "cr2", "cr3", "crw", "nef", "nrw", "arw", "raf", "orf", "rw2", "pef", "srw", "iiq", "erf", "mrw",
    "dcr", "3fr",
];

/// Whether a file is a camera's RAW, by its extension.
pub(super) fn is_raw(path: &Path) -> bool {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    EXTENSIONS.contains(&extension.as_str())
}

/// Whether a file's extension is none of a camera's RAW, or such files can be read.
pub fn is_readable(path: &Path) -> bool {
    cfg!(feature = "raw") || !is_raw(path)
}

/// Header of a RAW file; its size is that of the developed picture.
#[cfg(feature = "raw")]
pub(super) fn header(path: &Path) -> Result<Header> {
    develop::guarded("reading the header of a photograph", path, develop::header)
}

/// The developed picture, as stored (not upright), with its header.
#[cfg(feature = "raw")]
pub(super) fn developed(path: &Path) -> Result<(DynamicImage, Header)> {
    let header = header(path)?;
    Ok((develop::guarded("developing a RAW file", path, develop::develop)?, header))
}

/// Without rawler there is none.
#[cfg(not(feature = "raw"))]
pub(super) fn header(path: &Path) -> Result<Header> {
    Err(Error::file(
        "reading the header of a photograph",
        path,
        "is a camera's RAW file, and insitu was built without them",
        "build with `cargo build --release --features raw`, or develop all photographs alike to 16-bit TIFF in sRGB",
    ))
}

/// Without rawler there is none.
#[cfg(not(feature = "raw"))]
pub(super) fn developed(path: &Path) -> Result<(DynamicImage, Header)> {
    header(path).and_then(|_| Err(Error::Bug("a RAW file has a header and no decoder".into())))
}

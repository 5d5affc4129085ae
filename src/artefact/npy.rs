//! Large arrays as `.npy`, little-endian.

use super::remake;
use crate::error::{Error, FileContext, Result};
use ndarray::{Array, Dimension};
use ndarray_npy::{ReadNpyExt, ReadableElement, WritableElement, WriteNpyError, WriteNpyExt};
use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::path::Path;

/// What arrays are made of.
pub trait Element: ReadableElement + WritableElement + std::fmt::Display {
    /// Whether a reader may trust it: no NaN, no infinity.
    fn is_sound(&self) -> bool;
}

impl Element for f32 {
    fn is_sound(&self) -> bool {
        self.is_finite()
    }
}

impl Element for f64 {
    fn is_sound(&self) -> bool {
        self.is_finite()
    }
}

impl Element for u32 {
    fn is_sound(&self) -> bool {
        true
    }
}

/// Writes an array, row-major.
pub fn write<T: Element, D: Dimension>(path: &Path, array: &Array<T, D>) -> Result<()> {
    let mut file = BufWriter::new(File::create(path).at("writing", path)?);
    array
        .write_npy(&mut file)
        .map_err(|e| match e {
            WriteNpyError::Io(e) => e,
            e => std::io::Error::other(e),
        })
        .at("writing", path)?;
    file.flush().at("writing", path)
}

/// Reads an array; refuses damaged files, another number of dimensions, and values that are not finite.
pub fn read<T: Element, D: Dimension>(path: &Path) -> Result<Array<T, D>> {
    let file = BufReader::new(File::open(path).at("reading", path)?);
    let refuse = |problem: String| Error::file("reading an array", path, problem, remake(path));
    let array = Array::<T, D>::read_npy(file).map_err(|e| refuse(format!("damaged or cut short ({e})")))?;
    if let Some((at, value)) = array.indexed_iter().find(|(_, v)| !v.is_sound()) {
        return Err(refuse(format!("is {value} at {at:?}")));
    }
    Ok(array)
}

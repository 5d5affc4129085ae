//! Large arrays as `.npy`, little-endian f32.

use super::remake;
use crate::error::{Error, FileContext, Result};
use ndarray::Array2;
use ndarray_npy::{ReadNpyExt, WriteNpyError, WriteNpyExt};
use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::path::Path;

/// Writes a matrix, row-major.
pub fn write(path: &Path, array: &Array2<f32>) -> Result<()> {
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

/// Reads a matrix; refuses damaged files and values that are not finite.
pub fn read(path: &Path) -> Result<Array2<f32>> {
    let file = BufReader::new(File::open(path).at("reading", path)?);
    let refuse = |problem: String| Error::file("reading an array", path, problem, remake(path));
    let array = Array2::<f32>::read_npy(file).map_err(|e| refuse(format!("damaged or cut short ({e})")))?;
    if let Some((at, value)) = array.indexed_iter().find(|(_, v)| !v.is_finite()) {
        return Err(refuse(format!("is {value} at {at:?}")));
    }
    Ok(array)
}

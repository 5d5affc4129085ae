//! Transfers on disk: `transfer.json`, `transfer.npy`, `irradiance.npy`.

use super::{Source, Transfers};
use crate::artefact::json::{self, JsonArtefact};
use crate::artefact::{npy, remake};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Who the rows and columns of the arrays are.
#[derive(Serialize, Deserialize)]
struct Index {
    left_out: usize,
    left_out_share: f64,
    sources: Vec<Source>,
    receiver_patches: Vec<u32>,
    receiver_vertices: Vec<u32>,
}

impl JsonArtefact for Index {
    const FORMAT: &'static str = "insitu-transfer";
    const VERSION: u32 = 1;
}

impl Transfers {
    /// Names of the files in a stage's folder.
    pub const FILES: [&'static str; 3] = ["transfer.json", "transfer.npy", "irradiance.npy"];

    /// Writes the three files into a folder.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let index = Index {
            left_out: self.left_out,
            left_out_share: self.left_out_share,
            sources: self.sources.clone(),
            receiver_patches: self.receiver_patches.clone(),
            receiver_vertices: self.receiver_vertices.clone(),
        };
        let [a, b, c] = Self::FILES;
        json::write(&folder.join(a), &index)?;
        npy::write(&folder.join(b), &self.transfer)?;
        npy::write(&folder.join(c), &self.irradiance)
    }

    /// Reads the three files of a folder; refuses arrays that do not fit the index.
    pub fn read(folder: &Path) -> Result<Self> {
        let [a, b, c] = Self::FILES;
        let index: Index = json::read(&folder.join(a))?;
        let transfer = npy::read(&folder.join(b))?;
        let irradiance = npy::read(&folder.join(c))?;
        let vertices = index.receiver_vertices.len();
        for (file, found, expected) in
            [(b, transfer.dim(), (index.sources.len(), vertices)), (c, irradiance.dim(), (vertices, 3))]
        {
            if found != expected {
                let problem = format!("is {found:?} large, {a} says {expected:?}");
                let path = folder.join(file);
                return Err(Error::file("reading the transfers", &path, problem, remake(&path)));
            }
        }
        Ok(Self {
            sources: index.sources,
            receiver_patches: index.receiver_patches,
            receiver_vertices: index.receiver_vertices,
            transfer,
            irradiance,
            left_out: index.left_out,
            left_out_share: index.left_out_share,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::SourceKind;
    use ndarray::Array2;

    fn sample() -> Transfers {
        Transfers {
            sources: vec![
                Source { kind: SourceKind::Patch(3), power_share: 0.6 },
                Source { kind: SourceKind::Distant(0), power_share: 0.3 },
            ],
            receiver_patches: vec![1],
            receiver_vertices: vec![2, 4, 5],
            transfer: Array2::from_shape_fn((2, 3), |(i, j)| (i + j) as f32),
            irradiance: Array2::ones((3, 3)),
            left_out: 4,
            left_out_share: 0.1,
        }
    }

    #[test]
    fn files_give_back_what_was_written() {
        let folder = tempfile::tempdir().unwrap();
        sample().write(folder.path()).unwrap();
        assert_eq!(Transfers::read(folder.path()).unwrap(), sample());
    }

    #[test]
    fn arrays_of_another_run_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        sample().write(folder.path()).unwrap();
        npy::write(&folder.path().join("transfer.npy"), &Array2::zeros((2, 4))).unwrap();
        let e = Transfers::read(folder.path()).unwrap_err().to_string();
        assert!(e.contains("transfer.npy: is (2, 4) large, transfer.json says (2, 3)"), "{e}");
    }
}

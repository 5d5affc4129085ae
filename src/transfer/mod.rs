//! Radiance transfers from sources to receiver vertices (Gibson et al. 2003, §5).

pub mod form_factor;
pub mod sampling;
mod solve;
mod storage;

use crate::error;
use crate::illuminate::patch::LightModel;
use ndarray::Array2;
use serde::{Deserialize, Serialize};
pub use solve::solve;

/// Which light a source is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SourceKind {
    /// Index into [`crate::illuminate::patch::PatchMesh::patches`].
    Patch(u32),
    /// Index into [`LightModel::distant`].
    Distant(u32),
}

/// A member of the source set.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// Which light.
    pub kind: SourceKind,
    /// Its share of all light that reaches the receivers, 0..1.
    pub power_share: f64,
}

impl Source {
    /// Radiance of the source, plate units.
    pub fn radiance(&self, light: &LightModel) -> [f32; 3] {
        match self.kind {
            SourceKind::Patch(i) => light.mesh.patches[i as usize].radiance,
            SourceKind::Distant(i) => light.distant[i as usize].radiance,
        }
    }
}

/// The source set, and what each source sends to each receiver vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct Transfers {
    /// The source set, strongest first.
    pub sources: Vec<Source>,
    /// Patches that the plate's camera sees, ascending.
    pub receiver_patches: Vec<u32>,
    /// Mesh vertices of those patches, ascending: the columns of [`Self::transfer`].
    pub receiver_vertices: Vec<u32>,
    /// Irradiance per unit radiance with the static scene's visibility, sr, [sources × receiver vertices].
    pub transfer: Array2<f32>,
    /// Irradiance from all patches and all distant light, in the source set or not, plate units,
    /// [receiver vertices × 3].
    pub irradiance: Array2<f32>,
    /// Number of lights that are not in the source set.
    pub left_out: usize,
    /// Their share of all light that reaches the receivers: a bound on the part of a shadow that is missing.
    pub left_out_share: f64,
}

/// Column of [`Transfers::transfer`] for a mesh vertex; [`NO_COLUMN`] where it is no receiver.
pub const NO_COLUMN: u32 = u32::MAX;

impl Transfers {
    /// For every mesh vertex its column, or [`NO_COLUMN`].
    pub fn columns(&self, mesh_vertices: usize) -> Vec<u32> {
        let mut columns = vec![NO_COLUMN; mesh_vertices];
        for (column, &vertex) in self.receiver_vertices.iter().enumerate() {
            if let Some(slot) = columns.get_mut(vertex as usize) {
                *slot = column as u32;
            }
        }
        columns
    }
}

/// Why there are no transfers.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// The plate's camera looks past the model.
    #[error("the plate's camera sees none of the model's {patches} patches")]
    NoReceiver {
        /// Patches in the model.
        patches: usize,
    },
    /// Nothing shines on what the camera sees.
    #[error("none of {sources} light sources reaches what the plate's camera sees")]
    NoLight {
        /// Patches and distant sources.
        sources: usize,
    },
    /// The share cannot be reached.
    #[error("source_share is {0}, which is not above 0 and at most 1")]
    Share(f64),
    /// No visibility without rays.
    #[error("rays is 0")]
    NoRays,
    /// A patch or distant source is broken.
    #[error("{what} {index} has radiance {radiance:?}")]
    Radiance {
        /// `patch` or `distant source`.
        what: &'static str,
        /// Which one.
        index: usize,
        /// Its radiance.
        radiance: [f32; 3],
    },
}

impl error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::NoReceiver { .. } => {
                "check the plate's pose (`calibrate`) and that the primitives of `model` enclose the view".into()
            }
            Self::NoLight { .. } => "check that the probe's picture is not black and that faces look inwards".into(),
            Self::Share(_) => "set transfer.source_share between 0 and 1; 0.7 is usual".into(),
            Self::NoRays => "set transfer.rays to 8 or more".into(),
            Self::Radiance { .. } => "run `insitu run --force --from illuminate`".into(),
        }
    }
}

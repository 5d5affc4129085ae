//! Radiance transfers from sources to receiver vertices (Gibson et al. 2003, §5).

mod blockers;
mod boxes;
mod field;
pub mod form_factor;
mod gather;
mod lights;
mod links;
mod lobe;
mod octree;
mod receivers;
mod refine;
mod rows;
pub mod sampling;
mod sets;
mod shaft;
mod shafts;
mod solve;
mod storage;
#[cfg(test)]
mod tests;
mod tree;

use crate::error;
use crate::illuminate::patch::LightModel;
use crate::shadow::Receiver;
use ndarray::Array2;
use serde::{Deserialize, Serialize};
use std::ops::Range;

pub use links::Links;
pub use lobe::Finish;
pub(crate) use lobe::Lobe;
pub use receivers::{ReceiverMesh, ReceiverTriangle};
pub use shafts::{Affected, ShaftCounts, ShaftHierarchy, Traversal};
pub use solve::{solve, solve_glossy};

/// Which light a source is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
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
    /// Luminance of the irradiance that it sends, averaged over the receivers' area, plate units.
    pub mean: f64,
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
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Transfers {
    /// The source set, in the order of the tree's leaves.
    pub sources: Vec<Source>,
    /// Clusters of sources; `nodes[0]` is the root.
    pub tree: SourceTree,
    /// Where transfers are known.
    pub receivers: ReceiverMesh,
    /// Sparse transfers by receiver vertex.
    pub links: Links,
    /// Irradiance from all patches and all distant light, in the source set or not, plate units,
    /// [receiver vertices × 3].
    pub irradiance: Array2<f32>,
    /// Which sources and receivers a box may part (gibson §6).
    pub shafts: ShaftHierarchy,
    /// Number of lights that are not in the source set.
    pub left_out: usize,
    /// Their share of all light that reaches the receivers: a bound on the part of a shadow that is missing.
    pub left_out_share: f64,
    /// Their largest share of the irradiance of one receiver vertex: the same bound for any place.
    pub largest_left_out_share: f64,
}

/// Binary tree over the source set.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SourceTree {
    /// The root first, children after their parents.
    pub nodes: Vec<SourceNode>,
}

/// A cluster of sources.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceNode {
    /// Indices of the sources below.
    pub leaves: Range<u32>,
    /// Indices of the nodes below; `None`: one source.
    pub children: Option<[u32; 2]>,
    /// Luminance of the irradiance that it sends, averaged over the receivers' area, plate units (gibson §7.1.1).
    pub mean: f64,
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
                "check the plate's pose (`calibrate`) and that the primitives of `model` enclose the view"
                    .into()
            }
            Self::NoLight { .. } => {
                "check that the probe's picture is not black and that faces look inwards".into()
            }
            Self::Share(_) => "set transfer.source_share between 0 and 1; 0.7 is usual".into(),
            Self::NoRays => "set transfer.rays to 8 or more".into(),
            Self::Radiance { .. } => "run `insitu run --force --from illuminate`".into(),
        }
    }
}

impl Transfers {
    /// Irradiance of all light on what a pixel looks at, plate units; `None` where it is no receiver.
    pub fn irradiance_on(&self, receiver: &Receiver) -> Option<[f32; 3]> {
        let (vertices, weights) = self.receivers.locate(receiver.patch, receiver.barycentric)?;
        Some(self.irradiance_at(vertices, weights))
    }

    /// Irradiance of all light between receiver vertices, plate units (see [`ReceiverMesh::locate`]).
    pub fn irradiance_at(&self, vertices: [u32; 3], weights: [f32; 3]) -> [f32; 3] {
        let at = |v: u32, k: usize| self.irradiance[(v as usize, k)];
        std::array::from_fn(|k| weights.iter().zip(vertices).map(|(w, v)| w * at(v, k)).sum())
    }
}

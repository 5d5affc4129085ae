//! The scene model: primitives in a hierarchy, fitted to what a person marked.

pub mod face;
pub mod gltf;
pub mod polygon;
pub mod sight;

mod export;
mod faces;
mod feature;
mod fit;
#[cfg(test)]
mod graph_tests;
mod guess;
mod marked;
mod parameters;
mod placed;
mod problem;
pub mod room;
#[cfg(test)]
mod tests;
mod tree;

pub use export::export;
pub use face::Face;
pub use fit::{Fitter, fit};
pub use marked::{Block, Marked};
pub use problem::Problem;
pub use tree::{Off, Views};

use crate::annotations::Kind;
use crate::artefact::json::JsonArtefact;
use serde::{Deserialize, Serialize};

/// A primitive in its place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FittedPrimitive {
    /// Its name; its faces are called `name` or `name.side`.
    pub name: String,
    /// Its shape.
    pub kind: Kind,
    /// What it stands or lies on.
    pub parent: Option<String>,
    /// Width, height, depth of a box or room; width, height of a quad; m.
    pub size_m: Vec<f64>,
    /// Standard deviations of these; 0 for what was given.
    pub size_sigma_m: Vec<f64>,
    /// Standard deviation of the corner that is known worst, in the direction in which it is, m; the camera's errors are in it where
    /// these are known.
    pub corner_sigma_m: f64,
    /// How many marks it has.
    pub marks: usize,
    /// Distance of its corners from their marks, rms in px.
    pub rms_px: f64,
    /// Of a room that was searched: where its faces are.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub faces: Vec<FaceDistance>,
}

/// How far a face of a room is from the camera that saw it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FaceDistance {
    /// `left`, `right`, `front`, `back` or `ceiling`.
    pub side: String,
    /// Distance, m.
    pub distance_m: f64,
    /// Its standard deviation.
    pub sigma_m: f64,
    /// What tells it.
    pub source: FaceSource,
}

/// What tells where a face is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaceSource {
    /// Its edges in the plate.
    Plate,
    /// A person's marks, or sizes.
    Marks,
    /// Nothing.
    Presumed,
}

/// The scene model: `model/scene.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    /// The primitives, parents before children.
    pub primitives: Vec<FittedPrimitive>,
    /// Their faces.
    pub faces: Vec<Face>,
    /// Distance of all corners from their marks, rms in px.
    pub rms_px: f64,
}

impl JsonArtefact for Scene {
    const FORMAT: &'static str = "insitu-scene";
    const VERSION: u32 = 2;
}

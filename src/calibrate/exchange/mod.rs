//! Cameras of other programs: COLMAP's models (text and binary), fSpy's projects. Their world is taken as the grid's frame: z up,
//! metres.

pub mod colmap;
pub mod fspy;

use super::world_from_grid;
use crate::camera::{Camera, Intrinsics};
use nalgebra::Isometry3;

/// Why a file of another program cannot be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// A line that is none of the format's.
    #[error("line {line} is no {what}: {text}")]
    Line {
        /// From 1.
        line: usize,
        /// What should stand there.
        what: &'static str,
        /// What does.
        text: String,
    },
    /// The file ends too early, or is not of the kind.
    #[error("is cut short or no {0}")]
    NotOne(&'static str),
    /// A lens that insitu does not know.
    #[error("camera {camera} has the model `{model}`")]
    Model {
        /// Its number.
        camera: u32,
        /// COLMAP's name, or number.
        model: String,
    },
    /// An image whose camera is not there.
    #[error("{image} was taken by camera {camera}, which is not there")]
    NoCamera {
        /// File name.
        image: String,
        /// Number of the camera.
        camera: u32,
    },
    /// A project that was not solved.
    #[error("holds no camera: {0}")]
    NoSolution(String),
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::Line { .. } | Self::NotOne(_) => "export it again",
            Self::Model { .. } => {
                "use SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV or FULL_OPENCV without k4 … k6, or undistort the \
                 images (`colmap image_undistorter`)"
            }
            Self::NoCamera { .. } => "export cameras and images together",
            Self::NoSolution(_) => "set vanishing points until fSpy shows no error, then save again",
        }
        .into()
    }
}

/// A photograph with its camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Posed {
    /// File name.
    pub image: String,
    /// Lens and pose in insitu's world.
    pub camera: Camera,
}

fn posed(intrinsics: Intrinsics, camera_from_grid: &Isometry3<f64>) -> Camera {
    Camera { intrinsics, world_from_camera: world_from_grid() * camera_from_grid.inverse() }
}

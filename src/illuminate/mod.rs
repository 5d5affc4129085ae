//! Light on the model: the probe's radiance is carried outwards along its rays onto a patch mesh, the plate's where it
//! sees the surface; reflectance follows from radiance and irradiance; what neither sees gathers its light from the
//! rest (Gibson and Chalmers 2003, §4.2).

pub mod build;
pub mod check;
pub mod distant;
pub mod gather;
mod lamps;
pub mod mesh;
mod outline;
pub mod patch;
pub mod project;
pub mod punctual;
#[cfg(test)]
pub mod room;
mod stage;
mod store;

pub use stage::put_light;
pub use store::{read_light, read_sky, write_light};

/// Why no light can be put on a model.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum Problem {
    /// There is nothing to put light on.
    #[error("the scene model has no face with an area ({0} faces)")]
    NoFaces(usize),
    /// The environment is dark.
    #[error("the environment holds no light")]
    Dark,
    /// A setting makes no sense.
    #[error("illuminate.{name} is {value}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::NoFaces(_) => "add a primitive to the annotations, e.g. the floor",
            Self::Dark => "check the probe's pictures and their exposures",
            Self::Setting { .. } => "give a positive number, or leave it out for the default",
        }
        .into()
    }
}

/// Radiance × area of a patch, by luminance.
pub(crate) fn power(mesh: &patch::PatchMesh, i: usize) -> f64 {
    f64::from(crate::image::luminance(mesh.patches[i].radiance)) * f64::from(mesh.area(i))
}

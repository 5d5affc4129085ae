//! Occlusion textures (Eisemann and Décoret 2006): soft shadows of rectangular lights in a time that depends neither on the
//! size of the light nor on the number of triangles.
//!
//! The scene is cut into [`Slices`] parallel to the light, all drawn in one pass ([`Mask`]) in the perspective of a centre
//! behind it ([`Frustum`]), and prefiltered ([`Filtered`]): what of the light a slice blocks at a point is then one lookup of
//! the mean over a square ([`Kernel`], eq. 4). [`OcclusionTextures`] combines the slices, by product for want of knowing how
//! they overlap (eq. 5). [`PlateShadow`] takes an object's shadow from a photograph: what is visible without the object
//! less what is visible with it.
//!
//! What the method cannot see: how the occlusion of different slices is correlated (a closed surface cut into slices leaks or
//! darkens in its penumbra), occluders in the receiver's own slice (contact shadows fade there), light that is no
//! rectangle.

mod combine;
mod filter;
mod find;
#[cfg(test)]
mod find_tests;
mod fit;
mod frustum;
mod light;
mod mipmap;
mod n_buffers;
mod plate;
mod slices;
mod summed_area;
#[cfg(test)]
mod tests;
mod textures;

use crate::error;

pub use filter::Filtered;
pub use find::{find, given};
pub use frustum::{Frustum, Kernel, Section};
pub use light::RectangularLight;
pub use mipmap::Mipmap;
pub use n_buffers::NBuffers;
pub(crate) use plate::Cut;
pub use plate::PlateShadow;
pub use slices::{Fade, MOST_SLICES, Mask, Slices};
pub use summed_area::SummedArea;
pub use textures::OcclusionTextures;

/// Why there are no rectangular lights.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum Problem {
    /// None of what is bright is a rectangle.
    #[error(
        "the scene has no rectangular light: {bright} bright patches, of a rectangle's shape to {share:.2} at best"
    )]
    NoRectangle {
        /// Number of bright patches.
        bright: usize,
        /// Largest intersection over union of a bright region and a rectangle.
        share: f64,
    },
    /// A rectangle of the settings.
    #[error("area light {index} of the settings has {what}")]
    AreaLight {
        /// Which one, from 0.
        index: usize,
        /// What is wrong with it.
        what: &'static str,
    },
}

impl error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::NoRectangle { .. } => {
                "set render.method to \"radiance-transfer\", which takes light of any shape, or give rectangles as \
                 render.area_lights"
            }
            Self::AreaLight { .. } => {
                "give a corner and two sides at right angles, in metres in the grid's frame, and the radiance where the \
                 model has no surface"
            }
        }
        .into()
    }
}

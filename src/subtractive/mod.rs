//! Subtractive shadows (DeCoro and Rusinkiewicz 2008): the whole unshadowed light in full detail, less a shadow buffer of
//! few lights and few pixels.
//!
//! The environment at the object's place is sampled to lights (§2 step 1, [`Light`]), each draws a shadow map
//! ([`Casters`], step 2b), what the hidden ones would send is summed at a few pixels and resampled once ([`ShadowBuffer`],
//! steps 2c, 2d and 4), and subtracted from the unshadowed light ([`Unshadowed`], steps 3 and 5). [`Detail`] holds its two
//! knobs (§2.1) and how a time per frame drives both. On the plate the unshadowed light is the photograph ([`LitPlate`]).
//!
//! The paper's lights lie at infinity. Here they lie where the scene model is seen in their direction, so that a near lamp
//! throws the shadow of a near lamp and what the model already hides is not taken twice.

mod brdf;
mod buffer;
mod cache;
mod casters;
mod detail;
mod gather;
mod ggx;
mod lights;
mod lit_plate;
mod local;
mod object;
mod plate;
mod structured;
mod surface;

pub use brdf::Brdf;
pub(crate) use brdf::ggx as ggx_distribution;
pub use buffer::ShadowBuffer;
pub(crate) use buffer::{grid, sampled};
pub use cache::RadianceCache;
pub use casters::Casters;
pub use detail::{Detail, Pace};
pub use gather::{Sent, gather};
pub use lights::Light;
pub(crate) use lights::sample;
pub(crate) use lit_plate::{LitPlate, half};
pub use local::Unshadowed;
pub(crate) use object::render_object;
pub use plate::Subtractive;
pub use surface::Surface;
pub(crate) use surface::pixel_angle;

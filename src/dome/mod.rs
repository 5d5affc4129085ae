//! The light dome (Supan, Stuppacher and Haller 2006): the environment as a dome of lights, one for each texel of a coarse
//! cube map, each with a shadow map.
//!
//! A picture of a mirror ball or by a fisheye lens is laid out by direction ([`SphereMap`]) on a cube ([`CubeMap`], §VI.1),
//! downsampled to [`lights`] (§V.C), whose maps are drawn few at a time ([`DomeMaps`], §V.A); what they hide is the shadow
//! buffer (eq. 3). [`LightDome`] is the method for stills: the environment is that of the scene model at the object's place.
//! `live` is the system of the paper.
//!
//! Beyond the paper: lights may stand at the centroid of their texel's brightness, and texels whose light stands badly are
//! split ([`Layout`]); with both a small bright light throws its own shadow, not one that is too soft or too far to the side.
//! In stills lights lie where the scene model is seen in their direction, unless `dome_at_infinity` is set.

pub(crate) mod cube;
mod lights;
mod maps;
mod object;
mod plate;
mod sphere_map;

pub use cube::{CubeMap, Sums};
pub use lights::{Cell, DomeLight, Layout, above, irradiance, lights, strongest};
pub use maps::{DomeMaps, OnItself, Pose, bound};
pub(crate) use object::render_object;
pub use plate::LightDome;
pub(crate) use plate::SIDE;
pub use sphere_map::{Fisheye, Problem, Seen, SphereMap};

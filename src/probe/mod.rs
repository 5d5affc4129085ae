//! The light probe.

pub mod latlong;
pub mod mirror_ball;

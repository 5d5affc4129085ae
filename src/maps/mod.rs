//! All directions in one picture: latitude and longitude, a cube, an octahedron, a mirror sphere. Pictures go from one layout to
//! another with their light: each part of a texel gives its radiance over its solid angle to the texel that it falls into.

mod convert;
mod layout;

pub use convert::{convert, power};
pub use layout::Layout;

use glam::Vec3;

/// Solid angle of a spherical triangle between unit vectors, sr (van Oosterom and Strackee 1983).
pub fn spherical_triangle(a: Vec3, b: Vec3, c: Vec3) -> f64 {
    let [a, b, c] = [a, b, c].map(|v| v.as_dvec3());
    let over = 1.0 + a.dot(b) + b.dot(c) + c.dot(a);
    2.0 * a.dot(b.cross(c)).abs().atan2(over)
}

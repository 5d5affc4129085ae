//! A box seen from inside, for tests.

use crate::model::face::Face;
use nalgebra::Point3;

/// Floor, ceiling and four walls of a room around the y axis with its floor at 0, all facing inwards.
pub fn faces(width: f64, height: f64, depth: f64) -> Vec<Face> {
    let (x, y, z) = (width / 2.0, height, depth / 2.0);
    let face = |name: &str, corners: [[f64; 3]; 4]| Face {
        name: format!("room.{name}"),
        vertices: corners.map(|[x, y, z]| Point3::new(x, y, z)).to_vec(),
        gloss: None,
    };
    vec![
        face("floor", [[-x, 0., -z], [-x, 0., z], [x, 0., z], [x, 0., -z]]),
        face("ceiling", [[-x, y, -z], [x, y, -z], [x, y, z], [-x, y, z]]),
        face("left", [[-x, 0., -z], [-x, y, -z], [-x, y, z], [-x, 0., z]]),
        face("right", [[x, 0., -z], [x, 0., z], [x, y, z], [x, y, -z]]),
        face("back", [[-x, 0., -z], [x, 0., -z], [x, y, -z], [-x, y, -z]]),
        face("front", [[-x, 0., z], [-x, y, z], [x, y, z], [x, 0., z]]),
    ]
}

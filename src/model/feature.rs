//! What a mark refers to: a corner, a place on an edge, on a cylinder's rim or on its side as seen.

use super::parameters::corner_number;
use super::placed::{Placed, Solid};
use crate::annotations::{Kind, Primitive};
use nalgebra::{Point3, Vector3};

/// Between the corners of an edge.
const ALONG: char = '/';

/// A part of a primitive that can be seen in a photograph, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Feature {
    /// A corner: as it is marked.
    Point(Point3<f64>),
    /// The line through two corners: somewhere along it.
    Edge([Point3<f64>; 2]),
    /// A circle: somewhere on it.
    Rim {
        /// Its middle.
        centre: Point3<f64>,
        /// Two directions across each other, as long as its radius.
        radii: [Vector3<f64>; 2],
    },
    /// The outline of an upright cylinder: somewhere along it.
    Side {
        /// Middles of bottom and top.
        axis: [Point3<f64>; 2],
        /// As the rim's.
        radii: [Vector3<f64>; 2],
        /// The one to the right as seen from outside.
        right: bool,
    },
}

/// The feature called `name`; `None` if the primitive has no such.
pub fn feature(primitive: &Primitive, placed: &Placed, values: &[f64], name: &str) -> Option<Feature> {
    match (primitive.kind, placed) {
        (Kind::Cylinder, Placed::Solid(solid)) => round(solid, name),
        _ if name.contains(ALONG) => {
            let (a, b) = name.split_once(ALONG)?;
            let [a, b] = [a, b].map(|end| corner(primitive, placed, values, end));
            Some(Feature::Edge([a?, b?]))
        }
        _ => corner(primitive, placed, values, name).map(Feature::Point),
    }
}

fn round(solid: &Solid, name: &str) -> Option<Feature> {
    let [diameter, height, _] = solid.size;
    let radii = [Vector3::x(), Vector3::z()].map(|a| solid.frame * a * (diameter / 2.0));
    let axis = [solid.at(0.0, 0.0, 0.0), solid.at(0.0, height, 0.0)];
    match name {
        "bottom" => Some(Feature::Rim { centre: axis[0], radii }),
        "top" => Some(Feature::Rim { centre: axis[1], radii }),
        "left" | "right" => Some(Feature::Side { axis, radii, right: name == "right" }),
        _ => None,
    }
}

fn signs(name: &str) -> Option<Vec<f64>> {
    let sign = |c| match c {
        '+' => Some(1.0),
        '-' => Some(-1.0),
        _ => None,
    };
    name.chars().map(sign).collect()
}

fn corner(primitive: &Primitive, placed: &Placed, values: &[f64], name: &str) -> Option<Point3<f64>> {
    match (primitive.kind, placed) {
        (Kind::Room | Kind::Box | Kind::Wedge, Placed::Solid(solid)) => {
            let [x, y, z] = signs(name)?[..] else { return None };
            // The upper edge of a wedge's front is cut off.
            if solid.kind == Kind::Wedge && y > 0.0 && z > 0.0 {
                return None;
            }
            let [w, h, d] = solid.size;
            Some(solid.at(x * w / 2.0, (y + 1.0) / 2.0 * h, z * d / 2.0))
        }
        (Kind::Extrusion, Placed::Solid(solid)) => {
            let p = solid.outline.get(corner_number(name)?)?;
            let y = match name.chars().last()? {
                '+' => solid.size[1],
                '-' => 0.0,
                _ => return None,
            };
            Some(solid.at(p.x, y, p.y))
        }
        (Kind::Quad, Placed::Flat(plane)) => {
            let [u, v] = signs(name)?[..] else { return None };
            Some(plane.at(u * values[3] / 2.0, v * values[4] / 2.0))
        }
        (Kind::Polygon, Placed::Flat(plane)) => {
            let k: usize = name.parse().ok()?;
            Some(plane.at(*values.get(2 * k)?, *values.get(2 * k + 1)?))
        }
        _ => None,
    }
}

/// Whether a primitive can have such a mark, whatever its size.
pub fn is_known(primitive: &Primitive, name: &str) -> bool {
    if let Some((a, b)) = name.split_once(ALONG) {
        return primitive.kind != Kind::Cylinder
            && a != b
            && [a, b].iter().all(|end| is_known(primitive, end));
    }
    let signs = |n: usize| name.len() == n && name.chars().all(|c| "+-".contains(c));
    match primitive.kind {
        Kind::Ground => false,
        Kind::Room | Kind::Box => signs(3),
        Kind::Wedge => signs(3) && !name.ends_with("++"),
        Kind::Quad => signs(2),
        Kind::Cylinder => ["top", "bottom", "left", "right"].contains(&name),
        Kind::Polygon => name.parse::<usize>().is_ok_and(|k| k < 1000),
        Kind::Extrusion => {
            let number = name.strip_suffix(['+', '-']).and_then(|n| n.parse::<usize>().ok());
            number.is_some_and(|k| k < 1000)
        }
    }
}

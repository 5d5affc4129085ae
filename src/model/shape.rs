//! Primitives as geometry: where their parameters put their corners, and the faces they have.

use super::Face;
use super::Problem;
use crate::annotations::{Kind, Lift, Primitive, Yaw};
use nalgebra::{Point3, Rotation3, Vector3};

/// How far a quad or polygon stands before the face it lies on, m, so that it wins over it.
const IN_FRONT_M: f64 = 0.002;

/// A plane with axes: `u` to the right and `v` up as seen from the front, `u × v` towards the viewer.
#[derive(Debug, Clone, Copy)]
pub struct Plane {
    /// Origin, m.
    pub origin: Point3<f64>,
    /// To the right.
    pub u: Vector3<f64>,
    /// Up.
    pub v: Vector3<f64>,
}

impl Plane {
    fn at(&self, u: f64, v: f64) -> Point3<f64> {
        self.origin + self.u * u + self.v * v
    }
}

/// A primitive in its place.
#[derive(Debug, Clone, Copy)]
pub enum Placed {
    /// Room, box or ground: middle of its bottom, turn about the vertical, height of what it stands on, extents.
    Solid {
        /// Seen from inside.
        hollow: bool,
        /// Middle of the bottom, m.
        base: Point3<f64>,
        /// Turn about +Y, rad.
        yaw: f64,
        /// Height of its support in the world, m.
        support: f64,
        /// Width, height, depth, m.
        size: [f64; 3],
    },
    /// Quad or polygon: the plane it lies in.
    Flat(Plane),
}

/// Names of a primitive's parameters, in their order.
pub fn parameter_names(primitive: &Primitive) -> Vec<String> {
    let fixed: &[&str] = match primitive.kind {
        Kind::Room | Kind::Box => &["x", "z", "lift", "yaw", "width", "height", "depth"],
        Kind::Quad => &["u", "v", "turn", "width", "height"],
        Kind::Ground => &[],
        Kind::Polygon => {
            let corners = (0..polygon_corners(primitive)).flat_map(|k| [format!("u{k}"), format!("v{k}")]);
            return corners.collect();
        }
    };
    fixed.iter().map(|s| s.to_string()).collect()
}

/// Index of the first extent among the parameters, and of the turn.
pub fn extents_and_turn(kind: Kind) -> Option<(std::ops::Range<usize>, usize)> {
    match kind {
        Kind::Room | Kind::Box => Some((4..7, 3)),
        Kind::Quad => Some((3..5, 2)),
        Kind::Ground | Kind::Polygon => None,
    }
}

/// Number of corners of a polygon: one more than the highest marked.
pub fn polygon_corners(primitive: &Primitive) -> usize {
    let numbers = primitive.marks.iter().filter_map(|m| m.corner.parse::<usize>().ok());
    // More than that nobody marks; the bound keeps a slip of the pen from asking for memory.
    numbers.max().map_or(0, |n| n.min(999) + 1)
}

/// What is known of the parameters: `None` is to be fitted.
pub fn known(primitive: &Primitive) -> Result<Vec<Option<f64>>, Problem> {
    let n = parameter_names(primitive).len();
    let Some((extents, turn)) = extents_and_turn(primitive.kind) else {
        return Ok(vec![None; n]);
    };
    let mut known = vec![None; n];
    known[turn] = (primitive.yaw == Yaw::Parent).then_some(0.0);
    if n == 7 {
        known[2] = (primitive.lift == Lift::None).then_some(0.0);
    }
    let (given, expected) = (primitive.size_m.len(), extents.len());
    if given != 0 && given != expected {
        return Err(Problem::SizeCount { name: primitive.name.clone(), given, expected });
    }
    for (value, k) in primitive.size_m.iter().zip(extents) {
        if !value.is_finite() || *value < 0.0 {
            return Err(Problem::Size { name: primitive.name.clone(), what: "size", value: *value });
        }
        known[k] = (*value > 0.0).then_some(*value);
    }
    Ok(known)
}

fn vertical(yaw: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::y_axis(), yaw)
}

/// Puts a primitive in its place. Without a parent it stands `level_m` over the horizontal plane at `ground`, m.
pub fn place(
    primitive: &Primitive,
    values: &[f64],
    parent: Option<&Placed>,
    ground: f64,
) -> Result<Placed, Problem> {
    let refuse = || Problem::Attach { name: primitive.name.clone(), attach: primitive.attach.clone() };
    let (origin, yaw) = match parent {
        None => (Point3::new(0.0, ground + primitive.level_m, 0.0), 0.0),
        Some(Placed::Flat(_)) => return Err(refuse()),
        Some(Placed::Solid { base, yaw, support, size, hollow }) => {
            let height = match primitive.attach.as_str() {
                "base" => *support,
                "top" if !hollow => base.y + size[1],
                _ => base.y,
            };
            (Point3::new(base.x, height, base.z), *yaw)
        }
    };
    let upright = ["top", "base", "floor"].contains(&primitive.attach.as_str());
    match primitive.kind {
        Kind::Ground => {
            let side = 2.0 * primitive.extent_m;
            Ok(Placed::Solid { hollow: true, base: origin, yaw, support: origin.y, size: [side, 0.0, side] })
        }
        Kind::Room | Kind::Box => {
            if !upright {
                return Err(refuse());
            }
            let [x, z, lift, turn, size @ ..] = values else { return Err(refuse()) };
            let base = origin + vertical(yaw) * Vector3::new(*x, *lift, *z);
            let size = [size[0], size[1], size[2]];
            let hollow = primitive.kind == Kind::Room;
            Ok(Placed::Solid { hollow, base, yaw: yaw + turn, support: origin.y, size })
        }
        Kind::Quad | Kind::Polygon => {
            let turn = vertical(yaw);
            let mut plane = Plane { origin, u: turn * Vector3::x(), v: turn * -Vector3::z() };
            if !upright {
                let parent = parent.ok_or_else(refuse)?;
                plane = side(parent, &primitive.attach).ok_or_else(refuse)?;
            }
            if let (Kind::Quad, [u, v, turn, ..]) = (primitive.kind, values) {
                let (sin, cos) = turn.sin_cos();
                plane = Plane {
                    origin: plane.at(*u, *v),
                    u: plane.u * cos + plane.v * sin,
                    v: plane.v * cos - plane.u * sin,
                };
            }
            Ok(Placed::Flat(plane))
        }
    }
}

/// A side of a solid, its origin in the middle. The front is the outside of a box and the inside of a room.
pub fn side(solid: &Placed, name: &str) -> Option<Plane> {
    let Placed::Solid { hollow, base, yaw, size: [w, h, d], .. } = solid else { return None };
    let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
    let middle = y * (h / 2.0);
    let (centre, u, v) = match name {
        "left" => (middle - x * (w / 2.0), z, y),
        "right" => (middle + x * (w / 2.0), -z, y),
        "front" => (middle + z * (d / 2.0), x, y),
        "back" => (middle - z * (d / 2.0), -x, y),
        "top" | "ceiling" => (y * *h, x, -z),
        "bottom" | "floor" => (Vector3::zeros(), x, z),
        _ => return None,
    };
    // From inside, left and right change places.
    let u = if *hollow { -u } else { u };
    let turn = vertical(*yaw);
    Some(Plane { origin: base + turn * centre, u: turn * u, v: turn * v })
}

/// A marked corner, m; `None` if the primitive has no such corner.
pub fn corner(primitive: &Primitive, placed: &Placed, values: &[f64], name: &str) -> Option<Point3<f64>> {
    let signs = || -> Option<Vec<f64>> {
        name.chars()
            .map(|c| match c {
                '+' => Some(1.0),
                '-' => Some(-1.0),
                _ => None,
            })
            .collect()
    };
    match (primitive.kind, placed) {
        (Kind::Room | Kind::Box, Placed::Solid { base, yaw, size: [w, h, d], .. }) => {
            let signs = signs()?;
            let [x, y, z] = signs[..] else { return None };
            Some(base + vertical(*yaw) * Vector3::new(x * w / 2.0, (y + 1.0) / 2.0 * h, z * d / 2.0))
        }
        (Kind::Quad, Placed::Flat(plane)) => {
            let signs = signs()?;
            let [u, v] = signs[..] else { return None };
            Some(plane.at(u * values[3] / 2.0, v * values[4] / 2.0))
        }
        (Kind::Polygon, Placed::Flat(plane)) => {
            let k: usize = name.parse().ok()?;
            Some(plane.at(*values.get(2 * k)?, *values.get(2 * k + 1)?))
        }
        _ => None,
    }
}

/// The faces, fronts counter-clockwise. The bottom of a box that rests on something is left out.
pub fn faces(primitive: &Primitive, placed: &Placed, values: &[f64]) -> Result<Vec<Face>, Problem> {
    let rectangle = |name: String, plane: &Plane, w: f64, h: f64| {
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        let vertices = corners.map(|[u, v]| plane.at(u * w / 2.0, v * h / 2.0)).to_vec();
        Face { name, vertices, gloss: primitive.gloss }
    };
    // Without a parent there is no face to win over.
    let lift_m = if primitive.parent.is_some() { IN_FRONT_M } else { 0.0 };
    let forward = |plane: &Plane| Plane { origin: plane.origin + plane.u.cross(&plane.v) * lift_m, ..*plane };
    Ok(match (primitive.kind, placed) {
        (kind, Placed::Solid { size: [w, h, d], .. }) => {
            let all: &[&str] = match kind {
                Kind::Ground => &["floor"],
                Kind::Room => &["floor", "ceiling", "left", "right", "front", "back"],
                _ if primitive.lift == Lift::None => &["top", "left", "right", "front", "back"],
                _ => &["top", "bottom", "left", "right", "front", "back"],
            };
            let face = |name: &&str| {
                let (width, height) = match *name {
                    "left" | "right" => (*d, *h),
                    "front" | "back" => (*w, *h),
                    _ => (*w, *d),
                };
                let label = if kind == Kind::Ground {
                    primitive.name.clone()
                } else {
                    format!("{}.{name}", primitive.name)
                };
                side(placed, name).map(|plane| rectangle(label, &plane, width, height))
            };
            all.iter().filter_map(face).collect()
        }
        (Kind::Quad, Placed::Flat(plane)) => {
            vec![rectangle(primitive.name.clone(), &forward(plane), values[3], values[4])]
        }
        (_, Placed::Flat(plane)) => {
            let corners: Vec<[f64; 2]> = values.chunks(2).map(|p| [p[0], p[1]]).collect();
            let corners =
                convex(corners).ok_or_else(|| Problem::NotConvex { name: primitive.name.clone() })?;
            let plane = forward(plane);
            let vertices = corners.iter().map(|[u, v]| plane.at(*u, *v)).collect();
            vec![Face { name: primitive.name.clone(), vertices, gloss: primitive.gloss }]
        }
    })
}

/// Counter-clockwise corners of a convex polygon; `None` if it is not convex.
fn convex(mut corners: Vec<[f64; 2]>) -> Option<Vec<[f64; 2]>> {
    let n = corners.len();
    let turn = |c: &[[f64; 2]], i: usize| {
        let (a, b, c) = (c[i], c[(i + 1) % n], c[(i + 2) % n]);
        (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
    };
    if n < 3 {
        return None;
    }
    if (0..n).map(|i| turn(&corners, i)).sum::<f64>() < 0.0 {
        corners.reverse();
    }
    // Turns of one sign all round, and once round: a star turns twice.
    let angle = |i: usize| {
        let (a, b, c) = (corners[i], corners[(i + 1) % n], corners[(i + 2) % n]);
        let (first, second) = ((b[1] - a[1]).atan2(b[0] - a[0]), (c[1] - b[1]).atan2(c[0] - b[0]));
        (second - first).rem_euclid(std::f64::consts::TAU)
    };
    let round: f64 = (0..n).map(angle).sum();
    let ok = (0..n).all(|i| turn(&corners, i) > 0.0) && round < 1.5 * std::f64::consts::TAU;
    ok.then_some(corners)
}

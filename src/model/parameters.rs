//! What a primitive's place and size are made of: the parameters that are fitted.

use super::Problem;
use crate::annotations::{Kind, Lift, Primitive, Yaw};
use std::ops::Range;

/// Whether a primitive stands, hangs or lies on a horizontal face.
pub fn is_upright(primitive: &Primitive) -> bool {
    ["top", "base", "floor", "bottom", "ceiling"].contains(&primitive.attach.as_str())
}

/// Whether it is under what carries it.
pub fn hangs(primitive: &Primitive) -> bool {
    ["bottom", "ceiling"].contains(&primitive.attach.as_str())
}

/// Whether it has its back on an upright face.
pub fn is_on_wall(primitive: &Primitive) -> bool {
    !is_upright(primitive) && is_boxlike(primitive.kind)
}

/// Whether it has a width, a height and a depth.
pub fn is_boxlike(kind: Kind) -> bool {
    matches!(kind, Kind::Room | Kind::Box | Kind::Wedge)
}

/// Names of a primitive's parameters, in their order.
pub fn names(primitive: &Primitive) -> Vec<String> {
    let leans = primitive.leans_on.is_some();
    let fixed: &[&str] = match primitive.kind {
        Kind::Room | Kind::Box | Kind::Wedge if leans => {
            &["place along the face", "lean", "lift", "turn", "width", "height", "depth"]
        }
        Kind::Room | Kind::Box | Kind::Wedge => {
            &["place in x", "place in z", "height over its support", "turn", "width", "height", "depth"]
        }
        Kind::Cylinder => &["place in x", "place in z", "height over its support", "diameter", "height"],
        Kind::Quad if leans => &["place along the face", "lean", "turn", "width", "height"],
        Kind::Quad => &["place in u", "place in v", "turn", "width", "height"],
        Kind::Ground => &[],
        Kind::Polygon => {
            let corners =
                (0..corner_count(primitive)).flat_map(|k| ["u", "v"].map(|a| format!("corner {k} in {a}")));
            return corners.collect();
        }
        Kind::Extrusion => {
            let corners =
                (0..corner_count(primitive)).flat_map(|k| ["x", "z"].map(|a| format!("corner {k} in {a}")));
            let own = ["height over its support", "height"].map(String::from);
            return own.into_iter().chain(corners).collect();
        }
    };
    fixed.iter().map(|s| s.to_string()).collect()
}

/// Indices of the extents among the parameters.
pub fn extents(kind: Kind) -> Range<usize> {
    match kind {
        Kind::Room | Kind::Box | Kind::Wedge => 4..7,
        Kind::Cylinder | Kind::Quad => 3..5,
        Kind::Extrusion => 1..2,
        Kind::Ground | Kind::Polygon => 0..0,
    }
}

/// Index of the height over the support.
pub fn lift(kind: Kind) -> Option<usize> {
    match kind {
        Kind::Room | Kind::Box | Kind::Wedge | Kind::Cylinder => Some(2),
        Kind::Extrusion => Some(0),
        _ => None,
    }
}

/// Index of the turn.
pub fn turn(kind: Kind) -> Option<usize> {
    match kind {
        Kind::Room | Kind::Box | Kind::Wedge => Some(3),
        Kind::Quad => Some(2),
        _ => None,
    }
}

/// Index of the lean, of what leans.
pub fn lean(primitive: &Primitive) -> Option<usize> {
    primitive.leans_on.as_ref().map(|_| 1)
}

/// Number of a corner of a polygon (`3`) or an extrusion (`3+`).
pub fn corner_number(corner: &str) -> Option<usize> {
    corner.trim_end_matches(['+', '-']).parse().ok()
}

/// Number of corners of a polygon or an extrusion: one more than the highest marked.
pub fn corner_count(primitive: &Primitive) -> usize {
    let numbers = primitive.marks.iter().filter_map(|m| corner_number(&m.corner));
    // More than that nobody marks; the bound keeps a slip of the pen from asking for memory.
    numbers.max().map_or(0, |n| n.min(999) + 1)
}

/// What is known of the parameters: `None` is to be fitted.
pub fn known(primitive: &Primitive) -> Result<Vec<Option<f64>>, Problem> {
    let mut known = vec![None; names(primitive).len()];
    let leans = primitive.leans_on.is_some();
    if let Some(turn) = turn(primitive.kind) {
        let free =
            primitive.yaw == Yaw::Free && !leans && !is_on_wall(primitive) && primitive.parallel_to.is_none();
        known[turn] = (!free).then_some(0.0);
    }
    if let Some(lift) = lift(primitive.kind) {
        // How high a thing hangs on a wall is told by nothing but its marks.
        let free = primitive.lift == Lift::Free || is_on_wall(primitive);
        known[lift] = (leans || !free).then_some(0.0);
    }
    if is_on_wall(primitive) {
        known[1] = Some(0.0);
    }
    let extents = extents(primitive.kind);
    let (given, expected) = (primitive.size_m.len(), extents.len());
    if given != 0 && given != expected {
        return Err(Problem::SizeCount { name: primitive.name.clone(), given, expected });
    }
    for (value, k) in primitive.size_m.iter().zip(extents) {
        if !value.is_finite() || *value < 0.0 {
            return Err(Problem::Size { name: primitive.name.clone(), what: "size".into(), value: *value });
        }
        known[k] = (*value > 0.0).then_some(*value);
    }
    Ok(known)
}

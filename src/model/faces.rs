//! The faces of primitives in their place.

use super::placed::{Placed, Plane, Solid};
use super::polygon::convex_pieces;
use super::{Face, Problem, parameters};
use crate::annotations::{Kind, Lift, Primitive};
use nalgebra::{Point2, Point3};

/// How far a quad or polygon stands before the face it lies on, m, so that it wins over it.
const IN_FRONT_M: f64 = 0.002;

/// The faces, convex, fronts counter-clockwise. A polygon with dents or holes is several, `name`, `name.1`, … What rests on
/// another's face is left out.
pub fn faces(primitive: &Primitive, placed: &Placed, values: &[f64]) -> Result<Vec<Face>, Problem> {
    let faces = match placed {
        Placed::Solid(solid) => of_solid(primitive, solid)?,
        Placed::Flat(plane) => {
            // Without a parent there is no face to win over; what leans lies on none.
            let lies = primitive.parent.is_some() && primitive.leans_on.is_none();
            let plane = plane.before(if lies { IN_FRONT_M } else { 0.0 });
            match primitive.kind {
                Kind::Quad => vec![(String::new(), rectangle(&plane, values[3], values[4]))],
                _ => of_polygon(primitive, &plane, values)?,
            }
        }
    };
    let named = |(side, vertices): (String, Vec<Point3<f64>>)| {
        let name =
            if side.is_empty() { primitive.name.clone() } else { format!("{}.{side}", primitive.name) };
        Face { name, vertices, gloss: primitive.gloss }
    };
    Ok(faces.into_iter().map(named).collect())
}

/// Name of a side and its corners.
type Side = (String, Vec<Point3<f64>>);

fn rectangle(plane: &Plane, w: f64, h: f64) -> Vec<Point3<f64>> {
    [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
        .map(|[u, v]| plane.at(u * w / 2.0, v * h / 2.0))
        .to_vec()
}

fn of_solid(primitive: &Primitive, solid: &Solid) -> Result<Vec<Side>, Problem> {
    let [w, h, d] = solid.size;
    let touches =
        primitive.lift == Lift::None && !parameters::is_on_wall(primitive) && primitive.leans_on.is_none();
    let hangs = parameters::hangs(primitive);
    let (top, bottom) = (!(touches && hangs), !touches || hangs);
    let side = |name: &str, corners: &dyn Fn(&Plane) -> Vec<Point3<f64>>| {
        solid.side(name).map(|plane| (name.to_string(), corners(&plane)))
    };
    let cuboid = |name: &str| {
        let (w, h) = match name {
            "left" | "right" => (d, h),
            "front" | "back" => (w, h),
            _ => (w, d),
        };
        side(name, &|plane| rectangle(plane, w, h))
    };
    Ok(match solid.kind {
        Kind::Ground => cuboid("floor").map(|(_, corners)| (String::new(), corners)).into_iter().collect(),
        Kind::Room => {
            ["floor", "ceiling", "left", "right", "front", "back"].into_iter().filter_map(cuboid).collect()
        }
        Kind::Wedge => {
            let triangle = |corners: [[f64; 3]; 3]| corners.map(|[x, y, z]| solid.at(x, y, z)).to_vec();
            let (x, z) = (w / 2.0, d / 2.0);
            let mut all = vec![
                side("slope", &|plane| rectangle(plane, w, h.hypot(d))),
                Some(("left".into(), triangle([[-x, 0.0, -z], [-x, 0.0, z], [-x, h, -z]]))),
                Some(("right".into(), triangle([[x, 0.0, z], [x, 0.0, -z], [x, h, -z]]))),
            ];
            all.extend((!parameters::is_on_wall(primitive)).then(|| cuboid("back")));
            all.extend(bottom.then(|| cuboid("bottom")));
            all.into_iter().flatten().collect()
        }
        Kind::Cylinder | Kind::Extrusion => {
            let mut all = Vec::new();
            for k in 0..solid.outline.len() {
                if let Some((a, b)) = solid.edge(k) {
                    let corners = [(a, 0.0), (b, 0.0), (b, h), (a, h)].map(|(p, y)| solid.at(p.x, y, p.y));
                    all.push((format!("side.{k}"), corners.to_vec()));
                }
            }
            for name in [top.then_some("top"), bottom.then_some("bottom")].into_iter().flatten() {
                all.extend(of_section(primitive, solid, name)?);
            }
            all
        }
        _ => {
            let back = (!parameters::is_on_wall(primitive)).then_some("back");
            let all = [
                top.then_some("top"),
                bottom.then_some("bottom"),
                Some("left"),
                Some("right"),
                Some("front"),
                back,
            ];
            all.into_iter().flatten().filter_map(cuboid).collect()
        }
    })
}

/// Top or bottom of what stands over an outline.
fn of_section(primitive: &Primitive, solid: &Solid, name: &str) -> Result<Vec<Side>, Problem> {
    let (y, sign) = if name == "top" { (solid.size[1], -1.0) } else { (0.0, 1.0) };
    // As seen from its front.
    let points: Vec<_> = solid.outline.iter().map(|p| Point2::new(p.x, sign * p.y)).collect();
    let pieces = convex_pieces(&points, &[(0..points.len()).collect()]);
    let pieces = pieces.ok_or_else(|| Problem::Outline { name: primitive.name.clone() })?;
    let corners = |piece: Vec<usize>| {
        piece.into_iter().map(|k| solid.at(solid.outline[k].x, y, solid.outline[k].y)).collect()
    };
    Ok(numbered(name, pieces.into_iter().map(corners)))
}

fn of_polygon(primitive: &Primitive, plane: &Plane, values: &[f64]) -> Result<Vec<Side>, Problem> {
    let points: Vec<_> = values.chunks_exact(2).map(|p| Point2::new(p[0], p[1])).collect();
    let in_hole = |k: &usize| primitive.holes.iter().any(|hole| hole.contains(k));
    let border = (0..points.len()).filter(|k| !in_hole(k)).collect();
    let outlines: Vec<Vec<usize>> = std::iter::once(border).chain(primitive.holes.iter().cloned()).collect();
    let pieces =
        convex_pieces(&points, &outlines).ok_or_else(|| Problem::Outline { name: primitive.name.clone() })?;
    let corners = |piece: Vec<usize>| piece.into_iter().map(|k| plane.at(points[k].x, points[k].y)).collect();
    Ok(numbered("", pieces.into_iter().map(corners)))
}

/// The first piece has the name itself, further ones a number.
fn numbered(name: &str, pieces: impl Iterator<Item = Vec<Point3<f64>>>) -> Vec<Side> {
    let called = |(k, corners): (usize, _)| match (k, name) {
        (0, _) => (name.to_string(), corners),
        (_, "") => (k.to_string(), corners),
        _ => (format!("{name}.{k}"), corners),
    };
    pieces.enumerate().map(called).collect()
}

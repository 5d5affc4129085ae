//! A layout as marks, and what is presumed of the faces that nothing tells of.

use super::Problem;
use super::contents::Contents;
use super::evidence::Evidence;
use super::layout::{AWAY, Edge, Layout, RIGHT, SIDES, Side, UP};
use super::search::{DISTANCE, search};
use super::view::View;
use crate::annotations::{Mark, Primitive, Yaw};
use crate::camera::Camera;
use crate::config;
use crate::exposure::Photograph;
use nalgebra::{Point2, Point3, Vector3};
use std::f64::consts::PI;

/// Accuracy of a found edge as a whole, px of the reduced plate.
const EDGE_SIGMA_PX: f64 = 1.0;
/// The step at a piece is that of the whole edge if the cosine between them is above this.
const SAME_STEP: f64 = 0.5;
/// Pieces of one edge lie within this of their middle, px across it.
const WITHIN_PX: f64 = 1.0;
/// Accuracy of the room's turn by the segments along its axes, rad.
const TURN_SIGMA: f64 = 0.2 * PI / 180.0;
/// Accuracy of a presumed height and of a presumed distance of a wall, m.
const PRESUMED_SIGMA_M: [f64; 2] = [0.4, 2.0];
/// A face that is not seen is at least so much beyond what is, m.
const BEYOND_M: f64 = 0.1;

/// A face that nothing in the picture fixes.
#[derive(Debug, Clone, PartialEq)]
pub struct Presumed {
    /// Which, by its name.
    pub side: &'static str,
    /// Distance from the camera, m, and its standard deviation.
    pub distance_m: f64,
    /// The latter.
    pub sigma_m: f64,
}

/// A room found in the plate.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// The primitive.
    pub name: String,
    /// Names of the faces whose edges are seen.
    pub sides: Vec<&'static str>,
    /// Marks on its edges.
    pub marks: Vec<Mark>,
    /// What is presumed of the others.
    pub presumed: Vec<Presumed>,
    /// From where distances count: the camera.
    pub from: Point3<f64>,
    /// What the fit starts from: place in x and z, height over the support, turn, width, height, depth.
    pub start: [f64; 7],
}

impl Found {
    /// The room's turn, as the parameter is, against that of the segments along its axes, in standard deviations.
    pub fn turn_residual(&self, turn: f64) -> f64 {
        (turn - self.start[3]) / TURN_SIGMA
    }

    /// What was done, in words.
    pub fn told(&self) -> Vec<String> {
        let list = |names: &[&str]| match names {
            [one] => one.to_string(),
            [first @ .., last] => format!("{} and {last}", first.join(", ")),
            [] => String::new(),
        };
        let name = &self.name;
        let mut all = vec![format!("`{name}` is found in the plate: {}", list(&self.sides))];
        let presumed: Vec<String> = (self.presumed.iter())
            .map(|p| format!("{} {:.1} ± {:.1} m from the camera", p.side, p.distance_m, p.sigma_m))
            .collect();
        let words: Vec<&str> = presumed.iter().map(String::as_str).collect();
        if !words.is_empty() {
            all.push(format!(
                "nothing in the plate tells of these faces of `{name}`, which are presumed: {}; mark them in the ball, or give size_m",
                list(&words)
            ));
        }
        all
    }
}

/// How the axes of the view lie in the room: x and z of each.
#[derive(Debug, Clone, Copy)]
struct Turned {
    right: [f64; 2],
    away: [f64; 2],
}

impl Turned {
    fn name(&self, side: Side) -> &'static str {
        let minus = |v: [f64; 2]| v.map(|c| -c);
        let [x, z] = match side {
            Side::Floor => return "floor",
            Side::Ceiling => return "ceiling",
            Side::Left => minus(self.right),
            Side::Right => self.right,
            Side::Back => self.away,
        };
        wall([x, z])
    }

    /// The wall behind the camera.
    fn behind(&self) -> &'static str {
        wall(self.away.map(|c| -c))
    }

    /// A corner by signs to the right, up, away.
    fn corner(&self, signs: [f64; 3]) -> String {
        let at = |k: usize| signs[RIGHT] * self.right[k] + signs[AWAY] * self.away[k];
        [at(0), signs[UP], at(1)].map(|s| if s > 0.0 { '+' } else { '-' }).iter().collect()
    }

    /// An edge, as marks name it.
    fn edge(&self, edge: &Edge) -> String {
        let mut signs = [0.0; 3];
        for side in edge.of {
            signs[side.normal()] = if matches!(side, Side::Floor | Side::Left) { -1.0 } else { 1.0 };
        }
        let [from, to] = [-1.0, 1.0].map(|end| {
            signs[edge.axis] = end;
            self.corner(signs)
        });
        format!("{from}/{to}")
    }
}

fn wall([x, z]: [f64; 2]) -> &'static str {
    match () {
        () if x < -0.5 => "left",
        () if x > 0.5 => "right",
        () if z < -0.5 => "back",
        () => "front",
    }
}

/// Finds a room in the plate, a photograph from `camera` called `image`. `ground_y`: what its floor lies on, in the world, m.
pub fn find(
    primitive: &Primitive,
    image: &str,
    plate: &Photograph,
    camera: &Camera,
    ground_y: f64,
    settings: &config::Model,
) -> Result<Found, Problem> {
    let height = camera.centre().y - ground_y - primitive.level_m;
    if height <= 0.0 {
        return Err(Problem::Below(height));
    }
    let given = primitive.turn_deg.to_radians();
    let own_x = Vector3::new(given.cos(), 0.0, -given.sin());
    let along = (primitive.yaw != Yaw::Free).then_some(own_x);
    let view = View::new(plate, camera, along)?;
    let evidence = Evidence::new(&view);
    let contents = Contents::new(&view, &evidence);
    let layout = search(&evidence, &contents, height)?;

    let world = |k: usize| camera.world_from_camera * view.axis(k);
    let (right, away) = (world(RIGHT), world(AWAY));
    let (turn, turned) = match along {
        None => ((-right.z).atan2(right.x), Turned { right: [1.0, 0.0], away: [0.0, -1.0] }),
        Some(x) => {
            let z = x.cross(&Vector3::y());
            let of = |v: &Vector3<f64>| [v.dot(&x).round(), v.dot(&z).round()];
            (given, Turned { right: of(&right), away: of(&away) })
        }
    };
    let sides: Vec<&'static str> =
        SIDES.into_iter().filter(|s| layout.has(*s)).map(|s| turned.name(s)).collect();
    let reach = seen(&view, &layout);
    let default = |side: Side| {
        let (least, cap) = match side {
            Side::Ceiling => (settings.presumed_height_m - height, reach[2]),
            Side::Left => (settings.presumed_wall_m, reach[0]),
            Side::Right => (settings.presumed_wall_m, reach[1]),
            _ => (settings.presumed_wall_m, 0.0),
        };
        least.max(cap.min(DISTANCE.end * height) + BEYOND_M)
    };
    let distance = |side: Side| if layout.has(side) { layout.distance(side) } else { default(side) };
    let behind = settings.presumed_wall_m;
    let presumed = [Side::Left, Side::Right, Side::Back, Side::Ceiling]
        .map(|side| (turned.name(side), distance(side)))
        .into_iter()
        .chain([(turned.behind(), behind)])
        .filter(|(side, _)| !sides.contains(side));
    let all: Vec<Presumed> = presumed
        .map(|(side, distance_m)| Presumed {
            side,
            distance_m,
            sigma_m: PRESUMED_SIGMA_M[usize::from(side != "ceiling")],
        })
        .collect();
    let presumed = all.iter().filter(|p| !is_told(primitive, &sides, &all, p.side)).cloned().collect();

    let middle = camera.centre()
        + right * ((distance(Side::Right) - distance(Side::Left)) / 2.0)
        + away * ((distance(Side::Back) - behind) / 2.0);
    let (across, deep) = (distance(Side::Left) + distance(Side::Right), distance(Side::Back) + behind);
    let [width, depth] = if turned.right[0].abs() > 0.5 { [across, deep] } else { [deep, across] };
    let start = [middle.x, middle.z, 0.0, turn - given, width, height + distance(Side::Ceiling), depth];
    let marks = layout.edges().iter().flat_map(|e| marks(&evidence, &view, &turned, e, image)).collect();
    Ok(Found { name: primitive.name.clone(), sides, marks, presumed, from: camera.centre(), start })
}

/// Whether a person's marks, or a known size and the face opposite, tell of a face.
fn is_told(primitive: &Primitive, found: &[&str], presumed: &[Presumed], side: &str) -> bool {
    let marked = |side: &str| primitive.marks.iter().any(|m| touches(&m.corner, side));
    let (axis, opposite) = match side {
        "left" => (0, "right"),
        "right" => (0, "left"),
        "back" => (2, "front"),
        "front" => (2, "back"),
        _ => (1, "floor"),
    };
    let known = primitive.size_m.get(axis).is_some_and(|size| *size > 0.0);
    // Of two faces of which nothing is told, one is presumed and the other follows.
    let first = presumed.iter().map(|p| p.side).find(|s| *s == side || *s == opposite);
    marked(side) || known && (found.contains(&opposite) || marked(opposite) || first != Some(side))
}

/// Whether a marked corner or edge is one of a face's.
pub fn touches(corner: &str, side: &str) -> bool {
    let (at, sign) = match side {
        "left" => (0, '-'),
        "right" => (0, '+'),
        "floor" => (1, '-'),
        "ceiling" => (1, '+'),
        "back" => (2, '-'),
        _ => (2, '+'),
    };
    corner.split('/').all(|end| end.chars().nth(at) == Some(sign))
}

/// The pieces that support an edge, as marks: together as accurate as one line.
fn marks(evidence: &Evidence, view: &View, turned: &Turned, edge: &Edge, image: &str) -> Vec<Mark> {
    let sum: Vector3<f64> = evidence.of(edge).filter_map(|p| p.step).sum();
    let Some(step) = sum.try_normalize(1e-9) else { return Vec::new() };
    let same = |s: &Vector3<f64>| s.dot(&step) > SAME_STEP;
    let mut pieces: Vec<_> = evidence.of(edge).filter(|p| p.step.as_ref().is_some_and(same)).collect();
    // Another edge beside this one is left out.
    let mut beside: Vec<f64> = pieces.iter().map(|p| p.beside).collect();
    beside.sort_by(f64::total_cmp);
    let middle = beside[beside.len() / 2];
    pieces.retain(|p| (p.beside - middle).abs() <= WITHIN_PX);
    let sigma_px = EDGE_SIGMA_PX * view.reduction * (pieces.len() as f64).sqrt();
    let mark = |at: Point2<f64>| {
        let stored = view.stored(&at) * view.reduction;
        let corner = turned.edge(edge);
        Mark {
            corner,
            image: image.into(),
            at: [stored.x, stored.y],
            sigma_px: Some(sigma_px),
            reflection: false,
        }
    };
    pieces.into_iter().map(|p| mark(p.at + p.across * p.beside)).collect()
}

/// How far to the left, to the right and up the picture shows the faces of a layout, m.
fn seen(view: &View, layout: &Layout) -> [f64; 3] {
    const STEPS: usize = 64;
    let size = [view.lens.width_px, view.lens.height_px].map(f64::from);
    let mut reach = [0.0f64; 3];
    for k in 0..STEPS * STEPS {
        let at = [k % STEPS, k / STEPS].map(|v| (v as f64 + 0.5) / STEPS as f64);
        let ray = view.ray(&crate::calibrate::undistorted(&view.lens, [at[0] * size[0], at[1] * size[1]]));
        if let Some((_, far)) = layout.face(&ray) {
            let point = ray * far;
            for (reach, there) in reach.iter_mut().zip([-point[RIGHT], point[RIGHT], point[UP]]) {
                *reach = reach.max(there);
            }
        }
    }
    reach
}

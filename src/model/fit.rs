//! All primitives fitted to all marks at once (tutorial §3). Children have their parameters in their parent's frame, so
//! that contact and alignment hold exactly.

use super::shape::{self, Placed};
use super::sight::{self, Ball, Sight};
use super::{FittedPrimitive, Problem, Scene};
use crate::annotations::{Kind, Primitive, Yaw};
use crate::camera::Camera;
use crate::config;
use crate::least_squares::{self, Loss};
use nalgebra::{DMatrix, DVector, Point2, Point3};
use std::collections::BTreeMap;

/// Smallest extent that a primitive may have, m.
const MIN_EXTENT_M: f64 = 1e-3;

/// What the marks refer to.
pub struct Views<'a> {
    /// Cameras by file name.
    pub cameras: &'a BTreeMap<String, Camera>,
    /// The mirror ball, for marks in reflections.
    pub ball: Option<Ball>,
    /// Height of the surface that primitives without a parent stand on, in the world, m.
    pub ground_y: f64,
}

struct Node<'a> {
    primitive: &'a Primitive,
    parent: Option<usize>,
    known: Vec<Option<f64>>,
    sights: Vec<Sight<'a>>,
}

/// The primitives in an order in which parents come first.
struct Tree<'a> {
    nodes: Vec<Node<'a>>,
    ground_y: f64,
}

/// Values of all parameters, by primitive.
type Values = Vec<Vec<f64>>;

/// Fits the scene.
pub fn fit(primitives: &[Primitive], views: &Views, settings: &config::Model) -> Result<Scene, Problem> {
    let tree = Tree::new(primitives, views)?;
    let mut values: Values = Vec::new();
    let mut placed = Vec::new();
    for node in &tree.nodes {
        let own = first_guess(node, node.parent.map(|p| &placed[p]), tree.ground_y)?;
        placed.push(shape::place(node.primitive, &own, node.parent.map(|p| &placed[p]), tree.ground_y)?);
        values.push(own);
    }
    tree.check_in_front(&values)?;

    let free: Vec<(usize, usize)> = tree.free().collect();
    let start: Vec<f64> = free.iter().map(|&(i, k)| values[i][k]).collect();
    let names: Vec<String> = free
        .iter()
        .map(|&(i, k)| {
            let primitive = tree.nodes[i].primitive;
            format!("{} of `{}`", shape::parameter_names(primitive)[k], primitive.name)
        })
        .collect();
    let with = |x: &DVector<f64>| {
        let mut all = values.clone();
        free.iter().zip(x.iter()).for_each(|(&(i, k), v)| all[i][k] = *v);
        all
    };
    let residuals = |x: &DVector<f64>| tree.errors(&with(x)).map(|e| e / settings.mark_sigma_px);
    let fit = match least_squares::minimise(&residuals, &names, &start, Loss::Squares) {
        // Marks that contradict each other can also keep a fit from settling; that is then the better message.
        Err(e @ least_squares::Problem::NotConverged { .. }) => {
            tree.check_agreement(&values, settings)?;
            return Err(e.into());
        }
        other => other?,
    };
    let values = with(&fit.parameters);
    tree.check_agreement(&values, settings)?;

    let sigma = |i: usize, k: usize| free.iter().position(|f| *f == (i, k)).map_or(0.0, |f| fit.sigma(f));
    let errors = tree.errors(&values).ok_or(least_squares::Problem::Start)?;
    let placed = tree.place(&values)?;
    let mut scene = Scene { primitives: Vec::new(), faces: Vec::new(), rms_px: sight::rms_px(&errors) };
    let mut row = 0;
    for (i, node) in tree.nodes.iter().enumerate() {
        let extents = shape::extents_and_turn(node.primitive.kind).map_or(0..0, |(extents, _)| extents);
        for k in extents.clone() {
            if values[i][k] < MIN_EXTENT_M {
                let (name, value) = (node.primitive.name.clone(), values[i][k]);
                return Err(Problem::Size {
                    name,
                    what: ["width", "height", "depth"][k - extents.start],
                    value,
                });
            }
        }
        let rows = 2 * node.sights.len();
        scene.primitives.push(FittedPrimitive {
            name: node.primitive.name.clone(),
            kind: node.primitive.kind,
            parent: node.primitive.parent.clone(),
            size_m: extents.clone().map(|k| values[i][k]).collect(),
            size_sigma_m: extents.map(|k| sigma(i, k)).collect(),
            marks: node.sights.len(),
            rms_px: sight::rms_px(&errors.rows(row, rows).clone_owned()),
        });
        row += rows;
        scene.faces.extend(shape::faces(node.primitive, &placed[i], &values[i])?);
    }
    Ok(scene)
}

impl<'a> Tree<'a> {
    fn new(primitives: &'a [Primitive], views: &Views<'a>) -> Result<Self, Problem> {
        if primitives.is_empty() {
            return Err(Problem::Empty);
        }
        let mut nodes: Vec<Node> = Vec::with_capacity(primitives.len());
        let mut waiting: Vec<&Primitive> = primitives.iter().collect();
        for (i, p) in primitives.iter().enumerate() {
            if primitives[..i].iter().any(|q| q.name == p.name) {
                return Err(Problem::Duplicate { name: p.name.clone() });
            }
            if let Some(gloss) = p.gloss.filter(|g| !g.is_sound()) {
                let (name, specular, shininess) = (p.name.clone(), gloss.specular, gloss.shininess);
                return Err(Problem::Gloss { name, specular, shininess });
            }
        }
        while !waiting.is_empty() {
            let before = waiting.len();
            let mut later = Vec::new();
            for primitive in waiting {
                let parent = match &primitive.parent {
                    None => None,
                    Some(parent) => {
                        let refuse = |why| {
                            let (name, parent) = (primitive.name.clone(), parent.clone());
                            Problem::Parent { name, parent, why }
                        };
                        let known = primitives.iter().find(|p| p.name == *parent);
                        let kind = known.ok_or_else(|| refuse("is not in the file"))?.kind;
                        if matches!(kind, Kind::Quad | Kind::Polygon) {
                            return Err(refuse("is flat and cannot carry anything"));
                        }
                        match nodes.iter().position(|n| n.primitive.name == *parent) {
                            Some(at) => Some(at),
                            None => {
                                later.push(primitive);
                                continue;
                            }
                        }
                    }
                };
                let sights = sights(primitive, views)?;
                nodes.push(Node { primitive, parent, known: shape::known(primitive)?, sights });
            }
            waiting = later;
            if waiting.len() == before {
                return Err(Problem::Cycle { name: waiting[0].name.clone() });
            }
        }
        Ok(Self { nodes, ground_y: views.ground_y })
    }

    /// Every parameter to be fitted, as (primitive, parameter).
    fn free(&self) -> impl Iterator<Item = (usize, usize)> {
        self.nodes.iter().enumerate().flat_map(|(i, node)| {
            node.known.iter().enumerate().filter(|(_, known)| known.is_none()).map(move |(k, _)| (i, k))
        })
    }

    fn place(&self, values: &Values) -> Result<Vec<Placed>, Problem> {
        let mut placed: Vec<Placed> = Vec::with_capacity(self.nodes.len());
        for (node, values) in self.nodes.iter().zip(values) {
            let parent = node.parent.map(|p| &placed[p]);
            placed.push(shape::place(node.primitive, values, parent, self.ground_y)?);
        }
        Ok(placed)
    }

    /// Errors of all marks in order, px, x and y in turn; `None` with a corner behind its camera.
    fn errors(&self, values: &Values) -> Option<DVector<f64>> {
        let placed = self.place(values).ok()?;
        let mut errors = Vec::new();
        for ((node, placed), values) in self.nodes.iter().zip(&placed).zip(values) {
            for (mark, sight) in node.primitive.marks.iter().zip(&node.sights) {
                let e = sight.error(&shape::corner(node.primitive, placed, values, &mark.corner)?)?;
                errors.extend([e.x, e.y]);
            }
        }
        Some(DVector::from_vec(errors))
    }

    fn check_in_front(&self, values: &Values) -> Result<(), Problem> {
        let placed = self.place(values)?;
        for ((node, placed), values) in self.nodes.iter().zip(&placed).zip(values) {
            for (mark, sight) in node.primitive.marks.iter().zip(&node.sights) {
                let corner = shape::corner(node.primitive, placed, values, &mark.corner);
                if corner.and_then(|c| sight.error(&c)).is_none() {
                    let (corner, image) = (mark.corner.clone(), mark.image.clone());
                    return Err(Problem::Behind { name: node.primitive.name.clone(), corner, image });
                }
            }
        }
        Ok(())
    }

    fn check_agreement(&self, values: &Values, settings: &config::Model) -> Result<(), Problem> {
        let errors = self.errors(values).ok_or(least_squares::Problem::Start)?;
        let rms_px = sight::rms_px(&errors);
        let limit_px = settings.max_rms_px;
        if rms_px <= limit_px {
            return Ok(());
        }
        let marks = self.nodes.iter().flat_map(|n| n.primitive.marks.iter().map(|m| (&n.primitive.name, m)));
        let lengths = errors.as_slice().chunks(2).map(|e| e[0].hypot(e[1]));
        match marks.zip(lengths).max_by(|a, b| a.1.total_cmp(&b.1)) {
            Some(((name, mark), worst_px)) => Err(Problem::Contradiction {
                rms_px,
                limit_px,
                name: name.clone(),
                corner: mark.corner.clone(),
                image: mark.image.clone(),
                worst_px,
            }),
            None => Ok(()),
        }
    }
}

fn sights<'a>(primitive: &Primitive, views: &Views<'a>) -> Result<Vec<Sight<'a>>, Problem> {
    let parameters = shape::parameter_names(primitive).len();
    let sight = |mark: &crate::annotations::Mark| {
        let (name, corner, image) = (primitive.name.clone(), mark.corner.clone(), mark.image.clone());
        let valid = match primitive.kind {
            Kind::Ground => false,
            Kind::Polygon => corner.parse::<usize>().is_ok_and(|k| 2 * k + 1 < parameters),
            Kind::Quad => corner.len() == 2 && corner.chars().all(|c| "+-".contains(c)),
            _ => corner.len() == 3 && corner.chars().all(|c| "+-".contains(c)),
        };
        if !valid {
            return Err(Problem::Corner { name, corner });
        }
        let pixel = Point2::from(mark.at);
        let camera = views.cameras.get(&image);
        let camera = camera.ok_or_else(|| Problem::Image {
            name: name.clone(),
            corner: corner.clone(),
            image: image.clone(),
        })?;
        if mark.reflection {
            let sight = views.ball.and_then(|ball| Sight::reflected(camera, &ball, pixel));
            return sight.ok_or(Problem::NoReflection { name, corner, image, at: mark.at });
        }
        Ok(Sight::Direct { camera, pixel })
    };
    primitive.marks.iter().map(sight).collect()
}

/// Parameters of one primitive from its own marks, its parent being in place. For a given turn all corners are linear in
/// the other parameters, and lying on a mark's ray is a linear equation; the turn is searched.
fn first_guess(node: &Node, parent: Option<&Placed>, ground_y: f64) -> Result<Vec<f64>, Problem> {
    let turn = shape::extents_and_turn(node.primitive.kind).map(|(_, turn)| turn);
    let turns: Vec<f64> = match (node.primitive.yaw, turn) {
        (Yaw::Free, Some(_)) => (0..120).map(|k| f64::from(3 * k).to_radians()).collect(),
        _ => vec![0.0],
    };
    let mut best: Option<(f64, Vec<f64>)> = None;
    for angle in turns {
        let mut values: Vec<f64> = node.known.iter().map(|k| k.unwrap_or(0.0)).collect();
        let mut free: Vec<usize> = (0..values.len()).filter(|&k| node.known[k].is_none()).collect();
        if let (Yaw::Free, Some(turn)) = (node.primitive.yaw, turn) {
            values[turn] = angle;
            free.retain(|&k| k != turn);
        }
        let cost = solve_linear(node, parent, ground_y, &mut values, &free)?;
        if best.as_ref().is_none_or(|(least, _)| cost < *least) {
            best = Some((cost, values));
        }
    }
    Ok(best.map(|(_, values)| values).unwrap_or_default())
}

/// Sets the free values; returns their error, with a penalty for extents below zero and corners behind the camera.
fn solve_linear(
    node: &Node,
    parent: Option<&Placed>,
    ground_y: f64,
    values: &mut [f64],
    free: &[usize],
) -> Result<f64, Problem> {
    let primitive = node.primitive;
    let corners = |values: &[f64]| -> Result<Vec<Point3<f64>>, Problem> {
        let placed = shape::place(primitive, values, parent, ground_y)?;
        let corner = |m: &crate::annotations::Mark| {
            let refuse = || Problem::Corner { name: primitive.name.clone(), corner: m.corner.clone() };
            shape::corner(primitive, &placed, values, &m.corner).ok_or_else(refuse)
        };
        primitive.marks.iter().map(corner).collect()
    };
    let mut distances = vec![1.0; node.sights.len()];
    // The second round knows how far the corners are, and weighs them.
    for _ in 0..3 {
        free.iter().for_each(|&k| values[k] = 0.0);
        let zero = corners(values)?;
        let mut matrix = DMatrix::zeros(2 * zero.len(), free.len());
        let mut right = DVector::zeros(2 * zero.len());
        let mut shifts = Vec::new();
        for &k in free {
            values[k] = 1.0;
            shifts.push(corners(values)?.iter().zip(&zero).map(|(a, b)| a - b).collect::<Vec<_>>());
            values[k] = 0.0;
        }
        for (m, sight) in node.sights.iter().enumerate() {
            for (e, (row, value)) in sight.equations(distances[m]).into_iter().enumerate() {
                right[2 * m + e] = value - row.dot(&zero[m].coords);
                shifts.iter().enumerate().for_each(|(k, s)| matrix[(2 * m + e, k)] = row.dot(&s[m]));
            }
        }
        if !free.is_empty() && !zero.is_empty() {
            let scale = matrix.norm().max(1e-9);
            let solution = matrix.svd(true, true).solve(&right, 1e-9 * scale);
            let solution = solution.map_err(|_| Problem::Fit(least_squares::Problem::Start))?;
            free.iter().zip(solution.iter()).for_each(|(&k, v)| values[k] = *v);
        }
        for (m, corner) in corners(values)?.iter().enumerate() {
            distances[m] = (corner - node.sights[m].ray().origin).norm();
        }
    }
    let mut cost = 0.0;
    if let Some((extents, _)) = shape::extents_and_turn(primitive.kind) {
        for k in extents {
            if values[k] <= 0.0 {
                cost += 1e6;
                // Something to start from, for what the marks of this primitive alone do not tell.
                values[k] = if values[k] == 0.0 { 1.0 } else { values[k] };
            }
        }
    }
    for (corner, sight) in corners(values)?.iter().zip(&node.sights) {
        cost += sight.error(corner).map_or(1e6, |e| e.norm_squared().min(1e6));
    }
    Ok(cost)
}

//! The primitives of a scene as a graph: parents, and what else they refer to, before them.

use super::Problem;
use super::feature::{self, feature};
use super::parameters;
use super::placed::{Around, Placed, place};
use super::room::Found;
use super::sight::{Ball, Miss, Sight};
use crate::annotations::{Kind, Mark, Primitive};
use crate::camera::Camera;
use crate::least_squares::{self, NormalEquations, Residuals};
use nalgebra::{DMatrix, DVector, Point2};
use std::collections::BTreeMap;

/// What the marks refer to.
#[derive(Clone, Copy)]
pub struct Views<'a> {
    /// Cameras by file name.
    pub cameras: &'a BTreeMap<String, Camera>,
    /// The mirror ball, for marks in reflections.
    pub ball: Option<Ball>,
    /// Height of the surface that primitives without a parent stand on, in the world, m.
    pub ground_y: f64,
    /// Rooms that were found in the plate.
    pub rooms: &'a [Found],
}

/// A mark that is off.
#[derive(Debug, Clone, PartialEq)]
pub struct Off {
    /// The primitive.
    pub name: String,
    /// The corner or edge.
    pub corner: String,
    /// The photograph.
    pub image: String,
    /// How far it is off, px.
    pub px: f64,
    /// The same in standard deviations of the mark.
    pub sigmas: f64,
}

/// A primitive, and by number what its place depends on.
pub(super) struct Node<'a> {
    pub primitive: &'a Primitive,
    pub parent: Option<usize>,
    pub parallel_to: Option<usize>,
    pub mirror: Option<(usize, usize)>,
    pub parameters: Vec<Parameter>,
    pub sights: Vec<Sight<'a>>,
    /// Weight of each mark, 1/px.
    pub weights: Vec<f64>,
    /// What was found of it in the plate.
    pub found: Option<&'a Found>,
}

/// Where a parameter's value comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Parameter {
    /// Given.
    Known(f64),
    /// To be fitted.
    Free,
    /// That of another primitive, by number and index.
    Same(usize, usize),
}

/// Values of all parameters, by primitive.
pub(super) type Values = Vec<Vec<f64>>;

/// The primitives in an order in which all that one refers to comes first.
pub(super) struct Tree<'a> {
    pub nodes: Vec<Node<'a>>,
    pub ground_y: f64,
    /// Parameters to be fitted, as (primitive, parameter), children first: so ordered their normal equations stay sparse.
    pub free: Vec<(usize, usize)>,
    /// For each primitive those whose place or size changes with it, itself first.
    pub affected: Vec<Vec<usize>>,
    /// For each primitive the free parameters that it depends on.
    pub depends: Vec<Vec<usize>>,
}

impl<'a> Tree<'a> {
    pub fn new(primitives: &'a [Primitive], views: &Views<'a>, mark_sigma_px: f64) -> Result<Self, Problem> {
        if primitives.is_empty() {
            return Err(Problem::Empty);
        }
        check_alone(primitives)?;
        let mut order: Vec<&Primitive> = Vec::with_capacity(primitives.len());
        let mut waiting: Vec<&Primitive> = primitives.iter().collect();
        for primitive in primitives {
            check_references(primitive, primitives)?;
        }
        while !waiting.is_empty() {
            let mut later = Vec::new();
            for &primitive in &waiting {
                let ready = primitive.references().iter().all(|r| order.iter().any(|q| q.name == **r));
                if ready { order.push(primitive) } else { later.push(primitive) }
            }
            if later.len() == waiting.len() {
                return Err(Problem::Cycle { name: waiting[0].name.clone() });
            }
            waiting = later;
        }
        let place = |name: &String| order.iter().position(|p| p.name == *name);
        let mut nodes: Vec<Node> = Vec::with_capacity(order.len());
        for primitive in &order {
            let same = primitive.same_size.as_ref().and_then(place);
            let mirror = primitive.mirror.as_ref().and_then(|m| Some((place(&m.of)?, place(&m.about)?)));
            let known = parameters::known(primitive)?.into_iter().enumerate();
            let extents = parameters::extents(primitive.kind);
            let parameter = |(k, known): (usize, Option<f64>)| match (mirror, same, known) {
                (Some((of, _)), _, _) => Parameter::Same(of, k),
                (None, Some(other), _) if extents.contains(&k) => Parameter::Same(other, k),
                (_, _, Some(value)) => Parameter::Known(value),
                _ => Parameter::Free,
            };
            let sigmas = primitive.marks.iter().map(|m| m.sigma_px.unwrap_or(mark_sigma_px));
            nodes.push(Node {
                primitive,
                parent: primitive.parent.as_ref().and_then(place),
                parallel_to: primitive.parallel_to.as_ref().and_then(place),
                mirror,
                parameters: known.map(parameter).collect(),
                sights: primitive
                    .marks
                    .iter()
                    .map(|m| sight(primitive, m, views))
                    .collect::<Result<_, _>>()?,
                weights: sigmas.map(|s| 1.0 / s).collect(),
                found: views.rooms.iter().find(|found| found.name == primitive.name),
            });
        }
        Ok(Self::linked(nodes, views.ground_y))
    }

    /// Of primitives in such an order.
    pub fn linked(nodes: Vec<Node<'a>>, ground_y: f64) -> Self {
        let is_free = |p: &Parameter| matches!(p, Parameter::Free);
        let of_node = |i: usize| {
            let all = nodes[i].parameters.iter().enumerate();
            all.filter(|(_, p)| is_free(p)).map(move |(k, _)| (i, k)).collect::<Vec<_>>()
        };
        let free: Vec<(usize, usize)> = (0..nodes.len()).rev().flat_map(of_node).collect();
        let mut affected: Vec<Vec<usize>> = Vec::with_capacity(nodes.len());
        for i in 0..nodes.len() {
            let mut hit = vec![i];
            for (j, node) in nodes.iter().enumerate().skip(i + 1) {
                let tied = node.parameters.iter().filter_map(|p| match p {
                    Parameter::Same(other, _) => Some(*other),
                    _ => None,
                });
                let mirror = node.mirror.into_iter().flat_map(|(a, b)| [a, b]);
                let mut refers = node.parent.into_iter().chain(node.parallel_to).chain(mirror).chain(tied);
                if refers.any(|r| hit.contains(&r)) {
                    hit.push(j);
                }
            }
            affected.push(hit);
        }
        let mut depends = vec![Vec::new(); nodes.len()];
        for (column, &(i, _)) in free.iter().enumerate() {
            affected[i].iter().for_each(|&j| depends[j].push(column));
        }
        Self { nodes, ground_y, free, affected, depends }
    }

    /// The free parameters by name.
    pub fn names(&self) -> Vec<String> {
        let name = |&(i, k): &(usize, usize)| {
            let primitive = self.nodes[i].primitive;
            format!("the {} of `{}`", parameters::names(primitive)[k], primitive.name)
        };
        self.free.iter().map(name).collect()
    }

    /// All values, those of the free parameters being `x`.
    pub fn values(&self, x: &[f64]) -> Values {
        let start = |p: &Parameter| if let Parameter::Known(v) = p { *v } else { 0.0 };
        let mut values: Values =
            self.nodes.iter().map(|n| n.parameters.iter().map(start).collect()).collect();
        self.free.iter().zip(x).for_each(|(&(i, k), v)| values[i][k] = *v);
        (0..self.nodes.len()).for_each(|i| self.tie(i, &mut values));
        values
    }

    /// The free ones of all values.
    pub fn free_of(&self, values: &Values) -> Vec<f64> {
        self.free.iter().map(|&(i, k)| values[i][k]).collect()
    }

    /// Sets those values of a primitive that are another's.
    pub fn tie(&self, i: usize, values: &mut Values) {
        for (k, parameter) in self.nodes[i].parameters.iter().enumerate() {
            if let Parameter::Same(other, at) = *parameter {
                values[i][k] = values[other][at];
            }
        }
    }

    pub fn place_one(&self, i: usize, values: &Values, placed: &[Placed]) -> Result<Placed, Problem> {
        let node = &self.nodes[i];
        let at = |k: usize| &placed[k];
        let around = Around {
            parent: node.parent.map(at),
            parallel_to: node.parallel_to.map(at),
            mirror: node.mirror.map(|(of, about)| (at(of), at(about))),
            ground_y: self.ground_y,
        };
        place(node.primitive, &values[i], &around)
    }

    pub fn place(&self, values: &Values) -> Result<Vec<Placed>, Problem> {
        let mut placed: Vec<Placed> = Vec::with_capacity(self.nodes.len());
        for i in 0..self.nodes.len() {
            placed.push(self.place_one(i, values, &placed)?);
        }
        Ok(placed)
    }

    /// What sees the marks, by primitive.
    pub fn sights(&self) -> Vec<&[Sight<'a>]> {
        self.nodes.iter().map(|n| &n.sights[..]).collect()
    }

    /// The same were the cameras others; the ball stays as it was seen. `None` where one is missing.
    pub fn sights_by<'c>(&self, cameras: &'c BTreeMap<String, Camera>) -> Option<Vec<Vec<Sight<'c>>>>
    where
        'a: 'c,
    {
        let seen = |(mark, sight): (&Mark, &Sight<'a>)| -> Option<Sight<'c>> {
            match sight {
                Sight::Direct { pixel, .. } => {
                    Some(Sight::Direct { camera: cameras.get(&mark.image)?, pixel: *pixel })
                }
                reflected => Some(reflected.clone()),
            }
        };
        let of_node = |n: &Node<'a>| n.primitive.marks.iter().zip(&n.sights).map(seen).collect();
        self.nodes.iter().map(of_node).collect()
    }

    /// How far the marks of a primitive are off; `None` with one behind its camera.
    pub fn misses(&self, i: usize, values: &Values, placed: &Placed) -> Option<Vec<Miss>> {
        self.misses_of(i, values, placed, &self.nodes[i].sights)
    }

    /// The same for what else may see them.
    pub fn misses_of(
        &self,
        i: usize,
        values: &Values,
        placed: &Placed,
        sights: &[Sight],
    ) -> Option<Vec<Miss>> {
        let node = &self.nodes[i];
        let miss = |(mark, sight): (&Mark, &Sight)| {
            sight.miss(&feature(node.primitive, placed, &values[i], &mark.corner)?)
        };
        node.primitive.marks.iter().zip(sights).map(miss).collect()
    }

    /// The same of all primitives.
    pub fn all_misses(&self, values: &Values) -> Option<Vec<Vec<Miss>>> {
        let placed = self.place(values).ok()?;
        (0..self.nodes.len()).map(|i| self.misses(i, values, &placed[i])).collect()
    }

    /// The same by mark, in words.
    pub fn off(&self, misses: &[Vec<Miss>]) -> Vec<Off> {
        let of_node = |(node, misses): (&Node, &Vec<Miss>)| {
            let marks = node.primitive.marks.iter().zip(&node.weights).zip(misses);
            let off = |((mark, weight), miss): ((&Mark, &f64), &Miss)| Off {
                name: node.primitive.name.clone(),
                corner: mark.corner.clone(),
                image: mark.image.clone(),
                px: miss.length(),
                sigmas: miss.length() * weight,
            };
            marks.map(off).collect::<Vec<_>>()
        };
        self.nodes.iter().zip(misses).flat_map(of_node).collect()
    }

    /// Weighted residuals of a primitive's marks, as they are seen.
    fn rows(&self, i: usize, values: &Values, placed: &Placed, sights: &[Sight]) -> Option<Vec<f64>> {
        let mut rows = Vec::new();
        let misses = self.misses_of(i, values, placed, sights)?;
        for (miss, weight) in misses.iter().zip(&self.nodes[i].weights) {
            let from = rows.len();
            miss.push(&mut rows);
            rows[from..].iter_mut().for_each(|r| *r *= weight);
        }
        if let Some(found) = self.nodes[i].found {
            for presumed in &found.presumed {
                let distance = self.distance(i, placed, presumed.side)?;
                rows.push((distance - presumed.distance_m) / presumed.sigma_m);
            }
            rows.extend(parameters::turn(Kind::Room).map(|k| found.turn_residual(values[i][k])));
        }
        Some(rows)
    }

    /// Weighted residuals of all marks, by primitive.
    pub fn all_rows(&self, x: &[f64], sights: &[&[Sight]]) -> Option<Vec<Vec<f64>>> {
        let values = self.values(x);
        let placed = self.place(&values).ok()?;
        let each = placed.iter().zip(sights).enumerate();
        each.map(|(i, (placed, sights))| self.rows(i, &values, placed, sights)).collect()
    }

    /// How far a face of a room that was found is from the camera that saw it, m.
    pub fn distance(&self, i: usize, placed: &Placed, side: &str) -> Option<f64> {
        let Placed::Solid(solid) = placed else { return None };
        let plane = solid.side(side)?;
        Some((self.nodes[i].found?.from - plane.origin).dot(&plane.normal()))
    }

    /// For each primitive its residuals and their derivatives by the parameters that it depends on.
    pub fn blocks(&self, x: &[f64], sights: &[&[Sight]]) -> Option<Vec<(Vec<f64>, DMatrix<f64>)>> {
        let mut values = self.values(x);
        let mut placed = self.place(&values).ok()?;
        let mut blocks = Vec::with_capacity(self.nodes.len());
        for (i, (placed, columns)) in placed.iter().zip(&self.depends).enumerate() {
            let rows = self.rows(i, &values, placed, sights[i])?;
            let derivatives = DMatrix::zeros(rows.len(), columns.len());
            blocks.push((rows, derivatives));
        }
        let rows = |j: usize, values: &Values, placed: &Placed| {
            self.rows(j, values, placed, sights[j]).ok_or(least_squares::Problem::Start.into())
        };
        for (j, columns) in self.slopes(&mut values, &mut placed, rows).ok()?.into_iter().enumerate() {
            for (column, slopes) in columns.into_iter().enumerate() {
                blocks[j].1.set_column(column, &DVector::from_vec(slopes));
            }
        }
        Some(blocks)
    }

    /// Derivatives of what depends on primitives' places and sizes, by central differences: for each primitive, by each of the free
    /// parameters on which it depends, in their order. `values` and `placed` are moved and put back.
    pub fn slopes<T: std::ops::Sub<Output = T> + std::ops::Div<f64, Output = T>>(
        &self,
        values: &mut Values,
        placed: &mut [Placed],
        of: impl Fn(usize, &Values, &Placed) -> Result<Vec<T>, Problem>,
    ) -> Result<Vec<Vec<Vec<T>>>, Problem> {
        let mut slopes: Vec<Vec<Vec<T>>> = self.nodes.iter().map(|_| Vec::new()).collect();
        for &(i, k) in &self.free {
            let affected = &self.affected[i];
            let kept: Vec<Placed> = affected.iter().map(|&j| placed[j].clone()).collect();
            let value = values[i][k];
            let h = f64::EPSILON.cbrt() * value.abs().max(1.0);
            let mut side = |moved: f64| -> Result<Vec<Vec<T>>, Problem> {
                values[i][k] = moved;
                let mut side = Vec::with_capacity(affected.len());
                for &j in affected {
                    self.tie(j, values);
                    placed[j] = self.place_one(j, values, placed)?;
                    side.push(of(j, values, &placed[j])?);
                }
                Ok(side)
            };
            let (up, down) = (side(value + h)?, side(value - h)?);
            values[i][k] = value;
            for (&j, kept) in affected.iter().zip(kept) {
                self.tie(j, values);
                placed[j] = kept;
            }
            for (&j, (up, down)) in affected.iter().zip(up.into_iter().zip(down)) {
                slopes[j].push(up.into_iter().zip(down).map(|(up, down)| (up - down) / (2.0 * h)).collect());
            }
        }
        Ok(slopes)
    }
}

impl Residuals for Tree<'_> {
    fn residuals(&self, x: &DVector<f64>) -> Option<DVector<f64>> {
        Some(DVector::from_vec(self.all_rows(x.as_slice(), &self.sights())?.concat()))
    }

    fn jacobian(&self, x: &DVector<f64>) -> Option<DMatrix<f64>> {
        let blocks = self.blocks(x.as_slice(), &self.sights())?;
        let mut jacobian = DMatrix::zeros(blocks.iter().map(|b| b.0.len()).sum(), x.len());
        let mut from = 0;
        for ((rows, derivatives), columns) in blocks.iter().zip(&self.depends) {
            for (c, &column) in columns.iter().enumerate() {
                jacobian.view_mut((from, column), (rows.len(), 1)).copy_from(&derivatives.column(c));
            }
            from += rows.len();
        }
        Some(jacobian)
    }

    fn normal_equations(&self, x: &DVector<f64>) -> Option<NormalEquations> {
        let mut equations = NormalEquations::zero(x.len());
        let blocks = self.blocks(x.as_slice(), &self.sights())?;
        for ((rows, derivatives), columns) in blocks.iter().zip(&self.depends) {
            equations.add(&DVector::from_column_slice(rows), derivatives, columns);
        }
        Some(equations)
    }
}

fn check_alone(primitives: &[Primitive]) -> Result<(), Problem> {
    for (i, p) in primitives.iter().enumerate() {
        if primitives[..i].iter().any(|q| q.name == p.name) {
            return Err(Problem::Duplicate { name: p.name.clone() });
        }
        if let Some(gloss) = p.gloss.filter(|g| !g.is_sound()) {
            let (name, specular, shininess) = (p.name.clone(), gloss.specular, gloss.shininess);
            return Err(Problem::Gloss { name, specular, shininess });
        }
        let wild = |m: &&Mark| m.sigma_px.is_some_and(|s| !(s.is_finite() && s > 0.0));
        if let Some(mark) = p.marks.iter().find(wild) {
            let (name, corner) = (p.name.clone(), mark.corner.clone());
            return Err(Problem::Sigma { name, corner, value: mark.sigma_px.unwrap_or_default() });
        }
        if p.search && !super::room::can_be_searched(p) {
            return Err(Problem::Search { name: p.name.clone() });
        }
        if p.leans_on.is_some() && !matches!(p.kind, Kind::Box | Kind::Quad) {
            return Err(Problem::Leaning { name: p.name.clone() });
        }
    }
    Ok(())
}

/// What a primitive refers to must be there, and of a kind that can serve.
fn check_references(primitive: &Primitive, all: &[Primitive]) -> Result<(), Problem> {
    let flat = |p: &Primitive| matches!(p.kind, Kind::Quad | Kind::Polygon);
    let other_kind = |p: &Primitive| p.kind != primitive.kind;
    let check = |what, other: Option<&String>, serves: &dyn Fn(&Primitive) -> bool, why| {
        let Some(other) = other else { return Ok(()) };
        let refuse =
            |why| Problem::Reference { name: primitive.name.clone(), what, other: other.clone(), why };
        let found = all.iter().find(|p| p.name == *other).ok_or_else(|| refuse("is not in the file"))?;
        if serves(found) { Ok(()) } else { Err(refuse(why)) }
    };
    let mirror = primitive.mirror.as_ref();
    check("parent", primitive.parent.as_ref(), &|p| !flat(p), "is flat and cannot carry anything")?;
    let upright = |p: &Primitive| !flat(p) && p.leans_on.is_none();
    check("parallel_to", primitive.parallel_to.as_ref(), &upright, "has no upright axis of its own")?;
    let sized = |p: &Primitive| !other_kind(p) && !parameters::extents(p.kind).is_empty();
    check("same_size", primitive.same_size.as_ref(), &sized, "is of another kind, or has no size")?;
    let solid = |p: &Primitive| !other_kind(p) && !flat(p) && !matches!(p.kind, Kind::Room | Kind::Ground);
    check(
        "mirror.of",
        mirror.map(|m| &m.of),
        &solid,
        "is of another kind, or of one that has no mirror image",
    )?;
    check("mirror.about", mirror.map(|m| &m.about), &upright, "has no upright middle")
}

/// A mark as what sees it.
pub(super) fn sight<'a>(primitive: &Primitive, mark: &Mark, views: &Views<'a>) -> Result<Sight<'a>, Problem> {
    let (name, corner, image) = (primitive.name.clone(), mark.corner.clone(), mark.image.clone());
    if !feature::is_known(primitive, &corner) {
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
}

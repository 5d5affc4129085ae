//! Primitives within a larger fit, in which the cameras that see their marks move, too.

use super::Problem;
use super::feature::{Feature, feature};
use super::guess::first_guess;
use super::parameters;
use super::sight::Miss;
use super::tree::{Off, Parameter, Tree, Values, Views};
use crate::annotations::Primitive;
use crate::camera::Camera;
use crate::least_squares;
use nalgebra::{DMatrix, DVector, Point3};
use std::collections::BTreeMap;

/// Turns that are tried for what its own corners leave free to turn.
const TURNS: usize = 72;
/// Steps from a first guess, at most.
const STEPS: usize = 30;

/// Primitives with marks that are seen directly.
pub struct Marked<'a> {
    tree: Tree<'a>,
}

/// Residuals that depend on some of the parameters only.
pub struct Block<'b> {
    /// Weighted residuals.
    pub rows: Vec<f64>,
    /// Their derivatives by those parameters.
    pub derivatives: DMatrix<f64>,
    /// Which these are, in rising order.
    pub columns: &'b [usize],
}

impl<'a> Marked<'a> {
    /// The primitives, and values of their parameters near which a fit ends while the cameras stand as they are. All marks must
    /// be in photographs of `views`, none in the ball.
    pub fn new(
        primitives: &'a [Primitive],
        views: &Views<'a>,
        mark_sigma_px: f64,
    ) -> Result<(Self, DVector<f64>), Problem> {
        let tree = Tree::new(primitives, views, mark_sigma_px)?;
        let values = match untold_turn(&tree) {
            None => first_guess(&tree)?,
            Some((i, k)) => {
                let turned = |n: usize| {
                    let mut tried = Tree::new(primitives, views, mark_sigma_px)?;
                    let turn = std::f64::consts::TAU * n as f64 / TURNS as f64;
                    tried.nodes[i].parameters[k] = Parameter::Known(turn);
                    let tried = Tree::linked(tried.nodes, tried.ground_y);
                    let values = first_guess(&tried)?;
                    Ok((cost(&tried, &values), values))
                };
                let tried: Result<Vec<_>, Problem> =
                    (0..TURNS).map(turned).filter(|t| !matches!(t, Err(Problem::Behind { .. }))).collect();
                let best = tried?.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
                best.map_or_else(|| first_guess(&tree), |(_, values)| Ok(values))?
            }
        };
        let x = DVector::from_vec(tree.free_of(&values));
        let (x, _) = least_squares::descend(&tree, x, STEPS).ok_or(least_squares::Problem::Start)?;
        Ok((Self { tree }, x))
    }

    /// Names of the parameters.
    pub fn names(&self) -> Vec<String> {
        self.tree.names()
    }

    /// How many marks there are.
    pub fn marks(&self) -> usize {
        self.tree.nodes.iter().map(|n| n.sights.len()).sum()
    }

    /// Weighted residuals of all marks; `None` with one behind its camera.
    pub fn rows(&self, x: &[f64], cameras: &BTreeMap<String, Camera>) -> Option<Vec<Vec<f64>>> {
        let sights = self.tree.sights_by(cameras)?;
        self.tree.all_rows(x, &sights.iter().map(|s| &s[..]).collect::<Vec<_>>())
    }

    /// The same with derivatives.
    pub fn blocks(&self, x: &[f64], cameras: &BTreeMap<String, Camera>) -> Option<Vec<Block<'_>>> {
        let sights = self.tree.sights_by(cameras)?;
        let blocks = self.tree.blocks(x, &sights.iter().map(|s| &s[..]).collect::<Vec<_>>())?;
        let block = |((rows, derivatives), columns)| Block { rows, derivatives, columns };
        Some(blocks.into_iter().zip(self.tree.depends.iter().map(|d| &d[..])).map(block).collect())
    }

    /// How far each mark is off.
    pub fn off(&self, x: &[f64], cameras: &BTreeMap<String, Camera>) -> Option<Vec<Off>> {
        let (values, sights) = (self.tree.values(x), self.tree.sights_by(cameras)?);
        let placed = self.tree.place(&values).ok()?;
        let misses = |i: usize| self.tree.misses_of(i, &values, &placed[i], &sights[i]);
        Some(self.tree.off(&(0..placed.len()).map(misses).collect::<Option<Vec<_>>>()?))
    }

    /// Corners that are marked, with where: primitive, corner, place in the world.
    pub fn corners(&self, x: &[f64]) -> Vec<(&str, &str, Point3<f64>)> {
        let values = self.tree.values(x);
        let Ok(placed) = self.tree.place(&values) else { return Vec::new() };
        let mut all = Vec::new();
        for (i, node) in self.tree.nodes.iter().enumerate() {
            for mark in &node.primitive.marks {
                if let Some(Feature::Point(p)) = feature(node.primitive, &placed[i], &values[i], &mark.corner)
                {
                    all.push((&node.primitive.name[..], &mark.corner[..], p));
                }
            }
        }
        all
    }
}

/// The turn of a primitive that carries others, where no two corners of its own say it.
fn untold_turn(tree: &Tree) -> Option<(usize, usize)> {
    let of_node = |i: usize| {
        let node = &tree.nodes[i];
        let k = parameters::turn(node.primitive.kind)?;
        let corners = node.primitive.marks.iter().filter(|m| !m.corner.contains('/')).count();
        let untold = node.parameters[k] == Parameter::Free && corners < 2 && tree.affected[i].len() > 1;
        untold.then_some((i, k))
    };
    (0..tree.nodes.len()).find_map(of_node)
}

/// How far all marks are off, px² in sum, none by more than a tenth of a picture.
fn cost(tree: &Tree, values: &Values) -> f64 {
    const MOST_PX: f64 = 100.0;
    let Ok(placed) = tree.place(values) else { return f64::INFINITY };
    let of_mark = |miss: Option<f64>| miss.unwrap_or(MOST_PX).min(MOST_PX).powi(2);
    let of_node = |i: usize| -> f64 {
        let node = &tree.nodes[i];
        let marks = node.primitive.marks.iter().zip(&node.sights);
        marks
            .map(|(m, sight)| {
                let feature = feature(node.primitive, &placed[i], &values[i], &m.corner);
                of_mark(feature.and_then(|f| sight.miss(&f)).as_ref().map(Miss::length))
            })
            .sum()
    };
    (0..tree.nodes.len()).map(of_node).sum()
}

//! All primitives fitted to all marks at once (tutorial §3).

use super::guess::first_guess;
use super::sight::{self, Miss};
use super::tree::{Tree, Values, Views, sight};
use super::{FaceDistance, FaceSource, FittedPrimitive, Problem, Scene, faces, parameters};
use crate::annotations::Primitive;
use crate::config;
use crate::least_squares::{self, Fit, Loss};
use nalgebra::DVector;

/// Smallest extent that a primitive may have, m.
const MIN_EXTENT_M: f64 = 1e-3;
/// Step of the derivatives of a face's distance, m or rad.
const STEP: f64 = 1e-5;
/// Steps after a mark has moved, at most.
const DRAG_STEPS: usize = 12;

/// Fits the scene.
pub fn fit(primitives: &[Primitive], views: &Views, settings: &config::Model) -> Result<Scene, Problem> {
    Fitter::new(primitives, views, settings)?.scene()
}

/// A scene and its marks, solved again as a mark moves: as fast as a mouse moves it.
pub struct Fitter<'a> {
    tree: Tree<'a>,
    views: Views<'a>,
    settings: &'a config::Model,
    x: DVector<f64>,
}

impl<'a> Fitter<'a> {
    /// The scene as each primitive's own marks have it; [`Self::scene`] fits it.
    pub fn new(
        primitives: &'a [Primitive],
        views: &Views<'a>,
        settings: &'a config::Model,
    ) -> Result<Self, Problem> {
        let tree = Tree::new(primitives, views, settings.mark_sigma_px)?;
        let values = first_guess(&tree)?;
        let x = DVector::from_vec(tree.free_of(&values));
        Ok(Self { tree, views: *views, settings, x })
    }

    /// How many parameters are fitted.
    pub fn parameters(&self) -> usize {
        self.x.len()
    }

    /// The fit from some values, with what it is worth.
    fn solved(&self, values: &Values) -> Result<Fit, Problem> {
        let start = self.tree.free_of(values);
        match least_squares::minimise(&self.tree, &self.tree.names(), &start, Loss::Squares) {
            // Marks that contradict each other can also keep a fit from settling; that is then the better message.
            Err(e @ least_squares::Problem::NotConverged { .. }) => {
                self.check_agreement(values)?;
                Err(e.into())
            }
            other => Ok(other?),
        }
    }

    /// Moves the `mark`-th mark of a primitive to a place in its photograph, px, and solves from where it stands. Says whether
    /// there is such a mark, and a scene that can be seen so; otherwise nothing changes.
    pub fn drag(&mut self, primitive: &str, mark: usize, at: [f64; 2]) -> bool {
        let Some(node) = self.tree.nodes.iter_mut().find(|n| n.primitive.name == primitive) else {
            return false;
        };
        let Some(moved) = node.primitive.marks.get(mark) else { return false };
        let moved = crate::annotations::Mark { at, ..moved.clone() };
        let Ok(sight) = sight(node.primitive, &moved, &self.views) else { return false };
        let before = std::mem::replace(&mut node.sights[mark], sight);
        match least_squares::descend(&self.tree, self.x.clone(), DRAG_STEPS) {
            Some((x, _)) => self.x = x,
            None => {
                if let Some(node) = self.tree.nodes.iter_mut().find(|n| n.primitive.name == primitive) {
                    node.sights[mark] = before;
                }
                return false;
            }
        }
        true
    }

    /// The scene fitted to the marks as they stand, with standard deviations.
    pub fn scene(&mut self) -> Result<Scene, Problem> {
        let fit = self.solved(&self.tree.values(self.x.as_slice()))?;
        self.x = fit.parameters.clone();
        let tree = &self.tree;
        let values = tree.values(fit.parameters.as_slice());
        self.check_agreement(&values)?;
        let stated = self.stated(&fit);
        let sigma = |i: usize, k: usize| {
            let (i, k) = self.source(i, k);
            tree.free.iter().position(|f| *f == (i, k)).map_or(0.0, |f| stated * fit.sigma(f))
        };
        let misses = tree.all_misses(&values).ok_or(least_squares::Problem::Start)?;
        let placed = tree.place(&values)?;
        let rms_px = sight::rms_px(&misses.concat());
        let mut scene = Scene { primitives: Vec::new(), faces: Vec::new(), rms_px };
        for (i, node) in tree.nodes.iter().enumerate() {
            let primitive = node.primitive;
            let extents = parameters::extents(primitive.kind);
            if let Some(k) = extents.clone().find(|&k| values[i][k] < MIN_EXTENT_M) {
                let (name, value) = (primitive.name.clone(), values[i][k]);
                return Err(Problem::Size { name, what: parameters::names(primitive)[k].clone(), value });
            }
            scene.primitives.push(FittedPrimitive {
                name: primitive.name.clone(),
                kind: primitive.kind,
                parent: primitive.parent.clone(),
                size_m: extents.clone().map(|k| values[i][k]).collect(),
                size_sigma_m: extents.map(|k| sigma(i, k)).collect(),
                marks: node.sights.len(),
                rms_px: sight::rms_px(&misses[i]),
                faces: self.face_distances(i, &fit),
            });
            scene.faces.extend(faces::faces(primitive, &placed[i], &values[i])?);
        }
        Ok(scene)
    }

    /// What is found or presumed of a room is no better than stated, however well it fits: a factor of standard deviations.
    fn stated(&self, fit: &Fit) -> f64 {
        let freedom = fit.residuals.len().saturating_sub(fit.parameters.len());
        let searched = self.tree.nodes.iter().any(|node| node.found.is_some());
        let factor = (freedom as f64 / fit.cost().max(f64::MIN_POSITIVE)).sqrt();
        if searched && freedom > 0 { factor.max(1.0) } else { 1.0 }
    }

    /// Where the faces of a room are that was found in the plate.
    fn face_distances(&self, i: usize, fit: &Fit) -> Vec<FaceDistance> {
        let tree = &self.tree;
        let Some(found) = tree.nodes[i].found else { return Vec::new() };
        let distance = |x: &DVector<f64>, side: &str| {
            let placed = tree.place(&tree.values(x.as_slice())).ok()?;
            tree.distance(i, &placed[i], side)
        };
        let face = |side: &&str| {
            let mut by_all = DVector::zeros(fit.parameters.len());
            for k in (0..by_all.len()).filter(|k| tree.free[*k].0 == i) {
                let moved = |by: f64| {
                    let mut x = fit.parameters.clone();
                    x[k] += by;
                    distance(&x, side)
                };
                by_all[k] = (moved(STEP)? - moved(-STEP)?) / (2.0 * STEP);
            }
            let presumed = found.presumed.iter().any(|p| p.side == *side);
            Some(FaceDistance {
                side: side.to_string(),
                distance_m: distance(&fit.parameters, side)?,
                sigma_m: self.stated(fit) * by_all.dot(&(&fit.covariance * &by_all)).max(0.0).sqrt(),
                source: match presumed {
                    true => FaceSource::Presumed,
                    false if found.sides.contains(side) => FaceSource::Plate,
                    false => FaceSource::Marks,
                },
            })
        };
        ["left", "right", "front", "back", "ceiling"].iter().filter_map(face).collect()
    }

    /// The parameter whose value it is.
    fn source(&self, i: usize, k: usize) -> (usize, usize) {
        match self.tree.nodes[i].parameters[k] {
            super::tree::Parameter::Same(other, at) => self.source(other, at),
            _ => (i, k),
        }
    }

    fn check_agreement(&self, values: &Values) -> Result<(), Problem> {
        let misses = self.tree.all_misses(values).ok_or(least_squares::Problem::Start)?;
        let rms_px = sight::rms_px(&misses.concat());
        let limit_px = self.settings.max_rms_px;
        if rms_px <= limit_px {
            return Ok(());
        }
        let marks =
            self.tree.nodes.iter().flat_map(|n| n.primitive.marks.iter().map(|m| (&n.primitive.name, m)));
        let lengths = misses.iter().flatten().map(Miss::length);
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

//! All primitives fitted to all marks at once (tutorial §3).

use super::guess::first_guess;
use super::placed::Placed;
use super::sight::{self, Miss};
use super::tree::{Off, Tree, Values, Views, sight};
use super::{FaceDistance, FaceSource, FittedPrimitive, Problem, Scene, faces, parameters};
use crate::annotations::Primitive;
use crate::camera::{LENS, POSE, SharedCovariance, moved};
use crate::config;
use crate::least_squares::{self, Fit, Loss};
use nalgebra::{DMatrix, DVector, Matrix3, SVector, Vector3};

/// Smallest extent that a primitive may have, m.
const MIN_EXTENT_M: f64 = 1e-3;
/// Where a mark is off by more than twice so many standard deviations, those that are off by more than so many count less.
const ROBUST: f64 = 3.0;
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
    shared: Option<&'a SharedCovariance>,
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
        Ok(Self { tree, views: *views, settings, shared: None, x })
    }

    /// Counts the errors of cameras among those of the scene.
    pub fn with_cameras_known_to(self, shared: Option<&'a SharedCovariance>) -> Self {
        Self { shared, ..self }
    }

    /// How many parameters are fitted.
    pub fn parameters(&self) -> usize {
        self.x.len()
    }

    /// The fit from some values, with what it is worth.
    fn solved(&self, values: &Values) -> Result<Fit, Problem> {
        let start = self.tree.free_of(values);
        let names = self.tree.names();
        match least_squares::minimise(&self.tree, &names, &start, Loss::Squares) {
            Ok(fit) if fit.residuals.amax() > 2.0 * ROBUST => {
                let robust = Loss::Huber(ROBUST);
                let again = least_squares::minimise(&self.tree, &names, fit.parameters.as_slice(), robust);
                Ok(again.unwrap_or(fit))
            }
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
        let covariance = self.covariance(&fit);
        let stated = self.stated(&fit);
        let sigma = |i: usize, k: usize| {
            let (i, k) = self.source(i, k);
            let free = tree.free.iter().position(|f| *f == (i, k));
            free.map_or(0.0, |f| stated * covariance[(f, f)].max(0.0).sqrt())
        };
        let corner_sigmas = self.corner_sigmas(&values, &covariance)?;
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
                corner_sigma_m: corner_sigmas[i],
                marks: node.sights.len(),
                rms_px: sight::rms_px(&misses[i]),
                faces: self.face_distances(i, &fit, &covariance),
            });
            scene.faces.extend(faces::faces(primitive, &placed[i], &values[i])?);
        }
        Ok(scene)
    }

    /// Marks that the scene as it stands contradicts, so that they hardly count.
    pub fn outlying(&self) -> Vec<Off> {
        let misses = self.tree.all_misses(&self.tree.values(self.x.as_slice()));
        let off = misses.map_or(Vec::new(), |misses| self.tree.off(&misses));
        off.into_iter().filter(|o| o.sigmas > 2.0 * ROBUST).collect()
    }

    /// Covariance of the free parameters: of the marks, and, by how the fit follows them, of the cameras.
    fn covariance(&self, fit: &Fit) -> DMatrix<f64> {
        let by_cameras =
            self.shared.and_then(|shared| Some((shared, self.by_cameras(&fit.parameters, shared)?)));
        match by_cameras {
            None => fit.covariance.clone(),
            Some((shared, by_cameras)) => {
                let follows = &fit.gain * by_cameras;
                &fit.covariance + &follows * &shared.covariance * follows.transpose()
            }
        }
    }

    /// Derivatives of the residuals by lens and poses, in the order of their covariance.
    fn by_cameras(&self, x: &DVector<f64>, shared: &SharedCovariance) -> Option<DMatrix<f64>> {
        let rows = |k: usize, h: f64| {
            let mut cameras = self.views.cameras.clone();
            for (file, place) in &shared.places {
                let Some(camera) = cameras.get_mut(file) else { continue };
                let pose = SharedCovariance::pose(*place);
                if k < LENS {
                    camera.intrinsics = camera.intrinsics.changed(&SVector::<f64, LENS>::ith(k, h));
                } else if (pose..pose + POSE).contains(&k) {
                    let by = SVector::<f64, POSE>::ith(k - pose, h);
                    camera.world_from_camera = moved(&camera.world_from_camera, &by);
                }
            }
            let sights = self.tree.sights_by(&cameras)?;
            let sights: Vec<_> = sights.iter().map(|s| &s[..]).collect();
            Some(DVector::from_vec(self.tree.all_rows(x.as_slice(), &sights)?.concat()))
        };
        let column = |k: usize| {
            // Pixels of the lens; distortion, metres and radians.
            let h = if k < 4 { 1e-3 } else { 1e-6 };
            Some((rows(k, h)? - rows(k, -h)?) / (2.0 * h))
        };
        let columns: Option<Vec<_>> = (0..shared.covariance.nrows()).map(column).collect();
        Some(DMatrix::from_columns(&columns?))
    }

    /// Standard deviation of each primitive's worst corner, m.
    fn corner_sigmas(&self, values: &Values, covariance: &DMatrix<f64>) -> Result<Vec<f64>, Problem> {
        let tree = &self.tree;
        let mut values = values.clone();
        let mut placed = tree.place(&values)?;
        let corners = |i: usize, values: &Values, placed: &Placed| {
            let faces = faces::faces(tree.nodes[i].primitive, placed, &values[i])?;
            Ok(faces.into_iter().flat_map(|f| f.vertices).map(|p| p.coords).collect())
        };
        let slopes = tree.slopes(&mut values, &mut placed, corners)?;
        let worst = |(slopes, depends): (&Vec<Vec<Vector3<f64>>>, &Vec<usize>)| {
            let own =
                DMatrix::from_fn(depends.len(), depends.len(), |a, b| covariance[(depends[a], depends[b])]);
            let of_corner = |corner: usize| {
                let by_own = DMatrix::from_fn(3, depends.len(), |i, k| slopes[k][corner][i]);
                let own = &by_own * &own * by_own.transpose();
                Matrix3::from_fn(|i, j| own[(i, j)]).symmetric_eigenvalues().max().max(0.0).sqrt()
            };
            (0..slopes.first().map_or(0, Vec::len)).map(of_corner).fold(0.0, f64::max)
        };
        Ok(slopes.iter().zip(&tree.depends).map(worst).collect())
    }

    /// What is found or presumed of a room is no better than stated, however well it fits: a factor of standard deviations.
    fn stated(&self, fit: &Fit) -> f64 {
        let freedom = fit.residuals.len().saturating_sub(fit.parameters.len());
        let searched = self.tree.nodes.iter().any(|node| node.found.is_some());
        let factor = (freedom as f64 / fit.cost().max(f64::MIN_POSITIVE)).sqrt();
        if searched && freedom > 0 { factor.max(1.0) } else { 1.0 }
    }

    /// Where the faces of a room are that was found in the plate.
    fn face_distances(&self, i: usize, fit: &Fit, covariance: &DMatrix<f64>) -> Vec<FaceDistance> {
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
                sigma_m: self.stated(fit) * by_all.dot(&(covariance * &by_all)).max(0.0).sqrt(),
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

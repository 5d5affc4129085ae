//! Cameras and the scene's primitives in one solution: what is known of lens and plate ([`super::known`]), the marks of primitives in
//! the plate, and those in further photographs through the same lens, whose poses they tell (Triggs et al., *Bundle Adjustment – A
//! Modern Synthesis*, 2000; Debevec, Taylor and Malik, *Modeling and Rendering Architecture from Photographs*, 1996).

use super::known::Known;
use super::solve::{self, Evidence, Solution};
use super::vanishing::{MAX_RELATIVE_SIGMA, ROBUST};
use super::{PosedCamera, Problem};
use crate::annotations::Primitive;
use crate::camera::{Camera, LENS, POSE, SharedCovariance, moved};
use crate::config;
use crate::least_squares::{self, Loss, NormalEquations, Residuals};
use crate::model::{self, Marked, Off, Views};
use crate::vision;
use nalgebra::{DMatrix, DVector, Isometry3, Point2, SVector};
use std::collections::BTreeMap;
use std::ops::Range;

/// Corners that the pose of a further photograph needs.
const LEAST_CORNERS: usize = 4;
/// Without a mark that tells it a primitive's parameter stays where it starts, to this, m or rad.
const UNTOLD: f64 = 10.0;
/// Steps before the robust fit, at most.
const STEPS: usize = 30;
/// Marks that fit worse than they should by more than this factor count less.
const WORSE: f64 = 1.1;

/// Primitives and where their marks may be.
pub struct Scene<'a> {
    /// The primitives; marks in the ball or in other photographs are left out.
    pub primitives: &'a [Primitive],
    /// Height of the surface under the grid, m.
    pub ground_y: f64,
    /// Accuracy of marks, and how far off they may be.
    pub settings: &'a config::Model,
    /// Photographs from the plate's place.
    pub here: &'a [String],
    /// Others through the same lens.
    pub others: &'a [String],
}

/// Cameras found together with the primitives.
#[derive(Debug, Clone)]
pub struct Found {
    /// Lens and pose of the plate.
    pub solution: Solution,
    /// Photographs from other places.
    pub others: BTreeMap<String, PosedCamera>,
    /// How well all these are known; where primitives took part.
    pub shared: Option<SharedCovariance>,
    /// Marks that took part.
    pub marks: usize,
    /// How far they are off, rms, px.
    pub marks_rms_px: Option<f64>,
}

impl Found {
    fn alone(solution: Solution) -> Self {
        Self { solution, others: BTreeMap::new(), shared: None, marks: 0, marks_rms_px: None }
    }
}

/// Why primitives take no part.
#[derive(Debug, thiserror::Error)]
enum Unfit {
    #[error("{0}")]
    Model(#[from] model::Problem),
    #[error("{0}")]
    Fit(#[from] least_squares::Problem),
    #[error("their marks are {rms_px:.1} px (rms) off, the limit is {limit_px:.1} px")]
    Marks { rms_px: f64, limit_px: f64 },
    #[error("the grid's corners are {rms_px:.2} px (rms) off then, the limit is {limit_px:.2} px")]
    Grid { rms_px: f64, limit_px: f64 },
    #[error("the focal length is known to {:.0} % then, {:.0} % are needed", 100.0 * relative, 100.0 * MAX_RELATIVE_SIGMA)]
    Open { relative: f64 },
    #[error("the plate's accuracy is not known")]
    Unknown,
}

/// Finds lens and pose of the plate as [`super::solve`] does, then all cameras together with the primitives.
pub fn solve(evidence: &Evidence, settings: &config::Calibrate, scene: &Scene) -> Result<Found, Problem> {
    if !settings.joint || seen_in(scene.primitives, scene.here).is_empty() {
        return Ok(Found::alone(solve::solve(evidence, settings)?));
    }
    solve_from(&solve::start(evidence, settings, true)?, evidence, settings, scene)
}

/// The same from what the plate's camera is without primitives.
pub(super) fn solve_from(
    start: &Solution,
    evidence: &Evidence,
    settings: &config::Calibrate,
    scene: &Scene,
) -> Result<Found, Problem> {
    together(start, evidence, settings, scene).or_else(|why| {
        // Where these lines are refused, nothing makes up for it.
        let open = start.used.open.is_some();
        let mut solution = if open { solve::solve(evidence, settings)? } else { start.clone() };
        solution.warnings.push(format!("the scene's primitives take no part in finding the cameras: {why}"));
        Ok(Found::alone(solution))
    })
}

fn together(
    start: &Solution,
    evidence: &Evidence,
    settings: &config::Calibrate,
    scene: &Scene,
) -> Result<Found, Unfit> {
    let known = Known::new(start, evidence, settings).ok_or(Unfit::Unknown)?;
    let plate = &start.plate.camera;
    let mut cameras: BTreeMap<String, Camera> =
        scene.here.iter().map(|f| (f.clone(), plate.clone())).collect();
    let mut warnings = Vec::new();
    let others = others(scene, &cameras, plate, &mut warnings)?;
    cameras.extend(
        others
            .iter()
            .map(|(file, pose)| (file.clone(), Camera { world_from_camera: *pose, ..plate.clone() })),
    );
    let files: Vec<String> = cameras.keys().cloned().collect();
    let primitives = seen_in(scene.primitives, &files);
    let views = Views { cameras: &cameras, ball: None, ground_y: scene.ground_y, rooms: &[] };
    let (marked, first) = Marked::new(&primitives, &views, scene.settings.mark_sigma_px)?;
    let mut joint = Joint {
        marked: &marked,
        known: &known,
        here: scene.here,
        others: &others,
        untold: &first,
        weight: 1.0,
    };
    let mut x: Vec<f64> = first.as_slice().to_vec();
    x.extend(vec![0.0; POSE * others.len()]);
    x.extend(known.first());
    let names = joint.names();
    let near = least_squares::descend(&joint, DVector::from_vec(x), STEPS);
    let (x, _) = near.ok_or(least_squares::Problem::Start)?;
    let mut fit = least_squares::minimise(&joint, &names, x.as_slice(), Loss::Huber(ROBUST))?;
    let scatter = joint.scatter(&fit);
    if scatter > WORSE {
        joint.weight = 1.0 / scatter;
        fit = least_squares::minimise(&joint, &names, fit.parameters.as_slice(), Loss::Huber(ROBUST))?;
    }
    joint.found(start, &fit, settings, scene, warnings)
}

/// Poses of further photographs, from corners that are marked in the plate, too.
fn others(
    scene: &Scene,
    here: &BTreeMap<String, Camera>,
    plate: &Camera,
    warnings: &mut Vec<String>,
) -> Result<Vec<(String, Isometry3<f64>)>, Unfit> {
    let marked_in = |file: &String| seen_in(scene.primitives, std::slice::from_ref(file));
    let with_marks: Vec<_> = (scene.others.iter().map(|f| (f, marked_in(f))))
        .filter(|(_, primitives)| !primitives.is_empty())
        .collect();
    if with_marks.is_empty() {
        return Ok(Vec::new());
    }
    let primitives = seen_in(scene.primitives, scene.here);
    let views = Views { cameras: here, ball: None, ground_y: scene.ground_y, rooms: &[] };
    let (marked, x) = Marked::new(&primitives, &views, scene.settings.mark_sigma_px)?;
    let corners = marked.corners(x.as_slice());
    let mut posed = Vec::new();
    for (file, primitives) in with_marks {
        let marks = primitives.iter().flat_map(|p| p.marks.iter().map(|m| (&p.name, m)));
        let place = |name: &str, corner: &str| corners.iter().find(|c| c.0 == name && c.1 == corner);
        let (points, pixels): (Vec<_>, Vec<_>) =
            marks.filter_map(|(name, m)| Some((place(name, &m.corner)?.2, Point2::from(m.at)))).unzip();
        let pose = vision::pose_of_points(&points, &pixels, &plate.intrinsics).ok().flatten();
        let camera = pose.map(|p| Camera { world_from_camera: p.inverse(), ..plate.clone() });
        match camera.filter(|c| points.iter().all(|p| c.project(p).is_some())) {
            Some(camera) => posed.push((file.clone(), camera.world_from_camera)),
            None => warnings.push(format!(
                "{file} gets no pose: of its marks {} are of corners that are marked in the plate, {LEAST_CORNERS} that do not lie \
                 on a line are needed",
                points.len()
            )),
        }
    }
    Ok(posed)
}

/// The primitives with those marks alone that are seen directly in some photographs; and without marks those that they refer to.
fn seen_in(primitives: &[Primitive], files: &[String]) -> Vec<Primitive> {
    let seen = |p: &Primitive| {
        let marks = p.marks.iter().filter(|m| !m.reflection && files.contains(&m.image)).cloned();
        Primitive { marks: marks.collect(), ..p.clone() }
    };
    let all: Vec<Primitive> = primitives.iter().map(seen).collect();
    let mut names: Vec<&str> = Vec::new();
    let mut wanted: Vec<&Primitive> = all.iter().filter(|p| !p.marks.is_empty()).collect();
    while let Some(primitive) = wanted.pop() {
        if !names.contains(&&primitive.name[..]) {
            names.push(&primitive.name);
            let referred = primitive.references();
            wanted.extend(all.iter().filter(|p| referred.contains(&&p.name)));
        }
    }
    all.iter().filter(|p| names.contains(&&p.name[..])).cloned().collect()
}

/// Residuals, their derivatives by some parameters, and which these are, in rising order.
type Rows = (Vec<f64>, DMatrix<f64>, Vec<usize>);

/// All residuals. Parameters: the primitives', children first; the poses of other photographs; what is known of the plate. In
/// this order the normal equations keep their zeros, and solving them eliminates primitives and poses one by one.
struct Joint<'a> {
    marked: &'a Marked<'a>,
    known: &'a Known<'a>,
    here: &'a [String],
    others: &'a [(String, Isometry3<f64>)],
    /// Where the primitives' parameters stay without a mark.
    untold: &'a DVector<f64>,
    /// Of the marks, against what their stated accuracy says.
    weight: f64,
}

impl Joint<'_> {
    fn names(&self) -> Vec<String> {
        let poses = self.others.iter().flat_map(|(file, _)| vec![format!("the pose of {file}"); POSE]);
        self.marked.names().into_iter().chain(poses).chain(self.known.names()).collect()
    }

    /// Of the poses' parameters, and of all after those of the primitives.
    fn pose(&self, k: usize) -> Range<usize> {
        let from = self.untold.len() + POSE * k;
        from..from + POSE
    }

    fn plate<'x>(&self, x: &'x DVector<f64>) -> &'x [f64] {
        &x.as_slice()[self.untold.len() + POSE * self.others.len()..]
    }

    fn cameras(&self, x: &DVector<f64>) -> BTreeMap<String, Camera> {
        let plate = self.known.camera(self.plate(x));
        let other = |(k, (file, start)): (usize, &(String, Isometry3<f64>))| {
            let by = SVector::<f64, POSE>::from_column_slice(&x.as_slice()[self.pose(k)]);
            (
                file.clone(),
                Camera { intrinsics: plate.intrinsics.clone(), world_from_camera: moved(start, &by) },
            )
        };
        let mut cameras: BTreeMap<_, _> = self.others.iter().enumerate().map(other).collect();
        cameras.extend(self.here.iter().map(|f| (f.clone(), plate.clone())));
        cameras
    }

    /// Rows of each primitive's marks; then of what its parameters start from, and of the plate.
    fn groups(&self, x: &DVector<f64>) -> Option<Vec<Vec<f64>>> {
        let cameras = self.cameras(x);
        let own = &x.as_slice()[..self.untold.len()];
        let mut groups = self.marked.rows(own, &cameras)?;
        groups.iter_mut().flatten().for_each(|r| *r *= self.weight);
        groups.push(own.iter().zip(self.untold.iter()).map(|(x, start)| (x - start) / UNTOLD).collect());
        let plate = &cameras[self.here.first()?];
        groups.push(self.known.rows(self.plate(x), plate)?);
        Some(groups)
    }

    /// The same rows with derivatives by the parameters (rising) on which they depend.
    fn blocks(&self, x: &DVector<f64>) -> Option<Vec<Rows>> {
        let n = self.untold.len();
        let groups = self.groups(x)?;
        let mut by_cameras: Vec<DMatrix<f64>> =
            groups.iter().map(|g| DMatrix::zeros(g.len(), x.len() - n)).collect();
        let mut y = x.clone();
        for k in n..x.len() {
            let h = f64::EPSILON.cbrt() * x[k].abs().max(1.0);
            y[k] = x[k] + h;
            let up = self.groups(&y)?;
            y[k] = x[k] - h;
            let down = self.groups(&y)?;
            y[k] = x[k];
            for (matrix, (up, down)) in by_cameras.iter_mut().zip(up.iter().zip(&down)) {
                let slopes = up.iter().zip(down).map(|(up, down)| (up - down) / (2.0 * h));
                matrix.set_column(k - n, &DVector::from_iterator(up.len(), slopes));
            }
        }
        let of_marks = self.marked.blocks(&x.as_slice()[..n], &self.cameras(x))?;
        let mut blocks = Vec::with_capacity(groups.len());
        for (i, (rows, by_cameras)) in groups.into_iter().zip(by_cameras).enumerate() {
            let (own, columns): (DMatrix<f64>, Vec<usize>) = match of_marks.get(i) {
                Some(block) => (&block.derivatives * self.weight, block.columns.to_vec()),
                None if i == of_marks.len() => (DMatrix::identity(n, n) / UNTOLD, (0..n).collect()),
                None => (DMatrix::zeros(rows.len(), 0), Vec::new()),
            };
            let mut all = DMatrix::zeros(rows.len(), columns.len() + by_cameras.ncols());
            all.columns_mut(0, columns.len()).copy_from(&own);
            all.columns_mut(columns.len(), by_cameras.ncols()).copy_from(&by_cameras);
            blocks.push((rows, all, columns.into_iter().chain(n..x.len()).collect()));
        }
        Some(blocks)
    }

    /// Scatter of the marks over what they count for, by the robust weights.
    fn scatter(&self, fit: &least_squares::Fit) -> f64 {
        let marks: usize = self.marked_rows(fit);
        let told = fit.residuals.len() - self.untold.len();
        let freedom = told.saturating_sub(fit.parameters.len()).max(1);
        let loss = Loss::Huber(ROBUST);
        let squares: f64 = fit.residuals.rows(0, marks).iter().map(|r| loss.weight(*r) * r * r).sum();
        (squares / marks.max(1) as f64 * told as f64 / freedom as f64).sqrt()
    }

    fn marked_rows(&self, fit: &least_squares::Fit) -> usize {
        self.marked
            .rows(&fit.parameters.as_slice()[..self.untold.len()], &self.cameras(&fit.parameters))
            .map_or(0, |rows| rows.iter().map(Vec::len).sum())
    }

    fn found(
        &self,
        start: &Solution,
        fit: &least_squares::Fit,
        settings: &config::Calibrate,
        scene: &Scene,
        warnings: Vec<String>,
    ) -> Result<Found, Unfit> {
        let x = &fit.parameters;
        let cameras = self.cameras(x);
        let off = self.marked.off(&x.as_slice()[..self.untold.len()], &cameras);
        let off = off.ok_or(least_squares::Problem::Start)?;
        let rms =
            |off: &[&Off]| (off.iter().map(|o| o.px * o.px).sum::<f64>() / off.len().max(1) as f64).sqrt();
        let all: Vec<&Off> = off.iter().collect();
        let (rms_px, limit_px) = (rms(&all), scene.settings.max_rms_px);
        if rms_px > limit_px {
            return Err(Unfit::Marks { rms_px, limit_px });
        }
        let shared = self.shared(fit);
        let plate = &cameras[&self.here[0]];
        let posed = self.known.posed(&start.plate, plate.clone(), shared.camera(0));
        if posed.rms_px > settings.max_rms_px && !start.used.boards.is_empty() {
            return Err(Unfit::Grid { rms_px: posed.rms_px, limit_px: settings.max_rms_px });
        }
        let focal_sigma_px = shared.camera(0).sigma(0);
        let relative = focal_sigma_px / plate.intrinsics.focal_px[0];
        if start.used.open.is_some() && (relative.is_nan() || relative > MAX_RELATIVE_SIGMA) {
            return Err(Unfit::Open { relative });
        }
        let mut solution = start.clone();
        solution.warnings.extend(warnings);
        if let Some(open) = &start.used.open {
            solution.warnings.push(format!(
                "the focal length comes from the primitives' marks as well; of the lines alone: {open}"
            ));
        }
        solution.warnings.extend(off.iter().filter(|o| o.sigmas * self.weight > 2.0 * ROBUST).map(|o| {
            let Off { name, corner, image, px, .. } = o;
            format!("the mark `{corner}` of `{name}` in {image} is {px:.1} px off what all else says, and hardly counts")
        }));
        solution.plate = posed;
        solution.focal_sigma_px = start.focal_sigma_px.map(|_| focal_sigma_px);
        let other = |(k, (file, _)): (usize, &(String, Isometry3<f64>))| {
            let own: Vec<&Off> = off.iter().filter(|o| o.image == *file).collect();
            let posed = PosedCamera {
                camera: cameras[file].clone(),
                rms_px: rms(&own),
                covariance: Some(shared.camera(k + 1)),
                rival_rms_px: None,
            };
            (file.clone(), posed)
        };
        let others = self.others.iter().enumerate().map(other).collect();
        let marks = self.marked.marks();
        Ok(Found { solution, others, shared: Some(shared), marks, marks_rms_px: Some(rms_px) })
    }

    /// Covariance of all cameras; where residuals are smaller than stated, the stated accuracies hold.
    fn shared(&self, fit: &least_squares::Fit) -> SharedCovariance {
        let n = fit.parameters.len();
        let own = self.known.directions.ncols();
        let mut by_all = DMatrix::zeros(LENS + POSE * (1 + self.others.len()), n);
        by_all.view_mut((0, n - own), (LENS + POSE, own)).copy_from(&self.known.directions);
        for k in 0..self.others.len() {
            let at = (SharedCovariance::pose(k + 1), self.pose(k).start);
            by_all.view_mut(at, (POSE, POSE)).fill_with_identity();
        }
        let stated = fit.variance.max(1.0) / fit.variance;
        let covariance = &by_all * &fit.covariance * by_all.transpose() * stated;
        let covariance = (&covariance + covariance.transpose()) * 0.5;
        let mut places: BTreeMap<String, usize> = self.here.iter().map(|f| (f.clone(), 0)).collect();
        places.extend(self.others.iter().enumerate().map(|(k, (file, _))| (file.clone(), k + 1)));
        SharedCovariance { places, covariance }
    }
}

impl Residuals for Joint<'_> {
    fn residuals(&self, x: &DVector<f64>) -> Option<DVector<f64>> {
        Some(DVector::from_vec(self.groups(x)?.concat()))
    }

    fn jacobian(&self, x: &DVector<f64>) -> Option<DMatrix<f64>> {
        let blocks = self.blocks(x)?;
        let mut jacobian = DMatrix::zeros(blocks.iter().map(|b| b.0.len()).sum(), x.len());
        let mut from = 0;
        for (rows, derivatives, columns) in blocks {
            for (c, column) in columns.into_iter().enumerate() {
                jacobian.view_mut((from, column), (rows.len(), 1)).copy_from(&derivatives.column(c));
            }
            from += rows.len();
        }
        Some(jacobian)
    }

    fn normal_equations(&self, x: &DVector<f64>) -> Option<NormalEquations> {
        let mut equations = NormalEquations::zero(x.len());
        for (rows, derivatives, columns) in self.blocks(x)? {
            equations.add(&DVector::from_vec(rows), &derivatives, &columns);
        }
        Some(equations)
    }
}

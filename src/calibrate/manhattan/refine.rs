//! The room that its edges fit best, and how far off it may be where they lean together: parallel clutter, walls that are not
//! quite square and an unknown distortion turn neighbours alike, so that many of them know no more than a few.
//!
//! The segments of a direction share a leaning that changes slowly over the picture: random coefficients of bumps on a grid, which
//! are eliminated from the normal equations (mixed model: Henderson 1975; Laird and Ware 1982). The covariance is then that of
//! clusters, whatever their segments have in common (Liang and Zeger 1986), freed of bias for few of them (Bell and McCaffrey 2002),
//! and counts that segments change sides as the room moves (Louis 1982).

use super::{AGREES, Judge, NEGLIGIBLE};
use crate::calibrate::vanishing::{EdgeFit, Room, StatedFocal};
use nalgebra::{Cholesky, DMatrix, Point2, Rotation3, SMatrix, SVector, Vector2, Vector3};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// How far from right angles the directions of real walls are, rad.
const SQUARE_SIGMA: f64 = 0.1 * PI / 180.0;
/// What neighbours lean together, rad: with a lens whose distortion is known, with any other, …
const LEANING_SIGMA: [f64; 2] = [0.2 * PI / 180.0, 0.5 * PI / 180.0];
/// (a focal length as certain as this comes with its distortion)
const KNOWN_LENS: f64 = 1e-3;
/// … and the distance of the bumps that say where, of the image's diagonal.
const LEANING_REACH: f64 = 0.14;
/// Largest influence of a cluster on itself that is set right.
const LEVERAGE: f64 = 0.95;
/// Where segments would rather change sides than resist a turn, so much of their resistance is left, at least.
const LEAST_RESISTANCE: f64 = 0.1;
/// Converged when the next step is shorter than this, in standard deviations.
const STEP_SIGMA: f64 = 1e-3;

/// Logarithm of the focal length, turn in the camera frame, leanings of the directions.
const N: usize = 10;
type Vector = SVector<f64, N>;
type Matrix = SMatrix<f64, N, N>;

/// A room whose directions are not quite at right angles; lengths in units of the diagonal.
#[derive(Clone)]
struct State {
    room: Room,
    /// Direction k leans by `leaning[2k]` and `leaning[2k + 1]` towards the next and the one after.
    leaning: [f64; 6],
}

impl State {
    fn moved(&self, step: &Vector) -> Self {
        // A far start must not run away.
        let focal_px = self.room.focal_px * step[0].clamp(-0.1, 0.1).exp();
        let turn = Rotation3::new(Vector3::new(step[1], step[2], step[3]));
        Self {
            room: Room { focal_px, camera_from_room: turn * self.room.camera_from_room },
            leaning: std::array::from_fn(|k| self.leaning[k] + step[4 + k]),
        }
    }

    /// Direction `k` in the camera frame.
    fn direction(&self, k: usize) -> Vector3<f64> {
        let mut d = Vector3::ith(k, 1.0);
        (d[(k + 1) % 3], d[(k + 2) % 3]) = (self.leaning[2 * k], self.leaning[2 * k + 1]);
        self.room.camera_from_room * d
    }

    fn points(&self) -> [Vector3<f64>; 3] {
        let f = self.room.focal_px;
        [0, 1, 2].map(|k| self.direction(k).component_mul(&Vector3::new(f, f, 1.0)))
    }

    /// Sine of the angle between a segment and the line from its middle to the vanishing point of direction `k`, and its derivatives.
    fn miss(&self, judge: &Judge, k: usize) -> (f64, Vector) {
        let f = self.room.focal_px;
        let d = self.direction(k);
        let seen = |d: &Vector3<f64>| d.xy() * f - judge.middle * d.z;
        let towards = seen(&d);
        let length = towards.norm();
        let along = judge.direction * judge.direction.dot(&towards).signum();
        let sine = along.perp(&towards) / length;
        let slope =
            |change: Vector2<f64>| (along.perp(&change) - sine * towards.dot(&change) / length) / length;
        let mut slopes = Vector::zeros();
        slopes[0] = slope(d.xy() * f);
        for j in 0..3 {
            slopes[1 + j] = slope(seen(&Vector3::ith(j, 1.0).cross(&d)));
        }
        for j in 0..2 {
            slopes[4 + 2 * k + j] =
                slope(seen(&(self.room.camera_from_room * Vector3::ith((k + 1 + j) % 3, 1.0))));
        }
        (sine, slopes)
    }
}

/// A segment's part in the fit.
struct Member<'a> {
    judge: &'a Judge,
    /// The direction it agrees with best, and what share of it belongs to that.
    axis: usize,
    share: f64,
    /// What it counts, 1/rad².
    information: f64,
    miss: f64,
    slopes: Vector,
    /// Derivatives of the share's logarithm.
    swing: Vector,
    /// The bumps of shared leaning about it, with their values.
    bumps: [(usize, f64); 4],
}

impl Member<'_> {
    /// How far off its direction it is, in standard deviations of its own.
    fn sigmas(&self) -> f64 {
        (self.miss / self.judge.sigma).abs()
    }
}

/// Expectation: which segments belong to which direction.
fn members<'a>(state: &State, judges: &'a [Judge]) -> Vec<Member<'a>> {
    let points = state.points();
    let mean = judges.iter().map(|j| j.weight).sum::<f64>() / judges.len().max(1) as f64;
    let mut numbers = BTreeMap::new();
    let member = |judge: &'a Judge| {
        let (axis, shares) = judge.shares(&points);
        let share = shares[axis];
        if share <= NEGLIGIBLE {
            return None;
        }
        let (miss, slopes) = state.miss(judge, axis);
        let precision = 1.0 / (judge.sigma * judge.sigma);
        let mut swing = -slopes * miss * precision;
        for (k, share) in shares.iter().enumerate().filter(|(_, share)| **share > NEGLIGIBLE) {
            let (miss, slopes) = state.miss(judge, k);
            swing += slopes * (share * miss * precision);
        }
        let at = judge.middle / LEANING_REACH;
        let (cell, within) = (at.map(f64::floor), at.map(|v| v - v.floor()));
        let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
        let value = |[x, y]: [f64; 2]| (1.0 - (x - within.x).abs()) * (1.0 - (y - within.y).abs());
        // The leaning varies alike everywhere.
        let norm = corners.map(value).iter().map(|v| v * v).sum::<f64>().sqrt();
        let bumps = corners.map(|[x, y]| {
            let next = numbers.len();
            let bump = (axis, (cell.x + x) as i64, (cell.y + y) as i64);
            (*numbers.entry(bump).or_insert(next), value([x, y]) / norm)
        });
        let information = share * judge.weight / mean * precision;
        Some(Member { judge, axis, share, information, miss, slopes, swing, bumps })
    };
    judges.iter().filter_map(member).collect()
}

/// The normal equations with the shared leanings eliminated.
struct Equations {
    /// By how much each member moves each of them.
    pulls: Vec<Vector>,
    curvature: Matrix,
    gradient: Vector,
    /// The part of the curvature that is known beforehand.
    prior: Matrix,
}

fn equations(state: &State, members: &[Member], stated: Option<StatedFocal>) -> Option<Equations> {
    let count = members.iter().flat_map(|m| m.bumps).map(|(bump, _)| bump + 1).max().unwrap_or(0);
    let lens_known = stated.is_some_and(|s| s.relative_sigma <= KNOWN_LENS);
    let mut among = DMatrix::identity(count, count) / LEANING_SIGMA[usize::from(!lens_known)].powi(2);
    let mut across = DMatrix::zeros(count, N);
    for member in members {
        for (a, value) in member.bumps {
            let value = value * member.information;
            member.bumps.iter().for_each(|(b, other)| among[(a, *b)] += value * other);
            (0..N).for_each(|j| across[(a, j)] += value * member.slopes[j]);
        }
    }
    let follows = Cholesky::new(among)?.solve(&across);
    let pull = |member: &Member| {
        let followed: Vector = member
            .bumps
            .iter()
            .map(|(bump, value)| Vector::from_fn(|j, _| follows[(*bump, j)]) * *value)
            .sum();
        (member.slopes - followed) * member.information
    };
    let pulls: Vec<Vector> = members.iter().map(pull).collect();
    let (mut curvature, mut gradient) = (Matrix::zeros(), Vector::zeros());
    for (member, pull) in members.iter().zip(&pulls) {
        curvature += pull * member.slopes.transpose();
        gradient += pull * member.miss;
    }
    let mut prior = Matrix::zeros();
    for k in 0..6 {
        prior[(4 + k, 4 + k)] = SQUARE_SIGMA.powi(-2);
        gradient[4 + k] += state.leaning[k] * SQUARE_SIGMA.powi(-2);
    }
    if let Some(stated) = stated {
        prior[(0, 0)] = stated.relative_sigma.powi(-2);
        gradient[0] += (state.room.focal_px / stated.focal_px).ln() * prior[(0, 0)];
    }
    let curvature = (curvature + curvature.transpose()) / 2.0 + prior;
    Some(Equations { pulls, curvature, gradient, prior })
}

impl Equations {
    /// Covariance of the parameters.
    fn covariance(&self, members: &[Member]) -> Option<Matrix> {
        let cholesky = Cholesky::new(self.curvature)?;
        let lower = cholesky.l();
        // In units in which the curvature is 1.
        let whitened = |m: &Matrix| -> Option<Matrix> {
            let half = lower.solve_lower_triangular(m)?;
            let both = lower.solve_lower_triangular(&half.transpose())?;
            Some((both + both.transpose()) / 2.0)
        };
        // What segments that change sides take away from it.
        let mut lost = Matrix::zeros();
        for (member, pull) in members.iter().zip(&self.pulls) {
            lost -= pull * member.swing.transpose() * member.miss;
        }
        let mut resistance = (Matrix::identity() - whitened(&lost)?).symmetric_eigen();
        resistance.eigenvalues.apply(|r| *r = 1.0 / r.max(LEAST_RESISTANCE));
        let give = resistance.recompose();

        let mut clusters = BTreeMap::<[i64; 2], (Matrix, Vector)>::new();
        for (member, pull) in members.iter().zip(&self.pulls) {
            let (own, score) = clusters.entry(member.judge.cluster()).or_default();
            *own += pull * member.slopes.transpose();
            *score += pull * member.miss;
        }
        let mut scatter = Matrix::zeros();
        for (own, score) in clusters.values() {
            let mut left = whitened(own)?.symmetric_eigen();
            left.eigenvalues.apply(|l| *l = (1.0 - l.min(LEVERAGE)).max(0.0).powf(-0.5));
            let score = left.recompose() * lower.solve_lower_triangular(score)?;
            scatter += score * score.transpose();
        }
        let whole = give * scatter * give + whitened(&self.prior)?;
        let back = lower.transpose().try_inverse()?;
        Some(back * whole * back.transpose())
    }
}

/// Fits focal length and orientation to the segments of a room near `start` by expectation and maximisation in turn, `turns` at
/// most. Rooms' lengths are in px.
pub(super) fn refine(
    start: Room,
    judges: &[Judge],
    centre: Point2<f64>,
    diagonal_px: f64,
    stated: Option<StatedFocal>,
    turns: usize,
) -> Option<EdgeFit> {
    let stated = stated.map(|s| StatedFocal { focal_px: s.focal_px / diagonal_px, ..s });
    let room = Room { focal_px: start.focal_px / diagonal_px, ..start };
    let mut state = State { room, leaning: [0.0; 6] };
    for _ in 0..turns {
        let equations = equations(&state, &members(&state, judges), stated)?;
        let step = -Cholesky::new(equations.curvature)?.solve(&equations.gradient);
        if !step.iter().all(|s| s.is_finite()) {
            return None;
        }
        state = state.moved(&step);
        if -step.dot(&equations.gradient) < STEP_SIGMA * STEP_SIGMA {
            break;
        }
    }
    let members = members(&state, judges);
    let equations = equations(&state, &members, stated)?;
    let mut covariance = equations.covariance(&members)?;
    let room = Room { focal_px: state.room.focal_px * diagonal_px, ..state.room };
    covariance.row_mut(0).scale_mut(room.focal_px);
    covariance.column_mut(0).scale_mut(room.focal_px);
    let mut of_room = DMatrix::zeros(7, 7);
    of_room.view_mut((0, 0), (4, 4)).copy_from(&covariance.fixed_view::<4, 4>(0, 0));
    let by_leaning =
        equations.curvature.try_inverse()?.fixed_view::<1, 6>(0, 4).norm() * SQUARE_SIGMA.powi(-2);
    let worst =
        members.iter().filter(|m| m.share > AGREES).max_by(|a, b| a.sigmas().total_cmp(&b.sigmas()))?;
    let before = members.iter().take_while(|m| !std::ptr::eq(*m, worst));
    let number = before.filter(|m| m.axis == worst.axis && m.share > AGREES).count();
    let squares = members.iter().map(|m| (m.miss * m.judge.length_px(diagonal_px)).powi(2) / 2.0);
    Some(EdgeFit {
        room,
        centre,
        k1: 0.0,
        covariance: of_room,
        condition: by_leaning,
        rms_px: (squares.sum::<f64>() / members.len() as f64).sqrt(),
        worst: (worst.axis, number, worst.sigmas()),
    })
}

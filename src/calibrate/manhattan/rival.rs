//! Another room that the segments might as well belong to: what it adds to the uncertainty of the one that explains them best.

use super::{CLUSTER, Judge};
use crate::calibrate::vanishing::{EdgeFit, Room};
use nalgebra::{DVector, Matrix3, Point2, Rotation3, Vector3};
use std::collections::BTreeMap;

impl Judge {
    /// The square of the picture that it lies in: its segments count as one where something turns them alike.
    pub(super) fn cluster(&self) -> [i64; 2] {
        [self.middle.x / CLUSTER, self.middle.y / CLUSTER + 0.5].map(|v| v.floor() as i64)
    }
}

/// Adds to the covariance of a fit its distance to the rival that matters most, by the chance that the rival is right.
pub(super) fn count(fit: &mut EdgeFit, rivals: &[EdgeFit], judges: &[Judge], diagonal_px: f64) {
    let apart = |rival: &EdgeFit| {
        let turn = nearest(&rival.room.camera_from_room, &fit.room.camera_from_room);
        let between = (turn * fit.room.camera_from_room.inverse()).scaled_axis();
        [rival.room.focal_px - fit.room.focal_px, between.x, between.y, between.z]
    };
    let matter = |rival: &EdgeFit| {
        let apart = apart(rival);
        let relative = apart[0] / fit.room.focal_px;
        let chance = chance(&rival.room, &fit.room, judges, diagonal_px);
        let size = relative * relative + apart[1..].iter().map(|v| v * v).sum::<f64>();
        (chance * size, chance, apart)
    };
    let most = rivals.iter().map(matter).max_by(|a, b| a.0.total_cmp(&b.0));
    if let Some((_, chance, apart)) = most {
        let apart = DVector::from_row_slice(&apart);
        let mut of_room = fit.covariance.view_mut((0, 0), (4, 4));
        of_room += &apart * apart.transpose() * chance;
    }
}

/// The chance that `rival` is right rather than `best`: that of the segments' evidence, summed by clusters, to be for it (Vuong 1989).
fn chance(rival: &Room, best: &Room, judges: &[Judge], diagonal_px: f64) -> f64 {
    let points = |room: &Room| {
        let room = Room { focal_px: room.focal_px / diagonal_px, ..*room };
        [0, 1, 2].map(|k| room.vanishing_point(k, Point2::origin()))
    };
    let (rival, best) = (points(rival), points(best));
    let mut leads = BTreeMap::<[i64; 2], f64>::new();
    for judge in judges {
        let lead = judge.weight * (judge.evidence(&best) - judge.evidence(&rival));
        *leads.entry(judge.cluster()).or_default() += lead;
    }
    let count = leads.len() as f64;
    let lead: f64 = leads.values().sum();
    let variance = leads.values().map(|v| (v - lead / count).powi(2)).sum::<f64>() * count / (count - 1.0);
    // The normal distribution, to a hundredth.
    let chance = 1.0 / (1.0 + (1.702 * lead / variance.sqrt()).exp());
    if chance.is_finite() { chance } else { 0.0 }
}

/// The frame of the same axes, however named, that is nearest to another.
fn nearest(frame: &Rotation3<f64>, to: &Rotation3<f64>) -> Rotation3<f64> {
    let axes = (0..6).map(|k| frame * (Vector3::ith(k % 3, 1.0) * if k < 3 { 1.0 } else { -1.0 }));
    let axes: Vec<Vector3<f64>> = axes.collect();
    let pairs = (0..36).map(|k| (k / 6, k % 6)).filter(|(x, z)| x % 3 != z % 3);
    let frames = pairs.map(|(x, z)| {
        Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[axes[x], axes[z].cross(&axes[x]), axes[z]]))
    });
    frames.min_by(|a, b| a.angle_to(to).total_cmp(&b.angle_to(to))).unwrap_or(*frame)
}

//! Plane projective maps of the picture, and their fit to two pictures by Gauss–Newton on sampled edges (Lucas and Kanade
//! 1981; Szeliski, *Image Alignment and Stitching*, 2006, §3.4).

use crate::image::Image;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Difference beyond which a pixel is an outlier, ln exposure.
const CAP: f64 = 0.7;
const STEPS: usize = 30;
/// Change, px, below which the fit ends.
const SETTLED_PX: f64 = 0.003;

/// What is left free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Free {
    Shift,
    All,
}

/// ln exposure of a picture and where it can be trusted.
pub(super) struct Logs {
    pub ln: Image<f32>,
    pub held: Image<bool>,
}

/// A pixel centre of the first picture and its ln exposure.
pub(super) struct Edge {
    pub at: [f64; 2],
    pub ln: f64,
}

/// Where a map takes a point, px.
pub(super) fn map(h: &Matrix3<f64>, [x, y]: [f64; 2]) -> [f64; 2] {
    let p = h * Vector3::new(x, y, 1.0);
    [p.x / p.z, p.y / p.z]
}

/// How far the corners of a picture move, px, at most.
pub(super) fn largest_move(h: &Matrix3<f64>, (width, height): (usize, usize)) -> f64 {
    let (w, t) = (width as f64, height as f64);
    let corners = [[0.0, 0.0], [w, 0.0], [0.0, t], [w, t]];
    let moved = corners.iter().map(|c| {
        let m = map(h, *c);
        (m[0] - c[0]).hypot(m[1] - c[1])
    });
    moved.fold(0.0, f64::max)
}

impl Logs {
    /// ln exposure and its slope along x and y at a point, px; `None` where it is not held.
    fn at(&self, [x, y]: [f64; 2]) -> Option<(f64, [f64; 2])> {
        let (w, h) = self.ln.size();
        let (fx, fy) = (x - 0.5, y - 0.5);
        if !(fx >= 1.0 && fy >= 1.0 && fx < w as f64 - 2.0 && fy < h as f64 - 2.0) {
            return None;
        }
        let (x0, y0) = (fx as usize, fy as usize);
        let (a, b) = (fx - x0 as f64, fy - y0 as f64);
        if ![(0, 0), (1, 0), (0, 1), (1, 1)].iter().all(|(i, j)| *self.held.at(x0 + i, y0 + j)) {
            return None;
        }
        let v = |i: usize, j: usize| f64::from(*self.ln.at(x0 + i, y0 + j));
        let value = (v(0, 0) * (1.0 - a) + v(1, 0) * a) * (1.0 - b) + (v(0, 1) * (1.0 - a) + v(1, 1) * a) * b;
        let dx = (v(1, 0) - v(0, 0)) * (1.0 - b) + (v(1, 1) - v(0, 1)) * b;
        let dy = (v(0, 1) - v(0, 0)) * (1.0 - a) + (v(1, 1) - v(1, 0)) * a;
        Some((value, [dx, dy]))
    }
}

/// Differences at the edges that the second picture holds, their median taken off: what the exposures are off.
fn differences(edges: &[Edge], b: &Logs, h: &Matrix3<f64>) -> Vec<f64> {
    let found = edges.iter().filter_map(|e| Some(b.at(map(h, e.at))?.0 - e.ln));
    let mut values: Vec<f64> = found.collect();
    if let Some(middle) = super::super::median(values.clone()) {
        values.iter_mut().for_each(|v| *v -= middle);
    }
    values
}

/// Mean difference, each at most [`CAP`]; infinite where hardly anything is held.
pub(super) fn cost(edges: &[Edge], b: &Logs, h: &Matrix3<f64>) -> f64 {
    let values = differences(edges, b, h);
    if values.len() < super::NEEDED.max(edges.len() / 10) {
        return f64::INFINITY;
    }
    values.iter().map(|v| v.abs().min(CAP)).sum::<f64>() / values.len() as f64
}

/// Correlation of the two pictures at the edges.
pub(super) fn correlation(edges: &[Edge], b: &Logs, h: &Matrix3<f64>) -> f64 {
    let pairs: Vec<(f64, f64)> = edges.iter().filter_map(|e| Some((e.ln, b.at(map(h, e.at))?.0))).collect();
    let n = pairs.len().max(1) as f64;
    let (ma, mb) = (pairs.iter().map(|p| p.0).sum::<f64>() / n, pairs.iter().map(|p| p.1).sum::<f64>() / n);
    let sum = |f: &dyn Fn(f64, f64) -> f64| pairs.iter().map(|p| f(p.0 - ma, p.1 - mb)).sum::<f64>();
    sum(&|a, b| a * b) / (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt().max(1e-12)
}

/// Improves `start`, a map from pixels of the first picture to those of the second.
pub(super) fn refine(edges: &[Edge], b: &Logs, start: &Matrix3<f64>, free: Free) -> Matrix3<f64> {
    let (w, t) = b.ln.size();
    let scale = 0.5 * w.max(t) as f64;
    // Pixels from coordinates of about −1 to 1.
    let px = Matrix3::new(scale, 0.0, 0.5 * w as f64, 0.0, scale, 0.5 * t as f64, 0.0, 0.0, 1.0);
    let Some(unit) = px.try_inverse() else { return *start };
    let mut h = unit * start * px;
    h /= h[(2, 2)];
    let parameters: &[usize] = match free {
        Free::Shift => &[2, 5],
        Free::All => &[0, 1, 2, 3, 4, 5, 6, 7],
    };
    let n = parameters.len() + 1;
    for _ in 0..STEPS {
        let mut normal = DMatrix::<f64>::zeros(n, n);
        let mut right = DVector::<f64>::zeros(n);
        let middle = {
            let all = edges.iter().filter_map(|e| Some(b.at(map(&(px * h * unit), e.at))?.0 - e.ln));
            super::super::median(all.collect()).unwrap_or(0.0)
        };
        for edge in edges {
            let [x, y] = map(&unit, edge.at);
            let q = h * Vector3::new(x, y, 1.0);
            let (u, v, d) = (q.x / q.z, q.y / q.z, q.z);
            let Some((value, slope)) = b.at(map(&px, [u, v])) else { continue };
            let r = value - edge.ln - middle;
            let weight = 1.0 / (1.0 + (r / (0.3 * CAP)).powi(2));
            let (gx, gy) = (slope[0] * scale / d, slope[1] * scale / d);
            let slant = -(gx * u + gy * v);
            let all = [gx * x, gx * y, gx, gy * x, gy * y, gy, slant * x, slant * y];
            let row: Vec<f64> = parameters.iter().map(|k| all[*k]).chain([-1.0]).collect();
            for i in 0..n {
                (0..n).for_each(|j| normal[(i, j)] += weight * row[i] * row[j]);
                right[i] -= weight * row[i] * r;
            }
        }
        (0..n).for_each(|i| normal[(i, i)] *= 1.0 + 1e-6);
        let Some(factor) = normal.cholesky() else { break };
        let step = factor.solve(&right);
        let before = h;
        for (k, parameter) in parameters.iter().enumerate() {
            h[(parameter / 3, parameter % 3)] += step[k];
        }
        if !h.iter().all(|v| v.is_finite()) {
            return *start;
        }
        if (h - before).abs().max() * scale < SETTLED_PX {
            break;
        }
    }
    px * h * unit
}

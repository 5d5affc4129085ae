//! What the picture says for an edge of the room: a step of colour that lies on the line, and is the same all along it. Grooves,
//! mortar and planks are lines without a step, or with one that changes as they go.

use super::layout::{Edge, others};
use super::view::View;
use crate::image::Image;
use nalgebra::{Point2, Vector2, Vector3};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Length of a piece of a line, as a share of the picture's diagonal.
const PIECE: f64 = 0.02;
/// Angle between lines that are looked at, px from the vanishing point at the distance of the focal length.
const APART_PX: f64 = 0.8;
/// How far to both sides of a line it looks, px.
const REACH: i32 = 7;
/// An edge lies within this of the line, px …
const NEAR: i32 = 2;
/// … and its gradient is so many times the picture's own, and those further off.
const GRADIENT: f64 = 1.5;
const ABOVE_OTHERS: f64 = 1.2;
/// The step beside it is so many times the picture's own.
const STEP: f64 = 0.7;
/// Differences that 8 bits do not resolve, of gradients and of steps.
const LEAST: [f32; 2] = [0.001, 0.004];

/// A piece of a line.
#[derive(Debug, Clone, Copy)]
pub struct Piece {
    /// Its middle, px as an ideal lens would have it.
    pub at: Point2<f64>,
    /// Where it is along the line, as a multiple of the line's distance from the camera.
    pub slope: f64,
    /// The step of colour across it, of unit length, where there is one.
    pub step: Option<Vector3<f64>>,
    /// Across the line in the picture.
    pub across: Vector2<f64>,
    /// Where the edge lies beside the line in that direction, px.
    pub beside: f64,
}

/// Support of an edge, in pieces.
#[derive(Debug, Clone, Copy, Default)]
pub struct Support {
    /// Pieces that the picture shows of it.
    pub seen: f64,
    /// Those with one and the same step.
    pub agree: f64,
}

impl Support {
    /// Share of what is seen that agrees.
    pub fn share(&self) -> f64 {
        if self.seen > 0.0 { self.agree / self.seen } else { 0.0 }
    }
}

/// Pieces of all lines along the room's axes.
pub struct Evidence {
    /// By axis, then by angle.
    lines: [Vec<Vec<Piece>>; 3],
    /// Length of a piece, px.
    pub piece_px: f64,
}

impl Evidence {
    pub fn new(view: &View) -> Self {
        let blurred = blurred(&view.picture);
        let noise = [noise(&blurred, 2), noise(&blurred, 10)];
        let noise = [0, 1].map(|k| noise[k].map(|n| n.max(LEAST[k])));
        let piece_px = PIECE * view.diagonal_px();
        let count = (TAU * view.lens.focal_px[0] / APART_PX).ceil() as usize;
        let lines = [0, 1, 2].map(|axis| {
            let of = |i: usize| {
                let ends = view.line(axis, TAU * i as f64 / count as f64);
                ends.map_or(Vec::new(), |ends| pieces(view, &blurred, &noise, axis, ends, piece_px))
            };
            (0..count).into_par_iter().map(of).collect()
        });
        Self { lines, piece_px }
    }

    /// How many angles are looked at about each axis.
    pub fn count(&self) -> usize {
        self.lines[0].len()
    }

    fn number(&self, angle: f64) -> usize {
        (angle / TAU * self.count() as f64).round() as usize % self.count()
    }

    /// The pieces of an edge that the picture shows.
    pub fn of<'a>(&'a self, edge: &Edge) -> impl Iterator<Item = &'a Piece> + use<'a> {
        let away = edge.across[0].hypot(edge.across[1]);
        let range = edge.range.map(|r| r / away);
        let line = &self.lines[edge.axis][self.number(edge.angle())];
        line.iter().filter(move |p| p.slope > range[0] && p.slope < range[1])
    }

    /// How well it supports an edge.
    pub fn support(&self, edge: &Edge) -> Support {
        supported(self.of(edge))
    }

    /// Angles about an axis, within a range, at which a line is supported better than those beside it, and how well: the best
    /// `most` of them.
    pub fn peaks(&self, axis: usize, within: std::ops::Range<f64>, most: usize) -> Vec<(f64, f64)> {
        let angle = |i: usize| TAU * i as f64 / self.count() as f64;
        let inside = |i: &usize| within.contains(&angle(*i));
        let all: Vec<(usize, f64)> = (0..self.count())
            .filter(inside)
            .map(|i| (i, supported(self.lines[axis][i].iter()).agree))
            .collect();
        let mut peaks: Vec<(f64, f64)> = (0..all.len())
            .filter(|&k| {
                let beside = &all[k.saturating_sub(PEAK)..(k + PEAK + 1).min(all.len())];
                let best = beside.iter().map(|b| b.1).fold(0.0, f64::max);
                all[k].1 >= LEAST_PIECES && all[k].1 >= best && (k == 0 || all[k].1 > all[k - 1].1)
            })
            .map(|k| (angle(all[k].0), all[k].1))
            .collect();
        peaks.sort_by(|a, b| b.1.total_cmp(&a.1));
        peaks.truncate(most);
        peaks
    }
}

/// Lines to both sides that a peak stands out from.
const PEAK: usize = 3;
/// Pieces that must agree for a line to be looked at.
const LEAST_PIECES: f64 = 3.0;

/// Steps that differ cancel.
fn supported<'a>(pieces: impl Iterator<Item = &'a Piece>) -> Support {
    let (mut seen, mut sum) = (0.0, Vector3::zeros());
    for piece in pieces {
        seen += 1.0;
        sum += piece.step.unwrap_or_default();
    }
    Support { seen, agree: sum.norm() }
}

/// A line in pieces.
fn pieces(
    view: &View,
    blurred: &Image<[f32; 3]>,
    noise: &[[f32; 3]; 2],
    axis: usize,
    [a, b]: [Point2<f64>; 2],
    piece_px: f64,
) -> Vec<Piece> {
    let length = (b - a).norm();
    let count = (length / piece_px).floor() as usize;
    if count == 0 {
        return Vec::new();
    }
    let along = (b - a) / length;
    let across = Vector2::new(-along.y, along.x);
    let samples = (piece_px / 2.0).ceil() as usize;
    let [p, q] = others(axis);
    let piece = |k: usize| {
        // Mean colours at each distance beside it.
        let mut profile = [[0.0; 3]; 2 * REACH as usize + 1];
        for s in 0..samples {
            let at = a + along * (piece_px * (k as f64 + (s as f64 + 0.5) / samples as f64));
            for (offset, mean) in (-REACH..=REACH).zip(&mut profile) {
                let colour = bilinear(blurred, &view.stored(&(at + across * f64::from(offset))));
                (0..3).for_each(|c| mean[c] += colour[c] / samples as f64);
            }
        }
        let mean = |offset: i32, c: usize| profile[(offset + REACH) as usize][c];
        let gradient = |offset: i32| {
            let of = |c: usize| (mean(offset + 1, c) - mean(offset - 1, c)) / f64::from(noise[0][c]);
            (0..3).map(|c| of(c).powi(2)).sum::<f64>().sqrt()
        };
        let best = (-NEAR..=NEAR).max_by(|a, b| gradient(*a).total_cmp(&gradient(*b))).unwrap_or(0);
        let (least, most) = (gradient(best), [-NEAR - 2, -NEAR - 1, NEAR + 1, NEAR + 2].map(gradient));
        let most = most.into_iter().fold(0.0, f64::max);
        let step = Vector3::from_fn(|c, _| {
            let side = |sign: i32| (3..=REACH).map(|o| mean(sign * o, c)).sum::<f64>() / f64::from(REACH - 2);
            (side(1) - side(-1)) / f64::from(noise[1][c])
        });
        let there = least > GRADIENT && least > ABOVE_OTHERS * most && step.norm() > STEP;
        // The peak of a parabola through three gradients.
        let [l, m, r] = [best - 1, best, best + 1].map(gradient);
        let bend = l - 2.0 * m + r;
        let peak = if bend < 0.0 { (0.5 * (l - r) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        let at = a + along * (piece_px * (k as f64 + 0.5));
        let ray = view.ray(&at);
        Piece {
            at,
            slope: ray[axis] / ray[p].hypot(ray[q]),
            step: there.then(|| step.normalize()),
            across,
            beside: f64::from(best) + peak,
        }
    };
    (0..count).map(piece).collect()
}

/// By a binomial filter of five, standard deviation 1 px.
fn blurred(image: &Image<[f32; 3]>) -> Image<[f32; 3]> {
    let pass = |from: &Image<[f32; 3]>, dx: i64, dy: i64| {
        let (w, h) = (from.width() as i64, from.height() as i64);
        Image::from_fn(from.width(), from.height(), |x, y| {
            let mut sum = [0.0; 3];
            for (offset, weight) in (-2..=2).zip([0.0625, 0.25, 0.375, 0.25, 0.0625]) {
                let at = |v: usize, d: i64, n: i64| (v as i64 + d * offset).clamp(0, n - 1) as usize;
                let pixel = from.at(at(x, dx, w), at(y, dy, h));
                (0..3).for_each(|c| sum[c] += weight * pixel[c]);
            }
            sum
        })
    };
    pass(&pass(image, 1, 0), 0, 1)
}

/// Usual difference of pixels so far apart, by channel: 1.4826 times its median.
fn noise(image: &Image<[f32; 3]>, apart: usize) -> [f32; 3] {
    [0, 1, 2].map(|c| {
        let mut all = Vec::with_capacity(2 * image.pixels().len());
        for y in 0..image.height() {
            for x in 0..image.width() {
                let own = image.at(x, y)[c];
                if x + apart < image.width() {
                    all.push((image.at(x + apart, y)[c] - own).abs());
                }
                if y + apart < image.height() {
                    all.push((image.at(x, y + apart)[c] - own).abs());
                }
            }
        }
        let middle = all.len() / 2;
        if all.is_empty() { 0.0 } else { 1.4826 * *all.select_nth_unstable_by(middle, f32::total_cmp).1 }
    })
}

fn bilinear(image: &Image<[f32; 3]>, at: &Point2<f64>) -> [f64; 3] {
    let fx = (at.x - 0.5).clamp(0.0, (image.width() - 1) as f64);
    let fy = (at.y - 0.5).clamp(0.0, (image.height() - 1) as f64);
    let (x0, y0) = (fx as usize, fy as usize);
    let (x1, y1) = ((x0 + 1).min(image.width() - 1), (y0 + 1).min(image.height() - 1));
    let (ax, ay) = (fx - x0 as f64, fy - y0 as f64);
    let [a, b, c, d] = [(x0, y0), (x1, y0), (x0, y1), (x1, y1)].map(|(x, y)| image.at(x, y));
    std::array::from_fn(|k| {
        let [a, b, c, d] = [a[k], b[k], c[k], d[k]].map(f64::from);
        (a * (1.0 - ax) + b * ax) * (1.0 - ay) + (c * (1.0 - ax) + d * ax) * ay
    })
}

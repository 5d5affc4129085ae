//! Which photographs show one view, by their content, however they were exposed.
//!
//! Two exposures of one view are bound by a rising curve: where the one is brighter, so is the other. What departs from the
//! curve is noise, motion, or another view. No response need be known.

use super::Header;
use crate::image::CodeImage;

/// Cells of a thumbnail along its sides.
const CELLS: [usize; 2] = [48, 36];
/// Codes within which a cell must lie whole.
const HELD: std::ops::Range<f32> = 0.04..0.97;
/// Share of the cells that two must hold in common, to be compared.
const COMMON: f64 = 0.1;
/// Departure from the curve that noise does not make, ln exposure, and the share of cells that may have it: a ball that is put
/// into the view stays below it, another view has 10 % and more.
const DEPARTS: f32 = 0.3;
const MAY_DEPART: f64 = 0.07;

/// A photograph's green in cells: ln exposure by the sRGB curve, or NaN where it is not held.
#[derive(Debug, Clone, PartialEq)]
pub struct Thumbnail(Vec<f32>);

impl Thumbnail {
    /// Of a photograph.
    pub fn new(codes: &CodeImage) -> Self {
        let (width, height) = codes.size();
        let [columns, rows] = CELLS;
        let edge = |i: usize, of: usize, n: usize| i * n / of;
        let cell = |x: usize, y: usize| {
            let (mut sum, mut count) = (0.0_f32, 0);
            for v in edge(y, rows, height)..edge(y + 1, rows, height) {
                for u in edge(x, columns, width)..edge(x + 1, columns, width) {
                    let code = codes.at(u, v).0[1];
                    if !HELD.contains(&code) {
                        return f32::NAN;
                    }
                    sum += ((code + 0.055) / 1.055).powf(2.4);
                    count += 1;
                }
            }
            (sum / count as f32).ln()
        };
        Self((0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))).map(|(x, y)| cell(x, y)).collect())
    }

    /// Of a photograph that shows nothing.
    pub fn dark() -> Self {
        Self(vec![f32::NAN; CELLS[0] * CELLS[1]])
    }

    fn held(&self) -> usize {
        self.0.iter().filter(|v| !v.is_nan()).count()
    }

    /// Share of the cells that both hold which depart from a curve from the one to the other; `None` where they hold too few
    /// in common.
    fn departure(&self, other: &Self) -> Option<f64> {
        let both = self.0.iter().zip(&other.0).filter(|(a, b)| !a.is_nan() && !b.is_nan());
        let pairs: Vec<(f32, f32)> = both.map(|(a, b)| (*a, *b)).collect();
        if (pairs.len() as f64) < COMMON * self.0.len() as f64 {
            return None;
        }
        let swapped = pairs.iter().map(|(a, b)| (*b, *a)).collect();
        // Where the curve is steep, it is better followed the other way.
        Some(off_the_curve(pairs).min(off_the_curve(swapped)))
    }
}

/// Share of points off the running median of their neighbours along the first.
fn off_the_curve(mut pairs: Vec<(f32, f32)>) -> f64 {
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let reach = (pairs.len() / 24).max(8);
    let off = (0..pairs.len()).filter(|i| {
        let near = &pairs[i.saturating_sub(reach)..(i + reach + 1).min(pairs.len())];
        let mut values: Vec<f32> = near.iter().map(|p| p.1).collect();
        let middle = values.len() / 2;
        let curve = *values.select_nth_unstable_by(middle, f32::total_cmp).1;
        (pairs[*i].1 - curve).abs() > DEPARTS
    });
    off.count() as f64 / pairs.len().max(1) as f64
}

/// Groups photographs of one size by view, each group in the given order. What is too dark or too bright to show anything
/// goes with the nearest exposure among those taken right before or after it, where dates tell.
pub(super) fn views(photographs: &[(&Header, &Thumbnail)]) -> Vec<Vec<usize>> {
    let n = photographs.len();
    let mut group: Vec<usize> = (0..n).collect();
    let join = |group: &mut Vec<usize>, a: usize, b: usize| {
        let (from, to) = (group[a].max(group[b]), group[a].min(group[b]));
        group.iter_mut().filter(|g| **g == from).for_each(|g| *g = to);
    };
    for (i, j) in (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))) {
        let alike = photographs[i].1.departure(photographs[j].1);
        if alike.is_some_and(|d| d < MAY_DEPART) {
            join(&mut group, i, j);
        }
    }
    let mut by_time: Vec<usize> = (0..n).collect();
    by_time.sort_by(|a, b| photographs[*a].0.date.cmp(&photographs[*b].0.date).then(a.cmp(b)));
    let least = COMMON * (CELLS[0] * CELLS[1]) as f64;
    for (k, i) in by_time.iter().copied().enumerate() {
        // Without a date nothing tells what was taken right before and after.
        if photographs[i].1.held() as f64 >= least || photographs[i].0.date.is_none() {
            continue;
        }
        let stops = |j: usize| {
            let times = photographs[i].0.time_s.zip(photographs[j].0.time_s)?;
            Some((times.0 / times.1).ln().abs()).filter(|s| *s > 0.05)
        };
        let beside = [k.checked_sub(1), Some(k + 1)].into_iter().flatten().filter_map(|k| by_time.get(k));
        let nearest = beside.filter_map(|j| Some((stops(*j)?, *j))).min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, j)) = nearest {
            join(&mut group, i, j);
        }
    }
    let mut found: Vec<Vec<usize>> = vec![Vec::new(); n];
    group.iter().enumerate().for_each(|(i, g)| found[*g].push(i));
    found.retain(|g| !g.is_empty());
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Code, Image};

    /// A view of random blotches, photographed by a camera whose curve is not sRGB.
    fn shoot(view: u32, exposure: f32) -> Thumbnail {
        Thumbnail::new(&Image::from_fn(192, 144, |x, y| {
            let (u, v) = (x as f32 / 9.0, y as f32 / 8.0);
            let seed = view as f32 * 1.7;
            let light = 0.02
                * (3.0 * ((u + seed).sin() * (0.7 * v + 2.0 * seed).cos() + (0.31 * u * v + seed).sin()))
                    .exp();
            Code([(1.0 - (-light * exposure).exp()).powf(0.45); 3])
        }))
    }

    fn at(time_s: f64) -> Header {
        Header { time_s: Some(time_s), ..Header::default() }
    }

    #[test]
    fn views_are_told_apart_whatever_their_exposure_and_order() {
        let exposures = [0.25, 1.0, 4.0, 16.0];
        // Interleaved.
        let all: Vec<(Header, Thumbnail)> = exposures
            .iter()
            .flat_map(|e| [0, 1, 2].map(|view| (at(f64::from(*e)), shoot(view, *e))))
            .collect();
        let found = views(&all.iter().map(|(h, t)| (h, t)).collect::<Vec<_>>());
        assert_eq!(found, [[0, 3, 6, 9], [1, 4, 7, 10], [2, 5, 8, 11]].map(Vec::from));
    }

    #[test]
    fn a_black_photograph_goes_with_the_one_taken_before_it() {
        let all = [
            (at(1.0), shoot(0, 1.0)),
            (at(0.25), shoot(0, 0.25)),
            (at(0.0001), shoot(0, 0.0001)),
            (at(1.0), shoot(1, 1.0)),
        ];
        assert!(all[2].1.held() == 0);
        let found = |all: &[(Header, Thumbnail)]| views(&all.iter().map(|(h, t)| (h, t)).collect::<Vec<_>>());
        assert_eq!(found(&all), [vec![0, 1], vec![2], vec![3]]);
        let dated = all.map(|(h, t)| (Header { date: Some("2008:01:05 10:00:00".into()), ..h }, t));
        assert_eq!(found(&dated), [vec![0, 1, 2], vec![3]]);
    }
}

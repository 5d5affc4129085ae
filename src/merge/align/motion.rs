//! The motion of each frame against the middle exposure: first a shift, coarse to fine, then a homography where it
//! explains more. What does not clearly explain more is not taken.

use super::homography::{Edge, Free, Logs, correlation, cost, largest_move, map, refine};
use super::{GAIN, HELD, NEEDED};
use crate::exposure::Frame;
use crate::image::Image;
use crate::merge::order::by_exposure;
use crate::response::Response;
use nalgebra::Matrix3;
use rayon::prelude::*;

/// Pixels of the reduced pictures that are compared, at most.
const PIXELS: usize = 800_000;
/// Width of the coarsest pictures, px, and how far shifts are looked for there and, at each finer step, around.
const COARSEST: usize = 120;
const REACH: i32 = 8;
/// Edges looked at.
const SAMPLES: usize = 8000;
/// A motion below this would blur more than it brings, px.
const LEAST_PX: f64 = 0.3;
/// Share of the picture's size beyond which no motion is believed.
const FARTHEST: f64 = 0.15;
/// A frame whose edges correlate less than this with its neighbour's shows something else.
const LEAST_CORRELATION: f64 = 0.35;

/// How a frame lies against the view.
#[derive(Debug, Clone, PartialEq)]
pub enum Motion {
    /// Where it should be.
    Still,
    /// Shifted, px.
    Shift([f64; 2]),
    /// Turned, zoomed or tilted too.
    Homography(Matrix3<f64>),
    /// No motion brings it over its neighbour; what edges of the two have in common, as a correlation.
    Lost(f64),
}

impl Motion {
    /// Pixels of the frame from pixels of the view.
    pub fn frame_from_view(&self) -> Matrix3<f64> {
        match self {
            Self::Shift([x, y]) => Matrix3::new(1.0, 0.0, *x, 0.0, 1.0, *y, 0.0, 0.0, 1.0),
            Self::Homography(h) => *h,
            Self::Still | Self::Lost(_) => Matrix3::identity(),
        }
    }

    /// Farthest that a corner of the picture moves, px.
    pub fn largest_px(&self, size: (usize, usize)) -> f64 {
        largest_move(&self.frame_from_view(), size)
    }
}

/// Motion of each frame; the middle exposure stands still. Frames that share too few tones to tell are taken to lie as
/// their neighbour.
pub fn motions(frames: &[Frame], response: &Response) -> std::io::Result<Vec<Motion>> {
    let order = by_exposure(frames)?;
    let mut found = vec![Motion::Still; frames.len()];
    let Some(size) = frames.first().map(|f| f.codes.size()) else { return Ok(found) };
    let factor = ((size.0 * size.1) as f64 / PIXELS as f64).sqrt().ceil().max(1.0) as usize;
    if size.0 / factor < 64 || size.1 / factor < 48 {
        return Ok(found);
    }
    let reduced: Vec<Logs> =
        frames.par_iter().map(|f| reduce(f, response, factor)).collect::<std::io::Result<Vec<_>>>()?;
    let middle = order.len() / 2;
    for side in [(middle + 1..order.len()).collect::<Vec<_>>(), (0..middle).rev().collect()] {
        // Neighbours in exposure hold the most pixels in common; motions add up from the middle outwards.
        let mut last = order[middle];
        let mut last_from_view = Matrix3::identity();
        for k in side {
            let frame = order[k];
            let pair = match between(&reduced[last], &reduced[frame]) {
                Ok(pair) => pair,
                Err(correlation) => {
                    found[frame] = Motion::Lost(correlation);
                    continue;
                }
            };
            last_from_view = scaled(&pair, factor as f64) * last_from_view;
            last = frame;
            found[frame] = told(&last_from_view, size);
        }
    }
    Ok(found)
}

/// A map between reduced pictures as one between the pictures themselves.
fn scaled(h: &Matrix3<f64>, factor: f64) -> Matrix3<f64> {
    let up = Matrix3::new_scaling(factor);
    let down = Matrix3::new_scaling(1.0 / factor);
    up * h * down
}

fn told(h: &Matrix3<f64>, size: (usize, usize)) -> Motion {
    let shift = map(h, [0.0, 0.0]);
    let pure = Matrix3::new(1.0, 0.0, shift[0], 0.0, 1.0, shift[1], 0.0, 0.0, 1.0);
    if largest_move(h, size) < LEAST_PX {
        Motion::Still
    } else if (h / h[(2, 2)] - pure).abs().max() < 1e-12 {
        Motion::Shift(shift)
    } else {
        Motion::Homography(h / h[(2, 2)])
    }
}

/// Means of ln green exposure over `factor` × `factor` px.
fn reduce(frame: &Frame, response: &Response, factor: usize) -> std::io::Result<Logs> {
    let (width, height) = frame.codes.size();
    let (w, h) = (width / factor, height / factor);
    let (mut ln, mut held) = (Vec::with_capacity(w * h), Vec::with_capacity(w * h));
    let bands = (h / 64).max(1);
    for band in (0..h).step_by(h.div_ceil(bands)) {
        let rows = band..(band + h.div_ceil(bands)).min(h);
        let codes = frame.codes.rows(rows.start * factor..rows.end * factor)?;
        for y in 0..rows.len() {
            for x in 0..w {
                let (mut sum, mut inside) = (0.0_f32, true);
                for (u, v) in (0..factor).flat_map(|v| (0..factor).map(move |u| (u, v))) {
                    let code = codes.at(x * factor + u, y * factor + v).0[1];
                    inside &= HELD.contains(&code);
                    sum += response.curves[1].exposure_of(code);
                }
                let mean = sum / (factor * factor) as f32 / frame.exposure as f32;
                ln.push(mean.max(1e-20).ln());
                held.push(inside);
            }
        }
    }
    Ok(Logs { ln: Image::from_pixels(w, h, ln), held: Image::from_pixels(w, h, held) })
}

/// The steepest places of a picture that it holds.
fn edges(a: &Logs) -> Vec<Edge> {
    let (w, h) = a.ln.size();
    let mut found: Vec<(f32, usize, usize)> = (2..h - 2)
        .flat_map(|y| (2..w - 2).map(move |x| (x, y)))
        .filter(|&(x, y)| (0..9).all(|k| *a.held.at(x + k % 3 - 1, y + k / 3 - 1)))
        .map(|(x, y)| {
            let v = |x, y| *a.ln.at(x, y);
            ((v(x + 1, y) - v(x - 1, y)).abs() + (v(x, y + 1) - v(x, y - 1)).abs(), x, y)
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.2, a.1).cmp(&(b.2, b.1))));
    // Not all of one strong edge: every so-many-th of the steeper quarter.
    found.truncate((found.len() / 4).max(SAMPLES));
    let stride = found.len().div_ceil(SAMPLES).max(1);
    let take = found.into_iter().step_by(stride);
    take.map(|(_, x, y)| Edge { at: [x as f64 + 0.5, y as f64 + 0.5], ln: f64::from(*a.ln.at(x, y)) })
        .collect()
}

/// Half the size.
fn halved(a: &Logs) -> Logs {
    let (w, h) = (a.ln.width() / 2, a.ln.height() / 2);
    let four =
        |x: usize, y: usize| [(2 * x, 2 * y), (2 * x + 1, 2 * y), (2 * x, 2 * y + 1), (2 * x + 1, 2 * y + 1)];
    Logs {
        ln: Image::from_fn(w, h, |x, y| four(x, y).iter().map(|(u, v)| a.ln.at(*u, *v)).sum::<f32>() / 4.0),
        held: Image::from_fn(w, h, |x, y| four(x, y).iter().all(|(u, v)| *a.held.at(*u, *v))),
    }
}

/// Pixels of the second picture from pixels of the first; the correlation of their edges where nothing brings them
/// together.
fn between(a: &Logs, b: &Logs) -> Result<Matrix3<f64>, f64> {
    let still = Matrix3::identity();
    let fine = edges(a);
    let unmoved = cost(&fine, b, &still);
    let shift = coarse_to_fine(a, b);
    if fine.len() < NEEDED {
        return Ok(still);
    }
    let size = b.ln.size();
    let farthest = FARTHEST * size.0.max(size.1) as f64;
    let believed = |h: &Matrix3<f64>| largest_move(h, size) <= farthest;
    let (mut best, mut least) = (still, unmoved);
    let mut take = |h: Matrix3<f64>, gain: f64| {
        let cost = cost(&fine, b, &h);
        if cost < gain * least && believed(&h) {
            (best, least) = (h, cost);
        }
    };
    let started = Matrix3::new(1.0, 0.0, shift[0], 0.0, 1.0, shift[1], 0.0, 0.0, 1.0);
    let shifted = refine(&fine, b, &started, Free::Shift);
    take(shifted, GAIN);
    for start in [started, still] {
        take(refine(&fine, b, &start, Free::All), GAIN);
    }
    if least.is_infinite() {
        return Ok(still);
    }
    let alike = correlation(&fine, b, &best);
    if alike < LEAST_CORRELATION { Err(alike) } else { Ok(best) }
}

/// Shift of the second picture's content, px.
fn coarse_to_fine(a: &Logs, b: &Logs) -> [f64; 2] {
    let mut steps: Vec<(Logs, Logs)> = Vec::new();
    loop {
        let (x, y) = steps.last().map_or((a, b), |(x, y)| (x, y));
        if x.ln.width() <= 2 * COARSEST || x.ln.height() < 48 {
            break;
        }
        let next = (halved(x), halved(y));
        steps.push(next);
    }
    let mut shift = [0, 0];
    let mut reach = REACH;
    for (x, y) in steps.iter().rev().map(|(x, y)| (x, y)).chain([(a, b)]) {
        let sampled = edges(x);
        if sampled.len() >= NEEDED {
            let [sx, sy] = shift;
            let around = (-reach..=reach).flat_map(|v| (-reach..=reach).map(move |u| [sx + u, sy + v]));
            let of = |s: &[i32; 2]| {
                let h = Matrix3::new(1.0, 0.0, f64::from(s[0]), 0.0, 1.0, f64::from(s[1]), 0.0, 0.0, 1.0);
                cost(&sampled, y, &h)
            };
            let costs: Vec<_> = around.collect::<Vec<_>>().into_par_iter().map(|s| (of(&s), s)).collect();
            if let Some((least, best)) = costs.iter().min_by(|a, b| a.0.total_cmp(&b.0))
                && *least < GAIN * of(&shift)
            {
                shift = *best;
            }
        }
        if !std::ptr::eq(x, a) {
            shift = shift.map(|s| 2 * s);
            reach = 2;
        }
    }
    shift.map(f64::from)
}

#[cfg(test)]
mod tests {
    use super::super::Moved;
    use super::*;
    use crate::image::{Code, CodeImage};

    /// Blotches of light of many sizes.
    fn light(x: f64, y: f64) -> f64 {
        let wave = |a: f64, b: f64, c: f64| (a * x + b * y + c).sin();
        0.05 + 0.03
            * (wave(0.11, 0.07, 0.3) + wave(0.31, -0.22, 1.0) * wave(0.02, 0.05, 2.0) + wave(-0.05, 0.4, 0.1))
                .abs()
            + 0.04 * (1.0 + wave(0.013, 0.021, 0.7))
    }

    /// The view through a map from the view's pixels to the frame's.
    fn shoot(exposure: f64, frame_from_view: &Matrix3<f64>) -> CodeImage {
        let view_from_frame = frame_from_view.try_inverse().unwrap();
        let response = Response::srgb();
        Image::from_fn(320, 240, |x, y| {
            let [u, v] = map(&view_from_frame, [x as f64 + 0.5, y as f64 + 0.5]);
            let code = response.code_of([(light(u, v) * exposure) as f32; 3]);
            Code(code.map(|c| (c * 255.0).round() / 255.0))
        })
    }

    fn found(maps: &[Matrix3<f64>]) -> Vec<Motion> {
        let exposures: Vec<f64> = (0..maps.len()).map(|i| 2.0_f64.powi(2 - i as i32)).collect();
        let images: Vec<_> = maps.iter().zip(&exposures).map(|(h, e)| shoot(*e, h)).collect();
        let frames: Vec<_> =
            images.iter().zip(&exposures).map(|(codes, e)| Frame { codes, exposure: *e }).collect();
        motions(&frames, &Response::srgb()).unwrap()
    }

    fn moved(x: f64, y: f64, turn_deg: f64) -> Matrix3<f64> {
        let (s, c) = turn_deg.to_radians().sin_cos();
        Matrix3::new(c, -s, x, s, c, y, 0.0, 0.0, 1.0)
    }

    #[test]
    fn still_frames_stay() {
        assert_eq!(found(&[Matrix3::identity(); 3]), [Motion::Still, Motion::Still, Motion::Still]);
    }

    #[test]
    fn shifts_beyond_the_finest_reach_are_found_to_a_tenth_of_a_pixel() {
        let truth = moved(-17.4, 11.0, 0.0);
        let motions = found(&[Matrix3::identity(), Matrix3::identity(), truth]);
        assert_eq!(motions[..2], [Motion::Still, Motion::Still]);
        let off = (motions[2].frame_from_view() - truth).abs().max();
        assert!(off < 0.1, "{motions:?}");
    }

    #[test]
    fn a_turned_frame_needs_a_homography_and_gets_it() {
        let truth = moved(3.0, -2.0, 1.2);
        let motions = found(&[truth, Matrix3::identity(), Matrix3::identity()]);
        let Motion::Homography(h) = &motions[0] else { panic!("{motions:?}") };
        for corner in [[0.0, 0.0], [320.0, 0.0], [0.0, 240.0], [320.0, 240.0]] {
            let (a, b) = (map(h, corner), map(&truth, corner));
            assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 0.3, "{corner:?}: {a:?} {b:?}");
        }
    }

    #[test]
    fn a_frame_of_another_view_is_lost_and_named() {
        let exposures = [4.0, 2.0, 1.0];
        let other = |x: usize, y: usize| {
            let light = 0.04 + 0.03 * ((x * 7919 + y * 104_729) % 97) as f32 / 97.0;
            Code(Response::srgb().code_of([light; 3]))
        };
        let images = [
            shoot(4.0, &Matrix3::identity()),
            shoot(2.0, &Matrix3::identity()),
            Image::from_fn(320, 240, other),
        ];
        let frames: Vec<_> =
            images.iter().zip(exposures).map(|(codes, exposure)| Frame { codes, exposure }).collect();
        let motions = motions(&frames, &Response::srgb()).unwrap();
        assert!(matches!(motions[2], Motion::Lost(_)), "{motions:?}");
        assert_eq!(motions[..2], [Motion::Still, Motion::Still]);
    }

    #[test]
    fn a_moved_frame_is_seen_through_the_view() {
        use crate::exposure::Rows;
        let truth = moved(3.3, -2.0, 1.2);
        let image = shoot(2.0, &truth);
        let still = shoot(2.0, &Matrix3::identity());
        let back = Moved::new(&image, &Motion::Homography(truth)).rows(60..180).unwrap();
        // At the creases of the blotches bilinear means are flatter.
        let (mut sum, mut worst) = (0.0, 0.0_f32);
        for (x, y) in (60..180).flat_map(|y| (40..280).map(move |x| (x, y))) {
            let off = (back.at(x, y - 60).0[1] - still.at(x, y).0[1]).abs();
            (sum, worst) = (sum + off, worst.max(off));
        }
        let mean = sum / (120.0 * 240.0);
        assert!(mean < 0.003 && worst < 0.04, "{mean} {worst}");
        assert!(Moved::new(&image, &Motion::Shift([-20.0, 0.0])).rows(0..1).unwrap().at(5, 0).0[0].is_nan());
    }
}

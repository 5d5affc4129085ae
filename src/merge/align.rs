//! Motion between exposures of one view: a tripod that was touched, a camera in the hand. Compared is the logarithm of the
//! exposure at edges that both frames hold, so that the exposure time makes no difference.

mod homography;
mod motion;
mod moved;

pub use motion::{Motion, motions};
pub use moved::Moved;

use crate::exposure::Frame;
use crate::image::{Code, CodeImage, Image};
use crate::merge::order::by_exposure;
use crate::response::Response;
use rayon::prelude::*;

/// Largest shift looked for between neighbours, px.
const REACH: i32 = 8;
/// Codes that a frame holds.
const HELD: std::ops::Range<f32> = 0.1..0.92;
/// Edges looked at.
const SAMPLES: usize = 20_000;
/// Fewer tell nothing.
const NEEDED: usize = 200;
/// Difference beyond which a pixel is an outlier, ln exposure.
const CAP: f32 = 0.7;
/// A shift must make the frames agree better by this factor, so that noise moves nothing.
const GAIN: f32 = 0.85;

/// For each frame by how many px along x and y its content lies beside that of the middle exposure.
pub fn shifts(frames: &[Frame], response: &Response) -> Vec<[i32; 2]> {
    let mut found = vec![[0, 0]; frames.len()];
    // What cannot be read is not moved; merging says so.
    let Ok(order) = by_exposure(frames) else { return found };
    let middle = order.len() / 2;
    // Neighbours in exposure hold the most pixels in common; shifts add up from the middle outwards.
    let pairs = (middle..order.len().saturating_sub(1)).map(|k| (k, k + 1));
    for (from, to) in pairs.chain((1..=middle).rev().map(|k| (k, k - 1))) {
        let (from, to) = (order[from], order[to]);
        let [x, y] = between(&frames[from], &frames[to], response);
        found[to] = [found[from][0] + x, found[from][1] + y];
    }
    found
}

/// Shift of the second frame's content against the first's, px.
fn between(a: &Frame, b: &Frame, response: &Response) -> [i32; 2] {
    let log =
        |f: &Frame, c: &Code| (response.curves[1].exposure_of(c.0[1]) / f.exposure as f32).max(1e-9).ln();
    let (w, h) = a.codes.size();
    let margin = REACH as usize + 1;
    if w <= 2 * margin || h <= 2 * margin || b.codes.size() != (w, h) {
        return [0, 0];
    }
    let (Ok(ca), Ok(cb)) = (a.codes.rows(0..h), b.codes.rows(0..h)) else { return [0, 0] };
    let (la, lb) = (ca.map(|c| log(a, c)), cb.map(|c| log(b, c)));
    let mut edges: Vec<(f32, usize, usize)> = (margin..h - margin)
        .flat_map(|y| (margin..w - margin).map(move |x| (x, y)))
        .filter(|&(x, y)| HELD.contains(&ca.at(x, y).0[1]) && HELD.contains(&cb.at(x, y).0[1]))
        .map(|(x, y)| {
            let slope = (la.at(x + 1, y) - la.at(x - 1, y)).abs() + (la.at(x, y + 1) - la.at(x, y - 1)).abs();
            (slope, x, y)
        })
        .collect();
    if edges.len() < NEEDED {
        return [0, 0];
    }
    edges.sort_by(|a, b| b.0.total_cmp(&a.0));
    edges.truncate(SAMPLES);
    let cost = |[dx, dy]: [i32; 2]| -> f32 {
        let off = |&(_, x, y): &(f32, usize, usize)| {
            let moved = lb.at((x as i32 + dx) as usize, (y as i32 + dy) as usize);
            (la.at(x, y) - moved).abs().min(CAP)
        };
        edges.iter().map(off).sum::<f32>() / edges.len() as f32
    };
    let candidates: Vec<[i32; 2]> =
        (-REACH..=REACH).flat_map(|dy| (-REACH..=REACH).map(move |dx| [dx, dy])).collect();
    let best = candidates.into_par_iter().map(|s| (cost(s), s)).min_by(|a, b| a.0.total_cmp(&b.0));
    best.filter(|(least, _)| *least < GAIN * cost([0, 0])).map_or([0, 0], |(_, shift)| shift)
}

/// A frame with its content moved back; at the border its last pixels are repeated.
pub fn moved_back(codes: &CodeImage, [dx, dy]: [i32; 2]) -> CodeImage {
    let (w, h) = codes.size();
    let within = |i: usize, d: i32, n: usize| (i as i64 + i64::from(d)).clamp(0, n as i64 - 1) as usize;
    Image::from_fn(w, h, |x, y| *codes.at(within(x, dx, w), within(y, dy, h)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blotches of light, seen `shift` px beside their place.
    fn shoot(exposure: f32, shift: [i32; 2]) -> CodeImage {
        let response = Response::srgb();
        Image::from_fn(96, 80, |x, y| {
            let (u, v) = ((x as i32 - shift[0]) as f32, (y as i32 - shift[1]) as f32);
            let light = 0.02 + 0.1 * (1.0 + (0.45 * u).sin() * (0.31 * v + 0.002 * u * v).cos());
            Code(response.code_of([light * exposure; 3]))
        })
    }

    fn found(shift: [i32; 2]) -> Vec<[i32; 2]> {
        let images = [shoot(4.0, [0, 0]), shoot(2.0, [0, 0]), shoot(1.0, shift)];
        let frames: Vec<_> =
            images.iter().zip([4.0, 2.0, 1.0]).map(|(codes, exposure)| Frame { codes, exposure }).collect();
        shifts(&frames, &Response::srgb())
    }

    #[test]
    fn a_shifted_frame_is_found_and_moved_back() {
        assert_eq!(found([-1, 3]), [[0, 0], [0, 0], [-1, 3]]);
        let back = moved_back(&shoot(1.0, [-1, 3]), [-1, 3]);
        assert_eq!(back.at(40, 40), shoot(1.0, [0, 0]).at(40, 40));
    }

    #[test]
    fn frames_that_agree_stay() {
        assert_eq!(found([0, 0]), [[0, 0]; 3]);
    }
}

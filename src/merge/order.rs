//! One order of the frames, in whatever order they are given: rounding of sums goes by it, and where a reading lies at
//! the edge of what is left out, rounding decides.

use crate::exposure::Frame;
use std::cmp::Ordering;
use std::io::Result;

/// Rows that are compared at a time.
const ROWS: usize = 64;

/// Indices of the frames from the shortest exposure to the longest, equal ones by their codes. Alike in both are frames
/// that can take each other's place.
pub(super) fn by_exposure(frames: &[Frame]) -> Result<Vec<usize>> {
    let mut order: Vec<usize> = Vec::with_capacity(frames.len());
    for (i, frame) in frames.iter().enumerate() {
        let mut at = order.len();
        while at > 0 && compare(&frames[order[at - 1]], frame)?.is_gt() {
            at -= 1;
        }
        order.insert(at, i);
    }
    Ok(order)
}

/// Codes are read where exposures are equal alone, and up to the first rows that differ.
fn compare(a: &Frame, b: &Frame) -> Result<Ordering> {
    let size = a.codes.size();
    let so_far = a.exposure.total_cmp(&b.exposure).then(size.cmp(&b.codes.size()));
    if so_far.is_ne() {
        return Ok(so_far);
    }
    for top in (0..size.1).step_by(ROWS) {
        let rows = top..(top + ROWS).min(size.1);
        let (of_a, of_b) = (a.codes.rows(rows.clone())?, b.codes.rows(rows)?);
        let [a, b] = [&of_a, &of_b].map(|c| c.pixels().iter().map(|p| p.0.map(f32::to_bits)));
        let found = a.cmp(b);
        if found.is_ne() {
            return Ok(found);
        }
    }
    Ok(Ordering::Equal)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Code, CodeImage, Image};

    #[test]
    fn shortest_first_and_equal_ones_by_their_codes() {
        let image = |last: f32| -> CodeImage {
            Image::from_fn(3, 150, |x, y| Code([0.5, 0.5, if (x, y) == (2, 149) { last } else { 0.5 }]))
        };
        let images = [0.3, 0.1, 0.2, 0.4].map(image);
        let exposures = [1.0, 2.0, 1.0, 0.5];
        let frames: Vec<Frame> =
            images.iter().zip(exposures).map(|(codes, exposure)| Frame { codes, exposure }).collect();
        assert_eq!(by_exposure(&frames).unwrap(), [3, 2, 0, 1]);
        assert_eq!(by_exposure(&[frames[0]; 3]).unwrap(), [0, 1, 2]);
        assert_eq!(by_exposure(&[]).unwrap(), [0; 0]);
    }
}

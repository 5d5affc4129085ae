//! A frame as the view sees it.

use super::homography::map;
use super::motion::Motion;
use crate::exposure::{Rows, Strip};
use crate::image::{Code, Image};
use nalgebra::Matrix3;
use std::io::Result;
use std::ops::Range;

/// Codes from which on a mean would hide that a pixel is saturated.
const NEAR_CLIP: f32 = 0.98;

/// A frame brought over the view: its codes between pixels are bilinear means. Where the frame does not reach, they are
/// NaN, which tells nothing.
pub struct Moved<'a> {
    codes: &'a dyn Rows,
    frame_from_view: Matrix3<f64>,
    still: bool,
}

impl<'a> Moved<'a> {
    /// A frame with its motion.
    pub fn new(codes: &'a dyn Rows, motion: &Motion) -> Self {
        let still = matches!(motion, Motion::Still | Motion::Lost(_));
        Self { codes, frame_from_view: motion.frame_from_view(), still }
    }
}

impl Rows for Moved<'_> {
    fn size(&self) -> (usize, usize) {
        self.codes.size()
    }

    fn bits(&self) -> u32 {
        self.codes.bits()
    }

    fn strip(&self, range: Range<usize>) -> Result<Strip<'_>> {
        if self.still {
            return self.codes.strip(range);
        }
        let (width, height) = self.size();
        let (top, bottom) = (range.start as f64, range.end as f64);
        let corners = [[0.0, top], [width as f64, top], [0.0, bottom], [width as f64, bottom]];
        let reached = corners.map(|c| map(&self.frame_from_view, c)[1]);
        let (low, high) = reached.iter().fold((f64::MAX, f64::MIN), |(l, h), y| (l.min(*y), h.max(*y)));
        let first = (low - 2.0).clamp(0.0, height as f64) as usize;
        let last = (high + 3.0).clamp(first as f64, height as f64) as usize;
        let source = self.codes.rows(first..last)?;
        let nowhere = Code([f32::NAN; 3]);
        let seen = Image::from_fn(width, range.len(), |x, y| {
            let [u, v] = map(&self.frame_from_view, [x as f64 + 0.5, (range.start + y) as f64 + 0.5]);
            let (fx, fy) = (u - 0.5, v - 0.5 - first as f64);
            // Half a pixel beyond the outermost centres is still within the picture.
            let within = |f: f64, n: usize| n > 0 && f >= -0.5 && f <= n as f64 - 0.5;
            if !within(fx, width) || !within(fy, source.height()) {
                return nowhere;
            }
            let place = |f: f64, n: usize| {
                let f = f.clamp(0.0, (n - 1) as f64);
                (f as usize, (f as usize + 1).min(n - 1), f.fract() as f32)
            };
            let ((x0, x1, a), (y0, y1, b)) = (place(fx, width), place(fy, source.height()));
            let four = [source.at(x0, y0), source.at(x1, y0), source.at(x0, y1), source.at(x1, y1)];
            Code(std::array::from_fn(|k| {
                let v = four.map(|c| c.0[k]);
                let most = v.iter().copied().fold(0.0, f32::max);
                if most >= NEAR_CLIP {
                    return most;
                }
                (v[0] * (1.0 - a) + v[1] * a) * (1.0 - b) + (v[2] * (1.0 - a) + v[3] * a) * b
            }))
        });
        Ok(Strip::Codes(seen.into_pixels().into()))
    }
}

//! Sub-pixel edges across a curve in a picture.

use crate::image::Image;
use nalgebra::{Point2, Vector2};

/// Spacing of samples along a profile, px.
const STEP_PX: f64 = 0.5;
/// Half the width of the difference that finds an edge, samples.
const HALF: usize = 3;

/// An edge met by a profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// Where, along the profile from its middle, px.
    pub offset_px: f64,
    /// Difference of the two sides as a share of their mean.
    pub contrast: f64,
}

/// Bilinear lookup, clamped at the border; centres at +0.5.
pub fn sample(image: &Image<f32>, p: &Point2<f64>) -> f32 {
    let (w, h) = image.size();
    let fx = (p.x - 0.5).clamp(0.0, (w - 1) as f64);
    let fy = (p.y - 0.5).clamp(0.0, (h - 1) as f64);
    let (x0, y0) = (fx as usize, fy as usize);
    let (x1, y1) = ((x0 + 1).min(w - 1), (y0 + 1).min(h - 1));
    let (ax, ay) = ((fx - x0 as f64) as f32, (fy - y0 as f64) as f32);
    let top = image.at(x0, y0) * (1.0 - ax) + image.at(x1, y0) * ax;
    let bottom = image.at(x0, y1) * (1.0 - ax) + image.at(x1, y1) * ax;
    top * (1.0 - ay) + bottom * ay
}

/// The strongest edge on a line through `middle` along `normal`, those further than `reach_px` discounted; on linear
/// luminance, where a blurred edge keeps its place whatever its contrast.
pub fn find(image: &Image<f32>, middle: &Point2<f64>, normal: &Vector2<f64>, reach_px: f64) -> Option<Edge> {
    let half = (1.5 * reach_px / STEP_PX).ceil() as usize + 1;
    let count = 2 * (half + HALF) + 1;
    let at = |i: usize| (i as f64 - (half + HALF) as f64) * STEP_PX;
    let profile: Vec<f64> =
        (0..count).map(|i| f64::from(sample(image, &(middle + normal * at(i))))).collect();
    let sides = |i: usize| {
        let before: f64 = profile[i - HALF..i].iter().sum();
        let after: f64 = profile[i + 1..=i + HALF].iter().sum();
        (before, after)
    };
    let steps: Vec<f64> = (HALF..count - HALF).map(|i| (sides(i).1 - sides(i).0).abs()).collect();
    let discounted = |i: usize| steps[i] * (-0.5 * (at(i + HALF) / reach_px).powi(2)).exp();
    let best = (1..steps.len() - 1)
        .filter(|&i| steps[i] > 0.0 && steps[i] >= steps[i - 1] && steps[i] >= steps[i + 1])
        .max_by(|&a, &b| discounted(a).total_cmp(&discounted(b)))?;
    let [a, b, c] = [steps[best - 1], steps[best], steps[best + 1]];
    let (before, after) = sides(best + HALF);
    let contrast = 2.0 * b / (before + after).max(f64::MIN_POSITIVE);
    let bend = a - 2.0 * b + c;
    let vertex = if bend < 0.0 { 0.5 * (a - c) / bend } else { 0.0 };
    Some(Edge { offset_px: at(best + HALF) + vertex * STEP_PX, contrast })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_box_filtered_edge_is_placed_within_a_tenth_of_a_pixel(at in 14.0..18.0f64, dark in 0.01..0.9f32) {
            let image = Image::from_fn(32, 8, |x, _| {
                let covered = (x as f64 + 1.0 - at).clamp(0.0, 1.0) as f32;
                covered + (1.0 - covered) * dark
            });
            let edge = find(&image, &Point2::new(16.0, 4.0), &Vector2::new(1.0, 0.0), 3.0).unwrap();
            prop_assert!((16.0 + edge.offset_px - at).abs() < 0.15, "{} for {at}", 16.0 + edge.offset_px);
        }
    }

    #[test]
    fn a_flat_picture_has_no_edge() {
        let image = Image::from_fn(32, 8, |_, _| 0.3f32);
        assert_eq!(find(&image, &Point2::new(16.0, 4.0), &Vector2::new(1.0, 0.0), 3.0), None);
    }
}

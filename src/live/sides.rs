//! Corners of a marker from its sides. OpenCV's corners of a blurred, gamma-coded square lie some 0.4 px inside it, all of
//! them alike, which a pose takes for something else. Here each side is a line through the places where half of the light is
//! paper's, in linear radiance, and corners are where lines meet.

use crate::image::RadianceImage;
use nalgebra::{Point2, Vector2};

/// Profiles reach so far to both sides of a side, as a share of the marker across it; at least and at most so many px.
const REACH: f64 = 1.0 / 8.0;
const REACH_PX: [f64; 2] = [2.0, 4.0];
/// Distance of two samples of a profile, px.
const STEP_PX: f64 = 0.25;
/// Profiles keep so far from the corners, as a share of the side.
const MARGIN: f64 = 0.15;
/// A profile with less of the median contrast than this crosses something else.
const LEAST_CONTRAST: f64 = 0.5;
/// A corner that moves by more, px, is left where it was.
const FARTHEST_PX: f64 = 2.0;

/// A side: a point on it and its direction.
struct Line {
    point: Point2<f64>,
    along: Vector2<f64>,
}

/// Corners (px) of a dark square on white paper, going round, from nearby ones.
pub(super) fn refined(corners: [Point2<f64>; 4], picture: &RadianceImage) -> [Point2<f64>; 4] {
    let middle = Point2::from(corners.iter().map(|c| c.coords).sum::<Vector2<f64>>() / 4.0);
    let sides: [Option<Line>; 4] =
        std::array::from_fn(|k| side([corners[k], corners[(k + 1) % 4]], middle, picture));
    std::array::from_fn(|k| {
        let (Some(a), Some(b)) = (&sides[(k + 3) % 4], &sides[k]) else { return corners[k] };
        meeting(a, b).filter(|p| (p - corners[k]).norm() <= FARTHEST_PX).unwrap_or(corners[k])
    })
}

/// The side between two corners of a marker, by where half of the light is that of the paper outside.
fn side([from, to]: [Point2<f64>; 2], middle: Point2<f64>, picture: &RadianceImage) -> Option<Line> {
    let length = (to - from).norm();
    let along = (to - from).try_normalize(1e-9)?;
    let across = Vector2::new(-along.y, along.x);
    let inward = (middle - from).dot(&across);
    let outward = -across * inward.signum();
    let reach = (REACH * 2.0 * inward.abs()).clamp(REACH_PX[0], REACH_PX[1]);
    let half = (reach / STEP_PX) as i32;
    let (width, height) = (picture.width() as f64, picture.height() as f64);
    let profile = |at: f64| -> Option<[f64; 3]> {
        let sample = |i: i32| {
            let p = from + along * at + outward * (f64::from(i) * STEP_PX);
            let inside = p.x >= 1.0 && p.y >= 1.0 && p.x <= width - 1.0 && p.y <= height - 1.0;
            inside.then(|| f64::from(picture.bilinear(p.x, p.y).luminance()))
        };
        let values = (-half..=half).map(sample).collect::<Option<Vec<f64>>>()?;
        // Farther inside than where it is darkest lie the marker's cells.
        let inside = &values[..=half as usize];
        let darkest = (0..inside.len()).min_by(|&a, &b| inside[a].total_cmp(&inside[b]))?;
        let (dark, light) = (values[darkest], values[values.len() - 1]);
        // The paper's share of the profile lies outside the edge.
        let share = values[darkest..].iter().map(|v| (v - dark) / (light - dark)).sum::<f64>() - 0.5;
        Some([at - length / 2.0, (f64::from(half) - share) * STEP_PX, light - dark])
    };
    let count = ((1.0 - 2.0 * MARGIN) * length) as usize + 1;
    let places =
        (0..count).map(|i| MARGIN * length + (i as f64 + 0.5) * (1.0 - 2.0 * MARGIN) * length / count as f64);
    let mut profiles: Vec<[f64; 3]> = places.filter_map(profile).collect();
    let mut contrasts: Vec<f64> = profiles.iter().map(|p| p[2]).collect();
    contrasts.sort_by(f64::total_cmp);
    let usual = *contrasts.get(contrasts.len() / 2)?;
    profiles.retain(|p| usual > 0.0 && p[2] > LEAST_CONTRAST * usual && p[1].abs() < reach);
    let n = profiles.len() as f64;
    if profiles.len() < 3 {
        return None;
    }
    let mean = |k: usize| profiles.iter().map(|p| p[k]).sum::<f64>() / n;
    let (at, off) = (mean(0), mean(1));
    let spread: f64 = profiles.iter().map(|p| (p[0] - at).powi(2)).sum();
    let slope = profiles.iter().map(|p| (p[0] - at) * (p[1] - off)).sum::<f64>() / spread.max(1e-9);
    Some(Line { point: from + along * (at + length / 2.0) + outward * off, along: along + outward * slope })
}

fn meeting(a: &Line, b: &Line) -> Option<Point2<f64>> {
    let cross = a.along.perp(&b.along);
    (cross.abs() > 1e-6).then(|| a.point + a.along * ((b.point - a.point).perp(&b.along) / cross))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Image, Radiance};
    use proptest::prelude::*;

    type Corners = [Point2<f64>; 4];

    fn within(corners: &Corners, p: Point2<f64>) -> bool {
        (0..4).all(|k| (corners[(k + 1) % 4] - corners[k]).perp(&(p - corners[k])) >= 0.0)
    }

    /// A marker with white cells within its border on paper, each pixel the mean of 8 × 8 points.
    fn picture(corners: &Corners, lit: impl Fn(f64) -> f64) -> RadianceImage {
        let middle = corners.iter().map(|c| c.coords).sum::<Vector2<f64>>() / 4.0;
        let cells = corners.map(|c| Point2::from(middle + (c.coords - middle) * 4.0 / 6.0));
        Image::from_fn(80, 80, |x, y| {
            let is_dark = |i: usize| {
                let at = |k: usize, p: usize| p as f64 + (k as f64 + 0.5) / 8.0;
                let p = Point2::new(at(i % 8, x), at(i / 8, y));
                within(corners, p) && !within(&cells, p)
            };
            let dark = (0..64).filter(|i| is_dark(*i)).count() as f64 / 64.0;
            let light = lit(x as f64 / 80.0);
            Radiance([(light * (0.8 * (1.0 - dark) + 0.04 * dark)) as f32; 3])
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn corners_are_found_to_a_fraction_of_a_pixel(
            shift in proptest::array::uniform8(-1.0..1.0f64), off in proptest::array::uniform8(-0.5..0.5f64), uneven in 0.0..0.5f64,
        ) {
            // Seen from above, and at a flat angle.
            for square in [
                [[25.0, 26.0], [55.0, 24.0], [56.0, 54.0], [26.0, 56.0]],
                [[25.0, 30.0], [53.0, 29.0], [56.0, 45.0], [24.0, 46.0]],
            ] {
                let corners: Corners = std::array::from_fn(|k| {
                    Point2::new(square[k][0] + shift[2 * k], square[k][1] + shift[2 * k + 1])
                });
                let near = std::array::from_fn(|k| corners[k] + Vector2::new(off[2 * k], off[2 * k + 1]));
                let found = refined(near, &picture(&corners, |x| 1.0 - uneven * x));
                for (a, b) in found.iter().zip(&corners) {
                    prop_assert!((a - b).norm() < 0.15, "{} px", (a - b).norm());
                }
            }
        }
    }

    #[test]
    fn corners_without_sides_stay() {
        let corners = [[1.0, 1.0], [30.0, 1.0], [30.0, 30.0], [1.0, 30.0]].map(|[x, y]| Point2::new(x, y));
        let grey = Image::from_fn(80, 80, |_, _| Radiance([0.5; 3]));
        assert_eq!(refined(corners, &grey), corners);
    }
}

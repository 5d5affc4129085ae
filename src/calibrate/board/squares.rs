//! What a chessboard's squares look like in a photograph.

use super::{bilinear, pixel};
use crate::config;
use crate::image::Image;
use nalgebra::{Matrix3, Point2, Vector2};

/// A corner is one if the squares at it differ by this share of the difference between white and black.
const CONTRAST: f64 = 0.4;
/// Where the four squares are looked at, from the corner they meet at, in squares.
pub(super) const BESIDE: [[f64; 2]; 2] = [[0.2, 0.2], [0.4, 0.4]];
/// Where all are thought to be seen, if only blurred; outer squares may have been cut in half.
pub(super) const BETWEEN: [[f64; 2]; 1] = [[0.25, 0.25]];
/// Where it is open how large the squares are: next to the corners beside it, too.
pub(super) const REACH: [[f64; 2]; 4] = [[0.2, 0.2], [0.4, 0.4], [0.75, 0.25], [0.25, 0.75]];

/// Whether a square is black, counted from the middle of the one at the lower left.
fn is_black(i: i64, j: i64) -> bool {
    (i + j) % 2 == 0
}

/// Sides of the squares at a place on the board, px.
pub(super) fn sides(pixel_from_board: &Matrix3<f64>, at: Point2<f64>, square_m: f64) -> [Vector2<f64>; 2] {
    [Vector2::x(), Vector2::y()].map(|along| {
        let half = along * (square_m / 2.0);
        pixel(pixel_from_board, at + half) - pixel(pixel_from_board, at - half)
    })
}

/// Brightness of a place on the board; `None` outside the picture.
pub(super) fn seen(image: &Image<u8>, pixel_from_board: &Matrix3<f64>, at: Point2<f64>) -> Option<f64> {
    let p = pixel(pixel_from_board, at);
    bilinear(image, p.x, p.y)
}

/// Share of squares and of places in the margin that are as bright as they should be. Which squares are black is open: the brighter
/// kind is white.
pub(super) fn fit(
    image: &Image<u8>,
    pixel_from_board: &Matrix3<f64>,
    settings: &config::Calibrate,
) -> Option<f64> {
    let [nx, ny] = settings.inner_corners.map(i64::from);
    let at = |i: f64, j: f64| {
        let middle = |n: i64| (n as f64 - 1.0) / 2.0;
        Point2::new(i - middle(nx), j - middle(ny)) * settings.square_m
    };
    // Squares by their lower left corner, the margin half a square wide around them. Outer squares may have been cut in half.
    let squares: Vec<(i64, i64)> = (-1..ny).flat_map(|j| (-1..nx).map(move |i| (i, j))).collect();
    let within = |k: i64, n: i64| (k as f64 + 0.5).clamp(-0.25, n as f64 - 0.75);
    let bright = |&(i, j): &(i64, i64)| seen(image, pixel_from_board, at(within(i, nx), within(j, ny)));
    let [black, white] = [true, false].map(|kind| {
        let own = squares.iter().filter(|(i, j)| is_black(*i, *j) == kind);
        own.map(bright).collect::<Vec<Option<f64>>>()
    });
    let (middle_x, middle_y) = ((-1..nx).map(|i| i as f64 + 0.5), (-1..ny).map(|j| j as f64 + 0.5));
    let (low, high) = (-1.25, 0.25);
    let sides = middle_x
        .flat_map(|x| [at(x, low), at(x, ny as f64 + high)])
        .chain(middle_y.flat_map(|y| [at(low, y), at(nx as f64 + high, y)]));
    let margin: Vec<Option<f64>> = sides.map(|p| seen(image, pixel_from_board, p)).collect();
    let median = |values: &[Option<f64>]| {
        let mut known: Vec<f64> = values.iter().flatten().copied().collect();
        known.sort_by(f64::total_cmp);
        known.get(known.len() / 2).copied()
    };
    let threshold = (median(&black)? + median(&white)?) / 2.0;
    let right = |values: &[Option<f64>], is_white: bool| {
        values.iter().flatten().filter(|v| (**v > threshold) == is_white).count()
    };
    let kinds = [[true, false], [false, true]];
    let squares = kinds.map(|[a, b]| right(&black, a) + right(&white, b)).into_iter().max()?;
    let all = black.len() + white.len() + margin.len();
    Some((squares + right(&margin, true)) as f64 / all as f64)
}

/// Whether two squares at a corner, diagonally across, are bright and the two others dark, at places by the squares' sides; `None` where
/// one is outside the picture.
pub(super) fn is_corner(
    image: &Image<u8>,
    corner: Point2<f64>,
    [u, v]: [Vector2<f64>; 2],
    places: &[[f64; 2]],
) -> Option<bool> {
    let mut diagonals = [(f64::INFINITY, 0.0f64); 2];
    for [a, b] in places {
        for (x, y) in [(1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)] {
            let p = corner + u * (x * a) + v * (y * b);
            let bright = bilinear(image, p.x, p.y)?;
            let (least, most) = &mut diagonals[usize::from(x * y < 0.0)];
            (*least, *most) = (least.min(bright), most.max(bright));
        }
    }
    let [a, b] = diagonals;
    let (gap, span) = ((a.0 - b.1).max(b.0 - a.1), a.1.max(b.1) - a.0.min(b.0));
    Some(gap > CONTRAST * span.max(1.0))
}

//! The printed grid in one photograph: its corners, numbered the right way round.

mod markers;
mod partial;
mod squares;

pub(super) use markers::check;

use super::Problem;
use crate::config::{self, Disc, Grid};
use crate::image::Image;
use crate::vision::{self, BoardView};
use nalgebra::{DMatrix, Matrix3, Point2, Vector2, Vector3};

/// Centre of the black disc: this far outside the outer row and column of inner corners, in squares (in the middle of
/// a margin half a square wide).
const DISC_OFFSET: f64 = 1.25;
/// Where the same margin is white: this far outside the last corner along the edge, in squares.
const WHITE_OFFSET: f64 = 0.6;
/// Radius of the sampled spots, in squares; the printed disc's radius is 0.15.
const SPOT_RADIUS: f64 = 0.12;
/// Smallest difference in relative darkness between the disc and bare margin.
const MIN_DARKNESS: f64 = 0.08;

/// Positions of the inner corners in the grid's frame, m: origin in the middle, x along the first side, row by row.
pub fn corner_positions(settings: &config::Calibrate) -> Vec<Point2<f64>> {
    let [nx, ny] = settings.inner_corners.map(|n| n as usize);
    let at = |i: usize, n: usize| (i as f64 - (n as f64 - 1.0) / 2.0) * settings.square_m;
    (0..nx * ny).map(|k| Point2::new(at(k % nx, nx), at(k / nx, ny))).collect()
}

/// Finds the grid, or what is seen of it. A chessboard is seen from its front, but possibly turned by 180°: enough to calibrate a lens.
pub fn find(image: &Image<u8>, settings: &config::Calibrate) -> Result<BoardView, Problem> {
    match &settings.grid {
        Grid::Chessboard => chessboard(image, settings),
        Grid::Charuco(grid) => markers::charuco(image, grid, settings),
        Grid::Aruco(grid) => markers::aruco(image, grid),
    }
}

fn chessboard(image: &Image<u8>, settings: &config::Calibrate) -> Result<BoardView, Problem> {
    let [nx, ny] = settings.inner_corners;
    let Some(mut pixels) = vision::chessboard_corners(image, settings.inner_corners)? else {
        return partial::chessboard(image, None, settings);
    };
    let (nx, ny) = (nx as usize, ny as usize);
    let along = pixels[nx - 1] - pixels[0];
    let across = pixels[nx * (ny - 1)] - pixels[0];
    // With y down, axes that are right-handed on paper have a negative cross product.
    if along.perp(&across) > 0.0 {
        pixels.chunks_mut(nx).for_each(<[_]>::reverse);
    }
    let view = BoardView { board: corner_positions(settings), pixels };
    // Where a part is hidden, what is found whole may reach under what hides it.
    if partial::is_seen_whole(image, &view, settings) {
        return Ok(view);
    }
    partial::chessboard(image, Some(view.pixels), settings)
}

/// Finds the grid, turned the right way by its disc or markers; without either, with its x axis to the right in the picture.
pub fn find_oriented(image: &Image<u8>, settings: &config::Calibrate) -> Result<BoardView, Problem> {
    let mut view = find(image, settings)?;
    if settings.grid != Grid::Chessboard {
        return Ok(view);
    }
    let turned = match settings.disc {
        Disc::None => {
            let pixel_from_board = homography(&view).ok_or(Problem::NoPose)?;
            squares::sides(&pixel_from_board, Point2::origin(), settings.square_m)[0].x < 0.0
        }
        corner => {
            let here = disc_darkness(image, &view, settings, -1.0);
            let there = disc_darkness(image, &view, settings, 1.0);
            let (here, there) = here.zip(there).ok_or(Problem::DiscOutside)?;
            if (here - there).abs() < MIN_DARKNESS {
                return Err(Problem::DiscUnclear { darkness: [here, there] });
            }
            (here > there) != (corner == Disc::NegXNegY)
        }
    };
    if turned {
        view.board.iter_mut().for_each(|at| *at = -*at);
    }
    Ok(view)
}

/// How much darker the margin is at the disc's place than beside it, at the (−x, −y) or (+x, +y) corner by `sign`;
/// `None` where that lies outside the picture.
fn disc_darkness(
    image: &Image<u8>,
    view: &BoardView,
    settings: &config::Calibrate,
    sign: f64,
) -> Option<f64> {
    let pixel_from_board = homography(view)?;
    let [nx, ny] = settings.inner_corners.map(|n| (f64::from(n) - 1.0) / 2.0);
    let spot = |dx: f64, dy: f64| {
        let centre = Point2::new(nx + dx, ny + dy) * (sign * settings.square_m);
        mean_around(image, &pixel_from_board, centre, SPOT_RADIUS * settings.square_m)
    };
    let disc = spot(DISC_OFFSET, DISC_OFFSET)?;
    let white = (spot(DISC_OFFSET, WHITE_OFFSET)? + spot(WHITE_OFFSET, DISC_OFFSET)?) / 2.0;
    Some(1.0 - disc / white.max(1.0))
}

fn mean_around(
    image: &Image<u8>,
    pixel_from_board: &Matrix3<f64>,
    centre: Point2<f64>,
    radius: f64,
) -> Option<f64> {
    let steps = [-1.0, -0.5, 0.0, 0.5, 1.0];
    let (mut sum, mut count) = (0.0, 0.0);
    for (x, y) in steps.iter().flat_map(|x| steps.map(|y| (*x, y))).filter(|(x, y)| x * x + y * y <= 1.0) {
        sum += squares::seen(image, pixel_from_board, centre + Vector2::new(x, y) * radius)?;
        count += 1.0;
    }
    Some(sum / count)
}

fn bilinear(image: &Image<u8>, x: f64, y: f64) -> Option<f64> {
    let (fx, fy) = (x - 0.5, y - 0.5);
    let inside =
        fx >= 0.0 && fy >= 0.0 && fx < image.width() as f64 - 1.0 && fy < image.height() as f64 - 1.0;
    if !inside {
        return None;
    }
    let (x0, y0) = (fx as usize, fy as usize);
    let (ax, ay) = (fx - x0 as f64, fy - y0 as f64);
    let at = |x: usize, y: usize| f64::from(*image.at(x, y));
    let row = |y: usize| at(x0, y) * (1.0 - ax) + at(x0 + 1, y) * ax;
    Some(row(y0) * (1.0 - ay) + row(y0 + 1) * ay)
}

/// Plane to picture by the direct linear transform (Hartley and Zisserman 2004, §4.1); good to a fraction of a square.
pub(super) fn homography(view: &BoardView) -> Option<Matrix3<f64>> {
    let n = view.board.len();
    let unit = view.board.iter().map(|p| p.coords.norm()).fold(0.0, f64::max);
    let centre = view.pixels.iter().map(|p| p.coords).sum::<Vector2<f64>>() / n as f64;
    let size = view.pixels.iter().map(|p| (p.coords - centre).norm()).fold(0.0, f64::max);
    let rows = DMatrix::from_fn(2 * n, 9, |row, column| {
        let (b, p) = (view.board[row / 2] / unit, (view.pixels[row / 2] - centre) / size);
        let b = [b.x, b.y, 1.0];
        match (row % 2, column / 3) {
            (0, 0) | (1, 1) => b[column % 3],
            (0, 2) => -p.x * b[column % 3],
            (1, 2) => -p.y * b[column % 3],
            _ => 0.0,
        }
    });
    let eigen = nalgebra::SymmetricEigen::new(rows.tr_mul(&rows));
    let h = eigen.eigenvectors.column(eigen.eigenvalues.argmin().0).clone_owned();
    let h = Matrix3::from_row_slice(h.as_slice());
    let pixel_from_unit = Matrix3::new(size, 0.0, centre.x, 0.0, size, centre.y, 0.0, 0.0, 1.0);
    let h = pixel_from_unit * h * Matrix3::from_diagonal(&Vector3::new(1.0 / unit, 1.0 / unit, 1.0));
    h.iter().all(|v| v.is_finite()).then_some(h)
}

/// A place on the board in the picture, px.
fn pixel(pixel_from_board: &Matrix3<f64>, at: Point2<f64>) -> Point2<f64> {
    let p = pixel_from_board * Vector3::new(at.x, at.y, 1.0);
    Point2::new(p.x / p.z, p.y / p.z)
}

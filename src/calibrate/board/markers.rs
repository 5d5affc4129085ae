//! Grids that carry markers (Garrido-Jurado et al. 2014): corners are known by the markers' numbers, so that part of the grid may
//! be hidden, and it can neither be turned by 180° nor mistaken for another one.

use super::{corner_positions, homography, pixel};
use crate::calibrate::Problem;
use crate::config::{self, ArucoGrid, CharucoGrid, Grid};
use crate::image::Image;
use crate::vision::{self, BoardView, Marker};
use nalgebra::Point2;
use std::collections::BTreeMap;

/// Corners of the grid that are needed.
const NEEDED: usize = 6;
/// Half the side of the window by which a corner is refined, as a share of what is white around its markers, and at most, px.
const WINDOW: f64 = 0.8;
const MOST_WINDOW: f64 = 8.0;
/// A corner that refining moves by more than this, as a share of the square's side, is another one.
const MOST_MOVED: f64 = 0.15;

/// Corners of a marker by its number, m: top left, top right, bottom right, bottom left as it was printed.
type Places = BTreeMap<u32, [Point2<f64>; 4]>;

/// A square of a side around a point, its corners in a marker's order.
fn square(centre: Point2<f64>, side: f64) -> [Point2<f64>; 4] {
    [[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]
        .map(|[x, y]| centre + nalgebra::Vector2::new(x, y) * side)
}

/// Refuses a grid that cannot be printed, or that its dictionary has too few markers for.
pub(in crate::calibrate) fn check(settings: &config::Calibrate) -> Result<(), Problem> {
    let (dictionary, last) = match &settings.grid {
        Grid::Chessboard => return Ok(()),
        Grid::Charuco(grid) => {
            let (side, marker_side) = (settings.square_m, grid.marker_m);
            if !(marker_side > 0.0 && marker_side < side) {
                let what = format!("markers of {marker_side} m in squares of {side} m");
                return Err(Problem::NotAGrid { what });
            }
            let squares: u32 = settings.inner_corners.iter().map(|n| n + 1).product();
            (&grid.dictionary, grid.first_id.saturating_add(squares / 2 - 1))
        }
        Grid::Aruco(grid) => {
            let config::MarkerBoard { columns, rows, side_m, gap_m, first_id } = grid.board;
            let sound = (1..=100).contains(&columns)
                && (1..=100).contains(&rows)
                && (side_m > 0.0 && side_m < 100.0)
                && (0.0..100.0).contains(&gap_m);
            if !sound {
                let what =
                    format!("{columns} × {rows} markers with sides of {side_m} m and gaps of {gap_m} m");
                return Err(Problem::NotAGrid { what });
            }
            (&grid.dictionary, first_id.saturating_add((columns * rows - 1) as u32))
        }
    };
    vision::marker_cells(dictionary, last)?;
    Ok(())
}

/// Markers in rows: every marker's corners.
pub(super) fn aruco(image: &Image<u8>, grid: &ArucoGrid) -> Result<BoardView, Problem> {
    let config::MarkerBoard { columns, rows, side_m, gap_m, first_id } = grid.board;
    let at = |i: usize, n: usize| (i as f64 - (n as f64 - 1.0) / 2.0) * (side_m + gap_m);
    let centre = |k: usize| Point2::new(at(k % columns, columns), -at(k / columns, rows));
    let places: Places =
        (0..columns * rows).map(|k| (first_id + k as u32, square(centre(k), side_m))).collect();
    let mut view = BoardView { board: Vec::new(), pixels: Vec::new() };
    for (board, marker) in known(&vision::markers(image, &grid.dictionary, None)?, &places) {
        view.board.extend(board);
        view.pixels.extend(marker.corners);
    }
    enough(view, columns * rows * 4)
}

/// The markers that belong to the grid, with their places.
fn known<'a>(seen: &'a [Marker], places: &'a Places) -> Vec<(&'a [Point2<f64>; 4], &'a Marker)> {
    seen.iter().filter_map(|marker| Some((places.get(&marker.id)?, marker))).collect()
}

fn enough(view: BoardView, of: usize) -> Result<BoardView, Problem> {
    let found = view.pixels.len();
    if found < NEEDED { Err(Problem::FewCorners { found, of, needed: NEEDED }) } else { Ok(view) }
}

/// A chessboard with markers in its white squares: the inner corners beside a marker that is seen.
pub(super) fn charuco(
    image: &Image<u8>,
    grid: &CharucoGrid,
    settings: &config::Calibrate,
) -> Result<BoardView, Problem> {
    let (side, marker_side) = (settings.square_m, grid.marker_m);
    let places = charuco_places(grid, settings);
    let seen = vision::markers(image, &grid.dictionary, None)?;
    let seen = known(&seen, &places);
    // Where a corner should be by the markers at it.
    let beside = 0.75 * side;
    let mut expected = BoardView { board: Vec::new(), pixels: Vec::new() };
    let mut white_px = f64::MAX;
    for corner in corner_positions(settings) {
        let near = |board: &[Point2<f64>; 4]| {
            let away = nalgebra::center(&board[0], &board[2]) - corner;
            away.amax() < beside
        };
        let around: Vec<_> = seen.iter().filter(|(board, _)| near(board)).collect();
        if around.is_empty() {
            continue;
        }
        let local = BoardView {
            board: around.iter().flat_map(|(board, _)| **board).collect(),
            pixels: around.iter().flat_map(|(_, marker)| marker.corners).collect(),
        };
        let Some(pixel_from_board) = homography(&local) else { continue };
        let pixel = |at| pixel(&pixel_from_board, at);
        let nearest = local.board.iter().min_by(|a, b| (*a - corner).norm().total_cmp(&(*b - corner).norm()));
        white_px =
            nearest.map_or(white_px, |n| white_px.min((pixel(*n) - pixel(corner)).norm() / 2f64.sqrt()));
        expected.board.push(corner);
        expected.pixels.push(pixel(corner));
    }
    let all = settings.inner_corners.iter().product::<u32>() as usize;
    let expected = enough(expected, all)?;
    let window = (WINDOW * white_px).clamp(2.0, MOST_WINDOW) as i32;
    let refined = vision::refined_corners(image, &expected.pixels, window)?;
    let square_px = white_px * 2.0 * side / (side - marker_side);
    let mut view = BoardView { board: Vec::new(), pixels: Vec::new() };
    for ((board, from), to) in expected.board.iter().zip(&expected.pixels).zip(refined) {
        let within =
            to.x >= 0.0 && to.y >= 0.0 && to.x <= image.width() as f64 && to.y <= image.height() as f64;
        if within && (to - from).norm() < (MOST_MOVED * square_px).max(1.0) {
            view.board.push(*board);
            view.pixels.push(to);
        }
    }
    enough(view, all)
}

/// Markers in the white squares, numbered from the top left on, the top left square black where the count of rows is odd: the
/// order of OpenCV's boards up to version 4.6.
fn charuco_places(grid: &CharucoGrid, settings: &config::Calibrate) -> Places {
    let [columns, rows] = settings.inner_corners.map(|n| n as usize + 1);
    let at = |i: usize, n: usize| (i as f64 - (n as f64 - 1.0) / 2.0) * settings.square_m;
    let squares = (0..rows).rev().flat_map(|j| (0..columns).map(move |i| (i, j)));
    let white = squares.filter(|(i, j)| i % 2 != j % 2);
    let placed = white.enumerate().map(|(k, (i, j))| {
        let centre = Point2::new(at(i, columns), at(j, rows));
        (grid.first_id + k as u32, square(centre, grid.marker_m))
    });
    placed.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};

    const SIZE: (usize, usize) = (640, 480);

    /// A picture of a plane, whose brightness is given by metres, by a homography to it.
    fn drawn(board_from_pixel: &Matrix3<f64>, paper: impl Fn(Point2<f64>) -> f64) -> Image<u8> {
        let parts = [0.125, 0.375, 0.625, 0.875];
        Image::from_fn(SIZE.0, SIZE.1, |x, y| {
            let light = parts.iter().flat_map(|u| parts.map(|v| (*u, v))).map(|(u, v)| {
                let p = board_from_pixel * Vector3::new(x as f64 + u, y as f64 + v, 1.0);
                paper(Point2::new(p.x / p.z, p.y / p.z))
            });
            (255.0 * light.sum::<f64>() / 16.0).round() as u8
        })
    }

    fn pixel_from_board() -> Matrix3<f64> {
        Matrix3::new(900.0, 120.0, 320.0, 60.0, -880.0, 235.0, 0.15, -0.3, 1.0)
    }

    fn marker_light(places: &Places, dictionary: &str) -> impl Fn(Point2<f64>) -> Option<f64> + use<> {
        let markers: Vec<_> = places
            .iter()
            .map(|(id, corners)| (vision::marker_cells(dictionary, *id).unwrap(), *corners))
            .collect();
        move |p| {
            markers.iter().find_map(|(cells, corners)| {
                let across = (cells.len() as f64).sqrt();
                let side = (corners[1] - corners[0]).norm();
                let (u, v) = ((p.x - corners[0].x) / side, (corners[0].y - p.y) / side);
                let inside = (0.0..1.0).contains(&u) && (0.0..1.0).contains(&v);
                inside.then(|| {
                    let cell = (v * across) as usize * across as usize + (u * across) as usize;
                    if cells[cell] { 0.9 } else { 0.1 }
                })
            })
        }
    }

    fn largest_miss(view: &BoardView) -> f64 {
        let miss = |(b, p): (&Point2<f64>, &Point2<f64>)| {
            let e = pixel_from_board() * Vector3::new(b.x, b.y, 1.0);
            (p - Point2::new(e.x / e.z, e.y / e.z)).norm()
        };
        view.board.iter().zip(&view.pixels).map(miss).fold(0.0, f64::max)
    }

    fn charuco_picture(hidden: impl Fn(Point2<f64>) -> bool) -> (Image<u8>, config::Calibrate) {
        let grid = CharucoGrid { dictionary: "6x6_250".into(), marker_m: 0.03, first_id: 0 };
        let settings = config::Calibrate {
            grid: Grid::Charuco(grid.clone()),
            inner_corners: [6, 4],
            square_m: 0.05,
            ..Default::default()
        };
        let marker = marker_light(&charuco_places(&grid, &settings), "6x6_250");
        let from_pixel = pixel_from_board().try_inverse().unwrap();
        let picture = drawn(&from_pixel, |p| {
            let (u, v) = (p.x / 0.05 + 3.5, p.y / 0.05 + 2.5);
            if hidden(p) || !(0.0..7.0).contains(&u) || !(0.0..5.0).contains(&v) {
                return 0.75;
            }
            let black = u as usize % 2 == v as usize % 2;
            marker(p).unwrap_or(if black { 0.1 } else { 0.9 })
        });
        (picture, settings)
    }

    #[test]
    fn a_chessboard_with_markers_is_found_whole_and_partly_hidden() {
        let (picture, settings) = charuco_picture(|_| false);
        let whole = super::super::find_oriented(&picture, &settings).unwrap();
        assert_eq!(whole.pixels.len(), 24);
        assert!(largest_miss(&whole) < 0.2, "{}", largest_miss(&whole));
        let (picture, settings) = charuco_picture(|p| p.x > 0.01);
        let part = super::super::find_oriented(&picture, &settings).unwrap();
        assert!((8..16).contains(&part.pixels.len()), "{}", part.pixels.len());
        assert!(part.board.iter().all(|b| b.x < 0.03));
        let (picture, settings) = charuco_picture(|p| p.x > -0.11);
        let hidden = super::super::find_oriented(&picture, &settings);
        assert!(matches!(hidden, Err(Problem::FewCorners { of: 24, .. })), "{hidden:?}");
    }

    #[test]
    fn rows_of_markers_are_found_partly_hidden() {
        let board = config::MarkerBoard { columns: 4, rows: 3, side_m: 0.05, gap_m: 0.02, first_id: 3 };
        let grid = ArucoGrid { dictionary: "5x5_100".into(), board };
        let at = |i: usize, n: usize| (i as f64 - (n as f64 - 1.0) / 2.0) * 0.07;
        let places: Places =
            (0..12).map(|k| (3 + k as u32, square(Point2::new(at(k % 4, 4), -at(k / 4, 3)), 0.05))).collect();
        let marker = marker_light(&places, "5x5_100");
        let from_pixel = pixel_from_board().try_inverse().unwrap();
        let picture =
            drawn(&from_pixel, |p| if p.x > 0.05 && p.y > 0.0 { 0.5 } else { marker(p).unwrap_or(0.9) });
        let settings = config::Calibrate { grid: Grid::Aruco(grid), ..Default::default() };
        let view = super::super::find_oriented(&picture, &settings).unwrap();
        assert_eq!(view.pixels.len(), 32);
        assert!(largest_miss(&view) < 0.6, "{}", largest_miss(&view));
    }
}

//! A chessboard of which a part is hidden: corners that hang together are laid onto the board where squares and margin fit best,
//! and joined by every other one that is seen.

use super::squares::{BESIDE, BETWEEN, REACH, fit, is_corner, sides};
use super::{corner_positions, homography, pixel};
use crate::calibrate::Problem;
use crate::config;
use crate::image::Image;
use crate::vision::{self, BoardView, CornerRows};
use nalgebra::{DMatrix, Point2, Vector2};
use std::collections::BTreeMap;

/// Corners that are needed to lay the part onto the board, and in all.
const SEED: usize = 6;
const NEEDED: usize = 9;
/// Share of squares and margin that must look as they should: what is hidden looks right half of the time.
const LEAST_FIT: f64 = 0.7;
/// By so much more than anywhere else.
const LEAD: f64 = 0.05;
/// Corners more or fewer that may be false ones.
const FALSE: usize = 2;
/// Sides of squares, of the way between corners that were found beside each other: one between them may be left out.
const SHARES: [f64; 2] = [1.0, 0.5];
/// A corner moves less than this from where the others expect it, in squares, or a pixel.
const MOST_MOVED: f64 = 0.15;
/// The same where only its neighbours expect it, and the most rows and columns from the first one.
const MOST_GROWN: f64 = 0.25;
const MOST_ROWS: i64 = 100;
/// Turns of finding all corners from those known.
const TURNS: usize = 3;
/// In a window half as wide a corner is where it was, px: nothing else reaches into the window.
const STAYS_PX: f64 = 0.25;
/// It is off its place by as much as the others around it, px.
const MOST_ODD_PX: f64 = 0.5;
/// Half the side of the window in which a corner's gradients count, in squares, and at most, px.
const WINDOW: f64 = 0.3;
const MOST_WINDOW: f64 = 8.0;

/// A corner by its column and row in what was found.
type Corner = ([i64; 2], Point2<f64>);

/// Whether squares are seen on all sides of each corner in the picture.
pub(super) fn is_seen_whole(image: &Image<u8>, view: &BoardView, settings: &config::Calibrate) -> bool {
    homography(view).is_some_and(|pixel_from_board| {
        let four_squares = |(at, pixel): (&Point2<f64>, &Point2<f64>)| {
            is_corner(image, *pixel, sides(&pixel_from_board, *at, settings.square_m), &BETWEEN)
        };
        view.board.iter().zip(&view.pixels).all(|pair| four_squares(pair).unwrap_or(true))
    })
}

/// Finds it, possibly turned by 180°. `whole`: corners of a board found whole, of which some are under what hides it.
pub(super) fn chessboard(
    image: &Image<u8>,
    whole: Option<Vec<Point2<f64>>>,
    settings: &config::Calibrate,
) -> Result<BoardView, Problem> {
    let not_found = || Problem::GridNotFound { inner: settings.inner_corners };
    let whole = whole.map(|pixels| CornerRows { columns: settings.inner_corners[0] as usize, pixels });
    let grids = whole.into_iter().chain(vision::chessboard_parts(image)?);
    let part = grids.map(|found| connected(image, &found));
    let part = part.max_by_key(Vec::len).filter(|p| p.len() >= SEED).ok_or_else(not_found)?;
    let placed: Vec<Placed> = placements(&part, settings)
        .filter_map(|view| Some(Placed { fit: fit(image, &homography(&view)?, settings)?, view }))
        .collect();
    let best = chosen(&placed, settings).ok_or_else(not_found)?;
    joined(image, best.view.clone(), settings).ok_or_else(not_found)
}

/// Corners as they may lie on the board.
struct Placed {
    view: BoardView,
    /// Share of squares and margin that look as they should.
    fit: f64,
}

/// The one that squares and margin speak for; or that most corners speak for, if these are half of all: corners in all outer rows and
/// columns fit in one place alone.
fn chosen<'a>(placed: &'a [Placed], settings: &config::Calibrate) -> Option<&'a Placed> {
    let most = placed.iter().map(|p| p.view.board.len()).max()?;
    let nearly = placed.iter().filter(|p| p.view.board.len() + FALSE >= most);
    let best = nearly.max_by(|a, b| a.fit.total_cmp(&b.fit))?;
    // The same turned by 180° is no other one.
    let is_same = |p: &&Placed| {
        let off = |sign: f64| {
            let pairs = p.view.board.iter().zip(&best.view.board);
            pairs.map(|(a, b)| (a - b * sign).norm()).fold(0.0, f64::max)
        };
        p.view.pixels == best.view.pixels && off(1.0).min(off(-1.0)) < 0.1 * settings.square_m
    };
    let others = || placed.iter().filter(|p| !is_same(p));
    let is_alone = others().all(|p| p.view.board.len() + FALSE < best.view.board.len());
    let half = 2 * best.view.board.len() >= corner_positions(settings).len();
    let fits_best = others().all(|p| best.fit >= p.fit + LEAD);
    let fits_as_well = others().all(|p| p.fit < best.fit + LEAD);
    (is_alone && half && fits_as_well || best.fit >= LEAST_FIT && fits_best).then_some(best)
}

/// The most corners that hang together, grown from one by the sides of the squares beside it, numbered as seen from the front. What
/// was found reaches to the board's border and under what covers it, and serves for starts alone.
fn connected(image: &Image<u8>, found: &CornerRows) -> Vec<Corner> {
    let columns = found.columns;
    let rows = found.pixels.len() / columns;
    let at = |i: usize, j: usize| found.pixels[j * columns + i];
    let mut most: Vec<Corner> = Vec::new();
    for k in 0..rows * columns {
        let (i, j) = (k % columns, k / columns);
        let beside =
            |k: usize, n: usize| [k.checked_sub(1), (k + 1 < n).then_some(k + 1)].into_iter().flatten();
        for (side_i, side_j) in beside(i, columns).flat_map(|a| beside(j, rows).map(move |b| (a, b))) {
            let way = [at(side_i, j) - at(i, j), at(i, side_j) - at(i, j)];
            let near = 0.5 * way[0].norm().min(way[1].norm());
            if most.iter().any(|(_, p)| (p - at(i, j)).norm() < near) {
                continue;
            }
            for share in SHARES.iter().flat_map(|a| SHARES.map(|b| [*a, b])) {
                let grown = grown(image, at(i, j), [way[0] * share[0], way[1] * share[1]]);
                if grown.len() > most.len() {
                    most = grown;
                }
            }
        }
    }
    most
}

/// Corners reached from one, whose neighbours are `sides` away, px.
fn grown(image: &Image<u8>, start: Point2<f64>, sides: [Vector2<f64>; 2]) -> Vec<Corner> {
    if !is_corner(image, start, sides, &REACH).unwrap_or(false) {
        return Vec::new();
    }
    // With y down, axes that are right-handed on paper have a negative cross product.
    let mirrored = if sides[0].perp(&sides[1]) > 0.0 { -1 } else { 1 };
    let mut known = BTreeMap::from([([0i64, 0i64], (start, sides))]);
    let mut from = vec![[0, 0]];
    while let Some(here) = from.pop() {
        let (pixel, sides) = known[&here];
        for (axis, sign) in [(0, 1), (0, -1), (1, 1), (1, -1)] {
            let mut next = here;
            next[axis] += sign;
            if known.contains_key(&next) || next.iter().any(|n| n.abs() > MOST_ROWS) {
                continue;
            }
            let expected = pixel + sides[axis] * sign as f64;
            let side = sides[0].norm().min(sides[1].norm());
            let Ok(moved) = vision::refined_corners(image, &[expected], window(side)) else { continue };
            let mut there = sides;
            there[axis] = (moved[0] - pixel) * sign as f64;
            let seen = is_corner(image, moved[0], there, &BESIDE).unwrap_or(false);
            if seen && (moved[0] - expected).norm() < MOST_GROWN * side {
                known.insert(next, (moved[0], there));
                from.push(next);
            }
        }
    }
    known.into_iter().map(|([i, j], (pixel, _))| ([mirrored * i, j], pixel)).collect()
}

/// Half a window that holds no second corner, px.
fn window(side_px: f64) -> i32 {
    (WINDOW * side_px).clamp(1.0, MOST_WINDOW) as i32
}

/// How corners may lie on the board, seen from the front; those that would lie beside it are none.
fn placements(part: &[Corner], settings: &config::Calibrate) -> impl Iterator<Item = BoardView> {
    let all = corner_positions(settings);
    let [nx, ny] = settings.inner_corners.map(i64::from);
    let turns = [[1, 0, 0, 1], [0, -1, 1, 0], [-1, 0, 0, -1], [0, 1, -1, 0]];
    // By where the first one's column and row come to lie.
    let reach = nx.max(ny);
    let shifts = (-2 * reach..=2 * reach).flat_map(move |x| (-2 * reach..=2 * reach).map(move |y| [x, y]));
    shifts.flat_map(move |to| turns.map(|turn| (to, turn))).filter_map(move |([x, y], [a, b, c, d])| {
        let [first_i, first_j] = part.first()?.0;
        let place = |([i, j], pixel): &Corner| {
            let (i, j) = (i - first_i, j - first_j);
            let (x, y) = (x + a * i + b * j, y + c * i + d * j);
            let inside = (0..nx).contains(&x) && (0..ny).contains(&y);
            inside.then(|| (all[(y * nx + x) as usize], *pixel))
        };
        let (board, pixels): (Vec<_>, Vec<_>) = part.iter().filter_map(place).unzip();
        (5 * board.len() >= 4 * part.len()).then_some(BoardView { board, pixels })
    })
}

/// All corners that are seen, where the gradients around them ask for.
fn joined(image: &Image<u8>, mut view: BoardView, settings: &config::Calibrate) -> Option<BoardView> {
    // Once more from more corners: the lens may bend the board.
    for _ in 0..TURNS {
        let pixel_from_board = homography(&view)?;
        let board = corner_positions(settings);
        let expected: Vec<Point2<f64>> = board.iter().map(|at| pixel(&pixel_from_board, *at)).collect();
        let sides: Vec<[Vector2<f64>; 2]> =
            board.iter().map(|at| sides(&pixel_from_board, *at, settings.square_m)).collect();
        let shorter = |[u, v]: &[Vector2<f64>; 2]| u.norm().min(v.norm());
        let window = window(sides.iter().map(shorter).fold(f64::INFINITY, f64::min));
        let moved = vision::refined_corners(image, &expected, window).ok()?;
        let within = vision::refined_corners(image, &moved, (window / 2).max(1)).ok()?;
        let is_seen = |k: &usize| {
            (within[*k] - moved[*k]).norm() < STAYS_PX
                && (moved[*k] - expected[*k]).norm() < (MOST_MOVED * shorter(&sides[*k])).max(1.0)
                && is_corner(image, moved[*k], sides[*k], &BESIDE).unwrap_or(false)
        };
        let all = (0..board.len()).filter(is_seen).collect();
        let all = agreeing(all, &board, |k| moved[k] - expected[k]);
        view = BoardView {
            board: all.iter().map(|k| board[*k]).collect(),
            pixels: all.iter().map(|k| moved[*k]).collect(),
        };
        if view.board.len() < NEEDED {
            return None;
        }
    }
    Some(view)
}

/// The corners that are off as others are: a lens moves them by nearly a cubic of their places (its first radial term is one), what
/// hides a part of a square moves one corner.
fn agreeing(
    mut corners: Vec<usize>,
    board: &[Point2<f64>],
    off: impl Fn(usize) -> Vector2<f64>,
) -> Vec<usize> {
    let unit = board.iter().map(|p| p.coords.amax()).fold(f64::MIN_POSITIVE, f64::max);
    let powers: Vec<[i32; 2]> = (0..=3).flat_map(|n| (0..=n).map(move |k| [n - k, k])).collect();
    while corners.len() >= 2 * powers.len() {
        let terms = DMatrix::from_fn(corners.len(), powers.len(), |row, term| {
            let at = board[corners[row]] / unit;
            at.x.powi(powers[term][0]) * at.y.powi(powers[term][1])
        });
        let seen = DMatrix::from_fn(corners.len(), 2, |row, axis| off(corners[row])[axis]);
        let Ok(cubic) = terms.clone().svd(true, true).solve(&seen, 1e-9) else { break };
        let odd = seen - terms * cubic;
        let worst = (0..corners.len()).max_by(|a, b| odd.row(*a).norm().total_cmp(&odd.row(*b).norm()));
        match worst.filter(|k| odd.row(*k).norm() > MOST_ODD_PX) {
            Some(k) => drop(corners.remove(k)),
            None => break,
        }
    }
    corners
}

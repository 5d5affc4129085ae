//! The printed grid's white squares: paper of one reflectance, so that in one photograph they differ by the light on them and by
//! the lens alone.

use super::{Cell, Field, HELD, radius};
use crate::calibrate::{self, board};
use crate::config;
use crate::image::CodeImage;
use crate::response::Response;
use crate::response::samples::median;
use nalgebra::{Point2, Vector2};

/// Share of a square's sides that is read, in its middle: its edges are blurred.
const READ: f64 = 0.6;
/// Readings along each side of it.
const READINGS: usize = 12;
/// Shortest side of a square that is read, px.
const SHORTEST_PX: f64 = 8.0;
/// White squares of a photograph that are needed.
const NEEDED: usize = 8;

/// The white squares in a photograph, the field's cells; `None` where the grid is not seen, or hardly any square well exposed.
pub(super) fn field(codes: &CodeImage, response: &Response, settings: &config::Calibrate) -> Option<Field> {
    let view = board::find(&calibrate::grey(codes), settings).ok()?;
    let [nx, ny] = settings.inner_corners.map(|n| n as usize);
    if view.pixels.len() < nx * ny {
        return None;
    }
    let inner = |i: usize, j: usize| view.pixels[j * nx + i];
    let beyond = |near: Point2<f64>, next: Point2<f64>| near + (near - next);
    // Of the squares' corners, the outermost ones included, those along a row of inner corners, then all.
    let along = |i: usize, j: usize| match i {
        0 => beyond(inner(0, j), inner(1, j)),
        i if i == nx + 1 => beyond(inner(nx - 1, j), inner(nx - 2, j)),
        i => inner(i - 1, j),
    };
    let corner = |i: usize, j: usize| match j {
        0 => beyond(along(i, 0), along(i, 1)),
        j if j == ny + 1 => beyond(along(i, ny - 1), along(i, ny - 2)),
        j => along(i, j - 1),
    };
    let mut squares: [Vec<Square>; 2] = [Vec::new(), Vec::new()];
    for (i, j) in (0..=ny).flat_map(|j| (0..=nx).map(move |i| (i, j))) {
        let corners = [corner(i, j), corner(i + 1, j), corner(i, j + 1), corner(i + 1, j + 1)];
        if let Some((middle, exposure)) = read(codes, response, &corners) {
            let at = [(2 * i) as f64 / nx as f64 - 1.0, (2 * j) as f64 / ny as f64 - 1.0];
            squares[(i + j) % 2].push(Square { at, middle, exposure });
        }
    }
    let green = |squares: &[Square]| median(squares.iter().map(|s| s.exposure[1])).unwrap_or(0.0);
    let white = squares.into_iter().max_by(|a, b| green(a).total_cmp(&green(b)))?;
    if white.len() < NEEDED {
        return None;
    }
    let usual = [0, 1, 2].map(|k: usize| median(white.iter().map(|s| s.exposure[k])).unwrap_or(1.0));
    let size = codes.size();
    let cell = |s: Square| Cell {
        at: s.at,
        r: radius([s.middle.x, s.middle.y], size),
        exposure: (0..3).map(|k| s.exposure[k] / usual[k]).sum::<f64>() / 3.0,
    };
    Some(Field(white.into_iter().map(cell).collect()))
}

struct Square {
    /// On the grid, from −1 to 1 along its sides.
    at: [f64; 2],
    /// In the picture, px.
    middle: Point2<f64>,
    exposure: [f64; 3],
}

/// Middle and mean exposure of a square; `None` where it is small, badly exposed or beyond the picture.
fn read(
    codes: &CodeImage,
    response: &Response,
    [a, b, c, d]: &[Point2<f64>; 4],
) -> Option<(Point2<f64>, [f64; 3])> {
    let sides: [Vector2<f64>; 4] = [b - a, d - c, c - a, d - b];
    if sides.iter().any(|s| s.norm() < SHORTEST_PX) {
        return None;
    }
    let within = |k: usize| 0.5 + READ * ((k as f64 + 0.5) / READINGS as f64 - 0.5);
    let point = |s: f64, t: f64| {
        let (low, high) = (a.coords.lerp(&b.coords, s), c.coords.lerp(&d.coords, s));
        low.lerp(&high, t)
    };
    let mut sum = [0.0; 3];
    for (s, t) in (0..READINGS * READINGS).map(|k| (within(k % READINGS), within(k / READINGS))) {
        let p = point(s, t);
        if p.x < 0.0 || p.y < 0.0 || p.x >= codes.width() as f64 || p.y >= codes.height() as f64 {
            return None;
        }
        let code = codes.at(p.x as usize, p.y as usize).0;
        if code.iter().any(|c| !HELD.contains(c)) {
            return None;
        }
        let exposure = response.exposure_of(code);
        (0..3).for_each(|k| sum[k] += f64::from(exposure[k]));
    }
    let middle = Point2::from(point(0.5, 0.5));
    Some((middle, sum.map(|s| s / (READINGS * READINGS) as f64)))
}

#[cfg(test)]
mod tests {
    use super::super::Vignetting;
    use super::*;
    use crate::image::{Code, Image};
    use crate::response::Problem;
    use nalgebra::{Rotation3, Vector3};
    use rand::{Rng, SeedableRng, rngs::SmallRng};

    const SIZE: (usize, usize) = (640, 480);
    const FOCAL: f64 = 600.0;

    /// The grid at a place in front of the camera, turned, through a lens; lit from one side, brighter in its middle than a
    /// slope has it.
    fn shoot(lens: &Vignetting, at: [f64; 3], turn: [f64; 3], seed: u64) -> CodeImage {
        let grid = config::Calibrate::default();
        let [nx, ny] = grid.inner_corners.map(f64::from);
        let grid_from_camera = Rotation3::new(Vector3::from(turn)).inverse();
        let at = Vector3::from(at);
        let response = Response::srgb();
        let mut random = SmallRng::seed_from_u64(seed);
        let paper = |x: f64, y: f64| {
            let ray = Vector3::new((x - 320.0) / FOCAL, (y - 240.0) / FOCAL, 1.0);
            let (from, along) = (grid_from_camera * -at, grid_from_camera * ray);
            let hit = from - along * (from.z / along.z);
            let (u, v) = (hit.x / grid.square_m, hit.y / grid.square_m);
            let light = 1.0 + 0.03 * u - 0.02 * v - 0.002 * (u * u + v * v);
            let (i, j) = (u + 0.5 * (nx + 1.0), v + 0.5 * (ny + 1.0));
            let squares = (0.0..nx + 1.0).contains(&i) && (0.0..ny + 1.0).contains(&j);
            let margin = (-0.5..nx + 1.5).contains(&i) && (-0.5..ny + 1.5).contains(&j);
            let black = squares && (i.floor() + j.floor()) % 2.0 == 0.0;
            light
                * if black {
                    0.03
                } else if margin {
                    0.5
                } else {
                    0.15
                }
        };
        Image::from_fn(SIZE.0, SIZE.1, |x, y| {
            let parts = [0.125, 0.375, 0.625, 0.875];
            let mean =
                parts.iter().flat_map(|s| parts.map(|t| paper(x as f64 + s, y as f64 + t))).sum::<f64>()
                    / 16.0;
            let seen = mean as f32 * lens.of_pixel(x, y, SIZE).0;
            let code = response.code_of([seen, 0.8 * seen, 0.6 * seen]);
            Code(
                code.map(|c| {
                    ((c * 255.0 + random.random_range(-1.5..1.5_f32)).round() / 255.0).clamp(0.0, 1.0)
                }),
            )
        })
    }

    fn everywhere(lens: &Vignetting) -> Vec<CodeImage> {
        let places = [
            ([-0.26, -0.2, 1.0], [0.1, 0.2, 3.1]),
            ([0.26, -0.2, 1.0], [-0.2, 0.1, 0.1]),
            ([-0.26, 0.2, 1.0], [0.2, -0.2, 0.1]),
            ([0.26, 0.2, 1.0], [0.3, 0.1, -0.1]),
            ([0.0, 0.0, 0.8], [0.0, 0.4, 0.3]),
            ([0.1, -0.1, 0.9], [0.4, 0.0, 0.5]),
            ([-0.2, 0.0, 1.0], [-0.3, 0.3, 1.5]),
        ];
        places.iter().enumerate().map(|(k, (at, turn))| shoot(lens, *at, *turn, k as u64)).collect()
    }

    #[test]
    fn paper_seen_all_over_the_picture_gives_the_lens_back() {
        for coefficients in [[0.0, 0.0, 0.0], [-0.3, 0.0, 0.0], [-0.45, 0.15, -0.05]] {
            let lens = Vignetting::given(coefficients).unwrap();
            let found =
                Vignetting::estimate(&everywhere(&lens), &Response::srgb(), &config::Calibrate::default())
                    .unwrap();
            for r in [0.3, 0.6, 0.8, 1.0] {
                let (off, sigma) = (found.at(r) - lens.at(r), found.sigma(r));
                assert!(
                    off.abs() < 0.02 && off.abs() < 3.0 * sigma,
                    "{coefficients:?} at {r}: {off} ± {sigma}"
                );
            }
        }
    }

    #[test]
    fn paper_in_the_middle_alone_leaves_the_corners_open() {
        let lens = Vignetting::given([-0.3, 0.0, 0.0]).unwrap();
        let middle: Vec<CodeImage> =
            (0..4).map(|k| shoot(&lens, [0.0, 0.0, 1.2], [0.1 * f64::from(k), 0.2, 0.0], k as u64)).collect();
        let grid = config::Calibrate::default();
        let refused = Vignetting::estimate(&middle, &Response::srgb(), &grid);
        assert!(
            matches!(refused, Err(Problem::VignettingOpen { photographs: 4, sigma, .. }) if sigma > 0.02),
            "{refused:?}"
        );
        let refused = Vignetting::estimate(&[], &Response::srgb(), &grid);
        assert!(matches!(refused, Err(Problem::VignettingOpen { photographs: 0, .. })), "{refused:?}");
    }

    #[test]
    fn a_grid_partly_hidden_is_no_field() {
        let (lens, grid) = (Vignetting::given([0.0; 3]).unwrap(), config::Calibrate::default());
        let whole = shoot(&lens, [0.0, 0.0, 0.9], [0.3, 0.1, 0.0], 0);
        let hidden = |x: usize, y: usize| (x as f64 - 330.0).hypot(y as f64 - 240.0) < 50.0;
        let covered =
            Image::from_fn(
                SIZE.0,
                SIZE.1,
                |x, y| if hidden(x, y) { Code([0.4; 3]) } else { *whole.at(x, y) },
            );
        let seen = board::find(&calibrate::grey(&covered), &grid).unwrap().pixels.len();
        assert!((20..35).contains(&seen), "{seen}");
        assert!(field(&whole, &Response::srgb(), &grid).is_some());
        assert!(field(&covered, &Response::srgb(), &grid).is_none());
    }
}

//! Vignetting: how much less light the lens lets through to the picture's corners.
//!
//! V(r) = 1 + a r² + b r⁴ + c r⁶ with r the distance from the middle of the picture over half its diagonal (the usual
//! radial polynomial; Goldman, *Vignette and Exposure Calibration and Compensation*, PAMI 2010). Fitted to a flat field:
//! photographs of a surface of even brightness. Light that falls off to one side of it does no harm, since it has no part
//! in what is even in r. Or estimated from [`paper`] that is seen all over the picture in several photographs.

mod paper;

use super::samples::median;
use super::{Problem, Response};
use crate::config;
use crate::exposure::Rows;
use crate::image::CodeImage;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Cells along each side of the picture that are averaged: dust and grain go, the fall-off stays.
const CELLS: usize = 48;
/// Codes within which a cell must lie whole.
const HELD: std::ops::Range<f32> = 0.05..0.96;
/// Least share of the cells that must be well exposed.
const NEEDED_SHARE: f64 = 0.7;
/// What a lens can do; beyond it the flat field was none, or the coefficients are mistaken.
const BELIEVED: std::ops::RangeInclusive<f64> = 0.05..=1.5;
/// Rounds of weighting outliers down and of the fields' light.
const ROUNDS: usize = 8;
/// How far from 0 a lens' coefficients usually are: what holds those that nothing else does.
const USUAL_COEFFICIENT: f64 = 0.5;
/// Largest standard deviation of the light in the corners with which an estimate is believed.
const MAX_SIGMA: f64 = 0.02;

/// Fall-off of a lens at one aperture and focal length.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Vignetting {
    /// a, b, c.
    pub coefficients: [f64; 3],
    /// Their covariance; 0 where they were given.
    pub covariance: [[f64; 3]; 3],
}

impl Vignetting {
    /// Of coefficients that are known; those of no lens are refused.
    pub fn given(coefficients: [f64; 3]) -> Result<Self, Problem> {
        Self { coefficients, covariance: [[0.0; 3]; 3] }.believed()
    }

    /// From flat fields of one lens, whole pictures each.
    pub fn fit(flats: &[&dyn Rows], response: &Response) -> Result<Self, Problem> {
        let fields = flats.iter().map(|flat| Field::new(*flat, response)).collect::<Result<Vec<_>, _>>()?;
        solve(&fields, false).ok_or(Problem::NoFlatField { held: 0.0, needed: NEEDED_SHARE })?.believed()
    }

    /// From photographs in which the printed grid is seen in different places: its white paper shows how much of the light
    /// arrives there. Refused where the paper leaves the corners open; photographs without the grid are passed over.
    pub fn estimate(
        photographs: &[CodeImage],
        response: &Response,
        grid: &config::Calibrate,
    ) -> Result<Self, Problem> {
        let fields: Vec<Field> =
            photographs.par_iter().filter_map(|codes| paper::field(codes, response, grid)).collect();
        let open = |sigma| Problem::VignettingOpen { photographs: fields.len(), sigma, limit: MAX_SIGMA };
        let found = solve(&fields, true).ok_or(open(USUAL_COEFFICIENT * 3f64.sqrt()))?;
        let sigma = found.sigma(1.0);
        if sigma.is_nan() || sigma > MAX_SIGMA { Err(open(sigma)) } else { found.believed() }
    }

    fn believed(self) -> Result<Self, Problem> {
        let wrong = (0..=100).map(|i| self.at(f64::from(i) / 100.0)).find(|v| !BELIEVED.contains(v));
        wrong.map_or(Ok(self), |share| Err(Problem::NoLens { share }))
    }

    /// V at r.
    pub fn at(&self, r: f64) -> f64 {
        1.0 + Vector3::from(self.coefficients).dot(&powers(r))
    }

    /// Standard deviation of V at r.
    pub fn sigma(&self, r: f64) -> f64 {
        self.variance(r).sqrt()
    }

    /// Variance of V at r.
    fn variance(&self, r: f64) -> f64 {
        let p = powers(r);
        p.dot(&(Matrix3::from(self.covariance) * p))
    }

    /// V and its variance at the pixel in column x, row y.
    pub fn of_pixel(&self, x: usize, y: usize, size: (usize, usize)) -> (f32, f32) {
        let r = radius([x as f64 + 0.5, y as f64 + 0.5], size);
        (self.at(r) as f32, self.variance(r) as f32)
    }
}

fn powers(r: f64) -> Vector3<f64> {
    let r2 = r * r;
    Vector3::new(r2, r2 * r2, r2 * r2 * r2)
}

/// Distance from the middle over half the diagonal.
fn radius([x, y]: [f64; 2], (width, height): (usize, usize)) -> f64 {
    let (w, h) = (width as f64, height as f64);
    (2.0 * x - w).hypot(2.0 * y - h) / w.hypot(h)
}

/// One cell of a flat field.
struct Cell {
    /// Place on the surface: of a flat field that fills the picture from its middle, in half diagonals.
    at: [f64; 2],
    r: f64,
    exposure: f64,
}

impl Cell {
    /// What brightness and slope are multiplied with.
    fn plane(&self) -> Vector3<f64> {
        Vector3::new(1.0, self.at[0], self.at[1])
    }

    /// What the light's curvature is multiplied with.
    fn bend(&self) -> Vector3<f64> {
        let [u, v] = self.at;
        Vector3::new(u * u, u * v, v * v)
    }
}

/// A surface of even brightness in one photograph.
struct Field(Vec<Cell>);

impl Field {
    /// Means over cells and channels; each channel against its own median, so that the light's colour is of no matter.
    fn new(flat: &dyn Rows, response: &Response) -> Result<Self, Problem> {
        let (width, height) = flat.size();
        let (w, h) = ((width / CELLS).max(1), (height / CELLS).max(1));
        let mut cells: Vec<([f64; 2], [f64; 3])> = Vec::new();
        let mut all = 0;
        for y in (0..(height + 1).saturating_sub(h)).step_by(h) {
            let band = flat.rows(y..y + h).map_err(|e| Problem::Read { why: e.to_string() })?;
            for x in (0..(width + 1).saturating_sub(w)).step_by(w) {
                all += 1;
                let codes =
                    || (0..h).flat_map(|v| (x..x + w).map(move |u| (u, v))).map(|(u, v)| band.at(u, v).0);
                if codes().any(|c| c.iter().any(|c| !HELD.contains(c))) {
                    continue;
                }
                let sum = codes().map(|c| response.exposure_of(c).map(f64::from));
                let sum = sum.fold([0.0; 3], |a, b| std::array::from_fn(|k| a[k] + b[k]));
                let middle = [x as f64 + 0.5 * w as f64, y as f64 + 0.5 * h as f64];
                cells.push((middle, sum.map(|s| s / (w * h) as f64)));
            }
        }
        let held = cells.len() as f64 / f64::from(all.max(1));
        if held < NEEDED_SHARE {
            return Err(Problem::NoFlatField { held, needed: NEEDED_SHARE });
        }
        let usual = [0, 1, 2].map(|k: usize| median(cells.iter().map(|c| c.1[k])).unwrap_or(1.0));
        let half = 0.5 * (width as f64).hypot(height as f64);
        let cell = |([x, y], e): ([f64; 2], [f64; 3])| Cell {
            at: [(x - 0.5 * width as f64) / half, (y - 0.5 * height as f64) / half],
            r: radius([x, y], (width, height)),
            exposure: (0..3).map(|k| e[k] / usual[k]).sum::<f64>() / 3.0,
        };
        Ok(Self(cells.into_iter().map(cell).collect()))
    }
}

/// Least squares over a, b, c, and of each field its brightness and slope along its sides, by which it is divided for the next
/// round; where it is `curved`, over a curvature of the light, too, that all fields have in common. Outliers are weighted down.
fn solve(fields: &[Field], curved: bool) -> Option<Vignetting> {
    let mut light = vec![Vector3::new(1.0, 0.0, 0.0); fields.len()];
    let mut curvature = Vector3::<f64>::zeros();
    let of_light = if curved { 6 } else { 3 };
    let unknowns = of_light + 3 * fields.len();
    let mut solution = DVector::<f64>::zeros(unknowns);
    let (mut usual, mut inverse, mut count) = (f64::INFINITY, None, 0.0);
    for _ in 0..ROUNDS {
        let row = |j: usize, cell: &Cell| {
            let mut row = DVector::<f64>::zeros(unknowns);
            row.fixed_rows_mut::<3>(0).copy_from(&powers(cell.r));
            if curved {
                row.fixed_rows_mut::<3>(3).copy_from(&cell.bend());
            }
            row.fixed_rows_mut::<3>(of_light + 3 * j).copy_from(&cell.plane());
            row
        };
        let mut normal = DMatrix::<f64>::zeros(unknowns, unknowns);
        let prior = (usual.min(0.1) / USUAL_COEFFICIENT).powi(2);
        (0..of_light).for_each(|k| normal[(k, k)] = prior);
        let mut right = DVector::<f64>::zeros(unknowns);
        let mut residuals = Vec::new();
        count = 0.0;
        for (j, cell) in fields.iter().enumerate().flat_map(|(j, f)| f.0.iter().map(move |c| (j, c))) {
            let falling = light[j].dot(&cell.plane()) * (1.0 + curvature.dot(&cell.bend()));
            let (row, value) = (row(j, cell), cell.exposure / falling - 1.0);
            let weight = 1.0 / (1.0 + ((value - row.dot(&solution)) / (3.0 * usual)).powi(2));
            normal.ger(weight, &row, &row, 1.0);
            right.axpy(weight * value, &row, 1.0);
            residuals.push((row, value));
            count += weight;
        }
        let factor = normal.cholesky()?;
        solution = factor.solve(&right);
        usual = 1.4826 * median(residuals.iter().map(|(row, v)| (v - row.dot(&solution)).abs()))?.max(1e-9);
        inverse = Some(factor.inverse());
        if curved {
            let mut more = solution.fixed_rows_mut::<3>(3);
            curvature += &more;
            more.fill(0.0);
        }
        for (j, light) in light.iter_mut().enumerate() {
            let mut more = solution.fixed_rows_mut::<3>(of_light + 3 * j);
            *light += light[0] * &more;
            more.fill(0.0);
        }
    }
    let inverse = inverse?;
    let degrees = (count / (count - unknowns as f64).max(1.0)) * usual * usual;
    let covariance = std::array::from_fn(|j| std::array::from_fn(|i| inverse[(i, j)] * degrees));
    Some(Vignetting { coefficients: [solution[0], solution[1], solution[2]], covariance })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exposure::Frame;
    use crate::image::{Code, CodeImage, Image};
    use crate::{config, merge};
    use proptest::prelude::*;
    use rand::{Rng, SeedableRng, rngs::SmallRng};

    const SIZE: (usize, usize) = (320, 240);

    /// A picture of `light` through a lens, stored in 8 bits after dithering.
    fn shoot(lens: &Vignetting, exposure: f32, light: impl Fn(usize, usize) -> f32) -> CodeImage {
        let mut random = SmallRng::seed_from_u64(1);
        let response = Response::srgb();
        Image::from_fn(SIZE.0, SIZE.1, |x, y| {
            let seen = light(x, y) * exposure * lens.of_pixel(x, y, SIZE).0;
            let code = response.code_of([seen, 0.8 * seen, 0.6 * seen]);
            Code(
                code.map(|c| {
                    ((c * 255.0 + random.random_range(-0.5..0.5_f32)).round() / 255.0).clamp(0.0, 1.0)
                }),
            )
        })
    }

    fn fitted(flats: &[CodeImage]) -> Result<Vignetting, Problem> {
        let flats: Vec<&dyn Rows> = flats.iter().map(|f| f as &dyn Rows).collect();
        Vignetting::fit(&flats, &Response::srgb())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn a_flat_field_gives_the_lens_back(a in -0.5..0.0, b in -0.2..0.2, c in -0.1..0.1, slope in -0.2..0.2_f32) {
            let lens = Vignetting::given([a, b, c]).unwrap();
            // Lit more from one side, and in the second photograph less of all.
            let light = move |x: usize, _: usize| 0.5 * (1.0 + slope * (x as f32 / 320.0 - 0.5));
            let found = fitted(&[shoot(&lens, 1.0, light), shoot(&lens, 0.6, light)]).unwrap();
            for r in [0.2, 0.5, 0.8, 1.0] {
                let off = found.at(r) / lens.at(r) - 1.0;
                prop_assert!(off.abs() < 0.004, "{} at {}", off, r);
                prop_assert!(off.abs() < 5.0 * found.variance(r).sqrt() / lens.at(r) + 0.002, "{} at {}", off, r);
            }
        }
    }

    #[test]
    fn brackets_through_a_lens_merge_to_what_they_would_be_without_it() {
        let lens = Vignetting::given([-0.35, 0.1, -0.05]).unwrap();
        let flat = shoot(&lens, 1.0, |_, _| 0.6);
        let light = |x: usize, y: usize| 0.05 * (1.0 + (x / 20 + y / 16 * 3) as f32 % 7.0);
        let exposures = [0.5, 1.0, 2.0];
        let images = exposures.map(|e| shoot(&lens, e, light));
        let frames: Vec<Frame> =
            images.iter().zip(exposures).map(|(codes, e)| Frame { codes, exposure: f64::from(e) }).collect();
        let mut response = Response::srgb();
        response.vignetting = Some(fitted(&[flat]).unwrap());
        let settings = config::Merge::default();
        let merged = merge::merge(&frames, &response, 1.0, &settings).unwrap();
        let bare = merge::merge(&frames, &Response::srgb(), 1.0, &settings).unwrap();
        let (mut errors, mut corner, mut honest) = (Vec::new(), 0.0_f64, 0);
        for (x, y) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y))) {
            let off = merged.radiance.at(x, y).0[1] / (0.8 * light(x, y)) - 1.0;
            errors.push(f64::from(off.abs()));
            corner = corner.max(f64::from((bare.radiance.at(x, y).0[1] / (0.8 * light(x, y)) - 1.0).abs()));
            let sigma = merged.variance.at(x, y)[1].sqrt() / (0.8 * light(x, y));
            honest += usize::from(off.abs() < 3.0 * sigma);
        }
        errors.sort_by(f64::total_cmp);
        let count = errors.len();
        assert!(errors[count / 2] < 0.005, "{}", errors[count / 2]);
        assert!(corner > 0.25, "without it the corners are off by {corner}");
        assert!(honest * 100 > 95 * count, "{honest} of {count}");
    }

    #[test]
    fn dust_does_not_matter_and_a_picture_of_something_else_is_refused() {
        let lens = Vignetting::given([-0.3, 0.0, 0.0]).unwrap();
        let dusty = shoot(&lens, 1.0, |x, y| if (x / 12 + y / 9) % 17 == 0 { 0.3 } else { 0.6 });
        let found = fitted(&[dusty]).unwrap();
        assert!((found.at(1.0) - 0.7).abs() < 0.02, "{found:?}");
        let clipped = shoot(&lens, 1.0, |x, _| if x < 160 { 2.0 } else { 0.5 });
        assert!(matches!(fitted(&[clipped]), Err(Problem::NoFlatField { .. })));
        assert!(matches!(Vignetting::given([-1.0, 0.0, 0.0]), Err(Problem::NoLens { .. })));
    }
}

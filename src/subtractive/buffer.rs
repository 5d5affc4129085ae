//! The shadow buffer S: found at a few pixels, resampled to all of them once, after all lights (decoro2008, §2.3).

use super::Surface;
use crate::image::Image;
use glam::Vec3;
use rayon::prelude::*;

/// Cells of so many rows and columns are found together.
const GROUP: usize = 16;
/// Pixels whose weights add up to less have no sample near and alike, and are found by themselves: edges and thin parts.
const LEAST_WEIGHT: f32 = 0.02;

/// N values a sample, one sample in each square of `side` × `side` pixels that sees a surface.
pub struct ShadowBuffer<const N: usize> {
    side: usize,
    columns: usize,
    rows: usize,
    cells: Vec<Option<(Surface, [f32; N])>>,
}

impl<const N: usize> ShadowBuffer<N> {
    /// Finds the values of one pixel in `side`²: of the middle one of each square or, where that sees nothing, the one
    /// nearest to it that does. `find` answers for neighbouring surfaces together.
    pub fn fill(
        surfaces: &Image<Option<Surface>>,
        side: usize,
        find: impl Fn(&[Surface]) -> Vec<[f32; N]> + Sync,
    ) -> Self {
        let side = side.max(1);
        let (columns, rows) = grid(surfaces, side);
        let across = columns.div_ceil(GROUP);
        let groups: Vec<Vec<(usize, Surface, [f32; N])>> = (0..across * rows.div_ceil(GROUP))
            .into_par_iter()
            .map(|group| {
                let (left, top) = (group % across * GROUP, group / across * GROUP);
                let members: Vec<(usize, Surface)> = (top..rows.min(top + GROUP))
                    .flat_map(|y| (left..columns.min(left + GROUP)).map(move |x| (x, y)))
                    .filter_map(|(x, y)| Some((y * columns + x, middle(surfaces, side, x, y)?)))
                    .collect();
                let found = find(&members.iter().map(|m| m.1).collect::<Vec<_>>());
                members
                    .into_iter()
                    .zip(found)
                    .map(|((cell, surface), values)| (cell, surface, values))
                    .collect()
            })
            .collect();
        let mut cells = vec![None; columns * rows];
        for (cell, surface, values) in groups.into_iter().flatten() {
            cells[cell] = Some((surface, values));
        }
        Self { side, columns, rows, cells }
    }

    /// Number of samples.
    pub fn samples(&self) -> usize {
        self.cells.iter().flatten().count()
    }

    /// S′ at a pixel that sees `surface`: the samples around it by Gaussian(|Δposition|) · max(n · n′, 0), in a window that
    /// is a cubic B-spline of the picture, so that it has no edge. `None` where no sample is near and alike.
    pub fn at(&self, x: usize, y: usize, surface: &Surface) -> Option<[f32; N]> {
        if self.side == 1 {
            return self.cells[y * self.columns + x].map(|(_, values)| values);
        }
        let place = |p: usize| (p as f32 + 0.5) / self.side as f32 - 0.5;
        let ((column, across), (row, down)) = (window(place(x)), window(place(y)));
        let inverse = 1.0 / (self.side as f32 * surface.pixel_m).powi(2).max(f32::MIN_POSITIVE);
        let (mut sum, mut total, mut dark) = ([0.0; N], 0.0, true);
        for (j, down) in down.iter().enumerate() {
            for (i, across) in across.iter().enumerate() {
                let Some((other, values)) = self.cell(column + i as isize, row + j as isize) else {
                    continue;
                };
                let alike = surface.normal.dot(other.normal).max(0.0);
                let apart: f32 = Vec3::distance_squared(surface.position, other.position) * inverse;
                let weight = across * down * alike * (-0.5 * apart).exp();
                total += weight;
                if values.iter().any(|v| *v != 0.0) {
                    dark = false;
                    (0..N).for_each(|k| sum[k] += weight * values[k]);
                }
            }
        }
        match total {
            _ if total < LEAST_WEIGHT => None,
            _ if dark => Some([0.0; N]),
            _ => Some(sum.map(|s| s / total)),
        }
    }

    fn cell(&self, x: isize, y: isize) -> Option<&(Surface, [f32; N])> {
        let inside = (0..self.columns as isize).contains(&x) && (0..self.rows as isize).contains(&y);
        self.cells.get((y * self.columns as isize + x) as usize).filter(|_| inside)?.as_ref()
    }

    /// S′ of all pixels, zero where there is no surface.
    pub fn resample(
        &self,
        surfaces: &Image<Option<Surface>>,
        find: impl Fn(&[Surface]) -> Vec<[f32; N]> + Sync,
    ) -> Image<[f32; N]> {
        let (width, height) = surfaces.size();
        let rows: Vec<Vec<[f32; N]>> = (0..height)
            .into_par_iter()
            .map(|y| {
                let mut row = vec![[0.0; N]; width];
                let (mut places, mut lonely) = (Vec::new(), Vec::new());
                for (x, value) in row.iter_mut().enumerate() {
                    let Some(surface) = surfaces.at(x, y) else { continue };
                    match self.at(x, y, surface) {
                        Some(found) => *value = found,
                        None => {
                            places.push(x);
                            lonely.push(*surface);
                        }
                    }
                }
                if !lonely.is_empty() {
                    places.into_iter().zip(find(&lonely)).for_each(|(x, found)| row[x] = found);
                }
                row
            })
            .collect();
        Image::from_pixels(width, height, rows.into_iter().flatten().collect())
    }
}

/// Columns and rows of samples.
pub(crate) fn grid(surfaces: &Image<Option<Surface>>, side: usize) -> (usize, usize) {
    (surfaces.width().div_ceil(side), surfaces.height().div_ceil(side))
}

/// The surfaces at which samples are found, row by row.
pub(crate) fn sampled(surfaces: &Image<Option<Surface>>, side: usize) -> Vec<Option<Surface>> {
    let (columns, rows) = grid(surfaces, side);
    (0..columns * rows).into_par_iter().map(|i| middle(surfaces, side, i % columns, i / columns)).collect()
}

/// The surface that stands for a square of pixels.
fn middle(surfaces: &Image<Option<Surface>>, side: usize, x: usize, y: usize) -> Option<Surface> {
    let (width, height) = surfaces.size();
    let (u, v) = ((x * side + side / 2).min(width - 1), (y * side + side / 2).min(height - 1));
    if surfaces.at(u, v).is_some() {
        return *surfaces.at(u, v);
    }
    let square = (y * side..height.min((y + 1) * side))
        .flat_map(|y| (x * side..width.min((x + 1) * side)).map(move |x| (x, y)));
    let seen = square.filter(|&(x, y)| surfaces.at(x, y).is_some());
    let nearest = seen.min_by_key(|&(x, y)| x.abs_diff(u).pow(2) + y.abs_diff(v).pow(2))?;
    *surfaces.at(nearest.0, nearest.1)
}

/// First of four neighbouring cells around a place, and their weights by the cubic B-spline.
fn window(place: f32) -> (isize, [f32; 4]) {
    let first = place.floor();
    let t = place - first;
    let s = 1.0 - t;
    let near = |t: f32| (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0;
    (first as isize - 1, [s * s * s / 6.0, near(t), near(s), t * t * t / 6.0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A floor seen from above, a pixel a centimetre; from column 20 on a wall that stands half a metre higher.
    fn scene() -> Image<Option<Surface>> {
        Image::from_fn(40, 30, |x, y| {
            let (normal, height) = if x < 20 { (Vec3::Y, 0.0) } else { (Vec3::X, 0.5) };
            let position = Vec3::new(x as f32 * 0.01, height, y as f32 * 0.01);
            Some(Surface {
                position,
                normal,
                face_normal: normal,
                viewer: normal,
                material: 0,
                pixel_m: 0.01,
            })
        })
    }

    fn constant(surfaces: &[Surface]) -> Vec<[f32; 1]> {
        surfaces.iter().map(|s| [if s.normal == Vec3::Y { 1.0 } else { 3.0 }]).collect()
    }

    proptest! {
        #[test]
        fn the_window_has_weight_one(place in -3.0..50.0f32) {
            let (_, weights) = window(place);
            prop_assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-5 && weights.iter().all(|w| *w >= 0.0));
        }
    }

    #[test]
    fn neither_another_normal_nor_another_height_bleeds() {
        for side in [1, 2, 4, 8] {
            let buffer = ShadowBuffer::fill(&scene(), side, constant);
            let found = buffer.resample(&scene(), constant);
            for (i, value) in found.pixels().iter().enumerate() {
                let expected = if i % 40 < 20 { 1.0 } else { 3.0 };
                assert!((value[0] - expected).abs() < 1e-5, "pixel {i} at 1/{}: {value:?}", side * side);
            }
        }
    }

    #[test]
    fn a_smooth_shadow_survives_and_costs_few_samples() {
        let smooth = |surfaces: &[Surface]| -> Vec<[f32; 1]> {
            surfaces.iter().map(|s| [(s.position.z * 4.0).sin() + 1.0]).collect()
        };
        let buffer = ShadowBuffer::fill(&scene(), 4, smooth);
        assert_eq!(buffer.samples(), 10 * 8);
        let (found, exact) = (buffer.resample(&scene(), smooth), ShadowBuffer::fill(&scene(), 1, smooth));
        for y in 4..26 {
            let exact = exact.cells[y * 40 + 10].unwrap().1[0];
            assert!((found.at(10, y)[0] - exact).abs() < 0.03, "{} {exact}", found.at(10, y)[0]);
        }
    }

    #[test]
    fn a_thin_part_between_samples_is_found_by_itself() {
        let mut surfaces = scene();
        let thin = Surface { position: Vec3::new(0.05, 9.0, 0.05), ..surfaces.at(5, 5).unwrap() };
        *surfaces.at_mut(5, 5) = Some(thin);
        let find = |surfaces: &[Surface]| -> Vec<[f32; 1]> {
            surfaces.iter().map(|s| [if s.position.y > 5.0 { 7.0 } else { 1.0 }]).collect()
        };
        let buffer = ShadowBuffer::fill(&surfaces, 8, find);
        assert_eq!(buffer.resample(&surfaces, find).at(5, 5), &[7.0]);
    }
}

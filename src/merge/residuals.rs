//! How far each frame is from the merged picture, and where: means over cells, for a person to look at.

use crate::image::Image;
use std::ops::Range;

/// Cells along the width, at most.
const COLUMNS: usize = 240;

/// Sums over the cells that some rows of a view touch, a map a frame.
pub(super) struct Residuals {
    /// Side of a cell, px.
    cell: usize,
    columns: usize,
    rows: Range<usize>,
    sums: Vec<Vec<(f32, u32)>>,
}

impl Residuals {
    /// For rows of a view of that width, px.
    pub fn new(frames: usize, width: usize, rows: Range<usize>) -> Self {
        let cell = width.div_ceil(COLUMNS).max(1);
        let (columns, rows) = (width.div_ceil(cell), rows.start / cell..rows.end.div_ceil(cell));
        Self { cell, columns, sums: vec![vec![(0.0, 0); columns * rows.len()]; frames], rows }
    }

    /// Every so-many-th pixel tells enough of a cell.
    pub fn stride(&self) -> usize {
        (self.cell * self.cell / 8).clamp(1, 7)
    }

    /// A frame says so many stops more than the merged picture at a pixel.
    pub fn put(&mut self, frame: usize, x: usize, y: usize, stops: f32) {
        let at = (y / self.cell - self.rows.start) * self.columns + x / self.cell;
        let (sum, count) = &mut self.sums[frame][at];
        *sum += stops;
        *count += 1;
    }

    /// Adds those of some rows of the same view.
    pub fn add(&mut self, other: &Self) {
        let from = (other.rows.start - self.rows.start) * self.columns;
        for (all, more) in self.sums.iter_mut().zip(&other.sums) {
            for ((sum, count), (s, n)) in all[from..].iter_mut().zip(more) {
                *sum += s;
                *count += n;
            }
        }
    }

    /// A frame's map, stops; 0 where it is nowhere well exposed.
    pub fn map(&self, frame: usize) -> Image<f32> {
        let mean = |(sum, count): &(f32, u32)| sum / (*count).max(1) as f32;
        let cells = self.sums[frame].iter().map(mean).collect();
        Image::from_pixels(self.columns, self.rows.len(), cells)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_of_a_view_add_up_to_means_over_cells() {
        let mut all = Residuals::new(1, 480, 0..9);
        for rows in [0..5, 5..9] {
            let mut part = Residuals::new(1, 480, rows.clone());
            for (x, y) in rows.flat_map(|y| (0..480).map(move |x| (x, y))) {
                part.put(0, x, y, (x + 10 * y) as f32);
            }
            all.add(&part);
        }
        let map = all.map(0);
        assert_eq!(map.size(), (240, 5));
        assert_eq!((*map.at(0, 0), *map.at(3, 2), *map.at(3, 4)), (5.5, 51.5, 86.5));
    }
}

//! Where the markers are, and what of their paper is white.

use super::Problem;
use crate::config;
use crate::vision::{BoardView, Marker};
use nalgebra::{Point2, Rotation2, Vector2};
use std::collections::BTreeMap;

/// Places of white paper lie outside a marker's edges by this share of its side.
const WHITE_OUTSIDE: f64 = 0.13;

/// Markers in the plane z = 0 of the grid's frame.
#[derive(Debug, Clone)]
pub struct Layout {
    /// By number: top left, top right, bottom right, bottom left corner, m.
    corners: BTreeMap<u32, [Point2<f64>; 4]>,
    white: Vec<Point2<f64>>,
}

impl Layout {
    /// Of the settings.
    pub fn of(settings: &config::Live) -> Result<Self, Problem> {
        let mut placed = settings.markers.clone();
        if let Some(board) = &settings.board {
            let wrong = |what: String| Err(Problem::Setting { name: "board", what });
            let config::MarkerBoard { columns, rows, side_m, gap_m, first_id } = *board;
            if !(1..=100).contains(&columns) || !(1..=100).contains(&rows) {
                return wrong(format!("has {columns} × {rows} markers"));
            }
            if !(gap_m >= 0.0 && gap_m.is_finite()) {
                return wrong(format!("has a gap of {gap_m} m"));
            }
            let step = side_m + gap_m;
            let at = |i: usize, n: usize| (i as f64 - (n as f64 - 1.0) / 2.0) * step;
            placed.extend((0..columns * rows).map(|k| config::PlacedMarker {
                id: first_id + k as u32,
                centre_m: [at(k % columns, columns), -at(k / columns, rows)],
                side_m,
                rotation_deg: 0.0,
            }));
        }
        if placed.is_empty() {
            return Err(Problem::NotGiven("board"));
        }
        let (mut corners, mut white) = (BTreeMap::new(), Vec::new());
        for marker in placed {
            let sound = marker.side_m > 0.0 && marker.side_m.is_finite();
            if !sound || corners.contains_key(&marker.id) {
                let what = if sound { "twice".into() } else { format!("with a side of {} m", marker.side_m) };
                return Err(Problem::Setting {
                    name: "markers",
                    what: format!("have number {} {what}", marker.id),
                });
            }
            let turn = Rotation2::new(marker.rotation_deg.to_radians());
            let at =
                |x: f64, y: f64| Point2::from(marker.centre_m) + turn * Vector2::new(x, y) * marker.side_m;
            corners.insert(marker.id, [at(-0.5, 0.5), at(0.5, 0.5), at(0.5, -0.5), at(-0.5, -0.5)]);
            let out = 0.5 + WHITE_OUTSIDE;
            white.extend([at(0.0, out), at(0.0, -out), at(out, 0.0), at(-out, 0.0)]);
        }
        Ok(Self { corners, white })
    }

    /// The markers seen that belong to it, if there are any.
    pub fn view(&self, seen: &[Marker]) -> Option<BoardView> {
        let mut view = BoardView { board: Vec::new(), pixels: Vec::new() };
        for marker in seen {
            if let Some(corners) = self.corners.get(&marker.id) {
                view.board.extend(corners);
                view.pixels.extend(marker.corners);
            }
        }
        (!view.board.is_empty()).then_some(view)
    }

    /// Corners of all markers, m.
    pub fn corners(&self) -> impl Iterator<Item = &Point2<f64>> {
        self.corners.values().flatten()
    }

    /// Places of white paper, m.
    pub fn white(&self) -> &[Point2<f64>] {
        &self.white
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_is_numbered_row_by_row_and_lies_around_the_origin() {
        let board = config::MarkerBoard { columns: 3, rows: 2, side_m: 0.1, gap_m: 0.02, first_id: 5 };
        let layout = Layout::of(&config::Live { board: Some(board), ..Default::default() }).unwrap();
        assert_eq!(layout.corners.len(), 6);
        assert!((layout.corners[&5][0] - Point2::new(-0.17, 0.11)).norm() < 1e-9);
        assert!((layout.corners[&10][2] - Point2::new(0.17, -0.11)).norm() < 1e-9);
    }

    #[test]
    fn markers_that_are_not_or_twice_there_are_refused() {
        let said = |settings: config::Live| Layout::of(&settings).unwrap_err().to_string();
        assert_eq!(said(config::Live::default()), "`live.board` is not given");
        let marker = config::PlacedMarker { id: 3, centre_m: [0.0; 2], side_m: 0.1, rotation_deg: 0.0 };
        let twice = config::Live { markers: vec![marker.clone(), marker.clone()], ..Default::default() };
        assert_eq!(said(twice), "`live.markers` have number 3 twice");
        let flat = config::PlacedMarker { side_m: 0.0, ..marker };
        let flat = config::Live { markers: vec![flat], ..Default::default() };
        assert_eq!(said(flat), "`live.markers` have number 3 with a side of 0 m");
    }
}

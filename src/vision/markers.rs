//! Square markers of OpenCV's dictionaries (Garrido-Jurado et al. 2014).

use super::{HALF, Problem, matrix};
use crate::image::Image;
use nalgebra::{Point2, Vector2};
use opencv::aruco::{self, CornerRefineMethod, DetectorParameters, Dictionary};
use opencv::core::{Mat, Point2f, Ptr, Vector};
use opencv::prelude::{DetectorParametersTrait, DictionaryTraitConst, MatTraitConst};

/// A marker as seen.
#[derive(Debug, Clone, PartialEq)]
pub struct Marker {
    /// Its number in the dictionary.
    pub id: u32,
    /// Top left, top right, bottom right, bottom left corner as it was printed, px.
    pub corners: [Point2<f64>; 4],
}

/// Cells of the printed borders besides the code's.
const BORDER: i32 = 1;
const NAMES: [&str; 21] = [
    "4x4_50",
    "4x4_100",
    "4x4_250",
    "4x4_1000",
    "5x5_50",
    "5x5_100",
    "5x5_250",
    "5x5_1000",
    "6x6_50",
    "6x6_100",
    "6x6_250",
    "6x6_1000",
    "7x7_50",
    "7x7_100",
    "7x7_250",
    "7x7_1000",
    "aruco_original",
    "apriltag_16h5",
    "apriltag_25h9",
    "apriltag_36h10",
    "apriltag_36h11",
];
/// Of the squares by which corners are refined, px: smaller than a cell, so that they hold one corner.
const LEAST_WINDOW: i32 = 2;
const MOST_WINDOW: i32 = 5;

fn dictionary(name: &str) -> Result<Ptr<Dictionary>, Problem> {
    let number = NAMES.iter().position(|n| *n == name);
    let number = number.ok_or_else(|| Problem::Dictionary(name.to_string()))?;
    Ok(aruco::get_predefined_dictionary_i32(number as i32)?)
}

pub(super) fn nearest(name: &str) -> String {
    let alike = |n: &&&str| (1000.0 * strsim::jaro_winkler(name, n)) as i64;
    NAMES.iter().max_by_key(alike).map_or(String::new(), |n| format!("did you mean `{n}`?"))
}

/// Where markers are expected to be seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Part of the picture, `[left, top, right, bottom]`, px.
    pub within: [usize; 4],
    /// Shortest side of a marker, px.
    pub side_px: f64,
}

/// All markers of a dictionary (`4x4_50` …) in a picture, their corners to a fraction of a pixel; those of a part of it where it
/// is known where they are, at a fraction of the time.
pub fn markers(image: &Image<u8>, name: &str, expected: Option<&Expected>) -> Result<Vec<Marker>, Problem> {
    let dictionary = dictionary(name)?;
    let cells = f64::from(dictionary.marker_size() + 2 * BORDER);
    let window = |side: f64| ((0.8 * side / cells) as i32).clamp(LEAST_WINDOW, MOST_WINDOW);
    if let Some(Expected { within: [left, top, right, bottom], side_px }) = expected.copied() {
        let part = Image::from_fn(right - left, bottom - top, |x, y| *image.at(left + x, top + y));
        let mut found = detect(&part, &dictionary, window(side_px))?;
        let shift = Vector2::new(left as f64, top as f64);
        found.iter_mut().flat_map(|m| &mut m.corners).for_each(|corner| *corner += shift);
        return Ok(found);
    }
    let rough = detect(image, &dictionary, MOST_WINDOW)?;
    let side =
        |m: &Marker| (0..4).map(|k| (m.corners[k] - m.corners[(k + 1) % 4]).norm()).fold(f64::MAX, f64::min);
    let smallest = rough.iter().map(side).fold(f64::MAX, f64::min);
    if rough.is_empty() || window(smallest) == MOST_WINDOW {
        return Ok(rough);
    }
    detect(image, &dictionary, window(smallest))
}

fn detect(image: &Image<u8>, dictionary: &Ptr<Dictionary>, window: i32) -> Result<Vec<Marker>, Problem> {
    let mut parameters = DetectorParameters::create()?;
    parameters.set_corner_refinement_method(CornerRefineMethod::CORNER_REFINE_SUBPIX as i32);
    parameters.set_corner_refinement_win_size(window);
    parameters.set_corner_refinement_max_iterations(100);
    parameters.set_corner_refinement_min_accuracy(0.005);
    let (mut corners, mut ids) = (Vector::<Vector<Point2f>>::new(), Vector::<i32>::new());
    let mut rejected = Vector::<Vector<Point2f>>::new();
    aruco::detect_markers(&matrix(image)?, dictionary, &mut corners, &mut ids, &parameters, &mut rejected)?;
    let ours = |p: Point2f| Point2::new(f64::from(p.x) + HALF, f64::from(p.y) + HALF);
    let mut markers = Vec::new();
    for (id, corners) in ids.iter().zip(&corners) {
        let corners: Vec<_> = corners.iter().map(ours).collect();
        if let (Ok(id), Ok(corners)) = (u32::try_from(id), corners.try_into()) {
            markers.push(Marker { id, corners });
        }
    }
    markers.sort_by_key(|m| m.id);
    Ok(markers)
}

/// Cells of a marker with its black border, row by row from the top left, white or not.
pub fn marker_cells(name: &str, id: u32) -> Result<Vec<bool>, Problem> {
    let dictionary = dictionary(name)?;
    let count = dictionary.bytes_list().rows() as u32;
    if id >= count {
        return Err(Problem::Marker { id, count });
    }
    let side = dictionary.marker_size() + 2 * BORDER;
    let mut picture = Mat::default();
    aruco::draw_marker(&dictionary, id as i32, side, &mut picture, BORDER)?;
    let mut cells = Vec::new();
    for (row, column) in (0..side).flat_map(|r| (0..side).map(move |c| (r, c))) {
        cells.push(*picture.at_2d::<u8>(row, column)? > 127);
    }
    Ok(cells)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_printed_marker_is_found_where_it_is() {
        let cells = marker_cells("4x4_50", 7).unwrap();
        assert_eq!(cells.len(), 36);
        let picture = Image::from_fn(200, 150, |x, y| {
            let (u, v) = ((x as f64 - 59.5) / 10.0, (y as f64 - 39.5) / 10.0);
            let inside = (0.0..6.0).contains(&u) && (0.0..6.0).contains(&v);
            if inside && !cells[v as usize * 6 + u as usize] { 20 } else { 220 }
        });
        let found = markers(&picture, "4x4_50", None).unwrap();
        assert_eq!(found.len(), 1);
        let expected = [[60.0, 40.0], [120.0, 40.0], [120.0, 100.0], [60.0, 100.0]];
        for (found, [x, y]) in found[0].corners.iter().zip(expected) {
            assert!((found - Point2::new(x, y)).norm() < 0.6, "{found} {x} {y}");
        }
        assert_eq!(found[0].id, 7);
    }

    #[test]
    fn unknown_dictionaries_and_numbers_are_named() {
        use crate::error::Problem as _;
        let e = markers(&Image::from_fn(8, 8, |_, _| 0), "4x4_500", None).unwrap_err();
        assert_eq!(
            (e.to_string(), e.hint()),
            ("there is no dictionary of markers `4x4_500`".into(), "did you mean `4x4_50`?".into())
        );
        assert_eq!(marker_cells("4x4_50", 50), Err(Problem::Marker { id: 50, count: 50 }));
    }
}

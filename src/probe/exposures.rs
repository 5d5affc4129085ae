//! The probe's exposures as one picture.

use crate::config;
use crate::exposure::{Frame, Photograph};
use crate::image::{CodeImage, Radiance};
use crate::merge::{self, Merged, align};
use crate::response::Response;

/// Merges photographs of one view, each with its exposure ([`crate::exposure::Exposure::scale`]), in units of
/// `plate_exposure`; what lies beside the others is moved back first. Gives also by how many px along x and y each lay
/// beside the middle exposure.
///
/// A linear picture stands alone: it is brought to units of the plate, and the others are not looked at.
pub fn merge(
    photographs: Vec<(Photograph, f64)>,
    response: &Response,
    plate_exposure: f64,
    settings: &config::Merge,
) -> Result<(Merged, Vec<[i32; 2]>), merge::Problem> {
    let mut images = Vec::with_capacity(photographs.len());
    for (photograph, exposure) in photographs {
        match photograph {
            Photograph::Linear(image) => {
                let gain = (plate_exposure / exposure) as f32;
                let image = image.map(|p| Radiance(p.0.map(|v| v * gain)));
                return Ok((Merged::from_linear(&image), Vec::new()));
            }
            Photograph::Codes(codes) => images.push((codes, exposure)),
        }
    }
    let shifts = align::shifts(&frames(&images), response);
    for ((codes, _), shift) in images.iter_mut().zip(&shifts).filter(|(_, s)| **s != [0, 0]) {
        *codes = align::moved_back(codes, *shift);
    }
    Ok((merge::merge(&frames(&images), response, plate_exposure, settings)?, shifts))
}

fn frames(images: &[(CodeImage, f64)]) -> Vec<Frame<'_>> {
    images.iter().map(|(codes, exposure)| Frame { codes, exposure: *exposure }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Code, Image};

    /// Blotches of light, at most 0.22, seen `shift` px beside their place.
    fn light(x: usize, y: usize, shift: [i32; 2]) -> f32 {
        let (u, v) = ((x as i32 - shift[0]) as f32, (y as i32 - shift[1]) as f32);
        0.02 + 0.1 * (1.0 + (0.45 * u).sin() * (0.31 * v + 0.002 * u * v).cos())
    }

    fn shoot(exposure: f32, shift: [i32; 2]) -> (Photograph, f64) {
        let code = |x, y| Code(Response::srgb().code_of([light(x, y, shift) * exposure; 3]));
        (Photograph::Codes(Image::from_fn(96, 80, code)), f64::from(exposure))
    }

    fn merged(photographs: Vec<(Photograph, f64)>) -> (Merged, Vec<[i32; 2]>) {
        merge(photographs, &Response::srgb(), 2.0, &config::Merge::default()).unwrap()
    }

    #[test]
    fn exposures_that_lie_beside_the_others_are_moved_back_and_merged() {
        let (merged, shifts) = merged(vec![shoot(4.0, [0, 0]), shoot(2.0, [0, 0]), shoot(1.0, [-1, 3])]);
        assert_eq!(shifts, [[0, 0], [0, 0], [-1, 3]]);
        // At the border a moved picture repeats its last pixels.
        for (x, y) in (8..72).flat_map(|y| (8..88).map(move |x| (x, y))) {
            let (seen, true_) = (merged.radiance.at(x, y).0[1], 2.0 * light(x, y, [0, 0]));
            assert!((seen / true_ - 1.0).abs() < 0.01, "{seen} at {x}, {y}, in truth {true_}");
        }
    }

    #[test]
    fn a_linear_picture_is_brought_to_units_of_the_plate() {
        let linear = Photograph::Linear(Image::from_fn(96, 80, |_, _| Radiance([0.5, 1.0, 3.0])));
        let (merged, shifts) = merged(vec![(linear, 0.5), shoot(1.0, [0, 0])]);
        assert_eq!(merged.radiance.at(3, 4).0, [2.0, 4.0, 12.0]);
        assert!(shifts.is_empty() && !merged.clipped.pixels().contains(&true));
    }

    #[test]
    fn without_an_exposure_there_is_nothing_to_merge() {
        let e = merge(Vec::new(), &Response::srgb(), 1.0, &config::Merge::default()).unwrap_err();
        assert_eq!(e, merge::Problem::NoFrame);
    }
}

//! Where errors are measured.

use crate::image::{Image, RadianceImage};

/// Margin around the object, px.
const MARGIN_PX: usize = 2;
/// The shadow region is where less than this share of the empty scene's radiance is left.
const SHADOW: f32 = 0.95;
/// Side of the window whose median decides, px.
const MEDIAN_PX: usize = 5;

/// Pixels off the object, by a margin of 2 px, where T/B, median over 5×5, is below 0.95.
pub fn shadow(with: &RadianceImage, empty: &RadianceImage, near_object: &Image<bool>) -> Image<bool> {
    let (w, h) = with.size();
    let ratio: Vec<f32> = with
        .pixels()
        .iter()
        .zip(empty.pixels())
        .map(|(t, b)| if b.luminance() > 0.0 { t.luminance() / b.luminance() } else { 1.0 })
        .collect();
    let half = MEDIAN_PX / 2;
    let mut window = Vec::with_capacity(MEDIAN_PX * MEDIAN_PX);
    Image::from_fn(w, h, |x, y| {
        if *near_object.at(x, y) {
            return false;
        }
        window.clear();
        for j in y.saturating_sub(half)..(y + half + 1).min(h) {
            window.extend_from_slice(&ratio[j * w + x.saturating_sub(half)..j * w + (x + half + 1).min(w)]);
        }
        let middle = window.len() / 2;
        *window.select_nth_unstable_by(middle, f32::total_cmp).1 < SHADOW
    })
}

/// Pixels within 2 px of either coverage.
pub fn near_object(ours: &Image<f32>, reference: &Image<f32>) -> Image<bool> {
    let (w, h) = ours.size();
    let either = |x: usize, y: usize| *ours.at(x, y) > 0.0 || *reference.at(x, y) > 0.0;
    let mut near = Image::from_fn(w, h, |_, _| false);
    for y in 0..h {
        for x in (0..w).filter(|x| either(*x, y)) {
            for j in y.saturating_sub(MARGIN_PX)..(y + MARGIN_PX + 1).min(h) {
                for i in x.saturating_sub(MARGIN_PX)..(x + MARGIN_PX + 1).min(w) {
                    *near.at_mut(i, j) = true;
                }
            }
        }
    }
    near
}

/// Pixels that both pictures show as object, their neighbours too.
pub fn object_interior(ours: &Image<f32>, reference: &Image<f32>) -> Image<bool> {
    let (w, h) = ours.size();
    let full = |x: usize, y: usize| *ours.at(x, y) >= 0.999 && *reference.at(x, y) >= 0.999;
    Image::from_fn(w, h, |x, y| {
        (y.saturating_sub(1)..(y + 2).min(h))
            .all(|j| (x.saturating_sub(1)..(x + 2).min(w)).all(|i| full(i, j)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Radiance;

    #[test]
    fn the_shadow_is_found_off_the_object() {
        let empty = Image::from_fn(40, 20, |_, _| Radiance([1.0; 3]));
        let with = Image::from_fn(40, 20, |x, _| {
            Radiance(
                [if x < 10 {
                    1.0
                } else if x < 30 {
                    0.8
                } else {
                    0.97
                }; 3],
            )
        });
        let coverage = Image::from_fn(40, 20, |x, _| if (14..16).contains(&x) { 1.0 } else { 0.0 });
        let region = shadow(&with, &empty, &near_object(&coverage, &coverage));
        for x in 0..40 {
            let expected = (10..12).contains(&x) || (18..30).contains(&x);
            assert_eq!(*region.at(x, 10), expected, "column {x}");
        }
    }

    #[test]
    fn a_lone_noisy_pixel_is_no_shadow() {
        let empty = Image::from_fn(20, 20, |_, _| Radiance([1.0; 3]));
        let with = Image::from_fn(20, 20, |x, y| Radiance([if (x, y) == (9, 9) { 0.1 } else { 1.0 }; 3]));
        let none = Image::from_fn(20, 20, |_, _| 0.0);
        assert!(shadow(&with, &empty, &near_object(&none, &none)).pixels().iter().all(|s| !s));
    }
}

//! Where something moved: frames that see another thing than the others over more than a few pixels.

use crate::image::Image;

/// Half the side of the neighbourhood that is looked at, px, and how many of its pixels must disagree.
const REACH: usize = 2;
const NEEDED: u8 = 9;
/// Rows beyond a band that its mask depends on.
pub(super) const MARGIN: usize = REACH + 1;

/// Frames to leave out, one bit each, from those that single pixels find inconsistent: where many pixels around agree on
/// it, and one pixel further, since the border of a moving thing blends with what lies behind.
pub(super) fn mask(inconsistent: &Image<u64>) -> Image<u64> {
    let mut left = inconsistent.pixels().iter().fold(0, |all, bits| all | bits);
    let mut core = Image::filled(inconsistent.width(), inconsistent.height(), 0);
    while left != 0 {
        let bit = left & left.wrapping_neg();
        left ^= bit;
        let counts = gathered(&inconsistent.map(|bits| u8::from(bits & bit != 0)), REACH, |sum, n| *sum += n);
        for (core, count) in core.pixels_mut().iter_mut().zip(counts.pixels()) {
            *core |= if *count >= NEEDED { bit } else { 0 };
        }
    }
    gathered(&core, 1, |all, bits| *all |= bits)
}

/// Each pixel with all that lie within `reach`, along rows and then along columns.
fn gathered<T: Copy>(image: &Image<T>, reach: usize, add: impl Fn(&mut T, &T)) -> Image<T> {
    let width = image.width().max(1);
    let mut along = image.clone();
    for (to, from) in along.pixels_mut().chunks_mut(width).zip(image.pixels().chunks(width)) {
        gather(to, from, reach, 1, &add);
    }
    let mut around = along.clone();
    gather(around.pixels_mut(), along.pixels(), reach, width, &add);
    around
}

/// Adds what lies up to `reach` steps before and after.
fn gather<T>(to: &mut [T], from: &[T], reach: usize, step: usize, add: &impl Fn(&mut T, &T)) {
    for d in (1..=reach).map(|k| k * step).filter(|d| *d < from.len()) {
        to[d..].iter_mut().zip(from).for_each(|(to, from)| add(to, from));
        to.iter_mut().zip(&from[d..]).for_each(|(to, from)| add(to, from));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_patch_is_left_out_with_its_border_and_a_stray_pixel_is_not() {
        let inside = |x: usize, y: usize| (10..20).contains(&x) && (10..18).contains(&y);
        let seen =
            Image::from_fn(40, 30, |x, y| if inside(x, y) { 0b100 } else { u64::from((x, y) == (30, 5)) });
        let mask = mask(&seen);
        assert_eq!(*mask.at(30, 5), 0);
        for (x, y) in (10..18).flat_map(|y| (10..20).map(move |x| (x, y))) {
            assert_eq!(*mask.at(x, y), 0b100, "{x} {y}");
        }
        assert_eq!(*mask.at(25, 14), 0);
    }
}

//! Where something moved: frames that see another thing than the others over more than a few pixels.

use crate::image::Image;

/// Half the side of the neighbourhood that is looked at, px, and how many of its pixels must disagree.
const REACH: usize = 2;
const NEEDED: u32 = 9;
/// Rows beyond a band that its mask depends on.
pub(super) const MARGIN: usize = REACH + 1;

/// Frames to leave out, one bit each, from those that single pixels find inconsistent: where many pixels around agree on
/// it, and one pixel further, since the border of a moving thing blends with what lies behind.
pub(super) fn mask(inconsistent: &Image<u64>) -> Image<u64> {
    let (width, height) = inconsistent.size();
    if inconsistent.pixels().iter().all(|b| *b == 0) {
        return Image::from_fn(width, height, |_, _| 0);
    }
    let near = spread(inconsistent, REACH);
    let core = Image::from_fn(width, height, |x, y| {
        let (mut left, mut agreed) = (*near.at(x, y), 0);
        while left != 0 {
            let bit = left & left.wrapping_neg();
            left ^= bit;
            let mut count = 0;
            for v in y.saturating_sub(REACH)..(y + REACH + 1).min(height) {
                for u in x.saturating_sub(REACH)..(x + REACH + 1).min(width) {
                    count += u32::from(inconsistent.at(u, v) & bit != 0);
                }
            }
            if count >= NEEDED {
                agreed |= bit;
            }
        }
        agreed
    });
    spread(&core, 1)
}

/// Each pixel with the bits of all within `reach`, along rows and then along columns.
fn spread(bits: &Image<u64>, reach: usize) -> Image<u64> {
    let (width, height) = bits.size();
    let along = Image::from_fn(width, height, |x, y| {
        (x.saturating_sub(reach)..(x + reach + 1).min(width)).fold(0, |b, u| b | bits.at(u, y))
    });
    Image::from_fn(width, height, |x, y| {
        (y.saturating_sub(reach)..(y + reach + 1).min(height)).fold(0, |b, v| b | along.at(x, v))
    })
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

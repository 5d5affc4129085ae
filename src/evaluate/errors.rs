//! Errors of a composite against the truth, on linear radiance.

use crate::image::{Image, Radiance, RadianceImage};

/// How a removal ε compares with the true one ε*, over a region and all channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RemovalError {
    /// rms(ε − ε*) / rms(ε*): 1 = having done nothing, 0 = exact.
    pub relative: f64,
    /// Σε / Σε* − 1: + too dark, − too light.
    pub energy_bias: f64,
    /// rms(ε*), plate units.
    pub rms: f64,
}

/// How a picture C compares with the true one T.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PictureError {
    /// rms((C − T) / T).
    pub relative_rmse: f64,
    /// ΣC / ΣT − 1.
    pub bias: f64,
}

/// Pixel by pixel difference.
pub fn difference(a: &RadianceImage, b: &RadianceImage) -> RadianceImage {
    let pixels =
        a.pixels().iter().zip(b.pixels()).map(|(a, b)| Radiance(std::array::from_fn(|k| a.0[k] - b.0[k])));
    Image::from_pixels(a.width(), a.height(), pixels.collect())
}

fn samples<'a>(
    a: &'a RadianceImage,
    b: &'a RadianceImage,
    region: &'a Image<bool>,
) -> impl Iterator<Item = (f64, f64)> + 'a {
    (0..a.pixels().len()).filter(|i| region.pixels()[*i]).flat_map(move |i| {
        let (p, q) = (a.pixels()[i].0, b.pixels()[i].0);
        (0..3).map(move |k| (f64::from(p[k]), f64::from(q[k])))
    })
}

/// `None` where the region is empty or nothing was removed in truth.
pub fn removal(ours: &RadianceImage, truth: &RadianceImage, region: &Image<bool>) -> Option<RemovalError> {
    let (mut n, mut error, mut square, mut sums) = (0.0, 0.0, 0.0, [0.0; 2]);
    for (e, t) in samples(ours, truth, region) {
        n += 1.0;
        error += (e - t) * (e - t);
        square += t * t;
        sums[0] += e;
        sums[1] += t;
    }
    (square > 0.0 && sums[1] != 0.0).then(|| RemovalError {
        relative: (error / square).sqrt(),
        energy_bias: sums[0] / sums[1] - 1.0,
        rms: (square / n).sqrt(),
    })
}

/// Relative error of what two removals with independent noise have in common: that of their noise-free mean, as
/// √(Σ(a − t)(b − t) / Σt²); 0 where noise makes that negative. `None` where nothing was removed in truth.
pub fn common_error(ours: [&RadianceImage; 2], truth: &RadianceImage, region: &Image<bool>) -> Option<f64> {
    let [a, b] = ours.map(|image| samples(image, truth, region));
    let (mut product, mut square) = (0.0, 0.0);
    for ((a, t), (b, _)) in a.zip(b) {
        product += (a - t) * (b - t);
        square += t * t;
    }
    (square > 0.0).then(|| (product / square).max(0.0).sqrt())
}

/// `None` where the region is empty or the truth black.
pub fn picture(ours: &RadianceImage, truth: &RadianceImage, region: &Image<bool>) -> Option<PictureError> {
    let (mut n, mut square, mut sums) = (0.0, 0.0, [0.0; 2]);
    for (c, t) in samples(ours, truth, region) {
        sums[0] += c;
        sums[1] += t;
        // A black true pixel has no relative error.
        if t > 1e-6 {
            n += 1.0;
            square += ((c - t) / t).powi(2);
        }
    }
    (n > 0.0).then(|| PictureError { relative_rmse: (square / n).sqrt(), bias: sums[0] / sums[1] - 1.0 })
}

/// Means over 4×4 blocks of the region's pixels; a block counts if at least half of it lies in the region.
pub fn block_means(image: &RadianceImage, region: &Image<bool>) -> (RadianceImage, Image<bool>) {
    const SIDE: usize = 4;
    let (w, h) = (image.width() / SIDE, image.height() / SIDE);
    let mut counts = Vec::with_capacity(w * h);
    let means = Image::from_fn(w, h, |x, y| {
        let (mut sum, mut count) = ([0.0f64; 3], 0);
        for i in 0..SIDE * SIDE {
            let (px, py) = (x * SIDE + i % SIDE, y * SIDE + i / SIDE);
            if *region.at(px, py) {
                count += 1;
                (0..3).for_each(|k| sum[k] += f64::from(image.at(px, py).0[k]));
            }
        }
        counts.push(count);
        Radiance(sum.map(|v| if count > 0 { (v / f64::from(count)) as f32 } else { 0.0 }))
    });
    let inside = counts.into_iter().map(|c| c * 2 >= (SIDE * SIDE) as i32).collect();
    (means, Image::from_pixels(w, h, inside))
}

/// Medians of plate/reference: over all channels, and of each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// Plate units in one unit of the reference.
    pub global: f64,
    /// The same by channel.
    pub channels: [f64; 3],
}

/// The scale between plate and reference, from pixels that are not clipped and not black. `None` if there are none.
pub fn scale(plate: &RadianceImage, reference: &RadianceImage, usable: &Image<bool>) -> Option<Scale> {
    let ratios = |channel: usize| -> Vec<f64> {
        (0..plate.pixels().len())
            .filter(|i| usable.pixels()[*i])
            .map(|i| (f64::from(plate.pixels()[i].0[channel]), f64::from(reference.pixels()[i].0[channel])))
            .filter(|(p, r)| *p > 1e-6 && *r > 1e-9)
            .map(|(p, r)| p / r)
            .collect()
    };
    let by_channel = [ratios(0), ratios(1), ratios(2)];
    let global = median(by_channel.concat())?;
    let [r, g, b] = by_channel.map(median);
    Some(Scale { global, channels: [r?, g?, b?] })
}

/// Median of |plate / (scale · reference) − 1| over usable samples.
pub fn median_relative_error(
    plate: &RadianceImage,
    reference: &RadianceImage,
    usable: &Image<bool>,
    scale: f64,
) -> Option<f64> {
    let errors = samples(plate, reference, usable)
        .filter(|(_, r)| *r > 1e-9)
        .map(|(p, r)| (p / (scale * r) - 1.0).abs())
        .collect();
    median(errors)
}

/// The middle value; for an even count the upper one of the two.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::{Rng, SeedableRng, rngs::SmallRng};

    fn noise(seed: u64, low: f32, high: f32) -> RadianceImage {
        let mut rng = SmallRng::seed_from_u64(seed);
        Image::from_fn(16, 12, |_, _| Radiance([0; 3].map(|_| rng.random_range(low..high))))
    }

    fn everywhere() -> Image<bool> {
        Image::from_fn(16, 12, |_, _| true)
    }

    #[test]
    fn identical_pictures_have_no_error() {
        let (empty, with) = (noise(1, 0.5, 1.0), noise(2, 0.1, 0.4));
        let removed = difference(&empty, &with);
        let e = removal(&removed, &removed, &everywhere()).unwrap();
        assert_eq!((e.relative, e.energy_bias), (0.0, 0.0));
        let p = picture(&with, &with, &everywhere()).unwrap();
        assert_eq!((p.relative_rmse, p.bias), (0.0, 0.0));
    }

    #[test]
    fn having_done_nothing_has_relative_error_one() {
        let truth = difference(&noise(1, 0.5, 1.0), &noise(2, 0.1, 0.4));
        let nothing = Image::from_fn(16, 12, |_, _| Radiance::default());
        let e = removal(&nothing, &truth, &everywhere()).unwrap();
        assert_eq!((e.relative, e.energy_bias), (1.0, -1.0));
    }

    #[test]
    fn independent_noise_has_no_part_in_the_common_error() {
        let truth = noise(1, 0.4, 0.6);
        let wrong = |seed| {
            let n = noise(seed, -0.2, 0.2);
            let pixels = truth.pixels().iter().zip(n.pixels());
            let pixels = pixels.map(|(t, n)| Radiance(std::array::from_fn(|k| 1.1 * t.0[k] + n.0[k])));
            Image::from_pixels(16, 12, pixels.collect())
        };
        let (a, b) = (wrong(2), wrong(3));
        let alone = removal(&a, &truth, &everywhere()).unwrap().relative;
        let common = common_error([&a, &b], &truth, &everywhere()).unwrap();
        assert!(alone > 0.2 && (common - 0.1).abs() < 0.03, "{alone}, {common}");
    }

    #[test]
    fn block_means_average_noise_away() {
        let image = noise(3, 0.9, 1.1);
        let (means, inside) = block_means(&image, &everywhere());
        assert_eq!(means.size(), (4, 3));
        assert!(inside.pixels().iter().all(|i| *i));
        let by_hand: f32 = (0..16).map(|i| image.at(i % 4, i / 4).0[1]).sum::<f32>() / 16.0;
        assert!((means.at(0, 0).0[1] - by_hand).abs() < 1e-6);
        let left = Image::from_fn(16, 12, |x, _| x < 1);
        assert!(block_means(&image, &left).1.pixels().iter().all(|i| !i), "a quarter is too little");
    }

    #[test]
    fn an_empty_region_has_no_error() {
        let none = Image::from_fn(16, 12, |_, _| false);
        let image = noise(1, 0.5, 1.0);
        assert!(removal(&image, &image, &none).is_none() && picture(&image, &image, &none).is_none());
        assert!(scale(&image, &image, &none).is_none());
    }

    proptest! {
        #[test]
        fn a_known_scale_is_recovered(s in 1e-3f64..1e3, seed in 0u64..) {
            let reference = noise(seed, 0.1, 2.0);
            let plate = reference.map(|p| Radiance(p.0.map(|v| v * s as f32)));
            let found = scale(&plate, &reference, &everywhere()).unwrap();
            prop_assert!((found.global / s - 1.0).abs() < 1e-5);
            prop_assert!(found.channels.iter().all(|c| (c / s - 1.0).abs() < 1e-5));
            prop_assert!(median_relative_error(&plate, &reference, &everywhere(), s).unwrap() < 1e-5);
        }

        #[test]
        fn scaling_a_removal_by_1_plus_b_gives_error_and_bias_b(b in -0.9f32..2.0, seed in 0u64..) {
            let truth = noise(seed, 0.1, 0.5);
            let ours = truth.map(|p| Radiance(p.0.map(|v| v * (1.0 + b))));
            let e = removal(&ours, &truth, &everywhere()).unwrap();
            prop_assert!((e.relative - f64::from(b.abs())).abs() < 1e-5);
            prop_assert!((e.energy_bias - f64::from(b)).abs() < 1e-5);
        }
    }
}

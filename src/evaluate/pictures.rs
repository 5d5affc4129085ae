//! False colour.

use crate::image::{Code, CodeImage, Image, Radiance, RadianceImage};

/// A map and the values at the ends of its legend.
#[derive(Debug, Clone)]
pub struct ErrorMap {
    /// The picture.
    pub image: CodeImage,
    /// Value at the left end.
    pub low: f32,
    /// Value at the right end.
    pub high: f32,
    /// Colours from left to right, sRGB codes.
    pub colours: &'static [[f32; 3]],
}

/// Blue, white, red (ColorBrewer RdBu).
const DIVERGING: &[[f32; 3]] =
    &[[0.02, 0.19, 0.38], [0.26, 0.58, 0.76], [0.97, 0.97, 0.97], [0.84, 0.38, 0.30], [0.40, 0.0, 0.12]];
/// Black to pale yellow (matplotlib's magma).
const SEQUENTIAL: &[[f32; 3]] =
    &[[0.0, 0.0, 0.02], [0.32, 0.07, 0.49], [0.72, 0.22, 0.47], [0.99, 0.55, 0.39], [0.99, 0.99, 0.75]];

/// Signed luminance: blue where ours removes too little, red where too much; the ends at ± `range`.
pub fn error_map(error: &RadianceImage, range: f32) -> ErrorMap {
    ErrorMap { image: colour(error, -range, range, DIVERGING), low: -range, high: range, colours: DIVERGING }
}

/// Luminance from 0 to `range`.
pub fn removal_map(removed: &RadianceImage, range: f32) -> ErrorMap {
    ErrorMap { image: colour(removed, 0.0, range, SEQUENTIAL), low: 0.0, high: range, colours: SEQUENTIAL }
}

/// Stops that a frame says more than the merged picture: blue less, red more; the ends at ± `range`.
pub fn residual_map(stops: &Image<f32>, range: f32) -> ErrorMap {
    error_map(&stops.map(|v| Radiance([*v; 3])), range)
}

/// A count at each pixel, from 0 to the largest.
pub fn count_map(counts: &Image<f32>) -> ErrorMap {
    let most = counts.pixels().iter().copied().fold(1.0, f32::max);
    removal_map(&counts.map(|v| Radiance([*v; 3])), most)
}

/// The magnitude that all but one in 200 non-zero luminances stay below; 1 for a black picture.
pub fn range(image: &RadianceImage) -> f32 {
    let mut values: Vec<f32> =
        image.pixels().iter().map(|p| p.luminance().abs()).filter(|v| *v > 1e-6).collect();
    if values.is_empty() {
        return 1.0;
    }
    let at = (values.len() - 1) * 199 / 200;
    *values.select_nth_unstable_by(at, f32::total_cmp).1
}

fn colour(image: &RadianceImage, low: f32, high: f32, colours: &[[f32; 3]]) -> CodeImage {
    image.map(|p| {
        let at = ((p.luminance() - low) / (high - low)).clamp(0.0, 1.0) * (colours.len() - 1) as f32;
        let i = (at as usize).min(colours.len() - 2);
        let t = at - i as f32;
        Code(std::array::from_fn(|k| colours[i][k] * (1.0 - t) + colours[i + 1][k] * t))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_error_is_white_and_signs_differ() {
        let image = Image::from_pixels(4, 1, [0.0, -9.0, 9.0, 0.5].map(|v| Radiance([v; 3])).to_vec());
        let map = error_map(&image, 1.0).image;
        assert_eq!(map.at(0, 0).0, DIVERGING[2]);
        assert!(map.at(1, 0).0[2] > map.at(1, 0).0[0] && map.at(2, 0).0[0] > map.at(2, 0).0[2]);
        assert_eq!(range(&image), 9.0);
        assert_eq!(removal_map(&image, 1.0).image.at(1, 0).0, SEQUENTIAL[0]);
    }
}

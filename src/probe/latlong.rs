//! Equirectangular environments by the OpenEXR `latlong` convention: +Y at the top row, the image centre looks
//! along +Z, longitude grows to the left.

use crate::image::{Image, Radiance, RadianceImage};
use glam::Vec3;
use std::f32::consts::{PI, TAU};

/// Unit direction in the world seen at continuous pixel `(x, y)` of a `width × height` map.
pub fn direction(x: f32, y: f32, width: usize, height: usize) -> Vec3 {
    let longitude = PI - TAU * x / width as f32;
    let latitude = PI / 2.0 - PI * y / height as f32;
    let (sin_lon, cos_lon) = longitude.sin_cos();
    let (sin_lat, cos_lat) = latitude.sin_cos();
    Vec3::new(sin_lon * cos_lat, sin_lat, cos_lon * cos_lat)
}

/// Continuous pixel of a unit direction; inverse of [`direction`].
pub fn pixel(direction: Vec3, width: usize, height: usize) -> (f32, f32) {
    let longitude = direction.x.atan2(direction.z);
    let latitude = direction.y.clamp(-1.0, 1.0).asin();
    ((PI - longitude) / TAU * width as f32, (PI / 2.0 - latitude) / PI * height as f32)
}

/// The four texels around a unit direction, by their places in the map, with their bilinear weights; around the seam, not over the
/// poles.
pub fn neighbours(direction: Vec3, width: usize, height: usize) -> [(usize, f32); 4] {
    let (x, y) = pixel(direction, width, height);
    let (fx, fy) = (x - 0.5, (y - 0.5).clamp(0.0, (height - 1) as f32));
    let (ax, ay) = (fx - fx.floor(), fy - fy.floor());
    let column = |k: i64| (fx.floor() as i64 + k).rem_euclid(width as i64) as usize;
    let row = |k: usize| (fy as usize + k).min(height - 1);
    let at = |i: i64, j: usize| row(j) * width + column(i);
    [
        (at(0, 0), (1.0 - ax) * (1.0 - ay)),
        (at(1, 0), ax * (1.0 - ay)),
        (at(0, 1), (1.0 - ax) * ay),
        (at(1, 1), ax * ay),
    ]
}

/// Radiance towards a unit direction, between the texels around it.
pub fn lookup(map: &RadianceImage, direction: Vec3) -> Radiance {
    let mut sum = [0.0; 3];
    for (i, weight) in neighbours(direction, map.width(), map.height()) {
        (0..3).for_each(|k| sum[k] += weight * map.pixels()[i].0[k]);
    }
    Radiance(sum)
}

/// The map turned about its vertical: column `x` shows what column `x + columns` showed. Rows stay what they are, no light is lost.
pub fn turned(map: &RadianceImage, columns: f64) -> RadianceImage {
    let (w, h) = map.size();
    let (whole, part) = (columns.floor(), (columns - columns.floor()) as f32);
    let first = (whole as i64).rem_euclid(w as i64) as usize;
    Image::from_fn(w, h, |x, y| {
        let (a, b) = (map.at((first + x) % w, y).0, map.at((first + x + 1) % w, y).0);
        Radiance([0, 1, 2].map(|k| a[k] + (b[k] - a[k]) * part))
    })
}

/// Solid angle of each texel in row `y`, sr; exact, so that a whole map sums to 4π.
pub fn texel_solid_angle(y: usize, width: usize, height: usize) -> f64 {
    let edge =
        |row: usize| (std::f64::consts::FRAC_PI_2 - std::f64::consts::PI * row as f64 / height as f64).sin();
    (edge(y) - edge(y + 1)) * std::f64::consts::TAU / width as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn centre_looks_along_z_and_top_is_up() {
        assert!((direction(64.0, 32.0, 128, 64) - Vec3::Z).length() < 1e-6);
        assert!((direction(10.0, 0.0, 128, 64) - Vec3::Y).length() < 1e-6);
        assert!((direction(32.0, 32.0, 128, 64) - Vec3::X).length() < 1e-6, "longitude grows to the left");
    }

    #[test]
    fn a_lookup_goes_around_the_seam() {
        let map = Image::from_fn(64, 32, |x, _| Radiance([if x == 0 { 4.0 } else { 2.0 }; 3]));
        // Between the last column and the first one.
        assert!((lookup(&map, direction(0.0, 16.0, 64, 32)).0[0] - 3.0).abs() < 1e-3);
        assert!((lookup(&map, direction(64.0, 16.0, 64, 32)).0[0] - 3.0).abs() < 1e-3);
    }

    #[test]
    fn texels_cover_the_sphere() {
        let sum: f64 = (0..37).map(|y| 53.0 * texel_solid_angle(y, 53, 37)).sum();
        assert!((sum - 4.0 * std::f64::consts::PI).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn neighbours_share_a_direction(x in 0.0..64.0f32, y in 0.5..31.5f32) {
            let found = neighbours(direction(x, y, 64, 32), 64, 32);
            prop_assert!((found.iter().map(|n| n.1).sum::<f32>() - 1.0).abs() < 1e-5);
            let towards = |i: usize| direction((i % 64) as f32 + 0.5, (i / 64) as f32 + 0.5, 64, 32);
            let mean: Vec3 = found.iter().map(|(i, weight)| towards(*i) * *weight).sum();
            prop_assert!(mean.angle_between(direction(x, y, 64, 32)) < 0.02, "{x}, {y}");
        }

        #[test]
        fn pixel_inverts_direction(x in 0.01..255.9f32, y in 0.5..127.5f32) {
            let (px, py) = pixel(direction(x, y, 256, 128), 256, 128);
            prop_assert!((px - x).abs() < 0.01 && (py - y).abs() < 0.01);
        }
    }
}

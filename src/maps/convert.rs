//! From one layout to another, by solid angle.

use super::{Layout, spherical_triangle};
use crate::image::{Image, Radiance, RadianceImage};
use glam::Vec3;
use rayon::prelude::*;

/// Parts of a texel along each side, at least and at most.
const PARTS: [usize; 2] = [4, 32];

/// A part of a texel: where it lies and how large it is.
fn parts(layout: Layout, size: (usize, usize), texel: usize, along: usize) -> Vec<(Vec3, f64)> {
    let at = |c: usize, k: usize| c as f32 + k as f32 / along as f32;
    let (x, y) = (texel % size.0, texel / size.0);
    let n = along + 1;
    let corners: Vec<Vec3> =
        (0..n * n).map(|i| layout.corner(texel, at(x, i % n), at(y, i / n), size)).collect();
    (0..along * along)
        .filter_map(|i| {
            let first = i / along * n + i % along;
            let [a, b, c, d] = [0, 1, n + 1, n].map(|k| corners[first + k]);
            let solid_angle = spherical_triangle(a, b, c) + spherical_triangle(a, c, d);
            (solid_angle > 0.0).then(|| ((a + b + c + d).normalize_or(a), solid_angle))
        })
        .collect()
}

/// ∫ L dΩ of a picture, for each channel.
pub fn power(map: &RadianceImage, layout: Layout) -> [f64; 3] {
    let size = map.size();
    let texels = map.pixels().par_iter().enumerate().map(|(i, l)| {
        let angle: f64 = parts(layout, size, i, PARTS[0]).iter().map(|(_, a)| a).sum();
        l.0.map(|v| f64::from(v) * angle)
    });
    texels.reduce(|| [0.0; 3], |a, b| std::array::from_fn(|k| a[k] + b[k]))
}

/// A picture in another layout, `height` px high. Texels into which no part falls take the radiance of their direction. What is
/// left of rounding, a fraction of a per cent, is scaled away over the whole.
pub fn convert(map: &RadianceImage, from: Layout, to: Layout, height: usize) -> RadianceImage {
    let (size, target) = (map.size(), to.size(height));
    // Several parts for every texel of the target, in each direction.
    let finer = (target.0 * target.1) as f64 / (size.0 * size.1) as f64;
    let along = ((4.0 * finer.sqrt()).ceil() as usize).clamp(PARTS[0], PARTS[1]);
    let given: Vec<Vec<(u32, f64)>> = (0..map.pixels().len())
        .into_par_iter()
        .map(|i| {
            let parts = parts(from, size, i, along).into_iter();
            parts.map(|(d, angle)| (to.texel(d, target) as u32, angle)).collect()
        })
        .collect();
    let mut sums = vec![[0.0f64; 4]; target.0 * target.1];
    for (radiance, parts) in map.pixels().iter().zip(&given) {
        for (texel, angle) in parts {
            let sum = &mut sums[*texel as usize];
            (0..3).for_each(|k| sum[k] += f64::from(radiance.0[k]) * angle);
            sum[3] += angle;
        }
    }
    let mut made = Image::from_fn(target.0, target.1, |x, y| {
        let sum = sums[y * target.0 + x];
        if sum[3] > 0.0 {
            return Radiance([0, 1, 2].map(|k| (sum[k] / sum[3]) as f32));
        }
        map.pixels()[from.texel(to.direction(x as f32 + 0.5, y as f32 + 0.5, target), size)]
    });
    let (there, here) = (power(map, from), power(&made, to));
    let scale: [f64; 3] = std::array::from_fn(|k| if here[k] > 0.0 { there[k] / here[k] } else { 1.0 });
    made.pixels_mut().iter_mut().for_each(|p| (0..3).for_each(|k| p.0[k] *= scale[k] as f32));
    made
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    /// A dim gradient and a lamp some texels wide.
    fn scene(d: Vec3, lamp: Vec3) -> [f32; 3] {
        let l = if d.angle_between(lamp) < 0.12 { 80.0 } else { 0.4 + 0.3 * d.y };
        [l, 1.0 + 0.5 * d.x, 0.2]
    }

    fn draw(layout: Layout, height: usize, lamp: Vec3) -> RadianceImage {
        let size = layout.size(height);
        Image::from_fn(size.0, size.1, |x, y| {
            Radiance(scene(layout.direction(x as f32 + 0.5, y as f32 + 0.5, size), lamp))
        })
    }

    /// Direction of all light in the first channel above 10.
    fn centroid(map: &RadianceImage, layout: Layout) -> Vec3 {
        let size = map.size();
        let sum: Vec3 = (0..size.0 * size.1)
            .filter(|i| map.pixels()[*i].0[0] > 10.0)
            .flat_map(|i| parts(layout, size, i, 4).into_iter().map(move |(d, a)| d * a as f32))
            .sum();
        sum.normalize()
    }

    #[test]
    fn texels_cover_the_sphere() {
        for layout in Layout::ALL {
            let size = layout.size(24);
            let ones = Image::from_fn(size.0, size.1, |_, _| Radiance([1.0; 3]));
            let all = power(&ones, layout)[0];
            assert!((all / (4.0 * PI) - 1.0).abs() < 1e-4, "{layout:?}: {all}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn light_is_kept_and_stays_where_it_was(
            x in -1.0f32..1.0, y in -1.0f32..1.0, z in -0.8f32..1.0,
            pair in 0usize..16, from in 2usize..6, to in 2usize..6
        ) {
            let lamp = Vec3::new(x, y, z).normalize_or(Vec3::Y);
            let (a, b) = (Layout::ALL[pair / 4], Layout::ALL[pair % 4]);
            let map = draw(a, 16 * from, lamp);
            let made = convert(&map, a, b, 16 * to);
            let (there, here) = (power(&map, a), power(&made, b));
            for k in 0..3 {
                prop_assert!((here[k] / there[k] - 1.0).abs() < 1e-3, "{a:?} {b:?} {}", here[k] / there[k]);
            }
            let off = centroid(&made, b).angle_between(centroid(&map, a));
            // Of the coarsest texel seen here; a sphere's are large away from its middle.
            prop_assert!(off < 0.1, "{a:?} {b:?} {off}");
        }
    }

    #[test]
    fn a_round_trip_keeps_smooth_light() {
        let map = draw(Layout::Latlong, 64, Vec3::new(0.3, 0.6, 0.4).normalize());
        for layout in [Layout::Cube, Layout::Octahedral] {
            let there = convert(&map, Layout::Latlong, layout, 64);
            let back = convert(&there, layout, Layout::Latlong, 64);
            for (a, b) in map.pixels().iter().zip(back.pixels()) {
                assert!((a.0[1] - b.0[1]).abs() < 0.05, "{layout:?} {} {}", a.0[1], b.0[1]);
            }
        }
    }
}

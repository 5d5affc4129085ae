//! Radiance by direction on the faces of a cube: what a dome of lights takes its colours from (supan2006, §V.C).

use crate::image::{Radiance, RadianceImage};
use crate::probe::latlong;
use glam::Vec3;
use rayon::prelude::*;

/// Parts along a texel's edge that move each for itself where a cube is seen from elsewhere.
const PARTS: usize = 2;
/// Nobody stands farther out in a room than by this share of its light's distance.
const INSIDE: f32 = 0.9;

/// Number of faces: +x, −x, +y, −y, +z, −z.
pub const FACES: usize = 6;

/// Forward, right and down of each face, seen from inside.
const AXES: [[Vec3; 3]; FACES] = [
    [Vec3::X, Vec3::NEG_Z, Vec3::NEG_Y],
    [Vec3::NEG_X, Vec3::Z, Vec3::NEG_Y],
    [Vec3::Y, Vec3::X, Vec3::Z],
    [Vec3::NEG_Y, Vec3::X, Vec3::NEG_Z],
    [Vec3::Z, Vec3::X, Vec3::NEG_Y],
    [Vec3::NEG_Z, Vec3::NEG_X, Vec3::NEG_Y],
];

/// A cube map of `side`² texels a face, each with the mean radiance over its solid angle.
#[derive(Debug, Clone, PartialEq)]
pub struct CubeMap {
    side: usize,
    texels: Vec<Radiance>,
}

/// Unit direction of a place on a face, `u` to the right and `v` down, −1..1.
pub fn direction(face: usize, u: f32, v: f32) -> Vec3 {
    let [forward, right, down] = AXES[face];
    (forward + right * u + down * v).normalize()
}

/// Face and place of a direction; inverse of [`direction`].
pub fn place(direction: Vec3) -> (usize, f32, f32) {
    let a = direction.abs();
    let (axis, along) = if a.x >= a.y && a.x >= a.z {
        (0, direction.x)
    } else if a.y >= a.z {
        (2, direction.y)
    } else {
        (4, direction.z)
    };
    let face = axis + usize::from(along < 0.0);
    let [forward, right, down] = AXES[face];
    let depth = direction.dot(forward);
    (face, direction.dot(right) / depth, direction.dot(down) / depth)
}

/// Solid angle of the part `u0..u1` × `v0..v1` of a face, sr; exact, so that the cube has 4π.
pub fn solid_angle([u0, u1]: [f64; 2], [v0, v1]: [f64; 2]) -> f64 {
    let corner = |u: f64, v: f64| (u * v).atan2((u * u + v * v + 1.0).sqrt());
    corner(u1, v1) - corner(u0, v1) - corner(u1, v0) + corner(u0, v0)
}

/// Solid angles of a face's texels, sr.
fn solid_angles(side: usize) -> Vec<f64> {
    let span = |k: usize| [edge(k, side), edge(k + 1, side)];
    (0..side * side).map(|i| solid_angle(span(i % side), span(i / side))).collect()
}

/// Place of a texel's edge on its face.
fn edge(i: usize, side: usize) -> f64 {
    2.0 * i as f64 / side as f64 - 1.0
}

impl CubeMap {
    /// Evaluates radiance at the middle of every texel.
    pub fn from_fn(side: usize, radiance: impl Fn(Vec3) -> [f32; 3]) -> Self {
        let texels = (0..FACES * side * side).map(|i| Radiance(radiance(middle(i, side)))).collect();
        Self { side, texels }
    }

    /// From a `latlong` map, with all its power.
    pub fn from_latlong(map: &RadianceImage, side: usize) -> Self {
        let (w, h) = map.size();
        // Enough parts of each texel for several to fall into every texel of the cube.
        let parts = (16 * side).div_ceil(w).clamp(3, 32);
        let mut sums = Sums::new(side);
        for (i, radiance) in map.pixels().iter().enumerate() {
            let (x, y) = (i % w, i / w);
            for t in 0..parts {
                let row = y * parts + t;
                let solid_angle = latlong::texel_solid_angle(row, w * parts, h * parts);
                for s in 0..parts {
                    let at = |k: usize, i: usize| k as f32 + (i as f32 + 0.5) / parts as f32;
                    sums.add(latlong::direction(at(x, s), at(y, t), w, h), radiance.0, solid_angle);
                }
            }
        }
        sums.finish()
    }

    /// Texels along an edge.
    pub fn side(&self) -> usize {
        self.side
    }

    /// All texels, face by face, row by row.
    pub fn texels(&self) -> &[Radiance] {
        &self.texels
    }

    /// Unit direction and solid angle (sr) of texel `i`.
    pub fn texel(&self, i: usize) -> (Vec3, f64) {
        let (x, y) = (i % self.side, i / self.side % self.side);
        let span = |k: usize| [edge(k, self.side), edge(k + 1, self.side)];
        (middle(i, self.side), solid_angle(span(x), span(y)))
    }

    /// ∫ L dΩ, for each channel.
    pub fn power(&self) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for (i, radiance) in self.texels.iter().enumerate() {
            let (_, solid_angle) = self.texel(i);
            (0..3).for_each(|k| sum[k] += f64::from(radiance.0[k]) * solid_angle);
        }
        sum
    }

    /// Irradiance on a surface of unit normal, all of it seen.
    pub fn irradiance(&self, normal: Vec3) -> [f32; 3] {
        let (mut sum, angles) = ([0.0f64; 3], solid_angles(self.side));
        for (i, radiance) in self.texels.iter().enumerate() {
            let direction = middle(i, self.side);
            let weight = f64::from(direction.dot(normal).max(0.0)) * angles[i % angles.len()];
            (0..3).for_each(|k| sum[k] += f64::from(radiance.0[k]) * weight);
        }
        sum.map(|v| v as f32)
    }

    /// Irradiance on surfaces of all normals, by normal, all of the cube seen.
    pub fn irradiance_map(&self, side: usize) -> Self {
        let angles = solid_angles(self.side);
        let sent: Vec<(Vec3, f64, [f64; 3])> = (0..self.texels.len())
            .map(|i| (middle(i, self.side), angles[i % angles.len()], self.texels[i].0.map(f64::from)))
            .collect();
        let at = |i| {
            let normal = middle(i, side);
            let mut sum = [0.0f64; 3];
            for (direction, solid_angle, radiance) in &sent {
                let weight = f64::from(direction.dot(normal).max(0.0)) * solid_angle;
                (0..3).for_each(|k| sum[k] += radiance[k] * weight);
            }
            Radiance(sum.map(|v| v as f32))
        };
        Self { side, texels: (0..FACES * side * side).into_par_iter().map(at).collect() }
    }

    /// The same light as it is seen from a place `by` (m) away, all of it standing at a distance (m) from where the cube was
    /// seen, or nearly so far away if that is nearer.
    pub fn seen_from(&self, by: Vec3, distance_m: f32) -> Self {
        let by = by.clamp_length_max(INSIDE * distance_m);
        let (side, mut sums) = (self.side * PARTS, Sums::new(self.side));
        let angles = solid_angles(side);
        for i in 0..FACES * side * side {
            let (x, y, face) = (i % side, i / side % side, i / (side * side));
            let Radiance(radiance) = self.texels[(face * self.side + y / PARTS) * self.side + x / PARTS];
            let direction = middle(i, side);
            let way = direction * distance_m - by;
            let away = way.length();
            // The shell's part and how obliquely it is seen.
            let seen = distance_m.powi(2) * way.dot(direction) / away.powi(3);
            sums.add(way / away, radiance, angles[i % angles.len()] * f64::from(seen));
        }
        sums.finish()
    }

    /// The mean of every `factor`² texels, by solid angle; `side` must be a multiple of `factor`.
    pub fn downsampled(&self, factor: usize) -> Self {
        let mut sums = Sums::new((self.side / factor.max(1)).max(1));
        let angles = solid_angles(self.side);
        for (i, radiance) in self.texels.iter().enumerate() {
            sums.add(middle(i, self.side), radiance.0, angles[i % angles.len()]);
        }
        sums.finish()
    }

    /// Every texel by a function of its radiance.
    pub fn map(&self, f: impl Fn([f32; 3]) -> [f32; 3]) -> Self {
        Self { side: self.side, texels: self.texels.iter().map(|t| Radiance(f(t.0))).collect() }
    }

    /// Bilinear lookup, continued over the face's edge by the neighbouring face's nearest texel.
    pub fn bilinear(&self, direction: Vec3) -> [f32; 3] {
        let (face, u, v) = place(direction);
        let at = |p: f32| (p + 1.0) / 2.0 * self.side as f32 - 0.5;
        let (x, y) = (at(u), at(v));
        let (ax, ay) = (x - x.floor(), y - y.floor());
        let mut sum = [0.0; 3];
        for (dx, dy, weight) in [
            (0.0, 0.0, (1.0 - ax) * (1.0 - ay)),
            (1.0, 0.0, ax * (1.0 - ay)),
            (0.0, 1.0, (1.0 - ax) * ay),
            (1.0, 1.0, ax * ay),
        ] {
            let back = |p: f32, d: f32| 2.0 * (p.floor() + d + 0.5) / self.side as f32 - 1.0;
            let texel = self.nearest(self::direction(face, back(x, dx), back(y, dy)));
            (0..3).for_each(|k| sum[k] += weight * texel[k]);
        }
        sum
    }

    /// Radiance of the texel that holds a direction.
    pub fn nearest(&self, direction: Vec3) -> [f32; 3] {
        self.texels[self.index(direction)].0
    }

    /// The texel that holds a direction.
    pub fn index(&self, direction: Vec3) -> usize {
        index(direction, self.side)
    }
}

/// Unit direction of the middle of texel `i`.
pub(crate) fn middle(i: usize, side: usize) -> Vec3 {
    let (x, y, face) = (i % side, i / side % side, i / (side * side));
    let at = |k: usize| (2.0 * k as f32 + 1.0) / side as f32 - 1.0;
    direction(face, at(x), at(y))
}

/// The texel that holds a direction.
pub(crate) fn index(direction: Vec3, side: usize) -> usize {
    let (face, u, v) = place(direction);
    let at = |p: f32| (((p + 1.0) / 2.0 * side as f32) as usize).min(side - 1);
    (face * side + at(v)) * side + at(u)
}

/// Power and solid angle that have fallen into each texel of a cube.
pub struct Sums {
    side: usize,
    power: Vec<[f64; 3]>,
    solid_angle: Vec<f64>,
}

impl Sums {
    /// Nothing yet.
    pub fn new(side: usize) -> Self {
        let count = FACES * side * side;
        Self { side, power: vec![[0.0; 3]; count], solid_angle: vec![0.0; count] }
    }

    /// Adds radiance seen in a unit direction over a solid angle, sr.
    pub fn add(&mut self, direction: Vec3, radiance: [f32; 3], solid_angle: f64) {
        let i = index(direction, self.side);
        (0..3).for_each(|k| self.power[i][k] += f64::from(radiance[k]) * solid_angle);
        self.solid_angle[i] += solid_angle;
    }

    /// Share of the sphere that was added.
    pub fn covered(&self) -> f64 {
        self.solid_angle.iter().sum::<f64>() / (4.0 * std::f64::consts::PI)
    }

    /// Means by texel. One into which nothing fell takes that of the smallest square around it that got something; what did
    /// fall in keeps its power, exactly: the means are scaled to it.
    pub fn finish(&self) -> CubeMap {
        let mut levels = vec![(self.side, self.power.clone(), self.solid_angle.clone())];
        while levels.last().is_some_and(|(side, ..)| side % 2 == 0) {
            let (side, power, angle) = &levels[levels.len() - 1];
            let half = side / 2;
            let (mut p, mut a) = (vec![[0.0; 3]; FACES * half * half], vec![0.0; FACES * half * half]);
            for i in 0..power.len() {
                let (x, y, face) = (i % side, i / side % side, i / (side * side));
                let above = (face * half + y / 2) * half + x / 2;
                (0..3).for_each(|k| p[above][k] += power[i][k]);
                a[above] += angle[i];
            }
            levels.push((half, p, a));
        }
        let all: f64 = self.solid_angle.iter().sum();
        let mean = |power: &[f64; 3], angle: f64| power.map(|v| (v / angle) as f32);
        let everywhere = [0, 1, 2].map(|k| self.power.iter().map(|p| p[k]).sum::<f64>() / all.max(1e-12));
        let texel = |i: usize| {
            let (x, y, face) = (i % self.side, i / self.side % self.side, i / (self.side * self.side));
            let found = levels.iter().enumerate().find_map(|(level, (side, power, angle))| {
                let at = (face * side + (y >> level)) * side + (x >> level);
                (angle[at] > 1e-9).then(|| mean(&power[at], angle[at]))
            });
            Radiance(found.unwrap_or(everywhere.map(|v| v as f32)))
        };
        let mut cube = CubeMap { side: self.side, texels: (0..self.power.len()).map(texel).collect() };
        let mut seen = [0.0f64; 3];
        let angles = solid_angles(self.side);
        for (i, radiance) in cube.texels.iter().enumerate().filter(|(i, _)| self.solid_angle[*i] > 1e-9) {
            let angle = angles[i % angles.len()];
            (0..3).for_each(|k| seen[k] += f64::from(radiance.0[k]) * angle);
        }
        let scale = [0, 1, 2].map(|k| {
            let fell: f64 = self.power.iter().map(|p| p[k]).sum();
            if seen[k] > 0.0 { (fell / seen[k]) as f32 } else { 1.0 }
        });
        let fell = self.solid_angle.iter().map(|angle| *angle > 1e-9);
        for (texel, _) in cube.texels.iter_mut().zip(fell).filter(|(_, fell)| *fell) {
            (0..3).for_each(|k| texel.0[k] *= scale[k]);
        }
        cube
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_room_is_seen_from_another_place_in_it() {
        let (distance, by) = (2.0, Vec3::new(0.5, -0.2, 0.3));
        let room = |d: Vec3| [1.0 + 0.5 * d.x, 1.0 - 0.5 * d.z, 1.0];
        let found = CubeMap::from_fn(32, room).seen_from(by, distance);
        for i in 0..found.texels().len() {
            let d = found.texel(i).0;
            // Where a ray from there meets the shell.
            let along = d.dot(by);
            let t = -along + (along * along + distance * distance - by.length_squared()).sqrt();
            let truth = room((by + d * t) / distance);
            assert!((0..3).all(|k| (found.texels()[i].0[k] - truth[k]).abs() < 0.05), "{d}");
        }
        assert!((found.power()[2] / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn a_map_of_irradiance_has_that_of_each_normal() {
        let cube = CubeMap::from_fn(8, |d| [1.0 + d.x, 1.0 + d.y * d.z, 0.3]);
        let map = cube.irradiance_map(6);
        for i in 0..map.texels().len() {
            let exact = cube.irradiance(map.texel(i).0);
            assert!((0..3).all(|k| (map.texels()[i].0[k] - exact[k]).abs() < 1e-6));
        }
    }
    use crate::image::Image;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    proptest! {
        #[test]
        fn place_inverts_direction(face in 0..FACES, u in -0.999f32..0.999, v in -0.999f32..0.999) {
            let (f, a, b) = place(direction(face, u, v));
            prop_assert!(f == face && (a - u).abs() < 1e-4 && (b - v).abs() < 1e-4);
        }

        #[test]
        fn a_latlong_map_keeps_its_power(lamp in 0usize..64 * 32, bright in 1.0..1e4f32, side in 2usize..5) {
            let map = Image::from_fn(64, 32, |x, y| {
                let l = if y * 64 + x == lamp { bright } else { 1.0 };
                Radiance([l, 0.5 + 0.01 * x as f32, 0.2])
            });
            let there = |k: usize| (0..64 * 32).map(|i| {
                f64::from(map.pixels()[i].0[k]) * latlong::texel_solid_angle(i / 64, 64, 32)
            }).sum::<f64>();
            let cube = CubeMap::from_latlong(&map, 8 << (side - 2));
            let power = cube.power();
            for (k, power) in power.iter().enumerate() {
                prop_assert!((power / there(k) - 1.0).abs() < 1e-4, "{} {}", power, there(k));
            }
        }
    }

    #[test]
    fn texels_cover_the_sphere() {
        let cube = CubeMap::from_fn(7, |_| [1.0; 3]);
        let all: f64 = (0..cube.texels().len()).map(|i| cube.texel(i).1).sum();
        assert!((all - 4.0 * PI).abs() < 1e-9);
        let half = cube.irradiance(Vec3::new(0.3, 0.5, -0.2).normalize());
        assert!((f64::from(half[0]) / PI - 1.0).abs() < 0.02, "{half:?}");
    }

    #[test]
    fn downsampling_keeps_the_power_and_lookups_run_over_edges() {
        let cube = CubeMap::from_fn(16, |d| [1.0 + d.x, 2.0 + d.y * d.z, 0.5]);
        for factor in [2, 4, 8] {
            let small = cube.downsampled(factor);
            for (a, b) in small.power().iter().zip(cube.power()) {
                assert!((a / b - 1.0).abs() < 1e-6, "{a} {b}");
            }
        }
        for i in 0..500 {
            let (a, b) = (i as f32 * 2.399, (i as f32 + 0.5) / 250.0 - 1.0);
            let r = (1.0 - b * b).sqrt();
            let d = Vec3::new(r * a.cos(), b, r * a.sin());
            assert!((cube.bilinear(d)[0] - 1.0 - d.x).abs() < 0.08, "{d}");
        }
    }

    #[test]
    fn what_was_not_seen_is_like_what_is_near() {
        let mut sums = Sums::new(16);
        let whole = CubeMap::from_fn(16, |d| if d.x > 0.0 { [3.0; 3] } else { [1.0; 3] });
        for (i, radiance) in whole.texels().iter().enumerate() {
            let (d, angle) = whole.texel(i);
            if d.dot(Vec3::NEG_X) < 0.95 {
                sums.add(d, radiance.0, angle);
            }
        }
        let cube = sums.finish();
        assert!(sums.covered() < 0.98);
        assert!((cube.bilinear(Vec3::NEG_X)[0] - 1.0).abs() < 1e-3);
        assert!((cube.bilinear(Vec3::X)[0] - 3.0).abs() < 1e-3);
    }
}

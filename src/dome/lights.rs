//! A light for every texel of a coarse cube map (supan2006, §V.C), and what the paper leaves open: lights that stand where
//! their texel is bright, and more of them where one is too few.

use super::cube::{CubeMap, FACES, solid_angle};
use crate::illuminate::distant::{Stratum, weight};
use crate::illuminate::patch::DistantSource;
use crate::image::luminance;
use glam::{DVec3, Vec3};
use std::collections::BTreeSet;
use std::f64::consts::PI;

/// How a dome is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Texels along a face's edge before any is split, a divisor of the environment's.
    pub texels: usize,
    /// Lights stand at the centroid of their texel's brightness; in the paper, in its middle.
    pub centroid: bool,
    /// So many texels are parted into four, those first whose light stands worst for what it is the light of.
    pub splits: usize,
}

/// A square of texels of the environment's cube.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Cell {
    face: usize,
    x: usize,
    y: usize,
    size: usize,
}

/// One light of the dome, at infinity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DomeLight {
    /// What of the environment it stands for.
    pub cell: Cell,
    /// Its direction, and the cell's solid angle and mean radiance.
    pub source: DistantSource,
    /// Solid angle of the cap over which the cell's brightness is spread about it, sr.
    pub extent_sr: f32,
    /// Power × rms of the angle between the light and what it stands for: the shadow's error.
    error: f64,
}

impl DomeLight {
    /// Irradiance on what faces it.
    pub fn power(&self) -> [f32; 3] {
        self.source.radiance.map(|l| l * self.source.solid_angle_sr)
    }

    pub(super) fn stratum(&self) -> Stratum {
        Stratum { source: self.source, extent_sr: self.extent_sr }
    }
}

/// A texel that is split stays so until others need it more by this factor: lights that come and go would flicker.
const STAY: f64 = 1.5;

/// The lights of an environment, dark ones left out. `kept` are the cells that were split in the frame before, and become
/// those of this one.
pub fn lights(environment: &CubeMap, layout: Layout, kept: &mut BTreeSet<Cell>) -> Vec<DomeLight> {
    let side = environment.side();
    let size = (side / layout.texels.max(1)).max(1);
    let across = side / size;
    let cells = (0..FACES * across * across).map(|i| Cell {
        face: i / (across * across),
        x: i % across * size,
        y: i / across % across * size,
        size,
    });
    let light = |cell| light(environment, cell, layout.centroid);
    let mut lights: Vec<DomeLight> = cells.map(light).collect();
    let mut split = BTreeSet::new();
    for _ in 0..layout.splits {
        let urgency = |l: &DomeLight| l.error * if kept.contains(&l.cell) { STAY } else { 1.0 };
        let parted = |l: &&(usize, &DomeLight)| l.1.cell.size > 1 && l.1.error > 0.0;
        let worst = lights.iter().enumerate().collect::<Vec<_>>();
        let worst = worst.iter().filter(parted).max_by(|a, b| urgency(a.1).total_cmp(&urgency(b.1)));
        let Some(&(i, _)) = worst else { break };
        let cell = lights.swap_remove(i).cell;
        split.insert(cell);
        lights.extend(cell.quarters().map(light));
    }
    *kept = split;
    lights.retain(|l| l.source.radiance.iter().any(|v| *v > 0.0));
    lights.sort_by_key(|l| l.cell);
    lights
}

/// Leaves out the lights below the horizon of all receivers, given by their unit normals.
pub fn above(lights: Vec<DomeLight>, normals: &[Vec3]) -> Vec<DomeLight> {
    lights.into_iter().filter(|l| normals.iter().any(|n| n.dot(l.source.direction) > 0.0)).collect()
}

/// Irradiance of lights on a surface of unit normal.
pub fn irradiance(lights: &[DomeLight], normal: Vec3) -> [f32; 3] {
    let mut sum = [0.0; 3];
    for light in lights {
        let (cos, power) = (normal.dot(light.source.direction).max(0.0), light.power());
        (0..3).for_each(|k| sum[k] += cos * power[k]);
    }
    sum
}

/// The `count` lights that send most, in the order of their cells.
pub fn strongest(mut lights: Vec<DomeLight>, count: usize) -> Vec<DomeLight> {
    let sent = |l: &DomeLight| luminance(l.power());
    lights.sort_by(|a, b| sent(b).total_cmp(&sent(a)));
    lights.truncate(count);
    lights.sort_by_key(|l| l.cell);
    lights
}

impl Cell {
    /// Its texels of a cube of some side.
    pub(super) fn texels(self, side: usize) -> impl Iterator<Item = usize> {
        let Self { face, x, y, size } = self;
        (y..y + size).flat_map(move |v| (x..x + size).map(move |u| (face * side + v) * side + u))
    }

    fn quarters(self) -> [Self; 4] {
        let size = self.size / 2;
        [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| Self {
            x: self.x + i * size,
            y: self.y + j * size,
            size,
            ..self
        })
    }
}

fn light(environment: &CubeMap, cell: Cell, centroid: bool) -> DomeLight {
    let side = environment.side();
    let (mut power, mut moment, mut all) = ([0.0; 3], DVec3::ZERO, 0.0);
    let mut texel_sr = 0.0;
    for i in cell.texels(side) {
        let (direction, solid_angle) = environment.texel(i);
        let sent = environment.texels()[i].0.map(|l| f64::from(l.max(0.0)) * solid_angle);
        let sent_weight = weight(&sent);
        (0..3).for_each(|k| power[k] += sent[k]);
        moment += direction.as_dvec3() * sent_weight;
        all += sent_weight;
        texel_sr += solid_angle * sent_weight;
    }
    let edge = |k: usize| 2.0 * k as f64 / side as f64 - 1.0;
    let span = |from: usize| [edge(from), edge(from + cell.size)];
    let solid_angle = solid_angle(span(cell.x), span(cell.y));
    let middle = |from: usize| (edge(from) + edge(from + cell.size)) as f32 / 2.0;
    let middle = super::cube::direction(cell.face, middle(cell.x), middle(cell.y));
    let direction = if centroid { moment.as_vec3().try_normalize().unwrap_or(middle) } else { middle };
    // Σ w |d − d₀|² = 2 (Σ w − d₀ · Σ w d).
    let spread = (2.0 * (1.0 - moment.dot(direction.as_dvec3()) / all.max(f64::MIN_POSITIVE))).max(0.0);
    // The mean direction of a cap of half angle α has length (1 + cos α)/2.
    let cap = 4.0 * PI * (1.0 - moment.length() / all.max(f64::MIN_POSITIVE)).max(0.0);
    DomeLight {
        cell,
        source: DistantSource {
            direction,
            solid_angle_sr: solid_angle as f32,
            radiance: power.map(|p| (p / solid_angle) as f32),
        },
        extent_sr: (cap + texel_sr / all.max(f64::MIN_POSITIVE)).min(solid_angle) as f32,
        error: all * spread.sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A dim sky with a small lamp in a direction.
    fn lamp(at: Vec3, side: usize) -> CubeMap {
        CubeMap::from_fn(side, |d| if d.dot(at) > 0.9985 { [900.0, 800.0, 600.0] } else { [0.5, 0.6, 0.7] })
    }

    fn made(environment: &CubeMap, centroid: bool, splits: usize) -> Vec<DomeLight> {
        lights(environment, Layout { texels: 4, centroid, splits }, &mut BTreeSet::new())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn the_dome_has_the_environments_energy(
            x in -1.0..1.0f32, y in -1.0..1.0f32, z in -1.0..1.0f32, texels in 0usize..4, splits in 0usize..30,
            centroid in any::<bool>(),
        ) {
            let environment = lamp(Vec3::new(x, y, z).try_normalize().unwrap_or(Vec3::Y), 32);
            let layout = Layout { texels: 1 << texels, centroid, splits };
            let lights = lights(&environment, layout, &mut BTreeSet::new());
            for (k, whole) in environment.power().iter().enumerate() {
                let sum: f64 = lights.iter().map(|l| f64::from(l.power()[k])).sum();
                prop_assert!((sum / whole - 1.0).abs() < 1e-5, "{} {}", sum, whole);
            }
            let sphere: f64 = lights.iter().map(|l| f64::from(l.source.solid_angle_sr)).sum();
            prop_assert!((sphere / (4.0 * PI) - 1.0).abs() < 1e-5);
            prop_assert!(lights.len() >= FACES << (2 * texels));
        }
    }

    #[test]
    fn a_small_lamp_is_found_where_it_is() {
        for at in [Vec3::new(0.35, 1.0, 0.2), Vec3::new(-0.9, 0.8, 0.1), Vec3::new(0.1, 0.6, -1.0)] {
            let environment = lamp(at.normalize(), 32);
            let off = |lights: &[DomeLight]| {
                let power = |l: &&DomeLight| l.power()[0];
                let brightest = lights.iter().max_by(|a, b| power(a).total_cmp(&power(b))).unwrap();
                brightest.source.direction.angle_between(at.normalize()).to_degrees()
            };
            let found = [(false, 0), (true, 0), (true, 8)].map(|(c, s)| off(&made(&environment, c, s)));
            assert!(found[1] < 0.5 * found[0].max(3.0), "at the centroid: {found:?}");
            // Parts of the lamp, which is 6° across.
            assert!(found[2] < 3.5, "split: {found:?}");
        }
    }

    #[test]
    fn half_of_a_dome_is_above_a_floor() {
        let sky = CubeMap::from_fn(16, |_| [1.0; 3]);
        let up = |texels| {
            let layout = Layout { texels, centroid: false, splits: 0 };
            above(lights(&sky, layout, &mut BTreeSet::new()), &[Vec3::Y]).len()
        };
        assert_eq!([up(2), up(4), up(8)], [12, 48, 192], "the paper's 48 lights are a dome of 4 × 4");
    }

    #[test]
    fn splits_stay_where_they_are_while_brightness_wavers() {
        let two = |a: f32, b: f32| {
            CubeMap::from_fn(32, move |d| {
                let near = |at: Vec3| d.dot(at.normalize()) > 0.97;
                match (near(Vec3::new(0.5, 1.0, 0.3)), near(Vec3::new(-0.6, 1.0, -0.4))) {
                    (true, _) => [a; 3],
                    (_, true) => [b; 3],
                    _ => [0.1; 3],
                }
            })
        };
        let layout = Layout { texels: 4, centroid: true, splits: 1 };
        let mut kept = BTreeSet::new();
        lights(&two(10.0, 9.0), layout, &mut kept);
        let before = kept.clone();
        lights(&two(9.0, 10.0), layout, &mut kept);
        assert_eq!(kept, before);
        lights(&two(3.0, 10.0), layout, &mut kept);
        assert_ne!(kept, before, "a lasting change is followed");
    }
}

//! Light from beyond the scene model: a small, very bright source (the sun) is split off first, the rest is cut into
//! cells of equal power (Debevec, *A median cut algorithm for light probe sampling*, 2005). No power is lost.

use super::patch::DistantSource;
use crate::image::{Image, Radiance, RadianceImage, luminance};
use crate::probe::latlong;
use glam::Vec3;

/// A source is split off if its radiance falls to this share of its peak …
const SUN_EDGE: f64 = 0.05;
/// … within this solid angle, sr (a cap of 5°), …
const SUN_MAX_SR: f64 = 0.024;
/// … and if it sends this share of all power.
const SUN_MIN_SHARE: f64 = 0.05;
/// Smallest angular radius of a source, rad: that of the sun in the sky.
const SUN_RADIUS: f64 = 0.004_65;

/// Distant light as found.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Distant {
    /// The cells, the sun first if there is one.
    pub sources: Vec<DistantSource>,
    /// Angular radius of the sun as found after the blur of the probe is taken off, rad.
    pub sun_radius: Option<f64>,
}

/// The distant layer: radiance by direction, 0 where the model is hit.
pub struct Layer<'a> {
    /// Equirectangular radiance; what a texel sends is `radiance × share × solid angle`.
    pub radiance: &'a RadianceImage,
    /// Share of each texel that the model leaves free.
    pub share: &'a [f32],
}

impl Layer<'_> {
    /// The radiance times the free share, for `distant.exr`.
    pub fn picture(&self) -> RadianceImage {
        let (w, h) = self.radiance.size();
        let texels = self.radiance.pixels().iter().zip(self.share);
        Image::from_pixels(w, h, texels.map(|(l, s)| Radiance(l.0.map(|v| v * s))).collect())
    }
}

/// A texel of an environment, as a part of sources.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Texel {
    pub x: usize,
    pub y: usize,
    pub direction: Vec3,
    /// Free solid angle, sr.
    pub solid_angle: f64,
    /// Radiance × free solid angle.
    pub power: [f64; 3],
}

/// All texels of an environment, row by row.
pub(crate) fn texels(radiance: &RadianceImage) -> Vec<Texel> {
    let (w, h) = radiance.size();
    let texel = |(i, radiance): (usize, &Radiance)| Texel::new(i, w, h, radiance.0, 1.0);
    radiance.pixels().iter().enumerate().map(texel).collect()
}

impl Texel {
    fn new(i: usize, width: usize, height: usize, radiance: [f32; 3], share: f32) -> Self {
        let (x, y) = (i % width, i / width);
        let solid_angle = latlong::texel_solid_angle(y, width, height) * f64::from(share);
        Self {
            x,
            y,
            direction: latlong::direction(x as f32 + 0.5, y as f32 + 0.5, width, height),
            solid_angle,
            power: radiance.map(|l| f64::from(l.max(0.0)) * solid_angle),
        }
    }
}

/// Power of a part of an environment by luminance.
pub(crate) fn weight(power: &[f64; 3]) -> f64 {
    f64::from(luminance(power.map(|p| p as f32)))
}

/// Cuts the layer into about `count` sources. `blur` is the angular standard deviation (per axis, rad) with which the
/// probe shows a point at a direction.
pub fn cut(layer: &Layer, count: usize, blur: impl Fn(Vec3) -> f64) -> Distant {
    let (w, h) = layer.radiance.size();
    let mut texels: Vec<Texel> = (0..w * h)
        .filter(|&i| layer.share[i] > 0.0)
        .map(|i| Texel::new(i, w, h, layer.radiance.pixels()[i].0, layer.share[i]))
        .collect();
    let mut distant = Distant::default();
    if let Some((source, radius)) = split_sun(&mut texels, blur) {
        distant.sources.push(source);
        distant.sun_radius = Some(radius);
    }
    distant.sources.extend(median_cut(texels, [w, h], count).iter().map(|s| s.source));
    distant
}

/// Cuts the texels of a map of some size (px) into at most `count` cells of about equal power (Debevec 2005), each a
/// source of the cell's whole power.
pub(crate) fn median_cut(texels: Vec<Texel>, [w, h]: [usize; 2], count: usize) -> Vec<Stratum> {
    let mut cells = vec![texels];
    while cells.len() < count.max(1) {
        // The strongest cell that can still be cut.
        let power = |c: &[Texel]| if c.len() > 1 { c.iter().map(|t| weight(&t.power)).sum() } else { 0.0 };
        let powers: Vec<f64> = cells.iter().map(|c| power(c)).collect();
        let Some(i) = (0..cells.len()).max_by(|&a, &b| powers[a].total_cmp(&powers[b])) else { break };
        if powers[i] <= 0.0 {
            break;
        }
        let (a, b) = halve(cells.swap_remove(i), w, h);
        cells.push(a);
        cells.push(b);
    }
    cells.iter().filter_map(|c| stratum(c)).collect()
}

/// Texels that one source stands for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stratum {
    /// The source, with the solid angle of all of them.
    pub source: DistantSource,
    /// Solid angle of the cap over which the light itself is spread, sr: less where a lamp shines among dark texels.
    pub extent_sr: f32,
}

/// One source of a cell's whole power, in the direction of its power's centroid.
pub(crate) fn stratum(cell: &[Texel]) -> Option<Stratum> {
    let (mut power, mut moment, mut solid_angle) = ([0.0f64; 3], nalgebra::Vector3::zeros(), 0.0);
    let mut texel = 0.0;
    for t in cell {
        (0..3).for_each(|k| power[k] += t.power[k]);
        let d = t.direction;
        moment += nalgebra::Vector3::new(f64::from(d.x), f64::from(d.y), f64::from(d.z)) * weight(&t.power);
        solid_angle += t.solid_angle;
        texel += t.solid_angle * weight(&t.power);
    }
    let whole: f64 = cell.iter().map(|t| weight(&t.power)).sum();
    if whole <= 0.0 || moment.norm() <= 0.0 {
        return None;
    }
    let d = moment.normalize();
    let source = DistantSource {
        direction: Vec3::new(d.x as f32, d.y as f32, d.z as f32),
        solid_angle_sr: solid_angle as f32,
        radiance: power.map(|p| (p / solid_angle) as f32),
    };
    // The mean direction of a cap of half angle α has length (1 + cos α)/2.
    let cap = 4.0 * std::f64::consts::PI * (1.0 - moment.norm() / whole).max(0.0);
    Some(Stratum { source, extent_sr: (cap + texel / whole).min(solid_angle) as f32 })
}

/// Cuts across the longer side of the cell so that both parts have nearly half the power; neither is empty.
fn halve(mut cell: Vec<Texel>, width: usize, height: usize) -> (Vec<Texel>, Vec<Texel>) {
    let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
    for t in &cell {
        low = [low[0].min(t.x), low[1].min(t.y)];
        high = [high[0].max(t.x), high[1].max(t.y)];
    }
    // Columns crowd together towards the poles: their breadth is taken at the cell's middle.
    let latitude = std::f64::consts::PI * (0.5 - (low[1] + high[1] + 1) as f64 / (2 * height) as f64);
    let breadth = (high[0] - low[0] + 1) as f64 * std::f64::consts::TAU / width as f64 * latitude.cos();
    let tall = (high[1] - low[1] + 1) as f64 * std::f64::consts::PI / height as f64;
    if breadth > tall && high[0] > low[0] || high[1] == low[1] {
        cell.sort_by_key(|t| (t.x, t.y));
    } else {
        cell.sort_by_key(|t| (t.y, t.x));
    }
    let half = cell.iter().map(|t| weight(&t.power)).sum::<f64>() / 2.0;
    let mut sum = 0.0;
    let at = cell.iter().position(|t| {
        sum += weight(&t.power);
        sum >= half
    });
    let rest = cell.split_off((at.unwrap_or(0) + 1).clamp(1, cell.len() - 1));
    (cell, rest)
}

/// Takes what stands out of the surroundings of the brightest texel, if it is small and strong enough.
fn split_sun(texels: &mut [Texel], blur: impl Fn(Vec3) -> f64) -> Option<(DistantSource, f64)> {
    let radiance = |t: &Texel| weight(&t.power) / t.solid_angle;
    let whole: f64 = texels.iter().map(|t| weight(&t.power)).sum();
    let peak = texels.iter().max_by(|a, b| radiance(a).total_cmp(&radiance(b)))?;
    let (top, middle) = (radiance(peak), peak.direction);
    let cap = ((1.0 - SUN_MAX_SR / std::f64::consts::TAU) as f32).acos();
    let within = |t: &Texel, angle: f32| t.direction.dot(middle) > angle.cos();
    let bright = |t: &Texel| radiance(t) > SUN_EDGE * top;
    // Something wide, like a window or a cloud, reaches beyond the cap.
    if texels.iter().any(|t| bright(t) && within(t, 1.5 * cap) && !within(t, cap)) {
        return None;
    }
    let mut ring = [0.0f64; 4];
    for t in texels.iter().filter(|t| within(t, 2.0 * cap) && !within(t, cap)) {
        (0..3).for_each(|k| ring[k] += t.power[k]);
        ring[3] += t.solid_angle;
    }
    let background: [f64; 3] = std::array::from_fn(|k| if ring[3] > 0.0 { ring[k] / ring[3] } else { 0.0 });
    let mut taken = Vec::new();
    for t in texels.iter_mut().filter(|t| within(t, cap) && bright(t)) {
        let excess = std::array::from_fn(|k| (t.power[k] - background[k] * t.solid_angle).max(0.0));
        (0..3).for_each(|k| t.power[k] -= excess[k]);
        taken.push(Texel { power: excess, ..*t });
    }
    let mut sun = stratum(&taken)?.source;
    let power: f64 = taken.iter().map(|t| weight(&t.power)).sum();
    if power < SUN_MIN_SHARE * whole {
        for t in &taken {
            if let Some(back) = texels.iter_mut().find(|b| b.x == t.x && b.y == t.y) {
                (0..3).for_each(|k| back.power[k] += t.power[k]);
            }
        }
        return None;
    }
    // The second moment of a uniform disc of radius a is a²/2; the probe adds its blur on either axis.
    let second: f64 = taken
        .iter()
        .map(|t| weight(&t.power) * f64::from(t.direction.angle_between(sun.direction)).powi(2))
        .sum();
    let radius = (2.0 * (second / power - 2.0 * blur(sun.direction).powi(2))).max(0.0).sqrt().max(SUN_RADIUS);
    let solid_angle = std::f64::consts::TAU * (1.0 - radius.cos());
    let scale = f64::from(sun.solid_angle_sr) / solid_angle;
    sun.radiance = sun.radiance.map(|l| (f64::from(l) * scale) as f32);
    sun.solid_angle_sr = solid_angle as f32;
    Some((sun, radius))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::Environment;
    use proptest::prelude::*;

    fn total(sources: &[DistantSource]) -> f64 {
        sources.iter().map(|s| f64::from(luminance(s.radiance)) * f64::from(s.solid_angle_sr)).sum()
    }

    #[test]
    fn a_sun_is_one_source_of_its_own_with_power_and_direction_kept() {
        let sun = Vec3::new(0.4, 0.7, -0.3).normalize();
        let radius = 0.02f32;
        let env = Environment::from_fn(512, Vec3::ZERO, |d| {
            [if d.angle_between(sun) < radius { 2000.0 } else { 1.0 + 0.5 * d.y }; 3]
        });
        let share = vec![1.0; 512 * 256];
        let d = cut(&Layer { radiance: &env.radiance, share: &share }, 64, |_| 0.0);
        let first = d.sources[0];
        assert!(first.direction.angle_between(sun).to_degrees() < 0.1);
        let power = 2000.0 * std::f64::consts::TAU * (1.0 - f64::from(radius).cos());
        let found = f64::from(first.radiance[0]) * f64::from(first.solid_angle_sr);
        assert!((found / power - 1.0).abs() < 0.05, "{}", found / power);
        let found = d.sun_radius.unwrap();
        assert!((found / f64::from(radius) - 1.0).abs() < 0.2, "{found}");
        assert!((total(&d.sources) / env.power() - 1.0).abs() < 1e-4);
    }

    #[test]
    fn a_window_is_no_sun_and_darkness_has_no_sources() {
        let window = |d: Vec3| [if d.x > 0.8 && d.y.abs() < 0.3 { 50.0 } else { 0.1 }; 3];
        let env = Environment::from_fn(128, Vec3::ZERO, window);
        let share = vec![1.0; 128 * 64];
        assert!(cut(&Layer { radiance: &env.radiance, share: &share }, 16, |_| 0.0).sun_radius.is_none());
        let dark = Environment::from_fn(64, Vec3::ZERO, |_| [0.0; 3]);
        let share = vec![1.0; 64 * 32];
        assert!(cut(&Layer { radiance: &dark.radiance, share: &share }, 16, |_| 0.0).sources.is_empty());
        let share = vec![0.0; 128 * 64];
        assert!(cut(&Layer { radiance: &env.radiance, share: &share }, 16, |_| 0.0).sources.is_empty());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]
        #[test]
        fn splitting_off_a_sun_keeps_all_light(
            x in -1.0f32..1.0, y in 0.1f32..1.0, z in -1.0f32..1.0, radius in 0.006f32..0.05, strength in 200.0f32..2e4
        ) {
            let sun = Vec3::new(x, y, z).normalize();
            let light = |d: Vec3| {
                if d.angle_between(sun) < radius { [strength, 0.9 * strength, 0.7 * strength] } else { [1.0 + 0.5 * d.y; 3] }
            };
            let env = Environment::from_fn(256, Vec3::ZERO, light);
            let share = vec![1.0; 256 * 128];
            let d = cut(&Layer { radiance: &env.radiance, share: &share }, 64, |_| 0.0);
            for k in 0..3 {
                let there: f64 = (0..256 * 128)
                    .map(|i| f64::from(env.radiance.pixels()[i].0[k]) * env.solid_angle(i))
                    .sum();
                let here: f64 =
                    d.sources.iter().map(|s| f64::from(s.radiance[k]) * f64::from(s.solid_angle_sr)).sum();
                prop_assert!((here / there - 1.0).abs() < 1e-3, "channel {k}: {}", here / there);
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]
        #[test]
        fn the_cut_keeps_power_and_solid_angle(count in 1usize..100, tilt in -1.0..1.0f32, gain in 0.1..100.0f32) {
            let env = Environment::from_fn(64, Vec3::ZERO, |d| {
                [gain * (1.0 + tilt * d.x) * (2.0 + (7.0 * d.z).sin()), gain, gain * (1.0 + d.y)]
            });
            let share = vec![1.0; 64 * 32];
            let d = cut(&Layer { radiance: &env.radiance, share: &share }, count, |_| 0.0);
            prop_assert_eq!(d.sources.len(), count);
            prop_assert!((total(&d.sources) / env.power() - 1.0).abs() < 1e-4);
            let sr: f64 = d.sources.iter().map(|s| f64::from(s.solid_angle_sr)).sum();
            prop_assert!((sr / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-3);
        }
    }
}

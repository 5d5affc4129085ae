//! Structured importance sampling of an environment (Agarwal, Ramamoorthi, Belongie and Jensen 2003).
//!
//! Layers of ever brighter texels fall into connected regions. A region gets lights in proportion to Γ = L Δω^¼ (§3.1),
//! brightest layer first; those of a region count towards that of the layer below. Each new light goes where its region
//! is farthest from all lights so far (Hochbaum and Shmoys 1985). At last every texel's light goes to the nearest one.

use crate::illuminate::distant::{Stratum, Texel, stratum, texels};
use crate::image::{RadianceImage, luminance};
use glam::Vec3;

/// Layers, at thresholds of 0, 1 … standard deviations of the environment's luminance (§4.1).
const LAYERS: usize = 6;
/// Solid angle beyond which a region's light is no better known for being spread, sr (§3.1).
const COHERENT_SR: f64 = 0.01;

/// At most `count` lights of an environment, fewer where it is dark or has fewer texels. Their power (radiance × solid
/// angle) is the environment's to rounding; each lies where its texels' power has its centroid, which for a whole stratum
/// serves better than the paper's centre of it.
pub(super) fn structured(environment: &RadianceImage, count: usize) -> Vec<Stratum> {
    let size = environment.size();
    let texels = texels(environment);
    let radiance: Vec<f64> =
        environment.pixels().iter().map(|p| f64::from(luminance(p.0.map(|v| v.max(0.0))))).collect();
    let power = |i: usize| radiance[i] * texels[i].solid_angle;
    let whole: f64 = (0..texels.len()).map(power).sum();
    let deviation = deviation(&radiance);
    let mut points =
        Points { texels: &texels, nearest: vec![f32::INFINITY; texels.len()], chosen: Vec::new() };
    for layer in (0..LAYERS).rev().filter(|_| whole > 0.0) {
        let threshold = layer as f64 * deviation;
        for region in regions(size, |i| radiance[i] >= threshold) {
            let share = region.iter().map(|&i| power(i)).sum::<f64>() / whole;
            let solid_angle: f64 = region.iter().map(|&i| texels[i].solid_angle).sum();
            let important = share * (solid_angle.min(COHERENT_SR) / COHERENT_SR).powf(0.25);
            let wanted = (count as f64 * important).round() as usize;
            let present = region.iter().filter(|&&i| points.nearest[i] <= 0.0).count();
            let more = wanted.saturating_sub(present).min(count - points.chosen.len());
            points.add(&region, more, |i| radiance[i]);
        }
    }
    strata(&texels, &points.chosen).iter().filter_map(|texels| stratum(texels)).collect()
}

/// Of luminance over the texels.
fn deviation(values: &[f64]) -> f64 {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt()
}

/// Connected sets of the texels that are `inside`; left and right border are neighbours.
fn regions((width, height): (usize, usize), inside: impl Fn(usize) -> bool) -> Vec<Vec<usize>> {
    let mut seen: Vec<bool> = (0..width * height).map(|i| !inside(i)).collect();
    let mut regions = Vec::new();
    for start in 0..width * height {
        if std::mem::replace(&mut seen[start], true) {
            continue;
        }
        let (mut region, mut next) = (vec![start], 0);
        while let Some(&i) = region.get(next) {
            next += 1;
            let (x, y) = (i % width, i / width);
            let row = y * width;
            let mut around = vec![row + (x + 1) % width, row + (x + width - 1) % width];
            around.extend((y > 0).then(|| i - width));
            around.extend((y + 1 < height).then(|| i + width));
            for j in around {
                if !std::mem::replace(&mut seen[j], true) {
                    region.push(j);
                }
            }
        }
        regions.push(region);
    }
    regions
}

/// Texels chosen so far, and how far each texel is from them: 1 − cos of the angle, 0 only at a chosen one.
struct Points<'a> {
    texels: &'a [Texel],
    nearest: Vec<f32>,
    chosen: Vec<usize>,
}

impl Points<'_> {
    /// Chooses more texels of a region, each the farthest one; the first of all is the brightest.
    fn add(&mut self, region: &[usize], more: usize, radiance: impl Fn(usize) -> f64) {
        for _ in 0..more {
            let farther = |a: &&usize, b: &&usize| {
                self.nearest[**a].total_cmp(&self.nearest[**b]).then(radiance(**a).total_cmp(&radiance(**b)))
            };
            let Some(&point) = region.iter().max_by(farther).filter(|&&i| self.nearest[i] > 0.0) else {
                return;
            };
            let direction = self.texels[point].direction;
            for (nearest, texel) in self.nearest.iter_mut().zip(self.texels) {
                *nearest = nearest.min(distance(direction, texel.direction));
            }
            self.nearest[point] = 0.0;
            self.chosen.push(point);
        }
    }
}

/// 1 − cos of the angle between unit vectors; exact where they are close, and above 0 unless they are one.
fn distance(a: Vec3, b: Vec3) -> f32 {
    (a.distance_squared(b) / 2.0).max(f32::MIN_POSITIVE)
}

/// The texels by the chosen one that each is nearest to.
fn strata(texels: &[Texel], chosen: &[usize]) -> Vec<Vec<Texel>> {
    let mut strata = vec![Vec::new(); chosen.len()];
    for texel in texels {
        let to = |k: &usize| distance(texels[chosen[*k]].direction, texel.direction);
        if let Some(k) = (0..chosen.len()).min_by(|a, b| to(a).total_cmp(&to(b))) {
            strata[k].push(*texel);
        }
    }
    strata
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illuminate::patch::DistantSource;
    use crate::image::{Image, Radiance};

    #[test]
    fn regions_reach_around_the_seam() {
        // Columns 0 and 7 touch, column 4 stands alone.
        let mut found = regions((8, 3), |i| [0, 4, 7].contains(&(i % 8)));
        found.iter_mut().for_each(|r| r.sort_unstable());
        assert_eq!(found, [vec![0, 7, 8, 15, 16, 23], vec![4, 12, 20]]);
    }

    #[test]
    fn a_lamp_gets_its_share_of_the_lights_and_they_lie_in_it() {
        let lamp = |x: usize, y: usize| (20..24).contains(&x) && (10..13).contains(&y);
        let environment = Image::from_fn(64, 32, |x, y| Radiance([if lamp(x, y) { 500.0 } else { 1.0 }; 3]));
        let lights: Vec<_> = structured(&environment, 40).iter().map(|s| s.source).collect();
        let [low, high] =
            [(20.0, 10.0), (24.0, 13.0)].map(|(x, y)| crate::probe::latlong::direction(x, y, 64, 32));
        let reach = low.distance(high);
        let inside: Vec<_> =
            lights.iter().filter(|l| l.direction.distance((low + high).normalize()) < reach).collect();
        let share = |lights: &[&DistantSource]| -> f32 {
            lights.iter().map(|l| l.radiance[0] * l.solid_angle_sr).sum()
        };
        assert!((5..35).contains(&inside.len()), "{} of {}", inside.len(), lights.len());
        assert!(share(&inside) > 0.6 * share(&lights.iter().collect::<Vec<_>>()));
    }
}

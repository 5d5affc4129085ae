//! Which lights make the source set (gibson §4).

use super::field::{LightField, Point};
use super::gather::{Fineness, Gatherer, Sent};
use super::lights::{Light, Shape};
use crate::config::SourceOrder;
use crate::image::luminance;
use glam::Vec3;
use std::f64::consts::PI;

/// Indices of the strongest that together reach `share` of the sum, strongest first; none that has nothing.
pub(super) fn strongest(power: &[f64], share: f64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..power.len()).filter(|&i| power[i] > 0.0).collect();
    order.sort_by(|&a, &b| power[b].total_cmp(&power[a]).then(a.cmp(&b)));
    if share >= 1.0 {
        return order;
    }
    let enough = share * order.iter().map(|&i| power[i]).sum::<f64>();
    let (mut sum, mut count) = (0.0, 0);
    while sum < enough && count < order.len() {
        sum += power[order[count]];
        count += 1;
    }
    order.truncate(count);
    order
}

/// The source set, strongest first: indices of lights, of which `received` says what reaches the receivers, and what share of
/// the light of each of their places it makes up. The share counts: a shadow under a table is one of light that is faint
/// everywhere else. Where order is by power, a patch counts with what it sends anywhere and distant light with what it would
/// send to the receivers' area with nothing between, both in plate units · m²; lights that reach no receiver are left out all
/// the same.
pub(super) fn source_set(
    lights: &[Light],
    [received, shares]: [&[f64]; 2],
    order: SourceOrder,
    share: f64,
    receivers: &[(Vec3, f64)],
) -> Vec<usize> {
    match order {
        SourceOrder::Received => strongest(shares, share),
        SourceOrder::Power => {
            let flux = |(light, received): (&Light, &f64)| {
                if *received <= 0.0 {
                    return 0.0;
                }
                match light.shape {
                    Shape::Patch { .. } => PI * light.power(),
                    Shape::Distant { direction, .. } => {
                        let facing = |(n, area): &(Vec3, f64)| f64::from(n.dot(direction).max(0.0)) * area;
                        light.power() * receivers.iter().map(facing).sum::<f64>()
                    }
                }
            };
            strongest(&lights.iter().zip(received).map(flux).collect::<Vec<_>>(), share)
        }
    }
}

/// Some receiver vertices that stand for all, and the area of each, m²: by systematic sampling over the area.
pub(super) fn sample(areas: &[f64], count: usize) -> Vec<(usize, f64)> {
    if areas.len() <= count {
        return areas.iter().copied().enumerate().collect();
    }
    let step = areas.iter().sum::<f64>() / count as f64;
    let (mut chosen, mut at, mut next) = (Vec::with_capacity(count), 0.0, step / 2.0);
    for (v, area) in areas.iter().enumerate() {
        at += area;
        let mut weight = 0.0;
        while next < at {
            (weight, next) = (weight + step, next + step);
        }
        if weight > 0.0 {
            chosen.push((v, weight));
        }
    }
    chosen
}

/// What each light (in the order of the field's leaves) sends to a point, as luminance: far clusters part by power.
pub(super) fn by_light(field: &LightField, sent: &[Sent], mut each: impl FnMut(usize, f64)) {
    for s in sent {
        let leaves = field.tree.nodes[s.node as usize].leaves.clone();
        let all = f64::from(luminance(s.irradiance));
        if leaves.len() == 1 {
            each(leaves.start as usize, all);
            continue;
        }
        let power: f64 =
            field.lights[leaves.start as usize..leaves.end as usize].iter().map(Light::power).sum();
        for leaf in leaves {
            each(leaf as usize, all * field.lights[leaf as usize].power() / power);
        }
    }
}

/// Luminance at a point from a field, within a few tens of percent.
pub(super) fn magnitude(sent: &[Sent]) -> f64 {
    sent.iter().map(|s| f64::from(luminance(s.irradiance))).sum()
}

impl Gatherer<'_> {
    /// What all lights of a field send to a point, about: [`magnitude`] of a coarse cut.
    pub fn about(&self, field: &LightField, free: &[bool], point: &Point, sent: &mut Vec<Sent>) -> f64 {
        self.cut(field, free, point, Fineness { most: f64::INFINITY, coarse: true }, sent);
        magnitude(sent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::SourceKind;

    #[test]
    fn the_strongest_are_just_enough() {
        let power = [1.0, 0.0, 5.0, 3.0, 1.0];
        assert_eq!(strongest(&power, 0.7), [2, 3]);
        assert_eq!(strongest(&power, 0.85), [2, 3, 0]);
        assert_eq!(strongest(&power, 1.0), [2, 3, 0, 4]);
        assert!(strongest(&[0.0; 3], 0.5).is_empty());
    }

    #[test]
    fn samples_stand_for_the_whole_area() {
        let areas: Vec<f64> = (0..1000).map(|i| f64::from(i % 7)).collect();
        let all: f64 = areas.iter().sum();
        for count in [10, 100, 5000] {
            let chosen = sample(&areas, count);
            assert!((chosen.iter().map(|c| c.1).sum::<f64>() / all - 1.0).abs() < 1e-9);
            assert!(chosen.len() <= count && chosen.is_sorted_by_key(|c| c.0));
            assert!(count == 5000 || chosen.iter().all(|c| areas[c.0] > 0.0));
        }
    }

    #[test]
    fn power_and_what_is_received_order_differently() {
        let patch = |radiance: f32| Light {
            kind: SourceKind::Patch(0),
            radiance: [radiance; 3],
            shape: Shape::Patch { corners: [Vec3::ZERO, Vec3::X, Vec3::Y], normal: Vec3::Z },
        };
        let shape = Shape::Distant { direction: Vec3::Y, solid_angle: 0.1, angular_radius: 0.2 };
        let sky = Light { kind: SourceKind::Distant(0), radiance: [10.0; 3], shape };
        // Powers on 2 m² that face up: 0.5 π · 4, 0.5 π · 1, 10 · 0.1 · 2.
        let lights = [patch(4.0), patch(1.0), sky];
        let (received, area) = ([0.5, 2.0, 1.0], [(Vec3::Y, 2.0), (-Vec3::Y, 3.0)]);
        let set =
            |received: &[f64], order| source_set(&lights, [received, &[0.2, 0.1, 0.7]], order, 1.0, &area);
        assert_eq!(set(&received, SourceOrder::Received), [2, 0, 1]);
        assert_eq!(set(&received, SourceOrder::Power), [0, 2, 1]);
        assert_eq!(set(&[0.0, 1.0, 1.0], SourceOrder::Power), [2, 1]);
    }
}

//! What lights send to a point: cuts of their tree, visibility by rays.

use super::field::{LightField, Point, Seen, exact, seen};
use super::lights::{Light, Shape};
use super::lobe::Lobe;
use super::sampling::{Shift, in_cap, on_triangle, towards_triangle};
use crate::image::luminance;
use crate::visibility::Bvh;
use glam::Vec3;

/// Rays leave a surface by this much, m: above rounding, below what a shadow shows.
pub(super) const OFFSET_M: f32 = 5e-4;
/// Points of a light that are tried until one is above the horizon.
const MOST_TRIES: u32 = 32;
/// Rays towards distant light are this long, m.
const BEYOND_M: f32 = 1e5;

/// What a node sends to a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sent {
    pub node: u32,
    /// Plate units.
    pub irradiance: [f32; 3],
    /// Luminance of what it would send if nothing stood between.
    pub open: f32,
}

/// How finely to gather.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fineness {
    /// Clusters that send more (luminance) are opened.
    pub most: f64,
    /// Only the order of magnitude counts.
    pub coarse: bool,
}

/// The scene between lights and points.
pub(super) struct Gatherer<'a> {
    pub bvh: &'a Bvh,
    /// Most rays towards a light or a cluster.
    pub rays: u32,
}

impl Gatherer<'_> {
    /// Irradiance at a point from each light or far cluster, in the order of the leaves. `free` tells of each node
    /// ([nodes]) whether nothing stands between it and the point; a node below a free one is free.
    pub fn cut(&self, field: &LightField, free: &[bool], p: &Point, fineness: Fineness, out: &mut Vec<Sent>) {
        out.clear();
        let mut stack = Vec::with_capacity(64);
        if !field.tree.nodes.is_empty() {
            stack.push((0u32, false));
        }
        while let Some((i, free_above)) = stack.pop() {
            let node = &field.tree.nodes[i as usize];
            let free = free_above || free[i as usize];
            let open = match (seen(field, i, p, fineness.coarse), node.children) {
                (Seen::Nothing, _) => continue,
                (Seen::Far(e), None) => e,
                (Seen::Far(e), Some(_)) if f64::from(luminance(e)) <= fineness.most => e,
                (_, Some([a, b])) => {
                    stack.extend([(b, free), (a, free)]);
                    continue;
                }
                (Seen::Near, None) => exact(&field.lights[node.leaves.start as usize], p),
                (Seen::Mirrored(lobe), None) => {
                    let (irradiance, open) = self.mirrored(field, i, p, &lobe, free);
                    out.push(Sent { node: i, irradiance, open });
                    continue;
                }
            };
            if open == [0.0; 3] {
                continue;
            }
            let rays = self.rays_for(f64::from(luminance(open)), fineness);
            let visible = if free { 1.0 } else { self.visible(field, i, p, rays) };
            let sent = Sent { node: i, irradiance: open.map(|c| c * visible), open: luminance(open) };
            out.push(sent);
        }
    }

    /// Few rays for what sends little: their noise is bounded by what is sent, and without bias.
    fn rays_for(&self, sends: f64, fineness: Fineness) -> u32 {
        if fineness.coarse {
            self.rays.min(2)
        } else if sends > fineness.most {
            self.rays
        } else if sends > fineness.most / 4.0 {
            (self.rays / 2).max(1)
        } else {
            1
        }
    }

    /// Share of a node's light that reaches a point: a third of the rays first, the others only where those disagree.
    fn visible(&self, field: &LightField, node: u32, p: &Point, rays: u32) -> f32 {
        let leaves = &field.tree.nodes[node as usize].leaves;
        let shift = Shift::new(leaves_seed(&field.lights[leaves.start as usize]), p.seed());
        let first = (rays / 3).max(2).min(rays);
        let (mut seen, mut all) = (0.0, 0.0);
        // Of a light that stands halfway up the horizon more points are tried until some are above.
        for k in 0..rays.max(MOST_TRIES) {
            if all > 0.0 && (k >= rays || k >= first && (seen == 0.0 || seen == all)) {
                break;
            }
            let one = leaves.len() == 1;
            let leaf = if one {
                leaves.start as usize
            } else {
                // The first rays are spread over the whole cluster, and all of them are.
                let u = (k % first) as f32 / first as f32 + shift.jitter(k) / first as f32;
                field.leaf(node, u)
            };
            let (weight, visible) = self.ray(&field.lights[leaf], p, shift, k);
            // Members of a cluster are drawn by power and send alike.
            let weight = if one { weight } else { f32::from(u8::from(weight > 0.0)) };
            all += weight;
            seen += if visible { weight } else { 0.0 };
        }
        if all > 0.0 { seen / all } else { 0.0 }
    }

    /// Irradiance from one light with the lobe's weight, and its luminance with nothing between: the exact form factor
    /// times means over stratified points.
    fn mirrored(&self, field: &LightField, node: u32, p: &Point, lobe: &Lobe, free: bool) -> ([f32; 3], f32) {
        let light = &field.lights[field.tree.nodes[node as usize].leaves.start as usize];
        let shift = Shift::new(leaves_seed(light), p.seed());
        let (mut all, mut open, mut sent) = (0.0, [0.0; 3], [0.0; 3]);
        for k in 0..self.rays.max(MOST_TRIES) {
            let (weight, direction, target) = near_sample(light, p, shift, k);
            if weight > 0.0 {
                all += weight;
                let visible = free || self.gets_through(p, target);
                for (c, w) in lobe.weight(direction).into_iter().enumerate() {
                    open[c] += weight * w;
                    sent[c] += if visible { weight * w } else { 0.0 };
                }
            }
        }
        if all == 0.0 {
            return ([0.0; 3], 0.0);
        }
        let e = exact(light, p);
        let scaled = |sum: [f32; 3]| std::array::from_fn(|c| e[c] * sum[c] / all);
        (scaled(sent), luminance(scaled(open)))
    }

    fn gets_through(&self, p: &Point, target: Target) -> bool {
        match target {
            Target::Place(y) => !self.bvh.occluded(p.position, y),
            Target::Direction(w) => !self.bvh.any_hit(p.position, w, 0.0, BEYOND_M),
        }
    }

    /// One ray towards a light: its weight in the form factor, and whether it gets there.
    fn ray(&self, light: &Light, p: &Point, shift: Shift, k: u32) -> (f32, bool) {
        let (weight, _, target) = sample(light, p, shift, k);
        (weight, weight > 0.0 && self.gets_through(p, target))
    }
}

/// Where a ray goes.
#[derive(Clone, Copy)]
enum Target {
    /// m
    Place(Vec3),
    Direction(Vec3),
}

/// As [`sample`]; near patches by solid angle, since by area most of their light would come from few points.
fn near_sample(light: &Light, p: &Point, shift: Shift, k: u32) -> (f32, Vec3, Target) {
    let Shape::Patch { corners, normal } = light.shape else { return sample(light, p, shift, k) };
    let relative = corners.map(|c| (c - p.position).as_dvec3());
    let [a, b, c] = relative;
    let size = (b - a).length().max((c - a).length());
    let nearest = a.length().min(b.length()).min(c.length());
    if size < 0.3 * nearest {
        return sample(light, p, shift, k);
    }
    let Some(w) = towards_triangle(relative, shift.point(k)) else { return sample(light, p, shift, k) };
    let (w, reach) = (w.as_vec3(), a.as_vec3().dot(normal));
    let slope = w.dot(normal);
    let weight = if slope < 0.0 { w.dot(p.normal).max(0.0) } else { 0.0 };
    let y = p.position + w * (reach / slope.min(-1e-6));
    (weight, w, Target::Place(y + normal * OFFSET_M))
}

/// A point of a light: its weight in the form factor, the unit direction to it, and where it is.
fn sample(light: &Light, p: &Point, shift: Shift, k: u32) -> (f32, Vec3, Target) {
    match light.shape {
        Shape::Patch { corners, normal } => {
            let y = on_triangle(corners, shift.point(k));
            let w = y - p.position;
            let cosines = w.dot(p.normal).max(0.0) * (-w.dot(normal)).max(0.0);
            let weight = cosines / w.length_squared().powi(2);
            (weight, w.normalize_or_zero(), Target::Place(y + normal * OFFSET_M))
        }
        Shape::Distant { direction, angular_radius, .. } => {
            let w = in_cap(direction, angular_radius, shift.point(k));
            (w.dot(p.normal).max(0.0), w, Target::Direction(w))
        }
    }
}

fn leaves_seed(light: &Light) -> u64 {
    match light.kind {
        super::SourceKind::Patch(i) => u64::from(i),
        super::SourceKind::Distant(i) => u64::from(i) | 1 << 40,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::SourceKind;
    use crate::transfer::field::FAR;
    use proptest::prelude::*;

    fn vec(range: std::ops::Range<f32>) -> impl Strategy<Value = Vec3> {
        (range.clone(), range.clone(), range).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    /// A square of n × n × 2 patches at y = 0 that faces up, its brightness from `shade`.
    fn panel(n: usize, side: f32, shade: impl Fn(usize, usize) -> f32) -> Vec<Light> {
        let step = side / n as f32;
        let at =
            |i: usize, j: usize| Vec3::new(i as f32 * step - side / 2.0, 0.0, j as f32 * step - side / 2.0);
        let mut lights = Vec::new();
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            for corners in
                [[at(i, j), at(i, j + 1), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i + 1, j)]]
            {
                let shape = Shape::Patch { corners, normal: Vec3::Y };
                let (kind, s) = (SourceKind::Patch(lights.len() as u32), shade(i, j));
                lights.push(Light { kind, radiance: [s, s, 0.5 * s], shape });
            }
        }
        lights
    }

    fn sum(sent: &[Sent]) -> [f64; 3] {
        std::array::from_fn(|c| sent.iter().map(|s| f64::from(s.irradiance[c])).sum())
    }

    fn all(lights: &[Light], p: &Point) -> [f64; 3] {
        let each: Vec<_> = lights.iter().map(|l| exact(l, p)).collect();
        std::array::from_fn(|c| each.iter().map(|e| f64::from(e[c])).sum())
    }

    proptest! {
        #[test]
        fn far_clusters_keep_their_bound(
            p in vec(-3.0..3.0), n in vec(-1.0..1.0), turn in 0.2..3.0f32,
        ) {
            prop_assume!(n.length() > 0.1 && p.y > 0.05);
            let p = Point { position: p, normal: n.normalize(), lobe: None };
            let lights = panel(8, 1.0, |i, j| 1.0 + (i as f32 * turn + j as f32).sin());
            let field = LightField::new(&lights);
            let bvh = Bvh::new(&[], &[]);
            let gatherer = Gatherer { bvh: &bvh, rays: 4 };
            let mut sent = Vec::new();
            let free = vec![true; field.tree.nodes.len()];
            gatherer.cut(&field, &free, &p, Fineness { most: f64::INFINITY, coarse: false }, &mut sent);
            let (found, truth) = (sum(&sent), all(&lights, &p));
            for c in 0..3 {
                let bound = 2.0 * f64::from(FAR * FAR);
                prop_assert!((found[c] - truth[c]).abs() <= bound * truth[c] + 1e-6, "{} against {}", found[c], truth[c]);
            }
        }

        #[test]
        fn with_no_cluster_each_light_is_exact(p in vec(-2.0..2.0), n in vec(-1.0..1.0)) {
            prop_assume!(n.length() > 0.1);
            let p = Point { position: p, normal: n.normalize(), lobe: None };
            let lights = panel(4, 1.0, |_, _| 2.0);
            let field = LightField::new(&lights);
            let bvh = Bvh::new(&[], &[]);
            let mut sent = Vec::new();
            let free = vec![true; field.tree.nodes.len()];
            let gatherer = Gatherer { bvh: &bvh, rays: 4 };
            gatherer.cut(&field, &free, &p, Fineness { most: 0.0, coarse: false }, &mut sent);
            for s in &sent {
                let leaf = field.tree.nodes[s.node as usize].leaves.clone();
                prop_assert_eq!(leaf.len(), 1);
                let e = exact(&field.lights[leaf.start as usize], &p);
                prop_assert!((e[0] - s.irradiance[0]).abs() <= 0.01 * e[0] + 1e-7);
            }
            let (found, truth) = (sum(&sent), all(&lights, &p));
            prop_assert!((found[1] - truth[1]).abs() <= 0.01 * truth[1] + 1e-6);
        }
    }

    #[test]
    fn a_mirrored_light_agrees_with_brute_force() {
        let gloss = crate::model::face::Gloss { specular: [0.3, 0.2, 0.1], shininess: 40.0 };
        let lights = panel(4, 1.0, |_, _| 1.0);
        let field = LightField::new(&lights);
        let bvh = Bvh::new(&[], &[]);
        let gatherer = Gatherer { bvh: &bvh, rays: 32 };
        for (x, eye) in [
            (0.0, Vec3::new(0.1, -2.0, 0.0)),
            (0.6, Vec3::new(2.0, -1.0, 0.3)),
            (1.5, Vec3::new(4.0, -2.0, 0.0)),
        ] {
            let (position, normal) = (Vec3::new(x, 1.0, 0.2), -Vec3::Y);
            let lobe = Lobe::new(&gloss, [0.5; 3], position, normal, eye);
            let p = Point { position, normal, lobe };
            let (mut sent, free) = (Vec::new(), vec![true; field.tree.nodes.len()]);
            gatherer.cut(&field, &free, &p, Fineness { most: 0.0, coarse: false }, &mut sent);
            let (n, mut truth) = (600, [0.0f64; 3]);
            for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
                let y = Vec3::new((i as f32 + 0.5) / n as f32 - 0.5, 0.0, (j as f32 + 0.5) / n as f32 - 0.5);
                let w = y - position;
                let (r2, d) = (w.length_squared(), w.normalize());
                let kernel = f64::from(w.dot(normal) * -w.dot(Vec3::Y) / (r2 * r2)) / f64::from(n * n);
                let weight = lobe.unwrap().weight(d);
                (0..3).for_each(|c| truth[c] += kernel * f64::from(weight[c]) * [1.0, 1.0, 0.5][c]);
            }
            let found = sum(&sent);
            for c in 0..3 {
                assert!((found[c] / truth[c] - 1.0).abs() < 0.03, "{} against {} at {x}", found[c], truth[c]);
            }
        }
    }

    #[test]
    fn half_a_panel_behind_a_wall_sends_half() {
        let lights = panel(8, 1.0, |_, _| 1.0);
        let field = LightField::new(&lights);
        let wall = [
            Vec3::new(0.0, 0.01, -9.0),
            Vec3::new(9.0, 0.01, -9.0),
            Vec3::new(0.0, 0.01, 9.0),
            Vec3::new(9.0, 0.01, 9.0),
        ];
        let bvh = Bvh::new(&wall, &[[0, 1, 2], [1, 3, 2]]);
        let gatherer = Gatherer { bvh: &bvh, rays: 16 };
        let free = vec![false; field.tree.nodes.len()];
        let p = Point { position: Vec3::new(0.0, 8.0, 0.0), normal: -Vec3::Y, lobe: None };
        let (truth, mut sent) = (all(&lights, &p), Vec::new());
        for most in [0.0, 0.002, 0.016] {
            gatherer.cut(&field, &free, &p, Fineness { most, coarse: false }, &mut sent);
            let share = sum(&sent)[1] / truth[1];
            assert!((share - 0.5).abs() < 0.15, "{share} with clusters up to {most}");
            assert!(sent.windows(2).all(|s| field.tree.nodes[s[0].node as usize].leaves.end
                <= field.tree.nodes[s[1].node as usize].leaves.start));
        }
    }
}

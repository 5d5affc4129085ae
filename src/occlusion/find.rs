//! Rectangular lights: found among the light model's patches, or given and filled with their radiance.

use super::fit::{Rectangle, Triangle};
use super::{Problem, RectangularLight};
use crate::calibrate::world_from_grid;
use crate::config::AreaLight;
use crate::illuminate::patch::PatchMesh;
use crate::illuminate::power;
use crate::image::luminance;
use glam::{DVec2, Vec3};
use std::collections::HashMap;

/// A light is this much brighter than the middle surface of the scene.
const BRIGHT: f32 = 4.0;
/// A region is bounded where its radiance has fallen to this share of its peak: where a blurred edge lies.
const EDGE: f32 = 0.5;
/// Region and rectangle have at least this share of their union in common. A disc passes, as the square of equal moments.
const RECTANGULAR: f64 = 0.8;
/// A light sends at least this share of all power.
const STRONG: f64 = 0.01;
/// A given rectangle takes the radiance of patches that lie so near to it, m, and so parallel (cosine).
const ON_M: f32 = 0.05;
const PARALLEL: f32 = 0.95;

/// All rectangles of bright, adjoining patches of one face, strongest first (radiance: that which keeps their power).
pub fn find(mesh: &PatchMesh) -> Result<Vec<RectangularLight>, Problem> {
    let bright: Vec<f32> = mesh.patches.iter().map(|p| luminance(p.radiance)).collect();
    let least = BRIGHT * median(mesh, &bright);
    let all: f64 = (0..bright.len()).map(|i| power(mesh, i)).sum();
    let mut order: Vec<usize> = (0..bright.len()).filter(|&i| bright[i] > least).collect();
    order.sort_by(|&a, &b| bright[b].total_cmp(&bright[a]));
    let (neighbours, mut taken) = (neighbours(mesh), vec![false; bright.len()]);
    let (mut lights, mut best) = (Vec::new(), 0.0f64);
    for &seed in &order {
        if taken[seed] {
            continue;
        }
        let region = flood(&neighbours, &mut taken, vec![seed], |_, i| bright[i] >= EDGE * bright[seed]);
        // Its halo: what only grows darker outwards. Beyond a dark bar the next pane begins.
        flood(&neighbours, &mut taken, region.clone(), |from, i| {
            bright[i] > least && bright[i] < bright[from]
        });
        let sent: f64 = region.iter().map(|&i| power(mesh, i)).sum();
        if sent < STRONG * all {
            continue;
        }
        let plane = Plane::new(mesh.centroid(seed), mesh.normal(seed));
        let triangles: Vec<Triangle> = region.iter().map(|&i| plane.flatten(mesh.corners(i))).collect();
        let Some((rectangle, share)) = Rectangle::fit(&triangles) else { continue };
        best = best.max(share);
        if share >= RECTANGULAR {
            let area = rectangle.area();
            let sum = |c: usize| region.iter().map(|&i| power_of(mesh, i, c)).sum::<f64>();
            let radiance = [0, 1, 2].map(|c| (sum(c) / area) as f32);
            lights.push((sent, plane.light(&rectangle, radiance)));
        }
    }
    if lights.is_empty() {
        return Err(Problem::NoRectangle { bright: order.len(), share: best });
    }
    lights.sort_by(|a, b| b.0.total_cmp(&a.0));
    Ok(lights.into_iter().map(|(_, light)| light).collect())
}

/// Given rectangles; they shine where the patches on them face, or along the first side × the second.
pub fn given(lights: &[AreaLight], mesh: &PatchMesh) -> Result<Vec<RectangularLight>, Problem> {
    lights.iter().enumerate().map(|(index, light)| one(index, light, mesh)).collect()
}

fn one(index: usize, light: &AreaLight, mesh: &PatchMesh) -> Result<RectangularLight, Problem> {
    let refuse = |what| Err(Problem::AreaLight { index, what });
    let grid = world_from_grid();
    let turned = |v: [f64; 3]| {
        let w = grid.rotation * nalgebra::Vector3::from(v);
        Vec3::new(w.x as f32, w.y as f32, w.z as f32)
    };
    let t = grid.translation.vector;
    let corner = turned(light.corner_m) + Vec3::new(t.x as f32, t.y as f32, t.z as f32);
    let mut half = [turned(light.side_u_m) / 2.0, turned(light.side_v_m) / 2.0];
    if !(corner.is_finite() && half.iter().all(|h| h.is_finite() && h.length() > 1e-4)) {
        return refuse("a side without length");
    }
    if half[0].normalize().dot(half[1].normalize()).abs() > 0.02 {
        return refuse("sides that are not at right angles");
    }
    let centre = corner + half[0] + half[1];
    let plane = Plane::new(centre, half[0].cross(half[1]).normalize());
    let rectangle = Rectangle {
        centre: DVec2::ZERO,
        axis: plane.flatten([centre + half[0]; 3])[0].normalize_or(DVec2::X),
        half: DVec2::new(half[0].length().into(), half[1].length().into()),
    };
    let (mut sums, mut area, mut facing) = ([0.0; 3], 0.0, 0.0);
    for i in 0..mesh.patches.len() {
        let cosine = mesh.normal(i).dot(plane.normal);
        let off = (mesh.centroid(i) - centre).dot(plane.normal);
        if cosine.abs() < PARALLEL || off.abs() > ON_M {
            continue;
        }
        let common = rectangle.common_area(&plane.flatten(mesh.corners(i)));
        (0..3).for_each(|c| sums[c] += common * f64::from(mesh.patches[i].radiance[c]));
        (area, facing) = (area + common, facing + common * f64::from(cosine));
    }
    if facing < 0.0 {
        half.swap(0, 1);
    }
    let radiance = match light.radiance {
        Some(radiance) => radiance,
        None if area > 0.0 => sums.map(|s| (s / area) as f32),
        None => return refuse("no radiance, and no surface of the model lies on it"),
    };
    Ok(RectangularLight { centre, half, radiance })
}

/// A plane with axes of its own.
struct Plane {
    origin: Vec3,
    axes: [Vec3; 2],
    normal: Vec3,
}

impl Plane {
    fn new(origin: Vec3, normal: Vec3) -> Self {
        let (u, v) = normal.any_orthonormal_pair();
        // u × v along the normal.
        let axes = if u.cross(v).dot(normal) > 0.0 { [u, v] } else { [v, u] };
        Self { origin, axes, normal }
    }

    fn flatten(&self, corners: [Vec3; 3]) -> Triangle {
        corners.map(|p| {
            let to = (p - self.origin).as_dvec3();
            DVec2::new(to.dot(self.axes[0].as_dvec3()), to.dot(self.axes[1].as_dvec3()))
        })
    }

    fn light(&self, rectangle: &Rectangle, radiance: [f32; 3]) -> RectangularLight {
        let lift = |p: DVec2| self.axes[0] * p.x as f32 + self.axes[1] * p.y as f32;
        RectangularLight {
            centre: self.origin + lift(rectangle.centre),
            half: [lift(rectangle.axis * rectangle.half.x), lift(rectangle.axis.perp() * rectangle.half.y)],
            radiance,
        }
    }
}

fn power_of(mesh: &PatchMesh, i: usize, channel: usize) -> f64 {
    f64::from(mesh.patches[i].radiance[channel]) * f64::from(mesh.area(i))
}

/// Luminance below which half of all surface lies.
fn median(mesh: &PatchMesh, bright: &[f32]) -> f32 {
    let mut order: Vec<usize> = (0..bright.len()).collect();
    order.sort_by(|&a, &b| bright[a].total_cmp(&bright[b]));
    let half = order.iter().map(|&i| mesh.area(i)).sum::<f32>() / 2.0;
    let mut below = 0.0;
    let middle = order.into_iter().find(|&i| {
        below += mesh.area(i);
        below >= half
    });
    middle.map_or(0.0, |i| bright[i])
}

/// Patches that share an edge with each patch.
fn neighbours(mesh: &PatchMesh) -> Vec<Vec<usize>> {
    let mut sides: HashMap<[u32; 2], Vec<usize>> = HashMap::new();
    for (i, patch) in mesh.patches.iter().enumerate() {
        let [a, b, c] = patch.vertices;
        for (p, q) in [(a, b), (b, c), (c, a)] {
            sides.entry([p.min(q), p.max(q)]).or_default().push(i);
        }
    }
    let mut neighbours = vec![Vec::new(); mesh.patches.len()];
    for shared in sides.values().filter(|s| s.len() > 1) {
        for &i in shared {
            neighbours[i].extend(shared.iter().copied().filter(|&j| j != i));
        }
    }
    neighbours
}

/// Some patches and all that can be reached from them; `goes` says whether from one to the next.
fn flood(
    neighbours: &[Vec<usize>],
    taken: &mut [bool],
    mut region: Vec<usize>,
    goes: impl Fn(usize, usize) -> bool,
) -> Vec<usize> {
    region.iter().for_each(|&i| taken[i] = true);
    let mut next = 0;
    while let Some(&from) = region.get(next) {
        for &i in &neighbours[from] {
            if !taken[i] && goes(from, i) {
                taken[i] = true;
                region.push(i);
            }
        }
        next += 1;
    }
    region
}

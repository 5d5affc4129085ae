//! How much light an object can take out of the picture from each source, before any shadow is drawn.
//!
//! From source j the picture loses Σ_x B(x) E_j(x) / E(x) M_xj over the plate's pixels. A few hundred of them are probed;
//! in the place of M stands whether the object's bounding sphere lies in the direction of the source's centre.

use super::origins::triangle_variance;
use super::representatives::Seen;
use super::tiles::{Pixel, Prepared};
use super::{Bounds, Scene};
use crate::image::luminance;
use crate::transfer::{Affected, SourceKind};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::collections::{BTreeSet, HashMap};

/// Pixels that are probed.
const PROBES: usize = 256;
/// One pixel of so many vectors stands for them when probes are chosen.
const VECTORS: usize = 4;
/// A source whose shadow met no probe counts as if this share of the probed light had met it.
const UNMET: f64 = 1e-4;
/// Where the object touches, penumbrae are as narrow as at this distance, radii.
const CONTACT: f64 = 0.25;
/// Distant sources lie this far away, m.
const FAR: f32 = 1e5;

/// A receiver pixel and the pixels that it stands for.
struct Probe {
    position: Vec3,
    /// Receiver vertex whose transfers are taken for its own.
    vertex: u32,
    /// Radiance over irradiance, summed over the pixels.
    light: f32,
}

/// Every source as the object sees it, with the light that it can take from it; and the mean distance from its near side
/// to where it takes it, in radii of the object: a penumbra is as wide as that times the source's angle.
pub(crate) fn seen(
    scene: &Scene,
    prepared: &Prepared,
    affected: &Affected,
    bounds: &Bounds,
) -> (Vec<Seen>, f64) {
    let mut seen = vec![Seen::default(); scene.transfers.sources.len()];
    let probes = probes(scene, prepared, affected, bounds);
    let distance =
        |p: &Probe| f64::from(p.position.distance(bounds.centre) / bounds.radius - 1.0).max(CONTACT);
    let distance = probes.iter().map(distance).sum::<f64>() / probes.len().max(1) as f64;
    let losses = Losses::new(scene, affected, bounds, &probes);
    for (&j, (lost, mean)) in affected.sources.iter().zip(losses.by_source()) {
        seen[j as usize] = Seen { weight: mean, lost, marked: true, ..as_seen(scene, j, bounds) };
    }
    (seen, distance)
}

/// Where a source lies as seen from the object.
fn as_seen(scene: &Scene, source: u32, bounds: &Bounds) -> Seen {
    let (mesh, centre) = (&scene.light.mesh, bounds.centre.as_dvec3());
    match scene.transfers.sources[source as usize].kind {
        SourceKind::Patch(p) => {
            let corners = mesh.corners(p as usize).map(|c| c.as_dvec3());
            let position = corners.iter().sum::<DVec3>() / 3.0;
            Seen {
                direction: (position - centre).normalize_or(DVec3::Y),
                own_variance: triangle_variance(corners, centre, f64::from(bounds.radius)),
                position: Some(position),
                ..Seen::default()
            }
        }
        SourceKind::Distant(d) => {
            let d = &scene.light.distant[d as usize];
            let own_variance = f64::from(d.angular_radius()).powi(2) / 2.0;
            Seen { direction: d.direction.as_dvec3(), own_variance, ..Seen::default() }
        }
    }
}

/// Pixels drawn (systematically) in proportion to the light that the object may take there: radiance times the share of
/// the hemisphere that its bounding sphere covers.
fn probes(scene: &Scene, prepared: &Prepared, affected: &Affected, bounds: &Bounds) -> Vec<Probe> {
    let is_affected = |patches: &[u32]| patches.iter().any(|p| affected.patches.binary_search(p).is_ok());
    let mut candidates: Vec<(&Pixel, f32, f32)> = Vec::new();
    for tile in prepared.tiles.iter().filter(|t| is_affected(&t.patches)) {
        for vectors in prepared.vectors[tile.vectors.clone()].chunks(VECTORS) {
            let middle = &vectors[vectors.len() / 2];
            let pixel = &prepared.pixels[middle.pixels.start];
            let (all, plate) =
                (luminance(pixel.irradiance), scene.plate.pixels()[pixel.index as usize].luminance());
            let covered = covered(pixel.position, pixel.normal, bounds);
            if all > 0.0 && plate > 0.0 && covered > 0.0 {
                let pixels: usize = vectors.iter().map(|v| v.pixels.len()).sum();
                candidates.push((pixel, pixels as f32 * plate / all, covered));
            }
        }
    }
    let total: f64 = candidates.iter().map(|&(_, light, covered)| f64::from(light * covered)).sum();
    let step = total / PROBES as f64;
    let (mut probes, mut next, mut sum) = (Vec::with_capacity(PROBES + 1), step / 2.0, 0.0);
    for (pixel, light, covered) in candidates {
        sum += f64::from(light * covered);
        if sum > next && step > 0.0 {
            let drawn = ((sum - next) / step).ceil();
            next += drawn * step;
            let nearest = (0..3).max_by(|&a, &b| pixel.weights[a].total_cmp(&pixel.weights[b])).unwrap_or(0);
            let light = (drawn * step) as f32 / covered;
            probes.push(Probe { position: pixel.position, vertex: pixel.vertices[nearest], light });
        }
    }
    probes
}

/// About the share of the hemisphere over a receiver that the object's bounding sphere covers.
fn covered(position: Vec3, normal: Vec3, bounds: &Bounds) -> f32 {
    let to = bounds.centre - position;
    // What lies behind the receiver's plane takes nothing from it.
    let above = (to.dot(normal) / bounds.radius + 1.0).clamp(0.0, 2.0) / 2.0;
    let square = bounds.radius * bounds.radius;
    above * square / to.length_squared().max(square)
}

/// Sums over the probes for each affected source.
struct Losses {
    /// Light lost where the source's shadow falls.
    lost: Vec<f64>,
    /// Probed light where it falls, per unit of irradiance.
    met: Vec<f64>,
    /// Light that it sends to all probes.
    sent: Vec<f64>,
    /// Probed light, per unit of irradiance.
    light: f64,
}

impl Losses {
    fn new(scene: &Scene, affected: &Affected, bounds: &Bounds, probes: &[Probe]) -> Self {
        let places = Places::new(scene, affected, bounds);
        let rows = rows(scene, affected, probes);
        let count = affected.sources.len();
        let parts: Vec<Self> = probes
            .par_chunks(PROBES / 8)
            .map(|probes| {
                let mut part = Self::none(count);
                probes.iter().for_each(|p| part.add(p, &rows[&p.vertex], &places, bounds));
                part
            })
            .collect();
        parts.into_iter().fold(Self::none(count), Self::plus)
    }

    fn none(count: usize) -> Self {
        Self { lost: vec![0.0; count], met: vec![0.0; count], sent: vec![0.0; count], light: 0.0 }
    }

    fn plus(mut self, other: Self) -> Self {
        let add = |a: &mut Vec<f64>, b: Vec<f64>| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        add(&mut self.lost, other.lost);
        add(&mut self.met, other.met);
        add(&mut self.sent, other.sent);
        self.light += other.light;
        self
    }

    fn add(&mut self, probe: &Probe, row: &[f32], places: &Places, bounds: &Bounds) {
        let to = bounds.centre - probe.position;
        let distance = to.length();
        let toward = to / distance.max(1e-6);
        let sine = (bounds.radius / distance.max(1e-6)).min(1.0);
        // Within the sphere every direction meets the object.
        let (square, nearest) =
            if sine < 1.0 { (1.0 - sine * sine, distance - bounds.radius) } else { (-1.0, f32::MIN) };
        self.light += f64::from(probe.light);
        let p = probe.position;
        let sources = row.iter().zip(&places.x).zip(&places.y).zip(&places.z);
        let sums = self.lost.iter_mut().zip(&mut self.met).zip(&mut self.sent);
        for ((((&sent, &x), &y), &z), ((lost, met), all)) in sources.zip(sums) {
            let (x, y, z) = (x - p.x, y - p.y, z - p.z);
            let along = x * toward.x + y * toward.y + z * toward.z;
            let hidden = along >= nearest && along * along >= square * (x * x + y * y + z * z);
            let light = if hidden { f64::from(probe.light) } else { 0.0 };
            *lost += light * f64::from(sent);
            *met += light;
            *all += f64::from(probe.light * sent);
        }
    }

    /// For each source the light that is lost, and the mean irradiance where its shadow falls. Light that met no probe is
    /// not forgotten: something may lie between them.
    fn by_source(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        let least = f64::MIN_POSITIVE.sqrt();
        self.lost.iter().zip(&self.met).zip(&self.sent).map(move |((&lost, &met), &sent)| {
            let mean = if met > 0.0 { lost / met } else { sent / self.light.max(least) };
            (lost.max(UNMET * sent).max(least), mean.max(least))
        })
    }
}

/// Centres of the affected sources, m.
struct Places {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
}

impl Places {
    fn new(scene: &Scene, affected: &Affected, bounds: &Bounds) -> Self {
        let place = |j: u32| match scene.transfers.sources[j as usize].kind {
            SourceKind::Patch(p) => scene.light.mesh.centroid(p as usize),
            SourceKind::Distant(d) => bounds.centre + scene.light.distant[d as usize].direction * FAR,
        };
        let places: Vec<Vec3> = affected.sources.iter().map(|&j| place(j)).collect();
        Self {
            x: places.iter().map(|p| p.x).collect(),
            y: places.iter().map(|p| p.y).collect(),
            z: places.iter().map(|p| p.z).collect(),
        }
    }
}

/// Luminance that the affected sources send to the probes' vertices.
fn rows(scene: &Scene, affected: &Affected, probes: &[Probe]) -> HashMap<u32, Vec<f32>> {
    let vertices: BTreeSet<u32> = probes.iter().map(|p| p.vertex).collect();
    let vertices: Vec<u32> = vertices.into_iter().collect();
    let row = |all: &mut Vec<[f32; 3]>, &vertex: &u32| {
        all.resize(scene.transfers.sources.len(), [0.0; 3]);
        scene.transfers.expand(vertex, all);
        (vertex, affected.sources.iter().map(|&j| luminance(all[j as usize])).collect())
    };
    vertices.par_iter().map_init(Vec::new, row).collect()
}

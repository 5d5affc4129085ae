//! Shadow maps from representative sources, subtracted in f32 (Gibson et al. 2003, §7–8), in plain Rust.

use super::ldr::Ldr;
use super::lookup::{Cover, Pyramid};
use super::plan::{Outlook, Plan};
use super::projection::{MapPlan, OFFSETS, ShadowOrigin};
use super::raster::{ShadowMap, rasterise};
use super::tiles::{Pixel, Prepared, Tile, Vector};
use super::{Bounds, Occluder, Problem, Removed, Scene};
use crate::config::Render;
use crate::image::RadianceImage;
use crate::transfer::Traversal;
use crate::visibility::Bvh;
use glam::Vec3;
use ndarray::Array3;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};
use wide::f32x8;

/// Texels of shadow maps that are held at a time.
const BATCH_TEXELS: usize = 24 << 20;
/// Columns of transfers that are held at a time.
const BATCH_CLUSTERS: usize = 512;

/// Rays by which a tile is probed.
const RAY_PROBES: usize = 8;

/// The method with everything static in place; only the object changes from frame to frame.
pub struct RadianceTransfer<'a> {
    scene: Scene<'a>,
    prepared: Prepared,
    /// Tags of the hierarchy's nodes, frame by frame.
    traversal: Mutex<Traversal>,
    /// Where codes are subtracted instead of radiance.
    ldr: Option<Ldr<'a>>,
    passes: usize,
    origins: usize,
    map_px: usize,
}

/// A map's light as one frame sees it.
enum Mask {
    Map(Pyramid),
    Rays(ShadowOrigin),
}

/// Some clusters with their maps, drawn, and what they send to the receivers.
struct Batch<'a> {
    maps: &'a [MapPlan],
    /// Number of the first map.
    first: u32,
    masks: Vec<Mask>,
    columns: &'a Columns,
    /// The occluder, for the origins that are too near for a map.
    rays: &'a Rays,
}

/// Irradiance from each of some clusters at some receiver vertices.
pub(crate) struct Columns {
    /// Number of the first cluster.
    pub first: u32,
    /// Rows by receiver vertex.
    pub row: Vec<u32>,
    /// [rows × clusters × 3], plate units.
    pub irradiance: Array3<f32>,
}

struct Rays {
    bvh: Bvh,
    bounds: Bounds,
}

impl<'a> RadianceTransfer<'a> {
    /// Everything that does not depend on the object.
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        let prepared = Prepared::registered(scene, settings)?;
        Ok(Self {
            ldr: Ldr::prepare(scene, &prepared, settings)?,
            prepared,
            traversal: Mutex::default(),
            scene: *scene,
            passes: settings.passes,
            origins: settings.origins.max(1),
            map_px: settings.shadow_map_px,
        })
    }

    /// ε for an object.
    pub fn removed_radiance(&self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        let outlook = self.outlook(occluder);
        Ok(self.compose(occluder, &outlook, self.passes))
    }

    /// The shadow maps of an object, for those origins that are not too near for one.
    pub fn shadow_maps(&self, occluder: &Occluder) -> Result<Vec<ShadowMap>, Problem> {
        occluder.check()?;
        let plan = self.plan(&self.outlook(occluder), self.passes);
        let drawn: Vec<_> = plan.maps.iter().filter_map(|p| Some((p.projection?, p.size))).collect();
        Ok(drawn.par_iter().map(|(p, size)| rasterise(p, occluder, *size)).collect())
    }

    /// What an object has to do with the light.
    pub(crate) fn outlook(&self, occluder: &Occluder) -> Outlook<'a> {
        let bounds = Bounds::of(occluder);
        let mut traversal = self.traversal.lock().unwrap_or_else(PoisonError::into_inner);
        let affected = traversal.affected(self.scene.transfers, bounds.min, bounds.max);
        Outlook::new(&self.scene, &self.prepared, affected, bounds)
    }

    pub(crate) fn plan(&self, outlook: &Outlook, passes: usize) -> Plan {
        outlook.plan(passes, self.origins, self.ldr.is_none(), self.map_px)
    }

    /// The relative shadow error to expect of so many passes.
    pub(crate) fn expected_error(&self, outlook: &Outlook, passes: usize) -> f64 {
        outlook.error(passes, self.origins)
    }

    /// ε with so many passes.
    pub(crate) fn compose(&self, occluder: &Occluder, outlook: &Outlook, passes: usize) -> Removed {
        let plan = self.plan(outlook, passes);
        let mut blocked = vec![[0.0f32; 3]; self.prepared.pixels.len()];
        self.add(occluder, outlook, &plan, &mut blocked);
        let Some(ldr) = &self.ldr else {
            return self.removed(&plan, self.prepared.epsilon(self.scene.plate, &blocked));
        };
        let (codes, epsilon) = ldr.subtract(&self.prepared.pixels, &blocked);
        Removed { codes: Some(codes), ..self.removed(&plan, epsilon) }
    }

    /// Adds the irradiance that is blocked; code values where those are subtracted.
    pub(crate) fn add(&self, occluder: &Occluder, outlook: &Outlook, plan: &Plan, blocked: &mut [[f32; 3]]) {
        let lists = self.maps_of_tiles(&plan.maps, outlook.patches());
        let vertices = self.vertices_of(&lists);
        let rays = Rays::new(occluder);
        // What a cluster takes from a code depends on those before it: all of them at once.
        let intensities = self.ldr.as_ref().filter(|_| !plan.maps.is_empty()).map(|ldr| {
            let mut columns = self.columns(plan, &vertices, 0..plan.maps.len());
            ldr.intensities(&self.scene, plan, &vertices, &mut columns);
            columns
        });
        for maps in batches(&plan.maps) {
            let own;
            let columns = match &intensities {
                Some(all) => all,
                None => {
                    own = self.columns(plan, &vertices, maps.clone());
                    &own
                }
            };
            let batch = Batch::draw(&plan.maps[maps.clone()], maps.start as u32, columns, occluder, &rays);
            self.subtract(&batch, &lists, blocked);
        }
    }

    /// The same answer without culling, tiles or vectors: a plain loop over pixels and maps that sums in f64, to compare
    /// with.
    pub fn removed_radiance_plainly(&self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        let plan = self.plan(&self.outlook(occluder), self.passes);
        let vertices: Vec<u32> = (0..self.vertex_count() as u32).collect();
        let rays = Rays::new(occluder);
        let mut blocked = vec![[0.0f64; 3]; self.prepared.pixels.len()];
        for range in batches(&plan.maps) {
            let columns = self.columns(&plan, &vertices, range.clone());
            let maps = &plan.maps[range];
            let drawn: Vec<Option<ShadowMap>> =
                maps.par_iter().map(|p| Some(rasterise(&p.projection?, occluder, p.size))).collect();
            blocked.par_iter_mut().zip(&self.prepared.pixels).for_each(|(sum, pixel)| {
                for (plan, map) in maps.iter().zip(&drawn) {
                    let position = pixel.at(OFFSETS[plan.offset]);
                    let blocked = match map {
                        Some(map) => map.blocked(position, pixel.normal),
                        None => rays.blocked(&plan.origin, position, pixel.normal),
                    };
                    if blocked {
                        let corners = pixel.vertices.map(|v| columns.at(v, plan.cluster));
                        for (c, sum) in sum.iter_mut().enumerate() {
                            let irradiance: f32 = (0..3).map(|k| pixel.weights[k] * corners[k][c]).sum();
                            *sum += f64::from(plan.weight) * f64::from(irradiance);
                        }
                    }
                }
            });
        }
        let blocked: Vec<_> = blocked.iter().map(|sum| sum.map(|c| c as f32)).collect();
        Ok(self.removed(&plan, self.prepared.epsilon(self.scene.plate, &blocked)))
    }

    /// ε with what is to be said of it.
    pub(crate) fn removed(&self, plan: &Plan, epsilon: RadianceImage) -> Removed {
        Removed {
            epsilon,
            codes: None,
            noise: None,
            sources_used: plan.sources,
            passes: plan.passes,
            shadow_maps: plan.maps.len(),
            expected_error: Some(plan.error),
            left_out_share: self.scene.transfers.left_out_share,
        }
    }

    /// The static side of a frame.
    pub(crate) fn prepared(&self) -> &Prepared {
        &self.prepared
    }

    /// The plate.
    pub(crate) fn plate(&self) -> &'a RadianceImage {
        self.scene.plate
    }

    /// Number of passes that the settings ask for.
    pub(crate) fn passes(&self) -> usize {
        self.passes
    }

    pub(crate) fn set_passes(&mut self, passes: usize) {
        self.passes = passes;
    }

    /// Number of receiver vertices.
    pub(crate) fn vertex_count(&self) -> usize {
        self.scene.transfers.receivers.positions.len()
    }

    /// Largest side of a shadow map, texels.
    pub(crate) fn map_px(&self) -> usize {
        self.map_px
    }

    /// What the clusters of some maps send to some receiver vertices.
    pub(crate) fn columns(&self, plan: &Plan, vertices: &[u32], maps: Range<usize>) -> Columns {
        let (first, last) = (plan.maps[maps.start].cluster, plan.maps[maps.end - 1].cluster);
        let clusters = &plan.clusters[first as usize..=last as usize];
        let mut row = vec![u32::MAX; self.scene.transfers.receivers.positions.len()];
        vertices.iter().zip(0..).for_each(|(&v, i)| row[v as usize] = i);
        let irradiance = self.scene.transfers.gather(&plan.marked, clusters, vertices);
        Columns { first, row, irradiance }
    }

    /// For every tile the numbers of the maps that can shadow it, ascending.
    pub(crate) fn maps_of_tiles(&self, maps: &[MapPlan], patches: &[u32]) -> Vec<Vec<u32>> {
        let receives = |tile: &Tile| tile.patches.iter().any(|p| patches.binary_search(p).is_ok());
        let blocks = self.prepared.blocks.par_iter().flat_map_iter(|block| {
            let near: Vec<u32> = (0..)
                .zip(maps)
                .filter(|(_, m)| m.may_shadow(block.centre, block.radius))
                .map(|(i, _)| i)
                .collect();
            let tiles = &self.prepared.tiles[block.tiles.clone()];
            tiles.iter().map(move |tile| {
                if near.is_empty() || !receives(tile) {
                    return Vec::new();
                }
                let may = |&&i: &&u32| maps[i as usize].may_shadow(tile.centre, tile.radius);
                near.iter().filter(may).copied().collect()
            })
        });
        blocks.collect()
    }

    /// Receiver vertices of the tiles that may be shadowed, ascending.
    pub(crate) fn vertices_of(&self, lists: &[Vec<u32>]) -> Vec<u32> {
        let mut used = vec![false; self.scene.transfers.receivers.positions.len()];
        for (tile, _) in self.prepared.tiles.iter().zip(lists).filter(|(_, maps)| !maps.is_empty()) {
            tile.vertices.iter().for_each(|&v| used[v as usize] = true);
        }
        (0..).zip(used).filter(|(_, used)| *used).map(|(v, _)| v).collect()
    }

    /// Adds what a batch blocks. Every pixel belongs to one tile and takes the maps in order: the same sum for any
    /// number of threads.
    fn subtract(&self, batch: &Batch, lists: &[Vec<u32>], blocked: &mut [[f32; 3]]) {
        let mut parts = Vec::with_capacity(self.prepared.tiles.len());
        let mut rest = blocked;
        for (tile, maps) in self.prepared.tiles.iter().zip(lists) {
            let (part, after) = rest.split_at_mut(tile.pixels.len());
            let range = |n: u32| maps.partition_point(|&m| m < n);
            let maps = &maps[range(batch.first)..range(batch.first + batch.maps.len() as u32)];
            if !maps.is_empty() {
                parts.push((tile, maps, part));
            }
            rest = after;
        }
        parts.into_par_iter().for_each(|(tile, maps, blocked)| {
            let vectors = &self.prepared.vectors[tile.vectors.clone()];
            let mut sums = vec![[f32x8::ZERO; 3]; vectors.len()];
            // What is gone all over the tile adds up at its vertices.
            let mut everywhere = vec![[0.0f32; 3]; tile.vertices.len()];
            self.masks(batch, tile, maps, |corners, whole, masks| {
                if let Some(ldr) = &self.ldr {
                    let numbered = tile.vectors.clone().zip(vectors).zip(masks).zip(&mut sums);
                    for (((number, vector), mask), sum) in numbered {
                        let gone = vector.interpolate(corners, *mask + f32x8::splat(whole));
                        (0..3).for_each(|c| sum[c] += ldr.pass(number, c, gone[c]));
                    }
                    return;
                }
                if whole > 0.0 {
                    let all = everywhere.iter_mut().zip(corners);
                    all.for_each(|(sum, corner)| (0..3).for_each(|c| sum[c] += whole * corner[c]));
                }
                for ((vector, mask), sum) in vectors.iter().zip(masks).zip(&mut sums) {
                    let gone = vector.interpolate(corners, *mask);
                    (0..3).for_each(|c| sum[c] += gone[c]);
                }
            });
            for (vector, sum) in vectors.iter().zip(&mut sums) {
                let gone = vector.interpolate(&everywhere, f32x8::ONE);
                (0..3).for_each(|c| sum[c] += gone[c]);
            }
            for (vector, sum) in vectors.iter().zip(sums) {
                let lanes = sum.map(f32x8::to_array);
                for (i, pixel) in vector.pixels.clone().enumerate() {
                    let pixel = &mut blocked[pixel - tile.pixels.start];
                    (0..3).for_each(|c| pixel[c] += lanes[c][i]);
                }
            }
        });
    }

    /// For each cluster that loses light in a tile, in order: its irradiance at the tile's vertices, the share of it that is
    /// lost all over the tile, and what each of the tile's vectors loses besides (nothing, if there are none).
    fn masks(
        &self,
        batch: &Batch,
        tile: &Tile,
        maps: &[u32],
        mut each: impl FnMut(&[[f32; 3]], f32, &[f32x8]),
    ) {
        let vectors = &self.prepared.vectors[tile.vectors.clone()];
        let pixels = &self.prepared.pixels;
        let mut masks = vec![f32x8::ZERO; vectors.len()];
        let mut corners = vec![[0.0f32; 3]; tile.vertices.len()];
        let plan = |m: u32| &batch.maps[(m - batch.first) as usize];
        let mut in_part = Vec::new();
        for maps in maps.chunk_by(|&a, &b| plan(a).cluster == plan(b).cluster) {
            let mut whole = 0.0;
            in_part.clear();
            for &m in maps {
                let plan = plan(m);
                let mask = &batch.masks[(m - batch.first) as usize];
                let cover = match mask {
                    Mask::Map(map) => map.cover(tile.centre, tile.radius),
                    Mask::Rays(origin) => batch.rays.cover(origin, vectors, pixels, plan.offset),
                };
                match cover {
                    Cover::Nothing => {}
                    Cover::Everything => whole += plan.weight,
                    Cover::Part => in_part.push((plan, mask)),
                }
            }
            if whole == 0.0 && in_part.is_empty() {
                continue;
            }
            for (corner, &v) in corners.iter_mut().zip(&tile.vertices) {
                *corner = batch.columns.at(v, plan(maps[0]).cluster);
            }
            if corners.iter().all(|c| *c == [0.0; 3]) {
                continue;
            }
            masks.fill(f32x8::ZERO);
            for (plan, mask) in &in_part {
                let (weight, offset) = (f32x8::splat(plan.weight), plan.offset);
                match mask {
                    Mask::Map(map) => map.add(weight, vectors, pixels, offset, &mut masks),
                    Mask::Rays(origin) => {
                        for (vector, mask) in vectors.iter().zip(&mut masks) {
                            let normal = pixels[vector.pixels.start].normal;
                            *mask += weight * batch.rays.blocked_lanes(origin, vector, offset, normal);
                        }
                    }
                }
            }
            each(&corners, whole, if in_part.is_empty() && self.ldr.is_none() { &[] } else { &masks });
        }
    }
}

/// Ranges of maps of whole clusters, few enough to be held.
fn batches(maps: &[MapPlan]) -> Vec<Range<usize>> {
    let (mut batches, mut start, mut texels, mut at) = (Vec::new(), 0, 0, 0);
    for cluster in maps.chunk_by(|a, b| a.cluster == b.cluster) {
        let more: usize = cluster.iter().map(|m| m.size * m.size).sum();
        let clusters = cluster[0].cluster - maps[start].cluster;
        if at > start && (texels + more > BATCH_TEXELS || clusters as usize >= BATCH_CLUSTERS) {
            batches.push(start..at);
            (start, texels) = (at, 0);
        }
        texels += more;
        at += cluster.len();
    }
    if at > start {
        batches.push(start..at);
    }
    batches
}

impl<'a> Batch<'a> {
    fn draw(
        maps: &'a [MapPlan],
        first: u32,
        columns: &'a Columns,
        occluder: &Occluder,
        rays: &'a Rays,
    ) -> Self {
        let mask = |plan: &MapPlan| match &plan.projection {
            Some(projection) => Mask::Map(Pyramid::new(rasterise(projection, occluder, plan.size))),
            None => Mask::Rays(plan.origin),
        };
        Self { maps, first, masks: maps.par_iter().map(mask).collect(), columns, rays }
    }
}

impl Columns {
    /// Irradiance that a cluster sends to a receiver vertex.
    pub fn at(&self, vertex: u32, cluster: u32) -> [f32; 3] {
        let (row, column) = (self.row[vertex as usize] as usize, (cluster - self.first) as usize);
        [0, 1, 2].map(|c| self.irradiance[(row, column, c)])
    }
}

impl Rays {
    fn new(occluder: &Occluder) -> Self {
        Self { bvh: Bvh::new(&occluder.vertices, &occluder.triangles), bounds: Bounds::of(occluder) }
    }

    /// Whether the occluder stands between a receiver and an origin that is too near for a map.
    fn blocked(&self, origin: &ShadowOrigin, position: Vec3, normal: Vec3) -> bool {
        let from = position + normal * 1e-4;
        let near = match *origin {
            ShadowOrigin::Point(p) => self.bounds.near_segment(from, p, 0.0),
            ShadowOrigin::Direction(_) => true,
        };
        near && origin.hidden_by(&self.bvh, from)
    }

    /// What a few rays say of a tile: an origin at the object sees it large, with few edges.
    fn cover(&self, origin: &ShadowOrigin, vectors: &[Vector], pixels: &[Pixel], offset: usize) -> Cover {
        let blocked = |vector: &Vector| {
            let position = vector.positions[offset].map(|lanes| lanes.as_array_ref()[0]);
            self.blocked(origin, Vec3::from(position), pixels[vector.pixels.start].normal)
        };
        let mut probes = vectors.iter().step_by(vectors.len().div_ceil(RAY_PROBES).max(1)).map(blocked);
        let first = probes.next().unwrap_or(false);
        match (first, probes.all(|b| b == first)) {
            (true, true) => Cover::Everything,
            (false, true) => Cover::Nothing,
            _ => Cover::Part,
        }
    }

    fn blocked_lanes(&self, origin: &ShadowOrigin, vector: &Vector, offset: usize, normal: Vec3) -> f32x8 {
        let [x, y, z] = vector.positions[offset].map(f32x8::to_array);
        let mut share = [0.0; 8];
        for (i, share) in share.iter_mut().enumerate().take(vector.pixels.len()) {
            *share = f32::from(self.blocked(origin, Vec3::new(x[i], y[i], z[i]), normal));
        }
        f32x8::new(share)
    }
}

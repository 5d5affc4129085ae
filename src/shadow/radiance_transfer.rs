//! One shadow map per source, subtracted in f32 (Gibson et al. 2003, §7), in plain Rust.

use super::projection::{MapPlan, ShadowOrigin, plan};
use super::raster::{ShadowMap, rasterise};
use super::tiles::{Pixel, Prepared, Tile};
use super::{Occluder, Problem, Removed, Scene};
use crate::config::Render;
use crate::illuminate::patch::LightModel;
use crate::transfer::Source;
use crate::visibility::Bvh;
use glam::{Vec2, Vec3};
use ndarray::Array2;
use rayon::prelude::*;

/// Bytes of shadow maps that are held at a time.
const BATCH_BYTES: usize = 64 << 20;

/// The method with everything static in place; only the object changes from frame to frame.
pub struct RadianceTransfer {
    prepared: Prepared,
    light: LightModel,
    sources: Vec<Source>,
    /// [sources × receiver vertices], sr.
    transfer: Array2<f32>,
    radiance: Vec<[f32; 3]>,
    left_out_share: f64,
    size: usize,
    max_angle: f32,
}

/// A source as one frame sees it.
enum Mask {
    Map(ShadowMap),
    Rays(ShadowOrigin),
}

impl RadianceTransfer {
    /// Everything that does not depend on the object.
    pub fn prepare(scene: &Scene, settings: &Render) -> Result<Self, Problem> {
        let chosen = scene.chosen(settings);
        let sources: Vec<Source> = chosen.iter().map(|&j| scene.transfers.sources[j]).collect();
        Ok(Self {
            prepared: Prepared::new(scene, settings)?,
            radiance: sources.iter().map(|s| s.radiance(scene.light)).collect(),
            transfer: scene.transfer(&chosen),
            light: scene.light.clone(),
            left_out_share: scene.left_out_share(&chosen),
            sources,
            size: settings.shadow_map_px,
            max_angle: max_angle(settings)?,
        })
    }

    /// ε for an object.
    pub fn removed_radiance(&self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        let plans = self.plan(occluder);
        let all: Vec<&MapPlan> = plans.iter().collect();
        let blocked = vec![[0.0f32; 3]; self.prepared.pixels.len()];
        Ok(self.finish(occluder, &all, blocked, plans.len()))
    }

    /// The shadow maps of an object, for those sources that are not too near for one.
    pub fn shadow_maps(&self, occluder: &Occluder) -> Result<Vec<ShadowMap>, Problem> {
        occluder.check()?;
        let plans = self.plan(occluder);
        let drawn: Vec<_> = plans.iter().filter_map(|p| Some((p.projection?, p.size))).collect();
        Ok(drawn.par_iter().map(|(p, size)| rasterise(p, occluder, *size)).collect())
    }

    /// The maps of a frame: those that can shadow a receiver which their source lights.
    pub(crate) fn plan(&self, occluder: &Occluder) -> Vec<MapPlan> {
        let mut plans = plan(&self.light, &self.sources, occluder, self.size, self.max_angle);
        let needed: Vec<bool> = plans.par_iter().map(|p| self.tiles_of(p).next().is_some()).collect();
        let mut needed = needed.into_iter();
        plans.retain(|_| needed.next().unwrap_or(true));
        plans
    }

    /// Tiles that a map can shadow, by their number.
    fn tiles_of<'a>(&'a self, plan: &'a MapPlan) -> impl Iterator<Item = usize> + 'a {
        let row = self.transfer.row(plan.source as usize);
        let lit = move |tile: &Tile| tile.columns.iter().any(|&column| row[column as usize] > 0.0);
        let tiles = self.prepared.tiles.iter().enumerate();
        tiles.filter(move |(_, t)| plan.may_shadow(t.centre, t.radius) && lit(t)).map(|(i, _)| i)
    }

    /// Adds what the given maps block to what others have, and makes ε of it.
    pub(crate) fn finish(
        &self,
        occluder: &Occluder,
        plans: &[&MapPlan],
        mut blocked: Vec<[f32; 3]>,
        shadow_maps: usize,
    ) -> Removed {
        let bvh = Bvh::new(&occluder.vertices, &occluder.triangles);
        let batch = (BATCH_BYTES / (4 * self.size * self.size)).max(1);
        for plans in plans.chunks(batch) {
            let masks: Vec<Mask> = plans
                .par_iter()
                .map(|plan| match &plan.projection {
                    Some(projection) => Mask::Map(rasterise(projection, occluder, plan.size)),
                    None => Mask::Rays(plan.origin),
                })
                .collect();
            self.add(plans, &masks, &bvh, &mut blocked);
        }
        Removed {
            epsilon: self.prepared.epsilon(&blocked),
            noise: None,
            sources_used: self.sources.len(),
            shadow_maps,
            left_out_share: self.left_out_share,
        }
    }

    /// Largest side of a shadow map, texels.
    pub(crate) fn map_px(&self) -> usize {
        self.size
    }

    /// [sources × receiver vertices], sr.
    pub(crate) fn transfer(&self) -> &Array2<f32> {
        &self.transfer
    }

    /// Receiver pixels, in the order of what is blocked.
    pub(crate) fn pixels(&self) -> &[Pixel] {
        &self.prepared.pixels
    }

    /// Radiance of a map's source, times the map's share of it.
    pub(crate) fn map_radiance(&self, plan: &MapPlan) -> [f32; 3] {
        self.radiance[plan.source as usize].map(|c| c * plan.weight)
    }

    /// Adds what some maps block. Every pixel belongs to one tile and takes the maps in order: the same sum for any
    /// number of threads.
    fn add(&self, plans: &[&MapPlan], masks: &[Mask], bvh: &Bvh, blocked: &mut [[f32; 3]]) {
        let mut parts = Vec::with_capacity(self.prepared.tiles.len());
        let mut rest = blocked;
        for tile in &self.prepared.tiles {
            let (part, after) = rest.split_at_mut(tile.pixels.len());
            parts.push((tile, part));
            rest = after;
        }
        parts.into_par_iter().for_each(|(tile, blocked)| {
            let pixels = &self.prepared.pixels[tile.pixels.clone()];
            for (plan, mask) in plans.iter().zip(masks) {
                if !plan.may_shadow(tile.centre, tile.radius) {
                    continue;
                }
                let row = self.transfer.row(plan.source as usize);
                let Some(row) = row.as_slice() else { continue };
                let radiance = self.map_radiance(plan);
                for (pixel, sum) in pixels.iter().zip(&mut *blocked) {
                    let share = mask.blocked(pixel, plan.offset, bvh);
                    if share > 0.0 {
                        let irradiance = share * pixel.interpolate(row);
                        for c in 0..3 {
                            sum[c] += radiance[c] * irradiance;
                        }
                    }
                }
            }
        });
    }
}

/// The setting `source_angle_deg`, rad.
pub(crate) fn max_angle(settings: &Render) -> Result<f32, Problem> {
    if settings.source_angle_deg > 0.0 {
        return Ok(settings.source_angle_deg.to_radians() as f32);
    }
    let value = settings.source_angle_deg.to_string();
    Err(Problem::Setting { name: "source_angle_deg", value, range: "above 0" })
}

impl Mask {
    fn blocked(&self, pixel: &Pixel, offset: Vec2, bvh: &Bvh) -> f32 {
        let position = pixel.at(offset);
        match self {
            Self::Map(map) => map.blocked(position, pixel.normal),
            Self::Rays(origin) => ray_blocked(origin, position, pixel.normal, bvh),
        }
    }
}

/// Whether the occluder stands between a receiver and an origin that is too near for a map.
fn ray_blocked(origin: &ShadowOrigin, position: Vec3, normal: Vec3, bvh: &Bvh) -> f32 {
    let from = position + normal * 1e-4;
    let hit = match *origin {
        ShadowOrigin::Point(p) => bvh.occluded(from, p),
        ShadowOrigin::Direction(d) => bvh.any_hit(from, d, 0.0, f32::INFINITY),
    };
    if hit { 1.0 } else { 0.0 }
}

//! Shadow maps from representative sources on the graphics processor: raster passes draw all maps into one array
//! texture, one compute pass looks them up and leaves ε on the device.

use super::atlas::{Extent, Packing, Place};
use super::clock::{Clock, Phase};
use super::device::Buffer;
use super::layout::ShadowMap;
use super::maps::Maps;
use super::receivers::{Block, WORKGROUP};
use super::{Device, Phases, Twin, ceiling, shaders};
use crate::config::Render;
use crate::image::RadianceImage;
use crate::shadow::{self, MapPlan, OFFSETS, Occluder, Outlook, Plan, Problem, Removed, Scene};
use rayon::prelude::*;
use std::ops::Range;
use std::time::Instant;

/// What a frame may take of the device; its limits hold besides.
#[derive(Debug, Clone, Copy)]
pub struct Budget {
    /// Texels of shadow maps that are held at a time.
    pub texels: usize,
    /// Largest buffer, bytes.
    pub buffer_bytes: u64,
}

impl Default for Budget {
    fn default() -> Self {
        Self { texels: 64 << 20, buffer_bytes: u64::MAX }
    }
}

/// Times of a frame whose ε stays on the device, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Until the device is done.
    pub frame: f64,
    /// Choosing clusters and maps on the host, before anything is sent.
    pub plan: f64,
    /// The rest.
    pub phases: Phases,
}

/// The method with everything static on the device; only the object changes from frame to frame.
pub struct RadianceTransfer<'a> {
    /// The same method in plain Rust: plans the maps, does the origins that are too near for one.
    plain: shadow::RadianceTransfer<'a>,
    device: Device,
    subtract: wgpu::ComputePipeline,
    blocks: Vec<(Block, wgpu::BindGroup)>,
    maps: Maps,
    rows: Buffer,
    transfers: Buffer,
    /// Bindings of maps, rows and transfers; made anew where one of them grows.
    group: wgpu::BindGroup,
}

/// Maps that are drawn and looked up together.
struct Batch {
    maps: Range<usize>,
    places: Vec<Place>,
    layers: usize,
}

/// What the host knows of a frame before it writes to the device.
struct Work {
    /// All maps.
    plan: Plan,
    /// Those that are drawn.
    drawn: Plan,
    /// Receiver vertices that take part.
    vertices: Vec<u32>,
    /// Tiles that may change, ascending.
    affected: Vec<u32>,
    batches: Vec<Batch>,
    /// By pixel, what rays to the origins that are too near for a map find blocked.
    blocked: Option<Vec<[f32; 3]>>,
}

impl<'a> RadianceTransfer<'a> {
    /// Uploads everything that does not depend on the object.
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        Self::prepare_within(scene, settings, Budget::default())
    }

    /// The same with less of the device.
    pub fn prepare_within(scene: &Scene<'a>, settings: &Render, budget: Budget) -> Result<Self, Problem> {
        let plain = shadow::RadianceTransfer::prepare(scene, settings)?;
        let device = Device::open(budget.buffer_bytes)?;
        let invocations = device.limits.max_compute_invocations_per_workgroup;
        device.allows("a workgroup, invocations,", WORKGROUP as u64, u64::from(invocations))?;
        let extent = Extent::new(&device, plain.map_px(), budget.texels)?;
        let subtract = device.kernel(shaders::SUBTRACT_TRANSFERS, "subtract")?;
        let layout = subtract.get_bind_group_layout(1);
        let blocks = Block::all(&device, plain.prepared(), plain.plate())?;
        let maps = Maps::new(&device, extent)?;
        let storage = |label| Buffer::new(&device, label, wgpu::BufferUsages::STORAGE);
        let [rows, transfers] = ["rows of transfers, bytes,", "transfers, bytes,"].map(storage);
        let group = bind(&device, &subtract, &maps, [&rows, &transfers]);
        let blocks = blocks.into_iter().map(|b| (b.bind(&device, &layout), b)).map(|(g, b)| (b, g)).collect();
        device.wait()?;
        Ok(Self { plain, device, subtract, blocks, maps, rows, transfers, group })
    }

    /// Whether [`Self::timed`] asks the device's own clock.
    pub fn has_timestamps(&self) -> bool {
        self.device.device.features().contains(wgpu::Features::TIMESTAMP_QUERY)
    }

    /// The same method in plain Rust.
    pub(crate) fn plain(&self) -> &shadow::RadianceTransfer<'a> {
        &self.plain
    }

    /// Asks for so many passes from now on.
    pub fn set_passes(&mut self, passes: usize) {
        self.plain.set_passes(passes);
    }

    /// ε with so many passes.
    pub(crate) fn compose(
        &mut self,
        occluder: &Occluder,
        outlook: &Outlook,
        passes: usize,
    ) -> Result<Removed, Problem> {
        let work = self.work(occluder, outlook, passes);
        let plan = self.run(occluder, work, None)?;
        let blocks = self.blocks.iter().map(|(block, _)| block);
        let size = self.plain.plate().size();
        let (epsilon, _) = Block::epsilon(blocks, &self.device, self.plain.prepared(), size)?;
        Ok(self.plain.removed(&plan, epsilon))
    }

    /// A frame, measured; its ε stays on the device.
    pub fn timed(&mut self, occluder: &Occluder) -> Result<Timing, Problem> {
        occluder.check()?;
        self.device.wait()?;
        let started = Instant::now();
        let outlook = self.plain.outlook(occluder);
        let work = self.work(occluder, &outlook, self.plain.passes());
        let mut clock = Clock::new(&self.device, work.batches.len());
        let plan = started.elapsed().as_secs_f64();
        self.run(occluder, work, Some(&mut clock))?;
        self.device.wait()?;
        let frame = started.elapsed().as_secs_f64();
        Ok(Timing { frame, plan, phases: clock.read(&self.device)? })
    }

    /// Number of lookups that a frame makes.
    pub fn lookups(&self, occluder: &Occluder) -> Result<u64, Problem> {
        occluder.check()?;
        let outlook = self.plain.outlook(occluder);
        let plan = self.plain.plan(&outlook, self.plain.passes());
        let lists = self.plain.maps_of_tiles(&plan.maps, outlook.patches());
        let prepared = self.plain.prepared();
        let inside = |map: &MapPlan, pixel: &shadow::Pixel| {
            let Some(projection) = map.projection else { return false };
            let q = projection.project(pixel.at(OFFSETS[map.offset]));
            let p = q.truncate() / q.w;
            let within = |t: f32| (0.0..map.size as f32).contains(&t);
            q.w > 1e-6 && within(p.x) && within(p.y) && p.z > 0.0
        };
        let tiles = prepared.tiles.par_iter().zip(&lists).map(|(tile, maps)| {
            let pixels = &prepared.pixels[tile.pixels.clone()];
            let looks = |&m: &u32| pixels.iter().filter(|p| inside(&plan.maps[m as usize], p)).count() as u64;
            maps.iter().map(looks).sum::<u64>()
        });
        Ok(tiles.sum())
    }

    /// Lookups each second that the device could make at best.
    pub fn ceiling(&self) -> Result<f64, Problem> {
        Ok(ceiling::lookups_per_second(&self.device, &self.maps.atlas)?)
    }

    fn work(&self, occluder: &Occluder, outlook: &Outlook, passes: usize) -> Work {
        let plan = self.plain.plan(outlook, passes);
        let lists = self.plain.maps_of_tiles(&plan.maps, outlook.patches());
        let vertices = self.plain.vertices_of(&lists);
        let affected = (0..).zip(&lists).filter(|(_, maps)| !maps.is_empty()).map(|(tile, _)| tile).collect();
        let (drawn, rays): (Vec<_>, Vec<_>) = plan.maps.iter().copied().partition(|p| p.projection.is_some());
        let blocked = (!rays.is_empty()).then(|| {
            let rays = Plan { maps: rays, ..plan.clone() };
            let mut blocked = vec![[0.0; 3]; self.plain.prepared().pixels.len()];
            self.plain.add(occluder, outlook, &rays, &mut blocked);
            blocked
        });
        let drawn = Plan { maps: drawn, ..plan.clone() };
        let batches = self.batches(&drawn.maps, vertices.len());
        Work { plan, drawn, vertices, affected, batches, blocked }
    }

    /// As few as the atlas and the device's largest buffer allow; at least one.
    fn batches(&self, maps: &[MapPlan], rows: usize) -> Vec<Batch> {
        let most_clusters = (self.device.storage_bytes() as usize / (12 * rows.max(1))).max(1);
        let most_maps = self.device.storage_bytes() as usize / size_of::<ShadowMap>();
        let mut batches = Vec::new();
        let mut at = 0;
        loop {
            let (start, mut packing, mut places) = (at, Packing::new(self.maps.atlas.extent), Vec::new());
            while let Some(map) = maps.get(at) {
                let clusters = (map.cluster - maps[start].cluster) as usize + 1;
                if places.len() == most_maps.max(1) || clusters > most_clusters {
                    break;
                }
                let Some(place) = packing.place(map.size) else { break };
                places.push(place);
                at += 1;
            }
            batches.push(Batch { maps: start..at, places, layers: packing.layers() });
            if at == maps.len() || at == start {
                return batches;
            }
        }
    }

    fn run(
        &mut self,
        occluder: &Occluder,
        work: Work,
        mut clock: Option<&mut Clock>,
    ) -> Result<Plan, Problem> {
        for (i, batch) in work.batches.iter().enumerate() {
            if let Some(clock) = clock.as_deref_mut() {
                clock.start(&self.device, i)?;
            }
            let mut encoder = self.device.device.create_command_encoder(&Default::default());
            if i == 0 {
                self.begin(occluder, &work, &mut encoder)?;
            }
            let counts = self.upload(&work, batch, i > 0 || work.blocked.is_some())?;
            if let Some(clock) = clock.as_deref_mut() {
                clock.end(&self.device, Phase::Upload, &mut encoder)?;
            }
            self.maps.draw(&counts, clock.as_deref(), &mut encoder);
            if let Some(clock) = clock.as_deref_mut() {
                clock.end(&self.device, Phase::Maps, &mut encoder)?;
            }
            self.fuse(clock.as_deref(), &mut encoder);
            if let Some(clock) = clock.as_deref_mut() {
                clock.end(&self.device, Phase::Fused, &mut encoder)?;
            }
            self.device.queue.submit([encoder.finish()]);
            self.device.check()?;
        }
        Ok(work.plan)
    }

    /// What a frame uploads once: the object, and where its shadow may fall.
    fn begin(
        &mut self,
        occluder: &Occluder,
        work: &Work,
        encoder: &mut wgpu::CommandEncoder,
    ) -> Result<(), Problem> {
        self.maps.upload_mesh(&self.device, occluder)?;
        for (block, _) in &mut self.blocks {
            block.begin(&self.device, &work.affected, encoder);
            if let Some(blocked) = &work.blocked {
                block.block(&self.device, blocked);
            }
        }
        Ok(())
    }

    /// Uploads maps and transfers of a batch. Gives the number of maps in each layer.
    fn upload(&mut self, work: &Work, batch: &Batch, add: bool) -> Result<Vec<u32>, Problem> {
        let maps = &work.drawn.maps[batch.maps.clone()];
        let mut grown = false;
        let (first, clusters) = if maps.is_empty() {
            (0, 0)
        } else {
            let columns = self.plain.columns(&work.drawn, &work.vertices, batch.maps.clone());
            let values = columns.irradiance.as_slice().unwrap_or(&[]);
            grown |= self.rows.write(&self.device, bytemuck::cast_slice(&columns.row))?;
            grown |= self.transfers.write(&self.device, bytemuck::cast_slice(values))?;
            (columns.first, columns.irradiance.dim().1 as u32)
        };
        let parameters: Vec<ShadowMap> = maps
            .iter()
            .zip(&batch.places)
            .filter_map(|(plan, place)| ShadowMap::of(plan, *place, plan.cluster - first))
            .collect();
        let (counts, moved) =
            self.maps.upload(&self.device, &parameters, batch.layers, [clusters, u32::from(add)])?;
        if grown || moved {
            self.group = bind(&self.device, &self.subtract, &self.maps, [&self.rows, &self.transfers]);
        }
        Ok(counts)
    }

    /// Looks the maps up at the tiles that they may shadow.
    fn fuse(&self, clock: Option<&Clock>, encoder: &mut wgpu::CommandEncoder) {
        let timestamp_writes = clock.and_then(Clock::fused);
        let mut pass =
            encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: None, timestamp_writes });
        pass.set_pipeline(&self.subtract);
        pass.set_bind_group(0, &self.group, &[]);
        for (block, group) in self.blocks.iter().filter(|(block, _)| block.count > 0) {
            pass.set_bind_group(1, group, &[]);
            pass.dispatch_workgroups(block.count, 1, 1);
        }
    }

    /// The shadow maps of an object, for those origins that are not too near for one.
    pub fn shadow_maps(&mut self, occluder: &Occluder) -> Result<Vec<shadow::ShadowMap>, Problem> {
        occluder.check()?;
        let outlook = self.plain.outlook(occluder);
        let work = self.work(occluder, &outlook, self.plain.passes());
        let side = self.maps.atlas.extent.side();
        let row = (4 * side).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize);
        let mut maps = Vec::with_capacity(work.drawn.maps.len());
        for batch in work.batches.iter().filter(|b| b.layers > 0) {
            self.maps.upload_mesh(&self.device, occluder)?;
            let counts = self.upload(&work, batch, false)?;
            let mut encoder = self.device.device.create_command_encoder(&Default::default());
            self.maps.draw(&counts, None, &mut encoder);
            let bytes = (row * side * batch.layers) as u64;
            self.device.allows(
                "shadow maps to be read, bytes,",
                bytes,
                self.device.limits.max_buffer_size,
            )?;
            let staging = self.device.staging(bytes);
            let layout = wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(row as u32),
                rows_per_image: Some(side as u32),
            };
            encoder.copy_texture_to_buffer(
                self.maps.atlas.texture.as_image_copy(),
                wgpu::TexelCopyBufferInfo { buffer: &staging, layout },
                wgpu::Extent3d {
                    depth_or_array_layers: batch.layers as u32,
                    ..self.maps.atlas.texture.size()
                },
            );
            self.device.queue.submit([encoder.finish()]);
            let values: Vec<f32> = self.device.read(&staging)?;
            for (plan, place) in work.drawn.maps[batch.maps.clone()].iter().zip(&batch.places) {
                let Some(projection) = plan.projection else { continue };
                let [x, y] = place.corner.map(|c| c as usize);
                let lines = (0..plan.size).map(|line| (place.layer as usize * side + y + line) * row / 4 + x);
                let depth = lines.flat_map(|at| &values[at..at + plan.size]).copied().collect();
                maps.push(shadow::ShadowMap { projection, size: plan.size, depth });
            }
        }
        Ok(maps)
    }

    /// Takes the device away, as a driver that is reset does.
    #[cfg(test)]
    pub(super) fn lose_device(&self) {
        self.device.device.destroy();
    }
}

impl Twin for RadianceTransfer<'_> {
    fn adapter(&self) -> &str {
        &self.device.adapter
    }

    fn removed_radiance(&mut self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        let outlook = self.plain.outlook(occluder);
        self.compose(occluder, &outlook, self.plain.passes())
    }

    fn plain_radiance(&mut self, occluder: &Occluder) -> Result<Removed, Problem> {
        self.plain.removed_radiance(occluder)
    }

    fn plate(&self) -> &RadianceImage {
        self.plain.plate()
    }
}

fn bind(
    device: &Device,
    subtract: &wgpu::ComputePipeline,
    maps: &Maps,
    [rows, transfers]: [&Buffer; 2],
) -> wgpu::BindGroup {
    let [parameters, atlas] = maps.resources();
    let [frame, rows, transfers] = [maps.frame(), rows, transfers].map(|b| b.get().as_entire_binding());
    device.bind(&subtract.get_bind_group_layout(0), [parameters, atlas, frame, rows, transfers])
}

//! The plate under a few lights on the graphics processor: raster passes draw a shadow map for each light, a compute pass
//! fills the shadow buffer, another resamples it. What the methods `subtractive` and `light-dome` share.

use super::atlas::{Extent, Packing};
use super::device::Buffer;
use super::layout::{self, Detail, Sample, ShadowMap};
use super::maps::Maps;
use super::rays::{Hierarchies, NOTHING};
use super::receivers::Block;
use super::{Budget, Device, shaders};
use crate::shadow::{Bounds, MapPlan, Occluder, Problem, Removed, ShadowOrigin};
use crate::subtractive::{Light, LitPlate as Plain, Surface, grid, half, sampled};
use crate::visibility::BinaryBvh;
use std::ops::Range;
use std::time::Instant;

/// Invocations of a workgroup of subtractive_resample.wgsl, and of a side of one of subtractive_gather.wgsl.
const WORKGROUP: usize = 256;
const GATHER_SIDE: usize = 8;
/// Lights of a batch: drivers end long kernels, and llvmpipe, the software Vulkan, ends the loops of an invocation without a word
/// after 65,535 rounds of all together (`LP_MAX_TGSI_LOOP_ITERATIONS` of Mesa's gallivm), those of rays against the scene included.
const MOST_LIGHTS: usize = 64;
/// Kinds of lights, as subtractive_hidden.wgsl has them.
const DISTANT: u32 = 0;
const POINT: u32 = 1;
const PATCH: u32 = 2;
/// A light without a map.
const NONE: u32 = u32::MAX;

/// Everything of it that stays on the device when the object and its lights change.
pub(super) struct LitPlate {
    device: Device,
    maps: Maps,
    gather: wgpu::ComputePipeline,
    resample: wgpu::ComputePipeline,
    hierarchies: Hierarchies,
    lights: Buffer,
    detail: Buffer,
    samples: Buffer,
    /// Side of the squares for which samples are on the device, px; 0: none are.
    side: usize,
    blocks: Vec<Block>,
}

/// Lights whose maps are held at a time.
struct Batch {
    lights: Range<usize>,
    parameters: Vec<ShadowMap>,
    layers: usize,
    /// By light.
    maps: Vec<u32>,
}

impl LitPlate {
    /// Uploads it.
    pub fn new(plain: &Plain, budget: Budget) -> Result<Self, Problem> {
        let device = Device::open(budget.buffer_bytes)?;
        let extent = Extent::new(&device, plain.map_px, budget.texels)?;
        let mesh = &plain.scene.light.mesh;
        let storage = |label| Buffer::new(&device, label, wgpu::BufferUsages::STORAGE);
        let plate = Self {
            maps: Maps::new(&device, extent)?,
            gather: device.kernel(shaders::SUBTRACTIVE_GATHER, "gather")?,
            resample: device.kernel(shaders::SUBTRACTIVE_RESAMPLE, "resample")?,
            hierarchies: Hierarchies::new(&device, &BinaryBvh::new(&mesh.vertices, &mesh.triangles()))?,
            lights: storage("lights, bytes,"),
            detail: Buffer::new(&device, "detail", wgpu::BufferUsages::UNIFORM),
            samples: storage("the shadow buffer, bytes,"),
            side: 0,
            blocks: Block::all(&device, &plain.prepared, plain.scene.plate)?,
            device,
        };
        plate.device.wait()?;
        Ok(plate)
    }

    /// Name of the adapter, and what it is.
    pub fn adapter(&self) -> &str {
        &self.device.adapter
    }

    /// What an object removes of lights, found at one pixel in `side`². Where the frame is `timed`, gives also what its maps,
    /// samples and the rest took, s.
    pub fn removed(
        &mut self,
        plain: &Plain,
        lights: &[Light],
        occluder: &Occluder,
        (side, timed): (usize, bool),
    ) -> Result<(Removed, [f64; 3]), Problem> {
        let started = Instant::now();
        let bounds = Bounds::of(occluder);
        let plan = |light: &Light| MapPlan::new(0, light.origin, 1.0, 0, &bounds, plain.map_px);
        let plans: Vec<MapPlan> = lights.iter().map(plan).collect();
        self.maps.upload_mesh(&self.device, occluder)?;
        let near = plans.iter().any(|p| p.projection.is_none());
        let object =
            if near { BinaryBvh::new(&occluder.vertices, &occluder.triangles) } else { BinaryBvh::default() };
        self.hierarchies.write(&self.device, &object)?;
        self.upload_samples(plain, side)?;
        let mut seconds = [0.0, 0.0, started.elapsed().as_secs_f64()];
        let batches = self.batches(&plans);
        for (i, batch) in batches.iter().enumerate() {
            let order = (i, i + 1 == batches.len());
            let taken = self.run(plain, lights, batch, order, timed)?;
            (0..3).for_each(|k| seconds[k] += taken[k]);
        }
        let maps = batches.iter().map(|b| b.parameters.len()).sum();
        let size = plain.scene.plate.size();
        let (epsilon, differences) = Block::epsilon(self.blocks.iter(), &self.device, &plain.prepared, size)?;
        Ok((plain.stated(epsilon, [lights.len(), maps], &differences), seconds))
    }

    fn upload_samples(&mut self, plain: &Plain, side: usize) -> Result<(), Problem> {
        if self.side == side {
            return Ok(());
        }
        let sample = |surface: Option<Surface>| {
            let [position, normal] =
                surface.map_or([[0.0; 3]; 2], |s| [s.position.to_array(), s.normal.to_array()]);
            Sample { position, present: u32::from(surface.is_some()), normal, padding: 0, value: [0.0; 4] }
        };
        let samples: Vec<Sample> = sampled(&plain.surfaces, side).into_iter().map(sample).collect();
        self.samples.write(&self.device, bytemuck::cast_slice(&samples))?;
        self.side = side;
        Ok(())
    }

    /// As few as the atlas and the device's largest buffer allow; at least one.
    fn batches(&self, plans: &[MapPlan]) -> Vec<Batch> {
        let room = self.device.storage_bytes() as usize;
        let most = (room / size_of::<ShadowMap>().max(size_of::<layout::Light>())).clamp(1, MOST_LIGHTS);
        let (mut batches, mut at) = (Vec::new(), 0);
        while at < plans.len() {
            let (start, mut packing) = (at, Packing::new(self.maps.atlas.extent));
            let (mut parameters, mut maps) = (Vec::new(), Vec::new());
            while let Some(plan) = plans.get(at).filter(|_| maps.len() < most) {
                let mut map = NONE;
                if plan.projection.is_some() {
                    let Some(place) = packing.place(plan.size) else { break };
                    map = parameters.len() as u32;
                    parameters.extend(ShadowMap::of(plan, place, 0));
                }
                maps.push(map);
                at += 1;
            }
            batches.push(Batch { lights: start..at, parameters, layers: packing.layers(), maps });
        }
        batches
    }

    /// Draws, gathers and resamples a batch, by its number and whether it is the last. Gives what maps, samples and the rest
    /// took, s.
    fn run(
        &mut self,
        plain: &Plain,
        lights: &[Light],
        batch: &Batch,
        (number, last): (usize, bool),
        timed: bool,
    ) -> Result<[f64; 3], Problem> {
        let started = Instant::now();
        let all = batch.lights.clone().zip(&batch.maps).map(|(i, &map)| laid_out(&lights[i], map, half(i)));
        self.lights.write(&self.device, bytemuck::cast_slice(&all.collect::<Vec<_>>()))?;
        let [scene, object] = self.hierarchies.roots();
        let (columns, rows) = grid(&plain.surfaces, self.side);
        let detail = Detail {
            lights: batch.lights.len() as u32,
            scene: if plain.model_hides { scene } else { NOTHING },
            object,
            add: u32::from(number > 0),
            side: self.side as u32,
            columns: columns as u32,
            rows: rows as u32,
            width: plain.surfaces.width() as u32,
            last: u32::from(last),
            padding_a: 0,
            padding_b: [0; 2],
        };
        self.detail.write(&self.device, bytemuck::bytes_of(&detail))?;
        let (counts, _) = self.maps.upload(&self.device, &batch.parameters, batch.layers, [0, 0])?;
        let mut marks = vec![started.elapsed()];
        let mut encoder = self.device.device.create_command_encoder(&Default::default());
        let mut mark = |encoder: &mut wgpu::CommandEncoder| -> Result<(), Problem> {
            if timed {
                // Waits for what was encoded.
                let next = self.device.device.create_command_encoder(&Default::default());
                self.device.queue.submit([std::mem::replace(encoder, next).finish()]);
                self.device.wait()?;
            }
            marks.push(started.elapsed());
            Ok(())
        };
        self.maps.draw(&counts, None, &mut encoder);
        mark(&mut encoder)?;
        self.fill([columns, rows], &mut encoder);
        mark(&mut encoder)?;
        self.subtract(&mut encoder);
        mark(&mut encoder)?;
        self.device.queue.submit([encoder.finish()]);
        self.device.check()?;
        let [before, drawn, filled, done] = [0, 1, 2, 3].map(|i| marks[i].as_secs_f64());
        Ok([drawn - before, filled - drawn, before + done - filled])
    }

    /// What both kernels bind first.
    fn bind(&self, kernel: &wgpu::ComputePipeline) -> wgpu::BindGroup {
        let [parameters, atlas] = self.maps.resources();
        let [nodes, triangles] = self.hierarchies.resources();
        let [lights, detail] = [&self.lights, &self.detail].map(|b| b.get().as_entire_binding());
        let resources = [parameters, atlas, nodes, triangles, lights, detail];
        self.device.bind(&kernel.get_bind_group_layout(0), resources)
    }

    fn bind_samples(&self, kernel: &wgpu::ComputePipeline) -> wgpu::BindGroup {
        self.device.bind(&kernel.get_bind_group_layout(1), [self.samples.get().as_entire_binding()])
    }

    fn fill(&self, cells: [usize; 2], encoder: &mut wgpu::CommandEncoder) {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&self.gather);
        pass.set_bind_group(0, &self.bind(&self.gather), &[]);
        pass.set_bind_group(1, &self.bind_samples(&self.gather), &[]);
        let [columns, rows] = cells.map(|n| n.div_ceil(GATHER_SIDE) as u32);
        pass.dispatch_workgroups(columns, rows, 1);
    }

    fn subtract(&self, encoder: &mut wgpu::CommandEncoder) {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&self.resample);
        pass.set_bind_group(0, &self.bind(&self.resample), &[]);
        pass.set_bind_group(1, &self.bind_samples(&self.resample), &[]);
        let layout = self.resample.get_bind_group_layout(2);
        for block in &self.blocks {
            let group = self.device.bind(&layout, block.buffers().map(|b| b.as_entire_binding()));
            pass.set_bind_group(2, &group, &[]);
            pass.dispatch_workgroups(block.pixels().len().div_ceil(WORKGROUP) as u32, 1, 1);
        }
    }
}

fn laid_out(light: &Light, map: u32, half: f32) -> layout::Light {
    let (kind, origin) = match light.origin {
        ShadowOrigin::Direction(direction) => (DISTANT, direction),
        ShadowOrigin::Point(point) => (POINT, point),
    };
    let patch = light.patch().filter(|_| kind == POINT);
    let (normal, reference, spread) = patch.unwrap_or((glam::Vec3::ZERO, 1.0, 0.0));
    layout::Light {
        origin: origin.to_array(),
        kind: if patch.is_some() { PATCH } else { kind },
        power: light.power,
        map,
        normal: normal.to_array(),
        padding_a: 0,
        reference,
        spread,
        half,
        padding_b: 0,
    }
}

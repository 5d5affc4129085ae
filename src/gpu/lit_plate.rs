//! Subtractive shadows of the plate on the graphics processor: raster passes draw a shadow map for each light, a compute pass
//! fills the shadow buffer, another resamples it and leaves ε on the device.

use super::atlas::{Extent, Packing};
use super::device::Buffer;
use super::layout::{Detail, Light, Sample, ShadowMap};
use super::maps::Maps;
use super::rays::Hierarchies;
use super::receivers::Block;
use super::{Budget, Device, Difference, shaders};
use crate::config::Render;
use crate::shadow::{Bounds, MapPlan, Occluder, Problem, Removed, Scene, ShadowOrigin};
use crate::subtractive::{self, expected_error, grid, half, removed, sampled};
use crate::visibility::BinaryBvh;
use std::ops::Range;
use std::time::Instant;

/// Invocations of a workgroup of subtractive_resample.wgsl, and of a side of one of subtractive_gather.wgsl.
const WORKGROUP: usize = 256;
const GATHER_SIDE: usize = 8;
/// Kinds of lights, as subtractive_hidden.wgsl has them.
const DISTANT: u32 = 0;
const POINT: u32 = 1;
const PATCH: u32 = 2;
/// A light without a map.
const NONE: u32 = u32::MAX;

/// The method with everything static on the device; only the object and its lights change from frame to frame.
pub struct Subtractive<'a> {
    /// The same method in plain Rust: finds the lights, chooses the detail.
    plain: subtractive::Subtractive<'a>,
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

/// A frame whose ε is on the device.
pub struct DrawnLights<'m, 'a> {
    method: &'m Subtractive<'a>,
    lights: Vec<subtractive::Light>,
    maps: usize,
}

/// Lights whose maps are held at a time.
struct Batch {
    lights: Range<usize>,
    parameters: Vec<ShadowMap>,
    layers: usize,
    /// By light.
    maps: Vec<u32>,
}

impl<'a> Subtractive<'a> {
    /// Uploads everything that does not depend on the object.
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        Self::prepare_within(scene, settings, Budget::default())
    }

    /// The same with less of the device.
    pub fn prepare_within(scene: &Scene<'a>, settings: &Render, budget: Budget) -> Result<Self, Problem> {
        let plain = subtractive::Subtractive::prepare(scene, settings)?;
        let device = Device::open(budget.buffer_bytes)?;
        let extent = Extent::new(&device, settings.shadow_map_px, budget.texels)?;
        let mesh = &scene.light.mesh;
        let storage = |label| Buffer::new(&device, label, wgpu::BufferUsages::STORAGE);
        let method = Self {
            maps: Maps::new(&device, extent)?,
            gather: device.kernel(shaders::SUBTRACTIVE_GATHER, "gather")?,
            resample: device.kernel(shaders::SUBTRACTIVE_RESAMPLE, "resample")?,
            hierarchies: Hierarchies::new(&device, &BinaryBvh::new(&mesh.vertices, &mesh.triangles()))?,
            lights: storage("lights, bytes,"),
            detail: Buffer::new(&device, "detail", wgpu::BufferUsages::UNIFORM),
            samples: storage("the shadow buffer, bytes,"),
            side: 0,
            blocks: Block::all(&device, plain.prepared(), scene.plate)?,
            plain,
            device,
        };
        method.device.wait()?;
        Ok(method)
    }

    /// Name of the adapter, and what it is.
    pub fn adapter(&self) -> &str {
        &self.device.adapter
    }

    /// ε of an object.
    pub fn removed_radiance(&mut self, occluder: &Occluder) -> Result<Removed, Problem> {
        self.advance(occluder)?.read()
    }

    /// Starts a frame with as much detail as the settings ask for and, if they give a time, as it allows; its ε stays on the
    /// device until it is read.
    pub fn advance(&mut self, occluder: &Occluder) -> Result<DrawnLights<'_, 'a>, Problem> {
        occluder.check()?;
        let started = Instant::now();
        let detail = self.plain.detail();
        let lights = self.plain.lights(occluder, detail)?;
        let bounds = Bounds::of(occluder);
        let size = self.plain.settings().shadow_map_px;
        let plans: Vec<MapPlan> =
            lights.iter().map(|light| MapPlan::new(0, light.origin, 1.0, 0, &bounds, size)).collect();
        self.maps.upload_mesh(&self.device, occluder)?;
        let near = plans.iter().any(|p| p.projection.is_none());
        let object =
            if near { BinaryBvh::new(&occluder.vertices, &occluder.triangles) } else { BinaryBvh::default() };
        self.hierarchies.write(&self.device, &object)?;
        self.upload_samples(detail.side)?;
        let mut seconds = [started.elapsed().as_secs_f64(), 0.0, 0.0];
        let batches = self.batches(&plans);
        for (i, batch) in batches.iter().enumerate() {
            let taken = self.run(&lights, batch, i, i + 1 == batches.len())?;
            (0..3).for_each(|k| seconds[k] += taken[k]);
        }
        self.plain.learn(detail, seconds);
        let maps = batches.iter().map(|b| b.parameters.len()).sum();
        Ok(DrawnLights { method: self, lights, maps })
    }

    /// ε, and how far plain Rust lies from it.
    pub fn parity(&mut self, occluder: &Occluder) -> Result<(Removed, Difference), Problem> {
        let removed = self.removed_radiance(occluder)?;
        let plain = self.plain.frame(occluder)?;
        let difference = Difference::between(self.plain.scene().plate, &plain.epsilon, &removed.epsilon);
        Ok((removed, difference))
    }

    fn upload_samples(&mut self, side: usize) -> Result<(), Problem> {
        if self.side == side {
            return Ok(());
        }
        let sample = |surface: Option<subtractive::Surface>| {
            let [position, normal] =
                surface.map_or([[0.0; 3]; 2], |s| [s.position.to_array(), s.normal.to_array()]);
            Sample { position, present: u32::from(surface.is_some()), normal, padding: 0, value: [0.0; 4] }
        };
        let samples: Vec<Sample> = sampled(self.plain.surfaces(), side).into_iter().map(sample).collect();
        self.samples.write(&self.device, bytemuck::cast_slice(&samples))?;
        self.side = side;
        Ok(())
    }

    /// As few as the atlas and the device's largest buffer allow; at least one.
    fn batches(&self, plans: &[MapPlan]) -> Vec<Batch> {
        let room = self.device.storage_bytes() as usize;
        let most = (room / size_of::<ShadowMap>().max(size_of::<Light>())).max(1);
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

    /// Draws, gathers and resamples a batch. Gives what that took for all else, maps and samples, s, if a time is to be kept.
    fn run(
        &mut self,
        lights: &[subtractive::Light],
        batch: &Batch,
        number: usize,
        last: bool,
    ) -> Result<[f64; 3], Problem> {
        let started = Instant::now();
        let all = batch.lights.clone().zip(&batch.maps).map(|(i, &map)| laid_out(&lights[i], map, half(i)));
        self.lights.write(&self.device, bytemuck::cast_slice(&all.collect::<Vec<_>>()))?;
        let [scene, object] = self.hierarchies.roots();
        let (columns, rows) = grid(self.plain.surfaces(), self.side);
        let detail = Detail {
            lights: batch.lights.len() as u32,
            scene,
            object,
            add: u32::from(number > 0),
            side: self.side as u32,
            columns: columns as u32,
            rows: rows as u32,
            width: self.plain.surfaces().width() as u32,
            last: u32::from(last),
            padding_a: 0,
            padding_b: [0; 2],
        };
        self.detail.write(&self.device, bytemuck::bytes_of(&detail))?;
        let (counts, _) = self.maps.upload(&self.device, &batch.parameters, batch.layers, [0, 0])?;
        let mut marks = vec![started.elapsed()];
        let mut encoder = self.device.device.create_command_encoder(&Default::default());
        self.maps.draw(&counts, None, &mut encoder);
        self.mark(&mut encoder, started, &mut marks)?;
        self.fill([columns, rows], &mut encoder);
        self.mark(&mut encoder, started, &mut marks)?;
        self.subtract(&mut encoder);
        self.mark(&mut encoder, started, &mut marks)?;
        self.device.queue.submit([encoder.finish()]);
        self.device.check()?;
        let [before, drawn, filled, done] = [0, 1, 2, 3].map(|i| marks[i].as_secs_f64());
        Ok([before + done - filled, drawn - before, filled - drawn])
    }

    /// Where a time is to be kept, waits for what was encoded.
    fn mark(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        started: Instant,
        marks: &mut Vec<std::time::Duration>,
    ) -> Result<(), super::Problem> {
        if self.plain.settings().frame_ms > 0.0 {
            let next = self.device.device.create_command_encoder(&Default::default());
            self.device.queue.submit([std::mem::replace(encoder, next).finish()]);
            self.device.wait()?;
        }
        marks.push(started.elapsed());
        Ok(())
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

impl DrawnLights<'_, '_> {
    /// Waits for it and reads ε.
    pub fn read(self) -> Result<Removed, Problem> {
        let Subtractive { plain, device, blocks, .. } = self.method;
        let plate = plain.scene().plate;
        let prepared = plain.prepared();
        let (epsilon, differences) = Block::epsilon(blocks.iter(), device, prepared, plate.size())?;
        let luminance = |p: &crate::shadow::Pixel| epsilon.pixels()[p.index as usize].luminance();
        let pairs =
            prepared.pixels.iter().zip(&differences).map(|(p, difference)| [luminance(p), *difference]);
        let expected = expected_error(pairs);
        Ok(removed(epsilon, &self.lights, self.maps, expected))
    }
}

fn laid_out(light: &subtractive::Light, map: u32, half: f32) -> Light {
    let (kind, origin) = match light.origin {
        ShadowOrigin::Direction(direction) => (DISTANT, direction),
        ShadowOrigin::Point(point) => (POINT, point),
    };
    let patch = light.patch().filter(|_| kind == POINT);
    let (normal, reference, spread) = patch.unwrap_or((glam::Vec3::ZERO, 1.0, 0.0));
    Light {
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

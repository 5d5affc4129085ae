//! Occlusion textures on the graphics processor: one raster pass draws all slices without and with the object, compute
//! passes prefilter them in whole numbers, one more combines them and leaves ε on the device.

use super::device::Buffer;
use super::layout::Textures;
use super::receivers::Block;
use super::{Device, Twin, prefilter::Prefilter, shaders};
use crate::config::Render;
use crate::image::RadianceImage;
use crate::occlusion::{Cut, Frustum, MOST_SLICES, PlateShadow, Slices};
use crate::shadow::{Occluder, Problem, Removed, Scene};
use bytemuck::Zeroable;
use glam::Mat4;

/// Invocations of a workgroup of occlusion_combine.wgsl.
const WORKGROUP: usize = 256;
/// Fills up the list of pixels to whole workgroups.
const NONE: u32 = u32::MAX;
/// What is drawn to while fragments mark the mask: nothing is written there.
const CANVAS: wgpu::TextureFormat = wgpu::TextureFormat::R8Unorm;

/// The method with everything static on the device; only the object changes from frame to frame.
pub struct OcclusionTextures<'a> {
    /// The same method in plain Rust: finds the lights, cuts the space before them.
    plain: PlateShadow<'a>,
    device: Device,
    slicer: Slicer,
    prefilter: Prefilter,
    combine: wgpu::ComputePipeline,
    scene: Mesh,
    object: Mesh,
    textures: Buffer,
    pixels: Vec<Pixels>,
}

/// Draws the mask of all slices.
struct Slicer {
    pipeline: wgpu::RenderPipeline,
    mask: wgpu::Buffer,
    canvas: wgpu::TextureView,
}

/// Triangles on the device.
struct Mesh {
    vertices: Buffer,
    triangles: Buffer,
    /// Corners of all triangles.
    count: u32,
}

/// Some of the plate's pixels.
struct Pixels {
    block: Block,
    /// Those that the object may shadow before one light.
    reached: Buffer,
    count: usize,
    /// By light.
    factors: Vec<wgpu::Buffer>,
    found: wgpu::Buffer,
}

impl<'a> OcclusionTextures<'a> {
    /// Uploads everything that does not depend on the object.
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        Self::prepare_within(scene, settings, u64::MAX)
    }

    /// The same with no buffer beyond so many bytes.
    pub fn prepare_within(scene: &Scene<'a>, settings: &Render, buffer_bytes: u64) -> Result<Self, Problem> {
        let plain = PlateShadow::prepare(scene, settings)?;
        let device = Device::open(buffer_bytes)?;
        let mut mesh = Mesh::new(&device);
        mesh.write(&device, &scene.light.mesh.vertices, plain.triangles())?;
        let blocks = Block::all(&device, plain.prepared(), scene.plate)?;
        let pixels = blocks.into_iter().map(|block| Pixels::new(&device, &plain, block));
        let method = Self {
            slicer: Slicer::new(&device, settings.occlusion_px)?,
            prefilter: Prefilter::new(&device, settings)?,
            combine: device.kernel(shaders::OCCLUSION_COMBINE, "combine")?,
            scene: mesh,
            object: Mesh::new(&device),
            textures: Buffer::new(&device, "textures", wgpu::BufferUsages::UNIFORM),
            pixels: pixels.collect::<Result<_, _>>()?,
            plain,
            device,
        };
        method.device.wait()?;
        Ok(method)
    }

    /// Takes from the plate what the object takes of one light.
    fn subtract(&mut self, cut: &Cut) -> Result<(), Problem> {
        for pixels in &mut self.pixels {
            pixels.reach(&self.device, &cut.near)?;
        }
        let layers = 2 * cut.slices.count() as u32;
        let mut first = 0;
        while first < layers {
            let batch = self.prefilter.most_layers().min(layers - first);
            let last = first + batch == layers;
            let parameters = Textures { first, layers: batch, last: u32::from(last), ..self.parameters(cut) };
            self.textures.write(&self.device, bytemuck::bytes_of(&parameters))?;
            let mut encoder = self.device.device.create_command_encoder(&Default::default());
            if first == 0 {
                let meshes = [&self.scene, &self.object];
                self.slicer.draw(&self.device, self.textures.get(), meshes, &mut encoder);
            }
            let textures = self.textures.get();
            let table = self.prefilter.run(&self.device, textures, &self.slicer.mask, batch, &mut encoder);
            self.combine(cut.light, table, &mut encoder);
            self.device.queue.submit([encoder.finish()]);
            self.device.check()?;
            first += batch;
        }
        Ok(())
    }

    fn parameters(&self, cut: &Cut) -> Textures {
        let settings = self.plain.settings();
        Textures {
            radiance: self.plain.lights()[cut.light].radiance,
            prefilter: settings.occlusion_filter as u32,
            combination: settings.combination as u32,
            closed: u32::from(settings.close_leaks),
            stride: self.prefilter.stride(),
            ..Textures::of(&cut.frustum, &cut.slices, settings.occlusion_px)
        }
    }

    fn combine(&self, light: usize, table: &wgpu::Buffer, encoder: &mut wgpu::CommandEncoder) {
        let layouts = [0, 1].map(|i| self.combine.get_bind_group_layout(i));
        let whole = [self.textures.get(), table].map(|b| b.as_entire_binding());
        let whole = self.device.bind(&layouts[0], whole);
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&self.combine);
        pass.set_bind_group(0, &whole, &[]);
        for pixels in self.pixels.iter().filter(|p| p.count > 0) {
            let [receivers, blocked, epsilon] = pixels.block.buffers();
            let reached = pixels.reached.get();
            let buffers = [receivers, blocked, epsilon, reached, &pixels.factors[light], &pixels.found];
            let group = self.device.bind(&layouts[1], buffers.map(|b| b.as_entire_binding()));
            pass.set_bind_group(1, &group, &[]);
            pass.dispatch_workgroups((pixels.count / WORKGROUP) as u32, 1, 1);
        }
    }
}

impl Twin for OcclusionTextures<'_> {
    fn adapter(&self) -> &str {
        &self.device.adapter
    }

    fn removed_radiance(&mut self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        let cuts = self.plain.cuts(occluder);
        self.object.write(&self.device, &occluder.vertices, &occluder.triangles)?;
        let mut encoder = self.device.device.create_command_encoder(&Default::default());
        self.pixels.iter().for_each(|p| p.block.clear(&mut encoder));
        self.device.queue.submit([encoder.finish()]);
        for cut in &cuts {
            self.subtract(cut)?;
        }
        let blocks = self.pixels.iter().map(|p| &p.block);
        let size = self.plate().size();
        let (epsilon, _) = Block::epsilon(blocks, &self.device, self.plain.prepared(), size)?;
        Ok(self.plain.removed(epsilon, PlateShadow::textures(&cuts)))
    }

    fn plain_radiance(&mut self, occluder: &Occluder) -> Result<Removed, Problem> {
        self.plain.frame(occluder)
    }

    fn plate(&self) -> &RadianceImage {
        self.plain.scene().plate
    }
}

impl Mesh {
    fn new(device: &Device) -> Self {
        let buffer = |label| Buffer::new(device, label, wgpu::BufferUsages::STORAGE);
        Self { vertices: buffer("vertices, bytes,"), triangles: buffer("triangles, bytes,"), count: 0 }
    }

    fn write(
        &mut self,
        device: &Device,
        vertices: &[glam::Vec3],
        triangles: &[[u32; 3]],
    ) -> Result<(), super::Problem> {
        self.vertices.write(device, bytemuck::cast_slice(vertices))?;
        self.triangles.write(device, bytemuck::cast_slice(triangles))?;
        self.count = 3 * triangles.len() as u32;
        Ok(())
    }
}

impl Pixels {
    fn new(device: &Device, plain: &PlateShadow, block: Block) -> Result<Self, super::Problem> {
        let own = &plain.prepared().pixels[block.pixels()];
        let factors = plain.lights().iter().map(|light| {
            let factors: Vec<f32> = own.iter().map(|p| light.form_factor(p.position, p.normal)).collect();
            device.resident("form factors", bytemuck::cast_slice(&factors))
        });
        Ok(Self {
            reached: Buffer::new(device, "pixels of the frame, bytes,", wgpu::BufferUsages::STORAGE),
            count: 0,
            factors: factors.collect::<Result<_, _>>()?,
            found: device.storage("visibility", 8 * own.len() as u64),
            block,
        })
    }

    /// Uploads those of it that are named by their numbers of all (ascending).
    fn reach(&mut self, device: &Device, near: &[usize]) -> Result<(), super::Problem> {
        let range = self.block.pixels();
        let own = &near[near.partition_point(|&p| p < range.start)..near.partition_point(|&p| p < range.end)];
        let mut reached: Vec<u32> = own.iter().map(|&p| (p - range.start) as u32).collect();
        reached.resize(own.len().next_multiple_of(WORKGROUP), NONE);
        self.count = reached.len();
        self.reached.write(device, bytemuck::cast_slice(&reached))?;
        Ok(())
    }
}

impl Textures {
    /// What is needed to draw.
    fn of(frustum: &Frustum, slices: &Slices, size: usize) -> Self {
        let mut planes = [[0.0; 4]; MOST_SLICES];
        for (k, plane) in planes.iter_mut().enumerate().take(slices.count()) {
            let [from, to] = slices.span(k);
            *plane = [from, to, slices.fade(k).length, 0.0];
        }
        Self {
            light_from_world: Mat4::from(frustum.light_from_world).to_cols_array_2d(),
            behind: frustum.behind,
            near: slices.span(0)[0],
            size: size as u32,
            slices: slices.count() as u32,
            planes,
            ..Self::zeroed()
        }
    }
}

impl Slicer {
    fn new(device: &Device, size: usize) -> Result<Self, super::Problem> {
        let limit = u64::from(device.limits.max_texture_dimension_2d);
        device.allows("an occlusion texture, texels along its side,", size as u64, limit)?;
        let bytes = 4 * (size as u64).pow(2);
        device.allows("an occlusion texture, bytes,", bytes, device.storage_bytes())?;
        let side = size as u32;
        let canvas = device.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("canvas"),
            size: wgpu::Extent3d { width: side, height: side, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: CANVAS,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        Ok(Self {
            pipeline: draw_pipeline(device)?,
            mask: device.storage("mask", bytes),
            canvas: canvas.create_view(&Default::default()),
        })
    }

    /// All slices in one pass, the scene as instance 0 and the object as instance 1.
    fn draw(
        &self,
        device: &Device,
        textures: &wgpu::Buffer,
        meshes: [&Mesh; 2],
        encoder: &mut wgpu::CommandEncoder,
    ) {
        encoder.clear_buffer(&self.mask, 0, None);
        let layout = self.pipeline.get_bind_group_layout(0);
        let groups = meshes.map(|mesh| {
            let buffers = [textures, mesh.vertices.get(), mesh.triangles.get(), &self.mask];
            (mesh.count, device.bind(&layout, buffers.map(|b| b.as_entire_binding())))
        });
        let operations =
            wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Discard };
        let canvas = wgpu::RenderPassColorAttachment {
            view: &self.canvas,
            depth_slice: None,
            resolve_target: None,
            ops: operations,
        };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[Some(canvas)],
            ..Default::default()
        });
        pass.set_pipeline(&self.pipeline);
        for (instance, (count, group)) in (0..).zip(&groups) {
            pass.set_bind_group(0, group, &[]);
            pass.draw(0..*count, instance..instance + 1);
        }
    }
}

fn draw_pipeline(device: &Device) -> Result<wgpu::RenderPipeline, super::Problem> {
    let module = device.shader(shaders::OCCLUSION_MASK)?;
    let target =
        wgpu::ColorTargetState { format: CANVAS, blend: None, write_mask: wgpu::ColorWrites::empty() };
    let pipeline = device.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("draw slices"),
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("draw"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("mark"),
            compilation_options: Default::default(),
            targets: &[Some(target)],
        }),
        multiview_mask: None,
        cache: None,
    });
    device.check()?;
    Ok(pipeline)
}

/// The mask of two meshes (vertices and triangles), read back.
#[cfg(test)]
pub(super) fn draw_alone(
    device: &Device,
    meshes: [(&Vec<glam::Vec3>, &Vec<[u32; 3]>); 2],
    (frustum, slices, size): (&Frustum, &Slices, usize),
) -> Result<Vec<u32>, super::Problem> {
    let [a, b] = meshes.map(|(vertices, triangles)| {
        let mut mesh = Mesh::new(device);
        mesh.write(device, vertices, triangles).map(|()| mesh)
    });
    let slicer = Slicer::new(device, size)?;
    let mut textures = Buffer::new(device, "textures", wgpu::BufferUsages::UNIFORM);
    textures.write(device, bytemuck::bytes_of(&Textures::of(frustum, slices, size)))?;
    let staging = device.staging(slicer.mask.size());
    let mut encoder = device.device.create_command_encoder(&Default::default());
    slicer.draw(device, textures.get(), [&a?, &b?], &mut encoder);
    encoder.copy_buffer_to_buffer(&slicer.mask, 0, &staging, 0, slicer.mask.size());
    device.queue.submit([encoder.finish()]);
    device.read(&staging)
}

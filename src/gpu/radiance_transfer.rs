//! Shadow maps from representative sources on the graphics processor: raster passes draw the maps of a batch, a compute
//! pass adds what they block.

use super::layout::{Frame, Receiver, ShadowMap};
use super::{Device, shaders};
use crate::config::Render;
use crate::shadow::{self, MapPlan, OFFSETS, Occluder, Outlook, Plan, Problem, Removed, Scene, batches};

/// Bytes of shadow maps that are held at a time.
const BATCH_BYTES: usize = 64 << 20;
/// Invocations of a workgroup, as in subtract_transfers.wgsl.
const WORKGROUP: usize = 64;
/// Most maps in a batch, as in subtract_transfers.wgsl.
const MOST_MAPS: usize = 1024;

/// The method with everything static on the device; only the object changes from frame to frame.
pub struct RadianceTransfer<'a> {
    /// The same method in plain Rust: plans the maps, does the origins that are too near for one.
    plain: shadow::RadianceTransfer<'a>,
    device: Device,
    draw: wgpu::RenderPipeline,
    subtract: wgpu::ComputePipeline,
    pixels: Vec<PixelBlock>,
    maps: wgpu::Buffer,
    texture: wgpu::Texture,
    depths: wgpu::TextureView,
    layers: Vec<wgpu::TextureView>,
}

/// The occluder on the device.
struct Mesh {
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    index_count: u32,
}

/// Receiver pixels within the device's limits.
struct PixelBlock {
    receivers: wgpu::Buffer,
    /// Centre and radius of what each workgroup's pixels see, m.
    spheres: wgpu::Buffer,
    blocked: wgpu::Buffer,
    count: usize,
}

impl<'a> RadianceTransfer<'a> {
    /// Uploads everything that does not depend on the object.
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        let plain = shadow::RadianceTransfer::prepare(scene, settings)?;
        let device = Device::open()?;
        let errors = device.watch();
        let prepared = Self::upload(plain, device.clone(), settings);
        errors.none_on(&device)?;
        prepared
    }

    fn upload(
        plain: shadow::RadianceTransfer<'a>,
        device: Device,
        settings: &Render,
    ) -> Result<Self, Problem> {
        let most = device.limits.max_storage_buffer_binding_size.min(device.limits.max_buffer_size) as usize;
        let storage = wgpu::BufferUsages::STORAGE;

        let per_block = (most / size_of::<Receiver>()).min(65_535 * WORKGROUP);
        let pixels =
            plain.pixels().chunks(per_block).map(|pixels| PixelBlock::new(&device, pixels)).collect();

        let size = settings.shadow_map_px;
        let batch = (BATCH_BYTES / (4 * size * size))
            .clamp(1, MOST_MAPS.min(device.limits.max_texture_array_layers as usize));
        let texture = device.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("shadow maps"),
            size: wgpu::Extent3d {
                width: size as u32,
                height: size as u32,
                depth_or_array_layers: batch as u32,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Depth32Float,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT
                | wgpu::TextureUsages::TEXTURE_BINDING
                | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let layer = |i: usize| wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2),
            base_array_layer: i as u32,
            array_layer_count: Some(1),
            ..Default::default()
        };
        let maps = device.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("map parameters"),
            size: (batch * size_of::<ShadowMap>()) as u64,
            usage: storage | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Ok(Self {
            draw: draw_pipeline(&device)?,
            subtract: subtract_pipeline(&device)?,
            layers: (0..batch).map(|i| texture.create_view(&layer(i))).collect(),
            depths: texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2Array),
                ..Default::default()
            }),
            texture,
            plain,
            device,
            pixels,
            maps,
        })
    }

    /// Name of the adapter.
    pub fn adapter(&self) -> &str {
        &self.device.adapter
    }

    /// The same method in plain Rust.
    pub(crate) fn plain(&self) -> &shadow::RadianceTransfer<'a> {
        &self.plain
    }

    /// ε for an object.
    pub fn removed_radiance(&self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        self.compose(occluder, &self.plain.outlook(occluder), self.plain.passes())
    }

    /// ε with so many passes.
    pub(crate) fn compose(
        &self,
        occluder: &Occluder,
        outlook: &Outlook,
        passes: usize,
    ) -> Result<Removed, Problem> {
        let mut plan = self.plain.plan(outlook, passes);
        let (maps, rays): (Vec<_>, Vec<_>) = plan.maps.iter().copied().partition(|p| p.projection.is_some());
        let errors = self.device.watch();
        let mesh = self.device.mesh(occluder);
        let mut encoder = self.device.device.create_command_encoder(&Default::default());
        self.pixels.iter().for_each(|block| encoder.clear_buffer(&block.blocked, 0, None));
        self.device.queue.submit([encoder.finish()]);
        plan.maps = maps;
        for batch in batches(&plan.maps) {
            self.add(&plan, &plan.maps[batch.clone()], batch, &mesh);
        }
        let blocked = self.read_blocked();
        errors.none_on(&self.device)?;
        let (mut blocked, shadow_maps) = (blocked?, plan.maps.len() + rays.len());
        plan.maps = rays;
        self.plain.add(occluder, outlook, &plan, &mut blocked);
        Ok(Removed { shadow_maps, ..self.plain.removed(&plan, &blocked) })
    }

    /// Draws some maps and adds what they block.
    fn add(&self, plan: &Plan, maps: &[MapPlan], range: std::ops::Range<usize>, occluder: &Mesh) {
        let vertices: Vec<u32> = (0..self.plain.vertex_count() as u32).collect();
        let columns = self.plain.columns(plan, &vertices, range);
        let clusters = columns.irradiance.dim().1;
        let storage = wgpu::BufferUsages::STORAGE;
        let contents = columns.irradiance.as_slice().unwrap_or(&[]);
        let transfers = self.device.upload("transfers", bytemuck::cast_slice(contents), storage);
        for plans in maps.chunks(self.layers.len()) {
            let mut encoder = self.device.device.create_command_encoder(&Default::default());
            self.draw(plans, columns.first, occluder, &mut encoder);
            for block in &self.pixels {
                let frame = self.frame(plans.len(), block.count, clusters);
                let buffers =
                    [&frame, &self.maps, &block.receivers, &transfers, &block.blocked, &block.spheres];
                let layout = self.subtract.get_bind_group_layout(0);
                let group = self.device.bind(&layout, &buffers, Some(&self.depths));
                let mut pass = encoder.begin_compute_pass(&Default::default());
                pass.set_pipeline(&self.subtract);
                pass.set_bind_group(0, &group, &[]);
                pass.dispatch_workgroups(block.count.div_ceil(WORKGROUP) as u32, 1, 1);
            }
            self.device.queue.submit([encoder.finish()]);
        }
    }

    /// Draws at most as many maps as there are layers.
    fn draw(
        &self,
        plans: &[MapPlan],
        first_cluster: u32,
        occluder: &Mesh,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        let parameters: Vec<ShadowMap> = plans
            .iter()
            .filter_map(|plan| {
                let projection = plan.projection?;
                Some(ShadowMap {
                    map_from_world: projection.map_from_world.to_cols_array_2d(),
                    planes: projection.planes.to_cols_array_2d(),
                    sides: plan.sides.map(|s| s.to_array()),
                    offset: OFFSETS[plan.offset].to_array(),
                    weight: plan.weight,
                    cluster: plan.cluster - first_cluster,
                    size: plan.size as u32,
                    padding: [0; 3],
                })
            })
            .collect();
        self.device.queue.write_buffer(&self.maps, 0, bytemuck::cast_slice(&parameters));
        let group = self.device.bind(&self.draw.get_bind_group_layout(0), &[&self.maps], None);
        for (i, (layer, plan)) in self.layers.iter().zip(plans).enumerate() {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: layer,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(1.0),
                        store: wgpu::StoreOp::Store,
                    }),
                    stencil_ops: None,
                }),
                ..Default::default()
            });
            pass.set_pipeline(&self.draw);
            pass.set_bind_group(0, &group, &[]);
            pass.set_viewport(0.0, 0.0, plan.size as f32, plan.size as f32, 0.0, 1.0);
            pass.set_vertex_buffer(0, occluder.vertices.slice(..));
            pass.set_index_buffer(occluder.indices.slice(..), wgpu::IndexFormat::Uint32);
            pass.draw_indexed(0..occluder.index_count, 0, i as u32..i as u32 + 1);
        }
    }

    /// The shadow maps of an object, for those sources that are not too near for one.
    pub fn shadow_maps(&self, occluder: &Occluder) -> Result<Vec<shadow::ShadowMap>, Problem> {
        occluder.check()?;
        let plan = self.plain.plan(&self.plain.outlook(occluder), self.plain.passes());
        let plans: Vec<MapPlan> = plan.maps.iter().filter(|p| p.projection.is_some()).copied().collect();
        let mesh = self.device.mesh(occluder);
        let size = self.plain.map_px();
        let bytes_per_row = (4 * size).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize);
        let mut maps = Vec::with_capacity(plans.len());
        for batch in plans.chunks(self.layers.len()) {
            let staging = self.device.staging((bytes_per_row * size * batch.len()) as u64);
            let mut encoder = self.device.device.create_command_encoder(&Default::default());
            self.draw(batch, 0, &mesh, &mut encoder);
            let layout = wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(bytes_per_row as u32),
                rows_per_image: Some(size as u32),
            };
            encoder.copy_texture_to_buffer(
                self.texture.as_image_copy(),
                wgpu::TexelCopyBufferInfo { buffer: &staging, layout },
                wgpu::Extent3d { depth_or_array_layers: batch.len() as u32, ..self.texture.size() },
            );
            self.device.queue.submit([encoder.finish()]);
            let values: Vec<f32> = self.device.read(&staging)?;
            for (image, plan) in values.chunks(bytes_per_row / 4 * size).zip(batch) {
                let size = plan.size;
                let rows = image.chunks(bytes_per_row / 4).take(size);
                let depth = rows.flat_map(|row| &row[..size]).copied().collect();
                maps.extend(plan.projection.map(|projection| shadow::ShadowMap { projection, size, depth }));
            }
        }
        Ok(maps)
    }

    fn frame(&self, maps: usize, pixels: usize, clusters: usize) -> wgpu::Buffer {
        let frame = Frame { maps: maps as u32, pixels: pixels as u32, clusters: clusters as u32, padding: 0 };
        self.device.upload("frame", bytemuck::bytes_of(&frame), wgpu::BufferUsages::UNIFORM)
    }

    fn read_blocked(&self) -> Result<Vec<[f32; 3]>, super::Problem> {
        let mut blocked = Vec::with_capacity(self.plain.pixels().len());
        for block in &self.pixels {
            let staging = self.device.staging((block.count * 16) as u64);
            let mut encoder = self.device.device.create_command_encoder(&Default::default());
            encoder.copy_buffer_to_buffer(&block.blocked, 0, &staging, 0, staging.size());
            self.device.queue.submit([encoder.finish()]);
            let values: Vec<[f32; 4]> = self.device.read(&staging)?;
            blocked.extend(values.iter().map(|&[r, g, b, _]| [r, g, b]));
        }
        Ok(blocked)
    }
}

impl PixelBlock {
    fn new(device: &Device, pixels: &[shadow::Pixel]) -> Self {
        let receivers: Vec<Receiver> = pixels
            .iter()
            .map(|p| Receiver {
                position: p.position.to_array(),
                vertex_a: p.vertices[0],
                normal: p.normal.to_array(),
                vertex_b: p.vertices[1],
                weights: p.weights,
                vertex_c: p.vertices[2],
                across: p.footprint[0].to_array(),
                padding_a: 0,
                down: p.footprint[1].to_array(),
                padding_b: 0,
            })
            .collect();
        let spheres: Vec<[f32; 4]> = pixels.chunks(WORKGROUP).map(sphere).collect();
        let storage = wgpu::BufferUsages::STORAGE;
        Self {
            spheres: device.upload("spheres", bytemuck::cast_slice(&spheres), storage),
            receivers: device.upload("receivers", bytemuck::cast_slice(&receivers), storage),
            blocked: device.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("blocked irradiance"),
                size: (pixels.len() * 16) as u64,
                usage: storage | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
            count: pixels.len(),
        }
    }
}

/// Around some pixels: centre and radius.
fn sphere(pixels: &[shadow::Pixel]) -> [f32; 4] {
    let (low, high) = pixels.iter().fold((glam::Vec3::INFINITY, glam::Vec3::NEG_INFINITY), |(a, b), p| {
        (a.min(p.position), b.max(p.position))
    });
    let centre = (low + high) / 2.0;
    let radius = pixels.iter().map(|p| p.position.distance(centre) + p.reach()).fold(0.0, f32::max);
    centre.extend(radius).to_array()
}

impl Device {
    fn upload(&self, label: &str, contents: &[u8], usage: wgpu::BufferUsages) -> wgpu::Buffer {
        // Written, not mapped: a mapped buffer that could not be had panics.
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: (contents.len() as u64).next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT).max(16),
            usage: usage | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        self.queue.write_buffer(&buffer, 0, contents);
        buffer
    }

    fn mesh(&self, occluder: &Occluder) -> Mesh {
        let (vertices, triangles) =
            (bytemuck::cast_slice(&occluder.vertices), bytemuck::cast_slice(&occluder.triangles));
        Mesh {
            vertices: self.upload("occluder", vertices, wgpu::BufferUsages::VERTEX),
            indices: self.upload("occluder's triangles", triangles, wgpu::BufferUsages::INDEX),
            index_count: occluder.triangles.len() as u32 * 3,
        }
    }

    /// A buffer to read results from.
    fn staging(&self, size: u64) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("for reading"),
            size,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    }

    /// Waits for the device and reads a staging buffer.
    fn read<T: bytemuck::Pod>(&self, staging: &wgpu::Buffer) -> Result<Vec<T>, super::Problem> {
        let (sender, receiver) = std::sync::mpsc::channel();
        staging.map_async(wgpu::MapMode::Read, .., move |outcome| drop(sender.send(outcome)));
        self.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|e| self.problem(e))?;
        let outcome = receiver.recv().map_err(|e| self.problem(e))?;
        outcome.map_err(|e| self.problem(e))?;
        let range = staging.get_mapped_range(..).map_err(|e| self.problem(e))?;
        Ok(bytemuck::pod_collect_to_vec(&range))
    }

    /// Buffers at bindings 0, 1, …, then a texture.
    fn bind(
        &self,
        layout: &wgpu::BindGroupLayout,
        buffers: &[&wgpu::Buffer],
        texture: Option<&wgpu::TextureView>,
    ) -> wgpu::BindGroup {
        let resources = buffers
            .iter()
            .map(|b| b.as_entire_binding())
            .chain(texture.map(wgpu::BindingResource::TextureView));
        let entries: Vec<_> = resources
            .enumerate()
            .map(|(i, resource)| wgpu::BindGroupEntry { binding: i as u32, resource })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout, entries: &entries })
    }

    fn shader(&self, shader: shaders::Shader) -> Result<wgpu::ShaderModule, super::Problem> {
        let source = wgpu::ShaderSource::Wgsl(shaders::wgsl(shader)?.into());
        Ok(self.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source }))
    }
}

fn draw_pipeline(device: &Device) -> Result<wgpu::RenderPipeline, super::Problem> {
    let module = device.shader(shaders::SHADOW_MAP)?;
    Ok(device.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("draw shadow map"),
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("draw"),
            compilation_options: Default::default(),
            buffers: &[Some(wgpu::VertexBufferLayout {
                array_stride: 12,
                step_mode: wgpu::VertexStepMode::Vertex,
                attributes: &wgpu::vertex_attr_array![0 => Float32x3],
            })],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            format: wgpu::TextureFormat::Depth32Float,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Less),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: Default::default(),
        fragment: None,
        multiview_mask: None,
        cache: None,
    }))
}

fn subtract_pipeline(device: &Device) -> Result<wgpu::ComputePipeline, super::Problem> {
    let module = device.shader(shaders::SUBTRACT_TRANSFERS)?;
    Ok(device.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some("subtract transfers"),
        layout: None,
        module: &module,
        entry_point: Some("subtract"),
        compilation_options: Default::default(),
        cache: None,
    }))
}

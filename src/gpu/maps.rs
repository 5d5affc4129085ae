//! Shadow maps of an occluder: raster passes draw all of them into one depth array texture, a layer in one call.

use super::atlas::{Atlas, Extent, Place};
use super::clock::Clock;
use super::device::Buffer;
use super::layout::{Frame, ShadowMap};
use super::{Device, Problem, shaders};
use crate::shadow::{self, MapPlan, OFFSETS, Occluder};

/// The atlas and all that drawing it takes.
pub(super) struct Maps {
    pub atlas: Atlas,
    pipeline: wgpu::RenderPipeline,
    vertices: Buffer,
    indices: Buffer,
    frame: Buffer,
    parameters: Buffer,
    order: Buffer,
    /// Bindings of the buffers; made anew where one of them grows.
    group: wgpu::BindGroup,
    /// Triangles on the device.
    triangles: Vec<[u32; 3]>,
}

impl Maps {
    pub fn new(device: &Device, extent: Extent) -> Result<Self, Problem> {
        use wgpu::BufferUsages as Usage;
        let pipeline = draw_pipeline(device)?;
        let frame = Buffer::new(device, "frame", Usage::UNIFORM);
        let parameters = Buffer::new(device, "parameters of maps, bytes,", Usage::STORAGE);
        let order = Buffer::new(device, "maps by layer, bytes,", Usage::STORAGE);
        Ok(Self {
            atlas: Atlas::new(device, extent, 1),
            group: bind(device, &pipeline, [&frame, &parameters, &order]),
            pipeline,
            vertices: Buffer::new(device, "occluder, bytes,", Usage::VERTEX),
            indices: Buffer::new(device, "occluder's triangles, bytes,", Usage::INDEX),
            frame,
            parameters,
            order,
            triangles: Vec::new(),
        })
    }

    /// Uploads what is drawn.
    pub fn upload_mesh(&mut self, device: &Device, occluder: &Occluder) -> Result<(), Problem> {
        self.vertices.write(device, bytemuck::cast_slice(&occluder.vertices))?;
        if self.triangles != occluder.triangles {
            self.indices.write(device, bytemuck::cast_slice(&occluder.triangles))?;
            self.triangles.clone_from(&occluder.triangles);
        }
        Ok(())
    }

    /// Uploads the parameters of maps that lie in so many layers, and two numbers for the kernel that looks them up. Gives
    /// the number of maps in each layer, and whether [`Self::resources`] are others now.
    pub fn upload(
        &mut self,
        device: &Device,
        parameters: &[ShadowMap],
        layers: usize,
        [clusters, add]: [u32; 2],
    ) -> Result<(Vec<u32>, bool), Problem> {
        let side = self.atlas.extent.side() as u32;
        let frame = Frame { maps: parameters.len() as u32, clusters, side, add };
        self.frame.write(device, bytemuck::bytes_of(&frame))?;
        let mut order: Vec<u32> = (0..parameters.len() as u32).collect();
        order.sort_by_key(|&i| parameters[i as usize].layer);
        let mut counts = vec![0; layers.max(1)];
        parameters.iter().for_each(|p| counts[p.layer as usize] += 1);
        let grown = [
            self.parameters.write(device, bytemuck::cast_slice(parameters))?,
            self.order.write(device, bytemuck::cast_slice(&order))?,
            self.atlas.reserve(device, counts.len()),
        ];
        let grown = grown.contains(&true);
        if grown {
            self.group = bind(device, &self.pipeline, [&self.frame, &self.parameters, &self.order]);
        }
        Ok((counts, grown))
    }

    /// What shadow_map_lookup.wgsl binds.
    pub fn resources(&self) -> [wgpu::BindingResource<'_>; 2] {
        [self.parameters.get().as_entire_binding(), wgpu::BindingResource::TextureView(&self.atlas.view)]
    }

    /// How many they are.
    pub fn frame(&self) -> &Buffer {
        &self.frame
    }

    /// Draws the maps, each layer in one pass, all its maps in one call.
    pub fn draw(&self, counts: &[u32], clock: Option<&Clock>, encoder: &mut wgpu::CommandEncoder) {
        let mut from = 0;
        for (i, (layer, count)) in self.atlas.layers.iter().zip(counts).enumerate() {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: layer,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(shadow::EMPTY),
                        store: wgpu::StoreOp::Store,
                    }),
                    stencil_ops: None,
                }),
                timestamp_writes: clock.and_then(|c| c.maps(i == 0, i + 1 == counts.len())),
                ..Default::default()
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.group, &[]);
            pass.set_vertex_buffer(0, self.vertices.get().slice(..));
            pass.set_index_buffer(self.indices.get().slice(..), wgpu::IndexFormat::Uint32);
            pass.draw_indexed(0..3 * self.triangles.len() as u32, 0, from..from + count);
            from += count;
        }
    }
}

impl ShadowMap {
    /// At its place in the atlas; `None` where there is nothing to draw.
    pub fn of(plan: &MapPlan, place: Place, cluster: u32) -> Option<Self> {
        let projection = plan.projection?;
        Some(Self {
            map_from_world: projection.map_from_world.to_cols_array_2d(),
            planes: projection.planes.to_cols_array_2d(),
            sides: plan.sides.map(|s| s.to_array()),
            offset: OFFSETS[plan.offset].to_array(),
            weight: plan.weight,
            cluster,
            corner: place.corner,
            layer: place.layer,
            size: plan.size as u32,
        })
    }
}

fn bind(device: &Device, pipeline: &wgpu::RenderPipeline, buffers: [&Buffer; 3]) -> wgpu::BindGroup {
    device.bind(&pipeline.get_bind_group_layout(0), buffers.map(|b| b.get().as_entire_binding()))
}

fn draw_pipeline(device: &Device) -> Result<wgpu::RenderPipeline, Problem> {
    let module = device.shader(shaders::SHADOW_MAP)?;
    let pipeline = device.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("draw shadow maps"),
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
    });
    device.check()?;
    Ok(pipeline)
}

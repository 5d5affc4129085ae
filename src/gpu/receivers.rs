//! Receiver pixels on the device, tile by tile, in blocks within the device's limits.

use super::layout::{Receiver, Tile};
use super::{Device, Problem};
use crate::image::{Radiance, RadianceImage};
use crate::shadow::{Pixel, Prepared, TILE_PX};
use std::ops::Range;

/// Invocations of a workgroup of subtract_transfers.wgsl: the pixels of a tile.
pub(super) const WORKGROUP: usize = TILE_PX * TILE_PX;
/// Most workgroups of a dispatch.
const MOST_TILES: usize = 65_535;

/// Some tiles.
pub(super) struct Block {
    /// Which tiles.
    tiles: Range<usize>,
    /// Which pixels.
    pixels: Range<usize>,
    resident: [wgpu::Buffer; 2],
    /// Tiles of the frame, from the block's first.
    affected: wgpu::Buffer,
    /// How many they are.
    pub count: u32,
    blocked: wgpu::Buffer,
    epsilon: wgpu::Buffer,
    staging: wgpu::Buffer,
}

impl Block {
    /// All tiles, uploaded.
    pub fn all(device: &Device, prepared: &Prepared, plate: &RadianceImage) -> Result<Vec<Self>, Problem> {
        let most = device.storage_bytes() as usize / size_of::<Receiver>();
        device.allows(
            "a tile of pixels, bytes,",
            (WORKGROUP * size_of::<Receiver>()) as u64,
            device.storage_bytes(),
        )?;
        let tiles = &prepared.tiles;
        let (mut blocks, mut start) = (Vec::new(), 0);
        while start < tiles.len() {
            let first = tiles[start].pixels.start;
            let fits = tiles[start..].iter().take(MOST_TILES).take_while(|t| t.pixels.end - first <= most);
            let end = start + fits.count().max(1);
            blocks.push(Self::new(device, prepared, plate, start..end)?);
            start = end;
        }
        Ok(blocks)
    }

    fn new(
        device: &Device,
        prepared: &Prepared,
        plate: &RadianceImage,
        range: Range<usize>,
    ) -> Result<Self, Problem> {
        let tiles = &prepared.tiles[range.clone()];
        let pixels = tiles[0].pixels.start..tiles[tiles.len() - 1].pixels.end;
        let places: Vec<Tile> = tiles
            .iter()
            .map(|t| Tile {
                centre: t.centre.to_array(),
                radius: t.radius,
                first: (t.pixels.start - pixels.start) as u32,
                count: t.pixels.len() as u32,
                padding: [0; 2],
            })
            .collect();
        let receivers: Vec<Receiver> =
            prepared.pixels[pixels.clone()].iter().map(|p| receiver(p, plate)).collect();
        let bytes = 16 * pixels.len() as u64;
        Ok(Self {
            resident: [
                device.resident("tiles", bytemuck::cast_slice(&places))?,
                device.resident("receivers", bytemuck::cast_slice(&receivers))?,
            ],
            affected: device.storage("tiles of the frame", 4 * range.len() as u64),
            count: 0,
            blocked: device.storage("blocked irradiance", bytes),
            epsilon: device.storage("removed radiance", bytes),
            staging: device.staging(bytes),
            tiles: range,
            pixels,
        })
    }

    /// What the kernel sees of it.
    pub fn bind(&self, device: &Device, layout: &wgpu::BindGroupLayout) -> wgpu::BindGroup {
        let [tiles, receivers] = &self.resident;
        let buffers = [tiles, &self.affected, receivers, &self.blocked, &self.epsilon];
        device.bind(layout, buffers.map(|b| b.as_entire_binding()))
    }

    /// What kernels see of it that take pixels one by one: receivers, what is blocked, ε.
    pub fn buffers(&self) -> [&wgpu::Buffer; 3] {
        [&self.resident[1], &self.blocked, &self.epsilon]
    }

    /// Empties ε and what is blocked.
    pub fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.clear_buffer(&self.blocked, 0, None);
        encoder.clear_buffer(&self.epsilon, 0, None);
    }

    /// Empties ε and uploads the tiles that a frame may change, of all (ascending).
    pub fn begin(&mut self, device: &Device, affected: &[u32], encoder: &mut wgpu::CommandEncoder) {
        let from = affected.partition_point(|&t| (t as usize) < self.tiles.start);
        let to = affected.partition_point(|&t| (t as usize) < self.tiles.end);
        let own: Vec<u32> = affected[from..to].iter().map(|t| t - self.tiles.start as u32).collect();
        self.count = own.len() as u32;
        device.queue.write_buffer(&self.affected, 0, bytemuck::cast_slice(&own));
        encoder.clear_buffer(&self.epsilon, 0, None);
    }

    /// Uploads what is blocked already, by pixel of all.
    pub fn block(&self, device: &Device, blocked: &[[f32; 3]]) {
        let own: Vec<[f32; 4]> =
            blocked[self.pixels.clone()].iter().map(|&[r, g, b]| [r, g, b, 0.0]).collect();
        device.queue.write_buffer(&self.blocked, 0, bytemuck::cast_slice(&own));
    }

    /// Reads ε of its pixels.
    fn read(&self, device: &Device) -> Result<Vec<[f32; 4]>, Problem> {
        let mut encoder = device.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(&self.epsilon, 0, &self.staging, 0, 16 * self.pixels.len() as u64);
        device.queue.submit([encoder.finish()]);
        device.read(&self.staging)
    }

    /// ε of all blocks as a picture of the plate's size, and the kernel's fourth number by receiver pixel.
    pub fn epsilon<'b>(
        blocks: impl Iterator<Item = &'b Self>,
        device: &Device,
        prepared: &Prepared,
        (width, height): (usize, usize),
    ) -> Result<(RadianceImage, Vec<f32>), Problem> {
        let mut epsilon = vec![Radiance::default(); width * height];
        let mut fourth = Vec::with_capacity(prepared.pixels.len());
        for block in blocks {
            for (pixel, [r, g, b, w]) in prepared.pixels[block.pixels()].iter().zip(block.read(device)?) {
                epsilon[pixel.index as usize] = Radiance([r, g, b]);
                fourth.push(w);
            }
        }
        Ok((RadianceImage::from_pixels(width, height, epsilon), fourth))
    }

    /// Numbers of its pixels.
    pub fn pixels(&self) -> Range<usize> {
        self.pixels.clone()
    }
}

fn receiver(p: &Pixel, plate: &RadianceImage) -> Receiver {
    Receiver {
        position: p.position.to_array(),
        vertex_a: p.vertices[0],
        normal: p.normal.to_array(),
        vertex_b: p.vertices[1],
        weights: p.weights,
        vertex_c: p.vertices[2],
        across: p.footprint[0].to_array(),
        place: p.index + 1,
        down: p.footprint[1].to_array(),
        padding_b: 0,
        plate: plate.pixels()[p.index as usize].0,
        padding_c: 0,
        irradiance: p.irradiance,
        padding_d: 0,
    }
}

//! Prefiltering of occlusion textures on the graphics processor, in whole 32-bit numbers.

use super::{Device, Problem, shaders};
use crate::config::{OcclusionFilter, Render};

/// The kernels of one filter, and its tables.
pub(super) struct Prefilter {
    filter: OcclusionFilter,
    size: u32,
    /// In turn.
    kernels: [wgpu::ComputePipeline; 2],
    table: wgpu::Buffer,
    /// Levels that are made from the one before.
    levels: Vec<wgpu::Buffer>,
    most_layers: u32,
}

/// Layers that are held at a time where the device has room: 16 slices without and with the object.
const MOST_LAYERS: u64 = 32;

impl Prefilter {
    pub fn new(device: &Device, settings: &Render) -> Result<Self, Problem> {
        let (filter, size) = (settings.occlusion_filter, settings.occlusion_px as u32);
        let kernels = match filter {
            OcclusionFilter::Mipmap => {
                [(shaders::OCCLUSION_TEXELS, "fill"), (shaders::OCCLUSION_MIPMAP, "halve")]
            }
            OcclusionFilter::NBuffers => {
                [(shaders::OCCLUSION_TEXELS, "fill"), (shaders::OCCLUSION_N_BUFFERS, "widen")]
            }
            OcclusionFilter::SummedArea => [
                (shaders::OCCLUSION_SUMMED_AREA, "along_rows"),
                (shaders::OCCLUSION_SUMMED_AREA, "along_columns"),
            ],
        };
        let [first, second] = kernels.map(|(shader, entry)| device.kernel(shader, entry));
        let bytes = 4 * u64::from(words(filter, size));
        device.allows("the prefiltered table of a slice, bytes,", bytes, device.storage_bytes())?;
        let layers = (device.storage_bytes() / bytes).min(MOST_LAYERS).min(2 * settings.slices as u64);
        let level = |l: u32| {
            let buffer = super::device::Buffer::new(device, "level", wgpu::BufferUsages::UNIFORM);
            device.queue.write_buffer(buffer.get(), 0, bytemuck::bytes_of(&[l, 0, 0, 0]));
            buffer.get().clone()
        };
        let levels = match filter {
            OcclusionFilter::SummedArea => Vec::new(),
            _ => (1..=size.ilog2()).map(level).collect(),
        };
        Ok(Self {
            filter,
            size,
            kernels: [first?, second?],
            table: device.storage("prefiltered tables", layers * bytes),
            levels,
            most_layers: layers as u32,
        })
    }

    /// Words of a layer's table.
    pub fn stride(&self) -> u32 {
        words(self.filter, self.size)
    }

    /// Layers that can be held at a time.
    pub fn most_layers(&self) -> u32 {
        self.most_layers
    }

    /// Makes the tables of a batch of layers.
    pub fn run(
        &self,
        device: &Device,
        textures: &wgpu::Buffer,
        mask: &wgpu::Buffer,
        layers: u32,
        encoder: &mut wgpu::CommandEncoder,
    ) -> &wgpu::Buffer {
        let [first, second] = &self.kernels;
        let size = self.size;
        let bind = |kernel: &wgpu::ComputePipeline, last: Option<&wgpu::Buffer>| {
            let layout = kernel.get_bind_group_layout(0);
            let [a, b] = [textures, &self.table].map(|b| b.as_entire_binding());
            match last {
                Some(last) => device.bind(&layout, [a, b, last.as_entire_binding()]),
                None => device.bind(&layout, [a, b]),
            }
        };
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(first);
        pass.set_bind_group(0, &bind(first, Some(mask)), &[]);
        if self.filter == OcclusionFilter::SummedArea {
            let lines = (size + 1).div_ceil(64);
            pass.dispatch_workgroups(lines, layers, 1);
            pass.set_pipeline(second);
            pass.set_bind_group(0, &bind(second, None), &[]);
            pass.dispatch_workgroups(lines, layers, 1);
            return &self.table;
        }
        pass.dispatch_workgroups(size / 16, size / 16, layers);
        pass.set_pipeline(second);
        for (l, level) in (1..).zip(&self.levels) {
            pass.set_bind_group(0, &bind(second, Some(level)), &[]);
            let groups = match self.filter {
                OcclusionFilter::Mipmap => (size >> l).div_ceil(8),
                _ => size / 16,
            };
            pass.dispatch_workgroups(groups, groups, layers);
        }
        &self.table
    }
}

/// Of a layer's table: every level of a pyramid, whole levels, or a texel more along each side.
fn words(filter: OcclusionFilter, size: u32) -> u32 {
    match filter {
        OcclusionFilter::Mipmap => (4 * size * size - 1) / 3,
        OcclusionFilter::NBuffers => (size.ilog2() + 1) * size * size,
        OcclusionFilter::SummedArea => (size + 1) * (size + 1),
    }
}

#[cfg(test)]
mod tests {
    use super::super::device::Buffer;
    use super::super::layout::Textures;
    use super::super::tests::device;
    use super::*;
    use bytemuck::Zeroable;
    use rand::{Rng, SeedableRng, rngs::SmallRng};

    const SIZE: usize = 32;
    const SLICES: usize = 3;

    /// The texels of a layer, one by one.
    fn layer(mask: &[u32], layer: u32, closed: bool) -> Vec<u32> {
        let of = |bits: u32| {
            let own = bits & 0xffff | if layer % 2 == 1 { bits >> 16 } else { 0 };
            (own | if closed { own << 1 } else { 0 }) >> (layer / 2) & 1
        };
        mask.iter().map(|&bits| of(bits)).collect()
    }

    /// How many block in a rectangle.
    fn count(texels: &[u32], [x, y]: [usize; 2], [width, height]: [usize; 2]) -> u32 {
        let rows = y.min(SIZE)..(y + height).min(SIZE);
        rows.map(|y| texels[y * SIZE..][x.min(SIZE)..(x + width).min(SIZE)].iter().sum::<u32>()).sum()
    }

    /// The table of a layer as the filter defines it.
    fn expected(filter: OcclusionFilter, texels: &[u32]) -> Vec<u32> {
        let places =
            |columns: usize, rows: usize| (0..rows).flat_map(move |y| (0..columns).map(move |x| [x, y]));
        let levels = 0..=SIZE.ilog2();
        match filter {
            OcclusionFilter::Mipmap => levels
                .flat_map(|l| {
                    let (side, of) = (1 << l, SIZE >> l);
                    places(of, of).map(move |p| (p.map(|c| c * side), side))
                })
                .map(|(p, side)| count(texels, p, [side; 2]))
                .collect(),
            OcclusionFilter::NBuffers => levels
                .flat_map(|l| places(SIZE, SIZE).map(move |p| (p, 1 << l)))
                .map(|(p, side)| count(texels, p, [side; 2]))
                .collect(),
            OcclusionFilter::SummedArea => {
                places(SIZE + 1, SIZE + 1).map(|to| count(texels, [0; 2], to)).collect()
            }
        }
    }

    #[test]
    fn tables_hold_the_exact_counts() {
        let Some(device) = device() else { return };
        let mut random = SmallRng::seed_from_u64(5);
        let mask: Vec<u32> = (0..SIZE * SIZE).map(|_| random.random::<u32>() & 0x0007_0007).collect();
        let uploaded = device.resident("mask", bytemuck::cast_slice(&mask)).unwrap();
        for (filter, closed) in OcclusionFilter::ALL.into_iter().flat_map(|f| [(f, false), (f, true)]) {
            let settings =
                Render { occlusion_filter: filter, occlusion_px: SIZE, slices: SLICES, ..Default::default() };
            let prefilter = Prefilter::new(&device, &settings).unwrap();
            // The second batch, from layer 2 on.
            let (first, layers) = (2, 4);
            let textures = Textures {
                size: SIZE as u32,
                closed: u32::from(closed),
                first,
                layers,
                stride: prefilter.stride(),
                ..Textures::zeroed()
            };
            let mut uniform = Buffer::new(&device, "textures", wgpu::BufferUsages::UNIFORM);
            uniform.write(&device, bytemuck::bytes_of(&textures)).unwrap();
            let bytes = 4 * u64::from(layers * prefilter.stride());
            let staging = device.staging(bytes);
            let mut encoder = device.device.create_command_encoder(&Default::default());
            let table = prefilter.run(&device, uniform.get(), &uploaded, layers, &mut encoder);
            encoder.copy_buffer_to_buffer(table, 0, &staging, 0, bytes);
            device.queue.submit([encoder.finish()]);
            let found: Vec<u32> = device.read(&staging).unwrap();
            for (i, found) in found.chunks(prefilter.stride() as usize).enumerate() {
                let texels = layer(&mask, first + i as u32, closed);
                assert_eq!(found, expected(filter, &texels), "{filter:?}, layer {i}, closed: {closed}");
            }
        }
    }
}

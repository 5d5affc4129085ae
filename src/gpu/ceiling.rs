//! How fast the device can look up texels at best.

use super::atlas::Atlas;
use super::clock::Stamps;
use super::device::Buffer;
use super::layout::Work;
use super::{Device, Problem, shaders};
use std::time::Instant;

/// Invocations along a side; a multiple of the workgroup's 16.
const SIDE: u32 = 1024;
/// Lookups of each invocation.
const LOOKUPS: u32 = 64;
/// Runs, of which the fastest counts.
const RUNS: usize = 5;

/// Lookups of texels of an atlas each second, neighbours at neighbouring texels, with nothing else to do.
pub(super) fn lookups_per_second(device: &Device, atlas: &Atlas) -> Result<f64, Problem> {
    let kernel = device.kernel(shaders::LOOKUP_CEILING, "look")?;
    let work = Work {
        lookups: LOOKUPS,
        side: (atlas.extent.side() as u32).max(32),
        layers: atlas.layers.len() as u32,
        width: SIDE,
    };
    let mut parameters = Buffer::new(device, "work", wgpu::BufferUsages::UNIFORM);
    parameters.write(device, bytemuck::bytes_of(&work))?;
    let sums = device.storage("sums", u64::from(SIDE * SIDE) * 4);
    let group = device.bind(
        &kernel.get_bind_group_layout(0),
        [
            parameters.get().as_entire_binding(),
            sums.as_entire_binding(),
            wgpu::BindingResource::TextureView(&atlas.view),
        ],
    );
    device.wait()?;
    let mut best = f64::INFINITY;
    for _ in 0..RUNS {
        let stamps = Stamps::new(device, 2);
        let timestamp_writes = stamps.as_ref().map(|s| s.compute(Some(0), Some(1)));
        let started = Instant::now();
        let mut encoder = device.device.create_command_encoder(&Default::default());
        let mut pass =
            encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: None, timestamp_writes });
        pass.set_pipeline(&kernel);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(SIDE / 16, SIDE / 16, 1);
        drop(pass);
        device.queue.submit([encoder.finish()]);
        device.wait()?;
        let seconds = match &stamps {
            Some(stamps) => stamps.read(device)?[1],
            None => started.elapsed().as_secs_f64(),
        };
        best = best.min(seconds);
    }
    Ok(f64::from(SIDE * SIDE) * f64::from(LOOKUPS) / best)
}

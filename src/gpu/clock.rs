//! What the phases of a frame take: by the device's timestamps, or by the host's clock and waits where it has none.

use super::{Device, Problem};
use std::time::Instant;

/// Times of a frame's phases on the device, s.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Phases {
    /// From the first write of the host to the first pass.
    pub upload: f64,
    /// Drawing shadow maps.
    pub maps: f64,
    /// Looking them up and summing.
    pub fused: f64,
}

/// A phase.
#[derive(Debug, Clone, Copy)]
pub(super) enum Phase {
    Upload,
    Maps,
    Fused,
}

/// Timestamps of a batch: before the upload, then begin and end of both passes.
const STAMPS: u32 = 5;

/// Timestamps of the device.
pub(super) struct Stamps {
    set: wgpu::QuerySet,
    count: u32,
}

impl Stamps {
    /// So many; `None` where the device has no timestamps, or not so many.
    pub fn new(device: &Device, count: u32) -> Option<Self> {
        let wanted = wgpu::QuerySetDescriptor { label: None, ty: wgpu::QueryType::Timestamp, count };
        let able = device.device.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        (able && count <= wgpu::QUERY_SET_MAX_QUERIES)
            .then(|| Self { set: device.device.create_query_set(&wanted), count })
    }

    /// Begin and end of a compute pass.
    pub fn compute(&self, begin: Option<u32>, end: Option<u32>) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.set,
            beginning_of_pass_write_index: begin,
            end_of_pass_write_index: end,
        }
    }

    /// Waits for them; s since the device's own zero.
    pub fn read(&self, device: &Device) -> Result<Vec<f64>, Problem> {
        let bytes = u64::from(self.count) * 8;
        let resolved = device.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("timestamps"),
            size: bytes,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let staging = device.staging(bytes);
        let mut encoder = device.device.create_command_encoder(&Default::default());
        encoder.resolve_query_set(&self.set, 0..self.count, &resolved, 0);
        encoder.copy_buffer_to_buffer(&resolved, 0, &staging, 0, bytes);
        device.queue.submit([encoder.finish()]);
        let ticks: Vec<u64> = device.read(&staging)?;
        let zero = ticks.iter().copied().min().unwrap_or(0);
        let period = 1e-9 * f64::from(device.queue.get_timestamp_period());
        Ok(ticks.iter().take(self.count as usize).map(|t| (t - zero) as f64 * period).collect())
    }
}

/// Measures one frame.
pub(super) struct Clock {
    /// Of all batches; `None`: by the host's clock.
    stamps: Option<Stamps>,
    batch: u32,
    lap: Instant,
    by_host: Phases,
}

impl Clock {
    pub fn new(device: &Device, batches: usize) -> Self {
        let stamps = Stamps::new(device, STAMPS * batches as u32);
        Self { stamps, batch: 0, lap: Instant::now(), by_host: Phases::default() }
    }

    /// Before the uploads of a batch.
    pub fn start(&mut self, device: &Device, batch: usize) -> Result<(), Problem> {
        self.batch = batch as u32;
        if let Some(stamps) = &self.stamps {
            // An empty pass that ends just before.
            let mut encoder = device.device.create_command_encoder(&Default::default());
            let timestamp_writes = Some(stamps.compute(None, Some(STAMPS * self.batch)));
            encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: None, timestamp_writes });
            device.queue.submit([encoder.finish()]);
        } else {
            device.wait()?;
        }
        self.lap = Instant::now();
        Ok(())
    }

    /// Stamps of the first and last pass that draw maps.
    pub fn maps(&self, first: bool, last: bool) -> Option<wgpu::RenderPassTimestampWrites<'_>> {
        let stamp = |at: u32, wanted: bool| wanted.then_some(STAMPS * self.batch + at);
        let stamps = self.stamps.as_ref().filter(|_| first || last)?;
        Some(wgpu::RenderPassTimestampWrites {
            query_set: &stamps.set,
            beginning_of_pass_write_index: stamp(1, first),
            end_of_pass_write_index: stamp(2, last),
        })
    }

    /// Stamps of the fused pass.
    pub fn fused(&self) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let at = STAMPS * self.batch;
        self.stamps.as_ref().map(|stamps| stamps.compute(Some(at + 3), Some(at + 4)))
    }

    /// After a phase whose commands are in `encoder`; without timestamps it is submitted and waited for.
    pub fn end(
        &mut self,
        device: &Device,
        phase: Phase,
        encoder: &mut wgpu::CommandEncoder,
    ) -> Result<(), Problem> {
        if self.stamps.is_none() {
            let next = device.device.create_command_encoder(&Default::default());
            device.queue.submit([std::mem::replace(encoder, next).finish()]);
            device.wait()?;
            let seconds = self.lap.elapsed().as_secs_f64();
            match phase {
                Phase::Upload => self.by_host.upload += seconds,
                Phase::Maps => self.by_host.maps += seconds,
                Phase::Fused => self.by_host.fused += seconds,
            }
            self.lap = Instant::now();
        }
        Ok(())
    }

    /// The sums over all batches, when all is submitted.
    pub fn read(self, device: &Device) -> Result<Phases, Problem> {
        let Some(stamps) = &self.stamps else { return Ok(self.by_host) };
        let seconds = stamps.read(device)?;
        let mut phases = Phases::default();
        for [start, map, mapped, fuse, fused] in seconds.as_chunks().0 {
            phases.upload += map - start;
            phases.maps += mapped - map;
            phases.fused += fused - fuse;
        }
        Ok(phases)
    }
}

//! An open device: its limits, its faults as errors, its buffers.

use super::Problem;
use super::shaders::{self, Shader};
use std::sync::{Arc, Mutex, PoisonError};

/// An open device; clones share it.
#[derive(Clone)]
pub(crate) struct Device {
    pub adapter: String,
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pub limits: wgpu::Limits,
    faults: Faults,
}

/// What the device reports on its own, which else would end the program.
#[derive(Clone, Default)]
struct Faults(Arc<Mutex<Option<Fault>>>);

#[derive(Clone)]
enum Fault {
    Lost(String),
    OutOfMemory,
    Other(String),
}

impl Faults {
    /// The first fault stays, unless the device is lost, of which all others are consequences.
    fn record(&self, fault: Fault) {
        let mut recorded = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if recorded.is_none() || matches!(fault, Fault::Lost(_)) {
            *recorded = Some(fault);
        }
    }

    /// The fault since the last call; a lost device stays lost.
    fn take(&self) -> Option<Fault> {
        let mut recorded = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if matches!(*recorded, Some(Fault::Lost(_))) { recorded.clone() } else { recorded.take() }
    }
}

impl Device {
    /// The fastest adapter; buffers as large as it allows, but none beyond `buffer_bytes`.
    pub fn open(buffer_bytes: u64) -> Result<Self, Problem> {
        // Vulkan, Metal, Direct3D 12 unless the environment (WGPU_BACKEND) names another.
        let backends = wgpu::Backends::from_env().unwrap_or(wgpu::Backends::PRIMARY);
        let descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor { backends, ..descriptor });
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            ..Default::default()
        };
        let adapter = pollster::block_on(instance.request_adapter(&options))
            .map_err(|e| Problem::NoAdapter(e.to_string()))?;
        let info = adapter.get_info();
        let software = if info.device_type == wgpu::DeviceType::Cpu { ", software" } else { "" };
        let name = format!("{} ({:?}{software})", info.name, info.backend);
        let offered = adapter.limits();
        let limits = wgpu::Limits {
            max_buffer_size: offered.max_buffer_size.min(buffer_bytes),
            max_storage_buffer_binding_size: offered.max_storage_buffer_binding_size.min(buffer_bytes),
            ..wgpu::Limits::default().or_worse_values_from(&offered)
        };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("insitu"),
            required_features: adapter.features() & wgpu::Features::TIMESTAMP_QUERY,
            required_limits: limits.clone(),
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|e| Problem::Device { adapter: name.clone(), problem: e.to_string() })?;
        let faults = Faults::default();
        let (errors, losses) = (faults.clone(), faults.clone());
        device.on_uncaptured_error(Arc::new(move |error| {
            errors.record(match error {
                wgpu::Error::OutOfMemory { .. } => Fault::OutOfMemory,
                other => Fault::Other(other.to_string()),
            });
        }));
        device.set_device_lost_callback(move |_, message| losses.record(Fault::Lost(message)));
        Ok(Self { adapter: name, device, queue, limits, faults })
    }

    /// Refuses a need that the device cannot meet.
    pub fn allows(&self, what: &'static str, needed: u64, limit: u64) -> Result<(), Problem> {
        if needed <= limit {
            return Ok(());
        }
        Err(Problem::Limit { adapter: self.adapter.clone(), what, needed, limit })
    }

    /// Largest buffer that a kernel can see.
    pub fn storage_bytes(&self) -> u64 {
        self.limits.max_buffer_size.min(self.limits.max_storage_buffer_binding_size)
    }

    /// Whatever went wrong since the last call.
    pub fn check(&self) -> Result<(), Problem> {
        let adapter = self.adapter.clone();
        match self.faults.take() {
            None => Ok(()),
            Some(Fault::Lost(problem)) => Err(Problem::Lost { adapter, problem }),
            Some(Fault::OutOfMemory) => Err(Problem::OutOfMemory { adapter }),
            Some(Fault::Other(problem)) => Err(Problem::Device { adapter, problem }),
        }
    }

    /// A failed call: what the device itself reports comes first.
    fn failed(&self, problem: impl ToString) -> Problem {
        let other = Problem::Device { adapter: self.adapter.clone(), problem: problem.to_string() };
        self.check().err().unwrap_or(other)
    }

    /// Waits until all that was submitted is done.
    pub fn wait(&self) -> Result<(), Problem> {
        self.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|e| self.failed(e))?;
        self.check()
    }

    /// A buffer of its own for something that stays.
    pub fn resident(&self, label: &'static str, contents: &[u8]) -> Result<wgpu::Buffer, Problem> {
        let mut buffer = Buffer::new(self, label, wgpu::BufferUsages::STORAGE);
        buffer.write(self, contents)?;
        Ok(buffer.inner)
    }

    /// A buffer that kernels write and that can be read.
    pub fn storage(&self, label: &'static str, bytes: u64) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.max(LEAST_BYTES),
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    }

    /// A buffer to read results from.
    pub fn staging(&self, bytes: u64) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("for reading"),
            size: bytes.max(16),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    }

    /// Waits for the device and reads a staging buffer.
    pub fn read<T: bytemuck::Pod>(&self, staging: &wgpu::Buffer) -> Result<Vec<T>, Problem> {
        let (sender, receiver) = std::sync::mpsc::channel();
        staging.map_async(wgpu::MapMode::Read, .., move |outcome| drop(sender.send(outcome)));
        self.wait()?;
        let outcome = receiver.recv().map_err(|e| self.failed(e))?;
        outcome.map_err(|e| self.failed(e))?;
        let values = {
            let range = staging.get_mapped_range(..).map_err(|e| self.failed(e))?;
            bytemuck::pod_collect_to_vec(&range)
        };
        staging.unmap();
        Ok(values)
    }

    /// Resources at bindings 0, 1, …
    pub fn bind<'r, const N: usize>(
        &self,
        layout: &wgpu::BindGroupLayout,
        resources: [wgpu::BindingResource<'r>; N],
    ) -> wgpu::BindGroup {
        let entries: Vec<_> = (0..)
            .zip(resources)
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout, entries: &entries })
    }

    /// A shader with its imports.
    pub fn shader(&self, shader: Shader) -> Result<wgpu::ShaderModule, Problem> {
        let source = wgpu::ShaderSource::Wgsl(shaders::wgsl(shader)?.into());
        Ok(self.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source }))
    }

    /// A compute pipeline whose layout is that of its shader.
    pub fn kernel(&self, shader: Shader, entry_point: &str) -> Result<wgpu::ComputePipeline, Problem> {
        let module = self.shader(shader)?;
        let pipeline = self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry_point),
            layout: None,
            module: &module,
            entry_point: Some(entry_point),
            compilation_options: Default::default(),
            cache: None,
        });
        self.check()?;
        Ok(pipeline)
    }
}

/// Bindings hold at least one element, whatever it is.
const LEAST_BYTES: u64 = 256;

/// A buffer that is written anew each frame and grows where it must.
pub(crate) struct Buffer {
    label: &'static str,
    usage: wgpu::BufferUsages,
    inner: wgpu::Buffer,
}

impl Buffer {
    pub fn new(device: &Device, label: &'static str, usage: wgpu::BufferUsages) -> Self {
        let usage = usage | wgpu::BufferUsages::COPY_DST;
        Self { label, usage, inner: Self::create(device, label, usage, 0) }
    }

    fn create(device: &Device, label: &'static str, usage: wgpu::BufferUsages, bytes: u64) -> wgpu::Buffer {
        // Written, not mapped: a mapped buffer that could not be had panics.
        device.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT).max(LEAST_BYTES),
            usage,
            mapped_at_creation: false,
        })
    }

    /// Writes the contents, a multiple of four bytes; true where a new buffer took the old one's place.
    pub fn write(&mut self, device: &Device, contents: &[u8]) -> Result<bool, Problem> {
        let bytes = contents.len() as u64;
        let limit = if self.usage.contains(wgpu::BufferUsages::STORAGE) {
            device.storage_bytes()
        } else {
            device.limits.max_buffer_size
        };
        device.allows(self.label, bytes, limit)?;
        let grows = self.inner.size() < bytes;
        if grows {
            // A little room, so that it need not grow every frame.
            self.inner =
                Self::create(device, self.label, self.usage, (bytes + bytes / 4).min(limit).max(bytes));
        }
        device.queue.write_buffer(&self.inner, 0, contents);
        Ok(grows)
    }

    pub fn get(&self) -> &wgpu::Buffer {
        &self.inner
    }
}

//! Shadow maps on the graphics processor (wgpu). The plain Rust of [`crate::shadow`] is the reference.

mod layout;
mod radiance_transfer;
mod shaders;

use crate::error;
pub use radiance_transfer::RadianceTransfer;

/// Why the graphics processor gives no result.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// No driver, or none that wgpu can use.
    #[error("no graphics adapter found ({0})")]
    NoAdapter(String),
    /// The adapter is there but does not do what is needed.
    #[error("graphics adapter {adapter}: {problem}")]
    Device {
        /// Name of the adapter.
        adapter: String,
        /// What went wrong.
        problem: String,
    },
    /// A shader does not compile: a fault of insitu.
    #[error("shader {name}: {problem}")]
    Shader {
        /// File name.
        name: &'static str,
        /// What naga says.
        problem: String,
    },
}

impl error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::NoAdapter(_) => {
                "set render.backend = \"cpu\", or install a Vulkan driver (software: mesa-vulkan-drivers)"
                    .into()
            }
            Self::Device { .. } => "set render.backend = \"cpu\", or a smaller render.shadow_map_px".into(),
            Self::Shader { .. } => "set render.backend = \"cpu\" and report this".into(),
        }
    }
}

/// An open device; clones share it.
#[derive(Clone)]
pub(crate) struct Device {
    pub adapter: String,
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pub limits: wgpu::Limits,
}

impl Device {
    /// The fastest adapter; buffers as large as it allows.
    pub fn open() -> Result<Self, Problem> {
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
        let name = adapter.get_info().name;
        let offered = adapter.limits();
        let limits = wgpu::Limits {
            max_buffer_size: offered.max_buffer_size,
            max_storage_buffer_binding_size: offered.max_storage_buffer_binding_size,
            ..wgpu::Limits::default()
        };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("insitu"),
            required_limits: limits.clone(),
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|e| Problem::Device { adapter: name.clone(), problem: e.to_string() })?;
        Ok(Self { adapter: name, device, queue, limits })
    }

    /// A failure on this device.
    pub fn problem(&self, problem: impl ToString) -> Problem {
        Problem::Device { adapter: self.adapter.clone(), problem: problem.to_string() }
    }

    /// Catches the device's errors, which else would end the program.
    pub fn watch(&self) -> Watch {
        use wgpu::ErrorFilter::{Internal, OutOfMemory, Validation};
        Watch([Validation, Internal, OutOfMemory].map(|filter| self.device.push_error_scope(filter)))
    }
}

/// Errors since [`Device::watch`].
pub(crate) struct Watch([wgpu::ErrorScopeGuard; 3]);

impl Watch {
    /// The innermost error as a problem.
    pub fn none_on(self, device: &Device) -> Result<(), Problem> {
        let [validation, internal, memory] = self.0;
        let errors = [memory, internal, validation].map(|scope| pollster::block_on(scope.pop()));
        match errors.into_iter().flatten().next() {
            Some(e) => Err(device.problem(e)),
            None => Ok(()),
        }
    }
}

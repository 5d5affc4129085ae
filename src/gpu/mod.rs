//! Shadow methods on the graphics processor (wgpu), each a [`Twin`] of one in plain Rust, which is the reference.

mod atlas;
mod ceiling;
mod clock;
mod device;
mod layout;
mod light_dome;
mod lit_plate;
mod maps;
mod occlusion;
mod parity;
mod prefilter;
mod radiance_transfer;
mod rays;
mod receivers;
mod shaders;
mod subtractive;
#[cfg(test)]
mod tests;
mod twin;

use crate::error;
pub use clock::Phases;
pub(crate) use device::Device;
pub use light_dome::LightDome;
pub use occlusion::OcclusionTextures;
pub use parity::Difference;
pub use radiance_transfer::{Budget, RadianceTransfer, Timing};
pub use subtractive::Subtractive;
pub use twin::Twin;

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
    /// A need beyond the device.
    #[error("graphics adapter {adapter}: {what} needs {needed}, the limit is {limit}")]
    Limit {
        /// Name of the adapter.
        adapter: String,
        /// What is too large, with its unit.
        what: &'static str,
        /// How large it would be.
        needed: u64,
        /// How large it may be.
        limit: u64,
    },
    /// No memory left on the device.
    #[error("graphics adapter {adapter} is out of memory")]
    OutOfMemory {
        /// Name of the adapter.
        adapter: String,
    },
    /// The device is gone: a crashed or reset driver, or hardware removed.
    #[error("graphics adapter {adapter} is lost ({problem})")]
    Lost {
        /// Name of the adapter.
        adapter: String,
        /// What the driver says.
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
            Self::Device { .. } => "set render.backend = \"cpu\"".into(),
            Self::Limit { .. } | Self::OutOfMemory { .. } => {
                "set a smaller render.shadow_map_px or render.occlusion_px, fewer render.passes or render.lights, use a smaller plate, \
                 or set render.backend = \"cpu\""
                    .into()
            }
            Self::Lost { .. } => "run again; if it happens again, set render.backend = \"cpu\"".into(),
            Self::Shader { .. } => "set render.backend = \"cpu\" and report this".into(),
        }
    }
}

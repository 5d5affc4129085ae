//! The graphics processor (wgpu).
use crate::config::Render;
use crate::error;
use crate::shadow;

/// Why.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// None.
    #[error("no adapter")]
    NoAdapter,
}
impl error::Problem for Problem {
    fn hint(&self) -> String {
        "x".into()
    }
}
/// x
pub struct RadianceTransfer;
impl RadianceTransfer {
    /// x
    pub fn prepare(_: &shadow::Scene, _: &Render) -> Result<Self, shadow::Problem> {
        Err(Problem::NoAdapter.into())
    }
    /// x
    pub fn removed_radiance(&self, _: &shadow::Occluder) -> Result<shadow::Removed, shadow::Problem> {
        Err(Problem::NoAdapter.into())
    }
}

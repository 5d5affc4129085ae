//! The on-disk contract between stages: typed readers and writers that refuse what they cannot trust.

pub mod exr;
pub mod json;
pub mod npy;
pub mod ply;

/// What to do about an artefact that cannot be used.
pub const REMAKE: &str = "run `insitu run --force --from` the stage that writes it";

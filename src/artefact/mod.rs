//! The on-disk contract between stages: typed readers and writers that refuse what they cannot trust.

pub mod exr;
pub mod hdr;
pub mod json;
pub mod npy;
pub mod ply;

/// What to do about an artefact that cannot be used.
pub const REMAKE: &str = "run `insitu run --force --from` the stage that writes it";

/// The same for a file whose stage its folder tells.
pub fn remake(path: &std::path::Path) -> String {
    let folder = path.parent().and_then(|p| p.file_name()).unwrap_or_default();
    match crate::stage::find(&folder.to_string_lossy()) {
        Some(stage) => format!("run `insitu run --force --from {}`", stage.name),
        None => "copy or export the file again".into(),
    }
}

//! JSON artefacts: first keys `format` and `version`, then the content, indented so that it can be read and diffed.

use super::remake;
use crate::error::{Error, FileContext, Result};
use serde::{Serialize, de::DeserializeOwned};
use std::path::Path;

/// A type with a JSON form of its own.
pub trait JsonArtefact: Serialize + DeserializeOwned {
    /// Name of the format, e.g. `insitu-cameras`.
    const FORMAT: &'static str;
    /// Schema version; raised with every change of meaning.
    const VERSION: u32;

    /// What its users rely on and its type does not say; else what is wrong.
    fn check(&self) -> std::result::Result<(), String> {
        Ok(())
    }
}

#[derive(Serialize)]
struct Writing<'a, T> {
    format: &'a str,
    version: u32,
    #[serde(flatten)]
    content: &'a T,
}

/// Writes an artefact.
pub fn write<T: JsonArtefact>(path: &Path, content: &T) -> Result<()> {
    let whole = Writing { format: T::FORMAT, version: T::VERSION, content };
    let mut text = serde_json::to_string_pretty(&whole).map_err(|e| Error::Bug(e.to_string()))?;
    text.push('\n');
    std::fs::write(path, text).at("writing", path)
}

/// Reads an artefact; refuses another format, another version, and a file cut short.
pub fn read<T: JsonArtefact>(path: &Path) -> Result<T> {
    let bytes = std::fs::read(path).at("reading", path)?;
    let refuse = |problem: String| Error::file(format!("reading {}", T::FORMAT), path, problem, remake(path));
    let value: serde_json::Value =
        serde_json::from_slice(&bytes).map_err(|e| refuse(format!("damaged or cut short ({e})")))?;
    match value["format"].as_str() {
        Some(format) if format == T::FORMAT => {}
        Some(format) => return Err(refuse(format!("is a `{format}`, expected a `{}`", T::FORMAT))),
        None => return Err(refuse(format!("has no `format`, expected `{}`", T::FORMAT))),
    }
    match value["version"].as_u64() {
        Some(version) if version == u64::from(T::VERSION) => {}
        Some(version) => {
            return Err(refuse(format!("has schema version {version}, this insitu reads {}", T::VERSION)));
        }
        None => return Err(refuse("has no schema `version`".into())),
    }
    let content: T = serde_json::from_value(value).map_err(|e| refuse(e.to_string()))?;
    content.check().map_err(refuse)?;
    Ok(content)
}

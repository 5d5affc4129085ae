//! Whether a stage's result can stand, or something it was made from has changed.

use super::{Input, Stage, Workspace, digest_file, digest_folder};
use serde_json::Value;

/// Whether a result can stand.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum State {
    /// Same program, settings and inputs; outputs whole.
    Fresh,
    /// Made from something else; says what.
    Stale(String),
    /// There is no result; says why.
    Missing(String),
}

/// Compares a stage's manifest with what is there now. Looks at this stage alone, not at those before it.
pub fn state(workspace: &Workspace, stage: &Stage) -> State {
    let folder = workspace.folder(stage.name);
    let manifest = match workspace.manifest(stage.name) {
        Ok(manifest) => manifest,
        Err(_) if !folder.exists() => return State::Missing("never run".into()),
        Err(e) => return State::Missing(e.to_string()),
    };
    if manifest.stage_version != stage.version || manifest.program != env!("CARGO_PKG_VERSION") {
        return State::Stale(format!(
            "made by insitu {} (stage version {})",
            manifest.program, manifest.stage_version
        ));
    }
    let settings = workspace.pipeline.settings(&stage.all_settings());
    if manifest.settings != settings {
        return State::Stale(changed_settings(stage, &manifest.settings, &settings));
    }
    for (key, recorded) in &manifest.inputs {
        let path = workspace.base.join(key);
        let now = match recorded {
            Input::File(_) => digest_file(&path).map(Input::File),
            Input::Header(_) => crate::exposure::header_digest(&path).map(Input::Header),
            Input::Listing(_) => crate::exposure::listing_digest(&path).map(Input::Listing),
            Input::Absent if path.exists() => return State::Stale(format!("{key} is there now")),
            Input::Absent => Ok(Input::Absent),
        };
        match now {
            Ok(now) if now == *recorded => {}
            Ok(_) => return State::Stale(format!("{key} changed")),
            Err(_) => return State::Stale(format!("{key} cannot be read any more")),
        }
    }
    match digest_folder(&folder) {
        Ok(outputs) if outputs == manifest.outputs => State::Fresh,
        Ok(outputs) => {
            let spoilt = manifest.outputs.iter().find(|(name, hash)| outputs.get(*name) != Some(hash));
            let name = spoilt.map_or("a file too many", |(name, _)| name.as_str());
            State::Stale(format!("output {name} is not as it was written"))
        }
        Err(e) => State::Missing(e.to_string()),
    }
}

fn changed_settings(stage: &Stage, before: &Value, now: &Value) -> String {
    let of = |name: &'static str| match now[name].as_object() {
        Some(table) => {
            let changed = table.keys().filter(|k| before[name][*k] != now[name][*k]);
            changed.map(|k| format!("{name}.{k}")).collect()
        }
        None if before[name] != now[name] => vec![name.to_string()],
        None => Vec::new(),
    };
    let changed: Vec<String> = stage.all_settings().into_iter().flat_map(of).collect();
    format!("setting {} changed", changed.join(", "))
}

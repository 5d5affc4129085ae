//! The parts that belong together are together: stages, programs, settings.

use insitu::config::Pipeline;
use insitu::stage::STAGES;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn every_stage_has_a_program_a_table_and_earlier_reads() {
    let manifest = std::fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let settings = serde_json::to_value(Pipeline::default()).unwrap();
    for (i, stage) in STAGES.iter().enumerate() {
        assert!(root().join(format!("stages/{}.rs", stage.name)).exists(), "{}", stage.name);
        assert!(manifest.contains(&format!("name = \"insitu-{}\"", stage.name)), "{}", stage.name);
        assert!(settings[stage.name].is_object(), "{} has no settings table", stage.name);
        for name in stage.settings {
            let value = name.split('.').try_fold(&settings, |value, key| value.get(key));
            assert!(value.is_some(), "{} goes by {name}, which is no setting", stage.name);
        }
        for read in stage.reads {
            assert!(
                STAGES[..i].iter().any(|s| s.name == *read),
                "{} reads {read}, which comes later",
                stage.name
            );
        }
    }
}

/// Tables and keys of which the worked example holds what belongs to its capture and object.
const OF_THE_CAPTURE: &[&str] = &[
    "annotations",
    "ingest.photos",
    "ingest.sensor_width_mm",
    "ingest.roles",
    "render.object",
    "render.position_m",
    "render.rotation_deg",
    "render.diffuse",
    "evaluate.reference",
    "evaluate.reference_empty",
    "evaluate.reference_mask",
    "evaluate.truth",
    "evaluate.bounds",
];

#[test]
fn the_worked_example_shows_every_setting_with_its_meaning() {
    let shown = comments(&worked_example());
    for key in values(&Pipeline::default()).keys() {
        let comment = shown.get(key).unwrap_or_else(|| panic!("pipeline.toml does not show `{key}`"));
        assert!(!comment.is_empty(), "pipeline.toml does not say what `{key}` means");
    }
}

#[test]
fn the_worked_example_has_the_defaults_or_names_them() {
    let text = worked_example();
    let (shown, example) = (comments(&text), values(&toml::from_str(&text).unwrap()));
    for (key, default) in values(&Pipeline::default()) {
        if example[&key] != default && !OF_THE_CAPTURE.contains(&key.as_str()) {
            assert!(
                shown[&key].contains(&default.to_string()),
                "`{key}` is {}, its default {default}, and pipeline.toml gives no reason",
                example[&key]
            );
        }
    }
}

fn worked_example() -> String {
    std::fs::read_to_string(root().join("pipeline.toml")).unwrap()
}

/// Settings by `table.key`.
fn values(pipeline: &Pipeline) -> BTreeMap<String, Value> {
    let whole = serde_json::to_value(pipeline).unwrap();
    let mut values = BTreeMap::new();
    for (table, value) in whole.as_object().unwrap() {
        match value.as_object() {
            Some(keys) => values.extend(keys.iter().map(|(key, v)| (format!("{table}.{key}"), v.clone()))),
            None => drop(values.insert(table.clone(), value.clone())),
        }
    }
    values
}

/// For each key, as a value, a commented value or a table of its own, the comment over it: that of the lines before
/// it, back to an empty line or a line of dashes. Keys in a row share one.
fn comments(text: &str) -> BTreeMap<String, String> {
    let mut shown = BTreeMap::new();
    let (mut table, mut comment, mut after_key) = (String::new(), String::new(), false);
    for line in text.lines() {
        let bare = line.strip_prefix("# ").unwrap_or(line);
        let key = bare.split_once(" = ").map(|(key, _)| key).filter(|key| !key.contains(' '));
        if let Some(name) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
            shown.insert(name.to_string(), std::mem::take(&mut comment));
            table = format!("{name}.");
        } else if let Some(key) = key {
            shown.insert(format!("{table}{key}"), comment.clone());
            after_key = true;
            continue;
        } else if line.starts_with('#') && !line.ends_with("---") {
            if after_key {
                comment.clear();
            }
            comment += bare;
        } else {
            comment.clear();
        }
        after_key = false;
    }
    shown
}

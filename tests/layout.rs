//! The parts that belong together are together: stages, programs, settings.

use insitu::config::Pipeline;
use insitu::stage::STAGES;
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
        for read in stage.reads {
            assert!(
                STAGES[..i].iter().any(|s| s.name == *read),
                "{} reads {read}, which comes later",
                stage.name
            );
        }
    }
}

#[test]
fn the_worked_example_shows_every_setting() {
    let text = std::fs::read_to_string(root().join("pipeline.toml")).unwrap();
    let defaults = serde_json::to_value(Pipeline::default()).unwrap();
    for (table, settings) in defaults.as_object().unwrap() {
        let Some(settings) = settings.as_object() else {
            assert!(shows(&text, table), "pipeline.toml does not show `{table}`");
            continue;
        };
        let start = text.find(&format!("[{table}]\n")).unwrap_or_else(|| panic!("no table [{table}]"));
        let section = &text[start..];
        for key in settings.keys() {
            assert!(shows(section, key), "pipeline.toml does not show `{table}.{key}`");
        }
    }
}

/// A key as a value, a commented value, or a table of its own.
fn shows(text: &str, key: &str) -> bool {
    text.lines().any(|l| {
        let l = l.trim_start_matches("# ");
        l.starts_with(&format!("{key} =")) || (l.starts_with('[') && l.ends_with(&format!(".{key}]")))
    })
}

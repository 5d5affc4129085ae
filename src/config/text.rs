//! TOML that a person wrote: read, and its mistakes shown where they stand.

use crate::error::{Error, Result};
use std::path::Path;

/// The text of a settings file.
pub(super) fn text_of(path: &Path, missing: &str) -> Result<String> {
    std::fs::read_to_string(path).map_err(|e| {
        let utf8 = e.kind() == std::io::ErrorKind::InvalidData;
        Error::Settings {
            file: path.to_path_buf(),
            line: 0,
            column: 0,
            problem: format!("reading the settings: {e}"),
            hint: if utf8 { "save it as UTF-8 text" } else { missing }.into(),
        }
    })
}

/// Line and column, from 1, of a byte of a text.
pub(super) fn line_and_column(text: &str, byte: usize) -> (usize, usize) {
    let before = text.get(..byte).unwrap_or(text);
    let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
    (before.matches('\n').count() + 1, column)
}

/// Reads TOML into any settings type, with located errors.
pub fn parse<T: serde::de::DeserializeOwned>(text: &str, path: &Path) -> Result<T> {
    toml::from_str(text).map_err(|e| {
        let (line, column) = e.span().map_or((0, 0), |span| line_and_column(text, span.start));
        let problem = e.message().lines().collect::<Vec<_>>().join(" ");
        let problem =
            problem.replace("expected f64", "expected a number").replace("expected f32", "expected a number");
        let problem = ["usize", "u64"].iter().fold(problem, |problem, count| {
            problem.replace(&format!("expected {count}"), "expected a whole number of at least 0")
        });
        let hint = nearest_key(&problem).map_or("see the commented pipeline.toml of insitu".into(), |key| {
            format!("did you mean `{key}`?")
        });
        Error::Settings { file: path.to_path_buf(), line, column, problem, hint }
    })
}

/// Refuses numbers that nobody measured: `nan`, `inf`, and what no picture or room holds.
pub fn refuse_wild_numbers(text: &str, path: &Path) -> Result<()> {
    let refuse = |at: usize, number: &str| {
        let (line, column) = line_and_column(text, at);
        let problem = format!("{number} is no number that can be measured");
        let hint = "give pixels or metres as finite numbers below a million".into();
        Err(Error::Settings { file: path.to_path_buf(), line, column, problem, hint })
    };
    let wild = |number: &str| !number.replace('_', "").parse::<f64>().is_ok_and(|v| v.abs() < 1e6);
    let Ok(document) = toml_edit::Document::parse(text) else { return Ok(()) };
    let mut values: Vec<&toml_edit::Item> = vec![document.as_item()];
    let mut numbers: Vec<&toml_edit::Value> = Vec::new();
    while let Some(item) = values.pop() {
        match item {
            toml_edit::Item::Table(t) => values.extend(t.iter().map(|(_, v)| v)),
            toml_edit::Item::ArrayOfTables(a) => {
                values.extend(a.iter().flat_map(|t| t.iter().map(|(_, v)| v)))
            }
            toml_edit::Item::Value(v) => numbers.push(v),
            toml_edit::Item::None => {}
        }
    }
    while let Some(value) = numbers.pop() {
        match value {
            toml_edit::Value::Array(a) => numbers.extend(a.iter()),
            toml_edit::Value::InlineTable(t) => numbers.extend(t.iter().map(|(_, v)| v)),
            toml_edit::Value::Float(_) | toml_edit::Value::Integer(_) => {
                let Some(span) = value.span() else { continue };
                let number = text.get(span.clone()).unwrap_or_default();
                if wild(number) {
                    return refuse(span.start, number);
                }
            }
            _ => {}
        }
    }
    Ok(())
}

/// From serde's "unknown field `a`, expected one of `b`, `c`": the expected name nearest to the one found.
fn nearest_key(message: &str) -> Option<String> {
    if !message.starts_with("unknown") {
        return None;
    }
    let names: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let (found, expected) = names.split_first()?;
    expected
        .iter()
        .max_by(|a, b| strsim::jaro_winkler(found, a).total_cmp(&strsim::jaro_winkler(found, b)))
        .map(|s| s.to_string())
}

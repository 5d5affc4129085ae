//! A settings file, with the one it extends, as a [`Pipeline`].

use super::Pipeline;
use super::ranges;
use super::text::{line_and_column, parse, text_of};
use crate::error::{Error, Result};
use std::path::Path;

impl Pipeline {
    /// Reads a settings file; mistakes are shown with line and column, unknown keys with the nearest known one.
    pub fn read(path: &Path) -> Result<Self> {
        let text = text_of(path, "name a settings file, or write one with `insitu new FOLDER`")?;
        let own: Self = parse(&text, path)?;
        let Some(base) = &own.extends else {
            own.check(&[(path, &text)])?;
            return Ok(own);
        };
        let base_path = path.parent().unwrap_or(Path::new("")).join(base);
        let base_text = text_of(&base_path, &format!("check `extends` in {}", path.display()))?;
        if parse::<Self>(&base_text, &base_path)?.extends.is_some() {
            return Err(Error::Settings {
                file: base_path,
                line: 0,
                column: 0,
                problem: "is extended by another file and extends one itself".into(),
                hint: "keep to one level of `extends`".into(),
            });
        }
        let mut merged: toml::Table = parse(&base_text, &base_path)?;
        overlay(&mut merged, parse(&text, path)?);
        let whole: Self = merged
            .try_into()
            .map_err(|e| Error::Bug(format!("merging {} and {}: {e}", path.display(), base.display())))?;
        whole.check(&[(path, &text), (&base_path, &base_text)])?;
        Ok(whole)
    }

    /// Refuses numbers that make no sense, and shows them in the first of the files that gives them.
    fn check(&self, files: &[(&Path, &str)]) -> Result<()> {
        let Some(outside) = ranges::check(self) else { return Ok(()) };
        let found = files.iter().find_map(|(path, text)| {
            ranges::place(text, outside.path).map(|at| (*path, line_and_column(text, at)))
        });
        let (file, (line, column)) = found.unwrap_or((files[0].0, (0, 0)));
        let (problem, hint) = (outside.problem, outside.hint);
        Err(Error::Settings { file: file.to_path_buf(), line, column, problem, hint })
    }

    /// Some of its tables and keys (`table.key`), as they enter a stage's digest.
    pub fn settings(&self, names: &[&str]) -> serde_json::Value {
        let whole = serde_json::to_value(self).unwrap_or_default();
        let of = |name: &str| name.split('.').fold(&whole, |value, key| &value[key]).clone();
        names.iter().map(|name| (name.to_string(), of(name))).collect()
    }
}

/// Puts the values of `upper` over those of `lower`, table by table.
fn overlay(lower: &mut toml::Table, upper: toml::Table) {
    for (key, value) in upper {
        match (lower.get_mut(&key), value) {
            (Some(toml::Value::Table(below)), toml::Value::Table(above)) => overlay(below, above),
            (_, value) => {
                lower.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_keys_are_located_and_the_nearest_is_named() {
        let text = "work = \"w\"\n\n[transfer]\nrays = 4\n  sorce_share = 0.5\n";
        let e = parse::<Pipeline>(text, Path::new("pipeline.toml")).unwrap_err();
        assert!(e.to_string().starts_with("pipeline.toml:5:3: unknown field `sorce_share`"), "{e}");
        assert_eq!(e.hint(), "did you mean `source_share`?");
        assert_eq!(e.exit_code(), 2);
    }

    #[test]
    fn an_extending_file_changes_only_what_it_names() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("a.toml"), "[render]\nscale = 2.0\nrotation_deg = 5.0\n").unwrap();
        std::fs::write(dir.path().join("b.toml"), "extends = \"a.toml\"\n[render]\nscale = 3.0\n").unwrap();
        let pipeline = Pipeline::read(&dir.path().join("b.toml")).unwrap();
        assert_eq!((pipeline.render.scale, pipeline.render.rotation_deg), (3.0, 5.0));
    }

    #[test]
    fn unknown_roles_are_named() {
        let text = "[ingest.roles]\nplaet = [\"a.jpg\"]\n";
        let e = parse::<Pipeline>(text, Path::new("p.toml")).unwrap_err();
        assert_eq!(e.hint(), "did you mean `plate`?", "{e}");
    }
}

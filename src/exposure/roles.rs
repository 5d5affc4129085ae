//! Which file is for what: names in the photo folder against the patterns of `[ingest.roles]`.

use super::problem::{Problem, role_name};
use super::raw::is_raw;
use crate::config::Role;
use crate::error::{Error, FileContext, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// Files with their roles, by role and then name.
pub type Assignment = Vec<(Role, String)>;

const EXTENSIONS: [&str; 7] = ["jpg", "jpeg", "png", "tif", "tiff", "hdr", "exr"];

/// Image files in a folder and in the folders right within it (`sub/name.jpg`), sorted. Hidden ones are left out.
pub fn list(folder: &Path) -> Result<Vec<String>> {
    const DOING: &str = "listing the photographs";
    let mut names = Vec::new();
    let mut folders = vec![(String::new(), folder.to_path_buf())];
    while let Some((prefix, folder)) = folders.pop() {
        for entry in std::fs::read_dir(&folder).at(DOING, &folder)? {
            let entry = entry.at(DOING, &folder)?;
            let (path, file) = (entry.path(), entry.file_name().to_string_lossy().into_owned());
            let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
            if file.starts_with('.') {
                continue;
            } else if path.is_dir() && prefix.is_empty() {
                folders.push((format!("{file}/"), path));
            } else if (EXTENSIONS.contains(&extension.as_str()) || is_raw(&path)) && path.is_file() {
                names.push(format!("{prefix}{file}"));
            }
        }
    }
    names.sort();
    if names.is_empty() {
        let hint = "put the photographs there, or name their folder with `photos` in [ingest]";
        return Err(Error::file(DOING, folder, "holds no JPEG, PNG, TIFF, HDR or EXR file", hint));
    }
    Ok(names)
}

/// BLAKE3 of the sorted names of the image files in a folder.
pub fn listing_digest(folder: &Path) -> Result<String> {
    Ok(blake3::hash(list(folder)?.join("\n").as_bytes()).to_hex().to_string())
}

/// Gives each file that a pattern matches its role. A pattern that matches nothing is an error, and so is a file with
/// two roles, unless it is the plate and one of its brackets.
pub fn assign(names: &[String], patterns: &BTreeMap<Role, Vec<String>>) -> Result<Assignment, Problem> {
    let mut roles: Assignment = Vec::new();
    for (&role, patterns) in patterns {
        let mut files: Vec<String> = Vec::new();
        for pattern in patterns {
            let place = format!("ingest.roles.{}", role_name(role));
            // The order of patterns is the user's: the first plate is the one that is augmented.
            for file in matching(pattern, names, &place)? {
                if !files.contains(&file) {
                    files.push(file);
                }
            }
        }
        for file in files {
            let other = roles.iter().find(|(r, f)| *f == file && !may_share(*r, role));
            if let Some((first, _)) = other {
                return Err(Problem::TwoRoles { file, first: *first, second: role });
            }
            roles.push((role, file));
        }
    }
    Ok(roles)
}

fn may_share(a: Role, b: Role) -> bool {
    (a, b) == (Role::Plate, Role::Brackets) || (a, b) == (Role::Brackets, Role::Plate)
}

/// Roles by the habit of naming files after them, for settings that say nothing.
pub fn derive(names: &[String]) -> Assignment {
    const HABITS: [(Role, &[&str]); 6] = [
        (Role::PlateWithGrid, &["plate_with_grid", "grid_with_probe"]),
        (Role::Plate, &["plate"]),
        (Role::Brackets, &["bracket"]),
        (Role::Probe, &["probe", "ball"]),
        (Role::Grid, &["grid", "calib"]),
        (Role::Flat, &["flat"]),
    ];
    let role_of = |file: &String| {
        let lower = file.to_lowercase();
        let (role, _) = HABITS.iter().find(|(_, starts)| starts.iter().any(|s| lower.starts_with(s)))?;
        Some((*role, file.clone()))
    };
    let mut roles: Assignment = names.iter().filter_map(role_of).collect();
    roles.sort();
    roles
}

/// The names that a pattern matches, at least one.
pub(super) fn matching(pattern: &str, names: &[String], place: &str) -> Result<Vec<String>, Problem> {
    let found: Vec<String> = names.iter().filter(|n| glob(pattern, n)).cloned().collect();
    if !found.is_empty() {
        return Ok(found);
    }
    let likeness = |n: &str| strsim::jaro_winkler(pattern, n);
    let nearest = names.iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b))).cloned();
    Err(Problem::NoMatch { pattern: pattern.into(), place: place.into(), files: names.len(), nearest })
}

/// Whether a name is of a pattern in which `*` stands for any characters but `/`.
pub fn glob(pattern: &str, name: &str) -> bool {
    match pattern.split_once('*') {
        None => pattern == name,
        Some((before, after)) => name.strip_prefix(before).is_some_and(|rest| {
            let reach = rest.find('/').unwrap_or(rest.len());
            (0..=reach).filter(|&i| rest.is_char_boundary(i)).any(|i| glob(after, &rest[i..]))
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Problem as _;

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|n| n.to_string()).collect()
    }

    fn roles(roles: &[(Role, &[&str])]) -> BTreeMap<Role, Vec<String>> {
        roles.iter().map(|(r, p)| (*r, names(p))).collect()
    }

    #[test]
    fn star_stands_for_any_characters_within_a_folder() {
        assert!(glob("a*.jpg", "a.jpg") && glob("a*.jpg", "abc.jpg") && glob("*_*.jpg", "é_1.jpg"));
        assert!(!glob("a*.jpg", "ab.png") && !glob("a", "ab") && !glob("*.jpg", "sub/a.jpg"));
        assert!(glob("sub/*.jpg", "sub/a.jpg") && glob("*/*.jpg", "sub/a.jpg"));
    }

    #[test]
    fn a_pattern_without_a_file_names_the_nearest() {
        let e = assign(&names(&["plate_0.jpg", "probe_0.jpg"]), &roles(&[(Role::Plate, &["plaet_0.jpg"])]));
        let e = e.unwrap_err();
        assert_eq!(e.to_string(), "`plaet_0.jpg` (ingest.roles.plate) matches none of 2 image files");
        assert_eq!(e.hint(), "did you mean `plate_0.jpg`?");
    }

    #[test]
    fn two_roles_are_refused_but_the_plate_may_be_a_bracket() {
        let files = names(&["a.jpg", "b.jpg"]);
        let shared = roles(&[(Role::Plate, &["a.jpg"]), (Role::Brackets, &["*.jpg"])]);
        assert_eq!(assign(&files, &shared).unwrap().len(), 3);
        let wrong = roles(&[(Role::Probe, &["a.jpg"]), (Role::Brackets, &["*.jpg"])]);
        let message = assign(&files, &wrong).unwrap_err().to_string();
        assert_eq!(message, "a.jpg has the roles `brackets` and `probe`");
    }

    #[test]
    fn the_plate_named_first_stays_first() {
        let patterns = roles(&[(Role::Plate, &["b.jpg", "*.jpg"])]);
        assert_eq!(assign(&names(&["a.jpg", "b.jpg"]), &patterns).unwrap()[0].1, "b.jpg");
    }

    #[test]
    fn habits_of_naming() {
        let files = names(&["brackets_1.jpg", "calib_0.jpg", "grid_with_probe.jpg", "plate_0.jpg", "x.jpg"]);
        let expected = [Role::Plate, Role::Brackets, Role::PlateWithGrid, Role::Grid];
        assert_eq!(derive(&files).iter().map(|r| r.0).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn a_folder_without_images_is_named() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("notes.txt"), "x").unwrap();
        let message = list(folder.path()).unwrap_err().to_string();
        assert!(message.contains("holds no JPEG"), "{message}");
        let before = listing_digest(folder.path()).is_err();
        std::fs::write(folder.path().join("a.jpg"), "x").unwrap();
        assert!(before && listing_digest(folder.path()).is_ok());
    }
}

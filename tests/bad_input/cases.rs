//! Cases of bad input, run on spoilt copies of a capture that went through every stage.

use super::common;
use super::spoil::Spoil::{self, *};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// A bad input and what is said of it.
pub struct Case {
    name: &'static str,
    spoils: &'static [Spoil],
    /// A stage, to be run alone on `case.toml`; or a command line of `insitu`.
    program: &'static str,
    /// Exit status: 1 data, 2 settings or usage.
    code: i32,
    /// `#` stands for a measured number.
    error: &'static str,
    hint: &'static str,
}

pub const fn case(
    name: &'static str,
    spoils: &'static [Spoil],
    program: &'static str,
    code: i32,
    error: &'static str,
    hint: &'static str,
) -> Case {
    Case { name, spoils, program, code, error, hint }
}

/// The office, run through once with fast settings; cases work on copies made of links.
fn prepared() -> &'static Path {
    static PREPARED: OnceLock<PathBuf> = OnceLock::new();
    PREPARED.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bad_input");
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("making a folder");
        let office = common::Capture::office();
        let output = office.run(&["--quiet"]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        link(&office.path(""), &folder);
        folder
    })
}

fn link(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("making a folder");
    for entry in std::fs::read_dir(from).expect("reading a folder").flatten() {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            link(&entry.path(), &target);
        } else if std::fs::hard_link(entry.path(), &target).is_err() {
            std::fs::copy(entry.path(), &target).expect("copying");
        }
    }
}

/// A spoilt copy of the prepared capture.
pub fn spoilt(spoils: &[Spoil]) -> tempfile::TempDir {
    let parent = prepared().parent().expect("a folder");
    let folder = tempfile::tempdir_in(parent).expect("a temporary folder");
    link(prepared(), folder.path());
    Set("").apply(folder.path());
    spoils.iter().for_each(|s| s.apply(folder.path()));
    folder
}

pub fn run(folder: &Path, program: &str) -> Output {
    let insitu = Path::new(env!("CARGO_BIN_EXE_insitu"));
    let mut command = match program.strip_prefix("insitu ") {
        Some(arguments) => {
            let mut command = Command::new(insitu);
            command.args(arguments.split(' '));
            command
        }
        None => {
            let mut command = Command::new(insitu.with_file_name(format!("insitu-{program}")));
            command.arg("case.toml");
            command
        }
    };
    command.current_dir(folder).output().expect("starting the program")
}

/// Hashes of all results.
pub fn results(folder: &Path) -> BTreeMap<PathBuf, String> {
    let mut all = BTreeMap::new();
    let mut folders = vec![folder.join("work")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
            match entry.path().is_dir() {
                true => folders.push(entry.path()),
                false => drop(all.insert(
                    entry.path(),
                    insitu::stage::digest_file(&entry.path()).expect("reading a result"),
                )),
            }
        }
    }
    all
}

/// The lines `error: …` and `hint: …` of the first error.
pub fn said(output: &Output) -> [String; 2] {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    ["error: ", "hint: "].map(|start| {
        let line = text.lines().find_map(|l| l.strip_prefix(start));
        line.map_or(format!("no `{start}` in {text:?}"), String::from)
    })
}

/// Whether a message is the expected one, in which `#` stands for a measured number.
fn is(said: &str, expected: &str) -> bool {
    let mut rest = said;
    for (i, part) in expected.split('#').enumerate() {
        if i > 0 {
            let end = rest.find(|c: char| !(c.is_ascii_digit() || c == '-')).unwrap_or(rest.len());
            // A point is of the number where digits follow it.
            let fraction =
                rest[end..].strip_prefix('.').map(|f| f.chars().take_while(char::is_ascii_digit).count());
            let number = end + fraction.filter(|n| *n > 0).map_or(0, |n| n + 1);
            if number == 0 {
                return false;
            }
            rest = &rest[number..];
        }
        let Some(after) = rest.strip_prefix(part) else { return false };
        rest = after;
    }
    rest.is_empty()
}

pub fn check(cases: &[Case]) {
    let mut wrong = String::new();
    for case in cases {
        let folder = spoilt(case.spoils);
        let before = results(folder.path());
        let output = run(folder.path(), case.program);
        let [error, hint] = said(&output);
        let code = output.status.code();
        if code != Some(case.code) || !is(&error, case.error) || hint != case.hint {
            wrong += &format!("@@ {}\ncode {code:?}\nerror {error}\nhint {hint}\n", case.name);
        }
        // A single stage leaves all as it was; `insitu run` may have finished earlier ones.
        if !case.program.starts_with("insitu run") && results(folder.path()) != before {
            wrong += &format!("@@ {}: earlier results changed\n", case.name);
        }
    }
    assert!(wrong.is_empty(), "\n{wrong}");
}

//! Errors as a user meets them: what was being done, to which file, what is wrong, what to do.
//!
//! A domain module has its own `thiserror` enum that implements [`Problem`]; it knows numbers, never paths.
//! The edge (a stage, a reader) adds the deed and the file with [`Context::doing`], and the program prints the
//! whole once.

use std::path::{Path, PathBuf};

/// Result of anything that a stage calls.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What is wrong, in numbers and the field's terms, and what to do about it.
pub trait Problem: std::error::Error + Send + Sync + 'static {
    /// What the user should do, as an imperative sentence without a full stop.
    fn hint(&self) -> String;
}

/// A failure, by whose fault it is.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The command line or a settings file asks for something that cannot be.
    #[error("{}{}: {problem}", file.display(), Location(*line, *column))]
    Settings {
        /// Settings file.
        file: PathBuf,
        /// Line, from 1; 0 when the place is not known.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What is wrong there.
        problem: String,
        /// What to do.
        hint: String,
    },
    /// A file cannot be used.
    #[error("{doing}: {}: {problem}", file.display())]
    File {
        /// What was being done, e.g. `reading the plate`.
        doing: String,
        /// Which file.
        file: PathBuf,
        /// What is wrong with it.
        problem: String,
        /// What to do.
        hint: String,
    },
    /// The data cannot give a trustworthy result.
    #[error("{doing}: {problem}")]
    Data {
        /// What was being done.
        doing: String,
        /// What is wrong, with the number that says so.
        problem: Box<dyn Problem>,
    },
    /// The command line asks for something that cannot be.
    #[error("{problem}")]
    Usage {
        /// What is wrong.
        problem: String,
        /// What to do.
        hint: String,
    },
    /// A stage's own program failed and has said why.
    #[error("stage `{stage}` {}", match code { Some(_) => "failed", None => "was killed" })]
    Stage {
        /// Its name.
        stage: &'static str,
        /// Its exit status, unless it was killed.
        code: Option<i32>,
    },
    /// A promise inside insitu was broken.
    #[error("{0}; this is a fault of insitu, not of your data")]
    Bug(String),
}

struct Location(usize, usize);
impl std::fmt::Display for Location {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        if self.0 > 0 { write!(f, ":{}:{}", self.0, self.1) } else { Ok(()) }
    }
}

impl Error {
    /// A file that cannot be used.
    pub fn file(
        doing: impl Into<String>,
        file: &Path,
        problem: impl ToString,
        hint: impl Into<String>,
    ) -> Self {
        Self::File {
            doing: doing.into(),
            file: file.to_path_buf(),
            problem: problem.to_string(),
            hint: hint.into(),
        }
    }

    /// What the user should do.
    pub fn hint(&self) -> String {
        match self {
            Self::Settings { hint, .. } | Self::File { hint, .. } | Self::Usage { hint, .. } => hint.clone(),
            Self::Data { problem, .. } => problem.hint(),
            Self::Stage { code: Some(_), .. } => {
                "see the message above; results of earlier runs are kept".into()
            }
            Self::Stage { code: None, .. } => "run again: results of earlier runs are kept".into(),
            Self::Bug(_) => "report it with the command line and `stage.json`".into(),
        }
    }

    /// Exit status: 1 the data cannot give a result, 2 usage or settings, 3 ours.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::File { .. } | Self::Data { .. } => 1,
            Self::Settings { .. } | Self::Usage { .. } => 2,
            Self::Stage { code, .. } => code.and_then(|c| u8::try_from(c).ok()).unwrap_or(1),
            Self::Bug(_) => 3,
        }
    }
}

/// Adds the deed to a domain problem.
pub trait Context<T> {
    /// `fit(..).doing("fitting the response of channel red")?`
    fn doing(self, doing: impl Into<String>) -> Result<T>;
}

impl<T, E: Problem> Context<T> for std::result::Result<T, E> {
    fn doing(self, doing: impl Into<String>) -> Result<T> {
        self.map_err(|e| Error::Data { doing: doing.into(), problem: Box::new(e) })
    }
}

/// Adds deed and file to a failure of the file system.
pub trait FileContext<T> {
    /// `std::fs::read(p).at("reading the annotations", p)?`
    fn at(self, doing: &str, file: &Path) -> Result<T>;
}

impl<T> FileContext<T> for std::io::Result<T> {
    fn at(self, doing: &str, file: &Path) -> Result<T> {
        self.map_err(|e| {
            let hint = match e.kind() {
                std::io::ErrorKind::NotFound => "check the name and the folder in pipeline.toml",
                std::io::ErrorKind::PermissionDenied => {
                    "make the folder writable, or choose another with `work`"
                }
                std::io::ErrorKind::StorageFull
                | std::io::ErrorKind::QuotaExceeded
                | std::io::ErrorKind::FileTooLarge => {
                    "free some disk space, then run again: earlier results are kept"
                }
                std::io::ErrorKind::ReadOnlyFilesystem | std::io::ErrorKind::NotADirectory => {
                    "choose a writable folder with `work`"
                }
                _ => "check the disk and the permissions of the folder",
            };
            Error::file(doing, file, e, hint)
        })
    }
}

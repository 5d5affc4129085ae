//! What reaches the terminal: data on stdout, all else on stderr; bars only where a person looks.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::{ErrorKind, IsTerminal, Write};

/// How much is said.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verbosity {
    /// Errors alone.
    Quiet,
    /// One line a stage, warnings, bars on a terminal.
    Normal,
    /// Figures as they come, no bars.
    Verbose,
}

/// Answers every question about output.
#[derive(Debug, Clone, Copy)]
pub struct Printer {
    verbosity: Verbosity,
}

impl Printer {
    /// A printer of the given verbosity.
    pub fn new(verbosity: Verbosity) -> Self {
        Self { verbosity }
    }

    /// How much is said.
    pub fn verbosity(&self) -> Verbosity {
        self.verbosity
    }

    /// A product: a path, a table. A reader that has seen enough (`| head`) is no failure.
    pub fn data(&self, line: &str) {
        match writeln!(std::io::stdout(), "{line}") {
            Err(e) if e.kind() != ErrorKind::BrokenPipe => eprintln!("warning: writing to the output: {e}"),
            _ => {}
        }
    }

    /// A line of progress.
    pub fn say(&self, line: &str) {
        if self.verbosity >= Verbosity::Normal {
            eprintln!("{line}");
        }
    }

    /// What only `-v` shows.
    pub fn detail(&self, line: &str) {
        if self.verbosity >= Verbosity::Verbose {
            eprintln!("  {line}");
        }
    }

    /// A defect that was worked around.
    pub fn warn(&self, message: &str) {
        if self.verbosity >= Verbosity::Normal {
            eprintln!("warning: {message}");
        }
    }

    /// An error, handled here and nowhere else.
    pub fn error(&self, error: &crate::error::Error) {
        eprintln!("error: {error}");
        eprintln!("hint: {}", error.hint());
    }

    /// A bar on a terminal, nothing otherwise.
    pub fn progress(&self, what: &str, length: u64) -> ProgressBar {
        if self.verbosity != Verbosity::Normal || !std::io::stderr().is_terminal() {
            return ProgressBar::hidden();
        }
        let style = ProgressStyle::with_template("  {msg:24} {bar:40} {percent:>3} %  {eta}");
        ProgressBar::new(length)
            .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
            .with_message(what.to_string())
    }
}

//! `insitu status`: what is fresh, stale or missing, and why.

use crate::error::Result;
use crate::printer::Printer;
use crate::stage::{self, STAGES, State, Workspace};
use std::path::Path;

/// Prints one line a stage. A stage behind a stale one is stale too, whatever its own inputs say.
pub fn status(settings: &Path, printer: &Printer) -> Result<()> {
    let workspace = Workspace::open(settings)?;
    let mut to_run: Vec<&str> = Vec::new();
    for stage in STAGES {
        let (word, why) = match stage::state(&workspace, stage) {
            State::Missing(why) => ("missing", why),
            State::Stale(why) => ("stale", why),
            State::Fresh => match stage.reads.iter().find(|r| to_run.contains(r)) {
                Some(before) => ("stale", format!("waits for {before}")),
                None => ("fresh", String::new()),
            },
        };
        if word != "fresh" {
            to_run.push(stage.name);
        }
        printer.data(format!("{:<11} {word:<8} {why}", stage.name).trim_end());
    }
    Ok(())
}

//! The object in a film, frame by frame (Supan, Stuppacher and Haller 2006): the camera's pose from markers ([`Tracker`]),
//! the light from a mirror ball or a fisheye lens in the same moment ([`Lighting`]), the dome's shadow on what the settings say
//! is there ([`Phantoms`]), all put together by [`Live`].
//!
//! Beyond the paper: a pose filter whose gain follows the innovation ([`Filter`]), so that a still camera does not tremble and a
//! moving one does not lag; and lights that the ball's picture clips are raised until the markers' white paper gets the light
//! that it shows.

mod clipped;
mod compose;
mod filter;
mod lighting;
mod markers;
mod object;
mod phantoms;
mod shadow;
mod sides;
mod tracker;

pub use compose::{Live, Output, Timing};
pub use filter::Filter;
pub use lighting::Lighting;
pub use markers::Layout;
pub use phantoms::Phantoms;
pub use tracker::{Sight, Tracked, Tracker};

use crate::{dome, vision};

/// Why there is no augmented film.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// A setting that has no default.
    #[error("`live.{0}` is not given")]
    NotGiven(&'static str),
    /// A setting out of its range.
    #[error("`live.{name}` {what}")]
    Setting {
        /// Its name.
        name: &'static str,
        /// What is wrong.
        what: String,
    },
    /// No frame at all.
    #[error("the video has no frames")]
    Empty,
    /// A frame of another size.
    #[error("frame {frame} is {}×{} px, those before it {}×{} px", size.0, size.1, first.0, first.1)]
    Size {
        /// Which frame, from 0.
        frame: usize,
        /// Its size.
        size: (usize, usize),
        /// Size of the first one.
        first: (usize, usize),
    },
    /// No marker in any frame.
    #[error("no marker of the settings was seen in any of {frames} frames")]
    NoMarkers {
        /// Frames looked at.
        frames: usize,
    },
    /// No environment in any frame.
    #[error("in none of {frames} frames is the environment seen: {problem}")]
    NoEnvironment {
        /// Frames looked at.
        frames: usize,
        /// Of the last one.
        problem: dome::Problem,
    },
    /// OpenCV.
    #[error(transparent)]
    Vision(#[from] vision::Problem),
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::NotGiven(name) => {
                format!("give `{name}` in [live]; the commented pipeline.toml of insitu says how")
            }
            Self::Setting { .. } => "correct it in [live]".into(),
            Self::Empty => "check live.frames, and play the video".into(),
            Self::Size { .. } => "give frames of one size: cut the film where its size changes".into(),
            Self::NoMarkers { .. } => {
                "check live.dictionary, the numbers of the markers, and that they are in focus".into()
            }
            Self::NoEnvironment { problem, .. } => problem.hint(),
            Self::Vision(problem) => problem.hint(),
        }
    }
}

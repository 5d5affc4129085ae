//! Why frames cannot be merged.

/// Why frames cannot be merged.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// There is nothing to merge.
    #[error("there is no frame")]
    NoFrame,
    /// The frames differ in size.
    #[error("frame {frame} is {}×{} px, the first {}×{} px", size.0, size.1, first.0, first.1)]
    Sizes {
        /// Which frame, from 1.
        frame: usize,
        /// Its size, px.
        size: (usize, usize),
        /// Size of the first, px.
        first: (usize, usize),
    },
    /// What was put aside on the disk cannot be read again.
    #[error("reading the codes of a frame: {why}")]
    Read {
        /// What the system says.
        why: String,
    },
    /// An exposure is no positive number.
    #[error("an exposure is {exposure}")]
    Exposure {
        /// Its value.
        exposure: f64,
    },
}

impl From<std::io::Error> for Problem {
    fn from(e: std::io::Error) -> Self {
        Self::Read { why: e.to_string() }
    }
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::NoFrame => "give the role `brackets` or `plate` a photograph",
            Self::Read { .. } => "free some space in the folder for temporary files (TMPDIR), then run again",
            Self::Sizes { .. } => "use photographs of one size, neither cropped nor scaled",
            Self::Exposure { .. } => "state the exposure time in [[ingest.exposure]]",
        }
        .into()
    }
}

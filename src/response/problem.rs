//! Why a response cannot be told from brackets.

use super::channel_name;

/// Why a response cannot be told from brackets.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// The exposures do not differ.
    #[error("{frames} frames have {distinct} distinct exposure, at least 2 are needed")]
    OneExposure {
        /// Count of frames.
        frames: usize,
        /// Count of exposures more than 1 % apart.
        distinct: usize,
    },
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
    /// An exposure is no positive number.
    #[error("frame {frame} has the exposure {exposure}")]
    Exposure {
        /// Which frame, from 1.
        frame: usize,
        /// Its exposure.
        exposure: f64,
    },
    /// What was put aside on the disk cannot be read again.
    #[error("reading the codes of a frame: {why}")]
    Read {
        /// What the system says.
        why: String,
    },
    /// Hardly any place is well exposed twice.
    #[error(
        "channel {}: {usable} of {places} places are well exposed in two frames, at least {needed} are needed \
         ({:.0} % of their exposures are clipped, {:.0} % black)",
        channel_name(*channel), clipped * 100.0, dark * 100.0
    )]
    TooFew {
        /// Channel, from 0.
        channel: usize,
        /// Places that could be used.
        usable: usize,
        /// Places looked at.
        places: usize,
        /// Places needed.
        needed: usize,
        /// Share of clipped exposures.
        clipped: f64,
        /// Share of black exposures.
        dark: f64,
    },
    /// The curve is not determined by the data.
    #[error(
        "channel {}: standard error of {stops:.2} stops at code {level}, at most {limit:.2} is allowed \
         (condition number {condition:.1e})",
        channel_name(*channel)
    )]
    Undetermined {
        /// Channel, from 0.
        channel: usize,
        /// The worst level.
        level: usize,
        /// Its standard error, stops.
        stops: f64,
        /// What is allowed, stops.
        limit: f64,
        /// Condition number of the normal equations.
        condition: f64,
    },
    /// A flat field is not evenly bright, or badly exposed.
    #[error(
        "{:.0} % of a photograph of role `flat` are well exposed, {:.0} % are needed", held * 100.0, needed * 100.0
    )]
    NoFlatField {
        /// Share that is well exposed.
        held: f64,
        /// Share that is needed.
        needed: f64,
    },
    /// The grid's paper does not tell the vignetting.
    #[error(
        "the white squares of {photographs} photographs of the grid leave the light in the picture's corners uncertain by {:.1} %, \
         at most {:.0} % is allowed", 100.0 * sigma, 100.0 * limit
    )]
    VignettingOpen {
        /// In which the grid is seen with its white squares well exposed.
        photographs: usize,
        /// Standard deviation of the light in the corners, as a share of that in the middle.
        sigma: f64,
        /// What is allowed.
        limit: f64,
    },
    /// No lens has this vignetting.
    #[error(
        "the vignetting would leave {share:.2} of the light at some place of the picture, from 0.05 to 1.5 is believed"
    )]
    NoLens {
        /// Share of the light that it leaves.
        share: f64,
    },
    /// A stored curve is not one.
    #[error("channel {}: {levels} levels that do not rise throughout", channel_name(*channel))]
    NotACurve {
        /// Channel, from 0.
        channel: usize,
        /// Count of levels.
        levels: usize,
    },
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::OneExposure { .. } => {
                "photograph the view with exposure times one or two stops apart, or state the times in [[ingest.exposure]]"
            }
            Self::Sizes { .. } => "use photographs of one size, neither cropped nor scaled",
            Self::Exposure { .. } => "state the exposure time in [[ingest.exposure]]",
            Self::Read { .. } => "free some space in the folder for temporary files (TMPDIR), then run again",
            Self::TooFew { clipped, dark, .. } if clipped > dark => "add shorter exposures",
            Self::TooFew { .. } => "add longer exposures",
            Self::Undetermined { .. } => "add exposures in between, one or two stops apart",
            Self::NoFlatField { .. } => {
                "photograph a surface of even brightness so that it fills the picture, at a middle grey"
            }
            Self::VignettingOpen { .. } => {
                "photograph the grid in all parts of the picture, its corners too, its paper neither clipped nor in patchy light; or \
                 an even surface (role `flat`)"
            }
            Self::NoLens { .. } => {
                "check `vignetting` in [response], or that role `flat` shows a surface of even brightness alone"
            }
            Self::NotACurve { .. } => crate::artefact::REMAKE,
        }
        .into()
    }
}

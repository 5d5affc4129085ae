//! What can be wrong with a set of photographs.

use crate::config::Role;

/// What is wrong with a set of photographs. Files are named as in the photo folder.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// Nothing to augment.
    #[error("no photograph has the role `plate`")]
    NoPlate,
    /// A pattern of the settings names no file.
    #[error("`{pattern}` ({place}) matches none of {files} image files")]
    NoMatch {
        /// The pattern.
        pattern: String,
        /// Where it stands in the settings.
        place: String,
        /// Count of files in the folder.
        files: usize,
        /// The most similar name there is.
        nearest: Option<String>,
    },
    /// One file has two uses that exclude each other.
    #[error("{file} has the roles `{}` and `{}`", role_name(*.first), role_name(*.second))]
    TwoRoles {
        /// The file.
        file: String,
        /// One role.
        first: Role,
        /// The other.
        second: Role,
    },
    /// Exposures of one view differ in size.
    #[error(
        "{other} is {}×{} px, {file} is {}×{} px; they must be of one size for role `{}`",
        other_size.0, other_size.1, size.0, size.1, role_name(*.role)
    )]
    SizesDiffer {
        /// Their role.
        role: Role,
        /// First file.
        file: String,
        /// Its size, px.
        size: (u32, u32),
        /// The file that differs.
        other: String,
        /// Its size, px.
        other_size: (u32, u32),
    },
    /// An exposure that is needed is not known.
    #[error("{file} (`{}`) has no exposure time", role_name(*.role))]
    NoExposure {
        /// The file.
        file: String,
        /// Its role.
        role: Role,
    },
    /// An exposure that cannot be.
    #[error("{file} has {what} {value}")]
    BadExposure {
        /// The file.
        file: String,
        /// Which quantity, with its unit.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A colour profile that would have to be converted.
    #[error("{file} has {profile} embedded, not sRGB")]
    Profile {
        /// The file.
        file: String,
        /// What it has.
        profile: String,
    },
    /// Some codes are of a RAW file, others are not.
    #[error("{raw} is a camera's RAW file, {other} is none: no one response holds for both")]
    MixedRaw {
        /// A RAW file.
        raw: String,
        /// Another one.
        other: String,
    },
    /// Exposures that cannot be compared.
    #[error("{with} has {what}, {without} has none, so their exposures cannot be compared")]
    Mixed {
        /// Which quantity.
        what: &'static str,
        /// A file that has it.
        with: String,
        /// A file that has not.
        without: String,
    },
}

/// A role as it is written in the settings.
pub fn role_name(role: Role) -> String {
    serde_json::to_value(role).ok().and_then(|v| v.as_str().map(String::from)).unwrap_or_default()
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::NoPlate => "name it in pipeline.toml: [ingest.roles] plate = [\"FILE\"]".into(),
            Self::NoMatch { nearest: Some(nearest), .. } => format!("did you mean `{nearest}`?"),
            Self::NoMatch { nearest: None, .. } => "check `photos` in [ingest]: the folder has no images".into(),
            Self::TwoRoles { .. } => {
                "let each file match one role in [ingest.roles]; only the plate may also be one of the brackets".into()
            }
            Self::SizesDiffer { .. } => "use photographs of one size, neither cropped nor scaled".into(),
            Self::NoExposure { file, .. } | Self::BadExposure { file, .. } => format!(
                "state it under [ingest] in pipeline.toml: exposure = [{{ file = \"{file}\", time_s = 0.01 }}], and f_number and iso \
                 if they vary"
            ),
            Self::Profile { .. } => {
                "develop it again as sRGB, all photographs alike: a conversion afterwards would mix the channels' responses"
                    .into()
            }
            Self::MixedRaw { .. } => {
                "give plate, brackets and probe either RAW files or photographs that the camera developed".into()
            }
            Self::Mixed { what, without, .. } => {
                let key = if *what == "an ISO speed" { "iso" } else { "f_number" };
                format!("state it under [ingest] in pipeline.toml: exposure = [{{ file = \"{without}\", {key} = … }}]")
            }
        }
    }
}

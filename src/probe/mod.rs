//! The light probe: finding the mirror ball and unwrapping what it reflects.

pub mod clipped;
pub mod consistency;
pub mod crop;
mod edge;
pub mod environment;
pub mod exposures;
pub mod find;
pub mod fisheye;
pub mod latlong;
pub mod marked;
pub mod mirror_ball;
pub mod outline;
pub mod placed;
mod stage;
#[cfg(test)]
pub mod synthetic;
pub mod unwrap;
pub mod view;
pub mod views;

use crate::artefact::json::JsonArtefact;
use crate::calibrate;
use crate::camera::Camera;
use crate::config::ProbeSource;
use glam::Vec3;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

pub use environment::Environment;
pub use stage::of_capture;
pub use unwrap::Unwrapped;

/// The reflectivity seen may differ from the one given by this share.
const REFLECTIVITY_TOLERANCE: f64 = 0.1;

/// Where the ball is, and how surely.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProbeFit {
    /// What showed the environment. Of a fisheye lens or a map `camera` is the plate's, `centre` its place, and there is no ball.
    pub source: ProbeSource,
    /// The photographs of this view.
    pub photographs: Vec<String>,
    /// The view in which the ball was photographed.
    pub camera: Camera,
    /// Centre of the ball in the world, m.
    pub centre: Point3<f64>,
    /// Radius of the ball, m.
    pub radius_m: f64,
    /// Distance of the sub-pixel edges, or of the marks, from the outline, rms, px.
    pub outline_rms_px: f64,
    /// Share of the outline along which an edge was found; none was looked for on a marked outline.
    pub outline_support: Option<f64>,
    /// Correlation of the mirrored surface with the surface seen directly, where the ball stands on it.
    pub mirror_correlation: Option<f64>,
    /// Reflectivity as seen: mirrored over direct luminance of the surface.
    pub reflectivity_seen: Option<f64>,
    /// Standard deviation of the centre along the world's axes, m; 0 along y where the support's height gives it.
    pub centre_sigma_m: [f64; 3],
    /// Mean diameter of the ball in the picture, px.
    pub diameter_px: f64,
}

impl ProbeFit {
    /// Where nothing was searched: place and camera are as the settings say.
    fn stated(
        source: ProbeSource,
        camera: Camera,
        centre: Point3<f64>,
        radius_m: f64,
        diameter_px: f64,
    ) -> Self {
        Self {
            source,
            photographs: Vec::new(),
            camera,
            centre,
            radius_m,
            outline_rms_px: 0.0,
            outline_support: None,
            mirror_correlation: None,
            reflectivity_seen: None,
            centre_sigma_m: [0.0; 3],
            diameter_px,
        }
    }

    /// Angular standard deviation, per axis, with which the unwrapped ball shows a point in a direction, rad: of a pixel
    /// (variance 1/12 px²) and of bilinear interpolation (1/6 px²), through the mirror's slope 2 / (R cos θ).
    pub fn blur(&self, direction: Vec3) -> f64 {
        if self.source != ProbeSource::Ball {
            return 2.0 / self.diameter_px;
        }
        let view = (self.camera.centre() - self.centre).normalize();
        let d = Vector3::new(f64::from(direction.x), f64::from(direction.y), f64::from(direction.z));
        let cosine = ((1.0 + view.dot(&d)) / 2.0).max(0.0).sqrt().max(0.05);
        // Across and along the meridian, in the mean.
        let slope = 2.0 / (0.5 * self.diameter_px) * (0.5 * (1.0 + 1.0 / (cosine * cosine))).sqrt();
        slope * 0.25f64.sqrt()
    }

    /// The reflectivity seen, where it is far from the one given.
    pub fn other_reflectivity(&self, given: f64) -> Option<f64> {
        self.reflectivity_seen.filter(|seen| (seen / given - 1.0).abs() > REFLECTIVITY_TOLERANCE)
    }
}

impl JsonArtefact for ProbeFit {
    const FORMAT: &'static str = "insitu-probe";
    const VERSION: u32 = 3;
}

/// Why a probe cannot be used.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum Problem {
    /// Nowhere does the picture look like a mirror image of the surface.
    #[error(
        "the mirror ball was not found: at the best place its mirror image agrees with the surface by a correlation of {agreement:.2}, {needed:.2} is needed"
    )]
    NotFound {
        /// Correlation at the best place.
        agreement: f64,
        /// Correlation that is needed.
        needed: f64,
    },
    /// No photograph has the role.
    #[error("there is no photograph of the mirror ball")]
    NoPicture,
    /// Part of the ball lies outside the picture.
    #[error("the mirror ball is cut off by the border of the picture: {:.0} % of its outline lie outside", 100.0 * outside)]
    CutOff {
        /// Share of the outline outside the picture.
        outside: f64,
    },
    /// Something that looks like a mirror image, without a ball around it.
    #[error(
        "the mirror ball was not found: at the best place an edge runs along {:.0} % of its outline, {:.0} % are needed",
        100.0 * support, 100.0 * needed
    )]
    NoOutline {
        /// Share of the outline along which there is an edge.
        support: f64,
        /// Share that is needed.
        needed: f64,
    },
    /// The ball is too small in the picture.
    #[error("the mirror ball is {diameter_px:.1} px across, at least {needed_px} px are needed")]
    TooSmall {
        /// Diameter found, px.
        diameter_px: f64,
        /// Diameter needed, px.
        needed_px: f64,
    },
    /// Too few marks.
    #[error("the ball's outline is marked at {found} points, {needed} are needed")]
    FewMarks {
        /// How many.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Marks that are not on a ball's outline.
    #[error("the marks are {rms_px:.1} px (rms) off the outline of any ball, the limit is {limit_px:.1} px")]
    NotAnOutline {
        /// How far they are off.
        rms_px: f64,
        /// Largest acceptable.
        limit_px: f64,
    },
    /// Marks that leave the distance open.
    #[error("the marked outline gives the ball's distance to {:.0} % only (limit {:.0} %)", 100.0 * relative, 100.0 * limit)]
    DistanceUncertain {
        /// σ / distance.
        relative: f64,
        /// Largest acceptable.
        limit: f64,
    },
    /// No ball in front of the camera.
    #[error("no ball of {radius_m} m radius in front of the camera has the marked outline")]
    NoBall {
        /// `probe.radius_m`.
        radius_m: f64,
    },
    /// The outline is marked elsewhere.
    #[error("the ball's outline is marked in {image}, which is no photograph of the probe")]
    OtherImage {
        /// Where it is.
        image: String,
    },
    /// Not the plate's camera.
    #[error("the probe's photographs have {}×{} px, the plate has {}×{} px: they were not taken from its place", probe[0], probe[1], plate[0], plate[1])]
    OtherSize {
        /// Width and height of the probe's photographs, px.
        probe: [usize; 2],
        /// Width and height of the plate, px.
        plate: [usize; 2],
    },
    /// The printed grid does not give the camera.
    #[error(transparent)]
    Grid(calibrate::Problem),
    /// A lens without a focal length.
    #[error("the fisheye lens has a focal length of {0} px")]
    Focal(f64),
    /// The camera of a crop.
    #[error("the camera is {distance_m} m from the middle of a ball of {radius_m} m radius")]
    Near {
        /// `probe.distance_m`.
        distance_m: f64,
        /// `probe.radius_m`.
        radius_m: f64,
    },
    /// Several views that do not show the same.
    #[error(
        "the view `{files}` agrees with the first one by a correlation of {agreement:.2}, {needed:.2} is needed"
    )]
    Unlike {
        /// Pattern of its photographs.
        files: String,
        /// Correlation at the best turn.
        agreement: f64,
        /// What is needed.
        needed: f64,
    },
    /// A view without photographs.
    #[error("no photograph of role `probe` is called `{files}`")]
    EmptyView {
        /// Its pattern.
        files: String,
    },
    /// A picture that cannot be of the layout.
    #[error("the map has {}×{} px: in its layout {aspect} px of width go to one of height", size[0], size[1])]
    Shape {
        /// Width and height, px.
        size: [usize; 2],
        /// Width over height of the layout.
        aspect: usize,
    },
    /// The radius is not a length.
    #[error("the mirror ball has a radius of {0} m")]
    Radius(f64),
    /// The reflectivity is not a share.
    #[error("the mirror ball has a reflectivity of {0:?}")]
    Reflectivity([f64; 3]),
    /// No environment can be that small.
    #[error("an environment of {0} px width is too small to hold light")]
    Width(usize),
    /// The camera cannot look down on the plane the ball stands on.
    #[error("the camera is {0:.3} m above the plane through the ball's centre: it must look from above")]
    CameraBelow(f64),
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::Grid(problem) => return problem.hint(),
            Self::NotFound { .. } | Self::NoOutline { .. } => {
                "check probe.radius_m and probe.support_m, and that grid and ball stand on the same surface"
            }
            Self::NoPicture => "name its photographs in pipeline.toml under [ingest.roles] as `probe`",
            Self::FewMarks { .. } | Self::DistanceUncertain { .. } => {
                "mark more points all round the ball under [ball] in annotations.toml"
            }
            Self::NotAnOutline { .. } => "check each point of `outline` under [ball] in annotations.toml",
            Self::NoBall { .. } => "check probe.radius_m and `outline` under [ball] in annotations.toml",
            Self::OtherImage { .. } => "mark the outline in a photograph of the role `probe`",
            Self::OtherSize { .. } => "set probe.camera = \"grid\" and show the printed grid beside the ball",
            Self::Focal(_) => "give probe.focal_px, px per radian in the middle of the picture",
            Self::Near { .. } => "give probe.distance_m, from the camera to the ball's middle",
            Self::Unlike { .. } => {
                "check that all views are of one ball in one place, and each view's elevation_deg"
            }
            Self::EmptyView { .. } => "check `files` under [[probe.views]]",
            Self::Shape { .. } => "check probe.layout",
            Self::CutOff { .. } => "use a picture that shows the whole ball",
            Self::TooSmall { .. } => "go closer, use a longer lens or a larger picture",
            Self::Radius(_) => "give the ball's radius in metres as probe.radius_m",
            Self::Reflectivity(_) => "give probe.reflectivity as shares above 0 and up to 1",
            Self::Width(_) => "set probe.width_px to 16 or more",
            Self::CameraBelow(_) => "check probe.support_m and the pose of the grid",
        }
        .into()
    }
}

//! Lens and camera poses, from the printed grid, from marked vanishing lines, and from the marks of the scene's primitives.

pub mod board;
pub mod bundle;
pub mod exchange;
pub mod joint;
pub mod lens;
pub mod manhattan;
pub mod pose;
pub mod vanishing;

#[cfg(test)]
mod bundle_tests;
#[cfg(test)]
mod joint_tests;
mod known;
mod lines;
#[cfg(test)]
mod manhattan_tests;
mod problem;
mod solve;
mod stage;
#[cfg(test)]
mod tests;

pub use lines::{edges_of, pose_from_lines, undistorted};
pub use problem::Problem;
pub use solve::{Evidence, Solution, solve};
pub use stage::{export, greys, imported};

use crate::artefact::json::JsonArtefact;
use crate::camera::{Camera, CameraCovariance, Intrinsics, LensCovariance, SharedCovariance};
use crate::config;
use crate::exposure::Photograph;
use crate::image::{CodeImage, Image, RadianceImage};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A camera with the accuracy of its pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PosedCamera {
    /// The camera.
    pub camera: Camera,
    /// Distance of the marks it was found from to their images, rms in px.
    pub rms_px: f64,
    /// Covariance of lens and pose, where it is known; 0 of what is given.
    pub covariance: Option<CameraCovariance>,
    /// The same error for the second solution of the planar ambiguity, where there is one.
    pub rival_rms_px: Option<f64>,
}

/// A second solution that fits nearly as well leaves the pose undecided.
const UNDECIDED: f64 = 1.3;

impl PosedCamera {
    /// Whether a second, different pose explains the grid nearly as well (two-fold planar ambiguity).
    pub fn is_ambiguous(&self) -> bool {
        self.rival_rms_px.is_some_and(|rival| rival < UNDECIDED * self.rms_px)
    }
}

/// Lens and poses: `calibrate/cameras.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cameras {
    /// The lens.
    pub intrinsics: Intrinsics,
    /// Standard deviation of the focal length, px, where known.
    pub focal_sigma_px: Option<f64>,
    /// File name of the plate.
    pub plate: String,
    /// By file name. Photographs taken from one place have one pose.
    pub cameras: BTreeMap<String, PosedCamera>,
    /// How well the lens and all poses are known together, where that is known.
    pub shared: Option<SharedCovariance>,
}

impl JsonArtefact for Cameras {
    const FORMAT: &'static str = "insitu-cameras";
    const VERSION: u32 = 3;

    fn check(&self) -> Result<(), String> {
        if !self.cameras.contains_key(&self.plate) {
            return Err(format!("has no camera of the plate, {}", self.plate));
        }
        let lenses = self.cameras.iter().map(|(file, posed)| (file, &posed.camera.intrinsics));
        for (file, lens) in lenses.chain([(&self.plate, &self.intrinsics)]) {
            if lens.width_px == 0 || lens.height_px == 0 || !lens.focal_px.iter().all(|f| *f > 0.0) {
                return Err(format!("has an impossible lens for {file}"));
            }
        }
        Ok(())
    }
}

impl Cameras {
    /// Lens and poses; `posed` must hold the plate.
    pub fn new(
        plate: String,
        cameras: BTreeMap<String, PosedCamera>,
        focal_sigma_px: Option<f64>,
    ) -> Option<Self> {
        let intrinsics = cameras.get(&plate)?.camera.intrinsics.clone();
        Some(Self { intrinsics, focal_sigma_px, plate, cameras, shared: None })
    }

    /// The camera of the plate, which [`Self::new`] and the reader make sure of.
    pub fn plate_camera(&self) -> &Camera {
        &self.posed_plate().camera
    }

    /// The same with its accuracy.
    pub fn posed_plate(&self) -> &PosedCamera {
        &self.cameras[&self.plate]
    }
}

/// The grid's frame (x along its long side, y, z out of it) in the world (+Y up): (x, y, z) ↦ (x, z, −y).
pub fn world_from_grid() -> Isometry3<f64> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
    Isometry3::from_parts(Translation3::identity(), turn)
}

/// Longest side of the picture in which [`shows_grid`] looks, px.
const GLANCE_PX: usize = 1300;

/// Whether a photograph shows the grid, at a glance.
pub fn shows_grid(codes: &CodeImage, settings: &config::Calibrate) -> bool {
    let (width, height) = codes.size();
    let step = width.max(height).div_ceil(GLANCE_PX).max(1);
    let small = Image::from_fn(width / step, height / step, |x, y| *codes.at(x * step, y * step));
    board::find(&grey(&small), settings).is_ok()
}

/// Pose of the camera that took a picture of the grid.
pub fn grid_pose(
    image: &Image<u8>,
    intrinsics: &Intrinsics,
    settings: &config::Calibrate,
) -> Result<PosedCamera, Problem> {
    let board = board::find_oriented(image, settings)?;
    let boards = [board];
    let lens = LensCovariance::zeros();
    let view =
        pose::View { intrinsics, lens_covariance: &lens, boards: &boards, corner_sigma_px: 0.0, edges: None };
    let posed = pose::fit(&view)?.posed;
    if posed.rms_px > settings.max_rms_px {
        return Err(Problem::Reprojection { rms_px: posed.rms_px, limit_px: settings.max_rms_px });
    }
    Ok(posed)
}

/// Brightness of a photograph, stored or linear, for finding grid and edges.
pub fn grey_of(photograph: &Photograph) -> Image<u8> {
    match photograph {
        Photograph::Codes(image) => grey(image),
        Photograph::Linear(image) => grey_of_radiance(image),
    }
}

/// Brightness of a photograph for finding the grid.
pub fn grey(image: &CodeImage) -> Image<u8> {
    image.par_map(|c| (255.0 * crate::image::luminance(c.0)).round().clamp(0.0, 255.0) as u8)
}

/// Brightness of a linear picture for finding the grid: exposed for its 99th percentile, gamma 2.2.
pub fn grey_of_radiance(image: &RadianceImage) -> Image<u8> {
    let mut sorted: Vec<f32> = image.pixels().iter().map(|r| r.luminance()).collect();
    sorted.sort_by(f32::total_cmp);
    let white = sorted.get(sorted.len() * 99 / 100).copied().unwrap_or(1.0).max(f32::MIN_POSITIVE);
    image.map(|r| (255.0 * (r.luminance() / white).clamp(0.0, 1.0).powf(1.0 / 2.2)).round() as u8)
}

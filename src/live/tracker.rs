//! The pose of the camera in each frame, and what to do where no marker is seen.

use super::{Filter, Layout, Problem};
use crate::calibrate::{pose, world_from_grid};
use crate::camera::{Camera, Intrinsics};
use crate::config;
use crate::image::Image;
use crate::vision;
use nalgebra::{Isometry3, Point3};

/// Accuracy of a marker's corner, px, where the fit shows no larger one.
const CORNER_SIGMA_PX: f64 = 0.05;
/// A pose whose corners are further off than this is none, rms in px.
const MOST_RMS_PX: f64 = 3.0;

/// Whether the markers are seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sight {
    /// So many of them.
    Seen(usize),
    /// None; the last pose is held, for so many frames up to now.
    Held(usize),
    /// None for so long that the object fades.
    Fading(usize),
    /// None for too long, or none so far.
    Gone,
}

/// The camera of a frame.
#[derive(Debug, Clone)]
pub struct Tracked {
    /// Its pose, filtered; the last one where there is no new one.
    pub camera: Option<Camera>,
    /// The pose as the markers alone give it.
    pub measured: Option<Isometry3<f64>>,
    /// Reprojection error of the corners, rms in px.
    pub rms_px: f64,
    /// How surely it is known.
    pub sight: Sight,
    /// Of the object, 1 where the markers are seen, 0 where they were lost for long.
    pub opacity: f32,
}

/// Follows the camera.
pub struct Tracker {
    layout: Layout,
    dictionary: String,
    intrinsics: Intrinsics,
    filter: Filter,
    hold: usize,
    fade: usize,
    lost: usize,
    last: Option<Camera>,
}

impl Tracker {
    /// For a lens.
    pub fn new(settings: &config::Live, intrinsics: Intrinsics) -> Result<Self, Problem> {
        Ok(Self {
            layout: Layout::of(settings)?,
            dictionary: settings.dictionary.clone(),
            intrinsics,
            filter: Filter::default(),
            hold: settings.hold_frames,
            fade: settings.fade_frames,
            lost: 0,
            last: None,
        })
    }

    /// Where the markers are.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// The next frame.
    pub fn follow(&mut self, grey: &Image<u8>) -> Result<Tracked, Problem> {
        let seen = vision::markers(grey, &self.dictionary)?;
        let posed = self.layout.view(&seen).and_then(|view| {
            let boards = [view];
            let view = pose::View {
                intrinsics: &self.intrinsics,
                boards: &boards,
                corner_sigma_px: 0.0,
                edges: None,
            };
            let posed = pose::fit(&view).ok()?.posed;
            let corners = boards[0].board.len();
            (posed.rms_px < MOST_RMS_PX).then_some((posed, corners))
        });
        let Some((posed, corners)) = posed else { return Ok(self.missed()) };
        if self.lost > 0 {
            self.filter.reset();
        }
        self.lost = 0;
        let measured = posed.camera.world_from_camera;
        // Six parameters share the noise of 2n numbers: an rms of σ √(3/n) at the corners.
        let noise = posed.rms_px.max(CORNER_SIGMA_PX) * (3.0 / corners as f64).sqrt();
        let apart =
            |a: &Isometry3<f64>, b: &Isometry3<f64>| apart_px(&self.layout, &self.intrinsics, a, b) / noise;
        let world_from_camera = self.filter.update(measured, apart);
        let camera = Camera { intrinsics: self.intrinsics.clone(), world_from_camera };
        self.last = Some(camera.clone());
        Ok(Tracked {
            camera: Some(camera),
            measured: Some(measured),
            rms_px: posed.rms_px,
            sight: Sight::Seen(corners / 4),
            opacity: 1.0,
        })
    }

    fn missed(&mut self) -> Tracked {
        self.lost += 1;
        let beyond = self.lost.saturating_sub(self.hold);
        let (sight, opacity) = match (&self.last, beyond) {
            (Some(_), 0) => (Sight::Held(self.lost), 1.0),
            (Some(_), n) if n <= self.fade => {
                (Sight::Fading(self.lost), 1.0 - n as f32 / (self.fade + 1) as f32)
            }
            _ => (Sight::Gone, 0.0),
        };
        Tracked { camera: self.last.clone(), measured: None, rms_px: 0.0, sight, opacity }
    }
}

/// Distance of the markers' corners as two poses show them, rms in px.
fn apart_px(layout: &Layout, intrinsics: &Intrinsics, a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let camera = |pose: &Isometry3<f64>| Camera { intrinsics: intrinsics.clone(), world_from_camera: *pose };
    let (a, b) = (camera(a), camera(b));
    let (mut sum, mut count) = (0.0, 0);
    for corner in layout.corners() {
        let corner = world_from_grid() * Point3::new(corner.x, corner.y, 0.0);
        match (a.project(&corner), b.project(&corner)) {
            (Some(p), Some(q)) => {
                sum += (p - q).norm_squared();
                count += 1;
            }
            _ => return f64::MAX,
        }
    }
    (sum / f64::from(count.max(1))).sqrt()
}

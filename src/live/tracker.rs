//! The pose of the camera in each frame, and what to do where no marker is seen.

use super::sides::refined;
use super::{Filter, Layout, Problem};
use crate::calibrate::{PosedCamera, pose, world_from_grid};
use crate::camera::{Camera, Intrinsics, LensCovariance};
use crate::config;
use crate::image::{Image, RadianceImage};
use crate::vision::{self, Marker};
use nalgebra::{Isometry3, Point2, Point3};

/// Accuracy of a marker's corner, px, where the fit shows no larger one.
const CORNER_SIGMA_PX: f64 = 0.05;
/// A marker whose worst corner is so many times as far off as that of most is left out.
const MOST_OFF: f64 = 2.5;
/// A pose whose corners are further off than this is none, rms in px.
const MOST_RMS_PX: f64 = 3.0;
/// Markers are sought where they are expected and so far around, px, and as a share of their extent.
const MARGIN_PX: f64 = 16.0;
const MARGIN: f64 = 0.1;

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
    /// Markers in the last frame that showed some.
    seen: usize,
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
            seen: 0,
            last: None,
        })
    }

    /// Where the markers are.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// The next frame, as grey codes and in linear radiance.
    pub fn follow(&mut self, grey: &Image<u8>, picture: &RadianceImage) -> Result<Tracked, Problem> {
        let mut seen = self.markers(grey)?;
        seen.iter_mut().for_each(|m| m.corners = refined(m.corners, picture));
        let Some((posed, corners)) = self.posed(&seen) else { return Ok(self.missed()) };
        if self.lost > 0 {
            self.filter.reset();
        }
        (self.lost, self.seen) = (0, seen.len());
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

    /// All markers, sought where the last frames let expect them, and everywhere if fewer are there than before.
    fn markers(&self, grey: &Image<u8>) -> Result<Vec<Marker>, Problem> {
        if let Some(expected) = self.expected(grey.size()) {
            let found = vision::markers(grey, &self.dictionary, Some(&expected))?;
            if found.len() >= self.seen {
                return Ok(found);
            }
        }
        Ok(vision::markers(grey, &self.dictionary, None)?)
    }

    /// The part of a picture in which the markers are expected.
    fn expected(&self, (width, height): (usize, usize)) -> Option<vision::Expected> {
        let predicted = self.filter.predict().filter(|_| self.lost == 0)?;
        let camera = Camera { intrinsics: self.intrinsics.clone(), world_from_camera: predicted };
        let corners =
            self.layout.corners().map(|c| camera.project(&(world_from_grid() * Point3::new(c.x, c.y, 0.0))));
        let corners: Vec<Point2<f64>> = corners.collect::<Option<_>>()?;
        let side = |k: usize| (corners[k] - corners[k / 4 * 4 + (k + 1) % 4]).norm();
        let side_px = (0..corners.len()).map(side).fold(f64::MAX, f64::min);
        let low = |k: usize| corners.iter().map(|c| c[k]).fold(f64::MAX, f64::min);
        let high = |k: usize| corners.iter().map(|c| c[k]).fold(f64::MIN, f64::max);
        let margin = |k: usize| MARGIN_PX + MARGIN * (high(k) - low(k));
        let from = |k: usize, size: usize| (low(k) - margin(k)).clamp(0.0, size as f64) as usize;
        let to = |k: usize, size: usize| (high(k) + margin(k)).clamp(0.0, size as f64) as usize;
        let within = [from(0, width), from(1, height), to(0, width), to(1, height)];
        (within[0] < within[2] && within[1] < within[3]).then_some(vision::Expected { within, side_px })
    }

    /// The pose that markers show, and how many corners they are. Markers that are much further off than most, those partly
    /// hidden or in a shadow's edge, are left out.
    fn posed(&self, seen: &[Marker]) -> Option<(PosedCamera, usize)> {
        let fit = |seen: &[Marker]| {
            let boards = [self.layout.view(seen)?];
            let intrinsics = &self.intrinsics;
            let lens_covariance = &LensCovariance::zeros();
            let view = pose::View {
                intrinsics,
                lens_covariance,
                boards: &boards,
                corner_sigma_px: 0.0,
                edges: None,
            };
            Some((pose::fit(&view).ok()?.posed, boards[0].board.len()))
        };
        let all = fit(seen)?;
        let off = |marker: &Marker| {
            let view = self.layout.view(std::slice::from_ref(marker))?;
            let place = |p: &Point2<f64>| world_from_grid() * Point3::new(p.x, p.y, 0.0);
            let off = |(p, q): (&Point2<f64>, &Point2<f64>)| {
                all.0.camera.project(&place(p)).map_or(f64::MAX, |shown| (shown - q).norm())
            };
            Some(view.board.iter().zip(&view.pixels).map(off).fold(0.0, f64::max))
        };
        let mut off: Vec<(&Marker, f64)> = seen.iter().filter_map(|m| Some((m, off(m)?))).collect();
        off.sort_by(|a, b| a.1.total_cmp(&b.1));
        let usual = off[off.len() / 2].1;
        let kept: Vec<Marker> = off
            .iter()
            .filter(|o| o.1 <= MOST_OFF * usual.max(CORNER_SIGMA_PX))
            .map(|o| o.0.clone())
            .collect();
        let (posed, corners) = if kept.len() < off.len() { fit(&kept)? } else { all };
        (posed.rms_px < MOST_RMS_PX).then_some((posed, corners))
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

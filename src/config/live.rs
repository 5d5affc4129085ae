//! `[live]`: a film or a camera instead of a photograph.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Which cameras a live scene has (supan2006, §III).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Setup {
    /// One that sees the markers and the mirror ball.
    OneCamera,
    /// One for the scene, a fixed one for the ball.
    TwoCameras,
    /// One for the scene, a fixed one with a fisheye lens in the ball's place.
    Fisheye,
}

/// Markers of equal size in rows, in the plane z = 0 of the grid's frame, with the middle of all at its origin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MarkerBoard {
    /// Markers along x.
    pub columns: usize,
    /// Rows, from +y down.
    pub rows: usize,
    /// Side of a marker, m.
    pub side_m: f64,
    /// White between two, m.
    pub gap_m: f64,
    /// Number of the first one, at −x, +y; the others follow row by row.
    #[serde(default)]
    pub first_id: u32,
}

/// A marker by itself, in the plane z = 0 of the grid's frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlacedMarker {
    /// Its number in the dictionary.
    pub id: u32,
    /// Its middle, m.
    pub centre_m: [f64; 2],
    /// Its side, m.
    pub side_m: f64,
    /// Turn about z.
    #[serde(default)]
    pub rotation_deg: f64,
}

/// A flat part of the real scene, in the grid's frame, front along u × v.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhantomPlane {
    /// A corner, m.
    pub corner_m: [f64; 3],
    /// One side, m.
    pub side_u_m: [f64; 3],
    /// The other, m.
    pub side_v_m: [f64; 3],
}

/// A real box that stands upright, in the grid's frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhantomBox {
    /// Its middle, m.
    pub centre_m: [f64; 3],
    /// Its sides along x, y and z before it is turned, m.
    pub size_m: [f64; 3],
    /// Turn about z.
    #[serde(default)]
    pub rotation_deg: f64,
}

settings! {
    /// The fixed camera of a live scene that looks at the ball, or with a fisheye lens to where light comes from.
    EnvironmentCamera {
        /// Folder of pictures, video file, or `camera:N`, relative to the settings.
        frames: PathBuf = "environment".into(),
        /// Focal length, px; of a fisheye lens px per rad.
        focal_px: f64 = 0.0,
        /// Principal point, px; without it the middle.
        principal_point_px: Option<[f64; 2]> = None,
        /// k1, k2, p1, p2, k3 (not of a fisheye lens).
        distortion: [f64; 5] = [0.0; 5],
        /// Where it is, grid frame, m.
        position_m: [f64; 3] = [0.0; 3],
        /// A point that it looks at, grid frame, m.
        target_m: [f64; 3] = [0.0, 0.0, 1.0],
        /// What is up in its picture, grid frame.
        up: [f64; 3] = [0.0, 1.0, 0.0],
        /// Field of view of a fisheye lens.
        field_deg: f64 = 180.0,
    }
}

settings! {
    /// A film, or a camera, into which the object is put frame by frame (`insitu live`).
    Live {
        /// Which cameras there are.
        setup: Setup = Setup::OneCamera,
        /// Frames of the scene: folder of pictures, video file, or `camera:N`, relative to the settings.
        frames: PathBuf = "frames".into(),
        /// The second camera.
        environment: Option<EnvironmentCamera> = None,
        /// Folder for the frames and `live.avi`, relative to the settings.
        output: PathBuf = "live".into(),
        /// Frames a second, where the source does not say.
        frames_per_second: f64 = 25.0,
        /// Stop after so many frames, 0 for never.
        most_frames: usize = 0,
        /// Focal length, px.
        focal_px: f64 = 0.0,
        /// Principal point, px; without it the middle.
        principal_point_px: Option<[f64; 2]> = None,
        /// k1, k2, p1, p2, k3.
        distortion: [f64; 5] = [0.0; 5],
        /// Camera response (`response.json`), relative to the settings; without it sRGB.
        response: Option<PathBuf> = None,
        /// OpenCV's dictionary of markers: 4x4_50, 5x5_100, aruco_original, apriltag_36h11 …
        dictionary: String = "4x4_50".into(),
        /// A board of markers.
        board: Option<MarkerBoard> = None,
        /// Markers one by one.
        markers: Vec<PlacedMarker> = Vec::new(),
        /// Reflectance of the markers' paper.
        paper: [f32; 3] = [0.8; 3],
        /// Frames for which the last pose is held when no marker is seen …
        hold_frames: usize = 8,
        /// … and in which the object then fades.
        fade_frames: usize = 12,
        /// Middle of the mirror ball, grid frame, m.
        ball_centre_m: [f64; 3] = [0.0; 3],
        /// How far what shines is from the ball, about, m; 0: at infinity, as in the paper.
        environment_distance_m: f32 = 0.0,
        /// Flat parts of the scene that receive the shadow and hide the object.
        planes: Vec<PhantomPlane> = Vec::new(),
        /// Boxes that do.
        boxes: Vec<PhantomBox> = Vec::new(),
        /// Scene model (`scene.json`) whose faces do, relative to the settings.
        scene: Option<PathBuf> = None,
        /// Only the strongest lights cast shadows, so many of them.
        most_lights: Option<usize> = None,
        /// Shadow maps drawn in a frame, 0 for all.
        maps_per_frame: usize = 16,
    }
}

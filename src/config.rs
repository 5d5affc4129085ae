//! `pipeline.toml`: one table a stage, every key with its unit in its name and a default that works.

mod ranges;
mod read;
mod text;

use crate::maps::Layout;
use crate::probe::fisheye::Projection;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;
pub use text::{parse, refuse_wild_numbers};

macro_rules! settings {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident : $type:ty = $default:expr,)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct $name { $($(#[$field_doc])* pub $field: $type,)* }
        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }
    };
}

mod live;
mod render;

pub use live::*;
pub use render::*;

settings! {
    /// The whole file.
    Pipeline {
        /// Another settings file, relative to this one, whose values hold where this one is silent.
        extends: Option<PathBuf> = None,
        /// Folder that receives one folder a stage, relative to this file.
        work: PathBuf = "work".into(),
        /// What a person marked in the photographs, relative to this file.
        annotations: PathBuf = "annotations.toml".into(),
        /// `[ingest]`
        ingest: Ingest = Ingest::default(),
        /// `[response]`
        response: Response = Response::default(),
        /// `[merge]`
        merge: Merge = Merge::default(),
        /// `[calibrate]`
        calibrate: Calibrate = Calibrate::default(),
        /// `[probe]`
        probe: Probe = Probe::default(),
        /// `[model]`
        model: Model = Model::default(),
        /// `[illuminate]`
        illuminate: Illuminate = Illuminate::default(),
        /// `[irradiance]`
        irradiance: Irradiance = Irradiance::default(),
        /// `[transfer]`
        transfer: Transfer = Transfer::default(),
        /// `[render]`
        render: Render = Render::default(),
        /// `[composite]`
        composite: Composite = Composite::default(),
        /// `[evaluate]`
        evaluate: Evaluate = Evaluate::default(),
        /// `[live]`
        live: Live = Live::default(),
    }
}

/// What a photograph is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// The photograph to augment. The first one is used.
    Plate,
    /// Exposures of the plate's view, from the same place.
    Brackets,
    /// The printed grid, photographed from exactly where the plate was.
    PlateWithGrid,
    /// Exposures of the mirror ball (and the grid), close up.
    Probe,
    /// The printed grid from many sides, for inner orientation.
    Grid,
    /// A surface of even brightness, for the vignetting of the lens.
    Flat,
    /// Frames of a film.
    Frames,
}

settings! {
    /// Which photographs there are and how they were exposed.
    Ingest {
        /// Folder of the photographs, relative to this file.
        photos: PathBuf = "photos".into(),
        /// For each role the file names; `*` stands for any characters.
        roles: BTreeMap<Role, Vec<String>> = BTreeMap::new(),
        /// Exposure of files without EXIF, or to be used instead of it.
        exposure: Vec<ExposureOverride> = Vec::new(),
        /// Width of the sensor, mm; with the EXIF focal length it gives a first focal length in pixels.
        sensor_width_mm: Option<f64> = None,
        /// Focal length, mm, where EXIF has none.
        focal_mm: Option<f64> = None,
    }
}

/// Exposure of some files. `time_s` alone means that aperture and ISO did not change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExposureOverride {
    /// File name; `*` stands for any characters.
    pub file: String,
    /// Exposure time, s.
    #[serde(default)]
    pub time_s: Option<f64>,
    /// f-number.
    #[serde(default)]
    pub f_number: Option<f64>,
    /// ISO speed.
    #[serde(default)]
    pub iso: Option<f64>,
}

settings! {
    /// Camera response curve.
    Response {
        /// Which exposures to fit on.
        role: Role = Role::Brackets,
        /// How it is fitted.
        method: ResponseMethod = ResponseMethod::Auto,
        /// Response of another set of the same camera with the same settings (`response/response.json`), to be used in the
        /// place of a fit.
        file: Option<PathBuf> = None,
        /// Whether exposures that the pixels contradict are replaced by what the pixels say.
        exposures_from_pixels: bool = true,
        /// Sample positions in each channel.
        samples: usize = 1000,
        /// Weight λ of the squared second differences of ln exposure, where the samples' mean weight is 1 a level.
        smoothness: f64 = 1000.0,
        /// Vignetting a, b, c of 1 + a r² + b r⁴ + c r⁶, r in half diagonals; zeros for none or that of role `flat`.
        vignetting: [f64; 3] = [0.0; 3],
        /// Where neither coefficients nor a flat field are given: estimate it from the paper of the photographs of role `grid`.
        estimate_vignetting: bool = false,
        /// Seed of the order in which equally good sample positions are taken, and of the band.
        seed: u64 = 0,
    }
}

/// How the response is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ResponseMethod {
    /// The one that leaves the least residual on places left out.
    Auto,
    /// Least squares over a free value at each level (Debevec and Malik 1997).
    DebevecMalik,
    /// A polynomial (Mitsunaga and Nayar 1999).
    MitsunagaNayar,
    /// Means of exposure at each level in turn with radiance (Robertson, Borman and Stevenson 2003).
    Robertson,
}

impl ResponseMethod {
    /// Those that `auto` tries, the one that is taken in doubt first.
    pub const ALL: [Self; 3] = [Self::DebevecMalik, Self::MitsunagaNayar, Self::Robertson];
}

settings! {
    /// Exposures to linear radiance.
    Merge {
        /// Full-well capacity, electrons; sets the photon noise. 0: estimated from the exposures.
        full_well_electrons: f64 = 0.0,
        /// Read noise, electrons, where the full-well capacity is given.
        read_noise_electrons: f64 = 5.0,
        /// Code values at or above this share of the largest are taken as clipped.
        clip: f32 = 0.985,
        /// Whether frames are brought over each other.
        align: bool = true,
        /// Whether what moved is left out of the frames in which it differs; of the plate alone.
        deghost: bool = true,
    }
}

settings! {
    /// The printed grid and how cameras are found.
    Calibrate {
        /// What the printed grid is.
        grid: Grid = Grid::Chessboard,
        /// Inner corners along the long and the short side.
        inner_corners: [u32; 2] = [7, 5],
        /// Side of a square, m.
        square_m: f64 = 0.06,
        /// Height of the printed face above the surface it lies on, m.
        thickness_m: f64 = 0.002,
        /// Which corner of the grid carries the black disc that tells it from itself turned by 180°; `none` if there
        /// is no disc.
        disc: Disc = Disc::NegXNegY,
        /// Cameras of another program, relative to this file: a folder with a model of COLMAP, or a project of fSpy.
        import: Option<PathBuf> = None,
        /// Where the pose of the plate comes from.
        pose: PoseSource = PoseSource::Both,
        /// Accuracy of marked vanishing lines, px.
        mark_sigma_px: f64 = 0.5,
        /// Whether marked lines along three directions tell the principal point, where no grid does.
        solve_principal_point: bool = false,
        /// Whether marked lines tell radial distortion, where no grid does.
        plumb_lines: bool = false,
        /// Accuracy of the focal length that EXIF or settings state, as a share of it, where it is combined with that
        /// from vanishing lines.
        stated_focal_sigma: f64 = 0.04,
        /// Height of the camera over the floor, m, for a photograph without grid in which neither origin nor scale is
        /// marked: the origin is on the floor then, where the middle of the lower half of the picture looks. 0: unknown.
        camera_height_m: f64 = 0.0,
        /// Whether the marks of the scene's primitives take part in finding the cameras.
        joint: bool = true,
        /// Refuse a calibration whose grid corners reproject worse than this, px.
        max_rms_px: f64 = 1.0,
    }
}

/// What the printed grid is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Grid {
    /// A chessboard, told from itself turned by its disc.
    Chessboard,
    /// A chessboard with markers in its white squares (ChArUco).
    Charuco(CharucoGrid),
    /// Markers in rows (an ArUco board).
    Aruco(ArucoGrid),
}

/// The markers of a ChArUco board, in its white squares from the top left on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CharucoGrid {
    /// OpenCV's dictionary of markers.
    pub dictionary: String,
    /// Side of a marker, m.
    pub marker_m: f64,
    /// Number of the first one.
    #[serde(default)]
    pub first_id: u32,
}

/// A board of markers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArucoGrid {
    /// OpenCV's dictionary of markers.
    pub dictionary: String,
    /// Its markers.
    pub board: MarkerBoard,
}

/// Corner of the grid that carries the disc, in the grid's own frame (x along the long side).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Disc {
    /// At −x, −y.
    NegXNegY,
    /// At +x, +y.
    PosXPosY,
    /// There is none.
    None,
}

/// Where the plate's pose comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseSource {
    /// The grid, refined by marked vanishing lines where there are any.
    Both,
    /// The grid alone.
    Grid,
    /// Vanishing lines, marked or found, origin and scale alone (tutorial §3).
    VanishingLines,
}

/// Where the probe's photographs were taken from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ProbeCamera {
    /// From anywhere: they show the printed grid.
    Grid,
    /// From the plate's place.
    Plate,
    /// Said by the settings: they are crops whose sides the ball touches.
    Crop,
}

/// What shows the environment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProbeSource {
    /// A mirror ball.
    #[default]
    Ball,
    /// A fisheye lens.
    Fisheye,
    /// A ready map of all directions.
    Map,
}

settings! {
    /// Photographs of the ball from one side.
    ProbeView {
        /// Which of the photographs of role `probe`; `*` stands for any characters.
        files: String = "*".into(),
        /// Of a crop: where its camera stood, as `azimuth_deg` and `elevation_deg` of `[probe]`.
        azimuth_deg: f64 = 0.0,
        /// See there.
        elevation_deg: f64 = 30.0,
    }
}

settings! {
    /// The mirror ball, or what else shows the environment.
    Probe {
        /// What shows it.
        source: ProbeSource = ProbeSource::Ball,
        /// Where its photographs were taken from.
        camera: ProbeCamera = ProbeCamera::Grid,
        /// Radius of the ball, m.
        radius_m: f64 = 0.1,
        /// Share of light that the ball reflects, per channel.
        reflectivity: [f64; 3] = [0.9; 3],
        /// Height of the surface that the ball stands on, in the world, m; without it the surface under the grid.
        support_m: Option<f64> = None,
        /// Width of the environment map, px; its height is half of that.
        width_px: usize = 512,
        /// The ball from several sides; without any, all photographs are one view.
        views: Vec<ProbeView> = Vec::new(),
        /// Each view shows who took it within this angle around its camera; others fill that.
        photographer_deg: f64 = 12.0,
        /// Turn crops of further views until they show what the first shows.
        turn_views: bool = true,
        /// Where the middle of a cropped ball, a fisheye lens or the camera of a map stood, grid frame, m.
        position_m: [f64; 3] = [0.0, 0.0, 0.1],
        /// Where a crop's camera stood as seen from the ball, where a fisheye lens looked, or what the middle of a map shows:
        /// azimuth from the grid's +x towards its +y …
        azimuth_deg: f64 = 0.0,
        /// … and elevation above the grid.
        elevation_deg: f64 = 30.0,
        /// From a crop's camera to the middle of the ball, m.
        distance_m: f64 = 1.0,
        /// Layout of a map.
        layout: Layout = Layout::Latlong,
        /// Projection of a fisheye lens.
        projection: Projection = Projection::Equidistant,
        /// Its focal length, px per radian in the middle.
        focal_px: f64 = 0.0,
        /// Its principal point, px; without it the middle.
        principal_point_px: Option<[f64; 2]> = None,
        /// Its field of view.
        field_deg: f64 = 180.0,
    }
}

settings! {
    /// Fitting primitives to marks.
    Model {
        /// Accuracy of marks, px.
        mark_sigma_px: f64 = 1.0,
        /// Refuse a fit whose marks are further off than this, rms in px.
        max_rms_px: f64 = 5.0,
        /// Height of a searched room of whose ceiling nothing is seen, m.
        presumed_height_m: f64 = 2.6,
        /// Distance of the camera from its walls of which nothing is seen, m.
        presumed_wall_m: f64 = 1.5,
    }
}

settings! {
    /// Light on the model's surfaces.
    Illuminate {
        /// Longest edge of a patch, m.
        max_edge_m: f64 = 0.25,
        /// Shortest edge that refinement may make, m.
        min_edge_m: f64 = 0.05,
        /// A patch is split while it sends more than this share of all power.
        max_power_share: f64 = 0.002,
        /// Reflectance of surfaces seen in neither probe nor plate.
        unseen_reflectance: f32 = 0.5,
        /// Number of cells into which light from beyond the model is cut.
        distant_sources: usize = 128,
    }
}

settings! {
    /// Spherical-harmonic irradiance volume.
    Irradiance {
        /// Distance of grid points, m.
        spacing_m: f64 = 0.25,
        /// Half the side of the region around the grid that is covered, m; cut to the room.
        reach_m: f64 = 2.0,
        /// Rays per grid point.
        rays: usize = 4096,
    }
}

/// What makes a source strong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SourceOrder {
    /// What it sends to the receivers, by which faint light near by counts and light that no receiver sees does not.
    Received,
    /// What it sends anywhere: radiance × area (gibson §4), distant light with the area of the receivers.
    Power,
}

settings! {
    /// Radiance transfers (gibson §5).
    Transfer {
        /// Share of the light that the source set holds, on average over the places that the plate shows; 0.7 is the paper's.
        source_share: f64 = 0.7,
        /// Visibility rays for each pair of source and receiver vertex.
        rays: usize = 8,
        /// Sources are stored as one where their average shares misattribute at most this share of a vertex's irradiance.
        link_tolerance: f64 = 0.002,
        /// By what the strongest sources are found.
        order: SourceOrder = SourceOrder::Received,
        /// Receiver patches in a leaf of their octree.
        leaf_patches: usize = 8,
        /// Shafts end where less than this share of the irradiance of every receiver vertex passes.
        shaft_share: f64 = 0.02,
        /// Receivers are split until transfers differ from what their vertices say by no more than this share of the
        /// irradiance, root mean square over the plate's pixels; 0 leaves them as they are.
        receiver_tolerance: f64 = 0.015,
        /// Receivers are not split beyond so many vertices.
        receiver_vertices: usize = 10_000,
    }
}

settings! {
    /// The augmented photograph.
    Composite {
        /// Exposure of the displayed picture, stops, where the plate is linear; otherwise its own response makes it.
        exposure_ev: f32 = 0.0,
    }
}

settings! {
    /// Judging against a reference.
    Evaluate {
        /// True linear image with the object (EXR), relative to this file.
        reference: Option<PathBuf> = None,
        /// True linear image without it (EXR).
        reference_empty: Option<PathBuf> = None,
        /// Coverage of the object in the reference (PNG).
        reference_mask: Option<PathBuf> = None,
        /// True cameras, response and radiance of the capture (`truth.json`), to judge each stage.
        truth: Option<PathBuf> = None,
        /// Bounds that `insitu validate` holds the errors to.
        bounds: BTreeMap<String, f64> = BTreeMap::new(),
    }
}

//! What can be wrong with a calibration.

use crate::{least_squares, vision};

/// Why lens or pose cannot be found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// No grid.
    #[error("no grid of {}×{} inner corners is seen, whole or in part", inner[0], inner[1])]
    GridNotFound {
        /// Corners looked for.
        inner: [u32; 2],
    },
    /// The disc's place is outside the picture.
    #[error("the margin with the disc is outside the picture, so that the grid could be turned by 180°")]
    DiscOutside,
    /// Both corners look alike.
    #[error(
        "neither corner of the grid shows the disc (darkness {:.2} and {:.2}), so that it could be turned by 180°",
        darkness[0], darkness[1]
    )]
    DiscUnclear {
        /// Relative darkness at both places.
        darkness: [f64; 2],
    },
    /// Too few grid photographs.
    #[error("the grid is found in {found} photographs, 3 are needed for the lens")]
    FewGrids {
        /// How many.
        found: usize,
    },
    /// The boards' poses do not tell the lens.
    #[error(
        "the photographs of the grid are too much alike to tell the lens from its poses (condition number {condition:.0}, at most \
         {limit:.0} is allowed)"
    )]
    PosesAlike {
        /// By how many times the poses make the focal length worse known.
        condition: f64,
        /// Largest acceptable.
        limit: f64,
    },
    /// A grid of markers that cannot be.
    #[error("`calibrate.grid` has {what}")]
    NotAGrid {
        /// What is wrong.
        what: String,
    },
    /// Hardly anything of a grid of markers is seen.
    #[error("{found} of the grid's {of} corners are seen, {needed} are needed")]
    FewCorners {
        /// Corners seen.
        found: usize,
        /// Corners there are.
        of: usize,
        /// Corners needed.
        needed: usize,
    },
    /// The focal length is not determined.
    #[error("the focal length is known to {:.1} % only (limit {:.0} %)", 100.0 * relative, 100.0 * limit)]
    FocalUncertain {
        /// σ / f.
        relative: f64,
        /// Largest acceptable.
        limit: f64,
    },
    /// The vanishing points leave the focal length open.
    #[error(
        "these vanishing points alone do not fix the focal length: it is known to {:.0} %, and a degree between their \
         directions changes it by {:.0} % (condition number {condition:.1})",
        100.0 * relative, 100.0 * condition.to_radians()
    )]
    FocalOpen {
        /// σ / f.
        relative: f64,
        /// Relative change by a departure from right angles, 1/rad.
        condition: f64,
    },
    /// The vanishing points leave the principal point open.
    #[error(
        "these vanishing points alone do not fix the principal point: it is known to {sigma_px:.0} px only (limit {limit_px:.0} px)"
    )]
    CentreOpen {
        /// Its standard deviation.
        sigma_px: f64,
        /// Largest acceptable.
        limit_px: f64,
    },
    /// No room is seen.
    #[error(
        "of {found} line segments in the photograph {used} agree with three directions at right angles, too few to tell from chance"
    )]
    NoRoom {
        /// Segments found.
        found: usize,
        /// Those that agree.
        used: usize,
    },
    /// Nothing tells the focal length.
    #[error("nothing tells the focal length: no photographs of role `grid`, no vanishing lines, no EXIF")]
    NoFocal,
    /// Reprojection too bad.
    #[error("the grid's corners are {rms_px:.2} px off (rms), the limit is {limit_px:.2} px")]
    Reprojection {
        /// What it is.
        rms_px: f64,
        /// `calibrate.max_rms_px`.
        limit_px: f64,
    },
    /// The plate's view has no grid.
    #[error("no photograph from the plate's place shows the grid")]
    NoGridInPlate,
    /// No solution in front of the camera.
    #[error("no pose puts the grid in front of the camera")]
    NoPose,
    /// Too few edges.
    #[error("{found} edges are marked along a direction, 2 are needed for its vanishing point")]
    FewEdges {
        /// How many.
        found: usize,
    },
    /// Not enough finite vanishing points.
    #[error(
        "of {marked} marked directions {finite} have a vanishing point at a finite distance, 2 are needed for the focal \
         length: the others are parallel in the picture"
    )]
    FewVanishingPoints {
        /// How many are finite.
        finite: usize,
        /// How many directions are marked.
        marked: usize,
    },
    /// Directions that cannot be orthogonal.
    #[error("the marked directions cannot be orthogonal: f² = {f2_px2:.0} px²")]
    NegativeFocal {
        /// −v · v′.
        f2_px2: f64,
    },
    /// Lines that do not meet.
    #[error(
        "the marked lines miss their vanishing points by {rms_px:.1} px (rms), the limit is {limit_px:.1} px"
    )]
    EdgesDisagree {
        /// What it is.
        rms_px: f64,
        /// Largest acceptable.
        limit_px: f64,
    },
    /// A pose from lines without origin or scale.
    #[error("a pose from vanishing lines alone needs the marks `origin` and `scale`, or the camera's height")]
    NoOriginOrScale,
    /// The origin is sought above the horizon.
    #[error("the middle of the picture's lower half looks at no floor: it is above the horizon")]
    NoFloor,
    /// Marks of the known length that make no sense.
    #[error(
        "the marked length is {relative_length:.3} times the origin's depth; it or the origin is above the horizon"
    )]
    ScaleMarks {
        /// Length with the origin at depth 1.
        relative_length: f64,
    },
    /// Another program's cameras lack the plate.
    #[error("there is no camera of {plate} among them")]
    NotImported {
        /// File name of the plate.
        plate: String,
    },
    /// Another program saw a picture of another size.
    #[error(
        "the camera of {plate} is one of {}×{} px, the photograph has {}×{} px", theirs_px[0], theirs_px[1], plate_px[0], plate_px[1]
    )]
    OtherSize {
        /// File name of the plate.
        plate: String,
        /// Size of the plate.
        plate_px: [u32; 2],
        /// Size that the camera has.
        theirs_px: [u32; 2],
    },
    /// The lines are marked elsewhere.
    #[error("the vanishing lines are marked in {image}, which was not taken from the plate's place")]
    OtherImage {
        /// Where they are.
        image: String,
    },
    /// The fit failed.
    #[error(transparent)]
    Fit(#[from] least_squares::Problem),
    /// OpenCV failed.
    #[error(transparent)]
    Vision(#[from] vision::Problem),
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::GridNotFound { .. } => {
                "show more of the grid, sharp and larger, and check `calibrate.inner_corners`".into()
            }
            Self::DiscOutside | Self::DiscUnclear { .. } => {
                "show the grid with its margin, or set `calibrate.disc = \"none\"`".into()
            }
            Self::FewGrids { .. } => "photograph the grid from at least 3, better 10, sides".into(),
            Self::PosesAlike { .. } => {
                "photograph the grid tilted by 30° and more to several sides, near and far, in all parts of the picture".into()
            }
            Self::NotAGrid { .. } => "measure the printed grid again, in metres".into(),
            Self::FewCorners { .. } => {
                "show more of the grid, sharp and larger, and check dictionary, counts and `first_id` of `calibrate.grid`".into()
            }
            Self::FocalOpen { .. } => {
                "state the focal length (EXIF, or `ingest.focal_mm` and `ingest.sensor_width_mm`), or use a photograph that \
                 shows two directions in perspective"
                    .into()
            }
            Self::CentreOpen { .. } => {
                "mark edges along three directions that are all seen in perspective, or take the principal point as central \
                 (`calibrate.solve_principal_point = false`)"
                    .into()
            }
            Self::NoRoom { .. } => {
                "mark edges along the room's directions under [vanishing_lines], or photograph the grid".into()
            }
            Self::FocalUncertain { .. } => {
                "photograph the grid tilted to several sides, or mark longer lines along more directions".into()
            }
            Self::NoFocal => {
                "give photographs of the grid the role `grid`, or set `ingest.focal_mm` and `ingest.sensor_width_mm`"
                    .into()
            }
            Self::Reprojection { .. } => {
                "lay the grid on something flat, use sharp photographs, check `calibrate.inner_corners`".into()
            }
            Self::NoGridInPlate | Self::NoPose => {
                "give a photograph of the grid from the plate's place the role `plate_with_grid`, or mark vanishing \
                 lines with origin and scale"
                    .into()
            }
            Self::FewEdges { .. } => "mark at least two edges along each direction".into(),
            Self::FewVanishingPoints { .. } => {
                "use a photograph that shows two directions in perspective, or give grid photographs".into()
            }
            Self::NegativeFocal { .. } | Self::EdgesDisagree { .. } => {
                "check which edges are marked as x, y and z: they must be at right angles in the room".into()
            }
            Self::NoOriginOrScale => {
                "mark `origin` and `scale` under [vanishing_lines], or set `calibrate.camera_height_m`".into()
            }
            Self::NoFloor => "mark `origin` and `scale` under [vanishing_lines]".into(),
            Self::ScaleMarks { .. } => "mark the length from a point on the floor, along its axis".into(),
            Self::NotImported { .. } => "let the other program see the plate, too, under its file name".into(),
            Self::OtherSize { .. } => "give the other program the photograph as it is here, neither cropped nor scaled".into(),
            Self::OtherImage { .. } => "mark them in the plate".into(),
            Self::Fit(e) => e.hint(),
            Self::Vision(e) => e.hint(),
        }
    }
}

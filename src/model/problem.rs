//! What can be wrong with a scene model.

use crate::least_squares;

/// Why no scene can be made of the marks.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// Nothing to build.
    #[error("no primitive is given")]
    Empty,
    /// Two of one name.
    #[error("two primitives are called `{name}`")]
    Duplicate {
        /// The name.
        name: String,
    },
    /// A lobe that no surface has.
    #[error("`{name}` has a gloss of specular {specular:?}, shininess {shininess}")]
    Gloss {
        /// The primitive.
        name: String,
        /// Specular reflectance.
        specular: [f32; 3],
        /// Phong exponent.
        shininess: f32,
    },
    /// The parent is not there, or cannot carry anything.
    #[error("`{name}` has the parent `{parent}`, which {why}")]
    Parent {
        /// The child.
        name: String,
        /// The parent.
        parent: String,
        /// What is wrong with it.
        why: &'static str,
    },
    /// Parents in a circle.
    #[error("`{name}` is, by way of its parents, its own parent")]
    Cycle {
        /// One of the circle.
        name: String,
    },
    /// The parent has no such face.
    #[error("`{name}` is attached to `{attach}`, which its parent does not have")]
    Attach {
        /// The child.
        name: String,
        /// What it is attached to.
        attach: String,
    },
    /// A size that cannot be.
    #[error("`{name}` has the {what} {value} m")]
    Size {
        /// The primitive.
        name: String,
        /// Which extent.
        what: &'static str,
        /// Given or fitted, m.
        value: f64,
    },
    /// `size_m` of another length.
    #[error("`{name}` gives {given} sizes, its kind has {expected}")]
    SizeCount {
        /// The primitive.
        name: String,
        /// Entries of `size_m`.
        given: usize,
        /// What its kind has.
        expected: usize,
    },
    /// A corner that the primitive does not have.
    #[error("`{name}` has no corner `{corner}`")]
    Corner {
        /// The primitive.
        name: String,
        /// As marked.
        corner: String,
    },
    /// A mark in a photograph without a pose.
    #[error("corner `{corner}` of `{name}` is marked in {image}, whose pose is not known")]
    Image {
        /// The primitive.
        name: String,
        /// The corner.
        corner: String,
        /// The photograph.
        image: String,
    },
    /// A reflection marked beside the ball.
    #[error(
        "corner `{corner}` of `{name}` is marked as a reflection at {at:?} in {image}, where there is no ball"
    )]
    NoReflection {
        /// The primitive.
        name: String,
        /// The corner.
        corner: String,
        /// The photograph.
        image: String,
        /// The mark, px.
        at: [f64; 2],
    },
    /// The marks put a corner behind the camera.
    #[error("corner `{corner}` of `{name}` would be behind the camera of {image}")]
    Behind {
        /// The primitive.
        name: String,
        /// The corner.
        corner: String,
        /// The photograph.
        image: String,
    },
    /// The marks do not agree.
    #[error(
        "the marks contradict each other by {rms_px:.1} px (rms, limit {limit_px:.1} px); the worst is corner `{corner}` of \
         `{name}` in {image}, {worst_px:.1} px off"
    )]
    Contradiction {
        /// Over all marks.
        rms_px: f64,
        /// `model.max_rms_px`.
        limit_px: f64,
        /// Primitive of the worst mark.
        name: String,
        /// Its corner.
        corner: String,
        /// Its photograph.
        image: String,
        /// Its distance.
        worst_px: f64,
    },
    /// A polygon with a dent.
    #[error("the polygon `{name}` is not convex, or its corners are not numbered around it")]
    NotConvex {
        /// The primitive.
        name: String,
    },
    /// The fit failed.
    #[error(transparent)]
    Fit(#[from] least_squares::Problem),
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::Empty => "add at least one [[primitive]] to annotations.toml, e.g. a `ground`".into(),
            Self::Gloss { .. } => "give reflectances from 0 to 1 and a shininess from 0 to 1e6".into(),
            Self::Duplicate { .. } => "give each primitive a name of its own".into(),
            Self::Parent { .. } => "name a room, ground or box as the parent, or leave it out".into(),
            Self::Cycle { .. } => "let one of them stand on the surface under the grid: leave out its `parent`".into(),
            Self::Attach { .. } => {
                "boxes stand on `top` or `base`; quads and polygons lie on `top`, `base`, `left`, `right`, `front`, \
                 `back`, `ceiling`"
                    .into()
            }
            Self::Size { .. } => "check its marks, or give its size_m".into(),
            Self::SizeCount { .. } => "give width, height, depth; 0 for what is to be fitted".into(),
            Self::Corner { .. } => {
                "corners of boxes are like `-+-` (x, y up, z), of quads `-+`, of polygons `0`, `1`, …".into()
            }
            Self::Image { .. } => "mark photographs of the plate's place, or of the probe".into(),
            Self::NoReflection { .. } => "mark it within the ball's outline in a photograph of the probe".into(),
            Self::Behind { .. } => "check that the corner is what was marked, and that its parent is right".into(),
            Self::Contradiction { .. } => "check this mark first; or set `lift` or `yaw` to \"free\"".into(),
            Self::NotConvex { .. } => "number its corners around it, and cut it into convex polygons".into(),
            Self::Fit(e) => e.hint(),
        }
    }
}

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
    /// What it refers to is not there, or cannot serve.
    #[error("`{name}` has the {what} `{other}`, which {why}")]
    Reference {
        /// The primitive.
        name: String,
        /// Which field.
        what: &'static str,
        /// What it names.
        other: String,
        /// What is wrong with it.
        why: &'static str,
    },
    /// Only some kinds lean.
    #[error("`{name}` leans, which only boxes and quads can")]
    Leaning {
        /// The primitive.
        name: String,
    },
    /// Only rooms are searched.
    #[error("`{name}` is to be searched, which only a room without a parent can be")]
    Search {
        /// The primitive.
        name: String,
    },
    /// A room is not found in the plate.
    #[error("`{name}` is not found in {image}: {problem}")]
    Room {
        /// The primitive.
        name: String,
        /// The plate.
        image: String,
        /// Why.
        problem: super::room::Problem,
    },
    /// A standard deviation that cannot be.
    #[error("the mark of corner `{corner}` of `{name}` has the sigma_px {value}")]
    Sigma {
        /// The primitive.
        name: String,
        /// The corner.
        corner: String,
        /// As given, px.
        value: f64,
    },
    /// References in a circle.
    #[error("`{name}` refers, by way of others, to itself")]
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
        what: String,
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
    /// No polygon.
    #[error("the outline of `{name}` crosses or touches itself, has no area, or has a hole outside")]
    Outline {
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
            Self::Reference { what: "parent", .. } => {
                "name what stands upright (room, ground, box, wedge, cylinder, extrusion) as the parent, or leave it out".into()
            }
            Self::Reference { .. } => "name a primitive of the file that can serve, or leave it out".into(),
            Self::Leaning { .. } => "leave out its leans_on, or make it a box or a quad".into(),
            Self::Search { .. } => "leave out its `search`, and mark its corners".into(),
            Self::Room { .. } => "mark its corners and edges, in the plate and in the ball, and leave out its `search`".into(),
            Self::Sigma { .. } => "give a standard deviation above 0, or leave it out".into(),
            Self::Cycle { .. } => "let one of them stand on the surface under the grid: leave out its `parent`".into(),
            Self::Attach { .. } => {
                "things stand on `top` or `base` and hang under `bottom` or a room's `ceiling`; quads and polygons lie on faces, boxes \
                 hang on `left`, `right`, `front`, `back`; leans_on names one of these four"
                    .into()
            }
            Self::Size { .. } => "check its marks, or give its size_m".into(),
            Self::SizeCount { .. } => "give width, height, depth; 0 for what is to be fitted".into(),
            Self::Corner { .. } => {
                "corners of boxes are like `-+-` (x, y up, z), of quads `-+`, of polygons `0`, `1`, …, of extrusions `0-` (below), \
                 `0+` (above), …, edges `---/+--`; a cylinder has `top`, `bottom`, `left`, `right`"
                    .into()
            }
            Self::Image { .. } => "mark photographs of the plate's place or of the probe, or in others four corners that are marked in the plate, too".into(),
            Self::NoReflection { .. } => "mark it within the ball's outline in a photograph of the probe".into(),
            Self::Behind { .. } => "check that the corner is what was marked, and that its parent is right".into(),
            Self::Contradiction { .. } => "check this mark first; or set `lift` or `yaw` to \"free\"".into(),
            Self::Outline { .. } => "number its corners around it, and name those of each hole in `holes`".into(),
            Self::Fit(e) => e.hint(),
        }
    }
}

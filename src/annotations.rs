//! `annotations.toml`: what a person marked in the photographs. Pixels are continuous, (0, 0) the outer corner of the
//! top-left pixel.

use crate::error::{FileContext, Result};
use crate::model::face::Gloss;
use crate::stage::{Context, Input};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The whole file.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Annotations {
    /// Edges along the room's directions.
    pub vanishing_lines: Option<VanishingLines>,
    /// The mirror ball.
    pub ball: Option<Ball>,
    /// What the scene is made of.
    pub primitive: Vec<Primitive>,
}

impl Annotations {
    /// What was marked for this pipeline; nothing if there is no such file.
    pub fn load(ctx: &Context) -> Result<Self> {
        let path = ctx.base.join(&ctx.pipeline.annotations);
        if !path.exists() {
            ctx.depends_on(&path, Input::Absent);
            return Ok(Self::default());
        }
        Self::read(&ctx.user_file(&ctx.pipeline.annotations)?)
    }

    /// Reads the file.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).at("reading the annotations", path)?;
        let annotations = crate::config::parse(&text, path)?;
        crate::config::refuse_wild_numbers(&text, path)?;
        Ok(annotations)
    }
}

/// Edges marked along three orthogonal directions of the room, `[x0, y0, x1, y1]` px; x and y horizontal, z up. The
/// marks of x run from its start to its end, where the direction matters (pose without a grid). Without any, edges are searched
/// if needed: z is the picture's vertical then, x points right, y away from the camera.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VanishingLines {
    /// Which photograph.
    pub image: String,
    /// Along x.
    #[serde(default)]
    pub x: Vec<[f64; 4]>,
    /// Along y.
    #[serde(default)]
    pub y: Vec<[f64; 4]>,
    /// Along z.
    #[serde(default)]
    pub z: Vec<[f64; 4]>,
    /// Where the world's origin is seen.
    #[serde(default)]
    pub origin: Option<[f64; 2]>,
    /// A known length.
    #[serde(default)]
    pub scale: Option<Scale>,
}

impl VanishingLines {
    /// Whether any edge is marked, not only origin and scale.
    pub fn has_edges(&self) -> bool {
        [&self.x, &self.y, &self.z].iter().any(|lines| !lines.is_empty())
    }
}

/// The outline of the mirror ball, where it is not to be searched: it need not stand on the surface under the grid then.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ball {
    /// Which photograph of the probe.
    pub image: String,
    /// Points on its outline, at least 5, spread around it, px.
    pub outline: Vec<[f64; 2]>,
}

/// A known length along an axis, starting on the plane z = 0 through the origin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scale {
    /// Start, px.
    pub from: [f64; 2],
    /// End, px.
    pub to: [f64; 2],
    /// Along which axis.
    pub axis: Axis,
    /// Length, m.
    pub length_m: f64,
}

/// A direction of the room.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axis {
    /// Horizontal.
    X,
    /// Horizontal.
    Y,
    /// Up.
    Z,
}

/// Shape of a primitive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A box seen from inside.
    Room,
    /// A horizontal square centred under the grid.
    Ground,
    /// A box seen from outside.
    Box,
    /// A box cut in two from the lower edge of its front to the upper edge of its back: a ramp, half a roof.
    Wedge,
    /// An upright cylinder, in the model a prism of 16 sides of the same section.
    Cylinder,
    /// An upright prism over an outline that may have dents.
    Extrusion,
    /// A rectangle on a face of its parent.
    Quad,
    /// A polygon on a face of its parent, which may have dents and holes.
    Polygon,
}

/// Turn of a primitive about the vertical.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Yaw {
    /// As its parent.
    #[default]
    Parent,
    /// To be fitted.
    Free,
}

/// A horizontal axis of a primitive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Across {
    /// Along its width.
    X,
    /// Along its depth.
    Z,
}

/// A primitive that is another one's mirror image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mirror {
    /// The other one.
    pub of: String,
    /// The plane stands upright in the middle of this primitive …
    pub about: String,
    /// … across this axis of it.
    pub across: Across,
}

/// Height of a primitive over what supports it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Lift {
    /// It rests there.
    #[default]
    None,
    /// To be fitted.
    Free,
}

fn top() -> String {
    "top".into()
}

fn twenty() -> f64 {
    20.0
}

/// A primitive and its marks. What the fields say of contact, alignment and equality holds exactly: it is how the primitive is
/// parametrised; marks are met as well as they can be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Primitive {
    /// Name, unique.
    pub name: String,
    /// Shape.
    pub kind: Kind,
    /// What it stands on, hangs under, leans against or lies on; without it the surface under the grid.
    #[serde(default)]
    pub parent: Option<String>,
    /// `top`: on the parent's top (in a room: its floor); `base`: on the same surface as the parent; `bottom` or `ceiling`: hanging
    /// under the parent; `left`, `right`, `front`, `back`: a quad or polygon lies on that face, a box or wedge hangs there with its
    /// back; `slope` of a wedge and `0`, `1`, … of an extrusion carry quads and polygons.
    #[serde(default = "top")]
    pub attach: String,
    /// A face of the parent against which the upper edge of its back leans (a box) or its own upper edge (a quad).
    #[serde(default)]
    pub leans_on: Option<String>,
    /// Height of what a primitive without a parent stands or lies on, over the surface under the grid, m.
    #[serde(default)]
    pub level_m: f64,
    /// Turn about the vertical.
    #[serde(default)]
    pub yaw: Yaw,
    /// It runs parallel to that one instead of to its parent.
    #[serde(default)]
    pub parallel_to: Option<String>,
    /// Known turn besides, counter-clockwise seen from above, degrees.
    #[serde(default)]
    pub turn_deg: f64,
    /// Height over the support, or depth under what it hangs from.
    #[serde(default)]
    pub lift: Lift,
    /// Width, height, depth of a box, room or wedge; diameter, height of a cylinder; height of an extrusion; width, height of a
    /// quad; m. What is above 0 is known, 0 is fitted.
    #[serde(default)]
    pub size_m: Vec<f64>,
    /// It is as large as that one, of the same kind.
    #[serde(default)]
    pub same_size: Option<String>,
    /// It is the mirror image of another one, of the same kind.
    #[serde(default)]
    pub mirror: Option<Mirror>,
    /// Corners around each hole of a polygon.
    #[serde(default)]
    pub holes: Vec<Vec<usize>>,
    /// What its faces mirror besides their diffuse reflectance.
    #[serde(default)]
    pub gloss: Option<Gloss>,
    /// Half the side of a ground, m.
    #[serde(default = "twenty")]
    pub extent_m: f64,
    /// Search the edges of this room in the plate; marks say what is not seen there.
    #[serde(default)]
    pub search: bool,
    /// Where its corners are seen.
    #[serde(default)]
    pub marks: Vec<Mark>,
}

impl Primitive {
    /// Names of others on which its place or size depends.
    pub fn references(&self) -> Vec<&String> {
        let mirror = self.mirror.iter().flat_map(|m| [&m.of, &m.about]);
        let others = [&self.parent, &self.parallel_to, &self.same_size];
        others.into_iter().flatten().chain(mirror).collect()
    }
}

/// A corner seen in a photograph.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mark {
    /// `-+-`: signs of x, y (up), z of a corner of a box, room or wedge; `-+`: of a quad's; `0`, `1`, …: of a polygon's; `0-`,
    /// `0+`, …: of an extrusion's bottom and top. Of a cylinder `top` or `bottom`: a place on that rim, and `left` or `right`: on
    /// its side as seen. `---/+--`: a place on the line through two corners.
    pub corner: String,
    /// Which photograph.
    pub image: String,
    /// Where, px.
    pub at: [f64; 2],
    /// Standard deviation of the mark, px; `model.mark_sigma_px` unless given.
    #[serde(default)]
    pub sigma_px: Option<f64>,
    /// It was marked in its mirror image on the ball of the probe.
    #[serde(default)]
    pub reflection: bool,
}

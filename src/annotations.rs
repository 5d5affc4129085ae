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
    /// A rectangle on a face of its parent.
    Quad,
    /// A convex polygon on a face of its parent.
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

/// A primitive and its marks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Primitive {
    /// Name, unique.
    pub name: String,
    /// Shape.
    pub kind: Kind,
    /// What it stands on or lies on; without it the surface under the grid.
    #[serde(default)]
    pub parent: Option<String>,
    /// `top`: on the parent's top (in a room: its floor); `base`: on the same surface as the parent; for quads and
    /// polygons also a face of the parent.
    #[serde(default = "top")]
    pub attach: String,
    /// Height of what a primitive without a parent stands or lies on, over the surface under the grid, m.
    #[serde(default)]
    pub level_m: f64,
    /// Turn about the vertical.
    #[serde(default)]
    pub yaw: Yaw,
    /// Height over the support.
    #[serde(default)]
    pub lift: Lift,
    /// Width, height, depth of a box or room; width, height of a quad; m. What is above 0 is known, 0 is fitted.
    #[serde(default)]
    pub size_m: Vec<f64>,
    /// What its faces mirror besides their diffuse reflectance.
    #[serde(default)]
    pub gloss: Option<Gloss>,
    /// Half the side of a ground, m.
    #[serde(default = "twenty")]
    pub extent_m: f64,
    /// Where its corners are seen.
    #[serde(default)]
    pub marks: Vec<Mark>,
}

/// A corner seen in a photograph.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mark {
    /// `-+-`: signs of x, y (up), z of a box's or room's corner; `-+`: of a quad's corner; `0`, `1`, …: of a polygon's.
    pub corner: String,
    /// Which photograph.
    pub image: String,
    /// Where, px.
    pub at: [f64; 2],
    /// It was marked in its mirror image on the ball of the probe.
    #[serde(default)]
    pub reflection: bool,
}

//! The synthetic object: read, placed, lit by the scene's own light, seen by the plate's camera.

mod cells;
mod contacts;
mod environment;
mod frames;
mod gltf_file;
mod layer;
mod load;
mod normals;
mod object;
mod phong;
mod placement;
mod prefilter;
mod reflected;
mod set;
mod shade;
pub mod stage;

pub use cells::Cells;
pub use contacts::{Contact, Contacts, contacts};
pub use environment::Environment;
pub use frames::{Frame, Frames};
pub use layer::{Layer, Rendered, render};
pub(crate) use layer::{render_with, visible};
pub use load::load_object;
pub use object::{Material, Object, Soup, Triangle};
pub use phong::{Lobe, directional_albedo};
pub use placement::{check_placement, motions, world_from_object};
pub use prefilter::{Prefiltered, prefiltered};
pub use reflected::Reflector;
pub use set::{Set, Shaded};
pub use shade::{IrradianceAt, Lighting, Shadowed};
pub(crate) use shade::{Sample, Scene};

/// Why an object cannot be rendered.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum Problem {
    /// Nothing to show.
    #[error(
        "the mesh is empty: {vertices} vertices, {triangles} triangles, {degenerate} of them without area"
    )]
    Empty {
        /// Vertices in the file.
        vertices: usize,
        /// Triangles in the file.
        triangles: usize,
        /// Triangles dropped for having no area.
        degenerate: usize,
    },
    /// A triangle names a vertex that is not there.
    #[error("triangle {triangle} names vertex {index}, the mesh has {vertices}")]
    IndexOutOfRange {
        /// Triangle, from 0.
        triangle: usize,
        /// The index it names.
        index: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("vertex {vertex} lies at ({}, {}, {})", position[0], position[1], position[2])]
    NotFinite {
        /// Vertex, from 0.
        vertex: usize,
        /// Its position.
        position: [f32; 3],
    },
    /// A setting has an impossible value.
    #[error("`render.{name}` is {value}, expected {expected}")]
    Setting {
        /// Key in the table `[render]`.
        name: &'static str,
        /// What it is.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// The object lies behind the camera.
    #[error("object behind the camera: its nearest point has depth {nearest_m:.3} m along the viewing axis")]
    BehindCamera {
        /// Largest depth of a vertex, m.
        nearest_m: f64,
    },
    /// The object is not in the picture.
    #[error(
        "object outside the view: it spans x {:.0}..{:.0} px, y {:.0}..{:.0} px, the plate is {}×{} px",
        x_px[0], x_px[1], y_px[0], y_px[1], size_px[0], size_px[1]
    )]
    OutsideView {
        /// Extent of the projected vertices, px.
        x_px: [f64; 2],
        /// Extent of the projected vertices, px.
        y_px: [f64; 2],
        /// Size of the plate, px.
        size_px: [u32; 2],
    },
    /// The object is not in the room.
    #[error(
        "object outside the scene: along the world's {axis} it spans {:.3}..{:.3} m, the scene model {:.3}..{:.3} m",
        object_m[0], object_m[1], scene_m[0], scene_m[1]
    )]
    OutsideScene {
        /// Axis of the world frame.
        axis: char,
        /// Extent of the object, m.
        object_m: [f32; 2],
        /// Extent of the scene model, m.
        scene_m: [f32; 2],
    },
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::Empty { .. } => "export the object as triangles or polygons, with at least one of them",
            Self::IndexOutOfRange { .. } | Self::NotFinite { .. } => {
                "repair the mesh (Blender: Mesh > Clean Up) and export it again"
            }
            Self::Setting { .. } => "correct the setting in pipeline.toml",
            Self::BehindCamera { .. } | Self::OutsideView { .. } | Self::OutsideScene { .. } => {
                "check `render.position_m` (metres in the grid's frame), `render.scale` and `render.y_up`"
            }
        }
        .into()
    }
}

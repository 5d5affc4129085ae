//! How much light a synthetic object takes from the plate: ε(x) = Σ_j L_xj M_xj (Gibson et al. 2003, eq. 2).
//!
//! All methods answer with an image of ε. L_xj is what pixel x shows of source j: the plate's radiance times the
//! share that j has of the irradiance at x, so the plate's own reflectance is kept and ε never exceeds the plate. What share
//! that is depends on whether x lies in the scene's own shadow, which the plate knows better than the model (`registration`).

mod caster;
mod distant;
mod importance;
pub mod intensity;
mod ldr;
mod lookup;
mod origins;
mod plan;
mod projection;
mod radiance_transfer;
mod raster;
mod raytraced;
mod receivers;
mod registration;
mod representatives;
mod session;
mod silhouettes;
mod tiles;

use crate::config::Render;
use crate::illuminate::patch::LightModel;
use crate::image::{CodeImage, RadianceImage};
use crate::response::Response;
use crate::transfer::{Finish, SourceKind, Transfers};
use crate::{error, gpu, occlusion};
use glam::Vec3;

pub use caster::Caster;
pub use distant::DistantLookup;
pub(crate) use plan::{Outlook, Plan};
pub use projection::{Bounds, MapPlan, OFFSETS, Projection, ShadowOrigin};
pub use radiance_transfer::RadianceTransfer;
#[cfg(test)]
pub(crate) use raster::{DEPTH_BIAS, STEEPEST};
pub use raster::{EMPTY, ShadowMap, rasterise};
pub(crate) use raster::{Point, fragments};
pub use raytraced::raytraced;
pub use receivers::{Receiver, Receivers};
pub use session::{Frame, Session};
pub(crate) use tiles::{Pixel, Prepared, TILE_PX};

/// The synthetic object as light sees it, in the world.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Occluder {
    /// Positions, m.
    pub vertices: Vec<Vec3>,
    /// Vertex indices; degenerate triangles are allowed.
    pub triangles: Vec<[u32; 3]>,
}

/// What shadows fall from and onto.
#[derive(Clone, Copy)]
pub struct Scene<'a> {
    /// The light.
    pub light: &'a LightModel,
    /// What it sends to the receivers.
    pub transfers: &'a Transfers,
    /// What the plate's pixels look at.
    pub receivers: &'a Receivers,
    /// The plate.
    pub plate: &'a RadianceImage,
    /// What the receivers mirror to the plate's camera, as the transfers have it.
    pub finish: Option<Finish<'a>>,
    /// The plate as stored, for the method that subtracts from it.
    pub stored: Option<Stored<'a>>,
}

/// A photograph as the camera stored it.
#[derive(Clone, Copy)]
pub struct Stored<'a> {
    /// Its codes, of 8 bits; deeper ones are rounded.
    pub codes: &'a CodeImage,
    /// The response, which maps radiance in plate units to them.
    pub response: &'a Response,
}

/// What leaves the plate.
#[derive(Debug, Clone, PartialEq)]
pub struct Removed {
    /// ε, plate units; 0 where there is no receiver.
    pub epsilon: RadianceImage,
    /// The stored plate after all subtractions, where the method works in codes.
    pub codes: Option<CodeImage>,
    /// Noise of a sampled ε: rms of its standard error over rms of ε, where ε is above 2 % of the plate.
    pub noise: Option<f64>,
    /// Number of sources whose shadow was sought.
    pub sources_used: usize,
    /// Clusters into which they were gathered; 0 for rays.
    pub passes: usize,
    /// Hard shadows of which those of the clusters are made.
    pub shadow_maps: usize,
    /// Relative shadow error to expect of the clusters and maps, or of the lights that stand for an environment; `None`
    /// where the method cannot tell.
    pub expected_error: Option<f64>,
    /// Share of the receivers' light whose shadow was not sought.
    pub left_out_share: f64,
}

/// Why there is no shadow.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// Nothing to cast a shadow.
    #[error("the object has no triangles")]
    EmptyOccluder,
    /// A broken vertex or index.
    #[error("triangle {triangle} of the object has {what}")]
    BrokenTriangle {
        /// Which triangle.
        triangle: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// Artefacts of different runs.
    #[error("{what}: {found}, expected {expected}")]
    Mismatch {
        /// What does not fit.
        what: &'static str,
        /// What was found.
        found: String,
        /// What was expected.
        expected: String,
    },
    /// A setting out of its range.
    #[error("{name} is {value}, which is not {range}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// Its value.
        value: String,
        /// What it may be.
        range: &'static str,
    },
    /// Codes are to be subtracted, and there are none.
    #[error("the plate is linear: it has no stored codes")]
    NoCodes,
    /// No environment to take lights from.
    #[error("no light arrives at the object's place")]
    Dark,
    /// No rectangular light.
    #[error(transparent)]
    Rectangles(#[from] occlusion::Problem),
    /// The graphics processor.
    #[error(transparent)]
    Gpu(#[from] gpu::Problem),
}

impl error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::EmptyOccluder => {
                "check the object's file: it needs triangles, not only points or lines".into()
            }
            Self::BrokenTriangle { .. } => "repair the object's mesh, e.g. export it again".into(),
            Self::Mismatch { .. } => "run `insitu run --force --from illuminate`".into(),
            Self::Setting { name, range, .. } => format!("set render.{name} to {range}"),
            Self::NoCodes => {
                "set render.method to \"radiance-transfer\", or give the plate as a photograph".into()
            }
            Self::Dark => {
                "check that the object does not stand inside something, and the light that `illuminate` found"
                    .into()
            }
            Self::Rectangles(problem) => problem.hint(),
            Self::Gpu(problem) => problem.hint(),
        }
    }
}

/// ε of one object by the method and on the back end that the settings name. Shadow maps show a simplified object.
pub fn removed_radiance(scene: &Scene, occluder: &Occluder, settings: &Render) -> Result<Removed, Problem> {
    occluder.check()?;
    let caster = Caster::of(occluder, settings);
    Ok(Session::prepare(scene, settings)?.frame(&caster.occluder)?.removed)
}

impl Occluder {
    /// Refuses what no method can use.
    pub(crate) fn check(&self) -> Result<(), Problem> {
        if self.triangles.is_empty() {
            return Err(Problem::EmptyOccluder);
        }
        for (triangle, corners) in self.triangles.iter().enumerate() {
            for &v in corners {
                match self.vertices.get(v as usize) {
                    None => {
                        return Err(Problem::BrokenTriangle {
                            triangle,
                            what: "a vertex that does not exist",
                        });
                    }
                    Some(p) if !p.is_finite() => {
                        return Err(Problem::BrokenTriangle {
                            triangle,
                            what: "a position that is not finite",
                        });
                    }
                    _ => {}
                }
            }
        }
        Ok(())
    }
}

impl Scene<'_> {
    /// Refuses artefacts that were not made for each other.
    pub(crate) fn check(&self) -> Result<(), Problem> {
        let mismatch =
            |what, found: String, expected: String| Err(Problem::Mismatch { what, found, expected });
        self.receivers.check(self.plate)?;
        let (patches, distant) = (self.light.mesh.patches.len(), self.light.distant.len());
        for source in &self.transfers.sources {
            let (what, index, count) = match source.kind {
                SourceKind::Patch(i) => ("source patch", i, patches),
                SourceKind::Distant(i) => ("distant source", i, distant),
            };
            if index as usize >= count {
                return mismatch(what, index.to_string(), format!("less than {count}"));
            }
        }
        Ok(())
    }
}

//! How much light a synthetic object takes from the plate: ε(x) = Σ_j L_xj M_xj (Gibson et al. 2003, eq. 2).
//!
//! All methods answer with an image of ε. L_xj is what pixel x shows of source j: the plate's radiance times the
//! share that j has of the irradiance at x, so the plate's own reflectance is kept and ε never exceeds the plate.

mod projection;
mod radiance_transfer;
mod raster;
mod raytraced;
mod receivers;
mod tiles;

use crate::config::{Backend, Render, ShadowMethod};
use crate::illuminate::patch::LightModel;
use crate::image::{RadianceImage, luminance};
use crate::transfer::{SourceKind, Transfers};
use crate::{error, gpu};
use glam::Vec3;
use ndarray::Array2;

pub use projection::{Bounds, MapPlan, Projection, ShadowOrigin, plan};
pub use radiance_transfer::RadianceTransfer;
#[cfg(test)]
pub(crate) use raster::{DEPTH_BIAS, STEEPEST};
pub use raster::{ShadowMap, rasterise};
pub use raytraced::raytraced;
pub use receivers::{Receiver, Receivers};
pub(crate) use tiles::Pixel;

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
}

/// What leaves the plate.
#[derive(Debug, Clone, PartialEq)]
pub struct Removed {
    /// ε, plate units; 0 where there is no receiver.
    pub epsilon: RadianceImage,
    /// Noise of a sampled ε: rms of its standard error over rms of ε, where ε is above 2 % of the plate.
    pub noise: Option<f64>,
    /// Number of sources whose shadow was sought.
    pub sources_used: usize,
    /// Shadow maps drawn; several for a source that is large as seen from the object.
    pub shadow_maps: usize,
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
            Self::Gpu(problem) => problem.hint(),
        }
    }
}

/// ε by the method and on the back end that the settings name.
pub fn removed_radiance(scene: &Scene, occluder: &Occluder, settings: &Render) -> Result<Removed, Problem> {
    match (settings.method, settings.backend) {
        (ShadowMethod::Raytraced, _) => raytraced(scene, occluder, settings),
        (ShadowMethod::RadianceTransfer, Backend::Cpu) => {
            RadianceTransfer::prepare(scene, settings)?.removed_radiance(occluder)
        }
        (ShadowMethod::RadianceTransfer, Backend::Gpu) => {
            gpu::RadianceTransfer::prepare(scene, settings)?.removed_radiance(occluder)
        }
    }
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
        if self.receivers.pixels.size() != self.plate.size() {
            let (found, expected) = (self.receivers.pixels.size(), self.plate.size());
            return mismatch(
                "size of the plate's camera",
                format!("{found:?} px"),
                format!("{expected:?} px"),
            );
        }
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

    /// Indices of the sources that the settings ask for, strongest first.
    pub(crate) fn chosen(&self, settings: &Render) -> Vec<usize> {
        let share = |i: usize| self.transfers.sources[i].power_share;
        let mut order: Vec<usize> = (0..self.transfers.sources.len()).collect();
        order.sort_by(|&a, &b| share(b).total_cmp(&share(a)));
        if settings.max_sources > 0 {
            order.truncate(settings.max_sources);
        }
        order
    }

    /// Irradiance per unit radiance of some sources, sr, [sources × receiver vertices].
    pub(crate) fn transfer(&self, sources: &[usize]) -> Array2<f32> {
        let all = &self.transfers.sources;
        let vertices = self.transfers.receivers.positions.len();
        let mut out = Array2::zeros((sources.len(), vertices));
        let radiance: Vec<f32> = sources.iter().map(|&j| luminance(all[j].radiance(self.light))).collect();
        let mut row = vec![[0.0; 3]; all.len()];
        for v in 0..vertices {
            self.transfers.expand(v as u32, &mut row);
            for (i, &j) in sources.iter().enumerate() {
                out[(i, v)] = luminance(row[j]) / radiance[i];
            }
        }
        out
    }

    /// Share of the receivers' light that does not come from some sources.
    pub(crate) fn left_out_share(&self, sources: &[usize]) -> f64 {
        let all = &self.transfers.sources;
        let rest = all.iter().map(|s| s.power_share).sum::<f64>()
            - sources.iter().map(|&j| all[j].power_share).sum::<f64>();
        rest.max(0.0) + self.transfers.left_out_share
    }
}

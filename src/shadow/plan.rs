//! What one frame draws: clusters of sources, and the maps of each.

use super::importance::seen;
use super::origins::{Origin, Strata};
use super::projection::{MapPlan, OFFSETS};
use super::representatives::{Moments, Priority, Seen, representatives};
use super::tiles::Prepared;
use super::{Bounds, Scene};
use crate::transfer::Affected;
use std::ops::Range;

/// Clusters and maps of a frame.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// Sources in whose light the object may stand.
    pub sources: usize,
    /// By source, whether it is one of them.
    pub marked: Vec<bool>,
    /// Sources of each cluster, as ranges of the source set, ascending.
    pub clusters: Vec<Range<u32>>,
    /// Ascending by cluster.
    pub maps: Vec<MapPlan>,
    /// Predicted relative shadow error.
    pub error: f64,
}

/// What a frame knows before it is decided how many clusters there are.
pub(crate) struct Outlook<'a> {
    scene: Scene<'a>,
    bounds: Bounds,
    affected: Affected,
    seen: Vec<Seen>,
    moments: Moments,
}

/// Relative shadow error over the root of the summed squared errors of hard shadows (see [`super::origins`]); fitted to
/// measured errors so that few lie above the prediction.
const ERROR_SCALE: f64 = 1.0;

impl<'a> Outlook<'a> {
    pub fn new(scene: &Scene<'a>, prepared: &Prepared, bounds: Bounds) -> Self {
        let affected = scene.transfers.affected(bounds.min, bounds.max);
        let seen = seen(scene, prepared, &affected, &bounds);
        let moments = Moments::new(&seen);
        Self { scene: *scene, bounds, affected, seen, moments }
    }

    /// Receiver patches on which the object's shadow may fall, ascending.
    pub fn patches(&self) -> &[u32] {
        &self.affected.patches
    }

    /// Number of sources in whose light the object may stand.
    pub fn sources(&self) -> usize {
        self.affected.sources.len()
    }

    /// At most `passes` clusters (0: one a source) with `origins` maps each on average.
    pub fn plan(&self, passes: usize, origins: usize, map_px: usize) -> Plan {
        let tree = &self.scene.transfers.tree;
        let nodes = representatives(tree, &self.moments, passes, Priority::Spread);
        let found = self.origins(&nodes, origins);
        let mut shares = vec![0.0; nodes.len()];
        found.iter().for_each(|o| shares[o.cluster as usize] += o.share);
        let maps = (0..).zip(&found).map(|(i, o)| {
            let weight = (o.share / shares[o.cluster as usize]) as f32;
            MapPlan::new(o.cluster, o.at, weight, i % OFFSETS.len(), &self.bounds, map_size(map_px, o))
        });
        Plan {
            sources: self.sources(),
            marked: self.seen.iter().map(|s| s.marked).collect(),
            clusters: nodes.iter().map(|&n| tree.nodes[n as usize].leaves.clone()).collect(),
            maps: maps.collect(),
            error: error(&found),
        }
    }

    /// The relative shadow error to expect of so many passes.
    pub fn error(&self, passes: usize, origins: usize) -> f64 {
        let nodes = representatives(&self.scene.transfers.tree, &self.moments, passes, Priority::Spread);
        error(&self.origins(&nodes, origins))
    }

    fn origins(&self, nodes: &[u32], origins: usize) -> Vec<Origin> {
        let strata = Strata {
            light: self.scene.light,
            sources: &self.scene.transfers.sources,
            tree: &self.scene.transfers.tree,
            seen: &self.seen,
            moments: &self.moments,
            centre: self.bounds.centre.as_dvec3(),
            radius: f64::from(self.bounds.radius),
        };
        strata.origins(nodes, nodes.len() * origins.max(1))
    }
}

fn error(origins: &[Origin]) -> f64 {
    ERROR_SCALE * origins.iter().map(|o| o.share * o.share * o.width).sum::<f64>().sqrt()
}

/// Fewest texels along a map.
const COARSEST: usize = 32;
/// Texels per radian of an origin's width over the object's angular size: a texel may be about a quarter of the penumbra.
const TEXELS: f64 = 4.0;
/// An edge that is off by a texel may cost so much, as a share of the light squared times the share of the map.
const TEXEL_COST: f64 = 1e-6;

/// Side of an origin's map: fine enough for its penumbra, and no finer than its light deserves.
fn map_size(full: usize, origin: &Origin) -> usize {
    let wanted = (TEXELS / origin.width).min(origin.share * origin.share / TEXEL_COST);
    let mut size = full;
    while size / 2 >= COARSEST && (size / 2) as f64 >= wanted {
        size /= 2;
    }
    size
}

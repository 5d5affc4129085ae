//! What one frame draws: clusters of sources, and the maps of each.

use super::importance::seen;
use super::origins::{FINE, Origin, Strata};
use super::projection::{MapPlan, OFFSETS};
use super::representatives::{Moments, Seen, representatives};
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
    /// Number of passes: representative sources.
    pub passes: usize,
    /// Sources of each cluster, as ranges of the source set, ascending: the passes, or the parts of them that the maps stand for.
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
    /// Mean distance from the object's near side to its shadow, radii of the object.
    distance: f64,
}

/// What neither clusters nor origins make better: texels, the simplified object, transfers between vertices.
const REST: f64 = 0.02;

impl<'a> Outlook<'a> {
    pub fn new(scene: &Scene<'a>, prepared: &Prepared, affected: Affected, bounds: Bounds) -> Self {
        let (seen, distance) = seen(scene, prepared, &affected, &bounds);
        let moments = Moments::new(&seen);
        Self { scene: *scene, bounds, affected, seen, moments, distance }
    }

    /// Receiver patches on which the object's shadow may fall, ascending.
    pub fn patches(&self) -> &[u32] {
        &self.affected.patches
    }

    /// Number of sources in whose light the object may stand.
    pub fn sources(&self) -> usize {
        self.affected.sources.len()
    }

    /// At most `passes` clusters (0: one a source) with `origins` maps each on average. `parted`: every map takes what its
    /// part of the cluster sends, not a share of the whole.
    pub fn plan(&self, passes: usize, origins: usize, parted: bool, map_px: usize) -> Plan {
        let tree = &self.scene.transfers.tree;
        let nodes = representatives(tree, &self.moments, passes);
        let found = self.origins(&nodes, origins);
        let mut clusters: Vec<Range<u32>> = if parted {
            found.iter().map(|o| o.leaves.clone()).collect()
        } else {
            nodes.iter().map(|&n| tree.nodes[n as usize].leaves.clone()).collect()
        };
        clusters.dedup();
        let mut part = 0;
        let maps = (0..).zip(&found).map(|(i, o)| {
            let (cluster, weight) = if parted {
                part += usize::from(clusters[part] != o.leaves);
                (part as u32, o.part)
            } else {
                (o.cluster, o.weight)
            };
            MapPlan::new(cluster, o.at, weight as f32, i % OFFSETS.len(), &self.bounds, map_size(map_px, o))
        });
        let maps = maps.collect();
        Plan {
            sources: self.sources(),
            marked: self.seen.iter().map(|s| s.marked).collect(),
            passes: nodes.len(),
            clusters,
            maps,
            error: self.expected(&found),
        }
    }

    /// The relative shadow error to expect of so many passes.
    pub fn error(&self, passes: usize, origins: usize) -> f64 {
        let nodes = representatives(&self.scene.transfers.tree, &self.moments, passes);
        self.expected(&self.origins(&nodes, origins))
    }

    /// Relative shadow error that hard shadows in the place of penumbrae cost (see [`super::origins`]), and what else
    /// there is.
    fn expected(&self, origins: &[Origin]) -> f64 {
        let square: f64 = origins.iter().map(|o| o.share * o.share * o.width).sum();
        (square * self.distance).sqrt().hypot(REST)
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

/// Fewest texels along a map: averaged over many, a texel's edges blur the shadow by a texel, which shows where the object
/// stands on the ground.
const COARSEST: usize = 128;
/// Texels along a map per angular width of its origin, 1/rad: a texel is about half as wide as the penumbra that the
/// origin stands for, near the object.
const TEXELS: f64 = 2.0;

/// Side of an origin's map: fine enough for its penumbra, and no finer than its light deserves. Like a hard edge in the
/// place of a penumbra (see [`super::origins`]), a texel's edge errs by the light's share over the texel's width.
fn map_size(full: usize, origin: &Origin) -> usize {
    let wanted = (TEXELS / origin.width).min(origin.share / (FINE * FINE));
    let mut size = full;
    while size / 2 >= COARSEST && (size / 2) as f64 >= wanted {
        size /= 2;
    }
    size
}

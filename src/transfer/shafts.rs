//! What an object's box may hide, and from what (gibson §6).

use super::Transfers;
use glam::Vec3;

/// Shafts between clusters of sources and of receivers.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ShaftHierarchy {}

/// Sources and receivers between which an object may stand.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Affected {
    /// Indices of sources, ascending.
    pub sources: Vec<u32>,
    /// Receiver patches, ascending.
    pub patches: Vec<u32>,
}

impl Transfers {
    /// Sources of which something in the box (m, world) may hide a part from a receiver, and those receivers. May name
    /// too many, never too few.
    pub fn affected(&self, _min: Vec3, _max: Vec3) -> Affected {
        Affected {
            sources: (0..self.sources.len() as u32).collect(),
            patches: self.receivers.patches.clone(),
        }
    }
}

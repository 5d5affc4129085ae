//! Axis-aligned boxes.

use glam::Vec3;

/// An axis-aligned box; empty where `min` is above `max`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Box3 {
    /// Least coordinates.
    pub min: Vec3,
    /// Largest coordinates.
    pub max: Vec3,
}

impl Box3 {
    /// Holds nothing.
    pub const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// Around points.
    pub fn of(points: impl IntoIterator<Item = Vec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |b, p| Self { min: b.min.min(p), max: b.max.max(p) })
    }

    /// Around both.
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Larger by `by` on each side.
    pub fn grown(self, by: f32) -> Self {
        Self { min: self.min - by, max: self.max + by }
    }

    /// Diagonal.
    pub fn size(self) -> Vec3 {
        (self.max - self.min).max(Vec3::ZERO)
    }

    /// Middle.
    pub fn centre(self) -> Vec3 {
        (self.min + self.max) / 2.0
    }

    /// The eight corners.
    pub fn corners(self) -> [Vec3; 8] {
        let select = |i: usize| glam::BVec3::new(i & 1 > 0, i & 2 > 0, i & 4 > 0);
        std::array::from_fn(|i| Vec3::select(select(i), self.max, self.min))
    }
}

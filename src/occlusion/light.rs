//! A rectangular light and the frame that its slices lie in.

use crate::transfer::form_factor;
use glam::{Affine3A, Mat3, Vec2, Vec3};

/// A rectangle of even radiance that sends light from one side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RectangularLight {
    /// Its middle, world, m.
    pub centre: Vec3,
    /// From the middle to the middles of two adjoining sides, m; at right angles. Light leaves along the first × the second.
    pub half: [Vec3; 2],
    /// Plate units.
    pub radiance: [f32; 3],
}

impl RectangularLight {
    /// Unit vector along which light leaves.
    pub fn normal(&self) -> Vec3 {
        self.half[0].cross(self.half[1]).normalize_or_zero()
    }

    /// m².
    pub fn area(&self) -> f32 {
        4.0 * self.half[0].cross(self.half[1]).length()
    }

    /// Point of the rectangle for one of the unit square, m.
    pub fn at(&self, u: Vec2) -> Vec3 {
        self.centre + self.half[0] * (2.0 * u.x - 1.0) + self.half[1] * (2.0 * u.y - 1.0)
    }

    /// Counter-clockwise as seen from where it shines, m.
    pub fn corners(&self) -> [Vec3; 4] {
        [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(x, y)| self.at(Vec2::new(x, y)))
    }

    /// Irradiance on a surface with nothing between, plate units.
    pub fn irradiance(&self, position: Vec3, normal: Vec3) -> [f32; 3] {
        let share = self.form_factor(position, normal);
        self.radiance.map(|l| std::f32::consts::PI * share * l)
    }

    /// Share of what a surface sends that falls onto the light's front, by cosine.
    pub(crate) fn form_factor(&self, position: Vec3, normal: Vec3) -> f32 {
        form_factor::polygon(position, normal, &self.corners())
    }

    /// Into the light's coordinates: column and row in half sides (the rectangle spans −1..1) and depth, the distance from
    /// its plane, m, positive where it shines.
    pub fn light_from_world(&self) -> Affine3A {
        let [u, v] = self.half.map(|h| h / h.length_squared());
        let rows = Mat3::from_cols(u, v, self.normal()).transpose();
        Affine3A::from_mat3_translation(rows, -(rows * self.centre))
    }
}

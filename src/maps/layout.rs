//! Where a direction lies in each layout.

use crate::dome::cube;
use crate::probe::latlong;
use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

/// How all directions are laid out in a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// Latitude by rows, longitude by columns; twice as wide as high ([`latlong`]).
    Latlong,
    /// The six faces of a cube side by side: +x, −x, +y, −y, +z, −z, seen from inside.
    Cube,
    /// An octahedron unfolded to a square (Engelhardt and Dachsbacher 2008): +y in the middle, −y in the corners.
    Octahedral,
    /// A mirror sphere seen from +z at infinity (Blinn and Newell 1976; Miller and Hoffman 1984): its rim is −z.
    Sphere,
}

impl Layout {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Latlong, Self::Cube, Self::Octahedral, Self::Sphere];

    /// Width over height.
    pub fn aspect(self) -> usize {
        match self {
            Self::Latlong => 2,
            Self::Cube => cube::FACES,
            Self::Octahedral | Self::Sphere => 1,
        }
    }

    /// Size, px, of a picture of that height.
    pub fn size(self, height: usize) -> (usize, usize) {
        (self.aspect() * height, height)
    }

    /// Whether a picture may be of this layout.
    pub fn fits(self, (width, height): (usize, usize)) -> bool {
        height > 0 && width == self.aspect() * height
    }

    /// Unit direction at continuous pixel `(x, y)` of a picture. Outside the disc of a sphere it is that of the rim.
    pub fn direction(self, x: f32, y: f32, (width, height): (usize, usize)) -> Vec3 {
        let (u, v) = (2.0 * x / width as f32 - 1.0, 2.0 * y / height as f32 - 1.0);
        match self {
            Self::Latlong => latlong::direction(x, y, width, height),
            Self::Cube => {
                let face = ((x / height as f32) as usize).min(cube::FACES - 1);
                self.on_face(face, x, y, height)
            }
            Self::Octahedral => {
                let up = 1.0 - u.abs() - v.abs();
                let p = if up >= 0.0 { Vec2::new(u, v) } else { folded(Vec2::new(u, v)) };
                Vec3::new(p.x, up, p.y).normalize()
            }
            Self::Sphere => {
                let r2 = u * u + v * v;
                if r2 >= 1.0 {
                    return Vec3::NEG_Z;
                }
                let normal = Vec3::new(u, -v, (1.0 - r2).sqrt());
                normal * (2.0 * normal.z) - Vec3::Z
            }
        }
    }

    /// The same of the texel that holds `(x, y)` from inside, at a corner of it: edges of a cube's face belong to the face.
    pub(super) fn corner(self, texel: usize, x: f32, y: f32, size: (usize, usize)) -> Vec3 {
        match self {
            Self::Cube => self.on_face(texel % size.0 / size.1, x, y, size.1),
            _ => self.direction(x, y, size),
        }
    }

    fn on_face(self, face: usize, x: f32, y: f32, side: usize) -> Vec3 {
        let at = |p: f32| 2.0 * p / side as f32 - 1.0;
        cube::direction(face, at(x - (face * side) as f32), at(y))
    }

    /// Continuous pixel of a unit direction; inverse of [`Self::direction`].
    pub fn pixel(self, direction: Vec3, (width, height): (usize, usize)) -> (f32, f32) {
        let at = |u: f32, v: f32| ((u + 1.0) / 2.0 * width as f32, (v + 1.0) / 2.0 * height as f32);
        match self {
            Self::Latlong => latlong::pixel(direction, width, height),
            Self::Cube => {
                let (face, u, v) = cube::place(direction);
                let side = height as f32;
                (face as f32 * side + (u + 1.0) / 2.0 * side, (v + 1.0) / 2.0 * side)
            }
            Self::Octahedral => {
                let d = direction / (direction.x.abs() + direction.y.abs() + direction.z.abs());
                let p = Vec2::new(d.x, d.z);
                let p = if d.y >= 0.0 { p } else { folded(p) };
                at(p.x, p.y)
            }
            Self::Sphere => {
                let normal = (direction + Vec3::Z).normalize_or(Vec3::X);
                at(normal.x, -normal.y)
            }
        }
    }

    /// The texel that holds a direction, row by row.
    pub fn texel(self, direction: Vec3, size: (usize, usize)) -> usize {
        let (x, y) = self.pixel(direction, size);
        (y.max(0.0) as usize).min(size.1 - 1) * size.0 + (x.max(0.0) as usize).min(size.0 - 1)
    }
}

/// A point of the lower half of the octahedron on the square's corners, and back.
fn folded(p: Vec2) -> Vec2 {
    let sign = |v: f32| if v < 0.0 { -1.0 } else { 1.0 };
    Vec2::new((1.0 - p.y.abs()) * sign(p.x), (1.0 - p.x.abs()) * sign(p.y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn direction_inverts_pixel(x in -1.0f32..1.0, y in -1.0f32..1.0, z in -1.0f32..1.0) {
            let d = Vec3::new(x, y, z).normalize_or(Vec3::Y);
            for layout in Layout::ALL {
                let size = layout.size(64);
                let (px, py) = layout.pixel(d, size);
                // Near its rim a sphere has hardly any pixel for a direction.
                let off = layout.direction(px, py, size).angle_between(d);
                prop_assert!(off < if layout == Layout::Sphere && d.z < -0.9 { 0.1 } else { 2e-3 }, "{layout:?} {off}");
            }
        }
    }

    #[test]
    fn the_middles_are_where_they_are_said_to_be() {
        let middle = |layout: Layout| {
            let (w, h) = layout.size(64);
            layout.direction(w as f32 / 2.0, h as f32 / 2.0, (w, h))
        };
        assert!((middle(Layout::Latlong) - Vec3::Z).length() < 1e-6);
        assert!((middle(Layout::Octahedral) - Vec3::Y).length() < 1e-6);
        assert!((middle(Layout::Sphere) - Vec3::Z).length() < 1e-6);
        // Who looks at a mirror sphere along −z sees what lies at +x to the right.
        assert!((Layout::Sphere.pixel(Vec3::X, (64, 64)).0 - 32.0 * (1.0 + 0.5f32.sqrt())).abs() < 1e-3);
        assert!((Layout::Cube.direction(32.0, 32.0, (384, 64)) - Vec3::X).length() < 1e-6);
    }
}

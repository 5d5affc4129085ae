//! Where occlusion textures look from (eisemann2006, §3.4): a centre of projection behind the light, so that the square
//! frustum through the light's edges holds all receivers, and with them every kernel.

use super::RectangularLight;
use glam::{Affine3A, Vec2, Vec3};

/// Receivers that see the light's edge flatter than this (tangent against its normal) do not widen the frustum: they would
/// for hardly any light. What of their kernels lies outside counts as open.
const GRAZING: f32 = 6.0;
/// Longest distance of the centre of projection, in depths of the farthest receiver.
const FARTHEST: f32 = 1.0;

/// Perspective from behind a rectangular light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frustum {
    /// See [`RectangularLight::light_from_world`]. The light's edges lie on the frustum's sides.
    pub light_from_world: Affine3A,
    /// Distance of the centre of projection behind the light, m.
    pub behind: f32,
}

/// A plane parallel to the light, in a texture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Section {
    /// m.
    depth: f32,
    /// Size of the light's side there against the frustum's.
    scale: f32,
    /// Half the texture's side, texels.
    half: f32,
}

/// The square of an occlusion texture that lies between a point and the light, texels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kernel {
    /// Middle, column and row.
    pub centre: Vec2,
    /// Side.
    pub side: f32,
}

impl Frustum {
    /// The one that is nearest to parallel and holds all receivers (world, m). The rectangle's sides may differ: textures
    /// are square in units of it.
    pub fn fit(light: &RectangularLight, receivers: impl Iterator<Item = Vec3>) -> Self {
        let light_from_world = light.light_from_world();
        let (mut behind, mut depth) = (f32::INFINITY, 0.0f32);
        for q in receivers.map(|p| light_from_world.transform_point3(p)).filter(|q| q.z > 0.0) {
            depth = depth.max(q.z);
            for (across, half) in [(q.x, light.half[0]), (q.y, light.half[1])] {
                // |across| · behind / (z + behind) ≤ 1.
                let beyond = across.abs() - 1.0;
                if beyond > 0.0 && beyond * half.length() <= GRAZING * q.z {
                    behind = behind.min(q.z / beyond);
                }
            }
        }
        let farthest = if depth > 0.0 { FARTHEST * depth } else { 1.0 };
        Self { light_from_world, behind: behind.min(farthest) }
    }

    /// Column and row of a point in a texture of `size` texels a side, from its coordinates
    /// in front of the light. The same whatever plane it is projected onto.
    pub fn texel(&self, q: Vec3, size: usize) -> Vec2 {
        let scale = self.behind / (q.z + self.behind);
        (q.truncate() * scale + 1.0) * (size as f32 / 2.0)
    }

    /// The plane at a depth, m.
    pub fn section(&self, depth: f32, size: usize) -> Section {
        Section { depth, scale: self.behind / (depth + self.behind), half: size as f32 / 2.0 }
    }
}

impl Section {
    /// Where the pyramid from a point behind the plane, in the light's coordinates, to the light cuts it (eisemann2006,
    /// eq. 4).
    pub fn kernel(&self, q: Vec3) -> Kernel {
        let share = self.depth / q.z;
        Kernel {
            centre: (q.truncate() * (share * self.scale) + 1.0) * self.half,
            side: 2.0 * (1.0 - share) * self.scale * self.half,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn light(half: [f32; 2]) -> RectangularLight {
        RectangularLight {
            centre: Vec3::new(0.3, 2.0, -0.1),
            half: [Vec3::X * half[0], Vec3::Z * half[1]],
            radiance: [1.0; 3],
        }
    }

    proptest! {
        #[test]
        fn kernels_never_leave_the_texture(
            u in 0.02..1.0f32, v in 0.02..1.0f32, x in -1.5..1.5f32, z in -1.5..1.5f32, y in -2.0..1.0f32,
            share in 0.0..1.0f32,
        ) {
            let light = light([u, v]);
            let receivers = [Vec3::new(x, y, z), Vec3::new(-x, -1.0, z), Vec3::new(0.0, 0.0, -z)];
            prop_assume!(receivers.iter().all(|r| {
                let q = light.light_from_world().transform_point3(*r);
                q.z > 0.0 && (0..2).all(|k| (q[k].abs() - 1.0) * light.half[k].length() < GRAZING * q.z)
            }));
            let frustum = Frustum::fit(&light, receivers.into_iter());
            for r in receivers {
                let q = frustum.light_from_world.transform_point3(r);
                let kernel = frustum.section(share * q.z, 256).kernel(q);
                let (low, high) = (kernel.centre - kernel.side / 2.0, kernel.centre + kernel.side / 2.0);
                prop_assert!(low.min_element() > -0.01 && high.max_element() < 256.01, "{:?}", kernel);
            }
        }

        #[test]
        fn a_kernel_holds_just_the_rays_to_the_light(
            x in -1.0..1.0f32, z in -1.0..1.0f32, a in -0.3..1.3f32, b in -0.3..1.3f32, share in 0.05..0.95f32,
        ) {
            let light = light([0.3, 0.2]);
            let receiver = Vec3::new(x, 0.0, z);
            let frustum = Frustum { light_from_world: light.light_from_world(), behind: 0.4 };
            let q = frustum.light_from_world.transform_point3(receiver);
            let kernel = frustum.section(share * q.z, 512).kernel(q);
            // A point of the plane on the ray to a point of the light's plane, inside it or not.
            let on = receiver.lerp(light.at(Vec2::new(a, b)), 1.0 - share);
            let at = (frustum.texel(frustum.light_from_world.transform_point3(on), 512) - kernel.centre).abs() / kernel.side;
            let inside = (a - 0.5).abs().max((b - 0.5).abs());
            prop_assert!((at.max_element() - inside).abs() < 1e-3, "{} {}", at, inside);
        }
    }
}

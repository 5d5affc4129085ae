//! Receivers that also mirror (beyond gibson §9): what a Phong lobe adds to what the plate's camera sees, as irradiance.
//!
//! A face of diffuse reflectance ρ and specular reflectance k shows the camera ρ/π E + ∫ k (n + 2)/(2π) cosⁿα L cos θ dω,
//! with α the angle to the mirrored line of sight (Lafortune and Willems 1994: reciprocal, and k is never exceeded). That
//! is ρ/π times the irradiance ∫ [1 + s cosⁿα] L cos θ dω with s = k/ρ · (n + 2)/2: so weighted, transfers stay
//! irradiances, and ε remains the plate's radiance times the share of them that is blocked.

use crate::camera::Camera;
use crate::illuminate::patch::Patch;
use crate::model::face::Gloss;
use glam::Vec3;

/// The lobe of a receiver vertex towards the plate's camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Lobe {
    /// Unit vector along the mirrored line of sight.
    axis: Vec3,
    exponent: f32,
    /// s of each channel.
    strength: [f32; 3],
}

/// What the receivers mirror to the plate's camera.
#[derive(Debug, Clone, Copy)]
pub struct Finish<'a> {
    /// Centre of the plate's camera, m.
    pub eye: Vec3,
    /// By face of the scene.
    pub gloss: &'a [Option<Gloss>],
}

impl<'a> Finish<'a> {
    /// Of faces as a camera sees them; `None`: nothing is mirrored.
    pub fn new(camera: &Camera, gloss: &'a [Option<Gloss>]) -> Option<Self> {
        let eye = camera.centre();
        let eye = Vec3::new(eye.x as f32, eye.y as f32, eye.z as f32);
        gloss.iter().any(Option::is_some).then_some(Self { eye, gloss })
    }

    /// The lobe of a point of a patch.
    pub(crate) fn lobe(&self, patch: &Patch, position: Vec3, normal: Vec3) -> Option<Lobe> {
        let gloss = self.gloss.get(patch.face as usize)?.as_ref()?;
        Lobe::new(gloss, patch.reflectance, position, normal, self.eye)
    }
}

/// Diffuse reflectance counts as at least this.
const LEAST_DIFFUSE: f32 = 0.01;
/// What a lobe adds is left out below this share.
const FAINT: f32 = 0.005;

impl Lobe {
    /// Of a point as seen from `eye`; `diffuse` is ρ. `None`: nothing is mirrored.
    pub fn new(gloss: &Gloss, diffuse: [f32; 3], position: Vec3, normal: Vec3, eye: Vec3) -> Option<Self> {
        let axis = -(eye - position).try_normalize()?.reflect(normal);
        let n = gloss.shininess;
        let strength =
            std::array::from_fn(|c| gloss.specular[c] / diffuse[c].max(LEAST_DIFFUSE) * (n + 2.0) / 2.0);
        strength.iter().any(|&s| s > 0.0).then_some(Self { axis, exponent: n, strength })
    }

    /// 1 + s cosⁿα for light from a unit direction.
    pub fn weight(&self, direction: Vec3) -> [f32; 3] {
        let lobe = self.axis.dot(direction).max(0.0).powf(self.exponent);
        self.strength.map(|s| 1.0 + s * lobe)
    }

    /// Whether it adds anything to light from within a cone of directions around one (unit; sine of the half angle).
    pub fn reaches(&self, direction: Vec3, sine: f32) -> bool {
        if sine >= 1.0 {
            return true;
        }
        let from_axis = self.axis.dot(direction).clamp(-1.0, 1.0).acos();
        let nearest = (from_axis - sine.asin()).clamp(0.0, std::f32::consts::FRAC_PI_2).cos();
        self.strength.iter().any(|s| s * nearest.powf(self.exponent) > FAINT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::sampling::{Shift, in_cap};
    use proptest::prelude::*;

    fn vec(range: std::ops::Range<f32>) -> impl Strategy<Value = Vec3> {
        (range.clone(), range.clone(), range).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn a_lobe_is_reciprocal_and_keeps_its_energy(
            (v, w) in (vec(-1.0..1.0), vec(-1.0..1.0)), k in 0.0..1.0f32, n in 0.0..200.0f32,
        ) {
            let above = |v: Vec3| Vec3::new(v.x, v.y.abs().max(0.05), v.z).normalize();
            let (v, w) = (above(v), above(w));
            let gloss = Gloss { specular: [k; 3], shininess: n };
            let lobe = |eye: Vec3| Lobe::new(&gloss, [0.5; 3], Vec3::ZERO, Vec3::Y, eye);
            let Some(there) = lobe(v * 3.0) else { return Ok(()) };
            let (a, b) = (there.weight(w)[0], lobe(w * 5.0).unwrap().weight(v)[0]);
            prop_assert!((a - b).abs() <= 1e-3 * a, "{} there, {} back", a, b);
            // ∫ (f − ρ/π) cos θ dω over the half space, as a mean over directions of equal solid angle.
            let count = 20_000;
            let sum: f64 = (0..count)
                .map(|i| in_cap(Vec3::Y, std::f32::consts::FRAC_PI_2, Shift::new(1, 2).point(i)))
                .map(|d| f64::from((there.weight(d)[0] - 1.0) * d.y))
                .sum();
            let mirrored = 0.5 / std::f64::consts::PI * sum / f64::from(count) * std::f64::consts::TAU;
            prop_assert!(mirrored <= f64::from(k) * 1.03 + 1e-4, "{} of {} mirrored", mirrored, k);
        }

        #[test]
        fn what_a_lobe_does_not_reach_it_does_not_light(axis in vec(-1.0..1.0), d in vec(-1.0..1.0), n in 1.0..500.0f32, sine in 0.0..0.9f32, u in 0.0..1.0f32, turn in 0.0..1.0f32) {
            prop_assume!(axis.length() > 0.1 && d.length() > 0.1);
            let (axis, d) = (axis.normalize(), d.normalize());
            let lobe = Lobe { axis, exponent: n, strength: [n; 3] };
            let w = in_cap(d, sine.asin(), glam::Vec2::new(u, turn));
            prop_assert!(lobe.reaches(d, sine + 1e-3) || lobe.weight(w)[0] < 1.0 + 2.0 * FAINT);
        }
    }
}

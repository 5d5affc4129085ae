//! What lights send to a surface and on to the viewer (decoro2008, §2 step 2c).

use super::{Brdf, Light, Surface};
use glam::Vec3;

/// Light at a surface, plate units.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sent {
    /// Irradiance.
    pub irradiance: [f32; 3],
    /// Radiance towards the viewer by the gloss, of reflectance 1.
    pub gloss: [f32; 3],
}

/// Sums the lights named, each by the share that `share` gives for its index and direction. Lights below the surface's
/// horizon are not asked for. The gloss of a light is spread over the solid angle that it stands for, other than in the
/// paper: points would take more from a shiny surface than it shows, and leave black spots. A matt surface (`None`, Lambert) has no gloss.
pub fn gather(
    surface: &Surface,
    brdf: Option<Brdf>,
    lights: &[Light],
    named: impl IntoIterator<Item = usize>,
    mut share: impl FnMut(usize, Vec3) -> [f32; 3],
) -> Sent {
    let brdf = brdf.filter(|b| *b != Brdf::Lambert);
    let mut sent = Sent::default();
    for i in named {
        let (direction, gain) = lights[i].seen_from(surface.position);
        let weight = surface.normal.dot(direction).max(0.0) * gain;
        if weight <= 0.0 {
            continue;
        }
        let share = share(i, direction);
        if share == [0.0; 3] {
            continue;
        }
        let gloss = brdf
            .map_or(0.0, |b| b.widened(lights[i].extent_sr).value(surface.normal, direction, surface.viewer));
        for (k, share) in share.into_iter().enumerate() {
            let irradiance = weight * share * lights[i].power[k];
            sent.irradiance[k] += irradiance;
            sent.gloss[k] += gloss * irradiance;
        }
    }
    sent
}

impl Sent {
    /// What is left where so much is hidden, each part at least 0: a gloss of which more is hidden than there is must not take
    /// diffuse light with it.
    pub fn less(&self, hidden: &Self) -> Self {
        let less = |open: [f32; 3], hidden: [f32; 3]| [0, 1, 2].map(|k| (open[k] - hidden[k]).max(0.0));
        Self { irradiance: less(self.irradiance, hidden.irradiance), gloss: less(self.gloss, hidden.gloss) }
    }

    /// Irradiance, then gloss, as an entry of a [`super::ShadowBuffer`].
    pub fn to_array(self) -> [f32; 6] {
        let ([a, b, c], [d, e, f]) = (self.irradiance, self.gloss);
        [a, b, c, d, e, f]
    }

    /// Inverse of [`Self::to_array`].
    pub fn from_array([a, b, c, d, e, f]: [f32; 6]) -> Self {
        Self { irradiance: [a, b, c], gloss: [d, e, f] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illuminate::patch::DistantSource;
    use proptest::prelude::*;

    fn lights() -> Vec<Light> {
        let at = |i: usize| DistantSource {
            direction: Vec3::new((i as f32).sin(), 1.0, (i as f32).cos()).normalize(),
            solid_angle_sr: 0.1,
            radiance: [1.0, 2.0, i as f32],
        };
        (0..10).map(|i| Light::distant(&at(i))).collect()
    }

    fn floor() -> Surface {
        let up = Vec3::Y;
        Surface { position: Vec3::ZERO, normal: up, face_normal: up, viewer: up, material: 0, pixel_m: 1e-3 }
    }

    proptest! {
        #[test]
        fn hidden_and_visible_add_up(hidden in proptest::collection::vec(any::<bool>(), 10)) {
            let brdf = Some(Brdf::Phong { exponent: 10.0 });
            let sum = |of: &dyn Fn(usize) -> bool| {
                gather(&floor(), brdf, &lights(), 0..10, |i, _| if of(i) { [1.0; 3] } else { [0.0; 3] }).to_array()
            };
            let (all, gone, left) = (sum(&|_| true), sum(&|i| hidden[i]), sum(&|i| !hidden[i]));
            for k in 0..6 {
                prop_assert!((all[k] - gone[k] - left[k]).abs() < 1e-4 * all[k] + 1e-6);
            }
        }
    }

    #[test]
    fn a_light_below_the_horizon_is_not_asked_for() {
        let below = Surface { normal: -Vec3::Y, face_normal: -Vec3::Y, ..floor() };
        let sent = gather(&below, None, &lights(), 0..10, |_, _| unreachable!("all lights are above"));
        assert_eq!(sent, Sent::default());
    }
}

//! The environment as a few lights (decoro2008, §2, step 1), and where they lie.

use super::structured::structured;
use crate::config::{LightSampling, Render};
use crate::illuminate::distant::{Stratum, median_cut, texels};
use crate::illuminate::patch::{DistantSource, LightModel};
use crate::image::{RadianceImage, luminance};
use crate::irradiance::split_beams;
use crate::render::Environment;
use crate::shadow::ShadowOrigin;
use crate::transfer::sampling::{Shift, in_cap};
use crate::visibility::Bvh;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f32::consts::PI;

/// At most `count` lights with all the power of a `latlong` environment; none where that is black.
pub(crate) fn sample(environment: &RadianceImage, count: usize, sampling: LightSampling) -> Vec<Stratum> {
    match sampling {
        LightSampling::Structured => structured(environment, count),
        LightSampling::MedianCut => {
            let (width, height) = environment.size();
            median_cut(texels(environment), [width, height], count)
        }
    }
}

/// The lights of a scene model at `place` (m), most of them on its surfaces. A beam (the sun) is no part of the sampled
/// environment, whose texels would move it: it is as many lights all over its disc as a tenth of all.
pub(crate) fn lights_at(
    model: &LightModel,
    bvh: &Bvh,
    place: Vec3,
    count: usize,
    settings: &Render,
) -> Vec<Light> {
    let width = settings.environment_px.max(8);
    let (beams, soft) = split_beams(&model.distant);
    let open: Vec<_> =
        beams.into_iter().filter(|b| !bvh.any_hit(place, b.direction, 0.0, f32::INFINITY)).collect();
    let each = if open.is_empty() { 0 } else { (count / 10 / open.len()).max(1) };
    let points = open.iter().flat_map(|beam| {
        let share = DistantSource { solid_angle_sr: beam.solid_angle_sr / each as f32, ..*beam };
        let point = |i| in_cap(beam.direction, beam.angular_radius(), Shift::new(0, 0).point(i));
        (0..each as u32).map(move |i| Light::distant(&DistantSource { direction: point(i), ..share }))
    });
    let environment = Environment::cast_with(&model.mesh, &soft, bvh, place, width, width / 2);
    let rest = count.saturating_sub(each * open.len()).max(1);
    let sources = sample(&environment.map, rest, settings.light_sampling);
    let on_model = sources.par_iter().map(|stratum| Light::on_model(stratum, model, bvh, place));
    points.chain(on_model.collect::<Vec<_>>()).collect()
}

/// A light of the environment as seen from one place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Where it shines from.
    pub origin: ShadowOrigin,
    /// Irradiance that it gives at the environment's place to what faces it, plate units.
    pub power: [f32; 3],
    /// Solid angle over which it is spread, sr, and so its gloss.
    pub extent_sr: f32,
    /// Solid angle that it stands for, sr: those of all lights together fill the sphere.
    pub solid_angle_sr: f32,
    /// Of a light on the model's surfaces.
    near: Option<Near>,
}

/// What makes a near light weaker or stronger elsewhere.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Near {
    /// Normal of the surface that sends it.
    normal: Vec3,
    /// Cosine at that surface towards the environment's place, over (r² + A/π) there, with A the area of the stratum: the
    /// form factor of a disc on its axis, which stays finite where it is touched.
    reference: f32,
    /// A/π, m².
    spread: f32,
}

/// A surface seen more obliquely from the environment's place than by this cosine counts as so oblique.
const LEAST_COSINE: f32 = 0.1;
/// A surface with this share of the light's mean radiance is the one that it comes from.
const ENOUGH: f32 = 0.5;
/// Rays that find the surface of a light, over so many times its solid angle: a disc around a texel with its corners.
const RAYS: u32 = 64;
const REACH: f32 = 2.0;
/// Near lights lie before their surface by this much, m.
const BEFORE_M: f32 = 1e-4;

impl Light {
    /// At infinity, as the paper has all of them.
    pub fn distant(source: &DistantSource) -> Self {
        Self {
            origin: ShadowOrigin::Direction(source.direction),
            power: source.radiance.map(|l| l * source.solid_angle_sr),
            extent_sr: source.solid_angle_sr,
            solid_angle_sr: source.solid_angle_sr,
            near: None,
        }
    }

    /// The same as a point, whose gloss is as narrow as the material's: what additive shadows are made of.
    pub fn as_point(self) -> Self {
        Self { extent_sr: 0.0, ..self }
    }

    /// The same of a part of an environment.
    pub(crate) fn of_stratum(stratum: &Stratum) -> Self {
        Self { extent_sr: stratum.extent_sr, ..Self::distant(&stratum.source) }
    }

    /// On the front of the surface that sends the stratum's light to `place` (m), at infinity where that comes from beyond
    /// the model. What is seen along its direction may shine little: the wall behind a lamp, which hides it, or the gap between two
    /// of its faces. The light then stands on what sends most around there.
    pub(crate) fn on_model(stratum: &Stratum, model: &LightModel, bvh: &Bvh, place: Vec3) -> Self {
        let source = &stratum.source;
        let mean =
            luminance(source.radiance) * source.solid_angle_sr / stratum.extent_sr.max(f32::MIN_POSITIVE);
        let (_, along) = sent_along(source.direction, model, bvh, place);
        if along >= ENOUGH * mean {
            return Self::along(stratum, model, bvh, place);
        }
        let cap = DistantSource { solid_angle_sr: REACH * stratum.extent_sr, ..*source };
        let mut by_face: BTreeMap<Option<u32>, Vec<(Vec3, f32)>> = BTreeMap::new();
        for i in 0..RAYS {
            let direction = in_cap(cap.direction, cap.angular_radius(), Shift::new(0, 0).point(i));
            let (face, sent) = sent_along(direction, model, bvh, place);
            by_face.entry(face).or_default().push((direction, sent));
        }
        let sent = |rays: &Vec<(Vec3, f32)>| rays.iter().map(|ray| ray.1).sum::<f32>();
        let main = by_face.into_values().max_by(|a, b| sent(a).total_cmp(&sent(b))).unwrap_or_default();
        let centre: Vec3 = main.iter().map(|(direction, sent)| *direction * *sent).sum();
        let near = |direction: &Vec3| direction.dot(centre);
        let direction = main.into_iter().map(|ray| ray.0).max_by(|a, b| near(a).total_cmp(&near(b)));
        let lit = direction.filter(|_| centre != Vec3::ZERO).unwrap_or(cap.direction);
        let source = DistantSource { direction: lit, ..*source };
        Self::along(&Stratum { source, ..*stratum }, model, bvh, place)
    }

    /// On the front of the surface that is seen along the stratum's direction from `place` (m), at infinity where there is
    /// none.
    pub(crate) fn along(stratum: &Stratum, model: &LightModel, bvh: &Bvh, place: Vec3) -> Self {
        let (mut light, source) = (Self::of_stratum(stratum), &stratum.source);
        let Some(hit) = bvh.closest(place, source.direction, 0.0, f32::INFINITY) else { return light };
        let normal = model.mesh.normal(hit.triangle as usize);
        let cosine = -normal.dot(source.direction);
        if cosine <= 0.0 {
            return light;
        }
        let cosine = cosine.max(LEAST_COSINE);
        let spread = source.solid_angle_sr * hit.t * hit.t / cosine / PI;
        light.origin = ShadowOrigin::Point(place + source.direction * hit.t + normal * BEFORE_M);
        light.near = Some(Near { normal, reference: cosine / (hit.t * hit.t + spread), spread });
        light
    }

    /// Of a light on the model's surfaces: the normal of its surface, what its strength is over at the environment's
    /// place, and A/π of its stratum, m².
    pub(crate) fn patch(&self) -> Option<(Vec3, f32, f32)> {
        self.near.map(|near| (near.normal, near.reference, near.spread))
    }

    /// Unit direction towards the light at a position (m), and its irradiance there over `power`.
    pub fn seen_from(&self, position: Vec3) -> (Vec3, f32) {
        let (origin, near) = match (self.origin, self.near) {
            (ShadowOrigin::Point(origin), Some(near)) => (origin, near),
            (ShadowOrigin::Point(origin), None) => return ((origin - position).normalize_or_zero(), 1.0),
            (ShadowOrigin::Direction(direction), _) => return (direction, 1.0),
        };
        let to = origin - position;
        let direction = to.normalize_or_zero();
        let cosine = -near.normal.dot(direction);
        (direction, (cosine / (to.length_squared() + near.spread) / near.reference).max(0.0))
    }

    /// Whether a scene hides the light from a position that lies off its surfaces.
    pub fn hidden_by(&self, scene: &Bvh, position: Vec3) -> bool {
        self.origin.hidden_by(scene, position)
    }
}

/// The face that is seen in a direction, and the luminance that it sends from its front; of the distant light, where there is none.
fn sent_along(direction: Vec3, model: &LightModel, bvh: &Bvh, place: Vec3) -> (Option<u32>, f32) {
    let Some(hit) = bvh.closest(place, direction, 0.0, f32::INFINITY) else {
        let covers = |s: &&DistantSource| s.direction.dot(direction) >= s.angular_radius().cos();
        return (None, model.distant.iter().filter(covers).map(|s| luminance(s.radiance)).sum());
    };
    let patch = &model.mesh.patches[hit.triangle as usize];
    let front = model.mesh.normal(hit.triangle as usize).dot(direction) < 0.0;
    (Some(patch.face), if front { luminance(patch.radiance) } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illuminate::patch::PatchMesh;
    use crate::image::{Image, Radiance};
    use crate::synthetic::face;
    use proptest::prelude::*;

    fn total(sources: &[DistantSource], channel: usize) -> f64 {
        sources.iter().map(|s| f64::from(s.radiance[channel]) * f64::from(s.solid_angle_sr)).sum()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn lights_keep_all_power_and_the_whole_sphere(
            count in 1usize..120, lamp in 0usize..32 * 16, bright in 1.0..1e5f32, tilt in 0.0..1.0f32,
        ) {
            let environment = Image::from_fn(32, 16, |x, y| {
                let base = 1.0 + tilt * (x as f32 * 0.7).sin();
                Radiance([if y * 32 + x == lamp { bright } else { base }, base, 0.5 * y as f32])
            });
            let exact = |c: usize| texels(&environment).iter().map(|t| t.power[c]).sum::<f64>();
            for sampling in [LightSampling::Structured, LightSampling::MedianCut] {
                let lights: Vec<_> = sample(&environment, count, sampling).iter().map(|s| s.source).collect();
                prop_assert!(lights.len() == count, "{} {:?} for {}", lights.len(), sampling, count);
                for c in 0..3 {
                    prop_assert!((total(&lights, c) / exact(c) - 1.0).abs() < 1e-5, "{:?}", sampling);
                }
                let sphere: f64 = lights.iter().map(|l| f64::from(l.solid_angle_sr)).sum();
                prop_assert!((sphere / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn darkness_has_no_lights() {
        let black = Image::from_fn(16, 8, |_, _| Radiance::default());
        for sampling in [LightSampling::Structured, LightSampling::MedianCut] {
            assert!(sample(&black, 10, sampling).is_empty());
        }
    }

    #[test]
    fn a_lamps_light_stands_on_the_lamp_and_not_on_the_wall_behind() {
        let mut mesh = PatchMesh::default();
        face(&mut mesh, Vec3::new(-4.0, 3.0, -4.0), Vec3::X * 8.0, Vec3::Z * 8.0, 1.0, |_| [0.01; 3]);
        face(&mut mesh, Vec3::new(0.1, 1.5, 0.05), Vec3::X * 0.33, Vec3::Z * 0.27, 0.3, |_| [100.0; 3]);
        let model = LightModel { mesh, distant: vec![] };
        let bvh = Bvh::new(&model.mesh.vertices, &model.mesh.triangles());
        let environment = Environment::cast(&model, &bvh, Vec3::ZERO, 48, 24);
        let all: f64 = environment.power().iter().sum();
        let on_lamp = |light: &Light| {
            let near = |at: Vec3| (at.y - 1.5).abs() < 0.01;
            matches!(light.origin, ShadowOrigin::Point(at) if near(at))
        };
        let mut least: f64 = 1.0;
        for sampling in [LightSampling::Structured, LightSampling::MedianCut] {
            for count in [4, 30, 300] {
                let strata = sample(&environment.map, count, sampling);
                let share = |place: &dyn Fn(&Stratum) -> Light| {
                    let lights = strata.iter().map(place).filter(on_lamp);
                    lights.map(|l| f64::from(luminance(l.power))).sum::<f64>() / all
                };
                let found = share(&|s| Light::on_model(s, &model, &bvh, Vec3::ZERO));
                assert!(found > 0.98, "{count} {sampling:?}: {found}");
                least = least.min(share(&|s| Light::along(s, &model, &bvh, Vec3::ZERO)));
            }
        }
        assert!(least < 0.9, "what is seen along the middle may be the wall: {least}");
    }

    #[test]
    fn light_from_beyond_the_model_is_not_put_on_the_frame_of_its_window() {
        let mut mesh = PatchMesh::default();
        face(&mut mesh, Vec3::new(-0.01, 2.0, -1.0), Vec3::X * 0.02, Vec3::Z * 2.0, 0.5, |_| [0.01; 3]);
        let direction = Vec3::Y;
        let sky = DistantSource { direction, solid_angle_sr: 0.02, radiance: [2.0; 3] };
        let model = LightModel { mesh, distant: vec![sky] };
        let bvh = Bvh::new(&model.mesh.vertices, &model.mesh.triangles());
        let stratum = Stratum { source: sky, extent_sr: 0.02 };
        let place = |light: Light| matches!(light.origin, ShadowOrigin::Direction(_));
        assert!(place(Light::on_model(&stratum, &model, &bvh, Vec3::ZERO)));
        assert!(!place(Light::along(&stratum, &model, &bvh, Vec3::ZERO)), "the frame stands in the middle");
    }

    #[test]
    fn a_near_light_is_weaker_farther_away_and_one_at_infinity_is_not() {
        let mut mesh = PatchMesh::default();
        face(&mut mesh, Vec3::new(-1.0, 2.0, -1.0), Vec3::X * 2.0, Vec3::Z * 2.0, 0.5, |_| [1.0; 3]);
        let model = LightModel { mesh, distant: vec![] };
        let bvh = Bvh::new(&model.mesh.vertices, &model.mesh.triangles());
        let up = DistantSource { direction: Vec3::Y, solid_angle_sr: 0.01, radiance: [2.0; 3] };
        let up = Stratum { source: up, extent_sr: 0.01 };
        let lamp = Light::on_model(&up, &model, &bvh, Vec3::ZERO);
        assert!((lamp.seen_from(Vec3::ZERO).1 - 1.0).abs() < 1e-3);
        let (direction, gain) = lamp.seen_from(Vec3::Y * -2.0);
        assert!((gain - 0.25).abs() < 0.01 && direction.dot(Vec3::Y) > 0.999, "{gain}");
        assert!(
            !lamp.hidden_by(&bvh, Vec3::ZERO) && lamp.seen_from(Vec3::Y * 3.0).1 == 0.0,
            "no light behind it"
        );
        let sky = Light::on_model(
            &Stratum { source: DistantSource { direction: Vec3::X, ..up.source }, ..up },
            &model,
            &bvh,
            Vec3::ZERO,
        );
        assert_eq!(sky.origin, ShadowOrigin::Direction(Vec3::X));
        assert_eq!(sky.seen_from(Vec3::Y * -2.0), (Vec3::X, 1.0));
    }
}

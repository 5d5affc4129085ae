//! Lamps that the probe shows hardly larger than it blurs. The picture has part of their light beside them, on what stands
//! behind, and shows their border mixed with it. All that light is theirs: it is summed over their image and its blur, less
//! what shines from around, and divided by the solid angle in which the model shows them. They stand where the probe shows
//! them: marks in one picture leave their depth open to a few centimetres, and that would move their shadows.

use super::build::SHINES;
use super::gather::Gather;
use super::patch::{DistantSource, PatchMesh};
use crate::image::luminance;
use crate::probe::{Environment, latlong};
use crate::visibility::Bvh;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// The image of a point reaches so many standard deviations of the blur: it is made of pixels, which end.
pub(super) const REACH: f64 = 3.0;
/// A lamp whose radius is larger than so many standard deviations, or texels, is measured where it is seen.
const SMALL: f64 = 6.0;
/// Rays along each side of a texel.
const SUB: usize = 4;
/// What is brighter than this share of a lamp's surroundings may lie beside it.
const BRIGHTEST: f64 = 0.9;
/// This share of a lamp's surroundings must be shown.
const SHOWN: f64 = 0.8;

/// What a primitive looks like from the probe.
struct Image {
    /// Texels with the share that shows it.
    texels: Vec<(usize, f64)>,
    solid_angle: f64,
}

/// A lamp as the probe has it.
pub(super) struct Lamp {
    /// Radiance of its faces, by face.
    pub faces: BTreeMap<u32, [f32; 3]>,
    /// From where the model has it to where the probe shows it, across the line of sight, m.
    pub offset: Vec3,
}

/// Of the small lamps that the environment shows the one that sends most. One by one, since what stands beside a lamp shows
/// its light, too, until that is known. `primitives` has each face's primitive, `known` faces are left alone, and `probe_blur`
/// is the angular standard deviation with which the probe shows a point, rad.
pub(super) fn strongest(
    mesh: &PatchMesh,
    bvh: &Bvh,
    distant: &[DistantSource],
    env: &Environment,
    primitives: &[usize],
    known: &BTreeMap<u32, [f32; 3]>,
    probe_blur: impl Fn(Vec3) -> f64,
) -> Option<Lamp> {
    let mean = env.power() / (4.0 * PI);
    let bright = |radiance: &[f64; 3]| f64::from(luminance(radiance.map(|l| l as f32)));
    let mut bright_ones: Vec<(usize, Seen, f64)> = images(mesh, bvh, env, primitives)
        .into_iter()
        .filter(|(primitive, _)| known.keys().all(|face| primitives[*face as usize] != *primitive))
        .filter_map(|(primitive, image)| {
            let seen = seen(env, &image, &probe_blur)?;
            let power = image.solid_angle * bright(&seen.radiance);
            (bright(&seen.least) > f64::from(SHINES) * mean).then_some((primitive, seen, power))
        })
        .collect();
    if bright_ones.is_empty() {
        return None;
    }
    bright_ones.sort_by(|a, b| b.2.total_cmp(&a.2));
    let irradiance = Gather::new(mesh, distant, bvh, |_| true).irradiance(mesh);
    let shines = |(primitive, seen, _): &(usize, Seen, f64)| {
        let patches =
            (0..mesh.patches.len()).filter(|i| primitives[mesh.patches[*i].face as usize] == *primitive);
        let (sent, received) = patches.fold((0.0, 0.0), |(sent, received), i| {
            let area = f64::from(mesh.area(i));
            (sent + PI * area * bright(&seen.least), received + area * f64::from(luminance(irradiance[i])))
        });
        sent > f64::from(SHINES) * received
    };
    let (lamp, seen, _) = bright_ones.into_iter().find(shines)?;
    let (mut middle, mut area) = (Vec3::ZERO, 0.0);
    for i in (0..mesh.patches.len()).filter(|i| primitives[mesh.patches[*i].face as usize] == lamp) {
        middle += mesh.centroid(i) * mesh.area(i);
        area += mesh.area(i);
    }
    let distance = (middle / area).distance(env.origin[env.texel(seen.middle)]);
    let own = (0..primitives.len()).filter(|face| primitives[*face] == lamp);
    let faces = own.map(|face| (face as u32, seen.radiance.map(|l| l as f32))).collect();
    Some(Lamp { faces, offset: (seen.centroid - seen.middle) * distance })
}

/// Images of all primitives that are seen.
fn images(mesh: &PatchMesh, bvh: &Bvh, env: &Environment, primitives: &[usize]) -> BTreeMap<usize, Image> {
    let (w, h) = env.size();
    let hits: Vec<Vec<usize>> = (0..w * h)
        .into_par_iter()
        .map(|i| {
            let rays = (0..SUB * SUB).filter_map(|s| {
                let at = |c: usize, k: usize| c as f32 + (k as f32 + 0.5) / SUB as f32;
                let d = latlong::direction(at(i % w, s % SUB), at(i / w, s / SUB), w, h);
                let hit = bvh.closest(env.origin[i], d, 0.0, f32::MAX)?.triangle as usize;
                (mesh.normal(hit).dot(d) < 0.0).then(|| primitives[mesh.patches[hit].face as usize])
            });
            rays.collect()
        })
        .collect();
    let mut images: BTreeMap<usize, Image> = BTreeMap::new();
    for (i, hits) in hits.iter().enumerate() {
        let mut shares: BTreeMap<usize, f64> = BTreeMap::new();
        hits.iter().for_each(|p| *shares.entry(*p).or_default() += 1.0 / (SUB * SUB) as f64);
        for (primitive, share) in shares {
            let image = images.entry(primitive).or_insert(Image { texels: Vec::new(), solid_angle: 0.0 });
            image.texels.push((i, share));
            image.solid_angle += share * env.solid_angle(i);
        }
    }
    images
}

/// What the environment shows of a primitive.
struct Seen {
    /// Mean over the solid angle in which the model shows it.
    radiance: [f64; 3],
    /// The same if all that lies beside it were as bright as what is brightest around it: a leg before the border of a
    /// sunlit floor is not to shine.
    least: [f64; 3],
    /// Directions of its middle by the model, and of its light by the environment.
    middle: Vec3,
    centroid: Vec3,
}

/// Measures an image, if it is small beside the blur and its surroundings are seen.
fn seen(env: &Environment, image: &Image, probe_blur: impl Fn(Vec3) -> f64) -> Option<Seen> {
    let directions: Vec<Vec3> = image.texels.iter().map(|(i, _)| env.direction(*i)).collect();
    let shown = |(i, share): &(usize, f64)| env.direction(*i) * (share * env.solid_angle(*i)) as f32;
    let middle = image.texels.iter().map(shown).sum::<Vec3>().try_normalize()?;
    let radius = directions.iter().map(|d| f64::from(d.angle_between(middle))).fold(0.0, f64::max);
    let blur = probe_blur(middle);
    let (w, h) = env.size();
    let texel = PI / h as f64;
    if radius > SMALL * blur.max(texel) {
        return None;
    }
    let reach = REACH * blur + texel;
    let (mut power, mut shown, mut all, mut around) = ([0.0; 3], 0.0, 0.0, Vec::new());
    let mut within = Vec::new();
    for i in 0..w * h {
        let d = env.direction(i);
        if f64::from(d.angle_between(middle)) > radius + 2.0 * reach {
            continue;
        }
        let nearest = directions.iter().map(|c| d.distance_squared(*c)).fold(f32::MAX, f32::min);
        let (distance, angle) = (f64::from(nearest).sqrt(), env.solid_angle(i));
        let is_seen = env.weight[i] > 0.5;
        if distance < reach {
            all += angle;
            if is_seen {
                within.push(i);
                shown += angle;
                (0..3).for_each(|k| power[k] += angle * f64::from(env.radiance.pixels()[i].0[k]));
            }
        } else if distance < 2.0 * reach && is_seen {
            around.push(env.radiance.pixels()[i].0);
        }
    }
    if shown < SHOWN * all || around.is_empty() {
        return None;
    }
    // What shines from around stands for what the lamp hides, too.
    let back = |share: f64| {
        [0, 1, 2].map(|k| {
            let mut values: Vec<f32> = around.iter().map(|l| l[k]).collect();
            let at = (values.len() as f64 * share) as usize;
            f64::from(*values.select_nth_unstable_by(at, f32::total_cmp).1)
        })
    };
    let beside = (shown - image.solid_angle).max(0.0);
    let own =
        |back: [f64; 3]| std::array::from_fn(|k| (power[k] - back[k] * beside).max(0.0) / image.solid_angle);
    let (least, back) = (own(back(BRIGHTEST)), back(0.5));
    let radiance = own(back);
    let dark = f64::from(luminance(back.map(|l| l as f32)));
    let moment = |i: &usize| {
        let above = f64::from(env.radiance.pixels()[*i].luminance()) - dark;
        env.direction(*i) * (above.max(0.0) * env.solid_angle(*i)) as f32
    };
    let centroid = within.iter().map(moment).sum::<Vec3>().try_normalize()?;
    Some(Seen { radiance, least, middle, centroid })
}

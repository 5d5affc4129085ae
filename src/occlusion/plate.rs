//! The shadow on the plate: of the light that the scene leaves, what the object takes besides.
//!
//! ε(x) = B(x) Σ_l E_l(x) (V⁰_l(x) − V¹_l(x)) / E(x), with E_l the irradiance of rectangle l by its form factor, V⁰ and V¹ its
//! visibility in the scene without and with the object, E the irradiance of all light. What the scene already hides divides
//! out: E_l V⁰ is what arrives, V¹ / V⁰ the share that the object leaves of it.

use super::{Frustum, Mask, OcclusionTextures, RectangularLight, Slices, find, given};
use crate::config::Render;
use crate::image::{RadianceImage, luminance};
use crate::shadow::{Occluder, Pixel, Prepared, Problem, Removed, Scene};
use crate::transfer::sampling::Shift;
use crate::visibility::Bvh;
use glam::{Affine3A, Vec2, Vec3};
use rayon::prelude::*;

/// Rays start and end so far off surfaces, m.
const OFFSET_M: f32 = 1e-3;

/// The method `occlusion-textures`, prepared for a scene.
pub struct PlateShadow<'a> {
    scene: Scene<'a>,
    settings: Render,
    prepared: Prepared,
    triangles: Vec<[u32; 3]>,
    lights: Vec<RectangularLight>,
    /// Share of the receivers' light that is not from the rectangles.
    left_out_share: f64,
}

impl<'a> PlateShadow<'a> {
    /// Finds the lights, or takes those that the settings give.
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        check(settings)?;
        let prepared = Prepared::new(scene, settings)?;
        let mesh = &scene.light.mesh;
        let lights =
            if settings.area_lights.is_empty() { find(mesh)? } else { given(&settings.area_lights, mesh)? };
        let left_out_share = left_out(&prepared.pixels, &lights);
        Ok(Self {
            scene: *scene,
            settings: settings.clone(),
            prepared,
            triangles: mesh.triangles(),
            lights,
            left_out_share,
        })
    }

    /// The rectangles, strongest first where they were found.
    pub fn lights(&self) -> &[RectangularLight] {
        &self.lights
    }

    /// ε of an object. Scene and object are drawn anew: the slices follow the object.
    pub fn frame(&self, occluder: &Occluder) -> Result<Removed, Problem> {
        occluder.check()?;
        let cuts = self.cuts(occluder);
        let textures = Self::textures(&cuts);
        Ok(self.sum(&cuts, textures, |cut, near| self.sliced(occluder, cut, near)))
    }

    /// The same by so many rays from each pixel to each rectangle: what slices cost is the difference.
    pub fn traced(&self, occluder: &Occluder, rays: usize) -> Result<Removed, Problem> {
        occluder.check()?;
        let scene = Bvh::new(&self.scene.light.mesh.vertices, &self.triangles);
        let object = Bvh::new(&occluder.vertices, &occluder.triangles);
        let taken = |light: &RectangularLight, pixel: &Pixel| {
            let from = pixel.position + pixel.normal * OFFSET_M;
            let shift = Shift::new(self.settings.seed, u64::from(pixel.index));
            let hidden = (0..rays as u32).filter(|&i| {
                let to = light.at(shift.point(i)) + light.normal() * OFFSET_M;
                object.occluded(from, to) && !scene.occluded(from, to)
            });
            hidden.count() as f32 / rays.max(1) as f32
        };
        let of =
            |cut: &Cut, near: &[&Pixel]| near.par_iter().map(|p| taken(&self.lights[cut.light], p)).collect();
        Ok(self.sum(&self.cuts(occluder), 0, of))
    }

    /// Before each light of which the object may take something.
    pub(crate) fn cuts(&self, occluder: &Occluder) -> Vec<Cut> {
        let pixels = &self.prepared.pixels;
        let cut = |(number, light): (usize, &RectangularLight)| {
            let reach = Reach::new(light, occluder);
            let near: Vec<usize> =
                (0..pixels.len()).into_par_iter().filter(|&i| reach.holds(pixels[i].position)).collect();
            let far = near.iter().map(|&i| reach.coordinates(pixels[i].position).z).fold(0.0, f32::max);
            let frustum = Frustum::fit(light, near.iter().map(|&i| pixels[i].position));
            let slices = Slices::around([reach.low.z, reach.high.z], far, self.settings.slices);
            (!near.is_empty()).then_some(Cut { light: number, near, frustum, slices })
        };
        self.lights.iter().enumerate().filter_map(cut).collect()
    }

    /// Number of textures that they take, without the object and with it.
    pub(crate) fn textures(cuts: &[Cut]) -> usize {
        cuts.iter().map(|cut| 2 * cut.slices.count()).sum()
    }

    /// Sums over the lights. `taken` gives the share of each that the object takes from some pixels.
    fn sum(&self, cuts: &[Cut], textures: usize, taken: impl Fn(&Cut, &[&Pixel]) -> Vec<f32>) -> Removed {
        let pixels = &self.prepared.pixels;
        let mut blocked = vec![[0.0; 3]; pixels.len()];
        for cut in cuts {
            let light = &self.lights[cut.light];
            let seen: Vec<&Pixel> = cut.near.iter().map(|&i| &pixels[i]).collect();
            let sent: Vec<[f32; 3]> = seen
                .par_iter()
                .zip(&taken(cut, &seen))
                .map(|(pixel, &share)| match share {
                    0.0 => [0.0; 3],
                    _ => light.irradiance(pixel.position, pixel.normal).map(|e| e * share),
                })
                .collect();
            for (&i, sent) in cut.near.iter().zip(sent) {
                (0..3).for_each(|c| blocked[i][c] += sent[c]);
            }
        }
        self.removed(self.prepared.epsilon(self.scene.plate, &blocked), textures)
    }

    /// No error is expected in numbers: it is a bias (occlusion of different slices that is not independent, contact within
    /// a slice, light that is no rectangle), the same for any two halves of the slices or texels, so that nothing here
    /// differs by it. What is known is the share of light that is left out.
    pub(crate) fn removed(&self, epsilon: RadianceImage, textures: usize) -> Removed {
        Removed {
            epsilon,
            codes: None,
            noise: None,
            sources_used: self.lights.len(),
            passes: self.lights.len(),
            shadow_maps: textures,
            expected_error: None,
            left_out_share: self.left_out_share,
        }
    }

    /// V⁰ − V¹ of the pixels that the object may shadow.
    fn sliced(&self, occluder: &Occluder, cut: &Cut, near: &[&Pixel]) -> Vec<f32> {
        let (settings, Cut { frustum, slices, .. }) = (&self.settings, cut);
        let draw = |vertices: &[Vec3], triangles: &[[u32; 3]]| {
            let mask = Mask::draw(frustum, slices, settings.occlusion_px, vertices, triangles);
            if settings.close_leaks { mask.closed() } else { mask }
        };
        let without = draw(&self.scene.light.mesh.vertices, &self.triangles);
        let with = draw(&occluder.vertices, &occluder.triangles).with(&without);
        let [without, with] = [without, with]
            .map(|mask| OcclusionTextures::new(frustum, slices, &mask, settings.occlusion_filter));
        let visible = |textures: &OcclusionTextures, pixel: &Pixel| {
            textures.visibility(pixel.position, settings.combination)
        };
        near.par_iter().map(|p| (visible(&without, p) - visible(&with, p)).max(0.0)).collect()
    }

    pub(crate) fn prepared(&self) -> &Prepared {
        &self.prepared
    }

    pub(crate) fn scene(&self) -> &Scene<'a> {
        &self.scene
    }

    /// Of the scene.
    pub(crate) fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    pub(crate) fn settings(&self) -> &Render {
        &self.settings
    }
}

/// How the space between a light and the pixels that an object may shadow is cut.
pub(crate) struct Cut {
    /// Which light.
    pub light: usize,
    /// Numbers of those pixels, ascending; they set frustum and slices.
    pub near: Vec<usize>,
    pub frustum: Frustum,
    pub slices: Slices,
}

/// What an object may hide a light from.
struct Reach {
    light_from_world: Affine3A,
    /// Box around the object in the light's coordinates.
    low: Vec3,
    high: Vec3,
}

impl Reach {
    fn new(light: &RectangularLight, occluder: &Occluder) -> Self {
        let light_from_world = light.light_from_world();
        let corners = occluder.triangles.iter().flatten();
        let points = corners.map(|&v| light_from_world.transform_point3(occluder.vertices[v as usize]));
        let (low, high) = points.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), q| (a.min(q), b.max(q)));
        Self { light_from_world, low, high }
    }

    fn coordinates(&self, position: Vec3) -> Vec3 {
        self.light_from_world.transform_point3(position)
    }

    /// Whether the box around the part at the object's depths of the pyramid from a point to the light meets the object's.
    fn holds(&self, position: Vec3) -> bool {
        let q = self.coordinates(position);
        let (near, far) = (self.low.z.max(0.0), self.high.z.min(q.z));
        if near >= far {
            return false;
        }
        // At a depth the pyramid spans the light's square, shrunk and moved.
        let section = |depth: f32| {
            let share = (q.z - depth) / q.z;
            let middle = q.truncate() * (1.0 - share);
            (middle - share, middle + share)
        };
        let ((a, b), (c, d)) = (section(near), section(far));
        let (low, high): (Vec2, Vec2) = (a.min(c), b.max(d));
        low.cmple(self.high.truncate()).all() && high.cmpge(self.low.truncate()).all()
    }
}

/// Share of the receivers' light (luminance of irradiance) that no rectangle sends. What the scene hides of them is not
/// known here: at no pixel do they count for more than all light.
fn left_out(pixels: &[Pixel], lights: &[RectangularLight]) -> f64 {
    let sums = pixels.par_iter().map(|p| {
        let sent = lights.iter().map(|l| luminance(l.irradiance(p.position, p.normal))).sum::<f32>();
        let all = luminance(p.irradiance);
        [f64::from(all), f64::from(sent.min(all))]
    });
    let [all, sent] = sums.reduce(|| [0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
    if all > 0.0 { 1.0 - sent / all } else { 0.0 }
}

fn check(settings: &Render) -> Result<(), Problem> {
    let refuse = |name, value: usize, range| Err(Problem::Setting { name, value: value.to_string(), range });
    if !(1..=super::MOST_SLICES).contains(&settings.slices) {
        return refuse("slices", settings.slices, "between 1 and 16");
    }
    let side = settings.occlusion_px;
    if !(side.is_power_of_two() && (16..=4096).contains(&side)) {
        return refuse("occlusion_px", side, "a power of two between 16 and 4096");
    }
    Ok(())
}

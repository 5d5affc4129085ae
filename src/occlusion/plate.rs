//! The shadow on the plate: of the light that the scene leaves, what the object takes besides.
//!
//! ε(x) = B(x) Σ_l E_l(x) (V⁰_l(x) − V¹_l(x)) / E(x), with E_l the irradiance of rectangle l by its form factor, V⁰ and V¹ its
//! visibility in the scene without and with the object, E the irradiance of all light. What the scene already hides divides
//! out: E_l V⁰ is what arrives, V¹ / V⁰ the share that the object leaves of it.

use super::{Frustum, Mask, OcclusionTextures, RectangularLight, Slices, find, given};
use crate::config::Render;
use crate::image::luminance;
use crate::shadow::{Occluder, Pixel, Prepared, Problem, Removed, Scene};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

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
        let mut blocked = vec![[0.0; 3]; self.prepared.pixels.len()];
        let mut textures = 0;
        for light in &self.lights {
            textures += self.block(light, occluder, &mut blocked);
        }
        Ok(Removed {
            epsilon: self.prepared.epsilon(self.scene.plate, &blocked),
            codes: None,
            noise: None,
            sources_used: self.lights.len(),
            passes: self.lights.len(),
            shadow_maps: textures,
            expected_error: None,
            left_out_share: self.left_out_share,
        })
    }

    /// Adds the irradiance that the object takes of one light; gives the number of textures made.
    fn block(&self, light: &RectangularLight, occluder: &Occluder, blocked: &mut [[f32; 3]]) -> usize {
        let span = Span::of(light, occluder);
        let pixels = &self.prepared.pixels;
        let near: Vec<usize> =
            (0..pixels.len()).into_par_iter().filter(|&i| span.may_hide(light, &pixels[i])).collect();
        let far = near.iter().map(|&i| light.from_world(pixels[i].position).z).fold(0.0, f32::max);
        if near.is_empty() {
            return 0;
        }
        let frustum = Frustum::fit(*light, near.iter().map(|&i| pixels[i].position));
        let slices = Slices::around([span.low.z, span.high.z], far, self.settings.slices);
        let draw = |vertices: &[Vec3], triangles: &[[u32; 3]]| {
            let mask = Mask::draw(&frustum, &slices, self.settings.occlusion_px, vertices, triangles);
            if self.settings.close_leaks { mask.closed() } else { mask }
        };
        let without = draw(&self.scene.light.mesh.vertices, &self.triangles);
        let with = draw(&occluder.vertices, &occluder.triangles).with(&without);
        let textures = [without, with]
            .map(|m| OcclusionTextures::new(frustum, slices.clone(), &m, self.settings.occlusion_filter));
        let rule = self.settings.combination;
        let taken: Vec<f32> = near
            .par_iter()
            .map(|&i| {
                let [without, with] = [0, 1].map(|k| textures[k].visibility(pixels[i].position, rule));
                (without - with).max(0.0)
            })
            .collect();
        for (i, taken) in near.into_iter().zip(taken).filter(|(_, taken)| *taken > 0.0) {
            let sent = light.irradiance(pixels[i].position, pixels[i].normal);
            (0..3).for_each(|c| blocked[i][c] += sent[c] * taken);
        }
        2 * slices.count()
    }
}

/// Box around an object in a light's coordinates.
struct Span {
    low: Vec3,
    high: Vec3,
}

impl Span {
    fn of(light: &RectangularLight, occluder: &Occluder) -> Self {
        let used =
            occluder.triangles.iter().flatten().map(|&v| light.from_world(occluder.vertices[v as usize]));
        let (low, high) = used.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), q| (a.min(q), b.max(q)));
        Self { low, high }
    }

    /// Whether the pyramid from a pixel to the light meets the box around the pyramid's part at the object's depths.
    fn may_hide(&self, light: &RectangularLight, pixel: &Pixel) -> bool {
        let q = light.from_world(pixel.position);
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

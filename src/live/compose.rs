//! A frame from end to end: pose, light, maps, shadow buffer, object, composite.
//!
//! The real scene (§V.D, phantom objects) loses the share that the shadow buffer R has of its irradiance: B (1 − R / E). The
//! object shows I = (d − s) + sp (eq. 4), with d from the irradiance map and sp from the reflective environment map (§IV).

use super::lighting::Picture;
use super::{Lighting, Phantoms, Problem, Sight, Tracked, Tracker};
use crate::calibrate::grey;
use crate::camera::{Camera, Intrinsics};
use crate::composite::composite;
use crate::config::{self, Setup};
use crate::dome::{self, CubeMap, DomeMaps, Layout, Pose, above, irradiance, lights, strongest};
use crate::image::{Code, CodeImage, Image, Radiance, RadianceImage};
use crate::render::{Layer, Object, Sample, Scene, motions, render_with};
use crate::response::Response;
use crate::shadow::Occluder;
use crate::subtractive::{Surface, pixel_angle};
use crate::visibility::Bvh;
use glam::{Affine3A, Quat, Vec3};
use nalgebra::Point2;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::f32::consts::PI;
use std::time::Instant;

/// Codes from here on are clipped.
const CLIPPED: f32 = 0.985;
/// Side of a tile whose pixels are looked up together, px.
const TILE: usize = 16;
/// Sides of the irradiance map, and of the environment that it is made from, texels.
const IRRADIANCE: usize = 12;
const COARSE: usize = 8;

/// Times of a frame, ms.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Timing {
    /// Markers and pose.
    pub pose: f64,
    /// Environment.
    pub light: f64,
    /// Lights and shadow maps.
    pub maps: f64,
    /// Shadow buffer on the scene.
    pub shadow: f64,
    /// Object and composite.
    pub object: f64,
}

/// A frame with the object.
pub struct Output {
    /// As the camera would have stored it.
    pub picture: CodeImage,
    /// In linear radiance.
    pub radiance: RadianceImage,
    /// The camera.
    pub tracked: Tracked,
    /// Lights that cast shadows, and maps drawn.
    pub lights: usize,
    /// Maps drawn in this frame.
    pub drawn: usize,
    /// What has changed, to be said.
    pub notices: Vec<String>,
    /// What it took.
    pub timing: Timing,
}

/// A live scene.
pub struct Live {
    settings: config::Render,
    response: Response,
    tracker: Tracker,
    lighting: Lighting,
    phantoms: Phantoms,
    object: Object,
    caster: Occluder,
    motions: Vec<Affine3A>,
    distance_m: f32,
    most_lights: Option<usize>,
    maps: DomeMaps,
    split: BTreeSet<dome::Cell>,
    environment: Option<CubeMap>,
    sight: Option<Sight>,
    unlit: Option<dome::Problem>,
    seen: usize,
    frame: usize,
    size: (usize, usize),
    second: Option<(usize, usize)>,
}

impl Live {
    /// For frames of some sizes (px): of the scene's camera, and of the second one where there is one.
    pub fn new(
        settings: &config::Pipeline,
        response: Response,
        object: Object,
        phantoms: Phantoms,
        size: (usize, usize),
        second: Option<(usize, usize)>,
    ) -> Result<Self, Problem> {
        let live = &settings.live;
        if live.focal_px <= 0.0 {
            return Err(Problem::NotGiven("focal_px"));
        }
        if live.setup != Setup::OneCamera && live.environment.is_none() {
            return Err(Problem::NotGiven("environment"));
        }
        if live.setup != Setup::OneCamera && live.environment.as_ref().is_some_and(|e| e.focal_px <= 0.0) {
            return Err(Problem::NotGiven("environment.focal_px"));
        }
        let mut intrinsics = Intrinsics::pinhole(size.0 as u32, size.1 as u32, live.focal_px);
        intrinsics.distortion = live.distortion;
        if let Some(centre) = live.principal_point_px {
            intrinsics.principal_point_px = centre;
        }
        let tracker = Tracker::new(live, intrinsics)?;
        let lighting = Lighting::new(live, &settings.probe, tracker.layout(), second)
            .map_err(|problem| Problem::NoEnvironment { frames: 1, problem })?;
        let motions = motions(&settings.render)
            .map_err(|e| Problem::Setting { name: "path", what: format!("of [render]: {e}") })?;
        Ok(Self {
            settings: settings.render.clone(),
            response,
            tracker,
            lighting,
            phantoms,
            // Whole: what it hides of itself shows where a simpler one departs from it.
            caster: Occluder { vertices: object.vertices.clone(), triangles: object.triangles.clone() },
            object,
            motions,
            distance_m: live.environment_distance_m,
            most_lights: live.most_lights,
            maps: DomeMaps::new(settings.render.shadow_map_px, live.maps_per_frame),
            split: BTreeSet::new(),
            environment: None,
            sight: None,
            unlit: None,
            seen: 0,
            frame: 0,
            size,
            second,
        })
    }

    /// The dome's lights and maps as they are.
    pub fn maps(&self) -> &DomeMaps {
        &self.maps
    }

    /// Puts the object into the next frame.
    pub fn frame(&mut self, frame: &CodeImage, second: Option<&CodeImage>) -> Result<Output, Problem> {
        for (found, first) in [(Some(frame), Some(self.size)), (second, self.second)] {
            if let (Some(found), Some(first)) = (found, first)
                && found.size() != first
            {
                return Err(Problem::Size { frame: self.frame, size: found.size(), first });
            }
        }
        let mut clock = Clock::start();
        let mut timing = Timing::default();
        let mut notices = Vec::new();
        let scene = self.linear(frame);
        let tracked = self.tracker.follow(&grey(frame), &scene.radiance)?;
        notices.extend(self.sighted(tracked.sight));
        timing.pose = clock.lap();
        if let (Some(camera), Sight::Seen(_)) = (&tracked.camera, tracked.sight) {
            self.seen += 1;
            let second = second.map(|s| self.linear(s));
            match self.lighting.follow(&scene, camera, second.as_ref()) {
                Ok(environment) => {
                    let back = self
                        .unlit
                        .take()
                        .map(|_| format!("frame {}: the environment is seen again", self.frame));
                    notices.extend(back);
                    self.environment = Some(environment);
                }
                Err(problem) => {
                    if self.unlit.replace(problem).is_none() {
                        let kept = if self.environment.is_some() {
                            "the last light is kept"
                        } else {
                            "there is no light yet"
                        };
                        notices.push(format!("frame {}: {problem}; {kept}", self.frame));
                    }
                }
            }
        }
        timing.light = clock.lap();
        let motion = match self.motions.len() {
            0 => Affine3A::IDENTITY,
            n => self.motions[self.frame.min(n - 1)],
        };
        self.frame += 1;
        let (Some(camera), Some(environment), true) =
            (&tracked.camera, &self.environment, tracked.opacity > 0.0)
        else {
            let picture = frame.clone();
            let radiance = scene.radiance;
            return Ok(Output { picture, radiance, tracked, lights: 0, drawn: 0, notices, timing });
        };
        let [low, high] = self.object.bounds();
        let anchor = motion.transform_point3((low + high) / 2.0);
        let mut dome = lights(environment, Layout::of(&self.settings), &mut self.split);
        if self.distance_m > 0.0 {
            let from = self.lighting.place() - anchor;
            let seen = |d: Vec3| (from + d * self.distance_m).try_normalize().unwrap_or(d);
            dome.iter_mut().for_each(|l| l.source.direction = seen(l.source.direction));
        }
        let dome = above(dome, self.phantoms.normals());
        let all: Vec<[f32; 3]> = self.phantoms.normals().iter().map(|n| irradiance(&dome, *n)).collect();
        let dome = match self.most_lights {
            Some(count) => strongest(dome, count),
            None => dome,
        };
        let pose = Pose { anchor, turn: Quat::from_mat3a(&motion.matrix3) };
        let mut caster = self.caster.clone();
        caster.vertices.iter_mut().for_each(|v| *v = motion.transform_point3(*v));
        let drawn = self.maps.update(&dome, &caster, pose);
        timing.maps = clock.lap();
        let removed = self.shadow(camera, &scene.radiance, &all, tracked.opacity);
        timing.shadow = clock.lap();
        let layer = self.render(camera, environment, &self.object.moved(&motion), tracked.opacity);
        let radiance = composite(&scene.radiance, &removed, &layer)
            .map_or_else(|_| scene.radiance.clone(), |composite| composite.radiance);
        let stored = frame.pixels().iter().zip(scene.radiance.pixels()).zip(radiance.pixels());
        // What did not change keeps its code.
        let code = |((code, before), after): ((&Code, &Radiance), &Radiance)| {
            if before == after { *code } else { Code(self.response.code_of(after.0)) }
        };
        let picture = Image::from_pixels(frame.width(), frame.height(), stored.map(code).collect());
        timing.object = clock.lap();
        Ok(Output { picture, radiance, tracked, lights: dome.len(), drawn, notices, timing })
    }

    /// Refuses a film in which nothing could be done.
    pub fn finish(&self) -> Result<(), Problem> {
        match (self.frame, self.seen, &self.environment, self.unlit) {
            (0, ..) => Err(Problem::Empty),
            (frames, 0, ..) => Err(Problem::NoMarkers { frames }),
            (frames, _, None, Some(problem)) => Err(Problem::NoEnvironment { frames, problem }),
            _ => Ok(()),
        }
    }

    /// What is to be said of the markers.
    fn sighted(&mut self, sight: Sight) -> Option<String> {
        let before = self.sight.replace(sight);
        let frame = self.frame;
        match (before, sight) {
            (Some(Sight::Held(_) | Sight::Fading(_) | Sight::Gone), Sight::Seen(count)) => {
                Some(format!("frame {frame}: {count} markers are seen again"))
            }
            (_, Sight::Held(1)) => Some(format!("frame {frame}: no marker is seen; the last pose is held")),
            (Some(Sight::Held(_) | Sight::Seen(_)), Sight::Fading(lost)) => {
                Some(format!("frame {frame}: no marker was seen in {lost} frames; the object fades"))
            }
            (Some(Sight::Fading(_)), Sight::Gone) => {
                Some(format!("frame {frame}: the object is gone until a marker is seen"))
            }
            (None, Sight::Gone) => Some(format!("frame {frame}: no marker is seen yet")),
            _ => None,
        }
    }

    fn linear(&self, frame: &CodeImage) -> Picture {
        Picture {
            radiance: frame.map(|c| Radiance(self.response.exposure_of(c.0))),
            clipped: frame.map(|c| c.0.iter().any(|v| *v >= CLIPPED)),
        }
    }

    /// What leaves the scene: B R / E, with E by normal.
    fn shadow(
        &self,
        camera: &Camera,
        plate: &RadianceImage,
        all: &[[f32; 3]],
        opacity: f32,
    ) -> RadianceImage {
        let (width, height) = plate.size();
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let pixel_rad = pixel_angle(camera);
        let tiles: Vec<Vec<(usize, Radiance)>> = (0..columns * rows)
            .into_par_iter()
            .map(|tile| {
                let (left, top) = (tile % columns * TILE, tile / columns * TILE);
                let (mut at, mut surfaces, mut normals) = (Vec::new(), Vec::new(), Vec::new());
                for (y, x) in (top..height.min(top + TILE))
                    .flat_map(|y| (left..width.min(left + TILE)).map(move |x| (y, x)))
                {
                    let (origin, direction) = ray(camera, x, y);
                    let Some((position, normal)) = self.phantoms.seen(origin, direction) else { continue };
                    at.push(y * width + x);
                    normals.push(normal);
                    let n = self.phantoms.normals()[normal];
                    let pixel_m = origin.distance(position) * pixel_rad;
                    surfaces.push(Surface {
                        position,
                        normal: n,
                        face_normal: n,
                        viewer: -direction,
                        material: 0,
                        pixel_m,
                    });
                }
                let gone = self.maps.shadow_buffer(&surfaces);
                let removed = |((i, normal), gone): ((usize, usize), [f32; 3])| {
                    let share = |k: usize| {
                        if all[normal][k] > 0.0 { (gone[k] / all[normal][k]).min(1.0) } else { 0.0 }
                    };
                    (i, Radiance([0, 1, 2].map(|k| opacity * share(k) * plate.pixels()[i].0[k])))
                };
                at.into_iter().zip(normals).zip(gone).map(removed).collect()
            })
            .collect();
        let mut removed = Image::from_fn(width, height, |_, _| Radiance::default());
        for (i, radiance) in tiles.into_iter().flatten() {
            removed.pixels_mut()[i] = radiance;
        }
        removed
    }

    /// The object: I = (d − s) + sp, with s what the object and real things hide.
    fn render(&self, camera: &Camera, environment: &CubeMap, object: &Object, opacity: f32) -> Layer {
        let coarse = environment.downsampled(environment.side() / COARSE);
        let irradiance = CubeMap::from_fn(IRRADIANCE, |normal| coarse.irradiance(normal));
        let mirrored: Vec<CubeMap> =
            object.materials.iter().map(|m| gloss(environment, m.shininess)).collect();
        let bvh = Bvh::new(&object.vertices, &object.triangles);
        let scene = Scene::new(object, &bvh);
        // What the ball sees of a real thing is light from that thing, which no other hides by standing there.
        let place = self.lighting.place();
        let free = |d: Vec3| !self.phantoms.bvh.any_hit(place, d, 1e-4, f32::INFINITY);
        let open: Vec<bool> = self.maps.lights().map(|l| free(l.source.direction)).collect();
        let radiance = |samples: &[Sample]| {
            // What is hidden changes little within a pixel.
            let middle = Surface::of_object(&samples[samples.len() / 2], 0.0);
            let from = middle.position + middle.face_normal * scene.offset;
            let hidden =
                |i: usize, d: Vec3| open[i] && self.phantoms.bvh.any_hit(from, d, 0.0, f32::INFINITY);
            let s = self.maps.own_shadow_buffer(&middle, hidden);
            let mut sum = [0.0f32; 3];
            for sample in samples {
                let material = &object.materials[sample.material as usize];
                let d = irradiance.bilinear(sample.normal);
                let mirror = sample.view - sample.normal * (2.0 * sample.view.dot(sample.normal));
                let sp = match material.is_specular() {
                    true => mirrored[sample.material as usize].bilinear(mirror),
                    false => [0.0; 3],
                };
                for k in 0..3 {
                    let diffuse = material.diffuse[k] / PI * (d[k] - s[k]).max(0.0);
                    sum[k] += (diffuse + material.specular[k] * sp[k]) / samples.len() as f32;
                }
            }
            sum
        };
        let (side, seed) = (self.settings.antialiasing, self.settings.seed);
        let rendered =
            render_with(&scene, camera, &self.phantoms.bvh, side, seed, |_, samples, _| radiance(samples));
        let layer = rendered.layer;
        Layer {
            colour: layer.colour.map(|c| Radiance(c.0.map(|v| v * opacity))),
            coverage: layer.coverage.map(|a| (a * opacity).min(1.0)),
            depth: layer.depth,
        }
    }
}

/// The environment as wide as a Phong lobe: texels of the lobe's solid angle, 4π/(n + 1).
fn gloss(environment: &CubeMap, shininess: f32) -> CubeMap {
    let side = (1.5 * (shininess + 1.0)).sqrt() / 3f32.sqrt();
    let fits =
        |factor: &usize| environment.side() as f32 / *factor as f32 >= side && environment.side() > *factor;
    let factor = [1, 2, 4, 8, 16].into_iter().filter(fits).max().unwrap_or(1);
    environment.downsampled(factor)
}

fn ray(camera: &Camera, x: usize, y: usize) -> (Vec3, Vec3) {
    let ray = camera.ray(&Point2::new(x as f64 + 0.5, y as f64 + 0.5));
    let (o, d) = (ray.origin, ray.direction);
    (Vec3::new(o.x as f32, o.y as f32, o.z as f32), Vec3::new(d.x as f32, d.y as f32, d.z as f32))
}

struct Clock(Instant);

impl Clock {
    fn start() -> Self {
        Self(Instant::now())
    }

    /// Since the last lap, ms.
    fn lap(&mut self) -> f64 {
        let now = Instant::now();
        1e3 * (now - std::mem::replace(&mut self.0, now)).as_secs_f64()
    }
}

//! A frame from end to end: pose, light, maps, shadow buffer, object, composite.

use super::lighting::Picture;
use super::object::render;
use super::shadow::Dome;
use super::{Lighting, Phantoms, Problem, Sight, Tracked, Tracker};
use crate::calibrate::grey;
use crate::camera::Intrinsics;
use crate::composite::composite;
use crate::config::{self, Setup};
use crate::dome::{self, CubeMap, DomeMaps, Layout, Pose, above, lights, strongest};
use crate::image::{Code, CodeImage, Image, Radiance, RadianceImage};
use crate::render::{Object, motions};
use crate::response::Response;
use crate::shadow::Occluder;
use glam::{Affine3A, Quat, Vec3};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::time::Instant;

/// Codes from here on are clipped.
const CLIPPED: f32 = 0.985;
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
    most_lights: Option<usize>,
    maps: DomeMaps,
    split: BTreeSet<dome::Cell>,
    environment: Option<CubeMap>,
    /// Whether that is given and not looked for.
    known: bool,
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
            most_lights: live.most_lights,
            maps: DomeMaps::new(settings.render.shadow_map_px, live.maps_per_frame),
            split: BTreeSet::new(),
            environment: None,
            known: false,
            sight: None,
            unlit: None,
            seen: 0,
            frame: 0,
            size,
            second,
        })
    }

    /// Light that is known, as it is seen from where the ball or the lens stands: from now on neither is looked at.
    pub fn light(&mut self, environment: CubeMap) {
        (self.environment, self.known) = (Some(environment), true);
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
        self.seen += usize::from(matches!(tracked.sight, Sight::Seen(_)));
        if let (Some(camera), Sight::Seen(_), false) = (&tracked.camera, tracked.sight, self.known) {
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
        let environment = &self.lighting.seen_from(environment, anchor);
        let dome = lights(environment, Layout::of(&self.settings), &mut self.split);
        let dome = above(dome, self.phantoms.normals());
        let with_maps = match self.most_lights {
            Some(count) => strongest(dome.clone(), count),
            None => dome.clone(),
        };
        let pose = Pose { anchor, turn: Quat::from_mat3a(&motion.matrix3) };
        let mut caster = self.caster.clone();
        caster.vertices.iter_mut().for_each(|v| *v = motion.transform_point3(*v));
        let drawn = self.maps.update(&with_maps, &caster, pose);
        timing.maps = clock.lap();
        // What the ball sees of a real thing is light from that thing, which no other hides by standing there.
        let beyond = |d: Vec3| {
            let shown = self.lighting.shown(anchor, d);
            !self.phantoms.bvh.any_hit(self.lighting.place(), shown, 1e-4, f32::INFINITY)
        };
        let dome = Dome::new(&self.phantoms, &self.maps, &dome, beyond);
        let removed = dome.removed(camera, &scene.radiance, tracked.opacity);
        timing.shadow = clock.lap();
        let quality = (self.settings.antialiasing, self.settings.seed);
        let object = self.object.moved(&motion);
        let layer = render(&dome, camera, environment, &object, tracked.opacity, quality);
        let radiance = composite(&scene.radiance, &removed, &layer)
            .map_or_else(|_| scene.radiance.clone(), |composite| composite.radiance);
        // What did not change keeps its code.
        let code = |i: usize| match (&frame.pixels()[i], &scene.radiance.pixels()[i], &radiance.pixels()[i]) {
            (code, before, after) if before == after => *code,
            (_, _, after) => Code(self.response.code_of(after.0)),
        };
        let codes = (0..frame.pixels().len()).into_par_iter().map(code).collect();
        let picture = Image::from_pixels(frame.width(), frame.height(), codes);
        timing.object = clock.lap();
        Ok(Output { picture, radiance, tracked, lights: with_maps.len(), drawn, notices, timing })
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
            radiance: frame.par_map(|c| Radiance(self.response.exposure_of(c.0))),
            clipped: frame.par_map(|c| c.0.iter().any(|v| *v >= CLIPPED)),
        }
    }
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

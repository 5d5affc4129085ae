//! A session: everything static stays, the object moves, and the number of passes follows what was asked (Gibson et al.
//! 2003, §8).

use super::plan::Outlook;
use super::{Occluder, Problem, RadianceTransfer, Removed, Scene, raytraced};
use crate::config::{Backend, Render, ShadowMethod};
use crate::dome::LightDome;
use crate::gpu::{self, Twin};
use crate::occlusion::PlateShadow;
use crate::subtractive::Subtractive;
use std::time::Instant;

/// A shadow method, prepared for a scene.
pub struct Session<'a> {
    settings: Render,
    method: Method<'a>,
    pace: Pace,
}

/// ε of one occluder after the other.
type Frames<'a> = dyn FnMut(&Occluder) -> Result<Removed, Problem> + 'a;

enum Method<'a> {
    Cpu(Box<RadianceTransfer<'a>>),
    Gpu(Box<gpu::RadianceTransfer<'a>>),
    /// One whose passes are its own affair.
    Other(Box<Frames<'a>>),
}

/// A frame of a session.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// What leaves the plate.
    pub removed: Removed,
    /// What it took, s.
    pub seconds: f64,
}

impl<'a> Session<'a> {
    /// Prepares the method and back end that the settings name.
    pub fn prepare(scene: &Scene<'a>, settings: &Render) -> Result<Self, Problem> {
        let method = match (settings.method, settings.backend) {
            // Codes are subtracted on the CPU alone.
            (ShadowMethod::RadianceTransfer, Backend::Cpu) | (ShadowMethod::RadianceTransferLdr, _) => {
                Method::Cpu(Box::new(RadianceTransfer::prepare(scene, settings)?))
            }
            (ShadowMethod::RadianceTransfer, Backend::Gpu) => {
                Method::Gpu(Box::new(gpu::RadianceTransfer::prepare(scene, settings)?))
            }
            (ShadowMethod::Subtractive, Backend::Cpu) => {
                let mut method = Subtractive::prepare(scene, settings)?;
                Method::Other(Box::new(move |occluder| method.frame(occluder)))
            }
            (ShadowMethod::Subtractive, Backend::Gpu) => twin(gpu::Subtractive::prepare(scene, settings)?),
            (ShadowMethod::OcclusionTextures, Backend::Cpu) => {
                let method = PlateShadow::prepare(scene, settings)?;
                Method::Other(Box::new(move |occluder| method.frame(occluder)))
            }
            (ShadowMethod::OcclusionTextures, Backend::Gpu) => {
                twin(gpu::OcclusionTextures::prepare(scene, settings)?)
            }
            (ShadowMethod::LightDome, Backend::Cpu) => {
                let method = LightDome::prepare(scene, settings)?;
                Method::Other(Box::new(move |occluder| method.frame(occluder)))
            }
            (ShadowMethod::LightDome, Backend::Gpu) => twin(gpu::LightDome::prepare(scene, settings)?),
            (ShadowMethod::Raytraced, _) => {
                let (scene, settings) = (*scene, settings.clone());
                Method::Other(Box::new(move |occluder| raytraced(&scene, occluder, &settings)))
            }
        };
        Ok(Self { settings: settings.clone(), method, pace: Pace::default() })
    }

    /// ε for an object, with as many passes as the settings ask for: `passes`, or the fewest that `max_error` allows, or
    /// as many as earlier frames say can be done in `frame_ms`. Where several of them are set, the smallest number holds.
    pub fn frame(&mut self, occluder: &Occluder) -> Result<Frame, Problem> {
        let started = Instant::now();
        let Self { settings, pace, .. } = self;
        let removed = match &mut self.method {
            Method::Other(frame) => frame(occluder)?,
            Method::Cpu(method) => {
                occluder.check()?;
                let outlook = method.outlook(occluder);
                let passes = passes(settings, pace, method, &outlook);
                let planned = started.elapsed().as_secs_f64();
                let removed = method.compose(occluder, &outlook, passes);
                pace.learn(planned, started.elapsed().as_secs_f64() - planned, removed.passes);
                removed
            }
            Method::Gpu(method) => {
                occluder.check()?;
                let outlook = method.plain().outlook(occluder);
                let passes = passes(settings, pace, method.plain(), &outlook);
                let planned = started.elapsed().as_secs_f64();
                let removed = method.compose(occluder, &outlook, passes)?;
                pace.learn(planned, started.elapsed().as_secs_f64() - planned, removed.passes);
                removed
            }
        };
        Ok(Frame { removed, seconds: started.elapsed().as_secs_f64() })
    }
}

fn twin<'a>(mut method: impl Twin + 'a) -> Method<'a> {
    Method::Other(Box::new(move |occluder| method.removed_radiance(occluder)))
}

fn passes(settings: &Render, pace: &Pace, method: &RadianceTransfer, outlook: &Outlook) -> usize {
    let all = outlook.sources().max(1);
    let mut passes = if settings.passes == 0 { all } else { settings.passes.min(all) };
    if settings.max_error > 0.0 {
        passes = fewest(passes, |n| method.expected_error(outlook, n) <= settings.max_error);
    }
    if settings.frame_ms > 0.0 {
        passes = passes.min(pace.passes(settings.frame_ms * 1e-3));
    }
    passes
}

/// The least n in `1..=most` that is enough, or `most`; whoever is enough stays it when n grows.
fn fewest(most: usize, enough: impl Fn(usize) -> bool) -> usize {
    let mut high = 1;
    while high < most && !enough(high) {
        high *= 2;
    }
    let (mut low, mut high) = (high / 2, high.min(most));
    while high - low > 1 {
        let middle = (low + high) / 2;
        if enough(middle) { high = middle } else { low = middle }
    }
    high
}

/// What passes cost, from the frames so far.
#[derive(Debug, Clone, Copy, Default)]
struct Pace {
    /// Before the first pass, s.
    planning: f64,
    /// Each pass, s; 0: nothing known.
    pass: f64,
}

/// Passes of a first frame, about whose cost nothing is known.
const FIRST_PASSES: usize = 16;
/// Share of the last frame in what is known.
const NEWS: f64 = 0.5;

impl Pace {
    fn learn(&mut self, planning: f64, passing: f64, passes: usize) {
        let pass = passing / passes.max(1) as f64;
        let share = if self.pass > 0.0 { NEWS } else { 1.0 };
        self.planning += share * (planning - self.planning);
        self.pass += share * (pass - self.pass);
    }

    /// As many as fit into a time, s; at least one.
    fn passes(&self, seconds: f64) -> usize {
        if self.pass <= 0.0 {
            return FIRST_PASSES;
        }
        (((seconds - self.planning) / self.pass) as usize).max(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_fewest_are_found(most in 1usize..5000, threshold in 1usize..6000) {
            prop_assert_eq!(fewest(most, |n| n >= threshold), threshold.min(most));
        }

        #[test]
        fn passes_settle_where_the_time_is_met(planning in 0.0..0.01f64, pass in 1e-5..1e-2f64, wanted in 0.02..1.0f64) {
            let mut pace = Pace::default();
            let mut passes = 0;
            for _ in 0..6 {
                passes = pace.passes(wanted);
                pace.learn(planning, pass * passes as f64, passes);
            }
            let time = planning + pass * passes as f64;
            prop_assert!(time <= wanted * 1.000001 && time + pass * 1.01 >= wanted, "{} for {}", time, wanted);
        }
    }
}

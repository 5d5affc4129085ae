//! Frames of an object that moves while everything else stays.

use super::{Object, Set, Shaded, check_placement};
use crate::error::{Context as _, Result};
use crate::shadow::{self, Caster, Occluder, Removed, Session};
use crate::subtractive::Pace;
use glam::{Affine3A, Vec3};
use std::time::Instant;

/// A scene and an object, ready to be put together at any place.
pub struct Frames<'a> {
    set: Set<'a>,
    session: Session<'a>,
    object: &'a Object,
    caster: Caster,
    faces: &'a [Vec3],
    /// Of the object's shading.
    pace: Pace,
}

/// The object at a place.
pub struct Frame {
    /// What it takes from the plate.
    pub removed: Removed,
    /// What it shows, and what it adds to the plate.
    pub shaded: Shaded,
    /// What may look wrong.
    pub warnings: Vec<String>,
    /// Time of its shadow, s.
    pub shadow_s: f64,
    /// Time of its shading and of its light on the scene, s.
    pub shade_s: f64,
}

impl<'a> Frames<'a> {
    /// Prepares the shadow method. `faces` are the corners of the scene model's faces, m.
    pub fn prepare(
        shadows: &shadow::Scene<'a>,
        set: Set<'a>,
        object: &'a Object,
        faces: &'a [Vec3],
    ) -> Result<Self> {
        let session = Session::prepare(shadows, set.settings).doing("preparing the shadow method")?;
        let occluder = Occluder { vertices: object.vertices.clone(), triangles: object.triangles.clone() };
        let caster = Caster::of(&occluder, set.settings);
        Ok(Self { set, session, object, caster, faces, pace: Pace::default() })
    }

    /// What casts the shadow.
    pub fn caster(&self) -> &Caster {
        &self.caster
    }

    /// The object where the settings place it.
    pub fn first(&mut self) -> Result<Frame> {
        self.at(&Affine3A::IDENTITY, |part| part.into())
    }

    /// Frame `i` of the path: the object moved (rigidly) from where the settings place it.
    pub fn of_path(&mut self, i: usize, motion: &Affine3A) -> Result<Frame> {
        self.at(motion, |_| format!("rendering frame {i} of the path"))
    }

    fn at(&mut self, motion: &Affine3A, doing: impl Fn(&str) -> String) -> Result<Frame> {
        let object = self.object.moved(motion);
        let warnings = check_placement(&object, self.set.camera, self.faces, self.set.scene_bvh)
            .doing(doing("placing the object in the scene"))?;
        let shadow =
            self.session.frame(&self.caster.moved(motion).occluder).doing(doing("finding the shadow"))?;
        let started = Instant::now();
        let shaded = self.set.shade(&object, &shadow.removed.epsilon, &mut self.pace);
        let shade_s = started.elapsed().as_secs_f64();
        Ok(Frame { removed: shadow.removed, shaded, warnings, shadow_s: shadow.seconds, shade_s })
    }
}

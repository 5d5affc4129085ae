//! Distant light that is too small and strong for harmonics of second order, which would smear it over the sphere and
//! ring: the sun. It is kept out of the volume and added where irradiance is looked up, with a shadow ray.

use crate::illuminate::patch::DistantSource;
use crate::image::luminance;
use crate::sh;
use crate::visibility::Bvh;
use glam::Vec3;

/// A beam comes from within this solid angle, sr (a cap of 5°) …
const MAX_SR: f32 = 0.024;
/// … and carries this share of all distant light.
const MIN_SHARE: f32 = 0.05;
/// Shadow rays start at this distance, m: the object may touch the scene.
const START_M: f32 = 1e-3;

/// Splits distant light into beams and the rest.
pub fn split(distant: &[DistantSource]) -> (Vec<DistantSource>, Vec<DistantSource>) {
    let power = |s: &DistantSource| luminance(s.radiance) * s.solid_angle_sr;
    let all: f32 = distant.iter().map(power).sum();
    distant.iter().copied().partition(|s| s.solid_angle_sr < MAX_SR && power(s) > MIN_SHARE * all)
}

/// The beams among distant light, and the scene that may hide them.
pub struct Beams<'a> {
    sources: Vec<DistantSource>,
    scene: &'a Bvh,
}

impl<'a> Beams<'a> {
    /// Of the light model's distant sources; `scene` holds the surfaces that cast shadows.
    pub fn new(distant: &[DistantSource], scene: &'a Bvh) -> Self {
        Self { sources: Self::sources(distant), scene }
    }

    /// The beams among distant light.
    pub fn sources(distant: &[DistantSource]) -> Vec<DistantSource> {
        split(distant).0
    }

    /// Whether nothing of the scene stands between two points.
    pub(super) fn sees(&self, from: Vec3, to: Vec3) -> bool {
        !self.scene.any_hit(from, to - from, 0.0, 1.0)
    }

    /// Irradiance on a surface of unit `normal`, plate units.
    pub fn irradiance(&self, position: Vec3, normal: Vec3) -> [f32; 3] {
        let mut sum = [0.0; 3];
        for s in &self.sources {
            let share = normal.dot(s.direction) * s.solid_angle_sr;
            if share > 0.0 && !self.scene.any_hit(position, s.direction, START_M, f32::MAX) {
                (0..3).for_each(|k| sum[k] += share * s.radiance[k]);
            }
        }
        sum
    }

    /// Harmonics of the beams' radiance at a point.
    pub fn harmonics(&self, position: Vec3) -> sh::Coefficients {
        let seen = |s: &&DistantSource| !self.scene.any_hit(position, s.direction, START_M, f32::MAX);
        let beams = self.sources.iter().filter(seen);
        sh::project(beams.map(|s| (s.direction, s.radiance, f64::from(s.solid_angle_sr))))
    }
}

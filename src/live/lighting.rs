//! The light of a moment: the environment that a ball or a lens shows, in the units of the scene's camera.
//!
//! What joins the cameras is the markers' white paper. Places of it that both see give the gains between them (exposure and
//! white balance). Where the second sees none, as a lens that looks up, its environment is scaled so that the paper gets the
//! light that it shows. Light that is clipped in a ball's picture, a lamp mostly, is raised to what the paper gets besides
//! ([`Clipped`]).

use super::Layout;
use super::clipped::{Clipped, Paper, Place};
use crate::calibrate::world_from_grid;
use crate::camera::{Camera, Intrinsics};
use crate::config::{self, Setup};
use crate::dome::{self, CubeMap, Fisheye, SphereMap};
use crate::image::{Image, RadianceImage};
use crate::probe::fisheye::Projection;
use glam::{Mat3, Vec3};
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::f32::consts::PI;

/// Side of the cube map, texels.
const SIDE: usize = 32;
/// Side of the cube that is summed up at every place of the paper.
const COARSE: usize = 8;
/// Fewest places of white paper that say anything.
const LEAST_PLACES: usize = 4;

/// A picture in linear radiance, and where it is clipped.
pub struct Picture {
    /// Relative exposure, 1 where a channel saturates.
    pub radiance: RadianceImage,
    /// Whether a channel is.
    pub clipped: Image<bool>,
}

enum View {
    /// The scene's own camera sees the ball.
    Own,
    Ball {
        camera: Camera,
        map: SphereMap,
    },
    Fisheye {
        map: SphereMap,
    },
}

/// Follows the light.
pub struct Lighting {
    view: View,
    ball: (Point3<f64>, f64),
    from: Place,
    reflectivity: [f32; 3],
    paper: [f32; 3],
    white: Vec<Point3<f64>>,
    clipped: Clipped,
}

impl Lighting {
    /// For the set-up of the settings; `second` is the size of the second camera's frames, px.
    pub fn new(
        settings: &config::Live,
        probe: &config::Probe,
        layout: &Layout,
        second: Option<(usize, usize)>,
    ) -> Result<Self, dome::Problem> {
        let place = |[x, y, z]: [f64; 3]| world_from_grid() * Point3::new(x, y, z);
        let centre = place(settings.ball_centre_m);
        let view = match (settings.setup, &settings.environment, second) {
            (Setup::TwoCameras, Some(environment), Some(size)) => {
                let camera = fixed(environment, size);
                let distance_m = f64::from(settings.environment_distance_m);
                let map = SphereMap::of_ball(&camera, &centre, probe.radius_m, distance_m)?;
                View::Ball { camera, map }
            }
            (Setup::Fisheye, Some(environment), Some(size)) => {
                View::Fisheye { map: SphereMap::of_fisheye(&lens(environment, size), size) }
            }
            _ => View::Own,
        };
        let (at, radius_m) = match (settings.setup, &settings.environment) {
            (Setup::Fisheye, Some(environment)) => (place(environment.position_m), 0.0),
            _ => (centre, probe.radius_m as f32),
        };
        Ok(Self {
            view,
            ball: (centre, probe.radius_m),
            from: Place { centre: vec3(&at), distance_m: settings.environment_distance_m, radius_m },
            reflectivity: probe.reflectivity.map(|r| r as f32),
            paper: settings.paper,
            white: layout.white().iter().map(|p| place([p.x, p.y, 0.0])).collect(),
            clipped: Clipped::new(),
        })
    }

    /// Where the environment is seen from, m.
    pub fn place(&self) -> Vec3 {
        self.from.centre
    }

    /// The environment as it is seen from another place, m.
    pub fn seen_from(&self, environment: &CubeMap, place: Vec3) -> CubeMap {
        match self.from.distance_m > 0.0 {
            true => environment.seen_from(place - self.from.centre, self.from.distance_m),
            false => environment.clone(),
        }
    }

    /// The direction in which the environment's picture shows what lies in a direction from another place, m.
    pub fn shown(&self, place: Vec3, direction: Vec3) -> Vec3 {
        let Place { centre, distance_m, .. } = self.from;
        let by = place - centre;
        let along = by.dot(direction);
        let squared = along * along + distance_m * distance_m - by.length_squared();
        match distance_m > 0.0 && squared > 0.0 {
            true => (by + direction * (squared.sqrt() - along)).normalize_or(direction),
            false => direction,
        }
    }

    /// The environment of a frame, in the scene's units. `camera` is the scene's.
    pub fn follow(
        &mut self,
        scene: &Picture,
        camera: &Camera,
        second: Option<&Picture>,
    ) -> Result<CubeMap, dome::Problem> {
        let white = white(&self.white, scene, camera);
        let from_ball = self.reflectivity.map(|r| 1.0 / r);
        let (seen, gain) = match (&self.view, second) {
            (View::Ball { camera, map }, Some(picture)) => {
                let there = self::white(&self.white, picture, camera);
                let seen = map.environment(&picture.radiance, &picture.clipped, SIDE);
                (seen, ratio(&white, &there).map(|r| [0, 1, 2].map(|k| from_ball[k] * r[k])))
            }
            (View::Fisheye { map }, Some(picture)) => {
                (map.environment(&picture.radiance, &picture.clipped, SIDE), None)
            }
            _ => {
                let (centre, radius_m) = self.ball;
                let distance_m = f64::from(self.from.distance_m);
                let map = SphereMap::of_ball(camera, &centre, radius_m, distance_m)?;
                (map.environment(&scene.radiance, &scene.clipped, SIDE), Some(from_ball))
            }
        };
        // What the white paper shows is what it gets.
        let gets = |(i, w): (usize, [f32; 3])| Paper {
            place: vec3(&self.white[i]),
            irradiance: [0, 1, 2].map(|k| PI * w[k] / self.paper[k]),
        };
        let paper: Vec<Paper> = white.into_iter().map(gets).collect();
        let scaled = |cube: &CubeMap, by: [f32; 3]| cube.map(|l| [0, 1, 2].map(|k| l[k] * by[k]));
        if paper.len() < LEAST_PLACES {
            return Ok(scaled(&seen.cube, gain.unwrap_or([1.0; 3])));
        }
        Ok(match gain {
            Some(gain) => {
                let everywhere: Vec<Vec3> = self.white.iter().map(vec3).collect();
                let [all, clipped] = [&seen.cube, &seen.clipped].map(|cube| scaled(cube, gain));
                self.clipped.raised(&all, &clipped, &paper, &everywhere, &self.from)
            }
            None => {
                let coarse = seen.cube.downsampled(SIDE / COARSE);
                let given: Vec<[f32; 3]> = paper.iter().map(|p| self.given(&coarse, p.place)).collect();
                let by = |k: usize| {
                    let shares =
                        paper.iter().zip(&given).map(|(p, given)| p.irradiance[k] / given[k].max(1e-6));
                    middle(shares.collect())
                };
                scaled(&seen.cube, [0, 1, 2].map(by))
            }
        })
    }

    /// Irradiance that an environment gives to a place of the paper.
    fn given(&self, environment: &CubeMap, to: Vec3) -> [f32; 3] {
        let mut sum = [0.0; 3];
        for (i, radiance) in environment.texels().iter().enumerate() {
            let (direction, solid_angle) = environment.texel(i);
            let gives = solid_angle as f32 * self.from.gives(direction, to);
            (0..3).for_each(|k| sum[k] += radiance.0[k] * gives);
        }
        sum
    }
}

/// Places of white paper, by number, that a picture shows unclipped.
fn white(places: &[Point3<f64>], picture: &Picture, camera: &Camera) -> Vec<(usize, [f32; 3])> {
    let (w, h) = picture.radiance.size();
    let shown = |(i, place): (usize, &Point3<f64>)| {
        let p = camera.project(place)?;
        let inside = p.x >= 1.0 && p.y >= 1.0 && p.x < w as f64 - 1.0 && p.y < h as f64 - 1.0;
        (inside && !picture.clipped.at(p.x as usize, p.y as usize))
            .then(|| (i, picture.radiance.bilinear(p.x, p.y).0))
    };
    places.iter().enumerate().filter_map(shown).filter(|(_, w)| w.iter().all(|v| *v > 1e-4)).collect()
}

/// How much brighter places are in one picture than in another, in the middle of those that both show.
fn ratio(here: &[(usize, [f32; 3])], there: &[(usize, [f32; 3])]) -> Option<[f32; 3]> {
    let both = here.iter().filter_map(|(i, a)| Some((a, &there.iter().find(|(j, _)| i == j)?.1)));
    let both: Vec<_> = both.collect();
    let by = |k: usize| middle(both.iter().map(|(a, b)| a[k] / b[k]).collect());
    (both.len() >= LEAST_PLACES).then(|| [0, 1, 2].map(by))
}

/// The median.
fn middle(mut values: Vec<f32>) -> f32 {
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(1.0)
}

fn vec3(p: &Point3<f64>) -> Vec3 {
    Vec3::new(p.x as f32, p.y as f32, p.z as f32)
}

/// Pose of a fixed camera, +Z to its target, +Y down in its picture.
fn pose(environment: &config::EnvironmentCamera) -> Isometry3<f64> {
    let world = world_from_grid();
    let (eye, target) = (Point3::from(environment.position_m), Point3::from(environment.target_m));
    let forward = (world * (target - eye)).try_normalize(1e-12).unwrap_or(Vector3::y());
    let up = world * Vector3::from(environment.up);
    let right = forward.cross(&up).try_normalize(1e-12).unwrap_or(Vector3::x());
    let down = forward.cross(&right);
    let rotation = Rotation3::from_basis_unchecked(&[right, down, forward]);
    let eye = world * eye;
    Isometry3::from_parts(Translation3::from(eye.coords), UnitQuaternion::from_rotation_matrix(&rotation))
}

fn fixed(environment: &config::EnvironmentCamera, (width, height): (usize, usize)) -> Camera {
    let mut intrinsics = Intrinsics::pinhole(width as u32, height as u32, environment.focal_px);
    intrinsics.distortion = environment.distortion;
    if let Some(centre) = environment.principal_point_px {
        intrinsics.principal_point_px = centre;
    }
    Camera { intrinsics, world_from_camera: pose(environment) }
}

fn lens(environment: &config::EnvironmentCamera, (width, height): (usize, usize)) -> Fisheye {
    let rotation = pose(environment).rotation.to_rotation_matrix();
    let axis = |k: usize| {
        let c = rotation.matrix().column(k);
        Vec3::new(c[0] as f32, c[1] as f32, c[2] as f32)
    };
    Fisheye {
        projection: Projection::Equidistant,
        focal_px: environment.focal_px,
        centre_px: environment.principal_point_px.unwrap_or([width as f64 / 2.0, height as f64 / 2.0]),
        half_field: environment.field_deg.to_radians() / 2.0,
        world_from_camera: Mat3::from_cols(axis(0), axis(1), axis(2)),
    }
}

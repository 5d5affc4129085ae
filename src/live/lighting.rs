//! The light of a moment: the environment that a ball or a lens shows, in the units of the scene's camera.
//!
//! What joins the cameras is the markers' white paper. Where both see it, its colours give the gains between them (exposure and
//! white balance). Where the second does not, as a lens that looks up, its environment is scaled so that the paper gets the
//! light that it shows. Light that is clipped in a ball's picture, a lamp mostly, is raised to what the paper gets besides;
//! what is clipped anew gets what is new.

use super::Layout;
use crate::calibrate::world_from_grid;
use crate::camera::{Camera, Intrinsics};
use crate::config::{self, Setup};
use crate::dome::{self, CubeMap, Fisheye, Seen, SphereMap};
use crate::image::{Image, RadianceImage};
use crate::probe::fisheye::Projection;
use glam::{Mat3, Vec3};
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::f32::consts::PI;

/// Side of the cube map, texels.
const SIDE: usize = 32;
/// Side of the cube on which it is noted how much brighter clipped light is than it looks.
const CELLS: usize = 8;
/// Clipped light within this angle (cosine) of what was clipped before is the same light.
const SAME_LIGHT: f32 = 0.92;
/// A light that was not seen clipped for so many frames is forgotten.
const FORGOTTEN: usize = 10;
/// Share by which known boosts follow a small misfit in a frame; a large one is followed at once.
const FOLLOW: f32 = 0.2;
const LARGE: f32 = 0.15;
const MOST_BOOST: f32 = 1e4;

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

/// A part of the sky whose light is clipped.
#[derive(Clone, Copy)]
struct Boost {
    by: [f32; 3],
    seen: usize,
}

/// Follows the light.
pub struct Lighting {
    view: View,
    ball: (Point3<f64>, f64),
    distance_m: f64,
    place: Point3<f64>,
    reflectivity: [f32; 3],
    paper: [f32; 3],
    white: Vec<Point3<f64>>,
    boosts: Vec<Option<Boost>>,
    frame: usize,
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
        Ok(Self {
            view,
            ball: (centre, probe.radius_m),
            distance_m: f64::from(settings.environment_distance_m),
            place: match (settings.setup, &settings.environment) {
                (Setup::Fisheye, Some(environment)) => place(environment.position_m),
                _ => centre,
            },
            reflectivity: probe.reflectivity.map(|r| r as f32),
            paper: settings.paper,
            white: layout.white().iter().map(|p| place([p.x, p.y, 0.0])).collect(),
            boosts: vec![None; 6 * CELLS * CELLS],
            frame: 0,
        })
    }

    /// Where the environment is seen from, m.
    pub fn place(&self) -> Vec3 {
        let [x, y, z] = self.place.coords.into();
        Vec3::new(x as f32, y as f32, z as f32)
    }

    /// The environment of a frame, in the scene's units. `camera` is the scene's.
    pub fn follow(
        &mut self,
        scene: &Picture,
        camera: &Camera,
        second: Option<&Picture>,
    ) -> Result<CubeMap, dome::Problem> {
        self.frame += 1;
        let white = white(&self.white, scene, camera);
        let from_ball = self.reflectivity.map(|r| 1.0 / r);
        let (seen, gain) = match (&self.view, second) {
            (View::Ball { camera, map }, Some(picture)) => {
                let there = self::white(&self.white, picture, camera);
                let seen = map.environment(&picture.radiance, &picture.clipped, SIDE);
                let gain = white.zip(there).map(|(a, b)| [0, 1, 2].map(|k| from_ball[k] * a[k] / b[k]));
                (seen, gain)
            }
            (View::Fisheye { map }, Some(picture)) => {
                (map.environment(&picture.radiance, &picture.clipped, SIDE), None)
            }
            _ => {
                let (centre, radius_m) = self.ball;
                let map = SphereMap::of_ball(camera, &centre, radius_m, self.distance_m)?;
                (map.environment(&scene.radiance, &scene.clipped, SIDE), Some(from_ball))
            }
        };
        // What the white paper shows is what it gets.
        let wanted = white.map(|w| [0, 1, 2].map(|k| PI * w[k] / self.paper[k]));
        Ok(match (gain, wanted) {
            (Some(gain), Some(wanted)) => self.raised(&seen, gain, wanted),
            (Some(gain), None) => seen.cube.map(|l| [0, 1, 2].map(|k| l[k] * gain[k])),
            (None, Some(wanted)) => {
                let got = seen.cube.irradiance(Vec3::Y);
                seen.cube.map(|l| [0, 1, 2].map(|k| l[k] * wanted[k] / got[k].max(1e-6)))
            }
            (None, None) => seen.cube,
        })
    }

    /// Clipped light raised until the paper gets what it shows.
    fn raised(&mut self, seen: &Seen, gain: [f32; 3], wanted: [f32; 3]) -> CubeMap {
        let scaled = |cube: &CubeMap| cube.map(|l| [0, 1, 2].map(|k| l[k] * gain[k]));
        let (all, clipped) = (scaled(&seen.cube), scaled(&seen.clipped));
        let coarse = clipped.downsampled(SIDE / CELLS);
        // Irradiance that the clipped part of each cell gives to the paper.
        let given: Vec<[f32; 3]> = (0..coarse.texels().len())
            .map(|i| {
                let (direction, solid_angle) = coarse.texel(i);
                coarse.texels()[i].0.map(|l| l * direction.y.max(0.0) * solid_angle as f32)
            })
            .collect();
        let lit = |i: &usize| coarse.texels()[*i].0.iter().any(|l| *l > 0.0);
        let rest = [all.irradiance(Vec3::Y), clipped.irradiance(Vec3::Y)];
        let lacking = [0, 1, 2].map(|k| (wanted[k] - (rest[0][k] - rest[1][k])).max(0.0));
        let mut fresh = Vec::new();
        let mut known = [0.0f32; 3];
        for i in (0..given.len()).filter(lit) {
            let near = |j: &usize| coarse.texel(i).0.dot(coarse.texel(*j).0) > SAME_LIGHT;
            let remembered = |j: &usize| self.boosts[*j].is_some_and(|b| self.frame - b.seen <= FORGOTTEN);
            let closest = |j: &usize| (1e6 * coarse.texel(i).0.dot(coarse.texel(*j).0)) as i64;
            match (0..given.len()).filter(near).filter(remembered).max_by_key(closest) {
                Some(j) => {
                    let by = self.boosts[j].map_or([1.0; 3], |b| b.by);
                    self.boosts[i] = Some(Boost { by, seen: self.frame });
                    (0..3).for_each(|k| known[k] += by[k] * given[i][k]);
                }
                None => fresh.push(i),
            }
        }
        let new = [0, 1, 2].map(|k| fresh.iter().map(|&i| given[i][k]).sum::<f32>());
        let boost = |lacking: f32, given: f32| {
            if given > 0.0 { (lacking / given).clamp(1.0, MOST_BOOST) } else { 1.0 }
        };
        if fresh.is_empty() {
            let follow = [0, 1, 2].map(|k| {
                let misfit = if known[k] > 0.0 { lacking[k] / known[k] } else { 1.0 };
                if (misfit - 1.0).abs() > LARGE { misfit } else { 1.0 + FOLLOW * (misfit - 1.0) }
            });
            for b in self.boosts.iter_mut().flatten().filter(|b| b.seen == self.frame) {
                b.by = [0, 1, 2].map(|k| (b.by[k] * follow[k]).clamp(1.0, MOST_BOOST));
            }
        } else {
            let by = [0, 1, 2].map(|k| boost(lacking[k] - known[k], new[k]));
            fresh.iter().for_each(|&i| self.boosts[i] = Some(Boost { by, seen: self.frame }));
        }
        let texel = |d: Vec3| {
            let (a, c) = (all.nearest(d), clipped.nearest(d));
            let cell = coarse.index(d);
            let by = self.boosts[cell].filter(|b| b.seen == self.frame).map_or([1.0; 3], |b| b.by);
            [0, 1, 2].map(|k| (a[k] - c[k]).max(0.0) + c[k] * by[k])
        };
        CubeMap::from_fn(SIDE, texel)
    }
}

/// Median of the white paper's places that a picture shows unclipped; none where it shows too few.
fn white(places: &[Point3<f64>], picture: &Picture, camera: &Camera) -> Option<[f32; 3]> {
    let (w, h) = picture.radiance.size();
    let mut seen: Vec<[f32; 3]> = Vec::new();
    for place in places {
        let Some(p) = camera.project(place) else { continue };
        let inside = p.x >= 1.0 && p.y >= 1.0 && p.x < w as f64 - 1.0 && p.y < h as f64 - 1.0;
        if inside && !picture.clipped.at(p.x as usize, p.y as usize) {
            seen.push(picture.radiance.bilinear(p.x, p.y).0);
        }
    }
    if seen.len() < 4 {
        return None;
    }
    // The brighter half: the other may lie in the shadow of something or on ink.
    let quantile = |k: usize| {
        let mut values: Vec<f32> = seen.iter().map(|s| s[k]).collect();
        values.sort_by(f32::total_cmp);
        values[values.len() * 6 / 10]
    };
    let white = [0, 1, 2].map(quantile);
    white.iter().all(|v| *v > 1e-4).then_some(white)
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

//! The truth of a rendered capture in the form that stages give their results: cameras, probe, scene, light.

use super::truth::{Problem, Truth, numbers};
use crate::annotations::Kind;
use crate::calibrate::{PosedCamera, world_from_grid};
use crate::camera::{Camera, Intrinsics};
use crate::config::ProbeSource;
use crate::image::{Radiance, RadianceImage};
use crate::model::{Face, FittedPrimitive, Scene};
use crate::probe::{Environment, ProbeFit, latlong};
use glam::Vec3;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;
use std::collections::BTreeMap;

/// A bottom nearer than this to the ground lies on it and sends no light, m.
const ON_GROUND_M: f64 = 1e-3;

/// A rotation and a translation from rows of numbers.
fn isometry(r: [f64; 9], t: [f64; 3]) -> Isometry3<f64> {
    let rotation = Rotation3::from_matrix(&Matrix3::from_row_slice(&r));
    Isometry3::from_parts(Translation3::from(Vector3::from(t)), UnitQuaternion::from(rotation))
}

impl Truth {
    /// The truth's world (+Z up) in ours, whose axes are those of the grid.
    pub(super) fn world_from_truth(&self) -> Result<Isometry3<f64>, Problem> {
        let m: [f64; 16] = Self::numbers(&self.value["grid"]["world_from_board"], "grid.world_from_board")?;
        let r = [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];
        Ok(world_from_grid() * isometry(r, [m[3], m[7], m[11]]).inverse())
    }

    /// The camera of a photograph of the scene; the plate's for a name that is not known.
    pub fn camera(&self, file: &str) -> Result<Camera, Problem> {
        let value = &self.value["intrinsics"];
        let number = |key: &str| value[key].as_f64().ok_or(Problem::Shape(format!("intrinsics.{key}")));
        let (width, height) = (number("width")? as u32, number("height")? as u32);
        let mut intrinsics = Intrinsics::pinhole(width, height, 1.0);
        intrinsics.focal_px = [number("fx")?, number("fy")?];
        intrinsics.principal_point_px = [number("cx")?, number("cy")?];
        let image = self.image(file)?;
        let camera_from_truth =
            isometry(Self::numbers(&image["R"], "images.R")?, Self::numbers(&image["t"], "images.t")?);
        let world_from_camera = self.world_from_truth()? * camera_from_truth.inverse();
        Ok(Camera { intrinsics, world_from_camera })
    }

    /// The same, known exactly.
    pub fn posed_camera(&self, file: &str) -> Result<PosedCamera, Problem> {
        Ok(PosedCamera { camera: self.camera(file)?, rms_px: 0.0, covariance: None, rival_rms_px: None })
    }

    /// The mirror ball as photographed in `file`, with an environment of `width` texels.
    pub fn probe(&self, file: &str, width: usize) -> Result<ProbeFit, Problem> {
        let sphere = &self.value["sphere"];
        let centre = Point3::from(Self::numbers::<3>(&sphere["centre"], "sphere.centre")?);
        Ok(ProbeFit {
            source: ProbeSource::Ball,
            photographs: Vec::new(),
            camera: self.camera(file)?,
            centre: self.world_from_truth()? * centre,
            radius_m: sphere["radius"].as_f64().ok_or(Problem::Shape("sphere.radius".into()))?,
            outline_rms_px: 0.0,
            outline_support: None,
            mirror_correlation: None,
            reflectivity_seen: None,
            centre_sigma_m: [0.0; 3],
            // Of which a pixel is as fine as a texel is: the blur is 2 / d, a texel's 2π / (w √12).
            diameter_px: width as f64 * 12f64.sqrt() / std::f64::consts::PI,
        })
    }

    /// Name of the scene.
    pub fn scene_name(&self) -> &str {
        self.value["scene"].as_str().unwrap_or_default()
    }

    /// Name of the photograph to augment.
    pub fn plate_file(&self) -> Result<&str, Problem> {
        self.image("")?["file"].as_str().ok_or(Problem::Shape("images.file".into()))
    }

    /// File of the radiance of a photograph as rendered.
    pub fn empty_file(&self, file: &str) -> Result<&str, Problem> {
        self.image(file)?["linear_exr"].as_str().ok_or(Problem::Shape("images.linear_exr".into()))
    }

    /// File of the environment seen from the ball's centre.
    pub fn environment_file(&self) -> Result<&str, Problem> {
        let shape = || Problem::Shape("env_maps".into());
        let centre = numbers(&self.value["sphere"]["centre"]).ok_or_else(shape)?;
        let maps = self.value["env_maps"].as_array().ok_or_else(shape)?;
        let here = maps.iter().find(|m| {
            numbers(&m["position"])
                .is_some_and(|p| p.len() == 3 && p.iter().zip(&centre).all(|(a, b)| (a - b).abs() < 1e-3))
        });
        here.and_then(|m| m["file"].as_str()).ok_or_else(shape)
    }

    /// File of the light from beyond the scene, where there is any.
    pub fn sky_file(&self) -> Option<&str> {
        let emitters = self.value["emitters"].as_array()?;
        emitters.iter().find(|e| e["kind"] == "envmap")?["file"].as_str()
    }

    /// An equirectangular map of the truth (row 0 looks up) as our environment around `origin`. Both worlds have one
    /// vertical, so rows stay what they are and columns are shifted: no light is lost.
    pub fn environment(
        &self,
        map: &RadianceImage,
        scale: f64,
        origin: Point3<f64>,
    ) -> Result<Environment, Problem> {
        let (w, h) = map.size();
        let truth_from_world = self.world_from_truth()?.inverse();
        let d = latlong::direction(0.5, h as f32 / 2.0, w, h);
        let d = truth_from_world * Vector3::new(f64::from(d.x), f64::from(d.y), f64::from(d.z));
        let longitude = d.y.atan2(d.x);
        let shift = (std::f64::consts::PI - longitude) / std::f64::consts::TAU * w as f64 - 0.5;
        let radiance = latlong::turned(map, shift).map(|l| Radiance(l.0.map(|v| v * scale as f32)));
        let origin = Vec3::new(origin.x as f32, origin.y as f32, origin.z as f32);
        Ok(Environment { radiance, origin: vec![origin; w * h], weight: vec![1.0; w * h] })
    }

    /// Radiance of emitting primitives by name, in units of the truth.
    pub fn emitters(&self) -> Result<BTreeMap<String, [f64; 3]>, Problem> {
        let primitives = self.primitives()?.iter().filter(|p| !p["emit"].is_null());
        primitives.map(|p| Ok((name(p)?, Self::numbers(&p["emit"], "primitives.emit")?))).collect()
    }

    pub(super) fn primitives(&self) -> Result<&Vec<Value>, Problem> {
        self.value["primitives"].as_array().ok_or(Problem::Shape("primitives".into()))
    }

    /// The scene as it was rendered. Spheres become polyhedra of the same area.
    pub fn scene(&self) -> Result<Scene, Problem> {
        let world_from_truth = self.world_from_truth()?;
        let mut scene = Scene { primitives: Vec::new(), faces: Vec::new(), rms_px: 0.0 };
        for primitive in self.primitives()? {
            let name = name(primitive)?;
            let (kind, size, faces) = Self::shape(primitive)?;
            scene.primitives.push(FittedPrimitive {
                name: name.clone(),
                kind,
                parent: None,
                size_sigma_m: vec![0.0; size.len()],
                size_m: size,
                corner_sigma_m: 0.0,
                marks: 0,
                rms_px: 0.0,
                faces: Vec::new(),
            });
            scene.faces.extend(faces.into_iter().map(|(side, vertices)| Face {
                name: if side.is_empty() { name.clone() } else { format!("{name}.{side}") },
                vertices: vertices.iter().map(|v| world_from_truth * v).collect(),
                gloss: None,
            }));
        }
        Ok(scene)
    }

    /// Kind, size and faces in the truth's world of a primitive.
    fn shape(primitive: &Value) -> Result<(Kind, Vec<f64>, Vec<NamedFace>), Problem> {
        let vector = |key: &str| -> Result<Vector3<f64>, Problem> {
            Ok(Vector3::from(Self::numbers::<3>(&primitive[key], &format!("primitives.{key}"))?))
        };
        let centre = Point3::from(vector("centre")?);
        match primitive["kind"].as_str() {
            Some("rect") => {
                let (u, v) = (vector("half_u")?, vector("half_v")?);
                let size = vec![2.0 * u.norm(), 2.0 * v.norm()];
                Ok((Kind::Quad, size, vec![(String::new(), rectangle(centre, u, v))]))
            }
            Some("box") => {
                let size = vector("size")?;
                let turn = primitive["rot_z_deg"].as_f64().unwrap_or(0.0).to_radians();
                Ok((Kind::Box, vec![size.x, size.z, size.y], cuboid(centre, size / 2.0, turn)))
            }
            Some("sphere") => {
                let radius =
                    primitive["radius"].as_f64().ok_or(Problem::Shape("primitives.radius".into()))?;
                Ok((Kind::Polygon, vec![2.0 * radius], sphere(centre, radius)))
            }
            _ => Err(Problem::Shape("primitives.kind".into())),
        }
    }
}

/// Name of a side, and its corners, counter-clockwise from the front.
type NamedFace = (String, Vec<Point3<f64>>);

fn name(primitive: &Value) -> Result<String, Problem> {
    primitive["name"].as_str().map(String::from).ok_or(Problem::Shape("primitives.name".into()))
}

fn rectangle(centre: Point3<f64>, u: Vector3<f64>, v: Vector3<f64>) -> Vec<Point3<f64>> {
    vec![centre - u - v, centre + u - v, centre + u + v, centre - u + v]
}

/// Sides by our names: the truth's +Z is `top`, its −Y `front`.
fn cuboid(centre: Point3<f64>, half: Vector3<f64>, turn: f64) -> Vec<NamedFace> {
    let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), turn);
    let [x, y, z] =
        [Vector3::x() * half.x, Vector3::y() * half.y, Vector3::z() * half.z].map(|a| rotation * a);
    let sides = [
        ("top", z, x, y),
        ("bottom", -z, y, x),
        ("left", -x, z, y),
        ("right", x, y, z),
        ("front", -y, x, z),
        ("back", y, z, x),
    ];
    let lies = centre.z - half.z < ON_GROUND_M;
    sides
        .into_iter()
        .filter(|(side, ..)| !(lies && *side == "bottom"))
        .map(|(side, out, u, v)| (side.to_string(), rectangle(centre + out, u, v)))
        .collect()
}

/// An icosahedron, each face cut in four, blown up to the sphere's area.
fn sphere(centre: Point3<f64>, radius: f64) -> Vec<NamedFace> {
    let g = (1.0 + 5f64.sqrt()) / 2.0;
    let corners: Vec<Vector3<f64>> = [[0.0, 1.0, g], [1.0, g, 0.0], [g, 0.0, 1.0]]
        .into_iter()
        .flat_map(|[x, y, z]| {
            let signs = |c: f64| if c == 0.0 { vec![0.0] } else { vec![c, -c] };
            let mut all = Vec::new();
            for x in signs(x) {
                for y in signs(y) {
                    all.extend(signs(z).into_iter().map(|z| Vector3::new(x, y, z).normalize()));
                }
            }
            all
        })
        .collect();
    let side =
        (corners.iter().map(|c| (c - corners[0]).norm()).filter(|d| *d > 1e-9)).fold(f64::MAX, f64::min);
    let near = |a: usize, b: usize| ((corners[a] - corners[b]).norm() - side).abs() < 1e-9;
    let mut triangles = Vec::new();
    for a in 0..12 {
        for b in (a + 1..12).filter(|&b| near(a, b)) {
            for c in (b + 1..12).filter(|&c| near(a, c) && near(b, c)) {
                let [a, b, c] = [corners[a], corners[b], corners[c]];
                let [ab, bc, ca] = [a + b, b + c, c + a].map(|m| m.normalize());
                triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
            }
        }
    }
    let doubled = |t: &[Vector3<f64>; 3]| (t[1] - t[0]).cross(&(t[2] - t[0]));
    let area: f64 = triangles.iter().map(|t| doubled(t).norm() / 2.0).sum();
    let scale = radius * (4.0 * std::f64::consts::PI / area).sqrt();
    let face = |(i, mut t): (usize, [Vector3<f64>; 3])| {
        if doubled(&t).dot(&t[0]) < 0.0 {
            t.swap(1, 2);
        }
        (i.to_string(), t.map(|v| centre + v * scale).to_vec())
    };
    triangles.into_iter().enumerate().map(face).collect()
}

#[cfg(test)]
#[path = "true_scene_tests.rs"]
mod tests;

//! The scene as binary glTF 2.0: a mesh for each primitive and the photographs' cameras, to open in Blender and others.

use super::Scene;
use super::face::triangulate;
use crate::camera::Camera;
use crate::error::{Error, FileContext, Result};
use glam::{Quat, Vec3};
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::{Value, json};
use std::path::Path;

/// A light of KHR_lights_punctual.
#[derive(Debug, Clone, PartialEq)]
pub struct Light {
    /// Name of what shines.
    pub name: String,
    /// Where it is.
    pub kind: LightKind,
    /// Unit vector along its beam, world.
    pub towards: Vec3,
    /// Radiant intensity (spot) or irradiance (directional) in plate units; glTF counts in candela and lux.
    pub intensity: [f32; 3],
}

/// What kind of light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LightKind {
    /// Over the half-space in front of a place, world, m.
    Spot {
        /// Where.
        at: Vec3,
    },
    /// From infinity.
    Directional,
}

/// Nodes and definitions of lights: glTF's shine along −Z.
fn punctual(lights: &[Light]) -> (Vec<Value>, Vec<Value>) {
    let node = |(i, light): (usize, &Light)| {
        let q = Quat::from_rotation_arc(Vec3::NEG_Z, light.towards);
        let mut node = json!({
            "name": light.name, "rotation": q.to_array(),
            "extensions": {"KHR_lights_punctual": {"light": i}},
        });
        if let LightKind::Spot { at } = light.kind {
            node["translation"] = json!(at.to_array());
        }
        node
    };
    let definition = |light: &Light| {
        let top = light.intensity.into_iter().fold(f32::MIN_POSITIVE, f32::max);
        let mut made = json!({
            "name": light.name, "color": light.intensity.map(|v| v / top), "intensity": top,
            "type": if light.kind == LightKind::Directional { "directional" } else { "spot" },
        });
        if light.kind != LightKind::Directional {
            made["spot"] = json!({"innerConeAngle": 0.0, "outerConeAngle": std::f64::consts::FRAC_PI_2});
        }
        made
    };
    (lights.iter().enumerate().map(node).collect(), lights.iter().map(definition).collect())
}

/// A photograph's camera.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// Name of its node.
    pub name: &'a str,
    /// The camera.
    pub camera: &'a Camera,
    /// The photograph, as a path from the folder of the file written.
    pub picture: Option<&'a str>,
}

/// Opens the file in Blender as the photographs show it; stands beside `scene.glb`.
pub const OPEN_IN_BLENDER: &str = include_str!("open_in_blender.py");

/// Node and definition of a camera. One of glTF looks along −Z with +Y up, ours along +Z with +Y down; it has no distortion, its
/// pixels are square and its principal point is central, so that the rest stands in `extras`.
fn view((index, view): (usize, &View)) -> (Value, Value) {
    let i = &view.camera.intrinsics;
    let flip = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let turn = view.camera.world_from_camera.rotation * flip;
    let (at, q) = (view.camera.centre(), turn.coords);
    let mut extras = json!({
        "size_px": [i.width_px, i.height_px], "focal_px": i.focal_px, "principal_point_px": i.principal_point_px,
        "distortion": i.distortion, "is_plate": index == 0,
    });
    if let Some(picture) = view.picture {
        extras["picture"] = picture.into();
    }
    let node = json!({
        "name": view.name, "camera": index, "extras": extras,
        "translation": [at.x, at.y, at.z], "rotation": [q.x, q.y, q.z, q.w],
    });
    let perspective = json!({
        "aspectRatio": f64::from(i.width_px) / f64::from(i.height_px) * i.focal_px[1] / i.focal_px[0],
        "yfov": 2.0 * (f64::from(i.height_px) / 2.0 / i.focal_px[1]).atan(),
        "znear": 0.01,
    });
    (node, json!({"name": view.name, "type": "perspective", "perspective": perspective}))
}

/// Writes `scene.glb`; the first view is the plate's.
pub fn write(path: &Path, scene: &Scene, cameras: &[View], lights: &[Light]) -> Result<()> {
    let mut binary = Vec::new();
    let (mut views, mut accessors, mut meshes, mut nodes) = (vec![], vec![], vec![], vec![]);
    for primitive in &scene.primitives {
        let inside = |name: &str| name == primitive.name || name.starts_with(&format!("{}.", primitive.name));
        let faces: Vec<_> = scene.faces.iter().filter(|f| inside(&f.name)).cloned().collect();
        let soup = triangulate(&faces);
        if soup.triangles.is_empty() {
            continue;
        }
        let normals = faces.iter().flat_map(|f| {
            let n = f.normal();
            std::iter::repeat_n([n.x as f32, n.y as f32, n.z as f32], f.vertices.len())
        });
        let (low, high) = soup
            .vertices
            .iter()
            .fold((soup.vertices[0], soup.vertices[0]), |(low, high), v| (low.min(*v), high.max(*v)));
        let first = accessors.len();
        let mut add = |bytes: Vec<u8>, target: u32, mut accessor: Value| {
            accessor["bufferView"] = views.len().into();
            views.push(
                json!({"buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len(), "target": target}),
            );
            accessors.push(accessor);
            binary.extend(bytes);
        };
        let count = soup.vertices.len();
        let bytes = soup.vertices.iter().flat_map(|v| v.to_array()).flat_map(f32::to_le_bytes).collect();
        let bounds = (low.to_array(), high.to_array());
        add(
            bytes,
            ARRAY,
            json!({"componentType": FLOAT, "count": count, "type": "VEC3", "min": bounds.0, "max": bounds.1}),
        );
        let bytes = normals.flatten().flat_map(f32::to_le_bytes).collect();
        add(bytes, ARRAY, json!({"componentType": FLOAT, "count": count, "type": "VEC3"}));
        let bytes = soup.triangles.iter().flatten().flat_map(|i| i.to_le_bytes()).collect();
        let count = 3 * soup.triangles.len();
        add(bytes, ELEMENT_ARRAY, json!({"componentType": UNSIGNED_INT, "count": count, "type": "SCALAR"}));
        let attributes = json!({"POSITION": first, "NORMAL": first + 1});
        meshes.push(json!({
            "name": primitive.name,
            "primitives": [{"attributes": attributes, "indices": first + 2, "material": 0}],
        }));
        nodes.push(json!({"name": primitive.name, "mesh": meshes.len() - 1}));
    }
    let (posed, lenses): (Vec<_>, Vec<_>) = cameras.iter().enumerate().map(view).unzip();
    nodes.extend(posed);
    let (places, lights) = punctual(lights);
    nodes.extend(places);
    let mut root = json!({
        "asset": {"version": "2.0", "generator": concat!("insitu ", env!("CARGO_PKG_VERSION"))},
        "scene": 0,
        "scenes": [{"nodes": (0..nodes.len()).collect::<Vec<_>>()}],
        "nodes": nodes,
    });
    if !lenses.is_empty() {
        root["cameras"] = lenses.into();
    }
    if !lights.is_empty() {
        root["extensionsUsed"] = json!(["KHR_lights_punctual"]);
        root["extensions"] = json!({"KHR_lights_punctual": {"lights": lights}});
    }
    if !binary.is_empty() {
        root["materials"] = json!([{"name": "grey", "pbrMetallicRoughness": {
            "baseColorFactor": [0.5, 0.5, 0.5, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0,
        }}]);
        root["meshes"] = meshes.into();
        root["accessors"] = accessors.into();
        root["bufferViews"] = views.into();
        root["buffers"] = json!([{"byteLength": binary.len()}]);
    }
    let json = serde_json::to_vec(&root).map_err(|e| Error::Bug(e.to_string()))?;
    let binary = (!binary.is_empty()).then(|| binary.into());
    // The writer pads both chunks; lengths are its business.
    let glb = ::gltf::binary::Glb {
        header: ::gltf::binary::Header { magic: *b"glTF", version: 2, length: 0 },
        json: json.into(),
        bin: binary,
    };
    let bytes = glb.to_vec().map_err(|e| Error::Bug(e.to_string()))?;
    std::fs::write(path, bytes).at("writing the scene", path)
}

// Constants of the glTF 2.0 specification, §5.
const ARRAY: u32 = 34962;
const ELEMENT_ARRAY: u32 = 34963;
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;

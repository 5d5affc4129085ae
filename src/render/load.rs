//! Objects from files: glTF, OBJ, PLY.

use super::object::{Material, Object, Soup};
use super::placement::world_from_object;
use super::{Problem, gltf_file};
use crate::config;
use crate::error::{Context, Error, FileContext, Result};
use glam::Vec3;
use ply_rs_bw::ply::{DefaultElement, Property};
use std::cell::RefCell;
use std::io::BufReader;
use std::path::Path;

/// What to do about a file that cannot be read.
pub(super) const EXPORT: &str = "export the object again as .glb, .gltf, .obj or .ply";

/// Reads an object, checks it, and places it in the world.
pub fn load_object(path: &Path, settings: &config::Render) -> Result<Object> {
    let what = || format!("reading the object {}", path.display());
    let fallback = default_material(settings).doing("reading the settings of the object")?;
    let place = world_from_object(settings).doing("placing the object")?;
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let mut soup = match extension.as_str() {
        "obj" => read_obj(path, fallback)?,
        "ply" => read_ply(path, fallback)?,
        "gltf" | "glb" => gltf_file::read(path, fallback)?,
        _ => {
            let problem = format!("has the extension `{extension}`, expected glb, gltf, obj or ply");
            return Err(Error::file("reading the object", path, problem, EXPORT));
        }
    };
    let mut changed = 0;
    for material in &mut soup.materials {
        let (conserving, was_changed) = material.conserving();
        *material = conserving;
        changed += usize::from(was_changed);
    }
    if changed > 0 {
        soup.warnings
            .push(format!("{changed} materials reflect more light than they receive; they were scaled down"));
    }
    soup.check().doing(what())?;
    for p in &mut soup.positions {
        *p = place.transform_point3(*p);
    }
    for normals in soup.triangles.iter_mut().filter_map(|t| t.normals.as_mut()) {
        *normals = normals.map(|n| place.transform_vector3(n));
    }
    Object::new(soup, settings.smooth_deg.to_radians() as f32).doing(what())
}

fn default_material(settings: &config::Render) -> Result<Material, Problem> {
    let material = Material {
        diffuse: settings.diffuse,
        specular: settings.specular,
        shininess: settings.shininess,
        roughness: None,
    };
    let refuse =
        |name, value: f32, expected| Err(Problem::Setting { name, value: f64::from(value), expected });
    for k in 0..3 {
        let (d, s) = (material.diffuse[k], material.specular[k]);
        if !(0.0..=1.0).contains(&d) {
            return refuse("diffuse", d, "a reflectance in 0..=1");
        }
        if !(0.0..=1.0).contains(&s) {
            return refuse("specular", s, "a reflectance in 0..=1");
        }
        if d + s > 1.0 + 1e-6 {
            return refuse("specular", s, "at most 1 together with `diffuse`");
        }
    }
    if !(material.shininess >= 0.0 && material.shininess.is_finite()) {
        return refuse("shininess", material.shininess, "a finite exponent of at least 0");
    }
    Ok(material)
}

fn read_obj(path: &Path, fallback: Material) -> Result<Soup> {
    let refuse = |problem: String| Error::file("reading the object", path, problem, EXPORT);
    let mut reader = BufReader::new(std::fs::File::open(path).at("reading the object", path)?);
    let options = tobj::LoadOptions { ignore_points: true, ignore_lines: true, ..Default::default() };
    let mut soup = Soup { materials: vec![fallback], ..Soup::default() };
    let folder = path.parent().unwrap_or(Path::new(""));
    let libraries = RefCell::new(Vec::new());
    let (models, materials) = tobj::load_obj_buf(&mut reader, &options, |library| {
        let file = folder.join(library);
        let loaded = tobj::load_mtl(&file);
        libraries.borrow_mut().push((file, loaded.as_ref().err().map(ToString::to_string)));
        loaded
    })
    .map_err(|e| refuse(format!("not a whole OBJ ({e})")))?;
    for (file, problem) in libraries.into_inner() {
        match problem {
            None => soup.files.push(file),
            Some(e) => soup.warnings.push(format!(
                "material library {} cannot be used ({e}); the settings' material takes its place",
                file.display()
            )),
        }
    }
    for m in materials.unwrap_or_default() {
        if m.diffuse_texture.is_some() || m.specular_texture.is_some() {
            soup.warnings.push(format!("textures of material `{}` are not used, only its colours", m.name));
        }
        soup.materials.push(Material {
            diffuse: m.diffuse.unwrap_or(fallback.diffuse),
            specular: m.specular.unwrap_or([0.0; 3]),
            shininess: m.shininess.unwrap_or(fallback.shininess),
            roughness: None,
        });
    }
    for tobj::Model { mesh, .. } in models {
        let base = soup.positions.len() as u32;
        soup.positions.extend(mesh.positions.as_chunks::<3>().0.iter().map(|p| Vec3::from_array(*p)));
        let normals: Vec<Vec3> =
            mesh.normals.as_chunks::<3>().0.iter().map(|n| Vec3::from_array(*n)).collect();
        let material = mesh.material_id.map_or(0, |m| m as u32 + 1);
        let mut start = 0;
        // No arities: all faces are triangles.
        let arities = match mesh.face_arities.is_empty() {
            true => vec![3; mesh.indices.len() / 3],
            false => mesh.face_arities,
        };
        for arity in arities {
            let corners = start..start + arity as usize;
            start = corners.end;
            let positions: Vec<u32> = mesh.indices[corners.clone()].iter().map(|i| base + i).collect();
            let corner_normals: Option<Vec<Vec3>> = mesh
                .normal_indices
                .get(corners)
                .and_then(|indices| indices.iter().map(|i| normals.get(*i as usize).copied()).collect());
            soup.add_polygon(&positions, corner_normals.as_deref(), material);
        }
    }
    Ok(soup)
}

fn read_ply(path: &Path, fallback: Material) -> Result<Soup> {
    let refuse = |problem: String| Error::file("reading the object", path, problem, EXPORT);
    let mut reader = BufReader::new(std::fs::File::open(path).at("reading the object", path)?);
    let ply = ply_rs_bw::parser::Parser::<DefaultElement>::new()
        .read_ply(&mut reader)
        .map_err(|e| refuse(format!("not a whole PLY ({e})")))?;
    let rows = |name: &str| ply.payload.get(name).map(Vec::as_slice).unwrap_or_default();
    let mut soup = Soup { materials: vec![fallback], ..Soup::default() };
    let mut normals = Vec::new();
    for vertex in rows("vertex") {
        let triple = |names: [&str; 3]| -> Option<Vec3> {
            let [x, y, z] = names.map(|n| vertex.get(n).and_then(scalar));
            Some(Vec3::new(x?, y?, z?))
        };
        let position =
            triple(["x", "y", "z"]).ok_or_else(|| refuse("its vertices have no numbers x, y, z".into()))?;
        soup.positions.push(position);
        normals.extend(triple(["nx", "ny", "nz"]));
    }
    if rows("vertex").first().is_some_and(|v| v.contains_key("red")) {
        soup.warnings.push("vertex colours are not used, the settings' material is".into());
    }
    let has_normals = normals.len() == soup.positions.len();
    for (f, face) in rows("face").iter().enumerate() {
        let indices = face.get("vertex_indices").or_else(|| face.get("vertex_index"));
        let indices = indices
            .and_then(index_list)
            .ok_or_else(|| refuse(format!("face {f} has no list `vertex_indices` of whole numbers")))?;
        let corner_normals: Option<Vec<Vec3>> = has_normals
            .then(|| indices.iter().map(|i| normals.get(*i as usize).copied()).collect())
            .flatten();
        soup.add_polygon(&indices, corner_normals.as_deref(), 0);
    }
    Ok(soup)
}

fn scalar(p: &Property) -> Option<f32> {
    match *p {
        Property::Float(v) => Some(v),
        Property::Double(v) => Some(v as f32),
        Property::Char(v) => Some(v.into()),
        Property::UChar(v) => Some(v.into()),
        Property::Short(v) => Some(v.into()),
        Property::UShort(v) => Some(v.into()),
        Property::Int(v) => Some(v as f32),
        Property::UInt(v) => Some(v as f32),
        _ => None,
    }
}

/// A negative index becomes one that no mesh has, so that it is refused like any other out of range.
fn index_list(p: &Property) -> Option<Vec<u32>> {
    fn all<T: Copy + TryInto<u32>>(list: &[T]) -> Option<Vec<u32>> {
        Some(list.iter().map(|i| (*i).try_into().unwrap_or(u32::MAX)).collect())
    }
    match p {
        Property::ListUChar(l) => all(l),
        Property::ListChar(l) => all(l),
        Property::ListUShort(l) => all(l),
        Property::ListShort(l) => all(l),
        Property::ListUInt(l) => all(l),
        Property::ListInt(l) => all(l),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(name: &str, text: &str, settings: &config::Render) -> Result<Object> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(name);
        std::fs::write(&path, text).unwrap();
        std::fs::write(dir.path().join("m.mtl"), "newmtl shiny\nKd 0.1 0.2 0.3\nKs 0.5 0.5 0.5\nNs 90\n")
            .unwrap();
        load_object(&path, settings)
    }

    const OBJ: &str = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5 1\nusemtl shiny\n\
                       f 4 3 2 1\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n";

    #[test]
    fn obj_with_materials_and_polygons_is_placed() {
        let settings = config::Render {
            position_m: [0.1, 0.2, 0.3],
            rotation_deg: 90.0,
            scale: 2.0,
            ..Default::default()
        };
        let object = load("a.obj", OBJ, &settings).unwrap();
        assert_eq!(object.triangles.len(), 6);
        assert!(object.closed && object.warnings.is_empty(), "{:?}", object.warnings);
        assert_eq!(object.files.len(), 1);
        let m = object.materials[object.material_of[0] as usize];
        assert_eq!((m.diffuse, m.specular, m.shininess), ([0.1, 0.2, 0.3], [0.5; 3], 90.0));
        // (0.5, 0.5, 1) ·2 → (1, 1, 2), turned by 90° → (−1, 1, 2), moved → (−0.9, 1.2, 2.3), world (x, z, −y).
        let top = Vec3::new(-0.9, 2.3, -1.2);
        assert!(object.vertices.iter().any(|v| (*v - top).length() < 1e-5), "{:?}", object.vertices);
    }

    #[test]
    fn y_up_files_stand_upright() {
        let settings = config::Render { y_up: true, ..Default::default() };
        let object = load("a.obj", "v 0 0 0\nv 1 0 0\nv 0 3 0\nf 1 2 3\n", &settings).unwrap();
        assert!((object.bounds()[1] - Vec3::new(1.0, 3.0, 0.0)).length() < 1e-6);
    }

    #[test]
    fn a_missing_material_library_is_a_warning() {
        let object =
            load("a.obj", "mtllib none.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", &Default::default())
                .unwrap();
        assert!(object.warnings[0].contains("none.mtl"), "{:?}", object.warnings);
        assert_eq!(object.materials[object.material_of[0] as usize].diffuse, [0.5; 3]);
    }

    #[test]
    fn ply_in_ascii_with_normals_and_quads() {
        let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                    property float nx\nproperty float ny\nproperty float nz\nelement face 1\n\
                    property list uchar int vertex_indices\nend_header\n\
                    0 0 0 0 0 1\n1 0 0 0 0 1\n1 1 0 0 0 1\n0 1 0 0 0 1\n4 0 1 2 3\n";
        let object = load("a.ply", text, &Default::default()).unwrap();
        assert_eq!((object.vertices.len(), object.triangles.len()), (4, 2));
        assert!(
            object.normals.iter().all(|n| (*n - Vec3::Y).length() < 1e-6),
            "z of the grid is y of the world"
        );
    }

    #[test]
    fn what_is_no_mesh_is_refused() {
        let d = config::Render::default();
        for (name, text, expected) in [
            ("a.obj", "", "the mesh is empty: 0 vertices"),
            ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n", "out of bounds"),
            ("a.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "vertex 0 lies at (0, 0, NaN)"),
            ("a.stl", "solid\n", "has the extension `stl`"),
            ("a.ply", "ply\nformat ascii 1.0\n", "not a whole PLY"),
            ("a.gltf", "{", "not a whole glTF"),
            ("a.glb", "glTF", "not a whole glTF"),
        ] {
            let e = load(name, text, &d).unwrap_err().to_string();
            assert!(e.to_lowercase().contains(&expected.to_lowercase()), "{name}: {e}");
        }
        let negative = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                        element face 1\nproperty list uchar int vertex_index\nend_header\n\
                        0 0 0\n1 0 0\n0 1 0\n3 0 1 -2\n";
        assert!(load("a.ply", negative, &d).unwrap_err().to_string().contains("names vertex 4294967295"));
    }

    #[test]
    fn impossible_settings_are_refused() {
        let d = config::Render::default();
        for (settings, expected) in [
            (config::Render { scale: -1.0, ..d.clone() }, "`render.scale` is -1"),
            (config::Render { diffuse: [1.5; 3], ..d.clone() }, "`render.diffuse` is 1.5"),
            (config::Render { specular: [0.75; 3], ..d.clone() }, "`render.specular` is 0.75"),
            (config::Render { shininess: -2.0, ..d.clone() }, "`render.shininess` is -2"),
            (config::Render { position_m: [0.0, f64::NAN, 0.0], ..d.clone() }, "`render.position_m` is NaN"),
        ] {
            let e = load("a.obj", OBJ, &settings).unwrap_err().to_string();
            assert!(e.contains(expected), "{e}");
        }
    }
}

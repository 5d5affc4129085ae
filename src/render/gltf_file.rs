//! glTF 2.0, text or binary, with buffers inside or beside.

use super::load::EXPORT;
use super::object::{Material, Soup};
use crate::error::{Error, FileContext, Result};
use glam::{Mat3, Mat4, Vec3};
use gltf::buffer::Source;
use std::path::Path;

/// Reads the default scene with its node transforms. KHR extensions of materials, textures, skins, morph targets
/// and animations are left out.
pub(super) fn read(path: &Path, fallback: Material) -> Result<Soup> {
    let refuse = |problem: String| Error::file("reading the object", path, problem, EXPORT);
    let bytes = std::fs::read(path).at("reading the object", path)?;
    let gltf::Gltf { document, blob } =
        gltf::Gltf::from_slice(&bytes).map_err(|e| refuse(format!("not a whole glTF ({e})")))?;
    let mut soup = Soup { materials: vec![fallback], ..Soup::default() };
    soup.materials.extend(document.materials().map(|m| material(&m)));
    if document.textures().len() > 0 {
        soup.warnings.push("textures are not used, only the base colours".into());
    }
    let mut buffers = Vec::new();
    for buffer in document.buffers() {
        let data = match buffer.source() {
            Source::Bin => blob.clone().ok_or_else(|| refuse("its binary chunk is missing".into()))?,
            Source::Uri(uri) => match uri.strip_prefix("data:") {
                Some(data) => {
                    let encoded = data.split_once(";base64,").map(|(_, encoded)| encoded);
                    encoded.and_then(decode_base64).ok_or_else(|| refuse("a data URI is damaged".into()))?
                }
                None => {
                    let file = path.parent().unwrap_or(Path::new("")).join(uri);
                    let data = std::fs::read(&file).at("reading a buffer of the object", &file)?;
                    soup.files.push(file);
                    data
                }
            },
        };
        if data.len() < buffer.length() {
            return Err(refuse(format!(
                "buffer {} has {} bytes, expected {}",
                buffer.index(),
                data.len(),
                buffer.length()
            )));
        }
        buffers.push(data);
    }
    let scene = document.default_scene().or_else(|| document.scenes().next());
    for node in scene.iter().flat_map(|s| s.nodes()) {
        add_node(&mut soup, &node, Mat4::IDENTITY, &buffers, 0).map_err(refuse)?;
    }
    Ok(soup)
}

/// Deeper trees than this are cycles.
const MAX_DEPTH: usize = 256;

fn add_node(
    soup: &mut Soup,
    node: &gltf::Node,
    parent: Mat4,
    buffers: &[Vec<u8>],
    depth: usize,
) -> std::result::Result<(), String> {
    if depth > MAX_DEPTH {
        return Err(format!("node {} lies {MAX_DEPTH} levels deep", node.index()));
    }
    let place = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
    for primitive in node.mesh().iter().flat_map(|m| m.primitives()) {
        add_primitive(soup, &primitive, place, buffers)?;
    }
    node.children().try_for_each(|child| add_node(soup, &child, place, buffers, depth + 1))
}

fn add_primitive(
    soup: &mut Soup,
    primitive: &gltf::Primitive,
    place: Mat4,
    buffers: &[Vec<u8>],
) -> std::result::Result<(), String> {
    use gltf::mesh::Mode;
    let mode = primitive.mode();
    if !matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
        soup.warnings.push(format!("a primitive of {mode:?} was left out"));
        return Ok(());
    }
    let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(Vec::as_slice));
    let base = soup.positions.len() as u32;
    let positions = reader.read_positions().ok_or("a primitive has no positions")?;
    soup.positions.extend(positions.map(|p| place.transform_point3(Vec3::from_array(p))));
    let count = soup.positions.len() as u32 - base;
    // Normals go by the inverse transpose; a mirroring transform turns the winding.
    let linear = Mat3::from_mat4(place);
    let mirrored = linear.determinant() < 0.0;
    let cofactor = Mat3::from_cols(
        linear.y_axis.cross(linear.z_axis),
        linear.z_axis.cross(linear.x_axis),
        linear.x_axis.cross(linear.y_axis),
    ) * linear.determinant().signum();
    let normals: Option<Vec<Vec3>> =
        reader.read_normals().map(|n| n.map(|n| cofactor * Vec3::from_array(n)).collect());
    let indices: Vec<u32> = match reader.read_indices() {
        Some(indices) => indices.into_u32().collect(),
        None => (0..count).collect(),
    };
    let material = primitive.material().index().map_or(0, |m| m as u32 + 1);
    let triangles: Vec<[u32; 3]> = match mode {
        Mode::Triangles => indices.as_chunks::<3>().0.to_vec(),
        Mode::TriangleFan => indices.windows(2).skip(1).map(|w| [indices[0], w[0], w[1]]).collect(),
        _ => indices
            .windows(3)
            .enumerate()
            .map(|(i, w)| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] })
            .collect(),
    };
    for [a, b, c] in triangles {
        let corners = if mirrored { [a, c, b] } else { [a, b, c] };
        let corner_normals: Option<Vec<Vec3>> =
            normals.as_ref().and_then(|n| corners.iter().map(|i| n.get(*i as usize).copied()).collect());
        // An index beyond this primitive must not reach into the next one.
        let positions = corners.map(|i| if i < count { base + i } else { u32::MAX });
        soup.add_polygon(&positions, corner_normals.as_deref(), material);
    }
    Ok(())
}

/// Metallic-roughness to Phong: diffuse `0.96 c (1 − m)`, specular `0.04 (1 − m) + c m` (the specification's
/// Fresnel reflectance at normal incidence), exponent `(2/α² − 2) / 4` with `α = roughness²`: the Blinn–Phong
/// exponent of the same slope (Walter et al. 2007), a quarter of it for a lobe about the mirror direction. α itself is kept
/// for GGX, which is what the specification means.
fn material(m: &gltf::Material) -> Material {
    let pbr = m.pbr_metallic_roughness();
    let [r, g, b, _] = pbr.base_color_factor();
    let metallic = pbr.metallic_factor();
    let alpha = pbr.roughness_factor().max(0.03).powi(2);
    Material {
        diffuse: [r, g, b].map(|c| 0.96 * c * (1.0 - metallic)),
        specular: [r, g, b].map(|c| 0.04 * (1.0 - metallic) + c * metallic),
        shininess: ((2.0 / (alpha * alpha) - 2.0) / 4.0).max(0.0),
        roughness: Some(alpha),
    }
}

/// RFC 4648 with or without padding.
fn decode_base64(text: &str) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3);
    let (mut bits, mut count) = (0u32, 0);
    for c in text.trim_end_matches('=').bytes() {
        let value = match c {
            b'A'..=b'Z' => c - b'A',
            b'a'..=b'z' => c - b'a' + 26,
            b'0'..=b'9' => c - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        bits = bits << 6 | u32::from(value);
        count += 6;
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
        }
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One triangle (0,0,0) (1,0,0) (0,1,0) under a node that mirrors x, doubles it and moves by 3 along z.
    const GLTF: &str = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],
        "nodes":[{"mesh":0,"scale":[-2,1,1],"translation":[0,0,3]}],
        "materials":[{"pbrMetallicRoughness":{"baseColorFactor":[0.5,0.25,1.0,1.0],"metallicFactor":0.0,"roughnessFactor":0.5}}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0},"material":0}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}],
        "bufferViews":[{"buffer":0,"byteLength":36}],
        "buffers":[{"byteLength":36,"uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#;

    fn load(text: &str) -> Result<Soup> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.gltf");
        std::fs::write(&path, text).unwrap();
        read(&path, Material { diffuse: [0.5; 3], specular: [0.0; 3], shininess: 1.0, roughness: None })
    }

    #[test]
    fn node_transforms_apply_and_mirroring_keeps_the_front() {
        let soup = load(GLTF).unwrap();
        assert_eq!(soup.positions[1], Vec3::new(-2.0, 0.0, 3.0));
        let [a, b, c] = soup.triangles[0].positions.map(|i| soup.positions[i as usize]);
        assert!((b - a).cross(c - a).z > 0.0, "the front still looks along +z");
        let m = soup.materials[soup.triangles[0].material as usize];
        assert!((m.diffuse[0] - 0.48).abs() < 1e-6 && (m.specular[0] - 0.04).abs() < 1e-6);
        assert!((m.shininess - 7.5).abs() < 1e-4, "{}", m.shininess);
        assert_eq!(m.roughness, Some(0.25));
    }

    #[test]
    fn a_short_buffer_is_refused() {
        let e = load(&GLTF.replace("AAAAAAAAgD8AAAAA\"", "\"")).err().unwrap().to_string();
        assert!(e.contains("buffer 0 has") && e.contains("expected 36"), "{e}");
    }

    #[test]
    fn base64_is_read() {
        assert_eq!(decode_base64("aW5zaXR1").unwrap(), b"insitu");
        assert_eq!(decode_base64("aW5zaXQ=").unwrap(), b"insit");
        assert!(decode_base64("a*").is_none());
    }
}

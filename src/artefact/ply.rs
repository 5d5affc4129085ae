//! Binary little-endian PLY with float vertex properties and triangles with float properties.

use super::remake;
use crate::error::{Error, FileContext, Result};
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{
    Addable, DefaultElement, ElementDef, Encoding, Ply, Property, PropertyDef, PropertyType, ScalarType,
};
use ply_rs_bw::writer::Writer;
use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::path::Path;

/// A table of floats per vertex and, if there are triangles, per triangle.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Name and version of the format, e.g. `insitu-patches 1`; kept as a comment.
    pub format: String,
    /// Further comments: units, conventions.
    pub comments: Vec<String>,
    /// Names of the vertex properties.
    pub vertex_properties: Vec<String>,
    /// One row per vertex.
    pub vertices: Vec<Vec<f32>>,
    /// Names of the triangle properties.
    pub face_properties: Vec<String>,
    /// Vertex indices and properties of each triangle.
    pub faces: Vec<([u32; 3], Vec<f32>)>,
}

/// Writes a mesh.
pub fn write(path: &Path, mesh: &Mesh) -> Result<()> {
    let float = |name: &String| PropertyDef::new(name.clone(), PropertyType::Scalar(ScalarType::Float));
    let mut ply = Ply::<DefaultElement>::new();
    ply.header.encoding = Encoding::BinaryLittleEndian;
    ply.header.comments.push(format!("format {}", mesh.format));
    ply.header.comments.extend(mesh.comments.iter().cloned());
    let mut vertex = ElementDef::new("vertex".into());
    mesh.vertex_properties.iter().for_each(|p| vertex.properties.add(float(p)));
    ply.header.elements.add(vertex);
    let row = |names: &[String], values: &[f32]| {
        names.iter().cloned().zip(values.iter().map(|v| Property::Float(*v))).collect::<DefaultElement>()
    };
    let vertices = mesh.vertices.iter().map(|v| row(&mesh.vertex_properties, v)).collect();
    ply.payload.insert("vertex".into(), vertices);
    if !mesh.faces.is_empty() {
        let mut face = ElementDef::new("face".into());
        let indices = PropertyType::List(ScalarType::UChar, ScalarType::Int);
        face.properties.add(PropertyDef::new("vertex_indices".into(), indices));
        mesh.face_properties.iter().for_each(|p| face.properties.add(float(p)));
        ply.header.elements.add(face);
        let faces = mesh.faces.iter().map(|(indices, values)| {
            let mut face = row(&mesh.face_properties, values);
            face.insert(
                "vertex_indices".into(),
                Property::ListInt(indices.iter().map(|i| *i as i32).collect()),
            );
            face
        });
        ply.payload.insert("face".into(), faces.collect());
    }
    let mut file = BufWriter::new(File::create(path).at("writing", path)?);
    Writer::new().write_ply(&mut file, &mut ply).at("writing", path)?;
    file.flush().at("writing", path)
}

/// Reads a mesh of the given format; refuses another one, damaged files and values that are not finite.
pub fn read(path: &Path, format: &str) -> Result<Mesh> {
    let refuse = |problem: String| Error::file("reading a PLY", path, problem, remake(path));
    let mut file = BufReader::new(File::open(path).at("reading", path)?);
    let ply = Parser::<DefaultElement>::new()
        .read_ply(&mut file)
        .map_err(|e| refuse(format!("damaged or cut short ({e})")))?;
    let found = ply.header.comments.iter().find_map(|c| c.strip_prefix("format "));
    match found {
        Some(found) if found == format => {}
        Some(found) => return Err(refuse(format!("has format `{found}`, this insitu reads `{format}`"))),
        None => return Err(refuse(format!("names no format, expected `{format}`"))),
    }
    let scalars = |element: &str| -> Vec<String> {
        let definition = ply.header.elements.get(element);
        let properties = definition.iter().flat_map(|e| e.properties.values());
        properties
            .filter(|p| matches!(p.data_type, PropertyType::Scalar(_)))
            .map(|p| p.name.clone())
            .collect()
    };
    let row = |element: &DefaultElement, names: &[String]| -> Result<Vec<f32>> {
        let value = |name: &String| match element.get(name) {
            Some(Property::Float(v)) if v.is_finite() => Ok(*v),
            other => Err(refuse(format!("property {name} is {other:?}, expected a finite float"))),
        };
        names.iter().map(value).collect()
    };
    let vertex_properties = scalars("vertex");
    let face_properties = scalars("face");
    let rows = |name: &str| ply.payload.get(name).map(Vec::as_slice).unwrap_or_default();
    let vertices: Vec<_> =
        rows("vertex").iter().map(|v| row(v, &vertex_properties)).collect::<Result<_>>()?;
    let face = |f: &DefaultElement| match f.get("vertex_indices") {
        Some(Property::ListInt(list))
            if list.len() == 3 && list.iter().all(|i| (*i as usize) < vertices.len()) =>
        {
            Ok(([list[0] as u32, list[1] as u32, list[2] as u32], row(f, &face_properties)?))
        }
        other => Err(refuse(format!("a face has indices {other:?}"))),
    };
    let faces = rows("face").iter().map(face).collect::<Result<_>>()?;
    let comments = ply.header.comments.iter().filter(|c| !c.starts_with("format ")).cloned().collect();
    Ok(Mesh { format: format.into(), comments, vertex_properties, vertices, face_properties, faces })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh() -> Mesh {
        Mesh {
            format: "insitu-test 1".into(),
            comments: vec!["metres".into()],
            vertex_properties: ["x", "y", "z"].map(String::from).to_vec(),
            vertices: vec![vec![0.0, 1.5, -2.0], vec![1.0, 1.0, 1.0], vec![0.25, 3e-7, 9.0]],
            face_properties: vec!["radiance_red".into()],
            faces: vec![([0, 1, 2], vec![12.5])],
        }
    }

    #[test]
    fn survives_exactly() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.ply");
        write(&path, &mesh()).unwrap();
        assert_eq!(read(&path, "insitu-test 1").unwrap(), mesh());
    }

    #[test]
    fn another_version_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.ply");
        write(&path, &mesh()).unwrap();
        let message = read(&path, "insitu-test 2").unwrap_err().to_string();
        assert!(
            message.contains("has format `insitu-test 1`, this insitu reads `insitu-test 2`"),
            "{message}"
        );
    }

    #[test]
    fn cut_short_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.ply");
        write(&path, &mesh()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 7]).unwrap();
        assert!(read(&path, "insitu-test 1").is_err());
    }
}

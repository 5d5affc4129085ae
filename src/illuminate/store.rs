//! `patches.ply` and `distant.json`.

use super::patch::{DistantSource, Evidence, LightModel, Patch, PatchMesh};
use crate::artefact::json::{self, JsonArtefact};
use crate::artefact::{exr, ply};
use crate::error::{Error, Result};
use crate::image::RadianceImage;
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::path::Path;

const FORMAT: &str = "insitu-patches 1";
const VERTEX: [&str; 6] = ["x", "y", "z", "nx", "ny", "nz"];
const FACE: [&str; 8] = [
    "radiance_red",
    "radiance_green",
    "radiance_blue",
    "reflectance_red",
    "reflectance_green",
    "reflectance_blue",
    "evidence",
    "face",
];

/// `distant.json`.
#[derive(Debug, Serialize, Deserialize)]
struct DistantFile {
    sources: Vec<DistantSource>,
}

impl JsonArtefact for DistantFile {
    const FORMAT: &'static str = "insitu-distant";
    const VERSION: u32 = 1;
}

/// Writes `patches.ply` and `distant.json` into a folder.
pub fn write_light(folder: &Path, light: &LightModel) -> Result<()> {
    let m = &light.mesh;
    let comments = [
        "metres, +Y up, right-handed; front side counter-clockwise",
        "radiance: Rec. 709, plate units (1 saturates the plate); reflectance: diffuse, 0..1",
        "evidence: 0 probe, 1 plate, 2 gathered; face: index into scene.json",
    ];
    let mesh = ply::Mesh {
        format: FORMAT.into(),
        comments: comments.map(String::from).to_vec(),
        vertex_properties: VERTEX.map(String::from).to_vec(),
        vertices: m
            .vertices
            .iter()
            .zip(&m.normals)
            .map(|(v, n)| vec![v.x, v.y, v.z, n.x, n.y, n.z])
            .collect(),
        face_properties: FACE.map(String::from).to_vec(),
        faces: m
            .patches
            .iter()
            .map(|p| {
                let mut row = p.radiance.to_vec();
                row.extend(p.reflectance);
                row.extend([f32::from(p.evidence as u8), p.face as f32]);
                (p.vertices, row)
            })
            .collect(),
    };
    ply::write(&folder.join("patches.ply"), &mesh)?;
    json::write(&folder.join("distant.json"), &DistantFile { sources: light.distant.clone() })
}

/// The distant light of a model as the picture beside it, `distant.exr`; `None` where the model lets none in.
pub fn read_sky(path: &Path, light: &LightModel) -> Result<Option<RadianceImage>> {
    if light.distant.is_empty() { Ok(None) } else { exr::read_radiance(path).map(Some) }
}

/// Reads what [`write_light`] wrote.
pub fn read_light(folder: &Path) -> Result<LightModel> {
    let path = folder.join("patches.ply");
    let mesh = ply::read(&path, FORMAT)?;
    let refuse = |problem: String| {
        Error::file("reading the patches", &path, problem, "run `insitu run --force --from illuminate`")
    };
    if mesh.vertex_properties != VERTEX || (!mesh.faces.is_empty() && mesh.face_properties != FACE) {
        return Err(refuse(format!(
            "has properties {:?} and {:?}",
            mesh.vertex_properties, mesh.face_properties
        )));
    }
    let patch = |(vertices, row): &([u32; 3], Vec<f32>)| -> Result<Patch> {
        let evidence = match row[6] {
            0.0 => Evidence::Probe,
            1.0 => Evidence::Plate,
            2.0 => Evidence::Gathered,
            other => return Err(refuse(format!("a patch has evidence {other}"))),
        };
        Ok(Patch {
            vertices: *vertices,
            face: row[7] as u32,
            radiance: [row[0], row[1], row[2]],
            reflectance: [row[3], row[4], row[5]],
            evidence,
        })
    };
    let distant: DistantFile = json::read(&folder.join("distant.json"))?;
    Ok(LightModel {
        mesh: PatchMesh {
            vertices: mesh.vertices.iter().map(|v| Vec3::new(v[0], v[1], v[2])).collect(),
            normals: mesh.vertices.iter().map(|v| Vec3::new(v[3], v[4], v[5])).collect(),
            patches: mesh.faces.iter().map(patch).collect::<Result<_>>()?,
        },
        distant: distant.sources,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_survives_exactly() {
        let light = LightModel {
            mesh: PatchMesh {
                vertices: vec![Vec3::ZERO, Vec3::X, Vec3::Z],
                normals: vec![-Vec3::Y; 3],
                patches: vec![Patch {
                    vertices: [0, 1, 2],
                    face: 3,
                    radiance: [1.0, 2e5, 3e-7],
                    reflectance: [0.1, 0.2, 0.3],
                    evidence: Evidence::Plate,
                }],
            },
            distant: vec![DistantSource { direction: Vec3::Y, solid_angle_sr: 0.1, radiance: [4.0; 3] }],
        };
        let folder = tempfile::tempdir().unwrap();
        write_light(folder.path(), &light).unwrap();
        assert_eq!(read_light(folder.path()).unwrap(), light);
    }
}

//! The strongest light as glTF knows light (KHR_lights_punctual): a spot for each face that shines, a direction for the sun.

use super::build::shines;
use super::patch::LightModel;
use crate::image::luminance;
use crate::irradiance::Beams;
use crate::model::gltf::{Light, LightKind};
use glam::Vec3;
use std::collections::BTreeMap;

/// Lights stand this far in front of their face, m.
const BEFORE_M: f32 = 0.01;
/// A face that sends less than this share of all power is left out.
const LEAST_SHARE: f64 = 1e-3;

/// Lights of the model, strongest first; `irradiance` is that of each patch. A face of radiance L and area A becomes a spot over
/// its half-space of intensity L A: along its normal it lights as the face does, and it falls off towards the face's plane, as a
/// face does by the cosine. A beam keeps its irradiance.
pub fn lights(light: &LightModel, irradiance: &[[f32; 3]], name: impl Fn(u32) -> String) -> Vec<Light> {
    let mesh = &light.mesh;
    let mut faces: BTreeMap<u32, ([f32; 3], Vec3, Vec3, f32)> = BTreeMap::new();
    let mut all = 0.0;
    for (i, patch) in mesh.patches.iter().enumerate() {
        let area = mesh.area(i);
        let power = luminance(patch.radiance) * area;
        all += f64::from(power);
        if shines(patch.radiance, irradiance[i]) {
            let sum = faces.entry(patch.face).or_default();
            (0..3).for_each(|k| sum.0[k] += patch.radiance[k] * area);
            sum.1 += mesh.centroid(i) * power;
            sum.2 = mesh.normal(i);
            sum.3 += power;
        }
    }
    let mut lights: Vec<Light> = faces
        .into_iter()
        .filter(|(_, sum)| f64::from(sum.3) > LEAST_SHARE * all)
        .map(|(face, (intensity, moment, normal, power))| Light {
            name: name(face),
            kind: LightKind::Spot { at: moment / power + normal * BEFORE_M },
            towards: normal,
            intensity,
        })
        .collect();
    lights.extend(Beams::sources(&light.distant).into_iter().map(|s| Light {
        name: "sun".into(),
        kind: LightKind::Directional,
        towards: -s.direction,
        intensity: s.radiance.map(|l| l * s.solid_angle_sr),
    }));
    lights.sort_by(|a, b| luminance(b.intensity).total_cmp(&luminance(a.intensity)));
    lights
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illuminate::mesh::{FaceMesh, assemble};
    use crate::illuminate::patch::DistantSource;
    use crate::illuminate::room;

    #[test]
    fn a_shining_ceiling_and_a_sun_keep_their_intensity() {
        let meshes: Vec<_> = room::faces(2.0, 2.0, 3.0).iter().map(FaceMesh::new).collect();
        let mut mesh = assemble(&meshes);
        mesh.patches.iter_mut().filter(|p| p.face == 1).for_each(|p| p.radiance = [4.0, 2.0, 1.0]);
        let irradiance: Vec<_> =
            mesh.patches.iter().map(|p| if p.face == 1 { [0.5; 3] } else { [2.0; 3] }).collect();
        let sun =
            DistantSource { direction: Vec3::new(0.0, 0.6, 0.8), solid_angle_sr: 1e-3, radiance: [5e3; 3] };
        let light = LightModel { mesh, distant: vec![sun] };
        let all = lights(&light, &irradiance, |f| format!("face {f}"));
        assert_eq!(all.len(), 2);
        assert_eq!((all[0].name.as_str(), all[0].intensity), ("face 1", [24.0, 12.0, 6.0]));
        let LightKind::Spot { at } = all[0].kind else { panic!("{:?}", all[0]) };
        assert!((at - Vec3::new(0.0, 1.99, 0.0)).length() < 1e-5 && all[0].towards == -Vec3::Y);
        assert!((all[1].intensity[0] - 5.0).abs() < 1e-5 && all[1].towards.y < 0.0);
    }
}

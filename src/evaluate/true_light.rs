//! The truth of light in a rendered capture: irradiance at points, reflectance of surfaces.

use super::truth::{Problem, Truth};
use crate::sh;
use glam::{DMat3, Vec3};
use nalgebra::Point3;
use serde_json::Value;
use std::collections::BTreeMap;

/// Irradiance at a point of the empty scene, in harmonics up to l = 2.
#[derive(Debug, Clone)]
pub struct TrueIrradiance {
    /// Where, world, m.
    pub position: Vec3,
    /// Of irradiance by normal, in the truth's axes, plate units.
    harmonics: sh::Coefficients,
    truth_from_world: DMat3,
}

impl TrueIrradiance {
    /// Irradiance on a surface of unit normal, plate units.
    pub fn on(&self, normal: Vec3) -> [f32; 3] {
        sh::evaluate(&self.harmonics, (self.truth_from_world * normal.as_dvec3()).as_vec3())
    }
}

impl Truth {
    /// The points at which irradiance is known; `scale`: plate units in one unit of the truth.
    pub fn irradiance(&self, scale: f64) -> Result<Vec<TrueIrradiance>, Problem> {
        let world_from_truth = self.world_from_truth()?;
        let rotation = world_from_truth.rotation.inverse().to_rotation_matrix();
        let truth_from_world = DMat3::from_cols_slice(rotation.matrix().as_slice());
        let shape = || Problem::Shape("irradiance_probes.points".into());
        let points = self.value["irradiance_probes"]["points"].as_array().ok_or_else(shape)?;
        let point = |p: &Value| {
            let at = Point3::from(Self::numbers::<3>(&p["position"], "irradiance_probes.position")?);
            let at = world_from_truth * at;
            let flat: [f64; 3 * sh::COUNT] =
                Self::numbers(&p["irradiance_sh"], "irradiance_probes.irradiance_sh")?;
            let harmonics =
                std::array::from_fn(|i| std::array::from_fn(|k| (flat[3 * i + k] * scale) as f32));
            let position = Vec3::new(at.x as f32, at.y as f32, at.z as f32);
            Ok(TrueIrradiance { position, harmonics, truth_from_world })
        };
        points.iter().map(point).collect()
    }

    /// Diffuse reflectance of the primitives that reflect, by name; of a texture its mean.
    pub fn reflectances(&self) -> Result<BTreeMap<String, [f64; 3]>, Problem> {
        let mut all = BTreeMap::new();
        for primitive in self.primitives()?.iter().filter(|p| p["emit"].is_null()) {
            let name = primitive["name"].as_str().ok_or(Problem::Shape("primitives.name".into()))?;
            let material = &primitive["mat"];
            let value = match material["texture"].as_str() {
                Some(texture) => &self.value["textures"]["mean"][texture],
                None => &material["diffuse"],
            };
            all.insert(name.to_string(), Self::numbers(value, "primitives.mat")?);
        }
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// The grid lies at (1, 2, 0), turned by 90° about z, in a world whose z is up.
    fn truth() -> Truth {
        let mut harmonics = vec![[0.0; 3]; sh::COUNT];
        // 2 + x of the truth's axes: Y00 = 0.2821, Y11 = 0.4886 x.
        harmonics[0] = [2.0 / 0.282_094_8; 3];
        harmonics[3] = [1.0 / 0.488_602_5; 3];
        Truth::new(json!({
            "grid": {"world_from_board": [[0,-1,0,1],[1,0,0,2],[0,0,1,0],[0,0,0,1]]},
            "irradiance_probes": {"points": [{"position": [1, 3, 0.5], "irradiance_sh": harmonics}]},
            "textures": {"mean": {"tiles": [0.4, 0.3, 0.2]}},
            "primitives": [
                {"name": "floor", "mat": {"texture": "tiles"}, "emit": null},
                {"name": "wall", "mat": {"diffuse": [0.6, 0.5, 0.5]}, "emit": null},
                {"name": "lamp", "mat": {"diffuse": [0, 0, 0]}, "emit": [9, 9, 9]}
            ]
        }))
    }

    #[test]
    fn irradiance_turns_with_the_world() {
        let point = &truth().irradiance(0.5).unwrap()[0];
        assert!((point.position - Vec3::new(1.0, 0.5, 0.0)).length() < 1e-6);
        // The truth's x is −y of the grid, and that is our +z.
        let along = |n: Vec3| point.on(n)[1];
        assert!((along(Vec3::Z) - 1.5).abs() < 1e-5 && (along(Vec3::NEG_Z) - 0.5).abs() < 1e-5);
        assert!((along(Vec3::Y) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn lamps_reflect_nothing_and_textures_their_mean() {
        let all = truth().reflectances().unwrap();
        assert_eq!(all.len(), 2);
        assert_eq!((all["floor"], all["wall"]), ([0.4, 0.3, 0.2], [0.6, 0.5, 0.5]));
    }
}

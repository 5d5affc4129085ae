//! Single stages against the truth of a rendered capture (`truth.json`; its world is +Z up).

use super::compare::{Comparison, Ours};
use super::errors;
use super::figures::Measured;
use crate::calibrate::world_from_grid;
use crate::camera::Camera;
use crate::image::RadianceImage;
use nalgebra::{Matrix4, Point3, Vector4};
use serde_json::Value;

/// Why a `truth.json` cannot be used.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum Problem {
    /// A key is missing or of another shape.
    #[error("`{0}` is missing or not of the expected shape")]
    Shape(String),
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        "`evaluate.truth` takes the truth.json of a rendered capture".into()
    }
}

/// The parts of `truth.json` that stages are judged by.
#[derive(Debug, Clone)]
pub struct Truth {
    pub(super) value: Value,
}

pub(super) fn numbers(value: &Value) -> Option<Vec<f64>> {
    match value {
        Value::Array(list) => list.iter().map(numbers).collect::<Option<Vec<_>>>().map(|l| l.concat()),
        Value::Number(n) => n.as_f64().map(|v| vec![v]),
        _ => None,
    }
}

impl Truth {
    /// Takes a parsed `truth.json`.
    pub fn new(value: Value) -> Self {
        Self { value }
    }

    pub(super) fn numbers<const N: usize>(value: &Value, name: &str) -> Result<[f64; N], Problem> {
        numbers(value).and_then(|v| v.try_into().ok()).ok_or_else(|| Problem::Shape(name.into()))
    }

    /// The image of that file name, otherwise the first of role `plate`.
    pub(super) fn image(&self, file: &str) -> Result<&Value, Problem> {
        let images = self.value["images"].as_array().map(Vec::as_slice).unwrap_or_default();
        images
            .iter()
            .find(|i| i["file"] == file)
            .or_else(|| images.iter().find(|i| i["role"] == "plate"))
            .ok_or_else(|| Problem::Shape("images".into()))
    }

    /// A point of the truth's world in the grid's frame, m.
    fn in_grid(&self, world: [f64; 3]) -> Result<Point3<f64>, Problem> {
        let m: [f64; 16] = Self::numbers(&self.value["grid"]["world_from_board"], "grid.world_from_board")?;
        let grid_from_world = Matrix4::from_row_slice(&m)
            .try_inverse()
            .ok_or_else(|| Problem::Shape("grid.world_from_board".into()))?;
        let p = grid_from_world * Vector4::new(world[0], world[1], world[2], 1.0);
        Ok(Point3::new(p.x, p.y, p.z))
    }

    /// Focal length and place of the plate's camera.
    pub fn judge_camera(&self, camera: &Camera, file: &str, out: &mut Measured) -> Result<(), Problem> {
        let [fx, fy] = [&self.value["intrinsics"]["fx"], &self.value["intrinsics"]["fy"]]
            .map(|v| v.as_f64().filter(|f| *f > 0.0));
        let (Some(fx), Some(fy)) = (fx, fy) else { return Err(Problem::Shape("intrinsics.fx".into())) };
        let [ours_x, ours_y] = camera.intrinsics.focal_px;
        out.put("focal_error_percent", 100.0 * ((ours_x + ours_y) / (fx + fy) - 1.0));
        let image = self.image(file)?;
        let r: [f64; 9] = Self::numbers(&image["R"], "images.R")?;
        let t: [f64; 3] = Self::numbers(&image["t"], "images.t")?;
        // Xc = R Xw + t, so the centre is −Rᵀ t.
        let centre = std::array::from_fn(|k| -(r[k] * t[0] + r[3 + k] * t[1] + r[6 + k] * t[2]));
        let truth = self.in_grid(centre)?;
        let distance = (world_from_grid().inverse_transform_point(&camera.centre()) - truth).norm();
        out.put("camera_position_error_percent", 100.0 * distance / truth.coords.norm());
        Ok(())
    }

    /// Place of the mirror ball.
    pub fn judge_ball(&self, centre: &Point3<f64>, out: &mut Measured) -> Result<(), Problem> {
        let truth = self.in_grid(Self::numbers(&self.value["sphere"]["centre"], "sphere.centre")?)?;
        out.put(
            "ball_centre_error_mm",
            1e3 * (world_from_grid().inverse_transform_point(centre) - truth).norm(),
        );
        Ok(())
    }

    /// Response curve; `exposure_of` maps codes to relative exposure. One factor common to all channels is free: it is a
    /// choice of unit.
    pub fn judge_response(
        &self,
        exposure_of: impl Fn([f32; 3]) -> [f32; 3],
        out: &mut Measured,
    ) -> Result<(), Problem> {
        let shape = || Problem::Shape("response".into());
        let x = numbers(&self.value["response"]["x"]).ok_or_else(shape)?;
        let y: Vec<Vec<f64>> = self.value["response"]["y_rgb"]
            .as_array()
            .and_then(|channels| channels.iter().map(numbers).collect())
            .ok_or_else(shape)?;
        if y.len() != 3 || y.iter().any(|c| c.len() != x.len()) {
            return Err(shape());
        }
        let mut stops = Vec::new();
        for (i, x) in x.iter().enumerate().filter(|(_, x)| **x > 0.02 && **x < 1.0) {
            let ours = exposure_of([0, 1, 2].map(|k: usize| y[k][i] as f32));
            stops.extend(ours.iter().map(|v| (f64::from(*v).max(1e-9) / x).log2()));
        }
        let mean = stops.iter().sum::<f64>() / stops.len().max(1) as f64;
        let square: f64 = stops.iter().map(|s| (s - mean).powi(2)).sum();
        out.put("response_error_stops", (square / stops.len().max(1) as f64).sqrt());
        out.put("response_scale_stops", mean);
        Ok(())
    }

    /// Plate units in one unit of the truth's radiance.
    pub fn plate_scale(&self, file: &str) -> Result<f64, Problem> {
        self.image(file)?["exposure_scale"]
            .as_f64()
            .ok_or_else(|| Problem::Shape("images.exposure_scale".into()))
    }

    /// Merged radiance without a free scale: the plate against the empty reference at the truth's own exposure.
    pub fn judge_radiance(
        &self,
        ours: &Ours,
        empty: &RadianceImage,
        file: &str,
        out: &mut Measured,
    ) -> Result<(), Problem> {
        let usable = ours.clipped.map(|c| !c);
        let scale = self.plate_scale(file)?;
        if let Some(e) = errors::median_relative_error(ours.plate, empty, &usable, scale) {
            out.put("radiance_error_unscaled_percent", 100.0 * e);
        }
        Ok(())
    }

    /// Noise of the reference's ε*, from two seeds; says so where it is not known.
    pub fn judge_noise(
        &self,
        reference: &str,
        comparison: &Comparison,
        out: &mut Measured,
    ) -> Option<String> {
        match (self.difference_noise(reference), comparison.rms_and_mean) {
            (Some(noise), Some((rms, mean))) => {
                out.put("reference_noise", noise * mean / rms);
                None
            }
            (None, _) => Some(format!("The noise of the reference {reference} is unknown.")),
            (_, None) => None,
        }
    }

    /// Noise of the difference of a reference, by its file's stem, and the empty one, as a share of the mean radiance
    /// where they differ; `None` if it was not measured.
    pub fn difference_noise(&self, reference: &str) -> Option<f64> {
        self.value["truth_noise"][reference]["difference_rmse_over_mean_where_changed_5pct"].as_f64()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use nalgebra::{Isometry3, Vector3};
    use serde_json::json;
    use std::f64::consts::FRAC_1_SQRT_2;

    /// The grid lies at (1, 2, 0), turned by 90° about z; the camera at (1, 2, 4) in the truth's world.
    fn truth() -> Truth {
        Truth::new(json!({
            "intrinsics": {"fx": 500.0, "fy": 500.0},
            "images": [{"file": "p.jpg", "role": "plate", "exposure_scale": 1.5,
                "R": [[1,0,0],[0,-1,0],[0,0,-1]], "t": [-1, 2, 4]}],
            "grid": {"world_from_board": [[0,-1,0,1],[1,0,0,2],[0,0,1,0],[0,0,0,1]]},
            "sphere": {"centre": [1, 3, 0.5]},
            "response": {"x": [0.0, 0.01, 0.25, 0.5, 1.0], "y_rgb": [[0.0, 0.1, 0.5, FRAC_1_SQRT_2, 1.0],
                [0.0, 0.1, 0.5, FRAC_1_SQRT_2, 1.0], [0.0, 0.1, 0.5, FRAC_1_SQRT_2, 1.0]]},
            "truth_noise": {"with_object_floor": {"difference_rmse_over_mean_where_changed_5pct": 0.013}}
        }))
    }

    fn value(out: &Measured, name: &str) -> f64 {
        out.figures(&Default::default()).iter().find(|f| f.name == name).unwrap().value.unwrap()
    }

    #[test]
    fn cameras_are_compared_in_the_grids_frame() {
        let mut out = Measured::default();
        // 4 m above the grid is (0, 4, 0) in our world; ours is 2 cm off and 1 % too long.
        let camera = Camera {
            intrinsics: Intrinsics::pinhole(640, 480, 505.0),
            world_from_camera: Isometry3::new(Vector3::new(0.02, 4.0, 0.0), Vector3::zeros()),
        };
        truth().judge_camera(&camera, "p.jpg", &mut out).unwrap();
        assert!((value(&out, "focal_error_percent") - 1.0).abs() < 1e-9);
        assert!((value(&out, "camera_position_error_percent") - 0.5).abs() < 1e-9);
    }

    #[test]
    fn balls_are_compared_in_millimetres() {
        let mut out = Measured::default();
        // (1, 3, 0.5) lies 1 m along the board's x: (1, 0, 0.5) in its frame, (1, 0.5, 0) in our world.
        truth().judge_ball(&Point3::new(1.0, 0.503, -0.004), &mut out).unwrap();
        assert!((value(&out, "ball_centre_error_mm") - 5.0).abs() < 1e-6);
    }

    #[test]
    fn a_response_is_judged_up_to_one_factor() {
        let mut out = Measured::default();
        truth().judge_response(|c| c.map(|v| 2.0 * v * v), &mut out).unwrap();
        assert!(value(&out, "response_error_stops") < 1e-5);
        assert!((value(&out, "response_scale_stops") - 1.0).abs() < 1e-5);
        truth().judge_response(|c| [c[0] * c[0], c[1] * c[1], 2.0 * c[2] * c[2]], &mut out).unwrap();
        assert!(
            (value(&out, "response_error_stops") - (2.0f64 / 9.0).sqrt()).abs() < 1e-5,
            "tint is an error"
        );
    }

    #[test]
    fn another_shape_is_refused_by_name() {
        let bad = Truth::new(json!({"images": []}));
        assert_eq!(bad.plate_scale("p.jpg").unwrap_err(), Problem::Shape("images".into()));
        assert!(bad.judge_ball(&Point3::origin(), &mut Measured::default()).is_err());
        assert_eq!(truth().plate_scale("other.jpg").unwrap(), 1.5, "the first plate stands in");
        assert_eq!(truth().difference_noise("with_object_floor"), Some(0.013));
        assert_eq!(truth().difference_noise("with_object_raised"), None);
    }
}

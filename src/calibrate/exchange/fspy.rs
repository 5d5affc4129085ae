//! Projects of fSpy: a header, the state as JSON, the photograph. The camera looks along −z of its own frame, y up; lengths in the
//! picture are in halves of its longer side, about its middle, y up.

use super::{Problem, posed};
use crate::camera::{Camera, Intrinsics};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;

const MAGIC: &[u8; 4] = b"fspy";
const VERSION: u32 = 1;
const HEADER: usize = 16;
const KIND: &str = "project of fSpy";

/// The camera of a project.
pub fn read(bytes: &[u8]) -> Result<Camera, Problem> {
    let cut = || Problem::NotOne(KIND);
    let header: &[u8; HEADER] = bytes.first_chunk().ok_or(cut())?;
    let number = |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    if &header[..4] != MAGIC || number(4) != VERSION {
        return Err(cut());
    }
    let state = bytes.get(HEADER..HEADER + number(8) as usize).ok_or(cut())?;
    let state: Value = serde_json::from_slice(state).map_err(|_| cut())?;
    let camera = &state["cameraParameters"];
    if camera.is_null() {
        return Err(Problem::NoSolution("its vanishing points were not solved".into()));
    }
    let of = |value: &Value, name: &str| {
        value
            .as_f64()
            .filter(|v| v.is_finite())
            .ok_or_else(|| Problem::NoSolution(format!("`{name}` is missing")))
    };
    let (width, height) =
        (of(&camera["imageWidth"], "imageWidth")?, of(&camera["imageHeight"], "imageHeight")?);
    let half = 0.5 * width.max(height);
    let focal = half * of(&camera["relativeFocalLength"], "relativeFocalLength")?;
    let x = of(&camera["principalPoint"]["x"], "principalPoint")?;
    let y = of(&camera["principalPoint"]["y"], "principalPoint")?;
    let row = |i: usize, j: usize| of(&camera["cameraTransform"]["rows"][i][j], "cameraTransform");
    let mut turn = Matrix3::zeros();
    for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
        turn[(i, j)] = row(i, j)?;
    }
    let at = Vector3::new(row(0, 3)?, row(1, 3)?, row(2, 3)?);
    let off = (turn.transpose() * turn - Matrix3::identity()).amax();
    if !(width >= 1.0 && height >= 1.0 && focal > 0.0) || off > 1e-3 || turn.determinant() < 0.0 {
        return Err(Problem::NoSolution("its camera is none of a lens".into()));
    }
    // Ours looks along +z, y down.
    let turn = Rotation3::from_matrix(&(turn * Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0))));
    let grid_from_camera =
        Isometry3::from_parts(Translation3::from(at), UnitQuaternion::from_rotation_matrix(&turn));
    let intrinsics = Intrinsics {
        principal_point_px: [0.5 * width + half * x, 0.5 * height - half * y],
        ..Intrinsics::pinhole(width as u32, height as u32, focal)
    };
    Ok(posed(intrinsics, &grid_from_camera.inverse()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::world_from_grid;
    use nalgebra::Point3;
    use serde_json::json;

    fn project(state: &Value) -> Vec<u8> {
        let text = state.to_string();
        let mut bytes = MAGIC.to_vec();
        [VERSION, text.len() as u32, 0].iter().for_each(|n| bytes.extend(n.to_le_bytes()));
        bytes.extend(text.as_bytes());
        bytes
    }

    /// 4 m along −y of a z-up world from its origin, looking along +y: the camera's −z is the world's y, its y the world's z.
    fn state(width: u32, height: u32) -> Value {
        json!({"cameraParameters": {
            "principalPoint": {"x": 0.1, "y": 0.05},
            "cameraTransform": {"rows": [
                [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, -4.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]
            ]},
            "relativeFocalLength": 1.5, "imageWidth": width, "imageHeight": height,
        }})
    }

    #[test]
    fn landscape_and_portrait_see_a_point_where_fspy_has_it() {
        for (width, height) in [(1200, 800), (800, 1200)] {
            let camera = read(&project(&state(width, height))).unwrap();
            // 1 m to the right and 0.5 m up, 4 m away.
            let seen = camera.project(&(world_from_grid() * Point3::new(1.0, 0.0, 0.5))).unwrap();
            let middle = [f64::from(width) / 2.0, f64::from(height) / 2.0];
            let expected = [middle[0] + 60.0 + 900.0 * 0.25, middle[1] - 30.0 - 900.0 * 0.125];
            assert!((seen.x - expected[0]).abs() < 1e-9 && (seen.y - expected[1]).abs() < 1e-9, "{seen}");
        }
    }

    #[test]
    fn what_is_no_project_is_refused() {
        let good = project(&state(1200, 800));
        assert_eq!(read(&good[..40]), Err(Problem::NotOne(KIND)));
        assert_eq!(read(b"JFIF"), Err(Problem::NotOne(KIND)));
        let unsolved = read(&project(&json!({"cameraParameters": null}))).unwrap_err();
        assert_eq!(unsolved.to_string(), "holds no camera: its vanishing points were not solved");
        let mut mirrored = state(1200, 800);
        mirrored["cameraParameters"]["cameraTransform"]["rows"][0][0] = json!(-1.0);
        assert!(matches!(read(&project(&mirrored)), Err(Problem::NoSolution(_))));
    }
}

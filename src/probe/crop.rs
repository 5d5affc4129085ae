//! A ball cut out of its photograph: it touches the sides of the crop, and where the camera stood is said by the settings.

use super::{ProbeFit, Problem};
use crate::calibrate::world_from_grid;
use crate::camera::{Camera, Intrinsics};
use crate::config::{self, ProbeSource};
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Unit direction of an azimuth (from the grid's +x towards its +y) and an elevation, world, and what is up there.
pub fn looking(azimuth_deg: f64, elevation_deg: f64) -> (Vector3<f64>, Vector3<f64>) {
    let ((sa, ca), (se, ce)) = (azimuth_deg.to_radians().sin_cos(), elevation_deg.to_radians().sin_cos());
    let world = world_from_grid();
    (world * Vector3::new(ce * ca, ce * sa, se), world * Vector3::new(-se * ca, -se * sa, ce))
}

/// Azimuth and elevation of a camera as seen from its ball, degrees; inverse of [`looking`].
pub fn direction_deg(fit: &ProbeFit) -> [f64; 2] {
    let d = world_from_grid().inverse() * (fit.camera.centre() - fit.centre).normalize();
    [d.y.atan2(d.x).to_degrees(), d.z.clamp(-1.0, 1.0).asin().to_degrees()]
}

/// Rotation of a camera that looks along `forward`, with `up` up in its picture; both at right angles.
pub fn rotation(forward: &Vector3<f64>, up: &Vector3<f64>) -> Rotation3<f64> {
    Rotation3::from_basis_unchecked(&[forward.cross(up), -up, *forward])
}

/// The ball in a crop of a size, px: its camera stands at `distance_m` in the direction given and looks at its middle.
pub fn fit(
    (width, height): (usize, usize),
    direction_deg: [f64; 2],
    settings: &config::Probe,
) -> Result<ProbeFit, Problem> {
    let sine = settings.radius_m / settings.distance_m;
    if !(sine > 0.0 && sine < 0.95) {
        return Err(Problem::Near { distance_m: settings.distance_m, radius_m: settings.radius_m });
    }
    let radius_px = width.min(height) as f64 / 2.0;
    if 2.0 * radius_px < super::find::MIN_DIAMETER_PX {
        return Err(Problem::TooSmall {
            diameter_px: 2.0 * radius_px,
            needed_px: super::find::MIN_DIAMETER_PX,
        });
    }
    let focal = radius_px / sine.asin().tan();
    let centre = world_from_grid() * Point3::from(settings.position_m);
    let (towards, up) = looking(direction_deg[0], direction_deg[1]);
    let eye = centre + towards * settings.distance_m;
    let camera = Camera {
        intrinsics: Intrinsics::pinhole(width as u32, height as u32, focal),
        world_from_camera: Isometry3::from_parts(
            Translation3::from(eye.coords),
            UnitQuaternion::from_rotation_matrix(&rotation(&-towards, &up)),
        ),
    };
    Ok(ProbeFit::stated(ProbeSource::Ball, camera, centre, settings.radius_m, 2.0 * radius_px))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::outline;

    #[test]
    fn the_ball_touches_the_sides_of_its_crop() {
        let settings = config::Probe { distance_m: 0.7, ..Default::default() };
        let fit = fit((300, 300), [30.0, 25.0], &settings).unwrap();
        let outline = outline::project(&fit.camera, &fit.centre, fit.radius_m, 64).unwrap();
        for p in &outline {
            let r = (p - nalgebra::Point2::new(150.0, 150.0)).norm();
            assert!((r - 150.0).abs() < 0.01, "{r}");
        }
        // Azimuth 90° is the grid's +y, our −z.
        let (d, up) = looking(90.0, 0.0);
        assert!((d - Vector3::new(0.0, 0.0, -1.0)).norm() < 1e-9 && (up - Vector3::y()).norm() < 1e-9);
        let above = fit.camera.centre().y - fit.centre.y;
        let [azimuth, elevation] = direction_deg(&fit);
        assert!((azimuth - 30.0).abs() < 1e-9 && (elevation - 25.0).abs() < 1e-9);
        assert!((above - 0.7 * 25f64.to_radians().sin()).abs() < 1e-9);
    }

    #[test]
    fn a_camera_in_the_ball_is_refused() {
        let settings = config::Probe { distance_m: 0.1, ..Default::default() };
        assert_eq!(
            fit((300, 300), [0.0; 2], &settings).unwrap_err(),
            Problem::Near { distance_m: 0.1, radius_m: 0.1 }
        );
    }
}

//! The camera of the probe's photographs.

use super::Problem;
use crate::calibrate::{self, Cameras};
use crate::camera::Camera;
use crate::config::{self, ProbeCamera};
use crate::image::{Image, RadianceImage};

/// Shares of the picture that are drawn white when the grid is looked for.
const WHITE: [f64; 4] = [0.1, 0.02, 0.3, 0.5];

/// The view in which the ball was photographed.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Lens and pose.
    pub camera: Camera,
    /// Distance of the grid's corners from where this camera sees them, rms in px, where it was found from the grid.
    pub grid_rms_px: Option<f64>,
}

/// The plate's camera, or the one that the printed grid in the picture gives, as `settings.camera` says.
pub fn find(
    picture: &RadianceImage,
    cameras: &Cameras,
    settings: &config::Probe,
    grid: &config::Calibrate,
) -> Result<View, Problem> {
    match settings.camera {
        ProbeCamera::Plate => from_plate(picture, cameras.plate_camera()),
        // A crop needs none of this: [`super::crop`].
        ProbeCamera::Grid | ProbeCamera::Crop => from_grid(picture, cameras, grid),
    }
}

fn from_plate(picture: &RadianceImage, camera: &Camera) -> Result<View, Problem> {
    let (width, height) = picture.size();
    let plate = [camera.intrinsics.width_px, camera.intrinsics.height_px].map(|n| n as usize);
    if [width, height] != plate {
        return Err(Problem::OtherSize { probe: [width, height], plate });
    }
    Ok(View { camera: camera.clone(), grid_rms_px: None })
}

/// Draws the picture at several exposures until the grid is found.
fn from_grid(picture: &RadianceImage, cameras: &Cameras, grid: &config::Calibrate) -> Result<View, Problem> {
    let mut luminance: Vec<f32> = picture.pixels().iter().map(|p| p.luminance()).collect();
    luminance.sort_by(f32::total_cmp);
    let mut problem = Problem::NoPicture;
    for white in WHITE {
        let Some(top) = luminance.get(((1.0 - white) * luminance.len().saturating_sub(1) as f64) as usize)
        else {
            break;
        };
        let top = top.max(f32::MIN_POSITIVE);
        let grey: Image<u8> =
            picture.map(|p| (255.0 * (p.luminance() / top).clamp(0.0, 1.0).powf(1.0 / 2.2)) as u8);
        match calibrate::grid_pose(&grey, &cameras.intrinsics, grid) {
            Ok(posed) => return Ok(View { camera: posed.camera, grid_rms_px: Some(posed.rms_px) }),
            Err(why) => problem = Problem::Grid(why),
        }
    }
    Err(problem)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::PosedCamera;
    use crate::camera::Intrinsics;
    use crate::image::Radiance;
    use crate::probe::synthetic::{look_at, render};
    use nalgebra::Point3;

    fn camera() -> Camera {
        look_at(Intrinsics::pinhole(640, 480, 600.0), Point3::new(0.2, 0.6, 0.5), Point3::origin())
    }

    fn cameras() -> Cameras {
        let posed = PosedCamera {
            camera: Camera { intrinsics: camera().intrinsics, world_from_camera: Default::default() },
            rms_px: 0.0,
            covariance: None,
            rival_rms_px: None,
        };
        Cameras::new("plate.jpg".into(), [("plate.jpg".to_string(), posed)].into(), None).unwrap()
    }

    /// The grid of the default settings with its disc, on a dim floor.
    fn floor(x: f64, z: f64) -> [f32; 3] {
        let (u, v) = (x / 0.06, -z / 0.06);
        let white = match (u.abs() < 4.0 && v.abs() < 3.0, u.abs() < 4.5 && v.abs() < 3.5) {
            (true, _) => (u.floor() + v.floor()) as i64 % 2 != 0,
            (_, true) => (u + 4.25).hypot(v + 3.25) > 0.15,
            _ => return [0.3; 3],
        };
        if white { [0.8; 3] } else { [0.04; 3] }
    }

    fn picture() -> RadianceImage {
        let elsewhere = Point3::new(0.0, 0.1, 50.0);
        render(&camera(), &elsewhere, 0.1, 0.9, |_| [0.0; 3], floor, 4)
    }

    fn found(picture: &RadianceImage, camera: ProbeCamera) -> Result<View, Problem> {
        let settings = config::Probe { camera, ..Default::default() };
        find(picture, &cameras(), &settings, &config::Calibrate::default())
    }

    #[test]
    fn a_grid_that_a_lamp_outshines_gives_the_camera() {
        let plain = picture();
        // A tenth of the picture, at its border.
        let lit =
            Image::from_fn(640, 480, |x, y| if x < 64 { Radiance([900.0; 3]) } else { *plain.at(x, y) });
        for picture in [plain, lit] {
            let view = found(&picture, ProbeCamera::Grid).unwrap();
            let off = (view.camera.centre() - camera().centre()).norm();
            assert!(off < 2e-3 && view.grid_rms_px.is_some_and(|rms| rms < 0.1), "{off} m off, {view:?}");
        }
    }

    #[test]
    fn without_a_grid_there_is_no_camera() {
        let bare = Image::from_fn(640, 480, |_, _| Radiance([0.5; 3]));
        assert!(matches!(found(&bare, ProbeCamera::Grid), Err(Problem::Grid(_))));
        let empty = Image::from_fn(0, 0, |_, _| Radiance([0.5; 3]));
        assert_eq!(found(&empty, ProbeCamera::Grid), Err(Problem::NoPicture));
    }

    #[test]
    fn the_plates_camera_takes_pictures_of_the_plates_size_alone() {
        let view = found(&picture(), ProbeCamera::Plate).unwrap();
        assert_eq!((view.camera, view.grid_rms_px), (cameras().plate_camera().clone(), None));
        let small = Image::from_fn(8, 6, |_, _| Radiance([0.5; 3]));
        let e = found(&small, ProbeCamera::Plate).unwrap_err();
        assert_eq!(e, Problem::OtherSize { probe: [8, 6], plate: [640, 480] });
    }
}

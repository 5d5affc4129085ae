use super::*;
use crate::camera::Intrinsics;
use crate::probe::synthetic::{look_at, render};

const RADIUS: f64 = 0.1;
const FLOOR: Surface = Surface { height_m: 0.0, board_half_m: None };

fn camera(focal_px: f64, target: Point3<f64>) -> Camera {
    look_at(Intrinsics::pinhole(320, 240, focal_px), Point3::new(0.3, 0.9, 1.2), target)
}

fn scene(camera: &Camera, centre: &Point3<f64>) -> RadianceImage {
    let tiles = |x: f64, z: f64| {
        if x.abs() < 0.24 && z.abs() < 0.18 {
            return [if ((x / 0.06).floor() + (z / 0.06).floor()).rem_euclid(2.0) < 1.0 { 0.03 } else { 0.6 };
                3];
        }
        let dark = (x / 0.3).rem_euclid(1.0) < 0.08 || (z / 0.3).rem_euclid(1.0) < 0.08;
        [if dark { 0.12 } else { 0.3 }; 3]
    };
    let sky = |d: nalgebra::Vector3<f64>| [if d.x > 0.5 { 4.0 } else { 0.6 }; 3];
    render(camera, centre, RADIUS, 0.9, sky, tiles, 4)
}

#[test]
fn a_ball_among_tiles_is_found_within_a_millimetre() {
    let centre = Point3::new(-0.1, RADIUS, 0.33);
    let camera = camera(300.0, Point3::new(0.05, 0.0, 0.1));
    let fit = find(&camera, &scene(&camera, &centre), &FLOOR, &config::Probe::default()).unwrap();
    assert!((fit.centre - centre).norm() < 1e-3, "{:?} {}", fit.centre - centre, fit.outline_rms_px);
    assert!((fit.reflectivity_seen.unwrap() - 0.9).abs() < 0.01);
    assert!(fit.mirror_correlation.unwrap() > 0.9, "{:?}", fit.mirror_correlation);
}

#[test]
fn pixels_need_not_be_square() {
    let centre = Point3::new(0.15, RADIUS, 0.33);
    let mut camera = camera(400.0, Point3::new(0.05, 0.0, 0.1));
    camera.intrinsics.focal_px[1] = 320.0;
    let fit = find(&camera, &scene(&camera, &centre), &FLOOR, &config::Probe::default()).unwrap();
    assert!((fit.centre - centre).norm() < 1e-3, "{:?} {fit:?}", fit.centre - centre);
}

#[test]
fn a_ball_cut_off_by_the_border_is_refused() {
    let camera = camera(300.0, Point3::new(0.05, 0.0, 0.1));
    let ray = camera.ray(&Point2::new(8.0, 120.0));
    let t = (RADIUS - ray.origin.y) / ray.direction.y;
    let centre = ray.origin + ray.direction.into_inner() * t;
    let problem = find(&camera, &scene(&camera, &centre), &FLOOR, &config::Probe::default()).unwrap_err();
    assert!(matches!(problem, Problem::CutOff { outside } if outside > 0.2), "{problem}");
}

#[test]
fn a_ball_of_few_pixels_is_refused() {
    let centre = Point3::new(-0.1, RADIUS, 0.32);
    let camera = camera(110.0, Point3::new(0.05, 0.0, 0.1));
    let problem = find(&camera, &scene(&camera, &centre), &FLOOR, &config::Probe::default()).unwrap_err();
    // Whichever is noticed first: the size, or that so few pixels mirror anything.
    let refused = match problem {
        Problem::TooSmall { diameter_px, .. } => diameter_px < 20.0,
        Problem::NotFound { .. } => true,
        _ => false,
    };
    assert!(refused, "{problem}");
}

#[test]
fn an_empty_floor_has_no_ball() {
    let camera = camera(300.0, Point3::new(0.05, 0.0, 0.1));
    let elsewhere = Point3::new(40.0, RADIUS, 40.0);
    let problem = find(&camera, &scene(&camera, &elsewhere), &FLOOR, &config::Probe::default()).unwrap_err();
    assert!(matches!(problem, Problem::NotFound { .. }), "{problem}");
}

#[test]
fn a_radius_must_be_positive() {
    let camera = camera(300.0, Point3::origin());
    let picture = scene(&camera, &Point3::new(0.0, RADIUS, 0.0));
    assert_eq!(
        find(&camera, &picture, &FLOOR, &config::Probe { radius_m: -0.1, ..Default::default() }).unwrap_err(),
        Problem::Radius(-0.1)
    );
}

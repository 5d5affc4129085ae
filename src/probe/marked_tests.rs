use super::*;
use crate::camera::Intrinsics;
use crate::image::{Image, Radiance};
use crate::probe::synthetic::look_at;
use nalgebra::Point3;
use rand::{Rng, SeedableRng};

const RADIUS: f64 = 0.06;

/// A ball near the corner of the picture, where its outline is no circle.
fn scene() -> (Camera, Point3<f64>) {
    let mut intrinsics = Intrinsics::pinhole(640, 480, 500.0);
    intrinsics.distortion = [-0.1, 0.02, 0.0, 0.0, 0.0];
    let camera = look_at(intrinsics, Point3::new(0.1, 0.5, 1.0), Point3::new(0.0, 0.3, 0.0));
    (camera, Point3::new(-0.25, 0.42, 0.1))
}

fn picture() -> RadianceImage {
    Image::from_fn(640, 480, |_, _| Radiance([0.2; 3]))
}

/// Marks at `count` places along a part of the outline, wrong by up to `noise_px` along x and y.
fn marks(camera: &Camera, centre: &Point3<f64>, count: usize, part: f64, noise_px: f64) -> Vec<[f64; 2]> {
    let mut random = rand::rngs::StdRng::seed_from_u64(3);
    let rim = Rim::new(&camera.centre(), centre, RADIUS).unwrap();
    (0..count)
        .map(|i| {
            let p = camera.project(&rim.at(part * outline::angle(i, count))).unwrap();
            let mut noise = || noise_px * (2.0 * random.random::<f64>() - 1.0);
            [p.x + noise(), p.y + noise()]
        })
        .collect()
}

fn settings() -> config::Probe {
    config::Probe { radius_m: RADIUS, ..Default::default() }
}

#[test]
fn exact_marks_give_the_centre_exactly() {
    let (camera, centre) = scene();
    let fit = fit(&camera, &picture(), &marks(&camera, &centre, 5, 1.0, 0.0), &settings()).unwrap();
    assert!((fit.centre - centre).norm() < 1e-6, "{:?}", fit.centre - centre);
    assert!(fit.outline_rms_px < 1e-4 && fit.diameter_px > 50.0);
}

#[test]
fn the_stated_accuracy_covers_the_error_of_noisy_marks() {
    let (camera, centre) = scene();
    let fit = fit(&camera, &picture(), &marks(&camera, &centre, 24, 1.0, 1.0), &settings()).unwrap();
    let (error, sigma) = ((fit.centre - centre).norm(), Vector3::from(fit.centre_sigma_m).norm());
    assert!(error < 3.0 * sigma && sigma < 0.01, "{error} m, standard deviation {sigma} m");
    assert!((0.2..0.9).contains(&fit.outline_rms_px), "{}", fit.outline_rms_px);
}

#[test]
fn one_slip_among_many_marks_is_resisted() {
    let (camera, centre) = scene();
    let mut marks = marks(&camera, &centre, 16, 1.0, 0.3);
    marks[3][0] += 6.0;
    let fit = fit(&camera, &picture(), &marks, &settings()).unwrap();
    assert!((fit.centre - centre).norm() < 0.01, "{:?}", fit.centre - centre);
}

#[test]
fn four_marks_are_too_few() {
    let (camera, centre) = scene();
    let problem = fit(&camera, &picture(), &marks(&camera, &centre, 4, 1.0, 0.0), &settings()).unwrap_err();
    assert_eq!(problem, Problem::FewMarks { found: 4, needed: 5 });
}

#[test]
fn a_square_is_no_outline_of_a_ball() {
    let (camera, _) = scene();
    let square = [[0, 0], [1, 0], [2, 0], [2, 1], [2, 2], [1, 2], [0, 2], [0, 1]]
        .map(|[x, y]| [200.0 + 50.0 * f64::from(x), 200.0 + 50.0 * f64::from(y)]);
    let problem = fit(&camera, &picture(), &square, &settings()).unwrap_err();
    assert!(matches!(problem, Problem::NotAnOutline { rms_px, limit_px } if rms_px > limit_px), "{problem}");
}

#[test]
fn a_short_arc_leaves_the_distance_open() {
    let (camera, centre) = scene();
    let arc = marks(&camera, &centre, 8, 0.12, 0.8);
    let problem = fit(&camera, &picture(), &arc, &settings()).unwrap_err();
    assert!(matches!(problem, Problem::DistanceUncertain { .. } | Problem::NoBall { .. }), "{problem}");
}

#[test]
fn marks_in_one_place_are_no_ball() {
    let (camera, _) = scene();
    let problem = fit(&camera, &picture(), &[[300.0, 200.0]; 6], &settings()).unwrap_err();
    assert_eq!(problem, Problem::NoBall { radius_m: RADIUS });
}

#[test]
fn a_ball_that_the_border_cuts_is_refused() {
    let (camera, _) = scene();
    let ray = camera.ray(&Point2::new(5.0, 240.0));
    let centre = ray.origin + ray.direction.into_inner() * 1.0;
    let problem = fit(&camera, &picture(), &marks(&camera, &centre, 12, 1.0, 0.0), &settings()).unwrap_err();
    assert!(matches!(problem, Problem::CutOff { outside } if outside > 0.2), "{problem}");
}

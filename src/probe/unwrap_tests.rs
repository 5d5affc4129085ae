use super::*;
use crate::camera::{Camera, Intrinsics};
use crate::probe::mirror_ball::reflected_ray;
use crate::probe::synthetic::{look_at, render};
use nalgebra::Point2;
use proptest::prelude::*;

const RADIUS: f64 = 0.1;

fn fit() -> ProbeFit {
    let camera =
        look_at(Intrinsics::pinhole(320, 240, 600.0), Point3::new(0.0, 0.9, 1.2), Point3::new(0.0, 0.5, 0.0));
    ProbeFit {
        source: config::ProbeSource::Ball,
        photographs: Vec::new(),
        diameter_px: 2.0 * 600.0 * RADIUS / 1.26,
        camera,
        centre: Point3::new(0.0, 0.5, 0.0),
        radius_m: RADIUS,
        outline_rms_px: 0.0,
        outline_support: None,
        mirror_correlation: None,
        reflectivity_seen: None,
        centre_sigma_m: [0.0; 3],
    }
}

fn picture(
    camera: &Camera,
    fit: &ProbeFit,
    light: impl Fn(Vector3<f64>) -> [f32; 3] + Sync,
) -> RadianceImage {
    render(camera, &fit.centre, RADIUS, 0.9, &light, |_, _| light(-Vector3::y()), 8)
}

fn unwrapped(light: impl Fn(Vector3<f64>) -> [f32; 3] + Sync) -> Unwrapped {
    let fit = fit();
    let picture = picture(&fit.camera, &fit, light);
    let clipped = picture.map(|_| false);
    unwrap(&fit, &picture, &clipped, &config::Probe { width_px: 256, ..Default::default() }).unwrap()
}

#[test]
fn a_uniform_environment_is_restored_where_the_ball_shows_it() {
    let u = unwrapped(|_| [0.7, 0.5, 0.2]);
    for (l, w) in u.environment.radiance.pixels().iter().zip(&u.environment.weight) {
        if *w > 0.0 {
            assert!(
                (l.0[0] / 0.7 - 1.0).abs() < 1e-2 && (l.0[2] / 0.2 - 1.0).abs() < 1e-2,
                "{l:?} at weight {w}"
            );
        }
    }
    assert!(u.blind_share > 0.005 && u.blind_share < 0.12, "{}", u.blind_share);
    assert_eq!(u.clipped_power_share, 0.0);
}

#[test]
fn a_small_bright_light_keeps_power_and_place() {
    for towards in [Vector3::new(0.3, 0.9, 0.2), Vector3::new(1.0, 0.4, 0.1), Vector3::new(-0.8, 0.1, -0.7)] {
        let towards = towards.normalize();
        let radius = 1.5f64.to_radians();
        let u = unwrapped(|d| if d.angle(&towards) < radius { [5000.0; 3] } else { [0.0; 3] });
        let env = &u.environment;
        let (mut power, mut moment) = (0.0, Vec3::ZERO);
        for i in 0..env.weight.len() {
            let p = f64::from(env.radiance.pixels()[i].0[1]) * env.solid_angle(i);
            power += p;
            moment += env.direction(i) * p as f32;
        }
        let truth = 5000.0 * std::f64::consts::TAU * (1.0 - radius.cos());
        assert!((power / truth - 1.0).abs() < 0.03, "{} of the power towards {towards:?}", power / truth);
        let t = Vec3::new(towards.x as f32, towards.y as f32, towards.z as f32);
        let error_deg = moment.normalize().angle_between(t).to_degrees();
        assert!(error_deg < 0.3, "{error_deg} deg off");
    }
}

#[test]
fn light_clipped_in_every_exposure_is_reported() {
    let fit = fit();
    let light = |d: Vector3<f64>| if d.y > 0.95 { [50.0; 3] } else { [0.1; 3] };
    let picture = picture(&fit.camera, &fit, light).map(|p| Radiance(p.0.map(|v| v.min(1.0))));
    let clipped = picture.map(|p| p.0[0] >= 1.0);
    let u = unwrap(&fit, &picture, &clipped, &config::Probe { width_px: 128, ..Default::default() }).unwrap();
    assert!(u.clipped_power_share > 0.1, "{}", u.clipped_power_share);
}

#[test]
fn a_mirror_that_reflects_nothing_is_refused() {
    let fit = fit();
    let picture = picture(&fit.camera, &fit, |_| [1.0; 3]);
    let clipped = picture.map(|_| false);
    let settings = config::Probe { reflectivity: [0.0, 0.9, 0.9], ..Default::default() };
    assert_eq!(
        unwrap(&fit, &picture, &clipped, &settings).unwrap_err(),
        Problem::Reflectivity([0.0, 0.9, 0.9])
    );
}

proptest! {
    #[test]
    fn the_reflection_point_inverts_the_mirror(angle in 0.0..std::f64::consts::TAU, r in 0.0..0.97f64) {
        let fit = fit();
        let rim = crate::probe::outline::Rim::new(&fit.camera.centre(), &fit.centre, RADIUS).unwrap();
        let middle = fit.camera.project(&fit.centre).unwrap();
        let edge = fit.camera.project(&rim.at(angle)).unwrap();
        let pixel: Point2<f64> = middle + (edge - middle) * r;
        let ray = reflected_ray(&fit.camera, &fit.centre, RADIUS, &pixel).unwrap();
        let p = reflection_point(&fit.camera.centre(), &fit.centre, RADIUS, &ray.direction).unwrap();
        prop_assert!((p - ray.origin).norm() < 1e-7);
    }
}

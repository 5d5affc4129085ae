use super::*;
use crate::camera::Intrinsics;
use crate::probe::latlong;
use crate::probe::synthetic::{look_at, render};

const RADIUS: f64 = 0.1;
const SKY: f64 = 0.6;
const SURFACE: Surface = Surface { height_m: 0.0, board_half_m: None };

fn fit() -> ProbeFit {
    let centre = Point3::new(0.0, RADIUS, 0.0);
    let eye = Point3::new(0.1, 0.7, 0.9);
    let camera = look_at(Intrinsics::pinhole(480, 360, 500.0), eye, centre);
    ProbeFit {
        source: config::ProbeSource::Ball,
        photographs: Vec::new(),
        diameter_px: 2.0 * 500.0 * RADIUS / (eye - centre).norm(),
        camera,
        centre,
        radius_m: RADIUS,
        outline_rms_px: 0.0,
        outline_support: Some(1.0),
        mirror_correlation: Some(1.0),
        reflectivity_seen: Some(0.9),
        centre_sigma_m: [0.0; 3],
    }
}

/// Floor under a uniform sky and a sun, by rays past the ball and off it; the sky's part is tabulated by distance.
fn floor_radiance(sun: Vector3<f64>, power: [f64; 3]) -> impl Fn(f64, f64) -> [f32; 3] + Sync {
    let centre = Point3::new(0.0, RADIUS, 0.0);
    let meets = move |x: &Point3<f64>, d: &Vector3<f64>| {
        let c = centre - x;
        let along = c.dot(d);
        let inside = RADIUS * RADIUS - (c.norm_squared() - along * along);
        (along > 0.0 && inside > 0.0).then(|| along - inside.sqrt())
    };
    let sky = move |r: f64| {
        let x = Point3::new(r, 0.0, 0.0);
        let (w, h) = (256, 128);
        let mut sum = 0.0;
        for i in 0..w * h / 2 {
            let d = latlong::direction((i % w) as f32 + 0.5, (i / w) as f32 + 0.5, w, h);
            let d = Vector3::new(f64::from(d.x), f64::from(d.y), f64::from(d.z));
            let seen = match meets(&x, &d) {
                None => SKY,
                Some(t) => {
                    let n = (x + d * t - centre) / RADIUS;
                    // The mirrored floor is dark here, to know it.
                    if (d - n * (2.0 * d.dot(&n))).y > 0.0 { 0.9 * SKY } else { 0.0 }
                }
            };
            sum += seen * d.y * latlong::texel_solid_angle(i / w, w, h);
        }
        sum
    };
    let table: Vec<f64> = (0..200).map(|i| sky(0.005 * f64::from(i))).collect();
    move |x, z| {
        let e = table[((x.hypot(z) / 0.005) as usize).min(199)];
        let lit = if meets(&Point3::new(x, 0.0, z), &sun).is_none() { sun.y } else { 0.0 };
        // Tiles that differ by a few per cent.
        let reflectance = 0.3 * (1.0 + 0.05 * (40.0 * x).sin() * (33.0 * z).cos());
        power.map(|p| (reflectance / std::f64::consts::PI * (e + p * lit)) as f32)
    }
}

/// The scene photographed with the sun clipped at `level`: estimated gain and the true one.
fn photographed(level: [f32; 3], sun: Vector3<f64>) -> (Result<Gain, Unusable>, [f64; 3]) {
    let fit = fit();
    let radius = 1.0f64.to_radians();
    let radiance = [3000.0f32, 2500.0, 2000.0];
    let solid_angle = std::f64::consts::TAU * (1.0 - radius.cos());
    let floor = floor_radiance(sun, radiance.map(|l| f64::from(l) * solid_angle));
    let light = |d: Vector3<f64>| match d {
        d if d.angle(&sun) < radius => radiance,
        d if d.y > 0.0 => [SKY as f32; 3],
        _ => [0.0; 3],
    };
    // What the ball mirrors of the floor stays dark, as the table has it.
    let truth = render(&fit.camera, &fit.centre, RADIUS, 0.9, light, |_, _| [0.0; 3], 6);
    let ground = render(&fit.camera, &fit.centre, RADIUS, 0.0, |_| [0.0; 3], floor, 2);
    let truth = Image::from_fn(480, 360, |x, y| {
        Radiance(std::array::from_fn(|k| truth.at(x, y).0[k] + ground.at(x, y).0[k]))
    });
    let picture = truth.map(|p| Radiance(std::array::from_fn(|k| p.0[k].min(level[k]))));
    let mask = truth.map(|p| (0..3).any(|k| p.0[k] > level[k]));
    let only = |image: &RadianceImage| {
        Image::from_fn(480, 360, |x, y| if *mask.at(x, y) { *image.at(x, y) } else { Radiance::default() })
    };
    let settings = config::Probe { width_px: 256, ..Default::default() };
    let unwrapped = |image: &RadianceImage| unwrap::unwrap(&fit, image, &mask, &settings).unwrap();
    let merged = Merged { clipped: mask.clone(), ..Merged::from_linear(&picture) };
    let sum = |image: &RadianceImage, k: usize| image.pixels().iter().map(|p| f64::from(p.0[k])).sum::<f64>();
    let (measured, full) = (only(&picture), only(&truth));
    let (before, lost) = (unwrapped(&picture).environment, unwrapped(&measured).environment);
    let mut out = unwrapped(&picture);
    let found = restore(&fit, &merged, &SURFACE, &settings, &mut out).unwrap();
    let gain = found.as_ref().map_or([1.0; 3], Gain::applied);
    let light = |env: &Environment, k: usize| {
        (0..before.radiance.pixels().len())
            .map(|i| env.solid_angle(i) * f64::from(env.radiance.pixels()[i].0[k]))
            .sum::<f64>()
    };
    for (k, gain) in gain.into_iter().enumerate() {
        let expected = light(&before, k) + (gain - 1.0) * light(&lost, k);
        assert!((light(&out.environment, k) / expected - 1.0).abs() < 1e-5, "channel {k}");
    }
    (found, [0, 1, 2].map(|k| sum(&full, k) / sum(&measured, k)))
}

#[test]
fn a_clipped_sun_gets_the_power_that_its_shadow_tells() {
    let sun = Vector3::new(0.5, 0.7, 0.2).normalize();
    let (found, truth) = photographed([300.0, 400.0, 900.0], sun);
    let found = found.unwrap();
    for k in 0..3 {
        let error = (found.gain[k] - truth[k]).abs();
        assert!(error < 3.0 * found.sigma[k], "channel {k}: {found:?}, true {truth:?}");
        assert!(found.sigma[k] < 0.15 * truth[k], "{found:?}");
    }
    assert!(truth[0] > 1.5, "the test must lose light: {truth:?}");
}

#[test]
fn a_light_whose_shadow_cannot_be_there_is_left_alone() {
    let low = photographed([300.0; 3], Vector3::new(1.0, 0.1, 0.0).normalize()).0;
    assert_eq!(low.unwrap_err(), Unusable::Low);
    let fit = fit();
    // The sky says there is a strong light, the evenly lit floor that there is none.
    let sun = glam::Vec3::new(0.5, 0.7, 0.2).normalize();
    let near = |d: glam::Vec3| d.angle_between(sun) < 0.05;
    let lost = Environment::from_fn(128, glam::Vec3::ZERO, |d| if near(d) { [500.0; 3] } else { [0.0; 3] });
    let all = Environment::from_fn(128, glam::Vec3::ZERO, |d| if near(d) { [500.0; 3] } else { [0.5; 3] });
    let floor = |_: f64, _: f64| [0.2f32; 3];
    let picture = render(&fit.camera, &fit.centre, RADIUS, 0.9, |_| [0.5; 3], floor, 1);
    assert_eq!(gain(&fit, &picture, [&all, &lost], &SURFACE, [0.9; 3]).unwrap_err(), Unusable::NoShadow);
    let nowhere = Image::from_fn(8, 8, |_, _| Radiance::default());
    assert!(matches!(gain(&fit, &nowhere, [&all, &lost], &SURFACE, [0.9; 3]), Err(Unusable::FewPixels(..))));
}

#[test]
fn a_person_is_told_of_light_that_is_lost() {
    let found = Ok(Gain { gain: [1.5, 0.9, 2.0], sigma: [0.1, 0.2, 0.05], pixels: [100, 200] });
    let said = warning(0.254, &found).unwrap();
    assert!(
        said.starts_with("25 % of the light is clipped") && said.contains("1.50 1.00 2.00 (± 0.20)"),
        "{said}"
    );
    let said = warning(0.02, &Err(Unusable::NoShadow)).unwrap();
    assert!(
        said.contains("shows no shadow of the ball") && said.ends_with("; add a shorter exposure"),
        "{said}"
    );
    assert_eq!(warning(0.009, &Err(Unusable::NoShadow)), None);
}

//! The method `subtractive` against the ray-traced reference on the same model, and its hard cases.

mod room;

use glam::Vec3;
use insitu::config::{LightSampling, Render, ShadowMethod};
use insitu::error::Problem as _;
use insitu::illuminate::patch::{DistantSource, LightModel};
use insitu::shadow::{Problem, Session, removed_radiance};
use proptest::prelude::*;
use room::{Stage, blob, camera, cuboid, errors, face, object, stage};

fn settings() -> Render {
    Render { method: ShadowMethod::Subtractive, ..Default::default() }
}

#[test]
fn more_lights_come_nearer_to_the_reference() {
    let stage = stage(0.2, 128, 1.0);
    let slow = Render { method: ShadowMethod::Raytraced, rays: 512, ..Default::default() };
    let reference = removed_radiance(&stage.scene(), &object(), &slow).unwrap();
    for light_sampling in [LightSampling::Structured, LightSampling::MedianCut] {
        for (lights, bound) in [(20, 0.3), (80, 0.12), (400, 0.05)] {
            let fast = Render { lights, light_sampling, pixels_per_sample: 1, ..settings() };
            let found = removed_radiance(&stage.scene(), &object(), &fast).unwrap();
            let (error, bias) = errors(&stage.plate, &found.epsilon, &reference.epsilon);
            let expected = found.expected_error.unwrap();
            println!(
                "{light_sampling:?}, {lights} lights: error {error:.3} (expected {expected:.3}), bias {bias:+.3}"
            );
            assert!(expected > 0.4 * error && expected < 4.0 * error + 0.02, "{expected} for {error}");
            assert_eq!(found.sources_used, lights);
            assert!(error < bound && bias.abs() < 0.1, "{lights} lights: error {error}, bias {bias}");
        }
    }
}

#[test]
fn fewer_samples_cost_little_of_a_soft_shadow() {
    let stage = stage(0.2, 256, 1.0);
    let at = |pixels_per_sample| {
        let settings = Render { pixels_per_sample, lights: 100, ..settings() };
        removed_radiance(&stage.scene(), &object(), &settings).unwrap().epsilon
    };
    let fine = at(1);
    for (pixels, bound) in [(4, 0.1), (16, 0.15), (64, 0.3)] {
        let (error, bias) = errors(&stage.plate, &at(pixels), &fine);
        println!("1/{pixels}: error {error:.3}, bias {bias:+.3}");
        assert!(error < bound && bias.abs() < 0.05, "1/{pixels}: error {error}, bias {bias}");
    }
}

#[test]
fn no_more_is_removed_than_was_there_and_nothing_far_from_the_object() {
    room::removes_no_more_than_was_there(&settings());
}

/// A floor under sun and sky.
fn outdoors(sun: Vec3, radiance: f32) -> (Stage, [DistantSource; 2]) {
    let sun = DistantSource { direction: sun.normalize(), solid_angle_sr: 1e-4, radiance: [radiance; 3] };
    let sky = DistantSource {
        direction: Vec3::new(-0.5, 0.6, 0.3).normalize(),
        solid_angle_sr: 0.1,
        radiance: [5.0; 3],
    };
    let mut light = LightModel { distant: vec![sun, sky], ..Default::default() };
    face(&mut light.mesh, Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, 0.25, |_| [0.0; 3]);
    let camera = camera([0.3, 0.8, 0.8], [0.0, 0.0, 0.0], 64, 48, 80.0);
    let share = insitu::config::Transfer { source_share: 1.0, ..Default::default() };
    (Stage::new(light, &camera, &share), [sun, sky])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn a_sun_that_is_hidden_takes_exactly_its_light(x in 0.0..0.4f32, z in -0.3..0.3f32, radiance in 1e3..1e5f32) {
        hidden_sun(Vec3::new(x, 1.0, z), radiance);
    }

    #[test]
    fn what_stands_before_no_light_removes_nothing(x in -0.5..0.5f32, y in -1.5..-0.3f32, z in -0.5..0.5f32) {
        let (stage, _) = outdoors(Vec3::new(0.2, 1.0, 0.1), 3e4);
        // Below the floor, which it sees the sky beside.
        let object = blob(Vec3::new(x, y, z), 0.2, 0.1, 12);
        match removed_radiance(&stage.scene(), &object, &settings()) {
            Ok(removed) => prop_assert!(removed.epsilon.pixels().iter().all(|e| e.0 == [0.0; 3])),
            Err(e) => prop_assert!(matches!(e, Problem::Dark), "{}", e),
        }
    }
}

fn hidden_sun(direction: Vec3, radiance: f32) {
    let (stage, [sun, sky]) = outdoors(direction, radiance);
    let lid = cuboid(Vec3::new(0.0, 0.2, 0.0), Vec3::new(0.1, 0.002, 0.1));
    let settings = Render { pixels_per_sample: 1, lights: 40, ..settings() };
    let removed = removed_radiance(&stage.scene(), &lid, &settings).unwrap();
    let irradiance = |s: &DistantSource| s.radiance[0] * s.solid_angle_sr * s.direction.y;
    let expected = irradiance(&sun) / (irradiance(&sun) + irradiance(&sky));
    // Below the middle of the lid, against the sun.
    let below = sun.direction * (-0.2 / sun.direction.y) + Vec3::Y * 0.2;
    let nearest =
        |i: &usize| stage.receivers.pixels.pixels()[*i].map_or(f32::INFINITY, |r| r.position.distance(below));
    let pixels = stage.plate.pixels();
    let i = (0..pixels.len()).min_by(|a, b| nearest(a).total_cmp(&nearest(b))).unwrap();
    let found = removed.epsilon.pixels()[i].0[0] / pixels[i].0[0];
    assert!((found / expected - 1.0).abs() < 0.02, "{found} {expected}");
}

#[test]
fn a_time_for_a_frame_lowers_the_detail() {
    let stage = stage(0.4, 128, 0.9);
    let hurried = Render { lights: 1000, pixels_per_sample: 1, frame_ms: 1e-3, ..settings() };
    let mut session = Session::prepare(&stage.scene(), &hurried).unwrap();
    session.frame(&object()).unwrap();
    assert_eq!(session.frame(&object()).unwrap().removed.sources_used, 1, "no time for more than one light");
}

#[test]
fn bad_settings_and_darkness_are_refused() {
    let stage = stage(0.8, 40, 0.9);
    let refused = |settings: Render| removed_radiance(&stage.scene(), &object(), &settings).unwrap_err();
    let few = refused(Render { lights: 0, ..settings() });
    assert_eq!(few.to_string(), "lights is 0, which is not 1 or more");
    let odd = refused(Render { pixels_per_sample: 9, ..settings() });
    assert_eq!(odd.hint(), "set render.pixels_per_sample to 1, 4, 16, 64, 256 or 1024");
    assert!(matches!(refused(Render { shadow_map_px: 8, ..settings() }), Problem::Setting { .. }));
    let mut dark = stage.light.clone();
    dark.mesh.patches.iter_mut().for_each(|p| p.radiance = [0.0; 3]);
    let scene = insitu::shadow::Scene { light: &dark, ..stage.scene() };
    let error = removed_radiance(&scene, &object(), &settings()).unwrap_err();
    assert!(matches!(error, Problem::Dark), "{error}");
}

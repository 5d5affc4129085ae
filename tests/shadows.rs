//! Radiance transfer against the ray-traced reference on the same model, and the hard cases of shadows.

mod room;

use glam::Vec3;
use insitu::config::{Render, ShadowMethod, Transfer};
use insitu::illuminate::patch::{DistantSource, LightModel};
use insitu::image::RadianceImage;
use insitu::model::face::Gloss;
use insitu::shadow::{Occluder, Problem, RadianceTransfer, Scene, Session, removed_radiance};
use insitu::synthetic::{Lobby, lobby_of};
use insitu::transfer::{Finish, solve, solve_glossy};
use room::{Stage, blob, camera, cuboid, errors, stage};

fn at(x: f32, y: f32, z: f32) -> Vec3 {
    Vec3::new(x, y, z)
}

#[test]
fn radiance_transfer_agrees_with_the_reference() {
    let stage = stage(0.2, 64, 1.0);
    let scene = stage.scene();
    let objects = [
        ("box on the floor", cuboid(at(0.1, 0.12, 0.0), at(0.10, 0.12, 0.08))),
        ("box sunk into the floor", cuboid(at(0.1, 0.07, 0.0), at(0.10, 0.12, 0.08))),
        ("blob on the floor", blob(at(0.0, 0.17, 0.0), 0.15, 0.15, 24)),
        ("blob raised by 0.3 m", blob(at(0.0, 0.47, 0.0), 0.15, 0.15, 24)),
        ("thin plate raised", cuboid(at(0.0, 0.25, 0.0), at(0.2, 0.004, 0.15))),
    ];
    for (name, object) in &objects {
        // The plate is a chessboard that does not know the model's light: nothing to lay shadows over.
        let modelled = Render { register_px: 0, ..Default::default() };
        let slow = Render { method: ShadowMethod::Raytraced, rays: 1024, ..modelled.clone() };
        let reference = removed_radiance(&scene, object, &slow).unwrap();
        let noise = reference.noise.unwrap();
        assert!(noise < 0.03, "{name}: the reference's own noise is {noise}");
        for (passes, bound) in [(10, 0.17), (20, 0.09), (50, 0.055), (200, 0.035), (0, 0.03)] {
            let fast = Render { passes, ..modelled.clone() };
            let found = removed_radiance(&scene, object, &fast).unwrap();
            let (error, bias) = errors(&stage.plate, &found.epsilon, &reference.epsilon);
            let expected = found.expected_error.unwrap();
            println!(
                "{name}: {} passes, {} maps: error {error:.4}, expected {expected:.4}, bias {bias:+.4}, noise {noise:.4}",
                found.passes, found.shadow_maps
            );
            assert!(error <= bound, "{name}, {passes} passes: error {error}");
            // At 64 pixels a row the pixels at the foot of the box are as wide as the penumbra.
            assert!(
                error <= 1.5 * expected.max(0.025),
                "{name}, {passes} passes: {error}, {expected} expected"
            );
            assert!(bias.abs() <= 0.01, "{name}, {passes} passes: bias {bias}");
        }
    }
}

#[test]
fn ten_passes_keep_the_energy_beside_lit_furniture() {
    let Lobby { light, receivers, plate, .. } = Lobby::new(lobby_of(2000), 160);
    let settings = Transfer { source_share: 0.98, ..Default::default() };
    let transfers = &solve(&light, &receivers, &settings, || {}).unwrap();
    let (receivers, light, plate) = (&receivers, &light, &plate);
    let scene = Scene { light, transfers, receivers, plate, finish: None, stored: None };
    // At the foot of a pillar, and in the open.
    for place in [[0.0, -0.6], [0.3, 0.6]] {
        let object = Lobby::object(place, 0.0);
        let removed =
            |passes| removed_radiance(&scene, &object, &Render { passes, ..Default::default() }).unwrap();
        let all = removed(0);
        for passes in [10, 20] {
            let (error, bias) = errors(plate, &removed(passes).epsilon, &all.epsilon);
            println!("{place:?}, {passes} passes: error {error:.4}, bias {bias:+.4}");
            assert!(error < 0.08 && bias.abs() <= 0.01, "{place:?}, {passes} passes: {error}, {bias}");
        }
    }
}

#[test]
fn a_polished_floor_loses_its_mirror_images_too() {
    let stage = stage(0.15, 64, 1.0);
    let view = camera([0.9, 1.3, 1.7], [0.0, 0.1, 0.0], 64, 48, 0.9 * 64.0);
    let mut gloss = vec![None; 6];
    gloss[0] = Some(Gloss { specular: [0.2; 3], shininess: 20.0 });
    let finish = Finish::new(&view, &gloss);
    let settings = Transfer { source_share: 1.0, ..Default::default() };
    let transfers = solve_glossy(&stage.light, &stage.receivers, finish, &settings, || {}).unwrap();
    let polished = insitu::shadow::Scene { transfers: &transfers, finish, ..stage.scene() };
    // Between the camera and the image of the window.
    let object = blob(at(-0.5, 0.2, 0.0), 0.15, 0.15, 16);
    let slow = Render { method: ShadowMethod::Raytraced, rays: 512, ..Default::default() };
    let reference = removed_radiance(&polished, &object, &slow).unwrap();
    let fast = |scene| removed_radiance(scene, &object, &Render::default()).unwrap().epsilon;
    let (error, bias) = errors(&stage.plate, &fast(&polished), &reference.epsilon);
    let (dull, _) = errors(&stage.plate, &fast(&stage.scene()), &reference.epsilon);
    println!(
        "error {error:.4}, bias {bias:+.4}, noise {:.4}; of a dull floor {dull:.4}",
        reference.noise.unwrap()
    );
    assert!(error < 0.06 && bias.abs() < 0.02, "{error}, bias {bias}");
    assert!(dull > 2.0 * error, "the mirror image hides nothing: {dull}");
}

#[test]
fn culling_and_vectors_change_nothing() {
    let stage = stage(0.3, 80, 1.0);
    let object = blob(at(0.0, 0.2, 0.0), 0.15, 0.15, 16);
    for (passes, origins) in [(30, 1), (30, 8), (0, 1)] {
        let settings = Render { passes, origins, ..Default::default() };
        let method = RadianceTransfer::prepare(&stage.scene(), &settings).unwrap();
        let fast = method.removed_radiance(&object).unwrap();
        let plain = method.removed_radiance_plainly(&object).unwrap();
        let (error, bias) = errors(&stage.plate, &fast.epsilon, &plain.epsilon);
        assert!(error < 2e-3 && bias.abs() < 1e-4, "{passes} passes: {error}, {bias}");
        assert_eq!(fast.shadow_maps, plain.shadow_maps);
    }
}

#[test]
fn any_number_of_passes_takes_all_of_the_light() {
    // A lid leaves nothing in its umbra, into however few clusters the light is gathered; the rest is what few origins
    // miss at its rim.
    let stage = stage(0.4, 48, 1.0);
    let lid = cuboid(at(0.0, 0.05, 0.0), at(1.99, 0.002, 1.99));
    let whole = removed_radiance(&stage.scene(), &lid, &Render { passes: 0, ..Default::default() }).unwrap();
    let sum = |image: &RadianceImage| image.pixels().iter().map(|p| f64::from(p.luminance())).sum::<f64>();
    for (passes, bound) in [(5, 0.05), (17, 0.04), (60, 0.02)] {
        let found = removed_radiance(&stage.scene(), &lid, &Render { passes, ..Default::default() }).unwrap();
        let ratio = sum(&found.epsilon) / sum(&whole.epsilon);
        assert!((ratio - 1.0).abs() < bound, "{passes} passes remove {ratio} of the light");
        assert!(found.passes <= passes);
    }
}

#[test]
fn a_session_keeps_to_what_is_asked() {
    let stage = stage(0.3, 64, 1.0);
    let object = blob(at(0.0, 0.2, 0.0), 0.15, 0.15, 12);
    let scene = stage.scene();
    let passes = |settings: Render, frames: usize| {
        let mut session = Session::prepare(&scene, &settings).unwrap();
        let frames: Vec<_> = (0..frames).map(|_| session.frame(&object).unwrap().removed).collect();
        frames.last().unwrap().clone()
    };
    // Up to twenty passes draw the same maps and err alike.
    let by_number = passes(Render { passes: 60, ..Default::default() }, 1);
    assert_eq!(by_number.passes, 60);
    let wanted = by_number.expected_error.unwrap();
    let by_error = passes(Render { passes: 0, max_error: wanted, ..Default::default() }, 1);
    assert!(by_error.passes <= 60 && by_error.expected_error.unwrap() <= wanted, "{}", by_error.passes);
    let coarser = passes(Render { passes: 0, max_error: 2.0 * wanted, ..Default::default() }, 1);
    assert!(coarser.passes < by_error.passes);
    // No frame fits into a nanosecond, all do into an hour.
    assert_eq!(passes(Render { passes: 0, frame_ms: 1e-6, ..Default::default() }, 3).passes, 1);
    let hour = passes(Render { passes: 0, frame_ms: 3.6e6, ..Default::default() }, 2);
    assert!(hour.passes > 100, "{}", hour.passes);
}

#[test]
fn the_reference_knows_its_noise_and_ignores_threads() {
    let stage = stage(0.4, 48, 0.9);
    let object = blob(at(0.0, 0.3, 0.0), 0.15, 0.1, 12);
    let with = |rays, seed| Render { method: ShadowMethod::Raytraced, rays, seed, ..Default::default() };
    let run = |settings: &Render| removed_radiance(&stage.scene(), &object, settings).unwrap();
    let (a, b) = (run(&with(64, 1)), run(&with(64, 2)));
    // Two seeds differ by √2 standard errors.
    let (difference, _) = errors(&stage.plate, &a.epsilon, &b.epsilon);
    let noise = a.noise.unwrap();
    assert!((difference / (2f64.sqrt() * noise)).log2().abs() < 1.0, "{difference} found, {noise} claimed");
    assert!(run(&with(512, 1)).noise.unwrap() < 0.6 * noise);
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(alone.install(|| run(&with(64, 1))), a);
    for passes in [0, 20] {
        let maps = Render { passes, ..Default::default() };
        assert_eq!(alone.install(|| run(&maps)), run(&maps));
    }
}

#[test]
fn lights_inside_the_object_are_hidden_whole() {
    let stage = stage(0.4, 48, 1.0);
    // Around the ceiling lamp, sticking through the ceiling.
    let object = cuboid(at(0.0, 2.5, 0.8), at(0.5, 0.3, 0.5));
    let fast = removed_radiance(&stage.scene(), &object, &Render::default()).unwrap();
    let slow = Render { method: ShadowMethod::Raytraced, rays: 512, ..Default::default() };
    let slow = removed_radiance(&stage.scene(), &object, &slow).unwrap();
    let (error, bias) = errors(&stage.plate, &fast.epsilon, &slow.epsilon);
    assert!(error < 0.05 && bias.abs() < 0.02, "error {error}, bias {bias}");
}

#[test]
fn no_more_is_removed_than_was_there() {
    let stage = stage(0.4, 48, 1.0);
    // A lid over the whole floor takes all light of walls and ceiling.
    let lid = cuboid(at(0.0, 0.05, 0.0), at(1.99, 0.002, 1.99));
    for method in [ShadowMethod::RadianceTransfer, ShadowMethod::Raytraced] {
        let settings = Render { method, rays: 128, ..Default::default() };
        let removed = removed_radiance(&stage.scene(), &lid, &settings).unwrap();
        let mut shares = Vec::new();
        for (b, e) in stage.plate.pixels().iter().zip(removed.epsilon.pixels()) {
            for c in 0..3 {
                assert!(e.0[c] >= 0.0 && e.0[c] <= b.0[c], "{} of {}", e.0[c], b.0[c]);
                shares.push(e.0[c] / b.0[c]);
            }
        }
        shares.sort_by(f32::total_cmp);
        assert!(shares[shares.len() / 2] > 0.95, "most of the floor is dark: {}", shares[shares.len() / 2]);
    }
}

/// A floor under distant light alone.
fn floor_under(distant: Vec<DistantSource>) -> Stage {
    let mut light = LightModel { distant, ..Default::default() };
    room::face(&mut light.mesh, at(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, 0.25, |_| [0.0; 3]);
    let camera = camera([0.3, 0.8, 0.8], [0.0, 0.0, 0.0], 48, 36, 60.0);
    Stage::new(light, &camera, &Transfer { source_share: 1.0, ..Default::default() })
}

/// A floor in the sun under a board, which has been modelled `off` beside where it is, m.
fn under_a_board(off: f32) -> Stage {
    let sun = DistantSource {
        direction: at(0.35, 0.9, 0.25).normalize(),
        solid_angle_sr: 7e-4,
        radiance: [4000.0; 3],
    };
    let sky = DistantSource { direction: Vec3::Y, solid_angle_sr: 2.0, radiance: [0.3; 3] };
    let mut light = LightModel { distant: vec![sun, sky], ..Default::default() };
    room::face(&mut light.mesh, at(-1.5, 0.0, -1.5), Vec3::Z * 3.0, Vec3::X * 3.0, 0.2, |_| [0.0; 3]);
    let (corner, x, z) = (at(off - 0.6, 0.4, -0.8), Vec3::X * 0.5, Vec3::Z * 1.6);
    room::face(&mut light.mesh, corner, z, x, 0.2, |_| [0.0; 3]);
    room::face(&mut light.mesh, corner, x, z, 0.2, |_| [0.0; 3]);
    let camera = camera([0.8, 0.9, 1.3], [-0.1, 0.0, 0.0], 160, 120, 170.0);
    Stage::new(light, &camera, &Transfer { source_share: 1.0, ..Default::default() })
}

#[test]
fn the_scenes_own_shadow_is_where_the_plate_shows_it() {
    let truth = under_a_board(0.0);
    let floor = |x: usize, y: usize| {
        let tile = if x % 17 == 3 || y % 13 == 5 { 0.2 } else { 0.3 };
        tile * (1.0 + 0.08 * ((x * 7 + y * 13) as f32).sin())
    };
    let plate = insitu::image::Image::from_fn(160, 120, |x, y| {
        let receiver = truth.receivers.pixels.at(x, y).as_ref();
        let irradiance = receiver.and_then(|r| truth.transfers.irradiance_on(r)).unwrap_or([0.0; 3]);
        insitu::image::Radiance(irradiance.map(|e| floor(x, y) * e / std::f32::consts::PI))
    });
    // It hangs so that the border of the board's shadow lies in the middle of its own.
    let object = cuboid(at(-0.2, 0.2, 0.0), at(0.06, 0.05, 0.06));
    let slow = Render { method: ShadowMethod::Raytraced, rays: 512, register_px: 0, ..Default::default() };
    let reference =
        removed_radiance(&Scene { plate: &plate, ..truth.scene() }, &object, &slow).unwrap().epsilon;
    let error = |stage: &Stage, settings: &Render| {
        let scene = Scene { plate: &plate, ..stage.scene() };
        let found = removed_radiance(&scene, &object, settings).unwrap();
        errors(&plate, &found.epsilon, &reference).0
    };
    let fast = |register_px| Render { register_px, ..Default::default() };
    let best = error(&truth, &fast(0));
    // Nothing is lost where the model is right.
    let kept = error(&truth, &fast(4));
    println!("true model: {best:.3}, registered {kept:.3}");
    assert!(kept < best + 0.02, "{kept}, {best} as modelled");
    // What the plate shows in the sun and the model in the shadow would keep all its light.
    for off in [0.02, 0.03] {
        let moved = under_a_board(off);
        for method in [ShadowMethod::RadianceTransfer, ShadowMethod::Raytraced] {
            let settings = |px| Render { method, rays: 512, ..fast(px) };
            let (before, after) = (error(&moved, &settings(0)), error(&moved, &settings(4)));
            println!("{off} m, {method:?}: {before:.3} as modelled, {after:.3} registered");
            assert!(after < 0.5 * before, "{off} m, {method:?}: {after}, {before} as modelled");
        }
    }
}

#[test]
fn a_thousand_faint_lights_sum_in_f32_as_in_f64() {
    let distant: Vec<_> = (0..1000)
        .map(|i| {
            let (turn, height) = (i as f32 * 2.399_963, 0.2 + 0.75 * i as f32 / 1000.0);
            let radius = (1.0 - height * height).sqrt();
            let direction = at(radius * turn.cos(), height, radius * turn.sin());
            DistantSource { direction, solid_angle_sr: 1e-3, radiance: [1e-4 * (1.0 + (i % 7) as f32); 3] }
        })
        .collect();
    let stage = floor_under(distant);
    let object = cuboid(at(0.0, 0.2, 0.0), at(0.15, 0.1, 0.15));
    let settings = Render { shadow_map_px: 64, passes: 0, ..Default::default() };
    let method = RadianceTransfer::prepare(&stage.scene(), &settings).unwrap();
    let single = method.removed_radiance(&object).unwrap();
    assert_eq!(single.passes, 1000);
    let double = method.removed_radiance_plainly(&object).unwrap();
    let shadow = double.epsilon.pixels().iter().zip(single.epsilon.pixels()).filter(|(d, _)| d.0[0] > 0.05);
    let mut off: Vec<f32> = shadow.map(|(d, s)| (s.0[0] / d.0[0] - 1.0).abs()).collect();
    off.sort_by(f32::total_cmp);
    assert!(off.len() > 50, "there is a shadow");
    // A texel on the brink may fall to either side; rounding is what most pixels show.
    assert!(
        off[off.len() / 2] < 2e-6 && off[off.len() - 1] < 2e-3,
        "{} {}",
        off[off.len() / 2],
        off[off.len() - 1]
    );
}

#[test]
fn a_sun_at_the_horizon_of_the_receiver_is_harmless() {
    let graze = DistantSource {
        direction: at(1.0, 1e-5, 0.0).normalize(),
        solid_angle_sr: 6.8e-5,
        radiance: [1e5; 3],
    };
    let sky = DistantSource { direction: Vec3::Y, solid_angle_sr: 1.0, radiance: [1.0; 3] };
    let stage = floor_under(vec![graze, sky]);
    let object = cuboid(at(0.0, 0.1, 0.0), at(0.1, 0.1, 0.1));
    let removed = removed_radiance(&stage.scene(), &object, &Render::default()).unwrap();
    assert!(removed.epsilon.pixels().iter().all(|p| p.0.iter().all(|c| c.is_finite() && *c >= 0.0)));
}

#[test]
fn broken_objects_and_foreign_artefacts_are_refused() {
    let stage = stage(0.8, 16, 1.0);
    let refuse = |object: &Occluder, settings: &Render| {
        removed_radiance(&stage.scene(), object, settings).unwrap_err().to_string()
    };
    let settings = Render::default();
    assert_eq!(refuse(&Occluder::default(), &settings), "the object has no triangles");
    let mut broken = cuboid(at(0.0, 0.2, 0.0), Vec3::splat(0.1));
    broken.vertices[3].x = f32::NAN;
    assert!(refuse(&broken, &settings).ends_with("a position that is not finite"));
    broken.triangles = vec![[0, 1, 99]];
    assert_eq!(refuse(&broken, &settings), "triangle 0 of the object has a vertex that does not exist");
    let whole = cuboid(at(0.0, 0.2, 0.0), Vec3::splat(0.1));
    assert!(
        refuse(&whole, &Render { shadow_map_px: 4, ..settings.clone() }).starts_with("shadow_map_px is 4")
    );
    let small = RadianceImage::from_pixels(1, 1, vec![Default::default()]);
    let scene = insitu::shadow::Scene { plate: &small, ..stage.scene() };
    let e = removed_radiance(&scene, &whole, &settings);
    assert!(matches!(e, Err(Problem::Mismatch { .. })));
}

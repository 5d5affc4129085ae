use super::*;
use crate::config::{Combination, OcclusionFilter, Render, ShadowMethod};
use crate::error::Problem as _;
use crate::shadow::{Occluder, Scene, removed_radiance};
use crate::synthetic::{Lobby, cuboid, face};
use crate::transfer::sampling::Shift;
use crate::transfer::{Transfers, solve};
use crate::visibility::Bvh;
use glam::Vec3;
use proptest::prelude::*;

/// A ceiling light of 0.8 × 0.5 m, 2 m above the floor.
fn light() -> RectangularLight {
    RectangularLight { centre: Vec3::Y * 2.0, half: [Vec3::X * 0.4, Vec3::Z * 0.25], radiance: [1.0; 3] }
}

/// Points of the floor.
fn floor() -> impl Iterator<Item = Vec3> + Clone {
    (0..21 * 21).map(|i| Vec3::new((i % 21) as f32 * 0.07 - 0.7, 0.0, (i / 21) as f32 * 0.07 - 0.7))
}

/// Visible share of the light by rays.
fn traced(occluder: &Bvh, light: &RectangularLight, position: Vec3) -> f32 {
    let (shift, rays) = (Shift::new(1, 2), 4096);
    let free = (0..rays).filter(|&i| !occluder.occluded(position, light.at(shift.point(i)))).count();
    free as f32 / rays as f32
}

/// A sheet of 4 × 3 rectangles of 6 × 8 cm, 2 cm apart, at a height.
fn lattice(height: f32) -> Occluder {
    let mut out = Occluder::default();
    for (i, k) in (0..4).flat_map(|i| (0..3).map(move |k| (i, k))) {
        let corner = Vec3::new(0.08 * i as f32 - 0.16, height, 0.1 * k as f32 - 0.15);
        let first = out.vertices.len() as u32;
        let (u, v) = (Vec3::X * 0.06, Vec3::Z * 0.08);
        out.vertices.extend([corner, corner + u, corner + u + v, corner + v]);
        out.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    out
}

fn textures(occluder: &Occluder, slices: &Slices, filter: OcclusionFilter, close: bool) -> OcclusionTextures {
    let frustum = Frustum::fit(&light(), floor());
    let mask = Mask::draw(&frustum, slices, 512, &occluder.vertices, &occluder.triangles);
    OcclusionTextures::new(&frustum, slices, &if close { mask.closed() } else { mask }, filter)
}

fn rms(found: &OcclusionTextures, rule: Combination, occluder: &Occluder) -> f32 {
    let bvh = Bvh::new(&occluder.vertices, &occluder.triangles);
    let squares = floor().map(|p| (found.visibility(p, rule) - traced(&bvh, &light(), p)).powi(2));
    (squares.sum::<f32>() / floor().count() as f32).sqrt()
}

#[test]
fn a_sheet_parallel_to_the_light_is_as_rays_have_it() {
    let sheet = lattice(1.2);
    // The sheet lies on the slice's far side, where the slice is projected.
    let slices = Slices::uniform(0.7, 0.8001, 1);
    let errors =
        OcclusionFilter::ALL.map(|f| rms(&textures(&sheet, &slices, f, false), Combination::Product, &sheet));
    assert!(errors[2] < 0.004, "exact filter: {errors:?}");
    assert!(errors[2] < errors[1] && errors[1] < errors[0] && errors[0] < 0.1, "{errors:?}");
}

#[test]
fn nothing_before_the_light_leaves_all_of_it() {
    let behind = cuboid(Vec3::Y * 2.5, Vec3::splat(0.2));
    let found = textures(&behind, &Slices::uniform(0.0, 2.0, 8), OcclusionFilter::SummedArea, true);
    assert!(floor().all(|p| found.visibility(p, Combination::Product) == 1.0));
}

#[test]
fn no_receiver_is_hidden_by_its_own_surface() {
    // A tilted plate through all slices: nothing lies between it and the light.
    let corners = [(-0.5, -0.4), (0.5, -0.4), (0.5, 0.4), (-0.5, 0.4)];
    let vertices: Vec<Vec3> = corners.map(|(x, z)| Vec3::new(x, 0.6 + x, z)).to_vec();
    let plate = Occluder { vertices, triangles: vec![[0, 1, 2], [0, 2, 3]] };
    let found = textures(&plate, &Slices::uniform(0.0, 2.0, 16), OcclusionFilter::SummedArea, false);
    for i in 0..100 {
        let x = i as f32 * 0.009 - 0.45;
        let seen = found.visibility(Vec3::new(x, 0.6 + x, 0.1), Combination::Product);
        assert!(seen > 0.9, "{seen} at {x}");
    }
}

#[test]
fn slices_leave_no_step_where_a_receiver_crosses_them() {
    let object = lattice(1.3);
    let found = textures(&object, &Slices::uniform(0.5, 2.0, 12), OcclusionFilter::SummedArea, true);
    let at = |i: i32| found.visibility(Vec3::new(0.05, i as f32 * 1e-4, 0.03), Combination::Product);
    let largest = (0..13_000).map(|i| (at(i + 1) - at(i)).abs()).fold(0.0, f32::max);
    assert!(largest < 0.01, "{largest}");
}

#[test]
fn a_thin_wing_leaks_unless_slices_are_closed() {
    // It passes through five slices, each of which alone hides a part of the light.
    let corners = [(-0.6, -0.5), (0.6, -0.5), (0.6, 0.5), (-0.6, 0.5)];
    let vertices: Vec<Vec3> = corners.map(|(x, z)| Vec3::new(x, 1.0 + 0.5 * x, z)).to_vec();
    let wing = Occluder { vertices, triangles: vec![[0, 1, 2], [0, 2, 3]] };
    let bvh = Bvh::new(&wing.vertices, &wing.triangles);
    let slices = Slices::uniform(0.0, 2.0, 16);
    let dark: Vec<Vec3> = (0..400)
        .map(|i| Vec3::new((i % 20) as f32 * 0.02 - 0.2, 0.3, (i / 20) as f32 * 0.02 - 0.2))
        .filter(|p| traced(&bvh, &light(), *p) < 0.05)
        .collect();
    assert!(dark.len() > 10, "{} points in the umbra", dark.len());
    let leak = |close| {
        let found = textures(&wing, &slices, OcclusionFilter::SummedArea, close);
        dark.iter().map(|p| found.visibility(*p, Combination::Product)).sum::<f32>() / dark.len() as f32
    };
    let (open, closed) = (leak(false), leak(true));
    assert!(closed < 0.5 * open, "{open} leaks, {closed} where closed");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn rules_keep_their_order_on_any_occluder(
        corners in proptest::collection::vec((-0.6..0.6f32, 0.2..1.9f32, -0.6..0.6f32), 9..60),
        filter in 0usize..3, closed in any::<bool>(),
    ) {
        let vertices: Vec<Vec3> = corners.iter().map(|&(x, y, z)| Vec3::new(x, y, z)).collect();
        let triangles = (0..vertices.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let occluder = Occluder { vertices, triangles };
        let found = textures(&occluder, &Slices::uniform(0.0, 2.0, 8), OcclusionFilter::ALL[filter], closed);
        for p in floor() {
            let [product, sum, maximum] = [Combination::Product, Combination::Sum, Combination::Maximum]
                .map(|rule| found.visibility(p, rule));
            prop_assert!(sum <= product + 1e-5 && product <= maximum + 1e-5, "{} {} {}", sum, product, maximum);
        }
    }

    #[test]
    fn what_stands_before_no_light_removes_nothing(
        x in -1.0..2.0f32, z in -1.0..2.0f32, above in any::<bool>(), depth in 0.3..1.5f32,
    ) {
        let room = Room::new();
        // Behind the luminaire or below the floor.
        let y = if above { 3.0 + depth } else { -depth };
        let object = cuboid(Vec3::new(x, y, z), Vec3::splat(0.2));
        let settings = Render { method: ShadowMethod::OcclusionTextures, occlusion_px: 128, ..Default::default() };
        let removed = removed_radiance(&room.scene(), &object, &settings).unwrap();
        prop_assert!(removed.epsilon.pixels().iter().all(|e| e.0 == [0.0; 3]));
    }
}

/// A closed room with one luminaire, seen from within.
struct Room {
    lobby: Lobby,
    transfers: Transfers,
}

impl Room {
    fn new() -> Self {
        let mut lobby = Lobby::new(1.5, 64);
        let mesh = &mut lobby.light.mesh;
        mesh.patches.iter_mut().for_each(|p| p.radiance = [0.0; 3]);
        face(mesh, Vec3::new(0.2, 3.0, 0.2), Vec3::X * 0.5, Vec3::Z * 0.5, 0.25, |_| [9.0, 6.0, 3.0]);
        lobby.receivers = crate::shadow::Receivers::cast(&lobby.camera, &lobby.light.mesh);
        let settings = crate::config::Transfer { receiver_vertices: 0, ..Default::default() };
        let transfers = solve(&lobby.light, &lobby.receivers, &settings, || {}).unwrap();
        Self { lobby, transfers }
    }

    fn scene(&self) -> Scene<'_> {
        let Lobby { light, receivers, plate, .. } = &self.lobby;
        Scene { light, transfers: &self.transfers, receivers, plate, finish: None, stored: None }
    }
}

#[test]
fn on_the_plate_a_hidden_light_takes_exactly_its_contribution() {
    let room = Room::new();
    let method = PlateShadow::prepare(&room.scene(), &Render::default()).unwrap();
    let [light] = method.lights() else { panic!("{:?}", method.lights()) };
    assert!((light.area() - 0.25).abs() < 1e-3 && (light.radiance[0] - 9.0).abs() < 1e-3);
    let beside = method.frame(&cuboid(Vec3::new(0.45, 4.0, 0.45), Vec3::splat(0.2))).unwrap();
    assert!(
        beside.epsilon.pixels().iter().all(|e| e.luminance() == 0.0),
        "the object stands behind the light"
    );
    // A lid close under the luminaire hides it from the floor's middle.
    let lid = cuboid(Vec3::new(0.45, 2.8, 0.45), Vec3::new(2.0, 0.02, 2.0));
    let settings = Render { method: ShadowMethod::OcclusionTextures, ..Default::default() };
    let found = removed_radiance(&room.scene(), &lid, &settings).unwrap();
    assert_eq!(found, method.frame(&lid).unwrap());
    let mut compared = 0;
    for (i, receiver) in room.lobby.receivers.pixels.pixels().iter().enumerate() {
        let Some(r) = receiver.filter(|r| r.normal.y > 0.99 && r.position.y < 0.1) else { continue };
        if (r.position - Vec3::new(0.45, 0.0, 0.45)).abs().max_element() > 1.0 {
            continue;
        }
        compared += 1;
        let (sent, all) = (light.irradiance(r.position, r.normal), room.transfers.irradiance_on(&r).unwrap());
        for c in 0..3 {
            let share = (sent[c] / all[c]).min(1.0);
            let expected = room.lobby.plate.pixels()[i].0[c] * share;
            let found = found.epsilon.pixels()[i].0[c];
            assert!((found - expected).abs() < 1e-3 * expected, "{found}, expected {expected}");
        }
    }
    assert!(compared > 50, "{compared} pixels");
}

#[test]
fn by_rays_to_the_rectangle_little_differs() {
    let room = Room::new();
    let method = PlateShadow::prepare(&room.scene(), &Render::default()).unwrap();
    let sheet = cuboid(Vec3::new(0.45, 1.5, 0.45), Vec3::new(0.5, 0.002, 0.4));
    let [sliced, traced] = [method.frame(&sheet).unwrap(), method.traced(&sheet, 1024).unwrap()];
    let pairs = || sliced.epsilon.pixels().iter().zip(traced.epsilon.pixels());
    let signal: f32 = pairs().map(|(_, t)| t.luminance().powi(2)).sum();
    let error: f32 = pairs().map(|(s, t)| (s.luminance() - t.luminance()).powi(2)).sum();
    assert!(signal > 0.0 && (error / signal).sqrt() < 0.1, "{}", (error / signal).sqrt());
}

#[test]
fn a_scene_without_a_rectangle_is_refused() {
    let mut room = Room::new();
    room.lobby.light.mesh.patches.iter_mut().for_each(|p| p.radiance = [1.0; 3]);
    let settings = Render { method: ShadowMethod::OcclusionTextures, ..Default::default() };
    let refused = removed_radiance(&room.scene(), &lattice(1.0), &settings).unwrap_err();
    assert!(matches!(refused, crate::shadow::Problem::Rectangles(_)), "{refused}");
    assert!(refused.hint().contains("radiance-transfer"), "{}", refused.hint());
}

#[test]
fn settings_out_of_range_are_refused() {
    let room = Room::new();
    let d = Render::default();
    for settings in [
        Render { slices: 0, ..d.clone() },
        Render { slices: 17, ..d.clone() },
        Render { occlusion_px: 300, ..d.clone() },
    ] {
        let refused = PlateShadow::prepare(&room.scene(), &settings).map(|_| ());
        assert!(matches!(refused, Err(crate::shadow::Problem::Setting { .. })), "{refused:?}");
    }
}

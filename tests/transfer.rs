//! Radiance transfers against closed forms, and the hard cases of the source set.

mod room;

use glam::Vec3;
use insitu::config::Transfer;
use insitu::illuminate::patch::{DistantSource, LightModel};
use insitu::shadow::Receivers;
use insitu::transfer::{Problem, Transfers, form_factor, solve};
use room::{camera, face};

fn all() -> Transfer {
    Transfer { source_share: 1.0, ..Default::default() }
}

/// Irradiance of each source at a vertex, red.
fn row(transfers: &Transfers, vertex: usize) -> Vec<f32> {
    let mut out = vec![[0.0; 3]; transfers.sources.len()];
    transfers.expand(vertex as u32, &mut out);
    out.iter().map(|e| e[0]).collect()
}

fn solved(light: &LightModel, settings: &Transfer) -> Result<Transfers, Problem> {
    let camera = camera([0.1, 1.0, 0.1], [0.0, 0.0, 0.0], 24, 18, 24.0);
    solve(light, &Receivers::cast(&camera, &light.mesh), settings, || {})
}

fn floor(edge: f32) -> LightModel {
    let mut light = LightModel::default();
    face(&mut light.mesh, Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, edge, |_| [0.0; 3]);
    light
}

#[test]
fn one_patch_sends_its_form_factor() {
    let mut light = floor(1.0);
    let lamp = [Vec3::new(-0.3, 2.0, -0.3), Vec3::X * 0.6, Vec3::Z * 0.6];
    face(&mut light.mesh, lamp[0], lamp[1], lamp[2], 0.6, |_| [3.0, 2.0, 1.0]);
    light.mesh.patches.pop();
    let transfers = solved(&light, &all()).unwrap();
    assert_eq!(transfers.sources.len(), 1);
    let corners = light.mesh.corners(light.mesh.patches.len() - 1);
    for (v, &position) in transfers.receivers.positions.iter().enumerate() {
        let exact = 3.0 * std::f32::consts::PI * form_factor::polygon(position, Vec3::Y, &corners);
        let found = row(&transfers, v)[0];
        assert!((found / exact - 1.0).abs() < 0.02, "{found}, {exact}");
        assert!((transfers.irradiance[(v, 0)] - found).abs() < 1e-5);
    }
}

#[test]
fn a_closed_room_of_one_radiance_gives_pi_everywhere() {
    let mut light = room::room(0.25);
    light.mesh.patches.iter_mut().for_each(|p| p.radiance = [1.0; 3]);
    let transfers = solved(&light, &all()).unwrap();
    for e in transfers.irradiance.iter() {
        assert!((e / std::f32::consts::PI - 1.0).abs() < 0.02, "irradiance {e} in a furnace");
    }
}

#[test]
fn radiance_over_twelve_decades_keeps_the_faint() {
    let mut light = floor(1.0);
    face(&mut light.mesh, Vec3::new(-1.0, 2.0, -1.0), Vec3::X, Vec3::Z * 2.0, 2.0, |_| [1e6; 3]);
    face(&mut light.mesh, Vec3::new(0.0, 2.0, -1.0), Vec3::X, Vec3::Z * 2.0, 2.0, |_| [1e-6; 3]);
    let transfers = solved(&light, &all()).unwrap();
    assert_eq!(transfers.sources.len(), 4, "all of the source set when all is asked for");
    let least = transfers.sources.iter().map(|s| s.power_share).fold(1.0, f64::min);
    assert!(least > 0.0 && least < 1e-11);
    assert!(transfers.links.irradiance.iter().flatten().chain(&transfers.irradiance).all(|v| v.is_finite()));
    let strong = solved(&light, &Transfer::default()).unwrap();
    assert!(strong.sources.len() == 2 && strong.left_out == 2 && strong.left_out_share < 1e-11);
}

#[test]
fn twenty_thousand_patches_are_solved() {
    let mut light = floor(1.0);
    let ceiling = Vec3::new(-2.0, 2.5, -2.0);
    face(&mut light.mesh, ceiling, Vec3::X * 4.0, Vec3::Z * 4.0, 0.04, |_| [1.0; 3]);
    assert!(light.mesh.patches.len() > 20_000);
    let transfers = solved(&light, &all()).unwrap();
    // The ceiling as one rectangle.
    let whole = [(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)].map(|(x, z)| Vec3::new(x, 2.5, z));
    for (v, &position) in transfers.receivers.positions.iter().enumerate() {
        let f = form_factor::polygon(position, Vec3::Y, &whole);
        let found = transfers.irradiance[(v, 0)] / std::f32::consts::PI;
        assert!((found / f - 1.0).abs() < 0.02, "{found} summed, {f} as a whole");
    }
}

#[test]
fn the_rest_is_reported() {
    let light = room::room(0.4);
    let (part, whole) = (solved(&light, &Transfer::default()).unwrap(), solved(&light, &all()).unwrap());
    assert!(part.left_out_share <= 0.3 && part.left_out > 0);
    assert_eq!(part.left_out + part.sources.len(), whole.sources.len());
    let kept: f64 = part.sources.iter().map(|s| s.power_share).sum();
    assert!((kept + part.left_out_share - 1.0).abs() < 1e-9);
    // Each place counts alike: about the strongest.
    let strongest = whole.sources.iter().map(|s| s.power_share).fold(0.0, f64::max);
    let kinds: Vec<_> = part.sources.iter().map(|s| s.kind).collect();
    let left_out = whole.sources.iter().filter(|s| !kinds.contains(&s.kind));
    assert!(left_out.into_iter().all(|s| s.power_share < 0.5 * strongest), "the strongest are kept");
    assert!(part.largest_left_out_share >= part.left_out_share && part.largest_left_out_share < 1.0);
    let vertices = part.receivers.positions.len().min(whole.receivers.positions.len());
    for v in 0..vertices {
        let (a, b) = (part.irradiance[(v, 1)], whole.irradiance[(v, 1)]);
        assert!((a / b - 1.0).abs() < 0.01, "all light counts in the irradiance: {a}, {b}");
    }
}

#[test]
fn distant_light_is_shadowed_by_the_scene() {
    let mut light = floor(0.5);
    let direction = Vec3::new(0.0, 1.0, 0.0);
    light.distant.push(DistantSource { direction, solid_angle_sr: 1e-3, radiance: [100.0; 3] });
    let open = solved(&light, &all()).unwrap();
    assert!((0..open.receivers.positions.len()).all(|v| (row(&open, v)[0] - 0.1).abs() < 1e-4));
    // A roof over the half x < 0.
    face(&mut light.mesh, Vec3::new(-2.0, 2.0, -2.0), Vec3::X * 1.9, Vec3::Z * 4.0, 4.0, |_| [0.0; 3]);
    let roofed = solved(&light, &Transfer { receiver_tolerance: 0.0, ..all() }).unwrap();
    for (v, position) in roofed.receivers.positions.iter().enumerate() {
        let expected = if position.x < -0.2 { 0.0 } else { 0.1 };
        assert!((row(&roofed, v)[0] - expected).abs() < 1e-4);
    }
}

#[test]
fn light_that_counts_under_a_roof_alone_is_a_source() {
    let mut light = floor(0.5);
    let direction = Vec3::new(0.0, 1.0, 0.0);
    light.distant.push(DistantSource { direction, solid_angle_sr: 1e-3, radiance: [100.0; 3] });
    face(&mut light.mesh, Vec3::new(-2.0, 2.0, -2.0), Vec3::X * 2.0, Vec3::Z * 4.0, 4.0, |_| [0.0; 3]);
    // A wall at the far end of what the roof hides from the sun: less than a hundredth of all light.
    face(&mut light.mesh, Vec3::new(-2.0, 0.0, -2.0), Vec3::Y, Vec3::Z * 4.0, 4.0, |_| [5e-4; 3]);
    let transfers = solved(&light, &Transfer { source_share: 0.98, ..all() }).unwrap();
    let wall: f64 = transfers.sources.iter().map(|s| s.power_share).filter(|s| *s < 0.5).sum();
    assert!(wall > 0.0 && wall < 0.01, "the wall is a source with {wall} of all light");
    assert!(transfers.largest_left_out_share < 0.1, "{}", transfers.largest_left_out_share);
}

#[test]
fn what_cannot_be_solved_is_refused() {
    let refuse = |light: &LightModel, settings: &Transfer| solved(light, settings).unwrap_err().to_string();
    assert!(refuse(&floor(1.0), &all()).starts_with("none of 8 light sources reaches"));
    let lit = room::room(1.0);
    assert_eq!(
        refuse(&lit, &Transfer { source_share: 1.5, ..all() }),
        "source_share is 1.5, which is not above 0 and at most 1"
    );
    assert_eq!(refuse(&lit, &Transfer { rays: 0, ..all() }), "rays is 0");
    assert!(refuse(&LightModel::default(), &all()).contains("sees none of the model's 0 patches"));
    let mut broken = lit.clone();
    broken.mesh.patches[3].radiance[1] = f32::NAN;
    assert!(refuse(&broken, &all()).starts_with("patch 3 has radiance"));
}

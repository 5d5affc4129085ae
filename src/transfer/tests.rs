//! Whole scenes: sets, traversal, refinement, hard cases.

use super::*;
use crate::camera::{Camera, Intrinsics};
use crate::config::{SourceOrder, Transfer};
use crate::illuminate::patch::{DistantSource, Evidence, LightModel, Patch, PatchMesh};
use crate::image::luminance;
use crate::shadow::Receivers;
use glam::Vec3;
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

/// Cuts the parallelogram `corner + u + v` (front along u × v) into triangles with legs of at most `edge` m.
fn face(mesh: &mut PatchMesh, corner: Vec3, u: Vec3, v: Vec3, edge: f32, radiance: impl Fn(Vec3) -> f32) {
    let (columns, rows) = ((u.length() / edge).ceil() as u32, (v.length() / edge).ceil() as u32);
    let base = mesh.vertices.len() as u32;
    let face = mesh.patches.last().map_or(0, |p| p.face + 1);
    for (j, i) in (0..=rows).flat_map(|j| (0..=columns).map(move |i| (j, i))) {
        mesh.vertices.push(corner + u * (i as f32 / columns as f32) + v * (j as f32 / rows as f32));
        mesh.normals.push(u.cross(v).normalize());
    }
    for (j, i) in (0..rows).flat_map(|j| (0..columns).map(move |i| (j, i))) {
        let at = |di, dj| base + (j + dj) * (columns + 1) + i + di;
        for vertices in [[at(0, 0), at(1, 0), at(1, 1)], [at(0, 0), at(1, 1), at(0, 1)]] {
            let centre = vertices.iter().map(|&k| mesh.vertices[k as usize]).sum::<Vec3>() / 3.0;
            let radiance = [radiance(centre), 0.9 * radiance(centre), 0.7 * radiance(centre)];
            let (reflectance, evidence) = ([0.5; 3], Evidence::Probe);
            mesh.patches.push(Patch { vertices, face, radiance, reflectance, evidence });
        }
    }
}

/// A box that is open below: its top and its four sides, each of one radiance.
fn block(mesh: &mut PatchMesh, low: Vec3, size: Vec3, edge: f32, radiance: f32) {
    let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
    let shade = |_: Vec3| radiance;
    face(mesh, low + y, z, x, edge, shade);
    face(mesh, low, y, x, edge, shade);
    face(mesh, low + z, x, y, edge, shade);
    face(mesh, low, z, y, edge, shade);
    face(mesh, low + x, y, z, edge, shade);
}

/// A room, 4 × 2.6 × 4 m, with a table (its top looks down, too), a window and a lamp.
pub(super) fn room(edge: f32) -> LightModel {
    let mut mesh = PatchMesh::default();
    let (x, y, z) = (Vec3::X * 4.0, Vec3::Y * 2.6, Vec3::Z * 4.0);
    let low = Vec3::new(-2.0, 0.0, -2.0);
    face(&mut mesh, low, z, x, edge, |p| 0.2 + 0.05 * p.x);
    face(&mut mesh, low + y, x, z, edge, |p| {
        if p.x.abs() < 0.25 && (p.z - 0.8).abs() < 0.25 { 25.0 } else { 0.5 }
    });
    face(&mut mesh, low, y, z, edge, |p| if (p.y - 1.4).abs() < 0.6 && p.z.abs() < 1.0 { 7.0 } else { 0.3 });
    face(&mut mesh, low + x, z, y, edge, |_| 0.6);
    face(&mut mesh, low, x, y, edge, |_| 0.5);
    face(&mut mesh, low + z, y, x, edge, |_| 0.4);
    let top = Vec3::new(-0.2, 0.7, -0.5);
    block(&mut mesh, top, Vec3::new(1.0, 0.04, 0.7), edge, 0.15);
    face(&mut mesh, top, Vec3::X, Vec3::Z * 0.7, edge, |_| 0.05);
    for (dx, dz) in [(0.0, 0.0), (0.95, 0.0), (0.0, 0.65), (0.95, 0.65)] {
        let foot = Vec3::new(top.x + dx, 0.0, top.z + dz);
        block(&mut mesh, foot, Vec3::new(0.05, 0.7, 0.05), edge, 0.1);
    }
    LightModel { mesh, distant: Vec::new() }
}

pub(super) fn camera(eye: [f64; 3], target: [f64; 3], width: u32) -> Camera {
    let (eye, target) = (Point3::from(eye), Point3::from(target));
    let forward = (target - eye).normalize();
    let right = forward.cross(&Vector3::y()).normalize();
    let axes = nalgebra::Matrix3::from_columns(&[right, forward.cross(&right), forward]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Camera {
        intrinsics: Intrinsics::pinhole(width, width * 3 / 4, f64::from(width) * 0.8),
        world_from_camera: Isometry3::from_parts(Translation3::from(eye.coords), rotation),
    }
}

fn solved(light: &LightModel, settings: &Transfer) -> Transfers {
    let camera = camera([1.2, 1.5, 1.8], [0.0, 0.1, -0.2], 96);
    solve(light, &Receivers::cast(&camera, &light.mesh), settings, || {}).unwrap()
}

fn all() -> Transfer {
    Transfer { source_share: 1.0, ..Default::default() }
}

/// The room under the sun and a sky, without its ceiling.
fn courtyard(edge: f32) -> LightModel {
    let mut light = room(edge);
    light.mesh.patches.retain(|p| p.face != 1);
    let sun = Vec3::new(0.4, 0.8, 0.3).normalize();
    light.distant.push(DistantSource { direction: sun, solid_angle_sr: 6.8e-5, radiance: [4e4; 3] });
    for i in 0..24 {
        let (turn, height) = (i as f32 * 2.399_963, 0.1 + 0.85 * i as f32 / 24.0);
        let r = (1.0 - height * height).sqrt();
        let direction = Vec3::new(r * turn.cos(), height, r * turn.sin());
        light.distant.push(DistantSource { direction, solid_angle_sr: 0.2, radiance: [0.5; 3] });
    }
    light
}

/// Whether a segment, or a ray towards distant light, passes a box.
fn crosses(from: Vec3, step: Vec3, most: f32, min: Vec3, max: Vec3) -> bool {
    let (mut low, mut high) = (0.0f32, most);
    for k in 0..3 {
        let (a, b) = ((min[k] - from[k]) / step[k], (max[k] - from[k]) / step[k]);
        if step[k] == 0.0 {
            if from[k] < min[k] || from[k] > max[k] {
                return false;
            }
        } else {
            (low, high) = (low.max(a.min(b)), high.min(a.max(b)));
        }
    }
    low <= high
}

/// Random boxes against random points of lights and receivers: what a segment passes is in the lists.
fn nothing_is_missed(light: &LightModel, transfers: &Transfers, boxes: &[(Vec3, Vec3)], seed: u64) -> usize {
    let mut traversal = Traversal::default();
    let mut row = vec![[0.0; 3]; transfers.sources.len()];
    let mut hits = 0;
    for (n, &(min, size)) in boxes.iter().enumerate() {
        let max = min + size;
        let found = traversal.affected(transfers, min, max);
        assert!(found.sources.is_sorted() && found.patches.is_sorted());
        assert_eq!(found, transfers.affected(min, max), "marks of earlier frames do no harm");
        for k in 0..60u32 {
            let shift = sampling::Shift::new(seed, n as u64);
            let at =
                |i: u32, count: usize| ((shift.jitter(7 * k + i) * count as f32) as usize).min(count - 1);
            let t = transfers.receivers.triangles[at(0, transfers.receivers.triangles.len())];
            let corners = t.vertices.map(|v| transfers.receivers.positions[v as usize]);
            let x = sampling::on_triangle(corners, shift.point(2 * k));
            let lit: Vec<usize> = t.vertices.iter().fold(Vec::new(), |mut lit, &v| {
                transfers.expand(v, &mut row);
                lit.extend((0..row.len()).filter(|&j| row[j][0] > 0.0));
                lit
            });
            for &j in lit.iter().step_by(3) {
                let (step, most) = match transfers.sources[j].kind {
                    SourceKind::Patch(p) => (
                        sampling::on_triangle(light.mesh.corners(p as usize), shift.point(2 * k + 1)) - x,
                        1.0,
                    ),
                    SourceKind::Distant(d) => {
                        let d = light.distant[d as usize];
                        (sampling::in_cap(d.direction, d.angular_radius(), shift.point(2 * k + 1)), 1e3)
                    }
                };
                if crosses(x, step, most, min, max) {
                    hits += 1;
                    assert!(found.sources.binary_search(&(j as u32)).is_ok(), "source {j} missed");
                    assert!(found.patches.binary_search(&t.patch).is_ok(), "receiver {} missed", t.patch);
                }
            }
        }
    }
    hits
}

#[test]
fn traversal_never_misses_what_a_segment_passes() {
    let boxes: Vec<(Vec3, Vec3)> = (0..40)
        .map(|i| {
            let r = |k: u32| sampling::Shift::new(5, i).jitter(k);
            let min = Vec3::new(3.6 * r(0) - 1.9, 2.4 * r(1), 3.6 * r(2) - 1.9);
            // Every third one is flat, some are points.
            let size = Vec3::new(0.4 * r(3), if i % 3 == 0 { 0.0 } else { 0.4 * r(4) }, 0.4 * r(5));
            (min, if i % 7 == 0 { Vec3::ZERO } else { size })
        })
        .collect();
    for light in [room(0.35), courtyard(0.5)] {
        for settings in [all(), Transfer { leaf_patches: 3, shaft_share: 0.0, ..all() }, Transfer::default()]
        {
            let transfers = solved(&light, &settings);
            let hits = nothing_is_missed(&light, &transfers, &boxes, 9);
            assert!(hits > 100, "{hits} segments pass some box");
        }
    }
}

#[test]
fn traversal_is_close_to_what_single_pairs_say() {
    let transfers = solved(&room(0.25), &Transfer { shaft_share: 0.0, ..all() });
    let (min, max) = (Vec3::new(-0.8, 0.0, -0.3), Vec3::new(-0.6, 0.25, -0.1));
    let (found, pairs) = (transfers.affected(min, max), transfers.affected_by_pairs(min, max));
    assert!(!found.sources.is_empty() && found.sources.len() <= pairs.sources.len() + 5);
    let wide = found.patches.len() as f64 / pairs.patches.len() as f64;
    assert!(wide < 1.6, "{} of {} by pairs", found.patches.len(), pairs.patches.len());
    let out_of_the_way = transfers.affected(Vec3::splat(50.0), Vec3::splat(51.0));
    assert_eq!(out_of_the_way, Affected::default());
    let everything = transfers.affected(Vec3::splat(-9.0), Vec3::splat(9.0));
    assert_eq!(everything.patches, transfers.receivers.patches);
}

#[test]
fn boxes_in_the_planes_of_shafts_and_around_sources() {
    let light = room(0.35);
    let transfers = solved(&light, &all());
    let lamp = (0..transfers.sources.len())
        .max_by(|&a, &b| transfers.sources[a].power_share.total_cmp(&transfers.sources[b].power_share));
    let lamp = lamp.unwrap();
    let SourceKind::Patch(p) = transfers.sources[lamp].kind else { panic!("no patch") };
    let at = light.mesh.centroid(p as usize);
    let around = transfers.affected(at - 0.1, at + 0.1);
    assert!(around.sources.contains(&(lamp as u32)), "an object around the source");
    let touching = transfers.affected(at - Vec3::new(0.1, 0.0, 0.1), at + Vec3::new(0.1, 0.0, 0.1));
    assert!(touching.sources.contains(&(lamp as u32)), "a flat box in the lamp's own plane");
    let on_floor = transfers.affected(Vec3::new(-1.0, 0.0, -1.0), Vec3::new(-0.8, 0.0, -0.8));
    assert!(!on_floor.patches.is_empty(), "a flat box on the floor");
}

#[test]
fn shafts_are_small_and_say_what_they_are() {
    let transfers = solved(&room(0.25), &Transfer::default());
    let counts = transfers.shaft_counts();
    assert!(counts.bytes_per_shaft <= 100);
    assert!(counts.leaves > 10 && counts.leaves < counts.shafts && counts.ended <= counts.leaves);
    let fine = solved(&room(0.25), &Transfer { shaft_share: 0.0, ..Default::default() }).shaft_counts();
    assert!(fine.shafts > 2 * counts.shafts, "{} against {}", fine.shafts, counts.shafts);
    assert_eq!(fine.ended, 0);
}

#[test]
fn sets_by_power_keep_what_shines_away() {
    let mut light = room(0.5);
    // A bright patch that looks at nothing.
    face(&mut light.mesh, Vec3::new(5.0, 0.0, 0.0), Vec3::Y, Vec3::Z, 1.0, |_| 1e3);
    for order in [SourceOrder::Received, SourceOrder::Power] {
        let transfers = solved(&light, &Transfer { order, source_share: 0.7, ..Default::default() });
        assert!(transfers.sources.iter().all(|s| s.power_share > 0.0), "no source that reaches nothing");
        let kept: f64 = transfers.sources.iter().map(|s| s.power_share).sum();
        assert!((kept + transfers.left_out_share - 1.0).abs() < 1e-9);
        assert!(transfers.largest_left_out_share >= transfers.left_out_share);
    }
}

#[test]
fn patches_seen_by_corners_of_pixels_alone_are_receivers() {
    let light = room(0.05);
    let camera = camera([1.2, 1.5, 1.8], [0.0, 0.1, -0.2], 24);
    let receivers = Receivers::cast(&camera, &light.mesh);
    let centres: std::collections::BTreeSet<u32> =
        receivers.pixels.pixels().iter().flatten().map(|r| r.patch).collect();
    assert!(receivers.seen.len() > centres.len());
    assert!(centres.iter().all(|p| receivers.seen.binary_search(p).is_ok()));
}

/// Irradiance at a point by the receivers' triangles.
fn interpolated(transfers: &Transfers, patch: u32, weights: [f32; 3]) -> Option<f32> {
    let (vertices, weights) = transfers.receivers.locate(patch, weights)?;
    Some((0..3).map(|k| transfers.irradiance[(vertices[k] as usize, 1)] * weights[k]).sum())
}

#[test]
fn receivers_are_split_along_shadows_and_know_them_better() {
    let light = room(0.35);
    let coarse = solved(&light, &Transfer { receiver_tolerance: 0.0, ..all() });
    let fine = solved(&light, &all());
    assert!(fine.receivers.positions.len() > coarse.receivers.positions.len() + 50);
    let capped = Transfer { receiver_vertices: coarse.receivers.positions.len() + 40, ..all() };
    let capped = solved(&light, &capped).receivers.positions.len();
    assert!(capped > coarse.receivers.positions.len() && capped < coarse.receivers.positions.len() + 120);
    // The floor under and around the table against a scene of many more patches.
    let mut dense = light.clone();
    let keep: Vec<Patch> = dense.mesh.patches.iter().filter(|p| p.face != 0).copied().collect();
    dense.mesh.patches = keep;
    let (z, x) = (Vec3::Z * 4.0, Vec3::X * 4.0);
    face(&mut dense.mesh, Vec3::new(-2.0, 0.0, -2.0), z, x, 0.08, |p| 0.2 + 0.05 * p.x);
    let dense_transfers = solved(&dense, &Transfer { receiver_tolerance: 0.0, ..all() });
    let (mut errors, mut count) = ([0.0f64; 2], 0);
    for (i, patch) in dense.mesh.patches.iter().enumerate() {
        let at = dense.mesh.centroid(i);
        if at.y > 0.0 || patch.radiance[0] == 0.0 || (at.x - 0.3).abs() > 0.9 || (at.z + 0.15).abs() > 0.8 {
            continue;
        }
        let Some(truth) = interpolated(&dense_transfers, i as u32, [1.0 / 3.0; 3]) else { continue };
        // The floor's patch around the point.
        let found =
            (0..light.mesh.patches.len()).filter(|&p| light.mesh.patches[p].face == 0).find_map(|p| {
                let [a, b, c] = light.mesh.corners(p);
                let n = (b - a).cross(c - a);
                let w = [(c - b).cross(at - b), (a - c).cross(at - c), (b - a).cross(at - a)];
                let w = w.map(|v| v.dot(n) / n.length_squared());
                (w.iter().all(|&w| w >= 0.0)).then_some((p as u32, w))
            });
        let Some((p, w)) = found else { continue };
        for (k, t) in [&coarse, &fine].into_iter().enumerate() {
            let Some(e) = interpolated(t, p, w) else { continue };
            errors[k] += f64::from((e - truth) / truth).powi(2);
        }
        count += 1;
    }
    let rms = errors.map(|e| (e / f64::from(count)).sqrt());
    println!("rms error of the irradiance around the table: {:.3} not split, {:.3} split", rms[0], rms[1]);
    assert!(count > 200 && rms[1] < 0.7 * rms[0], "{rms:?} at {count} points");
}

#[test]
fn a_source_at_the_horizon_and_one_on_the_receiver_are_finite() {
    let mut light = room(0.5);
    // A lamp that lies on the floor and shines along it, and a pane that stands on it.
    face(&mut light.mesh, Vec3::new(-1.0, 0.0, -1.0), Vec3::X * 0.5, Vec3::Y * 0.3, 0.5, |_| 50.0);
    face(&mut light.mesh, Vec3::new(-1.0, 1e-5, 0.5), Vec3::X * 0.3, Vec3::Z * 0.3, 0.5, |_| 50.0);
    let graze = Vec3::new(1.0, 1e-5, 0.0).normalize();
    light.distant.push(DistantSource { direction: graze, solid_angle_sr: 6.8e-5, radiance: [1e5; 3] });
    let transfers = solved(&light, &all());
    let most = 4.0 * std::f32::consts::PI * 50.0;
    for e in transfers.irradiance.iter().chain(transfers.links.irradiance.iter().flatten()) {
        assert!(e.is_finite() && *e >= 0.0 && *e < most, "{e}");
    }
}

#[test]
fn a_polished_floor_shows_the_window_and_keeps_its_energy() {
    let mut light = room(0.25);
    light.mesh.patches.retain(|p| p.face < 6);
    let eye = [1.2, 1.5, 1.8];
    let receivers = Receivers::cast(&camera(eye, [0.0, 0.1, -0.2], 96), &light.mesh);
    let mut gloss = vec![None; 6];
    gloss[0] = Some(crate::model::face::Gloss { specular: [0.3; 3], shininess: 60.0 });
    let eye = Vec3::from(eye.map(|c| c as f32));
    let finish = Finish { eye, gloss: &gloss };
    let settings = Transfer { receiver_tolerance: 0.0, ..all() };
    let plain = solve(&light, &receivers, &settings, || {}).unwrap();
    let polished = solve_glossy(&light, &receivers, Some(finish), &settings, || {}).unwrap();
    let most = |t: &Transfers| {
        let floor = (0..t.receivers.positions.len()).filter(|&v| t.receivers.normals[v] == Vec3::Y);
        floor.map(|v| t.irradiance[(v, 1)] / plain.irradiance[(v, 1)]).fold(0.0, f32::max)
    };
    assert!(most(&polished) > 1.5, "the window's image is {} times as bright", most(&polished));
    let wall = (0..plain.receivers.positions.len()).filter(|&v| plain.receivers.normals[v] != Vec3::Y);
    for v in wall {
        assert_eq!(plain.irradiance[(v, 1)], polished.irradiance[(v, 1)], "walls are as before");
    }
    // In a furnace of radiance 1 a floor of ρ = 0.5 and k = 0.3 shows at most 0.8, and most of that from above.
    light.mesh.patches.iter_mut().for_each(|p| p.radiance = [1.0; 3]);
    let furnace = solve_glossy(&light, &receivers, Some(finish), &settings, || {}).unwrap();
    for v in (0..furnace.receivers.positions.len()).filter(|&v| furnace.receivers.normals[v] == Vec3::Y) {
        let shown = 0.5 / std::f32::consts::PI * furnace.irradiance[(v, 1)];
        assert!(shown > 0.55 && shown < 0.82, "{shown} shown in a furnace");
    }
}

#[test]
fn one_patch_is_its_own_room() {
    let mut light = LightModel::default();
    face(&mut light.mesh, Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, 3.0, |_| 0.0);
    light.mesh.patches.truncate(1);
    light.distant.push(DistantSource { direction: Vec3::Y, solid_angle_sr: 0.1, radiance: [1.0; 3] });
    let transfers = solved(&light, &all());
    assert_eq!((transfers.sources.len(), transfers.receivers.patches.len()), (1, 1));
    let above = transfers.affected(Vec3::new(-0.1, 0.5, -0.1), Vec3::new(0.1, 0.6, 0.1));
    assert_eq!(above, Affected { sources: vec![0], patches: vec![0] });
    let below = transfers.affected(Vec3::new(-0.1, -0.6, -0.1), Vec3::new(0.1, -0.5, 0.1));
    assert_eq!(below, Affected::default());
}

#[test]
fn a_thousand_faint_sources_add_up_in_f32_as_in_f64() {
    let light = room(0.2);
    let transfers = solved(&light, &Transfer { link_tolerance: 0.0, receiver_tolerance: 0.0, ..all() });
    assert!(transfers.sources.len() > 1000);
    let mut row = vec![[0.0f32; 3]; transfers.sources.len()];
    for v in 0..transfers.receivers.positions.len() {
        transfers.expand(v as u32, &mut row);
        let (single, double) = row.iter().fold((0.0f32, 0.0f64), |(s, d), e| (s + e[1], d + f64::from(e[1])));
        let all = f64::from(transfers.irradiance[(v, 1)]);
        assert!((double / all - 1.0).abs() < 1e-6, "{double} of {all}");
        assert!((f64::from(single) / double - 1.0).abs() < 2e-5, "{single} in f32, {double} in f64");
    }
}

#[test]
fn clusters_and_single_lights_agree() {
    let light = room(0.25);
    let exact = Transfer { link_tolerance: 0.0, receiver_tolerance: 0.0, rays: 16, ..all() };
    let (exact, fast) =
        (solved(&light, &exact), solved(&light, &Transfer { receiver_tolerance: 0.0, ..all() }));
    let (mut off, mut sum) = (0.0, 0.0);
    for (a, b) in exact.irradiance.outer_iter().zip(fast.irradiance.outer_iter()) {
        let [a, b] = [a, b].map(|e| f64::from(luminance([e[0], e[1], e[2]])));
        off += (a - b).powi(2);
        sum += a * a;
    }
    let rms = (off / sum).sqrt();
    assert!(rms < 0.01, "irradiance differs by {rms}");
    assert!(fast.links.node.len() * 2 < exact.links.node.len());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, ..Default::default() })]
    #[test]
    fn the_furnace_stays_at_pi(edge in 0.3..0.8f32, radiance in 1e-3..1e3f32) {
        let mut light = room(edge);
        light.mesh.patches.retain(|p| p.face < 6);
        light.mesh.patches.iter_mut().for_each(|p| p.radiance = [radiance; 3]);
        let transfers = solved(&light, &all());
        for e in transfers.irradiance.iter() {
            let share = e / (std::f32::consts::PI * radiance);
            prop_assert!((share - 1.0).abs() < 0.02, "{} of π in a furnace", share);
        }
    }
}

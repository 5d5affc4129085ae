//! Rooms of segments with clutter among them, and clutter alone.

use super::manhattan::find;
use super::vanishing::{Edge, StatedFocal};
use super::{Problem, vanishing};
use nalgebra::{Point2, Rotation3, Vector3};
use proptest::prelude::*;
use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};

const CENTRE: Point2<f64> = Point2::new(320.0, 240.0);
const DIAGONAL: f64 = 800.0;
const FOCAL: f64 = 600.0;

/// A camera that looks down by `pitch` and to the left by `yaw`, rad.
fn camera(yaw: f64, pitch: f64) -> Rotation3<f64> {
    // z up, x right, y forward; then the camera's own axes.
    let level = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
    let tilt = Rotation3::from_axis_angle(&Vector3::x_axis(), pitch);
    tilt * level * Rotation3::from_axis_angle(&Vector3::z_axis(), -yaw)
}

/// `edges` segments along each direction with half a pixel of noise, and clutter of any direction.
fn segments(camera_from_room: &Rotation3<f64>, edges: usize, clutter: usize, seed: u64) -> Vec<Edge> {
    let mut random = SmallRng::seed_from_u64(seed);
    let mut all = Vec::new();
    for k in 0..3 {
        for _ in 0..edges {
            let pixel = Point2::new(random.random_range(40.0..600.0), random.random_range(40.0..440.0));
            let ray = ((pixel - CENTRE) / FOCAL).push(1.0) * 3.0;
            let half = camera_from_room * Vector3::ith(k, random.random_range(0.1..0.5));
            let mut end = |p: Vector3<f64>| {
                let noise =
                    nalgebra::Vector2::new(random.random_range(-0.5..0.5), random.random_range(-0.5..0.5));
                CENTRE + p.xy() * (FOCAL / p.z) + noise
            };
            all.push([end(ray - half), end(ray + half)]);
        }
    }
    for _ in 0..clutter {
        let p = Point2::new(random.random_range(0.0..640.0), random.random_range(0.0..480.0));
        let (angle, length) = (random.random_range(0.0..6.3f64), random.random_range(12.0..60.0));
        all.push([p, p + nalgebra::Vector2::new(angle.cos(), angle.sin()) * length]);
    }
    all
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn a_room_is_found_among_as_much_clutter(yaw in 0.2..0.7f64, pitch in 0.1..0.5f64, seed in 0..1000u64) {
        let truth = camera(yaw, pitch);
        let all = segments(&truth, 30, 90, seed);
        let found = find(&all, CENTRE, DIAGONAL, None).unwrap().fit;
        let error = found.room.focal_px / FOCAL - 1.0;
        let sigma = found.focal_sigma_px() / FOCAL;
        prop_assert!(error.abs() < (5.0 * sigma).max(0.02), "{error} ± {sigma}");
        let off = found.room.camera_from_room.angle_to(&truth).to_degrees();
        prop_assert!(off < 1.0, "{off}° off");
    }
}

#[test]
fn axes_point_up_right_and_away() {
    for yaw in [-0.6, -0.3, 0.3, 0.6] {
        let truth = camera(yaw, 0.3);
        let stated = Some(StatedFocal { focal_px: FOCAL, relative_sigma: 1e-3 });
        let found = find(&segments(&truth, 20, 20, 5), CENTRE, DIAGONAL, stated).unwrap();
        assert!(found.fit.room.camera_from_room.angle_to(&truth).to_degrees() < 1.0, "{yaw}");
        let lengths = found.edges.along.each_ref().map(Vec::len);
        assert!(lengths.iter().all(|n| (15..=30).contains(n)), "{lengths:?}");
        // The marks of x run to the right.
        let to_the_right = found.edges.along[0].iter().filter(|[p, q]| q.x > p.x).count();
        assert_eq!(to_the_right, lengths[0]);
    }
}

#[test]
fn clutter_alone_is_no_room() {
    for seed in 0..3 {
        for clutter in [3, 20, 200, 1000] {
            let all = segments(&camera(0.3, 0.3), 0, clutter, seed);
            let stated = Some(StatedFocal { focal_px: FOCAL, relative_sigma: 0.04 });
            for stated in [None, stated] {
                let found = find(&all, CENTRE, DIAGONAL, stated);
                assert!(
                    matches!(found, Err(Problem::NoRoom { .. })),
                    "{seed} {clutter} {:?}",
                    found.map(|f| f.fit)
                );
            }
        }
    }
}

#[test]
fn a_corridor_seen_along_its_axis_is_refused_with_its_condition_number() {
    let all = segments(&camera(0.02, 0.02), 30, 10, 2);
    let e = find(&all, CENTRE, DIAGONAL, None).and_then(|f| f.fit.certain()).unwrap_err();
    assert!(matches!(e, Problem::FocalOpen { condition, .. } if condition > 10.0), "{e}");
    // A stated focal length settles it.
    let stated = Some(StatedFocal { focal_px: FOCAL, relative_sigma: 0.02 });
    let found = find(&all, CENTRE, DIAGONAL, stated).and_then(|f| f.fit.certain()).unwrap();
    assert!((found.room.focal_px / FOCAL - 1.0).abs() < 0.03);
    let marked = vanishing::fit_edges(
        &find(&all, CENTRE, DIAGONAL, stated).unwrap().edges,
        CENTRE,
        DIAGONAL,
        0.5,
        None,
        vanishing::Inner::default(),
    );
    assert!(
        matches!(
            marked,
            Err(Problem::FocalOpen { .. }
                | Problem::FewVanishingPoints { .. }
                | Problem::NegativeFocal { .. })
        ),
        "{marked:?}"
    );
}

/// As they are where something turns neighbours alike: those of one direction by half a degree, another way every 80 px.
fn leaning_together(all: &[Edge], edges: usize, seed: u64) -> Vec<Edge> {
    let leaning = |[p, q]: &Edge, direction: usize| {
        let middle = nalgebra::center(p, q);
        let at = (middle.x / 80.0).floor() as u64 * 100 + (middle.y / 80.0).floor() as u64;
        let mut random = SmallRng::seed_from_u64(seed * 1_000_003 + at * 10 + direction as u64);
        // Nearly normal, of variance 1.
        let normal: f64 = (0..12).map(|_| random.random_range(-0.5..0.5)).sum();
        let turn = nalgebra::Rotation2::new(normal * 0.5f64.to_radians());
        [p, q].map(|end| middle + turn * (end - middle))
    };
    all.iter().enumerate().map(|(k, edge)| leaning(edge, (k / edges).min(3))).collect()
}

/// Angle between the nearest axes, however they are named, degrees.
fn axes_apart(a: &Rotation3<f64>, b: &Rotation3<f64>) -> f64 {
    let cosines = (a.inverse() * b).matrix().abs();
    let worst = (0..3).map(|k| cosines.column(k).max()).fold(1.0, f64::min);
    worst.min(1.0).acos().to_degrees()
}

#[test]
fn rooms_whose_edges_lean_together_are_as_uncertain_as_they_say() {
    let truth = camera(0.5, 0.3);
    let (mut squares, mut sum, mut turns) = (0.0, 0.0, 0.0);
    let draws = 60;
    for seed in 0..draws {
        let all = leaning_together(&segments(&truth, 60, 60, seed), 60, seed);
        let fit = find(&all, CENTRE, DIAGONAL, None).unwrap().fit;
        let off = (fit.room.focal_px - FOCAL) / fit.focal_sigma_px();
        squares += off * off;
        sum += off;
        let turn = (truth * fit.room.camera_from_room.inverse()).scaled_axis();
        let of_turn = fit.covariance.fixed_view::<3, 3>(1, 1).clone_owned();
        turns += turn.dot(&(of_turn.try_inverse().unwrap() * turn)) / 3.0;
    }
    let [squares, sum, turns] = [squares, sum, turns].map(|v| v / draws as f64);
    assert!((0.5..1.6).contains(&squares), "focal length: χ² is {squares} of 1");
    assert!((0.5..1.6).contains(&turns), "turn: χ² is {turns} of 1");
    assert!(sum.abs() < 0.4, "focal length: off by {sum} standard deviations");
}

#[test]
fn parallel_clutter_is_resisted_or_told() {
    for seed in 0..12 {
        let truth = camera(0.3 + 0.03 * seed as f64, 0.15 + 0.02 * seed as f64);
        let mut all = segments(&truth, 30, 30, seed);
        let mut random = SmallRng::seed_from_u64(seed);
        // Shadows: in one part of the picture, of one direction in it, to three degrees.
        let towards: f64 = random.random_range(0.0..3.1);
        for _ in 0..60 {
            let p = Point2::new(random.random_range(300.0..600.0), random.random_range(300.0..440.0));
            let (angle, length) =
                (towards + random.random_range(-0.05..0.05), random.random_range(15.0..80.0));
            all.push([p, p + nalgebra::Vector2::new(angle.cos(), angle.sin()) * length]);
        }
        if let Ok(fit) = find(&all, CENTRE, DIAGONAL, None).and_then(|f| f.fit.certain()) {
            let (error, sigma) = (fit.room.focal_px / FOCAL - 1.0, fit.focal_sigma_px() / FOCAL);
            assert!(error.abs() < (3.0 * sigma).max(0.02), "{seed}: {error} ± {sigma}");
        }
    }
}

#[test]
fn growth_that_stands_upright_is_no_room() {
    for seed in 0..4 {
        for (count, spread) in [(60, 0.3), (300, 0.3), (1000, 0.3), (300, 0.15)] {
            let mut random = SmallRng::seed_from_u64(seed);
            let stalk = |_| {
                let p = Point2::new(random.random_range(0.0..640.0), random.random_range(0.0..480.0));
                let normal: f64 = (0..12).map(|_| random.random_range(-0.5..0.5)).sum();
                let (angle, length) = (1.571 + spread * normal, random.random_range(12.0..60.0));
                [p, p + nalgebra::Vector2::new(angle.cos(), angle.sin()) * length]
            };
            let all: Vec<Edge> = (0..count).map(stalk).collect();
            let found = find(&all, CENTRE, DIAGONAL, None).and_then(|f| f.fit.certain());
            let stated = Some(StatedFocal { focal_px: FOCAL, relative_sigma: 0.04 });
            let known = find(&all, CENTRE, DIAGONAL, stated);
            assert!(found.is_err(), "{count} {spread}: {found:?}");
            if count >= 300 {
                assert!(
                    matches!(known, Err(Problem::NoRoom { .. })),
                    "{count} {spread}: {:?}",
                    known.map(|f| f.fit)
                );
            }
        }
    }
}

#[test]
fn two_directions_or_a_camera_held_askew_serve_as_well() {
    for seed in 0..8 {
        let (yaw, pitch) = (0.3 + 0.05 * seed as f64, 0.2 + 0.1 * seed as f64);
        // A wall and its uprights, clutter; then all three, rolled to the side.
        let upright = camera(yaw, 0.4);
        let mut wall = segments(&upright, 30, 30, seed);
        wall.drain(30..60);
        let roll = Rotation3::from_axis_angle(&Vector3::z_axis(), 0.2 * seed as f64 - 0.7);
        let askew = roll * camera(yaw, pitch);
        for (truth, all) in [(upright, wall), (askew, segments(&askew, 30, 60, seed))] {
            let found = find(&all, CENTRE, DIAGONAL, None).and_then(|f| f.fit.certain());
            match &found {
                Ok(fit) => {
                    let (error, sigma) = (fit.room.focal_px / FOCAL - 1.0, fit.focal_sigma_px() / FOCAL);
                    assert!(error.abs() < (3.0 * sigma).max(0.01), "{seed}: {error} ± {sigma}");
                    let off = axes_apart(&fit.room.camera_from_room, &truth);
                    assert!(off < 1.0, "{seed}: {off}° off");
                }
                Err(problem) => assert!(matches!(problem, Problem::FocalOpen { .. }), "{problem}"),
            }
            let stated = Some(StatedFocal { focal_px: FOCAL, relative_sigma: 0.02 });
            let known = find(&all, CENTRE, DIAGONAL, stated).unwrap().fit;
            let off = axes_apart(&known.room.camera_from_room, &truth);
            assert!(off < 1.0, "{seed}: {off}° off with a stated focal length");
        }
    }
}

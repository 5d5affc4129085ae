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

//! Hard cases: vanishing lines that do not tell the focal length, grids seen badly.

use super::vanishing::{
    Edge, EdgeFit, Inner, RoomEdges, StatedFocal, edge_residual, fit_edges, focal_from_edges, vanishing_point,
};
use super::*;
use crate::camera::LENS;
use crate::vision::BoardView;
use nalgebra::{Point2, Point3, Rotation3};
use proptest::prelude::*;

const CENTRE: Point2<f64> = Point2::new(320.0, 240.0);
const DIAGONAL: f64 = 800.0;

/// Edges of a room seen with focal length 600 px by a camera turned by Euler angles (rad), with a little noise.
fn edges(turn: [f64; 3], centre: Point2<f64>, noise: f64, axes: &[usize]) -> RoomEdges {
    let camera_from_room = Rotation3::from_euler_angles(turn[0], turn[1], turn[2]);
    let project = |p: Vector3<f64>| {
        let c = camera_from_room * p;
        Point2::new(600.0 * c.x / c.z + centre.x, 600.0 * c.y / c.z + centre.y)
    };
    let mut all = RoomEdges::default();
    for &k in axes {
        for n in 0..8 {
            let s = n as f64 * 2.4;
            let middle = camera_from_room.inverse() * Vector3::new(s.cos() * 0.9, s.sin() * 0.7, 3.0);
            let half = Vector3::ith(k, 0.6);
            let shift = nalgebra::Vector2::new((5.0 * s).sin(), (7.0 * s).cos()) * noise;
            all.along[k].push([project(middle - half) + shift, project(middle + half) - shift]);
        }
    }
    all
}

#[test]
fn focal_length_comes_from_two_or_three_directions() {
    for axes in [&[0, 1, 2][..], &[0, 1], &[0, 2]] {
        let fit =
            focal_from_edges(&edges([0.9, 0.6, 0.5], CENTRE, 0.0, axes), CENTRE, DIAGONAL, 0.5).unwrap();
        assert!((fit.room.focal_px - 600.0).abs() < 0.01, "{axes:?}: {}", fit.room.focal_px);
    }
}

#[test]
fn noise_is_within_its_sigma() {
    let fit =
        focal_from_edges(&edges([0.9, 0.6, 0.5], CENTRE, 0.5, &[0, 1, 2]), CENTRE, DIAGONAL, 0.5).unwrap();
    let sigma = fit.focal_sigma_px();
    assert!(
        (fit.room.focal_px - 600.0).abs() < 4.0 * sigma && sigma < 30.0,
        "{} ± {sigma}",
        fit.room.focal_px
    );
}

#[test]
fn an_off_centre_principal_point_must_be_told() {
    let centre = Point2::new(360.0, 220.0);
    let edges = edges([0.9, 0.6, 0.5], centre, 0.0, &[0, 1]);
    let told = focal_from_edges(&edges, centre, DIAGONAL, 0.5).unwrap();
    assert!((told.room.focal_px - 600.0).abs() < 0.01);
    if let Ok(untold) = focal_from_edges(&edges, CENTRE, DIAGONAL, 0.5) {
        assert!((untold.room.focal_px - 600.0).abs() > 1.0);
    }
}

#[test]
fn a_fronto_parallel_view_is_refused() {
    let e = focal_from_edges(&edges([0.0; 3], CENTRE, 0.0, &[0, 1, 2]), CENTRE, DIAGONAL, 0.5).unwrap_err();
    assert!(matches!(e, Problem::FewVanishingPoints { finite: 1, marked: 3 }), "{e}");
}

#[test]
fn marks_that_cannot_be_orthogonal_are_refused_with_their_number() {
    // Two vanishing points on the same side of the principal point: f² < 0.
    let towards = |v: Point2<f64>| -> Vec<Edge> {
        [[100.0, 100.0], [500.0, 120.0], [300.0, 400.0]]
            .map(|p| {
                let p = Point2::from(p);
                [p, p + (v - p) * 0.2]
            })
            .to_vec()
    };
    let along = [towards(Point2::new(1200.0, 240.0)), towards(Point2::new(900.0, 300.0)), Vec::new()];
    let e = focal_from_edges(&RoomEdges { along }, CENTRE, DIAGONAL, 0.5).unwrap_err();
    // −(880, 0) · (580, 60)
    assert!(matches!(e, Problem::NegativeFocal { f2_px2 } if (f2_px2 + 510_400.0).abs() < 1.0), "{e}");
}

#[test]
fn an_outlier_is_resisted_and_named() {
    let mut marked = edges([0.9, 0.6, 0.5], CENTRE, 0.2, &[0, 1, 2]);
    marked.along[1][3][0].x += 25.0;
    let fit = focal_from_edges(&marked, CENTRE, DIAGONAL, 0.5).unwrap();
    assert!((fit.room.focal_px / 600.0 - 1.0).abs() < 0.05, "{}", fit.room.focal_px);
    assert_eq!((fit.worst.0, fit.worst.1), (1, 3));
}

#[test]
fn parallel_lines_meet_at_infinity() {
    let edges: Vec<Edge> =
        (0..4).map(|k| [Point2::new(50.0, 100.0 * k as f64), Point2::new(500.0, 100.0 * k as f64)]).collect();
    let v = vanishing_point(&edges, CENTRE, DIAGONAL).unwrap();
    assert!(v.x.abs() > 1.0 - 1e-9 && v.z.abs() < 1e-6, "{v}");
    assert!(matches!(vanishing_point(&edges[..1], CENTRE, DIAGONAL), Err(Problem::FewEdges { found: 1 })));
}

proptest! {
    #[test]
    fn edge_residuals_do_not_depend_on_the_scale_of_the_point(
        x in -900.0..900.0f64, y in -900.0..900.0f64, w in -2.0..2.0f64, s in 0.1..50.0f64,
    ) {
        let v = Vector3::new(x, y, w);
        let edge = [Point2::new(10.0, 20.0), Point2::new(110.0, 60.0)];
        let (a, b) = (edge_residual(&v, &edge), edge_residual(&(v * s), &edge));
        prop_assert!((a - b).abs() < 1e-6 * (1.0 + a.abs()));
    }

    #[test]
    fn the_pose_of_a_grid_is_found(
        heading in -3.0..3.0f64, height in 0.4..1.5f64, away in 0.3..1.5f64,
    ) {
        let settings = config::Calibrate::default();
        let from = Vector3::new(away * heading.sin(), height, away * heading.cos());
        let z = -from.normalize();
        let x = z.cross(&Vector3::y()).normalize();
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]));
        let camera = Camera {
            intrinsics: Intrinsics::pinhole(640, 480, 600.0),
            world_from_camera: Isometry3::from_parts(Translation3::from(from), turn),
        };
        let board = board::corner_positions(&settings);
        let see = |p: &Point2<f64>| camera.project(&(world_from_grid() * Point3::new(p.x, p.y, 0.0))).unwrap();
        let boards = [BoardView { pixels: board.iter().map(see).collect(), board }];
        let view = pose::View {
            intrinsics: &camera.intrinsics,
            lens_covariance: &LensCovariance::zeros(),
            boards: &boards,
            corner_sigma_px: 0.1,
            edges: None,
        };
        let posed = pose::fit(&view).unwrap().posed;
        prop_assert!((posed.camera.centre().coords - from).norm() < 1e-6);
        prop_assert!(posed.rms_px < 1e-6);
    }
}

/// A rendered grid: box-filtered, with its disc.
pub(super) fn picture(camera: &Camera, disc: bool, hidden: bool) -> Image<u8> {
    let ground = |x: f64, y: f64| -> f64 {
        let ray = camera.ray(&Point2::new(x, y));
        let p = ray.origin + ray.direction.into_inner() * (-ray.origin.y / ray.direction.y);
        let (u, v) = (p.x / 0.06, -p.z / 0.06);
        if hidden && u > 1.5 && v > 0.5 {
            return 90.0;
        }
        let (inside, margin) = (u.abs() < 4.0 && v.abs() < 3.0, u.abs() < 4.5 && v.abs() < 3.5);
        if inside {
            return if (u.floor() + v.floor()) as i64 % 2 == 0 { 20.0 } else { 220.0 };
        }
        if disc && (u + 4.25).hypot(v + 3.25) < 0.15 {
            return 20.0;
        }
        if margin { 220.0 } else { 120.0 }
    };
    Image::from_fn(640, 480, |x, y| {
        let steps = [0.125, 0.375, 0.625, 0.875];
        let sum: f64 = steps.iter().flat_map(|a| steps.map(|b| ground(x as f64 + a, y as f64 + b))).sum();
        (sum / 16.0).round() as u8
    })
}

pub(super) fn above(from: [f64; 3]) -> Camera {
    let from = Vector3::from(from);
    let z = -from.normalize();
    let x = z.cross(&Vector3::y()).normalize();
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]));
    Camera {
        intrinsics: Intrinsics::pinhole(640, 480, 600.0),
        world_from_camera: Isometry3::from_parts(Translation3::from(from), turn),
    }
}

#[test]
fn the_disc_tells_the_grid_from_itself_turned() {
    let settings = config::Calibrate::default();
    for from in [[0.5, 0.8, 0.6], [-0.5, 0.8, -0.6]] {
        let camera = above(from);
        let posed = grid_pose(&picture(&camera, true, false), &camera.intrinsics, &settings).unwrap();
        let off = (posed.camera.centre() - camera.centre()).norm();
        assert!(off < 0.005 * camera.centre().coords.norm(), "{off}");
        assert!(!posed.is_ambiguous());
    }
}

#[test]
fn a_grid_that_does_not_show_its_disc_is_refused() {
    let (settings, camera) = (config::Calibrate::default(), above([0.5, 0.8, 0.6]));
    for hidden in [false, true] {
        let e = grid_pose(&picture(&camera, false, hidden), &camera.intrinsics, &settings).unwrap_err();
        assert!(matches!(e, Problem::DiscUnclear { .. }), "{e}");
    }
}

/// The picture of a grid with a disc of so many squares over a place on it, in squares, and where that is and how large, px.
fn covered(camera: &Camera, [u, v]: [f64; 2], radius: f64) -> (Image<u8>, Point2<f64>, f64) {
    let whole = picture(camera, true, false);
    let see = |u: f64, v: f64| camera.project(&Point3::new(0.06 * u, 0.0, -0.06 * v)).unwrap();
    let (middle, reach) = (see(u, v), (see(u + radius, v) - see(u, v)).norm());
    let is_hidden =
        |x: usize, y: usize| (Point2::new(x as f64 + 0.5, y as f64 + 0.5) - middle).norm() < reach;
    let image = Image::from_fn(640, 480, |x, y| if is_hidden(x, y) { 140 } else { *whole.at(x, y) });
    (image, middle, reach)
}

#[test]
fn a_grid_partly_hidden_gives_the_corners_that_are_seen() {
    let settings = config::Calibrate::default();
    let all = board::corner_positions(&settings);
    for from in [[0.5, 0.8, 0.6], [-0.4, 0.7, -0.6], [0.1, 0.9, -0.3]] {
        let camera = above(from);
        for (place, radius) in [([3.0, 2.0], 1.2), ([0.0, 0.0], 1.2), ([-1.0, 2.5], 1.4), ([3.5, 0.0], 2.2)] {
            let (image, middle, reach) = covered(&camera, place, radius);
            let seen = |at: &Point2<f64>| {
                camera.project(&(world_from_grid() * Point3::new(at.x, at.y, 0.0))).unwrap()
            };
            let view = board::find_oriented(&image, &settings).unwrap();
            let far = |at: &&Point2<f64>| (seen(at) - middle).norm() > reach * (1.0 + 0.8 / radius);
            for at in all.iter().filter(far) {
                assert!(view.board.iter().any(|b| (b - at).norm() < 1e-9), "{from:?} {place:?}: no {at}");
            }
            for (at, pixel) in view.board.iter().zip(&view.pixels) {
                let there = seen(at);
                assert!((there - pixel).norm() < 0.3, "{from:?} {place:?}: {pixel}, is at {there}");
                assert!((pixel - middle).norm() > reach, "{from:?} {place:?}: {pixel} is hidden");
            }
        }
    }
    let camera = above([0.5, 0.8, 0.6]);
    let (image, ..) = covered(&camera, [3.0, 2.0], 1.2);
    let posed = grid_pose(&image, &camera.intrinsics, &settings).unwrap();
    let off = (posed.camera.centre() - camera.centre()).norm();
    assert!(off < 0.005 * camera.centre().coords.norm(), "{off}");
    // With its disc hidden it could be turned.
    let (image, ..) = covered(&camera, [-4.0, -3.0], 1.5);
    let refused = board::find_oriented(&image, &settings);
    assert!(matches!(refused, Err(Problem::DiscUnclear { .. })), "{refused:?}");
}

#[test]
fn lines_origin_and_scale_alone_give_the_pose() {
    use crate::annotations::{Axis, Scale, VanishingLines};
    let camera = above([1.5, 1.2, 2.0]);
    let see = |x: f64, y: f64, z: f64| {
        let p = camera.project(&(world_from_grid() * Point3::new(x, y, z))).unwrap();
        [p.x, p.y]
    };
    let edge = |from: [f64; 3], k: usize| {
        let mut to = from;
        to[k] += 0.5;
        let (a, b) = (see(from[0], from[1], from[2]), see(to[0], to[1], to[2]));
        [a[0], a[1], b[0], b[1]]
    };
    let starts = [[-0.4, -0.3, 0.0], [0.2, 0.1, 0.0], [0.0, -0.5, 0.3], [-0.2, 0.3, 0.2]];
    let lines = |k: usize| starts.map(|s| edge(s, k)).to_vec();
    let (from, to) = (see(0.3, -0.2, 0.0), see(0.3, -0.2, 0.4));
    let lines = VanishingLines {
        image: "plate.jpg".into(),
        x: lines(0),
        y: lines(1),
        z: lines(2),
        origin: Some(see(0.0, 0.0, 0.0)),
        scale: Some(Scale { from, to, axis: Axis::Z, length_m: 0.4 }),
    };
    let settings = config::Calibrate { pose: config::PoseSource::VanishingLines, ..Default::default() };
    let mut evidence = Evidence {
        width_px: 640,
        height_px: 480,
        grids: &[],
        plate_grids: &[],
        stated_focal_px: None,
        lines: Some(&lines),
        plate: None,
    };
    let found = solve(&evidence, &settings).unwrap();
    let plate = &found.plate.camera;
    assert!((plate.intrinsics.focal_px[0] - 600.0).abs() < 1e-2);
    assert!((plate.centre() - camera.centre()).norm() < 1e-4, "{}", plate.centre());
    assert!(plate.world_from_camera.rotation.angle_to(&camera.world_from_camera.rotation) < 1e-4);

    let without = VanishingLines { scale: None, ..lines.clone() };
    evidence.lines = Some(&without);
    assert!(matches!(solve(&evidence, &settings), Err(Problem::NoOriginOrScale)));
    evidence.lines = None;
    assert!(matches!(solve(&evidence, &settings), Err(Problem::NoFocal)));
}

/// Marks of a room seen by [`above`], each end off by normal noise of a standard deviation, px.
fn noisy_marks(camera: &Camera, sigma: f64, seed: u64) -> crate::annotations::VanishingLines {
    use crate::annotations::{Axis, Scale, VanishingLines};
    use rand::{Rng, SeedableRng, rngs::SmallRng};
    let random = std::cell::RefCell::new(SmallRng::seed_from_u64(seed));
    let normal = || (0..12).map(|_| random.borrow_mut().random_range(-0.5..0.5_f64)).sum::<f64>();
    let see = |p: Vector3<f64>| {
        let p = camera.project(&(world_from_grid() * Point3::from(p))).unwrap();
        [p.x + sigma * normal(), p.y + sigma * normal()]
    };
    let starts = [
        [-0.4, -0.3, 0.0],
        [0.2, 0.1, 0.0],
        [0.0, -0.5, 0.3],
        [-0.2, 0.3, 0.2],
        [0.4, -0.2, 0.1],
        [-0.5, 0.0, 0.4],
        [0.1, 0.4, 0.05],
        [-0.1, -0.1, 0.35],
    ];
    let lines = |k: usize| {
        let line = |s: &[f64; 3]| {
            let (a, b) = (see(Vector3::from(*s)), see(Vector3::from(*s) + Vector3::ith(k, 0.5)));
            [a[0], a[1], b[0], b[1]]
        };
        starts.iter().map(line).collect()
    };
    let (from, to) = (see(Vector3::new(0.3, -0.2, 0.0)), see(Vector3::new(0.3, -0.2, 0.4)));
    VanishingLines {
        image: "plate.jpg".into(),
        x: lines(0),
        y: lines(1),
        z: lines(2),
        origin: Some(see(Vector3::zeros())),
        scale: Some(Scale { from, to, axis: Axis::Z, length_m: 0.4 }),
    }
}

/// 100 draws of marks with 0.5 px noise: no bias, and squared errors over what the covariance says as χ² has them.
#[test]
fn cameras_from_noisy_lines_are_unbiased_and_as_uncertain_as_they_say() {
    const DRAWS: u64 = 100;
    let camera = above([1.5, 1.2, 2.0]);
    let settings = config::Calibrate { pose: config::PoseSource::VanishingLines, ..Default::default() };
    // Of the focal length, the centre, the turn: errors over deviations, their squares over degrees of freedom.
    let (mut off, mut squares) = ([0.0; 7], [0.0; 3]);
    for seed in 0..DRAWS {
        let lines = noisy_marks(&camera, 0.5, seed);
        let evidence = Evidence {
            width_px: 640,
            height_px: 480,
            grids: &[],
            plate_grids: &[],
            stated_focal_px: None,
            lines: Some(&lines),
            plate: None,
        };
        let found = solve(&evidence, &settings).unwrap().plate;
        let covariance = found.covariance.unwrap();
        let pose = &found.camera.world_from_camera;
        let shift = pose.translation.vector - camera.world_from_camera.translation.vector;
        let turn = (pose.rotation * camera.world_from_camera.rotation.inverse()).scaled_axis();
        let focal = found.camera.intrinsics.focal_px[0] - 600.0;
        let errors = [focal, shift.x, shift.y, shift.z, turn.x, turn.y, turn.z];
        let sigmas = [0, 9, 10, 11, 12, 13, 14].map(|k| covariance.sigma(k));
        (0..7).for_each(|k| off[k] += errors[k] / sigmas[k] / DRAWS as f64);
        squares[0] += (focal / sigmas[0]).powi(2) / DRAWS as f64;
        for (part, (at, error)) in [(LENS, shift), (LENS + 3, turn)].into_iter().enumerate() {
            let own = covariance.0.fixed_view::<3, 3>(at, at).clone_owned();
            let inverse = own.try_inverse().unwrap();
            squares[part + 1] += (error.transpose() * inverse * error)[0] / 3.0 / DRAWS as f64;
        }
    }
    // Three standard errors of a mean of 100.
    assert!(off.iter().all(|z| z.abs() < 0.3), "biased: {off:?}");
    assert!(squares.iter().all(|s| (0.8..1.2).contains(&s.sqrt())), "{squares:?}");
}

#[test]
fn three_vanishing_points_tell_the_principal_point() {
    let off = Point2::new(352.0, 219.0);
    let solve = Inner { principal_point: true, distortion: false };
    let marked = edges([0.9, 0.6, 0.5], off, 0.3, &[0, 1, 2]);
    let fit = fit_edges(&marked, CENTRE, DIAGONAL, 0.5, None, solve).unwrap();
    let miss = (fit.centre - off).norm();
    assert!(miss < 3.0 * fit.centre_sigma_px() && miss < 16.0, "{} ± {}", fit.centre, fit.centre_sigma_px());
    assert!((fit.room.focal_px / 600.0 - 1.0).abs() < 0.02, "{}", fit.room.focal_px);
    // Two leave it open.
    let two = edges([0.9, 0.6, 0.5], off, 0.3, &[0, 1]);
    let refused = fit_edges(&two, CENTRE, DIAGONAL, 0.5, None, solve);
    let open =
        matches!(refused, Err(Problem::CentreOpen { .. } | Problem::FocalOpen { .. } | Problem::Fit(_)));
    assert!(open, "{refused:?}");
}

#[test]
fn plumb_lines_tell_distortion() {
    let lens = Intrinsics { distortion: [-0.18, 0.0, 0.0, 0.0, 0.0], ..Intrinsics::pinhole(640, 480, 600.0) };
    let mut marked = edges([0.9, 0.6, 0.5], CENTRE, 0.1, &[0, 1, 2]);
    for p in marked.along.iter_mut().flatten().flatten() {
        let [x, y] = lens.distort([(p.x - CENTRE.x) / 600.0, (p.y - CENTRE.y) / 600.0]);
        *p = Point2::new(600.0 * x + CENTRE.x, 600.0 * y + CENTRE.y);
    }
    let plumb = Inner { principal_point: false, distortion: true };
    let fit = fit_edges(&marked, CENTRE, DIAGONAL, 0.5, None, plumb).unwrap();
    assert!((fit.k1 + 0.18).abs() < (3.0 * fit.k1_sigma()).min(0.05), "{} ± {}", fit.k1, fit.k1_sigma());
    let without = focal_from_edges(&marked, CENTRE, DIAGONAL, 0.5).unwrap();
    let off = |fit: &EdgeFit| (fit.room.focal_px / 600.0 - 1.0).abs();
    assert!(off(&fit) < 0.01 && off(&without) > 2.0 * off(&fit), "{} {}", off(&fit), off(&without));
}

#[test]
fn a_stated_focal_length_counts_by_its_accuracy() {
    let marked = edges([0.9, 0.6, 0.5], CENTRE, 0.5, &[0, 1, 2]);
    let with = |relative_sigma| {
        let stated = StatedFocal { focal_px: 660.0, relative_sigma };
        fit_edges(&marked, CENTRE, DIAGONAL, 0.5, Some(stated), Inner::default()).unwrap()
    };
    let alone = focal_from_edges(&marked, CENTRE, DIAGONAL, 0.5).unwrap().room.focal_px;
    let (sure, unsure) = (with(1e-4).room.focal_px, with(10.0).room.focal_px);
    assert!((sure / 660.0 - 1.0).abs() < 1e-3, "{sure}");
    assert!((unsure / alone - 1.0).abs() < 1e-3, "{unsure} {alone}");
    let weighed = with(0.02).room.focal_px;
    assert!(alone < weighed && weighed < 660.0, "{weighed}");
}

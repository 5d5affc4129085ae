//! Lenses from views of a board: accuracy as stated, poses that tell nothing, and hard photographs of the grid.

use super::bundle::{FreeLens, first_focal_px, fit};
use super::tests::{above, picture};
use super::*;
use crate::camera::{LENS, LensCovariance};
use crate::vision::BoardView;
use nalgebra::{Point2, Point3};
use rand::{Rng, SeedableRng, rngs::SmallRng};

fn lens() -> Intrinsics {
    Intrinsics {
        focal_px: [600.0, 600.0],
        principal_point_px: [328.0, 236.0],
        distortion: [-0.2, 0.06, 0.0, 0.0, 0.0],
        ..Intrinsics::pinhole(640, 480, 600.0)
    }
}

/// Boards turned (rad) and placed (m, camera frame), each corner off by normal noise.
fn views(poses: &[([f64; 3], [f64; 3])], sigma: f64, seed: u64) -> Vec<BoardView> {
    let mut random = SmallRng::seed_from_u64(seed);
    let mut normal = || (0..12).map(|_| random.random_range(-0.5..0.5_f64)).sum::<f64>();
    let board = board::corner_positions(&config::Calibrate::default());
    let mut view = |(turn, at): &([f64; 3], [f64; 3])| {
        let camera_from_board = Isometry3::new(Vector3::from(*at), Vector3::from(*turn));
        let mut see = |p: &Point2<f64>| {
            let seen = lens().project(&(camera_from_board * Point3::new(p.x, p.y, 0.0))).unwrap();
            Point2::new(seen.x + sigma * normal(), seen.y + sigma * normal())
        };
        BoardView { pixels: board.iter().map(&mut see).collect(), board: board.clone() }
    };
    poses.iter().map(&mut view).collect()
}

pub(super) const TILTED: [([f64; 3], [f64; 3]); 8] = [
    ([3.0, 0.1, 0.2], [-0.1, 0.05, 0.7]),
    ([2.5, 0.3, 0.1], [0.1, 0.0, 0.8]),
    ([3.0, 0.2, 1.2], [0.0, 0.1, 0.6]),
    ([2.6, -0.4, -0.5], [-0.15, -0.1, 0.9]),
    ([2.9, 0.0, -0.9], [0.15, 0.1, 0.7]),
    ([2.4, 0.2, 0.0], [0.0, -0.1, 0.6]),
    ([2.8, 0.8, 0.3], [0.1, -0.15, 0.8]),
    ([3.1, -0.6, 0.7], [-0.1, 0.1, 0.65]),
];

#[test]
fn lenses_are_unbiased_and_as_uncertain_as_they_say() {
    const DRAWS: u64 = 100;
    let free = FreeLens { aspect: false, radial: [true, true, false], tangential: false, ..FreeLens::ALL };
    let truth = lens().parameters();
    let parts = [0, 2, 3, 4, 5];
    let (mut off, mut squares, mut rms_px) = ([0.0; 5], 0.0, 0.0);
    for seed in 0..DRAWS {
        let views = views(&TILTED, 0.2, seed);
        let start = first_focal_px(&views, 640, 480).unwrap();
        assert!((start / 600.0 - 1.0).abs() < 0.1, "{start}");
        let found = fit(&views, &Intrinsics::pinhole(640, 480, start), free).unwrap();
        rms_px += found.rms_px / DRAWS as f64;
        let errors = parts.map(|k| found.intrinsics.parameters()[k] - truth[k]);
        parts.iter().enumerate().for_each(|(i, k)| off[i] += errors[i] / found.sigma(*k) / DRAWS as f64);
        let own = nalgebra::SMatrix::<f64, 5, 5>::from_fn(|i, j| found.covariance[(parts[i], parts[j])]);
        let errors = nalgebra::SVector::<f64, 5>::from(errors);
        squares += (errors.transpose() * own.try_inverse().unwrap() * errors)[0] / 5.0 / DRAWS as f64;
    }
    assert!(off.iter().all(|z| z.abs() < 0.35), "biased: {off:?}");
    assert!((0.8..1.2).contains(&squares.sqrt()), "{squares}");
    // Of 8 × 35 corners with two coordinates each; 53 numbers are fitted.
    let expected = 0.2 * 2f64.sqrt() * (1.0 - 53.0 / 560.0_f64).sqrt();
    assert!((rms_px / expected - 1.0).abs() < 0.03, "{rms_px} {expected}");
}

#[test]
fn nothing_but_what_is_free_moves() {
    let views = views(&TILTED, 0.2, 1);
    let free =
        FreeLens { aspect: false, principal_point: false, radial: [true, false, false], tangential: false };
    let found = fit(&views, &Intrinsics::pinhole(640, 480, 620.0), free).unwrap();
    assert_eq!(found.intrinsics.focal_px[0], found.intrinsics.focal_px[1]);
    assert_eq!(found.intrinsics.principal_point_px, [320.0, 240.0]);
    assert_eq!(found.intrinsics.distortion[1..], [0.0; 4]);
    for k in [2, 3, 5, 6, 7, 8] {
        assert_eq!(found.sigma(k), 0.0, "parameter {k}");
    }
    assert_eq!(found.covariance[(0, 1)], found.covariance[(0, 0)]);
}

#[test]
fn boards_that_all_face_the_camera_do_not_tell_its_lens() {
    let facing: Vec<_> = TILTED
        .iter()
        .map(|(turn, at)| ([std::f64::consts::PI, 0.0, 0.0], [at[0], at[1] + 0.01 * turn[2], at[2]]))
        .collect();
    let refused = lens::fit(&views(&facing, 0.2, 3), 640, 480, Some(600.0));
    assert!(
        matches!(refused, Err(Problem::PosesAlike { condition, .. }) if condition > 80.0),
        "{:?}",
        refused.map(|l| (l.fit.condition, l.focal_sigma_px()))
    );
    let told = lens::fit(&views(&TILTED, 0.2, 3), 640, 480, None).unwrap();
    assert!(told.fit.condition < 40.0, "{}", told.fit.condition);
}

/// Means over a square around each pixel.
fn blurred(image: &Image<u8>, reach: usize) -> Image<u8> {
    Image::from_fn(image.width(), image.height(), |x, y| {
        let (mut sum, mut count) = (0_u32, 0);
        for v in y.saturating_sub(reach)..(y + reach + 1).min(image.height()) {
            for u in x.saturating_sub(reach)..(x + reach + 1).min(image.width()) {
                sum += u32::from(*image.at(u, v));
                count += 1;
            }
        }
        (sum / count) as u8
    })
}

#[test]
fn a_grid_blurred_or_at_a_grazing_angle_gives_its_pose_or_is_refused() {
    let settings = config::Calibrate::default();
    let off = |camera: &Camera, image: &Image<u8>| {
        let posed = grid_pose(image, &camera.intrinsics, &settings)?;
        Ok::<_, Problem>((posed.camera.centre() - camera.centre()).norm() / camera.centre().coords.norm())
    };
    let camera = above([0.3, 0.55, 0.4]);
    let sharp = picture(&camera, true, false);
    assert!(off(&camera, &blurred(&sharp, 2)).unwrap() < 0.005);
    let lost = off(&camera, &blurred(&sharp, 25));
    assert!(matches!(lost, Err(Problem::GridNotFound { .. })), "{lost:?}");
    let grazing = above([0.5, 0.16, 0.35]);
    match off(&grazing, &picture(&grazing, true, false)) {
        Ok(off) => assert!(off < 0.01, "{off}"),
        Err(e) => assert!(matches!(e, Problem::GridNotFound { .. } | Problem::DiscUnclear { .. }), "{e}"),
    }
}

#[test]
fn a_small_far_grid_says_that_its_tilt_is_undecided() {
    let far = views(&[([2.75, 0.0, 0.0], [0.0, 0.0, 9.0])], 0.5, 4);
    let intrinsics = lens();
    let view = pose::View {
        intrinsics: &intrinsics,
        lens_covariance: &LensCovariance::zeros(),
        boards: &far,
        corner_sigma_px: 0.0,
        edges: None,
    };
    let posed = pose::fit(&view).unwrap().posed;
    assert!(posed.is_ambiguous(), "{} {:?}", posed.rms_px, posed.rival_rms_px);
    let near = views(&TILTED[1..2], 0.2, 4);
    let posed = pose::fit(&pose::View { boards: &near, ..view }).unwrap().posed;
    assert!(!posed.is_ambiguous(), "{} {:?}", posed.rms_px, posed.rival_rms_px);
}

#[test]
fn the_pose_follows_a_lens_that_is_uncertain() {
    let boards = views(&TILTED[1..2], 0.05, 5);
    let intrinsics = lens();
    let with = |focal_sigma: f64| {
        let covariance = crate::camera::focal_alone(focal_sigma);
        let view = pose::View {
            intrinsics: &intrinsics,
            lens_covariance: &covariance,
            boards: &boards,
            corner_sigma_px: 0.0,
            edges: None,
        };
        pose::fit(&view).unwrap().posed
    };
    let (sure, unsure) = (with(0.0), with(6.0));
    let covariance = unsure.covariance.clone().unwrap();
    assert!((covariance.sigma(0) - 6.0).abs() < 1e-9 && covariance.sigma(4) == 0.0);
    // A focal length 1 % longer has the board 1 % further away.
    let distance = unsure.camera.centre().coords.norm();
    let along = covariance.position_sigma_m().map(|s| s * s).iter().sum::<f64>().sqrt();
    assert!((along / (0.01 * distance) - 1.0).abs() < 0.15, "{along} {distance}");
    assert!(sure.covariance.unwrap().position_sigma_m()[1] < 0.2 * along);
    // Yet the board itself is seen where it is seen.
    let on_board = world_from_grid() * Point3::new(0.1, 0.05, 0.0);
    let sigma = covariance.pixel_sigma_px(&unsure.camera, &on_board).unwrap();
    let beyond = world_from_grid() * Point3::new(0.1, 0.05, 0.4);
    assert!(
        sigma < 0.5 && covariance.pixel_sigma_px(&unsure.camera, &beyond).unwrap() > 2.0 * sigma,
        "{sigma}"
    );
    assert_eq!(LENS, 9);
}

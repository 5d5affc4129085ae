//! Cameras and primitives in one solution: accuracy as stated, what primitives tell that lines do not, marks that are wrong.

use super::bundle::{self, FreeLens};
use super::joint::{Scene, solve_from};
use super::solve::{Evidence, Solution, Used};
use super::tests::above;
use super::*;
use crate::annotations::{Annotations, Axis, Mark, Primitive, Scale, VanishingLines};
use crate::camera::{LENS, POSE};
use crate::model::{Fitter, Views};
use crate::vision::BoardView;
use nalgebra::{DMatrix, DVector, Point2, Point3, Rotation3};
use rand::{Rng, SeedableRng, rngs::SmallRng};
use std::path::Path;

const GROUND: f64 = -0.002;

/// Normal noise.
struct Noise(SmallRng);

impl Noise {
    fn new(seed: u64) -> Self {
        Self(SmallRng::seed_from_u64(seed))
    }

    fn around(&mut self, p: Point2<f64>, sigma: f64) -> Point2<f64> {
        let mut normal = || (0..12).map(|_| self.0.random_range(-0.5..0.5_f64)).sum::<f64>();
        Point2::new(p.x + sigma * normal(), p.y + sigma * normal())
    }
}

/// A box on the ground: name, what stands in its table, middle of the bottom (x, z), turn, size.
type Solid = (&'static str, &'static str, [f64; 2], f64, [f64; 3]);

const SOLIDS: [Solid; 3] = [
    ("crate", "yaw = \"free\"", [0.5, -0.4], 0.3, [0.5, 0.4, 0.3]),
    ("shelf", "parent = \"crate\"\nattach = \"base\"", [-0.6, -0.7], 0.3, [0.3, 0.8, 0.4]),
    ("twin", "yaw = \"free\"\nsame_size = \"crate\"", [-0.4, 0.4], -0.5, [0.5, 0.4, 0.3]),
];

/// Solids with all their corners marked in each photograph.
fn marked(solids: &[Solid], cameras: &[(&str, &Camera)], sigma: f64, noise: &mut Noise) -> Vec<Primitive> {
    let mut all = Vec::new();
    for (name, table, [x, z], turn, size) in solids {
        let text = format!("[[primitive]]\nname = \"{name}\"\nkind = \"box\"\n{table}\n");
        let mut read: Annotations = crate::config::parse(&text, Path::new("annotations.toml")).unwrap();
        let mut primitive = read.primitive.remove(0);
        let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), *turn);
        for (image, camera) in cameras {
            for corner in ["---", "+--", "-+-", "++-", "--+", "+-+", "-++", "+++"] {
                let half = |k: usize| (if corner.as_bytes()[k] == b'+' { 0.5 } else { -0.5 }) * size[k];
                let at = turn * Vector3::new(half(0), half(1) + 0.5 * size[1], half(2));
                let seen = camera.project(&(Point3::new(*x, GROUND, *z) + at)).unwrap();
                let at = noise.around(seen, sigma);
                primitive.marks.push(Mark {
                    corner: corner.into(),
                    image: image.to_string(),
                    at: [at.x, at.y],
                    sigma_px: None,
                    reflection: false,
                });
            }
        }
        all.push(primitive);
    }
    all
}

/// Lens by eight boards and pose by one, their corners off by 0.2 px.
fn by_grid(plate: &Camera, noise: &mut Noise) -> Solution {
    let board = board::corner_positions(&config::Calibrate::default());
    let mut view = |camera_from_board: Isometry3<f64>| {
        let mut see = |p: &Point2<f64>| {
            let seen = plate.intrinsics.project(&(camera_from_board * Point3::new(p.x, p.y, 0.0))).unwrap();
            noise.around(seen, 0.2)
        };
        BoardView { pixels: board.iter().map(&mut see).collect(), board: board.clone() }
    };
    let views: Vec<_> = super::bundle_tests::TILTED
        .iter()
        .map(|(turn, at)| view(Isometry3::new(Vector3::from(*at), Vector3::from(*turn))))
        .collect();
    let boards = vec![view(plate.world_from_camera.inverse() * world_from_grid())];
    let free = FreeLens { aspect: false, radial: [false; 3], tangential: false, ..FreeLens::ALL };
    let fit = bundle::fit(&views, &Intrinsics::pinhole(640, 480, 610.0), free).unwrap();
    let seen = pose::View {
        intrinsics: &fit.intrinsics,
        lens_covariance: &fit.covariance,
        boards: &boards,
        corner_sigma_px: 0.2,
        edges: None,
    };
    let posed = pose::fit(&seen).unwrap().posed;
    let lens = lens::Lens { fit, dropped: Vec::new(), outliers: Vec::new() };
    Solution {
        plate: posed,
        focal_source: "grid",
        focal_sigma_px: Some(lens.focal_sigma_px()),
        lens: Some(lens),
        edges: None,
        edge_rms_px: None,
        warnings: Vec::new(),
        used: Used { boards, ..Used::default() },
    }
}

fn no_evidence() -> Evidence<'static> {
    Evidence {
        width_px: 640,
        height_px: 480,
        grids: &[],
        plate_grids: &[],
        stated_focal_px: None,
        lines: None,
        plate: None,
    }
}

fn settings() -> config::Calibrate {
    config::Calibrate { pose: config::PoseSource::Grid, ..config::Calibrate::default() }
}

/// Errors of lens and poses in the order of their covariance.
fn errors(found: &[&Camera], truth: &[&Camera]) -> DVector<f64> {
    let lens = |c: &Camera| DVector::from_column_slice(&c.intrinsics.parameters());
    let mut all = (lens(found[0]) - lens(truth[0])).as_slice().to_vec();
    for (found, truth) in found.iter().zip(truth) {
        let (a, b) = (&found.world_from_camera, &truth.world_from_camera);
        all.extend_from_slice((a.translation.vector - b.translation.vector).as_slice());
        all.extend_from_slice((a.rotation * b.rotation.inverse()).scaled_axis().as_slice());
    }
    DVector::from_vec(all)
}

fn scene<'a>(
    primitives: &'a [Primitive],
    settings: &'a config::Model,
    here: &'a [String],
    others: &'a [String],
) -> Scene<'a> {
    Scene { primitives, ground_y: GROUND, settings, here, others }
}

/// Squared error over what a covariance says, per degree of freedom, of some of its parameters.
fn chi2(errors: &DVector<f64>, covariance: &DMatrix<f64>, of: &[usize]) -> f64 {
    let n = of.len();
    let own = DMatrix::from_fn(n, n, |i, j| covariance[(of[i], of[j])]);
    let errors = DVector::from_fn(n, |i, _| errors[of[i]]);
    errors.dot(&own.cholesky().unwrap().solve(&errors)) / n as f64
}

/// 100 draws: a plate with a board, a photograph without one, three boxes marked in both with 1 px of noise.
#[test]
fn cameras_and_boxes_are_unbiased_and_as_uncertain_as_they_say() {
    const DRAWS: u64 = 100;
    let (plate, other) = (above([1.4, 1.3, 1.9]), above([-1.6, 1.2, 1.7]));
    let names = (["plate.jpg".to_string()], ["other.jpg".to_string()]);
    let model = config::Model::default();
    // Focal length and centre; the plate's pose; the other's; all together; sizes of the boxes.
    let parts: [Vec<usize>; 4] = [
        vec![0, 2, 3],
        (LENS..LENS + POSE).collect(),
        (LENS + POSE..LENS + 2 * POSE).collect(),
        [0, 2, 3].into_iter().chain(LENS..LENS + 2 * POSE).collect(),
    ];
    let (mut squares, mut off) = ([0.0; 5], vec![0.0; LENS + 2 * POSE]);
    let (mut alone, mut together) = (0.0, 0.0);
    for seed in 0..DRAWS {
        let mut noise = Noise::new(seed);
        let start = by_grid(&plate, &mut noise);
        let primitives = marked(&SOLIDS, &[("plate.jpg", &plate), ("other.jpg", &other)], 1.0, &mut noise);
        let scene = scene(&primitives, &model, &names.0, &names.1);
        let found = solve_from(&start, &no_evidence(), &settings(), &scene).unwrap();
        let cameras = [&found.solution.plate.camera, &found.others["other.jpg"].camera];
        let shared = found.shared.clone().unwrap();
        let errors = errors(&cameras, &[&plate, &other]);
        for (sum, part) in squares.iter_mut().zip(&parts) {
            *sum += chi2(&errors, &shared.covariance, part) / DRAWS as f64;
        }
        for &k in &parts[3] {
            off[k] += errors[k] / shared.covariance[(k, k)].sqrt() / DRAWS as f64;
        }
        alone += (start.plate.camera.centre() - plate.centre()).norm_squared();
        together += (cameras[0].centre() - plate.centre()).norm_squared();
        // The boxes, fitted as the stage `model` does, to cameras that are known so well.
        let cameras = BTreeMap::from(
            [("plate.jpg", cameras[0]), ("other.jpg", cameras[1])].map(|(n, c)| (n.to_string(), c.clone())),
        );
        let views = Views { cameras: &cameras, ball: None, ground_y: GROUND, rooms: &[] };
        let fitter = Fitter::new(&primitives, &views, &model).unwrap();
        let boxes = fitter.with_cameras_known_to(Some(&shared)).scene().unwrap();
        for (fitted, solid) in boxes.primitives.iter().zip(&SOLIDS).take(2) {
            for k in 0..3 {
                let z = (fitted.size_m[k] - solid.4[k]) / fitted.size_sigma_m[k];
                squares[4] += z * z / 6.0 / DRAWS as f64;
            }
            assert!(fitted.corner_sigma_m > fitted.size_sigma_m[0] / 2.0, "{fitted:?}");
        }
    }
    assert!(squares.iter().all(|s| (0.8..1.2).contains(&s.sqrt())), "{squares:?}");
    // Three standard errors of a mean of 100.
    assert!(off.iter().all(|z| z.abs() < 0.3), "biased: {off:?}");
    assert!(together < 0.9 * alone, "the boxes help to place the camera: {together} {alone}");
}

/// Two vanishing points nearly at infinity leave the focal length open; a box of known size tells it.
#[test]
fn a_box_tells_the_focal_length_that_lines_leave_open() {
    const DRAWS: u64 = 30;
    let plate = above([0.12, 0.35, 3.0]);
    let model = config::Model::default();
    let settings = config::Calibrate { pose: config::PoseSource::VanishingLines, ..Default::default() };
    let here = ["plate.jpg".to_string()];
    let cube: [Solid; 2] = [
        ("cube", "size_m = [0.5, 0.5, 0.5]", [0.5, -0.3], 0.0, [0.5; 3]),
        ("near", "size_m = [0.5, 0.5, 0.5]\nyaw = \"free\"", [-0.5, 0.8], 0.4, [0.5; 3]),
    ];
    let (mut squares, mut off, mut refused) = (0.0, 0.0, 0);
    for seed in 0..DRAWS {
        let mut noise = Noise::new(seed);
        let mut see = |p: Vector3<f64>| {
            let p = plate.project(&(world_from_grid() * Point3::from(p))).unwrap();
            let p = noise.around(p, 0.5);
            [p.x, p.y]
        };
        let mut line = |s: [f64; 3], k: usize| {
            let (a, b) = (see(Vector3::from(s)), see(Vector3::from(s) + Vector3::ith(k, 0.6)));
            [a[0], a[1], b[0], b[1]]
        };
        let starts = [[-0.6, -0.6, 0.0], [0.1, 0.2, 0.1], [-0.3, 0.3, 0.4], [0.2, -0.5, 0.3]];
        let [x, y, z] = [0, 1, 2].map(|k| starts.iter().map(|s| line(*s, k)).collect());
        let origin = Some(see(Vector3::zeros()));
        let (from, to) = (see(Vector3::new(0.3, -0.2, 0.0)), see(Vector3::new(0.3, -0.2, 0.5)));
        let scale = Some(Scale { from, to, axis: Axis::Z, length_m: 0.5 });
        let lines = VanishingLines { image: "plate.jpg".into(), x, y, z, origin, scale };
        let evidence = Evidence { lines: Some(&lines), ..no_evidence() };
        refused += usize::from(matches!(solve(&evidence, &settings), Err(Problem::FocalOpen { .. })));
        let primitives = marked(&cube, &[("plate.jpg", &plate)], 1.0, &mut noise);
        let scene = scene(&primitives, &model, &here, &[]);
        let found = joint::solve(&evidence, &settings, &scene).unwrap();
        let sigma = found.solution.focal_sigma_px.unwrap();
        let z = (found.solution.plate.camera.intrinsics.focal_px[0] - 600.0) / sigma;
        assert!(sigma < 0.05 * 600.0, "{sigma}");
        squares += z * z / DRAWS as f64;
        off += z / DRAWS as f64;
    }
    assert!(refused > DRAWS as usize * 2 / 3, "the lines alone are refused: {refused}");
    // Three standard errors of means of 30.
    assert!(off.abs() < 0.55 && (0.4..1.8).contains(&squares), "{off} {squares}");
}

#[test]
fn one_wrong_mark_is_resisted_and_named() {
    let (plate, other) = (above([1.4, 1.3, 1.9]), above([-1.6, 1.2, 1.7]));
    let names = (["plate.jpg".to_string()], ["other.jpg".to_string()]);
    let model = config::Model::default();
    let found = |wrong_px: f64| {
        let mut noise = Noise::new(3);
        let start = by_grid(&plate, &mut noise);
        let mut primitives =
            marked(&SOLIDS, &[("plate.jpg", &plate), ("other.jpg", &other)], 1.0, &mut noise);
        primitives[1].marks[6].at[0] += wrong_px;
        let scene = scene(&primitives, &model, &names.0, &names.1);
        solve_from(&start, &no_evidence(), &settings(), &scene).unwrap()
    };
    let (right, wrong) = (found(0.0), found(25.0));
    assert!(right.solution.warnings.is_empty(), "{:?}", right.solution.warnings);
    let [warning] = &wrong.solution.warnings[..] else { panic!("{:?}", wrong.solution.warnings) };
    assert!(warning.contains("the mark `-++` of `shelf` in plate.jpg is 2"), "{warning}");
    let shared = wrong.shared.unwrap();
    for (place, [a, b]) in [
        (0, [&right.solution.plate, &wrong.solution.plate]),
        (1, [&right.others["other.jpg"], &wrong.others["other.jpg"]]),
    ] {
        let moved = (a.camera.centre() - b.camera.centre()).norm();
        let sigma = shared.camera(place).position_sigma_m().into_iter().fold(0.0, f64::max);
        assert!(moved < sigma, "place {place} moved by {moved} m, {sigma}");
    }
}

#[test]
fn primitives_that_contradict_their_marks_take_no_part() {
    let plate = above([1.4, 1.3, 1.9]);
    let here = ["plate.jpg".to_string()];
    let model = config::Model::default();
    let mut noise = Noise::new(1);
    let start = by_grid(&plate, &mut noise);
    let mut turned = SOLIDS;
    // Said to be parallel.
    turned[1].3 += 0.7;
    let primitives = marked(&turned, &[("plate.jpg", &plate)], 1.0, &mut noise);
    let scene = scene(&primitives, &model, &here, &[]);
    let found = solve_from(&start, &no_evidence(), &settings(), &scene).unwrap();
    assert_eq!(found.solution.plate, start.plate);
    assert!(found.shared.is_none());
    let warning = found.solution.warnings.last().unwrap();
    assert!(
        warning.starts_with("the scene's primitives take no part in finding the cameras: their marks are"),
        "{warning}"
    );
}

#[test]
fn a_photograph_with_too_few_corners_gets_no_pose_and_is_named() {
    let (plate, other) = (above([1.4, 1.3, 1.9]), above([-1.6, 1.2, 1.7]));
    let names = (["plate.jpg".to_string()], ["other.jpg".to_string()]);
    let model = config::Model::default();
    let mut noise = Noise::new(2);
    let start = by_grid(&plate, &mut noise);
    let mut primitives = marked(&SOLIDS, &[("plate.jpg", &plate), ("other.jpg", &other)], 1.0, &mut noise);
    primitives.iter_mut().for_each(|p| p.marks.truncate(9));
    let scene = scene(&primitives, &model, &names.0, &names.1);
    let found = solve_from(&start, &no_evidence(), &settings(), &scene).unwrap();
    assert!(found.others.is_empty());
    assert!(
        found.solution.warnings[0].starts_with("other.jpg gets no pose: of its marks 3 are"),
        "{:?}",
        found.solution.warnings
    );
}

//! A synthetic room, marked directly and in the ball, and marks that cannot be trusted.

use super::*;
use crate::annotations::{Annotations, Mark, Primitive};
use crate::camera::{Camera, Intrinsics};
use crate::config;
use crate::error::Problem as _;
use crate::least_squares::{self, Loss};
use crate::probe::mirror_ball::reflected_ray;
use nalgebra::{DVector, Isometry3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use sight::Ball;
use std::collections::BTreeMap;
use std::path::Path;

const GROUND: f64 = -0.002;

/// A camera at `from` that looks at `to`, upright.
fn looking(from: [f64; 3], to: [f64; 3], focal_px: f64) -> Camera {
    let (from, to) = (Vector3::from(from), Vector3::from(to));
    let z = (to - from).normalize();
    let x = z.cross(&Vector3::y()).normalize();
    let rotation = Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
    let turn = UnitQuaternion::from_rotation_matrix(&rotation);
    Camera {
        intrinsics: Intrinsics::pinhole(640, 480, focal_px),
        world_from_camera: Isometry3::from_parts(Translation3::from(from), turn),
    }
}

fn cameras() -> BTreeMap<String, Camera> {
    let plate = looking([-1.0, 1.2, 1.8], [0.3, 0.2, -0.8], 500.0);
    let probe = looking([0.2, 0.6, 0.9], [0.6, 0.1, 0.0], 700.0);
    BTreeMap::from([("plate.jpg".into(), plate), ("probe.jpg".into(), probe)])
}

fn ball() -> Ball {
    Ball { centre: Point3::new(0.6, 0.098, 0.0), radius_m: 0.1 }
}

/// Where a point is seen in the ball.
fn reflection(camera: &Camera, ball: &Ball, point: &Point3<f64>) -> Point2<f64> {
    let start = camera.project(&ball.centre).unwrap();
    let residuals = |x: &DVector<f64>| {
        let ray = reflected_ray(camera, &ball.centre, ball.radius_m, &Point2::new(x[0], x[1]))?;
        let miss = (point - ray.origin).normalize() - ray.direction.into_inner();
        Some(DVector::from_column_slice(miss.as_slice()))
    };
    let names = ["x".to_string(), "y".to_string()];
    let fit = least_squares::minimise(&residuals, &names, &[start.x, start.y], Loss::Squares).unwrap();
    assert!(fit.rms < 1e-9, "the reflection of {point} is found");
    Point2::new(fit.parameters[0], fit.parameters[1])
}

/// The room: 5 × 2.6 × 4 m, turned by 25°, its floor's middle at (0.4, −0.3).
fn in_room(x: f64, y: f64, z: f64) -> Point3<f64> {
    let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), 25f64.to_radians());
    Point3::new(0.4, GROUND, -0.3) + turn * Vector3::new(x, y, z)
}

fn mark(corner: &str, point: Point3<f64>, noise: [f64; 2]) -> Mark {
    let camera = &cameras()["plate.jpg"];
    let p = camera.project(&point).unwrap();
    Mark {
        corner: corner.into(),
        image: "plate.jpg".into(),
        at: [p.x + noise[0], p.y + noise[1]],
        sigma_px: None,
        reflection: false,
    }
}

fn reflected(corner: &str, point: Point3<f64>, noise: [f64; 2]) -> Mark {
    let p = reflection(&cameras()["probe.jpg"], &ball(), &point);
    Mark {
        corner: corner.into(),
        image: "probe.jpg".into(),
        at: [p.x + noise[0], p.y + noise[1]],
        sigma_px: None,
        reflection: true,
    }
}

fn primitives(text: &str) -> Vec<Primitive> {
    crate::config::parse::<Annotations>(text, Path::new("annotations.toml")).unwrap().primitive
}

fn fitted(primitives: &[Primitive]) -> Result<Scene, Problem> {
    let cameras = cameras();
    let views = Views { cameras: &cameras, ball: Some(ball()), ground_y: GROUND, rooms: &[] };
    fit(primitives, &views, &config::Model::default())
}

const ROOM: &str = r#"
[[primitive]]
name = "room"
kind = "room"
yaw = "free"
[[primitive]]
name = "desk"
kind = "box"
parent = "room"
attach = "top"
[[primitive]]
name = "monitor"
kind = "box"
parent = "desk"
yaw = "free"
[[primitive]]
name = "window"
kind = "quad"
parent = "room"
attach = "front"
[[primitive]]
name = "rug"
kind = "polygon"
parent = "room"
"#;

fn marked(noise: &dyn Fn(usize) -> [f64; 2]) -> Vec<Primitive> {
    let mut all = primitives(ROOM);
    let room = |s: &str| {
        let sign = |k: usize| if s.as_bytes()[k] == b'+' { 1.0 } else { -1.0 };
        in_room(2.5 * sign(0), 1.3 * (sign(1) + 1.0), 2.0 * sign(2))
    };
    let mut n = 0;
    let mut next = || {
        n += 1;
        noise(n)
    };
    // The plate sees the back wall's ends, the ball what is behind the camera.
    all[0].marks = vec![
        mark("---", room("---"), next()),
        mark("+--", room("+--"), next()),
        mark("-+-", room("-+-"), next()),
    ];
    for s in ["--+", "+-+", "-++", "+++", "++-"] {
        all[0].marks.push(reflected(s, room(s), next()));
    }
    let desk = |x: f64, y: f64, z: f64| in_room(1.0 + 0.7 * x, 0.72 * y, -1.2 + 0.4 * z);
    for (s, x, y, z) in [
        ("--+", -1., 0., 1.),
        ("+-+", 1., 0., 1.),
        ("-++", -1., 1., 1.),
        ("+++", 1., 1., 1.),
        ("-+-", -1., 1., -1.),
    ] {
        all[1].marks.push(mark(s, desk(x, y, z), next()));
    }
    let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), 0.4);
    let monitor = |x: f64, y: f64, z: f64| {
        let p = turn * Vector3::new(0.25 * x, 0.4 * y, 0.1 * z);
        in_room(0.9 + p.x, 0.72 + p.y, -1.25 + p.z)
    };
    for (s, x, y, z) in [
        ("--+", -1., 0., 1.),
        ("+-+", 1., 0., 1.),
        ("-++", -1., 1., 1.),
        ("+++", 1., 1., 1.),
        ("-+-", -1., 1., -1.),
    ] {
        all[2].marks.push(mark(s, monitor(x, y, z), next()));
    }
    // On the wall at +z: seen from inside, its right is the room's −x.
    for (s, x, y) in [("--", 1.2, 0.9), ("+-", 0.2, 0.9), ("++", 0.2, 2.1), ("-+", 1.2, 2.1)] {
        all[3].marks.push(reflected(s, in_room(x, y, 2.0), next()));
    }
    for (k, x, z) in [("0", -0.5, -1.0), ("1", 0.3, -1.0), ("2", 0.4, 0.2), ("3", -0.6, 0.1)] {
        all[4].marks.push(mark(k, in_room(x, 0.0, z), next()));
    }
    all
}

#[test]
fn exact_marks_give_the_exact_room() {
    let scene = fitted(&marked(&|_| [0.0, 0.0])).unwrap();
    let sizes: Vec<f64> = scene.primitives.iter().flat_map(|p| p.size_m.clone()).collect();
    let truth = [5.0, 2.6, 4.0, 1.4, 0.72, 0.8, 0.5, 0.4, 0.2, 1.0, 1.2];
    for (size, truth) in sizes.iter().zip(truth) {
        assert!((size - truth).abs() < 1e-3, "{sizes:?}");
    }
    assert!(scene.rms_px < 1e-3, "{}", scene.rms_px);
    // Room 6, boxes 5 each, the window and the rug.
    assert_eq!(scene.faces.len(), 6 + 5 + 5 + 2);
}

#[test]
fn a_pixel_of_noise_costs_centimetres_and_sigma_says_so() {
    let scene = fitted(&marked(&|n| {
        let a = n as f64 * 2.399963;
        [1.2 * a.cos(), 1.2 * a.sin()]
    }))
    .unwrap();
    let truth = [5.0, 2.6, 4.0];
    let room = &scene.primitives[0];
    for ((size, sigma), truth) in room.size_m.iter().zip(&room.size_sigma_m).zip(truth) {
        let error = (size - truth).abs();
        assert!(error < 0.25 && error < 4.0 * sigma, "{size} ± {sigma}");
    }
}

#[test]
fn faces_show_their_fronts() {
    let scene = fitted(&marked(&|_| [0.0, 0.0])).unwrap();
    let middle =
        |f: &Face| f.vertices.iter().map(|v| v.coords).sum::<Vector3<f64>>() / f.vertices.len() as f64;
    let centre = in_room(0.0, 1.3, 0.0).coords;
    for f in
        scene.faces.iter().filter(|f| f.name.starts_with("room.") || f.name == "window" || f.name == "rug")
    {
        assert!((centre - middle(f)).dot(&f.normal()) > 0.0, "{} looks into the room", f.name);
    }
    let desk = in_room(1.0, 0.36, -1.2).coords;
    for f in scene.faces.iter().filter(|f| f.name.starts_with("desk.")) {
        assert!((middle(f) - desk).dot(&f.normal()) > 0.0, "{} looks out of the desk", f.name);
    }
    let find = |name: &str| scene.faces.iter().find(|f| f.name == name).unwrap();
    assert!(find("room.floor").normal().y > 0.999 && find("room.ceiling").normal().y < -0.999);
    assert!((find("window").area() - 1.2).abs() < 1e-2);
    let gap = (middle(find("window")) - middle(find("room.front"))).dot(&find("room.front").normal());
    assert!((gap - 0.002).abs() < 1e-6, "the window stands {gap} m before its wall");
}

#[test]
fn one_wrong_mark_hardly_counts_and_is_named() {
    let cameras = cameras();
    let views = Views { cameras: &cameras, ball: Some(ball()), ground_y: GROUND, rooms: &[] };
    let settings = config::Model { max_rms_px: 10.0, ..config::Model::default() };
    let noise = |n: usize| {
        let a = n as f64 * 2.399963;
        [0.7 * a.cos(), 0.7 * a.sin()]
    };
    let sizes = |wrong_px: f64, name_of_wrong: &mut Vec<String>| {
        let mut all = marked(&noise);
        // More marks of the same corners, so that one can be told from the others.
        for primitive in &mut all {
            let again = primitive.marks.clone();
            primitive
                .marks
                .extend(again.iter().map(|m| Mark { at: [m.at[0] - 0.5, m.at[1] + 0.3], ..m.clone() }));
            primitive
                .marks
                .extend(again.iter().map(|m| Mark { at: [m.at[0] + 0.4, m.at[1] - 0.2], ..m.clone() }));
        }
        all[1].marks[3].at[1] += wrong_px;
        let mut fitter = Fitter::new(&all, &views, &settings).unwrap();
        let scene = fitter.scene().unwrap();
        name_of_wrong.extend(fitter.outlying().iter().map(|o| format!("{} {}", o.name, o.corner)));
        scene.primitives[1].size_m.clone()
    };
    let (mut none, mut one) = (Vec::new(), Vec::new());
    let (right, wrong) = (sizes(0.0, &mut none), sizes(30.0, &mut one));
    assert!(none.is_empty(), "{none:?}");
    assert_eq!(one, ["desk +++"]);
    for (a, b) in right.iter().zip(&wrong) {
        assert!((a - b).abs() < 0.01, "{right:?} {wrong:?}");
    }
}

#[test]
fn the_unconstrained_parameter_is_named() {
    let mut all = marked(&|_| [0.0, 0.0]);
    all[1].marks.retain(|m| &m.corner[1..2] == "-");
    all.truncate(2);
    let e = fitted(&all).unwrap_err();
    assert!(e.to_string().contains("the height of `desk`"), "{e}");
}

#[test]
fn the_contradicting_mark_is_named() {
    let mut all = marked(&|_| [0.0, 0.0]);
    all[1].marks[3].at[0] += 90.0;
    let e = fitted(&all).unwrap_err();
    let named =
        matches!(&e, Problem::Contradiction { name, corner, .. } if name == "desk" && corner == "+++");
    assert!(named, "{e}");
    assert!(e.hint().contains("this mark"));
}

#[test]
fn a_floor_corner_above_the_horizon_is_refused() {
    let mut all = marked(&|_| [0.0, 0.0]);
    all.truncate(1);
    all[0].marks.retain(|m| !m.reflection);
    all[0].size_m = vec![5.0, 2.6, 4.0];
    all[0].yaw = crate::annotations::Yaw::Parent;
    all[0].marks.truncate(1);
    all[0].marks[0].at = [320.0, 2.0];
    let e = fitted(&all).unwrap_err();
    assert!(matches!(&e, Problem::Behind { corner, .. } if corner == "---"), "{e}");
}

#[test]
fn parents_are_checked() {
    let box_on = |name: &str, parent: &str| {
        format!("[[primitive]]\nname = \"{name}\"\nkind = \"box\"\nparent = \"{parent}\"\n")
    };
    let e = fitted(&primitives(&(box_on("a", "b") + &box_on("b", "a")))).unwrap_err();
    assert!(matches!(e, Problem::Cycle { .. }), "{e}");
    let e = fitted(&primitives(&box_on("a", "roof"))).unwrap_err();
    assert_eq!(e.to_string(), "`a` has the parent `roof`, which is not in the file");
    let e = fitted(&primitives(&(box_on("a", "a")))).unwrap_err();
    assert!(matches!(e, Problem::Cycle { .. }), "{e}");
}

#[test]
fn sizes_and_corners_are_checked() {
    let with = |size: &str, corner: &str| {
        primitives(&format!(
            "[[primitive]]\nname = \"a\"\nkind = \"box\"\nsize_m = {size}\nmarks = [{{ corner = \"{corner}\", image = \
             \"plate.jpg\", at = [1.0, 2.0] }}]\n"
        ))
    };
    assert!(matches!(fitted(&with("[-1.0, 1.0, 1.0]", "---")), Err(Problem::Size { .. })));
    assert!(matches!(fitted(&with("[1.0]", "---")), Err(Problem::SizeCount { given: 1, expected: 3, .. })));
    assert!(matches!(fitted(&with("[]", "-x-")), Err(Problem::Corner { .. })));
    let mut other = with("[]", "---");
    other[0].marks[0].image = "holiday.jpg".into();
    assert!(matches!(fitted(&other), Err(Problem::Image { .. })));
    other[0].marks[0].image = "probe.jpg".into();
    other[0].marks[0].reflection = true;
    assert!(matches!(fitted(&other), Err(Problem::NoReflection { .. })), "beside the ball");
}

#[test]
fn a_zero_size_primitive_is_refused() {
    let mut all = primitives("[[primitive]]\nname = \"a\"\nkind = \"quad\"\n");
    for corner in ["--", "+-", "++", "-+"] {
        all[0].marks.push(mark(corner, Point3::new(0.0, GROUND, 0.0), [0.0, 0.0]));
    }
    let e = fitted(&all).unwrap_err();
    assert!(matches!(e, Problem::Size { .. }), "{e}");
}

#[test]
fn a_ground_alone_is_a_scene() {
    let scene =
        fitted(&primitives("[[primitive]]\nname = \"ground\"\nkind = \"ground\"\nextent_m = 3.0\n")).unwrap();
    assert_eq!(scene.faces.len(), 1);
    assert!((scene.faces[0].area() - 36.0).abs() < 1e-9 && scene.faces[0].normal().y > 0.999);
    assert!(scene.faces[0].vertices.iter().all(|v| v.y == GROUND));
}

#[test]
fn a_dented_polygon_is_cut_and_a_starred_one_refused() {
    let polygon = |points: &[[f64; 2]]| {
        let mut all = primitives("[[primitive]]\nname = \"p\"\nkind = \"polygon\"\n");
        for (k, p) in points.iter().enumerate() {
            all[0].marks.push(mark(&k.to_string(), Point3::new(p[0], GROUND, p[1]), [0.0, 0.0]));
        }
        fitted(&all)
    };
    let scene = polygon(&[[0.0, 0.0], [1.0, 0.0], [0.3, -0.3], [0.0, -1.0]]).unwrap();
    let names: Vec<&str> = scene.faces.iter().map(|f| f.name.as_str()).collect();
    assert_eq!(names, ["p", "p.1"]);
    assert!((scene.faces.iter().map(Face::area).sum::<f64>() - 0.3).abs() < 1e-6);
    assert!(scene.faces.iter().all(|f| f.normal().y > 0.999));
    let ring = |k: usize| [0.5 * (k as f64 * 1.2566).cos(), 0.5 * (k as f64 * 1.2566).sin() - 0.5];
    assert!(polygon(&[0, 1, 2, 3, 4].map(ring)).is_ok() && polygon(&[4, 3, 2, 1, 0].map(ring)).is_ok());
    assert!(matches!(polygon(&[0, 2, 4, 1, 3].map(ring)), Err(Problem::Outline { .. })), "a star");
}

#[test]
fn the_glb_reads_back_with_the_camera_in_place() {
    let scene = fitted(&marked(&|_| [0.0, 0.0])).unwrap();
    let camera = &cameras()["plate.jpg"];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.glb");
    let views = |name, camera| super::gltf::View { name, camera, picture: Some("../plate.jpg") };
    super::gltf::write(&path, &scene, &[views("plate", camera)], &[]).unwrap();
    let gltf = ::gltf::Gltf::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let blob = gltf.blob.clone().unwrap();
    let triangles: usize = gltf
        .meshes()
        .flat_map(|m| m.primitives())
        .map(|p| {
            let reader = p.reader(|_| Some(&blob));
            let count = reader.read_positions().unwrap().count();
            let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
            assert!(indices.iter().all(|i| (*i as usize) < count));
            indices.len() / 3
        })
        .sum();
    assert_eq!(triangles, 2 * scene.faces.len());
    // What glTF's camera projects must be where ours does.
    let node = gltf.nodes().find(|n| n.camera().is_some()).unwrap();
    let lens = node.camera().unwrap();
    let ::gltf::camera::Projection::Perspective(lens) = lens.projection() else { panic!() };
    let world_from_camera = nalgebra::Matrix4::from_fn(|r, c| f64::from(node.transform().matrix()[c][r]));
    let point = in_room(0.2, 0.3, -0.5);
    let p = world_from_camera.try_inverse().unwrap() * point.to_homogeneous();
    let half = (f64::from(lens.yfov()) / 2.0).tan();
    let x = p.x / -p.z / (half * f64::from(lens.aspect_ratio().unwrap()));
    let seen = Point2::new((x + 1.0) * 320.0, (1.0 - p.y / -p.z / half) * 240.0);
    assert!((seen - camera.project(&point).unwrap()).norm() < 1e-2, "{seen}");
}

#[test]
fn the_glb_has_its_lights_where_they_shine() {
    use super::gltf::{Light, LightKind};
    use glam::Vec3;
    let scene = fitted(&marked(&|_| [0.0, 0.0])).unwrap();
    let spot = Light {
        name: "lamp".into(),
        kind: LightKind::Spot { at: Vec3::new(0.5, 2.0, -1.0) },
        towards: Vec3::NEG_Y,
        intensity: [8.0, 4.0, 2.0],
    };
    let sun = Light {
        kind: LightKind::Directional,
        towards: Vec3::new(0.6, -0.8, 0.0),
        intensity: [3.0, 3.0, 2.0],
        name: "sun".into(),
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.glb");
    let view = super::gltf::View { name: "plate", camera: &cameras()["plate.jpg"], picture: None };
    super::gltf::write(&path, &scene, &[view], &[spot, sun]).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let glb = ::gltf::binary::Glb::from_slice(&bytes).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&glb.json).unwrap();
    let lights = &json["extensions"]["KHR_lights_punctual"]["lights"];
    assert_eq!(json["extensionsUsed"], serde_json::json!(["KHR_lights_punctual"]));
    assert_eq!((&lights[0]["type"], &lights[1]["type"]), (&"spot".into(), &"directional".into()));
    assert_eq!(lights[0]["intensity"], 8.0);
    assert_eq!(lights[0]["color"], serde_json::json!([1.0, 0.5, 0.25]));
    let nodes = json["nodes"].as_array().unwrap();
    let lit: Vec<_> = nodes.iter().filter(|n| n["extensions"].is_object()).collect();
    assert_eq!(lit.len(), 2);
    let down = |node: &serde_json::Value| {
        let q: Vec<f32> =
            node["rotation"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap() as f32).collect();
        glam::Quat::from_xyzw(q[0], q[1], q[2], q[3]) * Vec3::NEG_Z
    };
    assert!((down(lit[0]) - Vec3::NEG_Y).length() < 1e-5);
    assert!((down(lit[1]) - Vec3::new(0.6, -0.8, 0.0)).length() < 1e-5);
    assert_eq!(lit[0]["translation"], serde_json::json!([0.5, 2.0, -1.0]));
}

#[test]
fn a_polygon_without_a_parent_lies_on_its_surface_and_a_ground_at_its_level() {
    let views = Views { cameras: &cameras(), ball: None, ground_y: GROUND, rooms: &[] };
    let camera = &views.cameras["plate.jpg"];
    let corners = [[0.0, 0.0], [0.4, 0.0], [0.4, -0.3], [0.0, -0.3]];
    let see = |[x, z]: [f64; 2]| camera.project(&Point3::new(x, GROUND, z)).unwrap();
    let marks: Vec<String> = corners
        .iter()
        .enumerate()
        .map(|(k, c)| {
            format!("{{ corner = \"{k}\", image = \"plate.jpg\", at = [{}, {}] }}", see(*c).x, see(*c).y)
        })
        .collect();
    let text = format!(
        "[[primitive]]\nname = \"top\"\nkind = \"polygon\"\nmarks = [{}]\n\
         [[primitive]]\nname = \"floor\"\nkind = \"ground\"\nlevel_m = -0.4\n",
        marks.join(", ")
    );
    let annotations: Annotations = config::parse(&text, Path::new("annotations.toml")).unwrap();
    let scene = fit(&annotations.primitive, &views, &config::Model::default()).unwrap();
    let height = |name: &str| scene.faces.iter().find(|f| f.name == name).unwrap().vertices[0].y;
    assert!((height("top") - GROUND).abs() < 1e-9, "{}", height("top"));
    assert!((height("floor") - (GROUND - 0.4)).abs() < 1e-9, "{}", height("floor"));
}

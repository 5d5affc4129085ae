//! Every kind of primitive and every relation: placed, seen by a camera, and found again from what is seen.

use super::feature::{Feature, feature};
use super::placed::Placed;
use super::tree::Tree;
use super::*;
use crate::annotations::{Annotations, Primitive};
use crate::camera::{Camera, Intrinsics};
use crate::config;
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::collections::BTreeMap;
use std::path::Path;

const GROUND: f64 = -0.002;

fn cameras() -> BTreeMap<String, Camera> {
    let looking = |from: [f64; 3], to: [f64; 3]| {
        let (from, to) = (Vector3::from(from), Vector3::from(to));
        let z = (to - from).normalize();
        let x = z.cross(&Vector3::y()).normalize();
        let turn =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]));
        Camera {
            intrinsics: Intrinsics::pinhole(640, 480, 450.0),
            world_from_camera: Isometry3::from_parts(Translation3::from(from), turn),
        }
    };
    BTreeMap::from([
        ("a".into(), looking([-1.4, 1.7, 2.3], [0.3, 0.6, -1.0])),
        ("b".into(), looking([1.9, 1.2, 1.6], [0.0, 0.7, -1.2])),
    ])
}

fn parsed(text: &str) -> Vec<Primitive> {
    crate::config::parse::<Annotations>(text, Path::new("annotations.toml")).unwrap().primitive
}

/// The marks as the cameras see the primitives with these values, by name.
fn seen(
    text: &str,
    truth: &[(&str, &[f64])],
    noise: &dyn Fn(usize) -> [f64; 2],
) -> (Vec<Primitive>, Vec<Face>) {
    let cameras = cameras();
    let mut all = parsed(text);
    let views = Views { cameras: &cameras, ball: None, ground_y: GROUND, rooms: &[] };
    let (mut marks, mut faces) = (Vec::new(), Vec::new());
    {
        let tree = Tree::new(&all, &views, 1.0).unwrap();
        let mut values = tree.values(&vec![0.0; tree.free.len()]);
        let mut placed: Vec<Placed> = Vec::new();
        let mut n = 0;
        for (i, node) in tree.nodes.iter().enumerate() {
            let name = node.primitive.name.as_str();
            tree.tie(i, &mut values);
            if let Some((_, own)) = truth.iter().find(|t| t.0 == name) {
                values[i] = own.to_vec();
                tree.tie(i, &mut values);
            }
            placed.push(tree.place_one(i, &values, &placed).unwrap());
            faces.extend(super::faces::faces(node.primitive, &placed[i], &values[i]).unwrap());
            for (k, mark) in node.primitive.marks.iter().enumerate() {
                let camera = &cameras[&mark.image];
                let point = match feature(node.primitive, &placed[i], &values[i], &mark.corner).unwrap() {
                    Feature::Point(point) => point,
                    Feature::Edge([a, b]) => a + (b - a) * (0.3 + 0.1 * k as f64),
                    Feature::Rim { centre, radii } => {
                        let angle = 0.3 + 1.3 * k as f64;
                        centre + radii[0] * angle.cos() + radii[1] * angle.sin()
                    }
                    Feature::Side { axis, radii, right } => {
                        tangent(camera, axis, radii, right, 0.2 + 0.1 * k as f64)
                    }
                };
                let at = camera.project(&point).unwrap();
                let [dx, dy] = noise(n);
                n += 1;
                marks.push((name.to_string(), k, [at.x + dx, at.y + dy]));
            }
        }
    }
    for (name, k, at) in marks {
        all.iter_mut().find(|p| p.name == name).unwrap().marks[k].at = at;
    }
    (all, faces)
}

/// A place on the outline of a cylinder by its definition: where a ray grazes it.
fn tangent(
    camera: &Camera,
    axis: [Point3<f64>; 2],
    radii: [Vector3<f64>; 2],
    right: bool,
    along: f64,
) -> Point3<f64> {
    let eye = camera.centre();
    let base = axis[0] + (axis[1] - axis[0]) * along;
    let at = |a: f64| base + radii[0] * a.cos() + radii[1] * a.sin();
    // The normal stands across the ray there; of the two such places one is to the right.
    let grazing = |a: f64| (at(a) - base).dot(&(eye - at(a)));
    let mut found = Vec::new();
    for k in 0..720 {
        let (mut low, mut high) = (f64::from(k).to_radians() / 2.0, f64::from(k + 1).to_radians() / 2.0);
        if grazing(low) * grazing(high) > 0.0 {
            continue;
        }
        for _ in 0..60 {
            let middle = (low + high) / 2.0;
            if grazing(low) * grazing(middle) > 0.0 { low = middle } else { high = middle }
        }
        found.push(at(low));
    }
    assert_eq!(found.len(), 2);
    let x = |p: &Point3<f64>| camera.project(p).unwrap().x;
    found.sort_by(|p, q| x(p).total_cmp(&x(q)));
    found[usize::from(right)]
}

fn fitted(primitives: &[Primitive]) -> Result<Scene, Problem> {
    let cameras = cameras();
    fit(
        primitives,
        &Views { cameras: &cameras, ball: None, ground_y: GROUND, rooms: &[] },
        &config::Model::default(),
    )
}

fn marks(image: &str, corners: &[&str]) -> String {
    let mark = |c: &&str| format!("{{ corner = \"{c}\", image = \"{image}\", at = [0.0, 0.0] }}");
    corners.iter().map(mark).collect::<Vec<_>>().join(", ")
}

fn primitive(name: &str, kind: &str, rest: &str, marks: &str) -> String {
    format!("[[primitive]]\nname = \"{name}\"\nkind = \"{kind}\"\n{rest}\nmarks = [{marks}]\n")
}

/// Fitted vertices lie where they should, to a tenth of a millimetre.
fn recovers(text: &str, truth: &[(&str, &[f64])]) -> Scene {
    let (all, faces) = seen(text, truth, &|_| [0.0; 2]);
    let scene = fitted(&all).unwrap_or_else(|e| panic!("{e}"));
    assert!(scene.rms_px < 1e-3, "{}", scene.rms_px);
    assert_eq!(scene.faces.len(), faces.len());
    for (found, truth) in scene.faces.iter().zip(&faces) {
        assert_eq!(found.name, truth.name);
        assert_eq!(found.vertices.len(), truth.vertices.len(), "{}", found.name);
        for (a, b) in found.vertices.iter().zip(&truth.vertices) {
            assert!((a - b).norm() < 1e-4, "{}: {a} instead of {b}", found.name);
        }
    }
    scene
}

fn room() -> String {
    let rest = "yaw = \"free\"\nsize_m = [4.4, 2.6, 5.0]";
    primitive("room", "room", rest, &marks("a", &["---", "+--", "-+-"]))
}

const ROOM: (&str, &[f64]) = ("room", &[0.2, -0.4, 0.0, 0.2, 4.4, 2.6, 5.0]);

#[test]
fn a_wedge_stands_on_the_floor() {
    let ramp = marks("a", &["---", "--+", "+-+", "-+-", "++-"]);
    let text = room() + &primitive("ramp", "wedge", "parent = \"room\"\nturn_deg = 30.0", &ramp);
    let scene = recovers(&text, &[ROOM, ("ramp", &[0.3, -0.5, 0.0, 0.0, 0.5, 0.3, 0.7])]);
    let slope = scene.faces.iter().find(|f| f.name == "ramp.slope").unwrap();
    assert!((slope.area() - 0.5 * 0.3f64.hypot(0.7)).abs() < 1e-4);
    assert!(slope.normal().y > 0.5, "it looks up");
    let inside = scene.faces.iter().filter(|f| f.name.starts_with("ramp."));
    let total: Vector3<f64> = inside.map(Face::area_vector).sum();
    assert!(
        (total.y - 0.5 * 0.7).abs() < 1e-4 && total.x.hypot(total.z) < 1e-6,
        "all but its bottom: {total}"
    );
}

#[test]
fn a_cylinder_is_found_from_its_rims_and_sides() {
    let tin = [marks("a", &["top", "top", "top", "bottom", "left", "right"]), marks("b", &["left", "right"])]
        .join(", ");
    let text = room() + &primitive("tin", "cylinder", "parent = \"room\"", &tin);
    let scene = recovers(&text, &[ROOM, ("tin", &[0.4, -0.8, 0.0, 0.36, 0.5])]);
    let tin = &scene.primitives[1];
    assert!((tin.size_m[0] - 0.36).abs() < 1e-5 && (tin.size_m[1] - 0.5).abs() < 1e-5, "{tin:?}");
    let top = scene.faces.iter().find(|f| f.name == "tin.top").unwrap();
    assert!((top.area() / (std::f64::consts::PI * 0.18 * 0.18) - 1.0).abs() < 1e-6, "of the circle's area");
    let closed: Vector3<f64> =
        scene.faces.iter().filter(|f| f.name.starts_with("tin.")).map(Face::area_vector).sum();
    assert!((closed.y - top.area()).abs() < 1e-6 && closed.x.hypot(closed.z) < 1e-6);
}

#[test]
fn an_extrusion_may_have_dents_and_carry_a_box() {
    // An L from above.
    let low = marks("a", &["0-", "1-", "2-", "3-", "4-", "5-", "0+", "3+"]);
    let text = room()
        + &primitive("bench", "extrusion", "parent = \"room\"", &low)
        + &primitive(
            "book",
            "box",
            "parent = \"bench\"",
            &marks("a", &["-+-", "++-", "-++", "+++", "--+", "+-+"]),
        );
    let bench: &[f64] = &[0.0, 0.45, -0.6, -1.0, 0.8, -1.0, 0.8, -0.6, -0.1, -0.6, -0.1, 0.1, -0.6, 0.1];
    let scene = recovers(&text, &[ROOM, ("bench", bench), ("book", &[0.2, -0.8, 0.0, 0.0, 0.3, 0.05, 0.2])]);
    let tops = scene.faces.iter().filter(|f| f.name.starts_with("bench.top"));
    let (count, area) = tops.fold((0, 0.0), |(n, a), f| (n + 1, a + f.area()));
    assert!(count == 2 && (area - (1.4 * 0.4 + 0.5 * 0.7)).abs() < 1e-4, "{count} {area}");
    let total: Vector3<f64> =
        scene.faces.iter().filter(|f| f.name.starts_with("bench.")).map(Face::area_vector).sum();
    assert!((total.y - area).abs() < 1e-6 && total.x.hypot(total.z) < 1e-6, "fronts look out: {total}");
    let book = scene.faces.iter().find(|f| f.name == "book.left").unwrap();
    let lowest = book.vertices.iter().map(|v| v.y).fold(f64::MAX, f64::min);
    assert!((lowest - (GROUND + 0.45)).abs() < 1e-4);
}

#[test]
fn a_wall_with_a_hole_in_it() {
    let border = marks("a", &["0", "1", "2", "3", "4", "5", "6", "7"]);
    let text = room()
        + &primitive(
            "wall",
            "polygon",
            "parent = \"room\"\nattach = \"back\"\nholes = [[4, 5, 6, 7]]",
            &border,
        );
    let corners: &[f64] =
        &[-1.0, -1.0, 1.0, -1.0, 1.0, 0.9, -1.0, 0.9, -0.4, -0.2, 0.3, -0.2, 0.3, 0.5, -0.4, 0.5];
    let scene = recovers(&text, &[ROOM, ("wall", corners)]);
    let area: f64 = scene.faces.iter().filter(|f| f.name.starts_with("wall")).map(Face::area).sum();
    assert!((area - (2.0 * 1.9 - 0.7 * 0.7)).abs() < 1e-4, "{area}");
    let (mut all, _) = seen(&text, &[ROOM, ("wall", corners)], &|_| [0.0; 2]);
    all[1].holes = vec![vec![0, 1, 2, 9]];
    assert!(matches!(fitted(&all), Err(Problem::Outline { .. })));
}

#[test]
fn a_board_leans_and_touches_floor_and_wall_exactly() {
    let seen_of = [marks("a", &["--+", "+-+", "-++", "+++"]), marks("b", &["+-+", "+++", "++-"])].join(", ");
    let board = primitive("board", "box", "parent = \"room\"\nleans_on = \"back\"", &seen_of);
    let values: &[f64] = &[0.3, 0.35, 0.0, 0.0, 0.6, 1.1, 0.04];
    recovers(&(room() + &board), &[ROOM, ("board", values)]);
    // With marks that are off by a pixel contact is as exact.
    let noise = |n: usize| [(n as f64 * 2.4).cos(), (n as f64 * 2.4).sin()];
    let (all, _) = seen(&(room() + &board), &[ROOM, ("board", values)], &noise);
    let scene = fitted(&all).unwrap();
    let back = scene.faces.iter().find(|f| f.name == "room.back").unwrap();
    let of_board = scene.faces.iter().filter(|f| f.name.starts_with("board."));
    let corners: Vec<Point3<f64>> = of_board.flat_map(|f| f.vertices.clone()).collect();
    let gap = |p: &Point3<f64>| (p - back.vertices[0]).dot(&back.normal());
    let nearest = corners.iter().map(gap).fold(f64::MAX, f64::min);
    let lowest = corners.iter().map(|p| p.y - GROUND).fold(f64::MAX, f64::min);
    assert!(nearest.abs() < 1e-12 && lowest.abs() < 1e-12, "{nearest} {lowest}");
    // A picture frame, too.
    let frame = primitive(
        "frame",
        "quad",
        "parent = \"room\"\nleans_on = \"back\"",
        &marks("a", &["--", "+-", "++", "-+"]),
    );
    recovers(&(room() + &frame), &[ROOM, ("frame", &[-0.2, 0.5, 0.0, 0.5, 0.7])]);
}

#[test]
fn lamps_hang_and_cabinets_are_on_walls() {
    // What hangs free has no contact that says how far it is: two places tell.
    let lamp =
        [marks("a", &["--+", "+-+", "-++", "+++", "---"]), marks("b", &["--+", "+-+", "-++"])].join(", ");
    let cabinet = marks("b", &["--+", "+-+", "-++", "+++", "---"]);
    let text = room()
        + &primitive("lamp", "box", "parent = \"room\"\nattach = \"ceiling\"\nlift = \"free\"", &lamp)
        + &primitive("cabinet", "box", "parent = \"room\"\nattach = \"left\"", &cabinet);
    let truth: [(&str, &[f64]); 3] = [
        ROOM,
        ("lamp", &[0.1, -1.0, 0.7, 0.0, 0.4, 0.2, 0.4]),
        ("cabinet", &[0.5, 0.0, 1.1, 0.0, 0.8, 0.6, 0.35]),
    ];
    let scene = recovers(&text, &truth);
    let find = |name: &str| scene.faces.iter().find(|f| f.name == name).unwrap();
    let top = find("lamp.top").vertices[0].y;
    assert!((top - (GROUND + 2.6 - 0.7)).abs() < 1e-5, "{top}");
    assert!(!scene.faces.iter().any(|f| f.name == "cabinet.back"), "it is on the wall");
    let (left, side) = (find("room.left"), find("cabinet.top"));
    let gap = |p: &Point3<f64>| (p - left.vertices[0]).dot(&left.normal());
    let gaps: Vec<f64> = side.vertices.iter().map(gap).collect();
    assert!(gaps.iter().filter(|g| g.abs() < 1e-12).count() == 2, "{gaps:?}");
}

#[test]
fn legs_are_alike_parallel_and_symmetric() {
    let top = marks("a", &["-+-", "++-", "-++", "+++", "--+"]);
    let leg = marks("a", &["--+", "+-+", "-++", "+++", "--"].map(|c| if c == "--" { "---" } else { c }));
    let text = room()
        + &primitive("leg", "box", "parent = \"room\"\nyaw = \"free\"", &leg)
        + &primitive(
            "other",
            "box",
            "parent = \"room\"\nsame_size = \"leg\"\nparallel_to = \"leg\"",
            &marks("a", &["--+", "+-+"]),
        )
        + &primitive("top", "box", "parent = \"leg\"", &top)
        + &primitive(
            "third",
            "box",
            "parent = \"room\"\nmirror = { of = \"leg\", about = \"top\", across = \"x\" }",
            "",
        );
    let truth: [(&str, &[f64]); 4] = [
        ROOM,
        ("leg", &[-0.3, -0.6, 0.0, 0.4, 0.1, 0.6, 0.12]),
        ("other", &[-0.3, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ("top", &[0.5, 0.1, 0.0, 0.0, 1.2, 0.03, 0.7]),
    ];
    let scene = recovers(&text, &truth);
    let find = |name: &str| scene.primitives.iter().find(|p| p.name == name).unwrap();
    assert_eq!(find("other").size_m, find("leg").size_m);
    assert_eq!(find("other").size_sigma_m, find("leg").size_sigma_m);
    assert_eq!(find("third").size_m, find("leg").size_m);
    let middle = |name: &str| {
        let f = scene.faces.iter().find(|f| f.name == name).unwrap();
        f.vertices.iter().map(|v| v.coords).sum::<Vector3<f64>>() / 4.0
    };
    let half = (middle("leg.top") + middle("third.top")) / 2.0 - middle("top.top");
    let across = middle("leg.top") - middle("third.top");
    assert!(half.dot(&across).abs() < 1e-9, "the top's middle is as far from both");
    let normal = |name: &str| scene.faces.iter().find(|f| f.name == name).unwrap().normal();
    assert!((normal("other.front").dot(&normal("leg.front")) - 1.0).abs() < 1e-12);
    let box_faces: Vec<_> = scene.faces.iter().filter(|f| f.name.starts_with("third.")).collect();
    let centre =
        box_faces.iter().map(|f| f.vertices[0].coords).sum::<Vector3<f64>>() / box_faces.len() as f64;
    assert!(
        box_faces.iter().all(|f| (f.vertices[0].coords - centre).dot(&f.normal()) > 0.0),
        "fronts look out"
    );
}

#[test]
fn an_edge_tells_of_a_corner_that_is_not_seen() {
    let seen = marks("a", &["--+", "+-+", "-++", "+++", "+--/++-", "-+-/++-"]);
    let text = room() + &primitive("desk", "box", "parent = \"room\"", &seen);
    recovers(&text, &[ROOM, ("desk", &[0.2, -0.5, 0.0, 0.0, 0.9, 0.7, 0.4])]);
    let text = room() + &primitive("desk", "box", "parent = \"room\"", &marks("a", &["---/---"]));
    assert!(matches!(fitted(&parsed(&text)), Err(Problem::Corner { .. })));
}

#[test]
fn references_are_checked() {
    let room = || primitive("room", "room", "size_m = [4.0, 2.5, 4.0]", "");
    let on_room =
        |rest: &str| fitted(&parsed(&(room() + &primitive("a", "box", rest, "")))).unwrap_err().to_string();
    assert_eq!(
        on_room("same_size = \"room\""),
        "`a` has the same_size `room`, which is of another kind, or has no size"
    );
    assert_eq!(on_room("parallel_to = \"b\""), "`a` has the parallel_to `b`, which is not in the file");
    let mirror = "mirror = { of = \"room\", about = \"room\", across = \"z\" }";
    assert!(on_room(mirror).contains("of one that has no mirror image"));
    assert_eq!(
        on_room("parent = \"room\"\nleans_on = \"floor\""),
        "`a` is attached to `floor`, which its parent does not have"
    );
    assert_eq!(
        on_room("attach = \"ceiling\""),
        "`a` is attached to `ceiling`, which its parent does not have"
    );
    let text = room() + &primitive("a", "cylinder", "parent = \"room\"\nleans_on = \"back\"", "");
    assert!(matches!(fitted(&parsed(&text)), Err(Problem::Leaning { .. })));
    let text =
        primitive("a", "box", "", "{ corner = \"---\", image = \"a\", at = [1.0, 1.0], sigma_px = 0.0 }");
    assert!(matches!(fitted(&parsed(&text)), Err(Problem::Sigma { .. })));
}

#[test]
fn all_that_no_mark_fixes_is_named() {
    let text = room() + &primitive("desk", "box", "parent = \"room\"", &marks("a", &["--+", "+-+"]));
    let (all, _) = seen(&text, &[ROOM, ("desk", &[0.2, -0.5, 0.0, 0.0, 0.9, 0.7, 0.4])], &|_| [0.0; 2]);
    let e = fitted(&all).unwrap_err().to_string();
    assert!(e.contains("the height of `desk`") && e.contains("the depth of `desk`"), "{e}");
    assert!(!e.contains("width") && !e.contains("room"), "{e}");
}

#[test]
fn what_hangs_free_in_one_picture_is_named() {
    let lamp = marks("a", &["--+", "+-+", "-++", "+++", "---"]);
    let text =
        room() + &primitive("lamp", "box", "parent = \"room\"\nattach = \"ceiling\"\nlift = \"free\"", &lamp);
    let (all, _) = seen(&text, &[ROOM, ("lamp", &[0.1, -1.0, 0.7, 0.0, 0.4, 0.2, 0.4])], &|_| [0.0; 2]);
    let e = fitted(&all).unwrap_err().to_string();
    assert!(e.contains("do not determine") && e.contains("of `lamp`") && !e.contains("room"), "{e}");
}

#[test]
fn a_mark_with_less_weight_pulls_less() {
    let text = room()
        + &primitive(
            "desk",
            "box",
            "parent = \"room\"",
            &marks("a", &["--+", "+-+", "-++", "+++", "++-", "-+-"]),
        );
    let (mut all, faces) =
        seen(&text, &[ROOM, ("desk", &[0.2, -0.5, 0.0, 0.0, 0.9, 0.7, 0.4])], &|_| [0.0; 2]);
    all[1].marks[3].at[0] += 6.0;
    let off = |all: &[Primitive]| {
        let scene = fitted(all).unwrap();
        let pairs = scene.faces.iter().zip(&faces).flat_map(|(a, b)| a.vertices.iter().zip(&b.vertices));
        pairs.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
    };
    let alike = off(&all);
    all[1].marks[3].sigma_px = Some(20.0);
    assert!(off(&all) < 0.1 * alike, "{} {alike}", off(&all));
}

#[test]
fn dragging_a_mark_ends_where_a_fit_from_scratch_does() {
    let corners = ["--+", "+-+", "-++", "+++", "++-", "-+-"];
    let text = room()
        + &primitive("desk", "box", "parent = \"room\"", &marks("a", &corners))
        + &primitive("book", "box", "parent = \"desk\"\nyaw = \"free\"", &marks("a", &corners));
    let truth: [(&str, &[f64]); 3] = [
        ROOM,
        ("desk", &[0.2, -0.5, 0.0, 0.0, 0.9, 0.7, 0.4]),
        ("book", &[0.1, 0.05, 0.0, 0.6, 0.3, 0.06, 0.2]),
    ];
    let noise = |n: usize| [0.7 * (n as f64 * 2.4).cos(), 0.7 * (n as f64 * 2.4).sin()];
    let (mut all, _) = seen(&text, &truth, &noise);
    let (cameras, settings) = (cameras(), config::Model::default());
    let views = Views { cameras: &cameras, ball: None, ground_y: GROUND, rooms: &[] };
    let to = [all[1].marks[2].at[0] + 3.0, all[1].marks[2].at[1] - 2.0];
    let before = all.clone();
    let mut fitter = Fitter::new(&before, &views, &settings).unwrap();
    assert!(!fitter.drag("chair", 0, to) && !fitter.drag("desk", 99, to));
    assert!(fitter.drag("desk", 2, to));
    all[1].marks[2].at = to;
    let (dragged, fresh) = (fitter.scene().unwrap(), fit(&all, &views, &settings).unwrap());
    for (a, b) in dragged.faces.iter().zip(&fresh.faces) {
        assert!(a.vertices.iter().zip(&b.vertices).all(|(a, b)| (a - b).norm() < 1e-4), "{}", a.name);
    }
}

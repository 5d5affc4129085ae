use super::*;
use crate::image::Image;
use nalgebra::Point2;
use serde_json::json;

/// The grid lies at (1, 2, 0.1), turned by 30° about z.
fn truth() -> Truth {
    let (sin, cos) = 30f64.to_radians().sin_cos();
    Truth::new(json!({
        "scene": "test",
        "intrinsics": {"width": 64, "height": 48, "fx": 50.0, "fy": 51.0, "cx": 30.0, "cy": 25.0},
        "images": [{"file": "p.jpg", "role": "plate", "exposure_scale": 1.5, "linear_exr": "truth/p.exr",
            "R": [[1, 0, 0], [0, 0, -1], [0, 1, 0]], "t": [-1, 0.5, 3]}],
        "grid": {"world_from_board": [[cos, -sin, 0, 1], [sin, cos, 0, 2], [0, 0, 1, 0.1], [0, 0, 0, 1]]},
        "sphere": {"centre": [1, 2, 0.6], "radius": 0.1},
        "env_maps": [{"file": "truth/a.exr", "position": [0, 0, 0]}, {"file": "truth/b.exr", "position": [1, 2, 0.6]}],
        "emitters": [{"name": "sky", "kind": "envmap", "file": "truth/sky.exr"}],
        "primitives": [
            {"name": "lamp", "kind": "rect", "centre": [1, 2, 2], "half_u": [0.2, 0, 0], "half_v": [0, -0.3, 0],
             "emit": [5, 6, 7]},
            {"name": "case", "kind": "box", "centre": [1, 2, 1], "size": [1, 2, 0.5], "rot_z_deg": 20.0, "emit": null},
            {"name": "block", "kind": "box", "centre": [4, 2, 0.25], "size": [1, 2, 0.5], "emit": null},
            {"name": "bulb", "kind": "sphere", "centre": [2, 2, 1], "radius": 0.06, "emit": [50, 40, 30]}
        ]
    }))
}

#[test]
fn cameras_see_in_our_world_what_they_saw_in_theirs() {
    let t = truth();
    let camera = t.camera("p.jpg").unwrap();
    let p = Point3::new(1.3, 4.0, 0.8);
    // Xc = R X + t = (0.3, −0.3, 7).
    let expected = Point2::new(50.0 * 0.3 / 7.0 + 30.0, 51.0 * -0.3 / 7.0 + 25.0);
    let found = camera.project(&(t.world_from_truth().unwrap() * p)).unwrap();
    assert!((found - expected).norm() < 1e-9, "{found}");
    let ball = t.probe("p.jpg", 512).unwrap();
    assert!((ball.centre - Point3::new(0.0, 0.5, 0.0)).norm() < 1e-12, "half a metre over the grid");
    // A texel of 2π/512 rad has a standard deviation of its side over √12.
    let texel = std::f64::consts::TAU / 512.0 / 12f64.sqrt();
    let away = ball.camera.centre() - ball.centre;
    let away = Vec3::new(away.x as f32, away.y as f32, away.z as f32).normalize();
    assert!((ball.blur(away) / texel - 1.0).abs() < 1e-6);
}

#[test]
fn faces_look_outwards_and_keep_their_area() {
    let t = truth();
    let scene = t.scene().unwrap();
    assert_eq!(scene.primitives.len(), 4);
    let of = |name: &str| -> Vec<&Face> {
        scene.faces.iter().filter(|f| f.name.split('.').next() == Some(name)).collect()
    };
    let lamp = of("lamp")[0];
    assert!((lamp.normal().y + 1.0).abs() < 1e-12 && (lamp.area() - 0.24).abs() < 1e-12, "it shines down");
    assert_eq!((of("case").len(), of("block").len()), (6, 5), "a block on the ground has no bottom");
    let bulb: f64 = of("bulb").iter().map(|f| f.area()).sum();
    assert!((bulb / (4.0 * std::f64::consts::PI * 0.0036) - 1.0).abs() < 1e-9);
    for (name, centre) in [("case", [1.0, 2.0, 1.0]), ("bulb", [2.0, 2.0, 1.0])] {
        let middle = t.world_from_truth().unwrap() * Point3::from(centre);
        for f in of(name) {
            assert!(f.normal().dot(&(f.vertices[0] - middle)) > 0.0, "{}", f.name);
        }
    }
    let top = of("case").into_iter().find(|f| f.name == "case.top").unwrap();
    assert!(top.normal().y > 0.999 && (top.area() - 2.0).abs() < 1e-12);
    assert_eq!(t.emitters().unwrap().len(), 2);
    assert_eq!(t.environment_file().unwrap(), "truth/b.exr");
    assert_eq!((t.sky_file(), t.empty_file("p.jpg").unwrap()), (Some("truth/sky.exr"), "truth/p.exr"));
}

#[test]
fn environments_keep_their_light_and_point_the_same_way() {
    let t = truth();
    let (w, h) = (256, 128);
    // Light around (0, 1, 0.5) of the truth's world: row 0 is +Z, φ = π − 2π(c+½)/W.
    let toward = Vector3::new(0.0, 1.0, 0.5).normalize();
    let map = Image::from_fn(w, h, |c, r| {
        let (theta, phi) = (
            std::f64::consts::PI * (r as f64 + 0.5) / h as f64,
            std::f64::consts::PI - std::f64::consts::TAU * (c as f64 + 0.5) / w as f64,
        );
        let d = Vector3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
        Radiance([(40.0 * (d.dot(&toward) - 1.0)).exp() as f32; 3])
    });
    let env = t.environment(&map, 2.0, Point3::origin()).unwrap();
    let mut moment = Vec3::ZERO;
    for i in 0..w * h {
        moment += env.direction(i) * env.radiance.pixels()[i].0[0] * env.solid_angle(i) as f32;
    }
    let expected = t.world_from_truth().unwrap() * toward;
    let expected = Vec3::new(expected.x as f32, expected.y as f32, expected.z as f32);
    assert!(moment.normalize().angle_between(expected).to_degrees() < 0.1);
    for y in 0..h {
        let row = |image: &RadianceImage| (0..w).map(|x| f64::from(image.at(x, y).0[0])).sum::<f64>();
        assert!((row(&env.radiance) - 2.0 * row(&map)).abs() < 1e-3 * row(&map).max(1e-3));
    }
}

#[test]
fn what_is_missing_is_named() {
    let bad =
        Truth::new(json!({"grid": truth().value["grid"], "primitives": [{"name": "x", "kind": "cone"}]}));
    assert_eq!(bad.scene().unwrap_err(), Problem::Shape("primitives.centre".into()));
    assert_eq!(bad.camera("p.jpg").unwrap_err(), Problem::Shape("intrinsics.width".into()));
}

use super::*;
use crate::config::AreaLight;
use crate::illuminate::patch::PatchMesh;
use crate::synthetic::{face, lobby};
use glam::Vec3;

/// A wall of 4 × 2 m with the given radiance.
fn wall(radiance: impl Fn(Vec3) -> f32) -> PatchMesh {
    let mut mesh = PatchMesh::default();
    face(&mut mesh, Vec3::ZERO, Vec3::X * 4.0, Vec3::Y * 2.0, 0.04, |p| [radiance(p); 3]);
    mesh
}

#[test]
fn two_panes_with_soft_edges_and_a_dark_bar_are_two_lights() {
    let pane = |p: Vec3, x: f32| {
        let inside = (0.5 - (p.x - x).abs()).min(0.4 - (p.y - 1.0).abs());
        9.0 * (0.5 + inside / 0.1).clamp(0.0, 1.0)
    };
    let lights = find(&wall(|p| 0.3 + pane(p, 1.2) + pane(p, 2.4))).unwrap();
    assert_eq!(lights.len(), 2);
    for light in lights {
        let x = if light.centre.x < 1.8 { 1.2 } else { 2.4 };
        assert!(light.centre.distance(Vec3::new(x, 1.0, 0.0)) < 0.02, "{light:?}");
        assert!(light.normal().dot(Vec3::Z) > 0.9999, "{light:?}");
        assert!((light.area() / 0.8 - 1.0).abs() < 0.08 && light.radiance[0] > 8.0, "{light:?}");
    }
}

#[test]
fn the_lobby_has_its_windows_and_luminaires() {
    let lights = find(&lobby(0.5).mesh).unwrap();
    assert_eq!(lights.len(), 12);
    let luminaires: Vec<_> = lights.iter().filter(|l| l.normal().y < -0.99).collect();
    assert_eq!(luminaires.len(), 8);
    assert!(luminaires.iter().all(|l| (l.area() - 0.36).abs() < 1e-3 && l.radiance[0] == 22.0));
}

#[test]
fn light_of_another_shape_is_refused_with_the_method_to_use_instead() {
    let cross = |p: Vec3| {
        let (x, y) = ((p.x - 2.0).abs(), (p.y - 1.0).abs());
        if (x < 0.1 && y < 0.8) || (x < 0.8 && y < 0.1) { 5.0 } else { 0.2 }
    };
    for mesh in [wall(cross), wall(|_| 0.3), PatchMesh::default()] {
        let problem = find(&mesh).unwrap_err();
        assert!(matches!(problem, Problem::NoRectangle { .. }));
        assert!(crate::error::Problem::hint(&problem).contains("radiance-transfer"));
    }
}

#[test]
fn a_given_rectangle_takes_radiance_and_side_from_what_lies_on_it() {
    // Grid (x, y, z) is world (x, z, −y): a rectangle on the wall, 1 × 0.5 m, its corners clockwise as seen from the room.
    let light = AreaLight {
        corner_m: [1.0, 0.0, 0.5],
        side_u_m: [0.0, 0.0, 0.5],
        side_v_m: [1.0, 0.0, 0.0],
        radiance: None,
    };
    let mesh = wall(|p| if p.x < 1.5 { 2.0 } else { 4.0 });
    let found = given(std::slice::from_ref(&light), &mesh).unwrap()[0];
    assert!(found.centre.distance(Vec3::new(1.5, 0.75, 0.0)) < 1e-5 && found.normal().dot(Vec3::Z) > 0.999);
    assert!((found.radiance[0] - 3.0).abs() < 0.05 && (found.area() - 0.5).abs() < 1e-4, "{found:?}");
    let refused = [
        AreaLight { corner_m: [0.0, 3.0, 0.0], ..light.clone() },
        AreaLight { side_u_m: [0.0; 3], ..light.clone() },
        AreaLight { side_u_m: [1.0, 0.0, 0.1], ..light.clone() },
    ];
    for light in refused {
        assert!(matches!(given(&[light], &mesh), Err(Problem::AreaLight { index: 0, .. })));
    }
    let stated = AreaLight { corner_m: [0.0, 3.0, 0.0], radiance: Some([1.0, 2.0, 3.0]), ..light };
    assert_eq!(given(&[stated], &mesh).unwrap()[0].radiance, [1.0, 2.0, 3.0]);
}

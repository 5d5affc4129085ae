use super::*;
use crate::illuminate::mesh::{FaceMesh, assemble};
use crate::illuminate::patch::DistantSource;
use crate::illuminate::room;
use crate::model::face::Face;
use std::f32::consts::PI;

fn light(faces: &[Face], radiance: [f32; 3]) -> LightModel {
    let meshes: Vec<_> = faces
        .iter()
        .map(|f| {
            let mut m = FaceMesh::new(f).unwrap();
            m.refine(|_| 1.0);
            Some(m)
        })
        .collect();
    let mut mesh = assemble(&meshes);
    mesh.patches.iter_mut().for_each(|p| p.radiance = radiance);
    LightModel { mesh, distant: Vec::new() }
}

fn settings() -> config::Irradiance {
    config::Irradiance { rays: 2048, spacing_m: 0.5, ..Default::default() }
}

#[test]
fn white_furnace() {
    let v = Volume::build(&light(&room::faces(4.0, 3.0, 4.0), [2.0, 1.0, 0.5]), 0.0, &settings()).unwrap();
    assert_eq!(v.open_nodes(), v.len());
    let c = v.harmonics(Vec3::new(0.31, 0.4, -0.2));
    let higher = c[1..].iter().map(|c| c[0].abs()).fold(0.0, f32::max);
    assert!(higher < 1e-3 * c[0][0], "higher bands vanish: {higher}");
    for n in [Vec3::X, -Vec3::Y, Vec3::new(0.6, 0.0, 0.8)] {
        let e = v.irradiance(Vec3::new(0.31, 0.4, -0.2), n);
        assert!((e[0] / (2.0 * PI) - 1.0).abs() < 1e-3, "{e:?}");
        assert!((e[2] / (0.5 * PI) - 1.0).abs() < 1e-3);
    }
}

#[test]
fn a_uniform_sky_over_black_ground() {
    let mut light = light(&room::faces(40.0, 1.0, 40.0)[..1], [0.0; 3]);
    let n = 4000;
    light.distant = (0..n)
        .map(|i| DistantSource {
            direction: sh::sphere_direction(i, n),
            solid_angle_sr: 4.0 * PI / n as f32,
            radiance: [1.0; 3],
        })
        .collect();
    let v = Volume::build(&light, 0.0, &settings()).unwrap();
    let p = Vec3::new(0.1, 0.3, 0.1);
    // Half a sphere of light gives π upwards and π/2 sideways; the truncated series is off by a few per cent of π.
    assert!((v.irradiance(p, Vec3::Y)[0] / PI - 1.0).abs() < 0.05, "{:?}", v.irradiance(p, Vec3::Y));
    assert!((v.irradiance(p, Vec3::X)[0] / PI - 0.5).abs() < 0.05);
    assert!(v.irradiance(p, -Vec3::Y)[0] / PI < 0.05);
}

#[test]
fn the_sun_is_added_exactly_where_it_shines() {
    // A sky of even cells and a sun that sends as much: harmonics alone would be 6 % too bright towards it and leave a
    // tenth of it on surfaces turned away.
    let mut light = light(&room::faces(40.0, 1.0, 40.0)[..1], [0.0; 3]);
    let n = 4000;
    let sky = |i| DistantSource {
        direction: sh::sphere_direction(i, n),
        solid_angle_sr: 4.0 * PI / n as f32,
        radiance: [1.0; 3],
    };
    let sun = DistantSource {
        direction: Vec3::new(0.6, 0.8, 0.0),
        solid_angle_sr: 1e-3,
        radiance: [4e3, 3e3, 2e3],
    };
    light.distant = (0..n).map(sky).collect();
    let without = Volume::build(&light, 0.0, &settings()).unwrap();
    light.distant.insert(0, sun);
    let with = Volume::build(&light, 0.0, &settings()).unwrap();
    assert_eq!(with, without, "the sun stays out of the volume");
    let bvh = Bvh::new(&light.mesh.vertices, &light.mesh.triangles());
    let beams = Beams::new(&light.distant, &bvh);
    let p = Vec3::new(0.1, 0.3, 0.1);
    let e = beams.irradiance(p, Vec3::Y);
    assert!((e[0] - 3.2).abs() < 1e-4 && (e[2] - 1.6).abs() < 1e-4, "{e:?}");
    assert_eq!(beams.irradiance(p, -Vec3::X), [0.0; 3]);
    assert_eq!(beams.irradiance(p - Vec3::Y, Vec3::Y), [0.0; 3], "the ground hides it from below");
}

#[test]
fn nodes_inside_a_box_are_left_out() {
    let mut faces = room::faces(4.0, 3.0, 4.0);
    for f in room::faces(1.0, 1.2, 1.0) {
        let mut outward = f.clone();
        outward.vertices.reverse();
        faces.push(outward);
    }
    let v = Volume::build(&light(&faces, [1.0; 3]), 0.0, &settings()).unwrap();
    assert!(v.open_nodes() < v.len());
    let middle = v.middle().unwrap();
    assert!(v.open().any(|(place, _)| place == middle) && middle.distance(Vec3::new(0.0, 1.0, 0.0)) < 0.8);
    let beside = v.irradiance(Vec3::new(0.55, 0.3, 0.0), Vec3::X)[0];
    assert!((beside / PI - 1.0).abs() < 0.02, "the dark inside does not leak: {beside}");
}

#[test]
fn a_thin_wall_does_not_leak() {
    // A partition at x = 0.1, between nodes, that shines to its right side.
    let mut faces = room::faces(4.0, 3.0, 4.0);
    let wall = |x: f64, turn: bool| {
        let mut corners = [[x, 0.0, -2.0], [x, 0.0, 2.0], [x, 3.0, 2.0], [x, 3.0, -2.0]];
        if turn {
            corners.reverse();
        }
        Face {
            name: "wall".into(),
            vertices: corners.map(|[x, y, z]| nalgebra::Point3::new(x, y, z)).to_vec(),
            gloss: None,
        }
    };
    faces.extend([wall(0.10, false), wall(0.11, true)]);
    let mut light = light(&faces, [0.0; 3]);
    for i in 0..light.mesh.patches.len() {
        let shines = (light.mesh.centroid(i).x - 0.11).abs() < 1e-3;
        light.mesh.patches[i].radiance = [f32::from(u8::from(shines)); 3];
    }
    let v = Volume::build(&light, 0.0, &settings()).unwrap();
    let bvh = Bvh::new(&light.mesh.vertices, &light.mesh.triangles());
    let beams = Beams::new(&[], &bvh);
    let on = |x: f32, normal: Vec3| v.irradiance_with(&beams, Vec3::new(x, 1.0, 0.3), normal)[0] / PI;
    for x in [0.03, 0.05, 0.08] {
        assert!(on(x, Vec3::NEG_X) < 1e-6, "dark side, {x}: {}", on(x, Vec3::NEG_X));
        let leak = v.irradiance(Vec3::new(x, 1.0, 0.3), Vec3::NEG_X)[0] / PI;
        assert!(leak > 0.03, "without a look it would leak: {leak}");
    }
    for x in [0.13, 0.3] {
        assert!(on(x, Vec3::NEG_X) > 0.7, "lit side, {x}: {}", on(x, Vec3::NEG_X));
    }
}

#[test]
fn a_small_lamp_gives_what_it_must_however_few_rays() {
    // A square of 6 cm, 1.5 m above the point that it looks at.
    let mut faces = room::faces(4.0, 3.0, 4.0);
    let (s, y) = (0.03, 1.77);
    let corners = [[-s, y, -s], [s, y, -s], [s, y, s], [-s, y, s]];
    faces.push(Face {
        name: "lamp".into(),
        vertices: corners.map(|[x, y, z]| nalgebra::Point3::new(x, y, z)).to_vec(),
        gloss: None,
    });
    let mut light = light(&faces, [0.0; 3]);
    light.mesh.patches.iter_mut().filter(|p| p.face == 6).for_each(|p| p.radiance = [500.0; 3]);
    let settings = config::Irradiance { rays: 64, spacing_m: 0.25, ..settings() };
    let v = Volume::build(&light, 0.25, &settings).unwrap();
    let e = sh::evaluate(&v.harmonics(Vec3::new(0.0, 0.27, 0.0)), Vec3::Y)[0];
    let solid_angle = 0.0036 / 2.25;
    let c = sh::project([(Vec3::Y, [500.0; 3], solid_angle)]);
    assert!((e / sh::evaluate(&c, Vec3::Y)[0] - 1.0).abs() < 0.01, "{e}");
}

#[test]
fn a_volume_survives_exactly() {
    let v = Volume::build(&light(&room::faces(4.0, 3.0, 4.0), [2.0, 1.0, 0.5]), 0.0, &settings()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("irradiance.ply");
    v.write(&path).unwrap();
    assert_eq!(Volume::read(&path).unwrap(), v);
}

#[test]
fn refusals_say_why() {
    let light = light(&room::faces(4.0, 3.0, 4.0), [1.0; 3]);
    let with = |spacing_m: f64| config::Irradiance { spacing_m, ..settings() };
    assert_eq!(
        Volume::build(&light, 0.0, &with(0.0)).unwrap_err(),
        Problem::Setting { name: "spacing_m", value: 0.0 }
    );
    assert!(matches!(Volume::build(&light, 0.0, &with(0.001)).unwrap_err(), Problem::TooMany(_)));
}

use super::*;
use crate::illuminate::room;

/// What a probe at `at` sees of a room whose ceiling lamp sends 20 and whose walls send 0.5.
fn environment(at: Vec3) -> Environment {
    let triangles = crate::model::face::triangulate(&room::faces(4.0, 2.5, 4.0));
    let bvh = Bvh::new(&triangles.vertices, &triangles.triangles);
    Environment::from_fn(512, at, |d| {
        let hit = bvh.closest(at, d, 0.0, f32::MAX).unwrap();
        let p = at + d * hit.t;
        let lamp = p.y > 2.499 && (p.x - 0.5).abs() < 0.3 && p.z.abs() < 0.3;
        [if lamp { 20.0 } else { 0.5 }; 3]
    })
}

fn built(settings: &config::Illuminate) -> Built {
    let env = environment(Vec3::new(0.3, 0.6, -0.4));
    build(&room::faces(4.0, 2.5, 4.0), &env, None, &Known::default(), settings, |_| 0.0).unwrap()
}

#[test]
fn a_rooms_radiance_is_recovered_and_its_lamp_resolved() {
    let light = built(&config::Illuminate::default()).light;
    assert!(light.distant.is_empty(), "a closed room has no distant light");
    let truth = 20.0 * 0.36 + 0.5 * (2.0 * (16.0 + 10.0 + 10.0) - 0.36);
    let sent: f64 = (0..light.mesh.patches.len()).map(|i| power(&light.mesh, i)).sum();
    assert!((sent / truth - 1.0).abs() < 0.02, "power {sent} of {truth}");
    let (mut wrong, mut area) = (0.0, 0.0);
    for (i, p) in light.mesh.patches.iter().enumerate() {
        let c = light.mesh.centroid(i);
        let lamp = c.y > 2.499 && (c.x - 0.5).abs() < 0.3 && c.z.abs() < 0.3;
        let expected = if lamp { 20.0 } else { 0.5 };
        wrong += f64::from(light.mesh.area(i) * (p.radiance[0] - expected).abs());
        area += f64::from(light.mesh.area(i));
    }
    assert!(wrong / truth < 0.07, "{:.3} of the power is misplaced", wrong / truth);
    assert!(area > 71.9);
}

#[test]
fn white_furnace_gives_each_surface_its_reflectance() {
    // A box in a room that sends 2 1 0.5 from everywhere: each side of it gets π L and sends ρ L.
    let (rho, around) = ([0.2f32, 0.5, 0.8], [2.0f32, 1.0, 0.5]);
    let own: [f32; 3] = std::array::from_fn(|k| rho[k] * around[k]);
    let mut faces = room::faces(4.0, 2.5, 4.0);
    for mut f in room::faces(0.5, 0.5, 0.5) {
        f.vertices.reverse();
        f.vertices.iter_mut().for_each(|v| v.y += 0.8);
        f.name = f.name.replace("room", "box");
        faces.push(f);
    }
    let triangles = crate::model::face::triangulate(&faces);
    let bvh = Bvh::new(&triangles.vertices, &triangles.triangles);
    let mut sides = std::collections::BTreeSet::new();
    for at in [Vec3::new(1.2, 1.9, 1.1), Vec3::new(-1.2, 0.2, -1.1)] {
        let env = Environment::from_fn(512, at, |d| {
            let p = at + d * bvh.closest(at, d, 0.0, f32::MAX).unwrap().t;
            if p.x.abs() < 0.3 && (p.y - 1.05).abs() < 0.3 && p.z.abs() < 0.3 { own } else { around }
        });
        // The room's radiance is given, so that the box's outline is not mixed into it.
        let known = Known { faces: (0..6).map(|face| (face, around)).collect(), sky: None };
        let built = build(&faces, &env, None, &known, &Default::default(), |_| 0.0).unwrap();
        let mesh = &built.light.mesh;
        for i in (0..mesh.patches.len()).filter(|i| mesh.patches[*i].face >= 6) {
            let patch = &mesh.patches[i];
            for (e, l) in built.irradiance[i].into_iter().zip(around) {
                let e = e / (std::f32::consts::PI * l);
                assert!((e - 1.0).abs() < 1e-3, "irradiance of patch {i}: {e}");
            }
            // At the outline texels show box and room.
            let whole = patch.evidence == Evidence::Probe && (patch.radiance[0] / own[0] - 1.0).abs() < 1e-6;
            if whole {
                sides.insert(patch.face);
                for (r, rho) in patch.reflectance.into_iter().zip(rho) {
                    let r = r / rho;
                    assert!((r - 1.0).abs() < 1e-3, "reflectance of patch {i}: {r}");
                }
            }
        }
    }
    assert_eq!(sides.len(), 6, "every side is seen");
}

#[test]
fn a_good_model_explains_its_pictures_and_a_lamp_that_is_missing_shows() {
    use crate::illuminate::check::check;
    let (env, at) = (environment(Vec3::new(0.3, 0.6, -0.4)), Vec3::new(0.3, 0.6, -0.4));
    let built = built(&config::Illuminate::default());
    let figure = |c: &crate::illuminate::check::Check, name: &str| {
        c.figures.iter().find(|(n, _)| *n == name).map(|(_, v)| *v).unwrap()
    };
    let good = check(&built.light, &built.irradiance, &env, &built.distant_picture, None);
    assert!((figure(&good, "predicted_over_probe_power") - 1.0).abs() < 0.02);
    assert!(figure(&good, "probe_residual_median_stops") < 0.01);
    let mut dark = built.light.clone();
    dark.mesh.patches.iter_mut().filter(|p| p.radiance[0] > 5.0).for_each(|p| p.radiance = [0.5; 3]);
    let bad = check(&dark, &built.irradiance, &env, &built.distant_picture, None);
    assert!(figure(&bad, "predicted_over_probe_power") < 0.8);
    let towards_lamp = env.texel(Vec3::new(0.2, 1.9, 0.4).normalize());
    assert!(bad.probe_residual.pixels()[towards_lamp] > 4.0, "from {at}");
}

#[test]
fn a_lamp_shines_to_its_unseen_side_too() {
    // A box of light on a pole that the probe sees from one side and from below.
    let at = Vec3::new(0.3, 0.6, -0.4);
    let mut faces = room::faces(4.0, 2.5, 4.0);
    for mut f in room::faces(0.2, 0.2, 0.2) {
        f.vertices.reverse();
        f.vertices.iter_mut().for_each(|v| (v.x, v.y, v.z) = (v.x + 1.2, v.y + 1.2, v.z + 1.0));
        f.name = f.name.replace("room", "lamp");
        faces.push(f);
    }
    let triangles = crate::model::face::triangulate(&faces);
    let bvh = Bvh::new(&triangles.vertices, &triangles.triangles);
    let env = Environment::from_fn(512, at, |d| {
        let p = at + d * bvh.closest(at, d, 0.0, f32::MAX).unwrap().t;
        let lamp = (p.x - 1.2).abs() < 0.11 && (p.y - 1.3).abs() < 0.11 && (p.z - 1.0).abs() < 0.11;
        [if lamp { 60.0 } else { 0.5 }; 3]
    });
    let built = build(&faces, &env, None, &Known::default(), &Default::default(), |_| 0.0).unwrap();
    assert_eq!((built.figure("small_lamps"), built.figure("lamps_completed")), (Some(0.0), Some(1.0)));
    let mesh = &built.light.mesh;
    let lamp: Vec<usize> = (0..mesh.patches.len()).filter(|i| mesh.patches[*i].face >= 6).collect();
    // Borders of what is seen mix with what is behind.
    for &i in lamp.iter().filter(|i| mesh.patches[**i].evidence == Evidence::Gathered) {
        let l = mesh.patches[i].radiance[0];
        assert!((l / 60.0 - 1.0).abs() < 0.2, "{l} at {}", mesh.centroid(i));
    }
    let sent: f64 = lamp.iter().map(|&i| power(mesh, i)).sum();
    assert!((sent / (60.0 * 0.24) - 1.0).abs() < 0.2, "{sent}");
}

#[test]
fn a_small_lamp_gets_the_light_that_the_probe_blurs_beside_it() {
    // A box of light of 12 cm before a wall; the probe shows it as wide again as it is, and 2 cm beside where the model has it.
    let (at, lamp, radiance) = (Vec3::new(0.3, 0.6, -0.4), Vec3::new(1.2, 1.3, 1.6), 300.0f32);
    let mut faces = room::faces(4.0, 2.5, 4.0);
    for mut f in room::faces(0.12, 0.12, 0.12) {
        f.vertices.reverse();
        f.vertices.iter_mut().for_each(|v| {
            (v.x, v.y, v.z) =
                (v.x + f64::from(lamp.x), v.y - 0.06 + f64::from(lamp.y), v.z + f64::from(lamp.z));
        });
        f.name = f.name.replace("room", "lamp");
        faces.push(f);
    }
    let triangles = crate::model::face::triangulate(&faces);
    let bvh = Bvh::new(&triangles.vertices, &triangles.triangles);
    let view = (lamp - at).normalize();
    let beside = view.cross(Vec3::Y).normalize() * 0.02;
    let shows = |d: Vec3| {
        let d = (d - beside / lamp.distance(at)).normalize();
        (at + d * bvh.closest(at, d, 0.0, f32::MAX).unwrap().t).distance(lamp) < 0.11
    };
    let blur = 0.012f32;
    let env = Environment::from_fn(512, at, |d| {
        let (u, v) = d.any_orthonormal_pair();
        let mut light = 0.0;
        for i in 0..64 {
            // A disc of 2 σ has the variance σ² along each axis.
            let (r, turn) = (2.0 * blur * ((i as f32 + 0.5) / 64.0).sqrt(), 2.399_963 * i as f32);
            let near = (d + (u * turn.cos() + v * turn.sin()) * r).normalize();
            light += if shows(near) { radiance } else { 0.5 } / 64.0;
        }
        [light; 3]
    });
    let built =
        build(&faces, &env, None, &Known::default(), &Default::default(), |_| f64::from(blur)).unwrap();
    assert_eq!((built.figure("small_lamps"), built.figure("lamps_completed")), (Some(1.0), Some(0.0)));
    let mesh = &built.light.mesh;
    for p in &mesh.patches {
        match p.face {
            6.. => assert!((p.radiance[0] / radiance - 1.0).abs() < 0.05, "{:?}", p.radiance),
            // What nobody sees behind the lamp is lit by it.
            _ if p.evidence == Evidence::Gathered => {}
            _ => assert!(p.radiance[0] < 1.5, "the wall shows none of it: {:?}", p.radiance),
        }
    }
    let own: Vec<usize> = (0..mesh.patches.len()).filter(|i| mesh.patches[*i].face >= 6).collect();
    let area: f32 = own.iter().map(|i| mesh.area(*i)).sum();
    let middle: Vec3 = own.iter().map(|i| mesh.centroid(*i) * (mesh.area(*i) / area)).sum();
    assert!((middle - lamp - beside).length() < 4e-3, "{} of {beside}", middle - lamp);
}

#[test]
fn a_leg_before_the_border_of_a_bright_wall_is_no_lamp() {
    let (at, leg) = (Vec3::new(0.3, 0.6, -0.4), Vec3::new(1.2, 0.6, 1.6));
    let mut faces = room::faces(4.0, 2.5, 4.0);
    for mut f in room::faces(0.05, 1.0, 0.05) {
        f.vertices.reverse();
        f.vertices.iter_mut().for_each(|v| (v.x, v.z) = (v.x + f64::from(leg.x), v.z + f64::from(leg.z)));
        f.name = f.name.replace("room", "leg");
        faces.push(f);
    }
    let view = (leg - at).normalize();
    let side = view.cross(Vec3::Y).normalize();
    // Two fifths of what is beside the leg are sunlit; it hides the border.
    let env = Environment::from_fn(512, at, |d| {
        let (beside, ahead) = (d.dot(side), d.dot(view));
        [if beside.abs() < 0.011 && ahead > 0.0 {
            0.3
        } else if beside > 0.011 && beside < 0.3 && ahead > 0.8 {
            1.3
        } else {
            0.1
        }; 3]
    });
    let built = build(&faces, &env, None, &Known::default(), &Default::default(), |_| 0.012).unwrap();
    assert_eq!(built.figure("small_lamps"), Some(0.0));
}

#[test]
fn an_open_sky_becomes_distant_light_of_the_same_power() {
    let ground = vec![room::faces(10.0, 1.0, 10.0)[0].clone()];
    let env = Environment::from_fn(128, Vec3::new(0.0, 0.1, 0.0), |d| [if d.y > 0.0 { 2.0 } else { 0.3 }; 3]);
    let built =
        build(&ground, &env, None, &Known::default(), &config::Illuminate::default(), |_| 0.0).unwrap();
    let up: f64 = built
        .light
        .distant
        .iter()
        .filter(|s| s.direction.y > 0.02)
        .map(|s| f64::from(s.radiance[0]) * f64::from(s.solid_angle_sr))
        .sum();
    assert!((up / (4.0 * std::f64::consts::PI) - 1.0).abs() < 0.03, "{up}");
    // Under a sky of 2, ground of radiance 0.3 has reflectance 0.15.
    let near =
        (0..built.light.mesh.patches.len()).find(|&i| built.light.mesh.centroid(i).length() < 0.5).unwrap();
    assert!((built.light.mesh.patches[near].reflectance[0] - 0.15).abs() < 0.01);
}

#[test]
fn what_the_probe_does_not_see_gathers_light() {
    let mut faces = room::faces(4.0, 2.5, 4.0);
    let shelf = [[-1.0, 0.3], [-1.0, 0.9], [-0.5, 0.9], [-0.5, 0.3]];
    let corners = shelf.map(|[x, z]| nalgebra::Point3::new(x, 1.2, z)).to_vec();
    faces.push(Face { name: "shelf.top".into(), vertices: corners, gloss: None });
    let env = environment(Vec3::new(0.3, 0.6, -0.4));
    let light =
        build(&faces, &env, None, &Known::default(), &config::Illuminate::default(), |_| 0.0).unwrap().light;
    let top: Vec<_> = light.mesh.patches.iter().filter(|p| p.face == 6).collect();
    assert!(!top.is_empty() && top.iter().all(|p| p.evidence == Evidence::Gathered));
    assert!(top.iter().all(|p| p.radiance[0] > 0.2 && p.radiance[0] < 2.0 && p.reflectance == [0.5; 3]));
}

#[test]
fn refusals_say_why() {
    let env = environment(Vec3::new(0.0, 1.0, 0.0));
    let settings = config::Illuminate::default();
    let problem = |faces: &[Face], env: &Environment, s: &config::Illuminate| {
        build(faces, env, None, &Known::default(), s, |_| 0.0).map(|_| ()).unwrap_err()
    };
    assert_eq!(problem(&[], &env, &settings), Problem::NoFaces(0));
    let dark = Environment::from_fn(32, Vec3::Y, |_| [0.0; 3]);
    assert_eq!(problem(&room::faces(1., 1., 1.), &dark, &settings), Problem::Dark);
    let bad = config::Illuminate { max_edge_m: -1.0, ..settings };
    assert_eq!(
        problem(&room::faces(1., 1., 1.), &env, &bad),
        Problem::Setting { name: "max_edge_m", value: -1.0 }
    );
}

#[test]
fn known_light_is_not_found_a_second_time_beside_it() {
    // A lamp of 0.2 m hangs under the ceiling; the probe shows it wider than it is.
    let mut faces = room::faces(4.0, 2.5, 4.0);
    let at = |x: f64, z: f64| nalgebra::Point3::new(x, 2.4, z);
    faces.push(Face {
        name: "lamp".into(),
        vertices: vec![at(0.0, 0.0), at(0.2, 0.0), at(0.2, 0.2), at(0.0, 0.2)],
        gloss: None,
    });
    let origin = Vec3::new(0.3, 0.6, -0.4);
    let lamp = Vec3::new(0.1, 2.4, 0.1);
    let env = Environment::from_fn(256, origin, |d| {
        let p = origin + d * ((lamp.y - origin.y) / d.y);
        let near = d.y > 0.0 && (p.x - lamp.x).abs() < 0.13 && (p.z - lamp.z).abs() < 0.13;
        [if near { 50.0 } else { 0.5 }; 3]
    });
    let known = Known { faces: BTreeMap::from([(6, [50.0; 3])]), sky: None };
    let settings = config::Illuminate::default();
    let light = build(&faces, &env, None, &known, &settings, |_| 0.0).unwrap().light;
    let brightest = light.mesh.patches.iter().filter(|p| p.face != 6).map(|p| p.radiance[0]);
    assert!(brightest.fold(0.0, f32::max) < 0.6, "nothing but the lamp shines");
    let sent: f64 = (0..light.mesh.patches.len())
        .filter(|&i| light.mesh.patches[i].face == 6)
        .map(|i| power(&light.mesh, i))
        .sum();
    assert!((sent / (50.0 * 0.04) - 1.0).abs() < 1e-4, "{sent}");
}

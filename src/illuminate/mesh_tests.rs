use super::*;
use proptest::prelude::*;

fn rectangle(w: f64, d: f64) -> Face {
    let vertices =
        [[0.0, 0.0], [0.0, d], [w, d], [w, 0.0]].map(|[x, z]| Point3::new(x - 0.3, 0.1, z)).to_vec();
    Face { name: "floor".into(), vertices, gloss: None }
}

fn meshed(face: &Face, edge: f64) -> PatchMesh {
    let mut m = FaceMesh::new(face).unwrap();
    m.refine(|p| graded(edge, p));
    assemble(&[Some(m)])
}

fn smallest_angle(mesh: &PatchMesh, i: usize) -> f32 {
    let c = mesh.corners(i);
    let angle = |k: usize| (c[(k + 1) % 3] - c[k]).angle_between(c[(k + 2) % 3] - c[k]);
    (0..3).map(angle).fold(f32::MAX, f32::min)
}

fn total_area(mesh: &PatchMesh) -> f64 {
    (0..mesh.patches.len()).map(|i| f64::from(mesh.area(i))).sum()
}

fn check(face: &Face, mesh: &PatchMesh, edge: f64, angle_deg: f32) {
    assert!((total_area(mesh) / face.area() - 1.0).abs() < 1e-5, "areas sum to the face's");
    let normal = face.normal();
    let normal = Vec3::new(normal.x as f32, normal.y as f32, normal.z as f32);
    for i in 0..mesh.patches.len() {
        let [a, b, c] = mesh.corners(i);
        assert!((b - a).cross(c - a).dot(normal) > 0.0, "all patches face the front");
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        assert!(f64::from(longest) <= 1.001 * graded(edge, mesh.centroid(i)), "edge of {longest} m");
        assert!(smallest_angle(mesh, i).to_degrees() > angle_deg, "patch {i}: {:?}", mesh.corners(i));
    }
}

#[test]
fn a_floor_is_covered_without_slivers() {
    let face = rectangle(5.0, 4.0);
    let mesh = meshed(&face, 0.25);
    check(&face, &mesh, 0.25, 20.0);
    assert!(mesh.patches.len() < 3000, "{} patches", mesh.patches.len());
}

#[test]
fn a_skirting_board_is_covered_with_few_patches() {
    let face = rectangle(4.0, 0.016);
    let mesh = meshed(&face, 0.25);
    check(&face, &mesh, 0.25, 1.0);
    assert!(
        mesh.patches.len() < 120,
        "its height does not set the length of its patches: {}",
        mesh.patches.len()
    );
}

#[test]
fn wide_ground_is_coarse_far_away() {
    let face = rectangle(40.0, 40.0);
    let mesh = meshed(&face, 0.25);
    check(&face, &mesh, 0.25, 20.0);
    assert!(mesh.patches.len() < 6000, "{} patches", mesh.patches.len());
}

#[test]
fn faces_without_area_are_left_out() {
    let line = Face {
        name: "l".into(),
        vertices: vec![Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(2.0, 0.0, 0.0)],
        gloss: None,
    };
    assert!(FaceMesh::new(&line).is_none());
    let point = Face { name: "p".into(), vertices: vec![Point3::origin(); 4], gloss: None };
    assert!(FaceMesh::new(&point).is_none());
}

#[test]
fn what_lies_under_another_face_in_its_plane_is_left_out() {
    let floor = rectangle(4.0, 4.0);
    let rug = |height: f64, reversed: bool| {
        let mut face = rectangle(1.0, 1.0);
        face.vertices.iter_mut().for_each(|v| (v.x, v.y, v.z) = (v.x + 1.0, v.y + height, v.z + 1.0));
        if reversed {
            face.vertices.reverse();
        }
        face
    };
    let area = |rug: &Face| {
        let meshed = |face: &Face| {
            let mut m = FaceMesh::new(face).unwrap();
            m.refine(|_| 0.05);
            m
        };
        total_area(&assemble(&[Some(meshed(&floor)), Some(meshed(rug))]))
    };
    // But for a strip at its border, which its own patches do not cover wholly.
    assert!((16.0..16.25).contains(&area(&rug(0.0, false))), "{}", area(&rug(0.0, false)));
    assert!((area(&rug(0.01, false)) - 17.0).abs() < 1e-4, "a table top stands above the floor");
    assert!((area(&rug(0.0, true)) - 17.0).abs() < 1e-4, "the other side of a sheet is another surface");
}

#[test]
fn no_ray_leaves_a_room_by_an_edge_whose_faces_are_cut_differently() {
    let faces = crate::illuminate::room::faces(4.0, 2.5, 4.0);
    let meshes: Vec<_> = faces
        .iter()
        .enumerate()
        .map(|(i, f)| {
            let mut m = FaceMesh::new(f).unwrap();
            m.refine(|_| [0.07, 0.31, 0.9, 0.2, 0.53, 1.3][i]);
            Some(m)
        })
        .collect();
    let mesh = assemble(&meshes);
    let bvh = crate::visibility::Bvh::new(&mesh.vertices, &mesh.triangles());
    let eye = Vec3::new(0.37, 1.1, -0.53);
    let corner = |i: usize| Vec3::new([-2.0, 2.0][i & 1], [0.0, 2.5][i >> 1 & 1], [-2.0, 2.0][i >> 2]);
    let centre = Vec3::new(0.0, 1.25, 0.0);
    let (mut lost, mut all) = (0, 0);
    for (a, b) in (0..8).flat_map(|a| [1, 2, 4].map(|bit| (a, a | bit))).filter(|(a, b)| a < b) {
        for i in 0..2000 {
            let edge = corner(a).lerp(corner(b), (i as f32 + 0.5) / 2000.0);
            // At the very edge rounding decides whether a ray is aimed into the room at all.
            let p = edge + (centre - edge).normalize() * 1e-4;
            all += 1;
            lost += usize::from(bvh.closest(eye, (p - eye).normalize(), 0.0, f32::MAX).is_none());
        }
    }
    assert!(all == 24_000 && lost == 0, "{lost} of {all}");
}

#[test]
fn refinement_is_local() {
    let mut m = FaceMesh::new(&rectangle(4.0, 4.0)).unwrap();
    m.refine(|_| 0.5);
    let before = assemble(&[Some(m.clone())]).patches.len();
    m.refine(|p| if p.distance(Vec3::new(0.5, 0.1, 0.5)) < 0.3 { 0.05 } else { 0.5 });
    let mesh = assemble(&[Some(m)]);
    assert!(mesh.patches.len() > before + 50 && mesh.patches.len() < 3000);
    let far = (0..mesh.patches.len()).filter(|&i| mesh.centroid(i).distance(Vec3::new(3.5, 0.1, 3.5)) < 1.0);
    assert!(far.clone().count() < 100, "{}", far.count());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_convex_face_is_covered(
        angles in proptest::collection::btree_set(0u32..360, 3..8),
        tilt in 0.0..3.0f64, stretch in 0.2..1.0f64,
    ) {
        let turn = nalgebra::Rotation3::new(Vector3::new(tilt, 0.3, -tilt));
        let vertices: Vec<_> = angles.iter().map(|a| {
            let (s, c) = f64::from(*a).to_radians().sin_cos();
            turn * Point3::new(c, stretch * s, 0.2)
        }).collect();
        let face = Face { name: "f".into(), vertices, gloss: None };
        prop_assume!(face.area() > 0.05);
        let mesh = meshed(&face, 0.2);
        prop_assert!((total_area(&mesh) / face.area() - 1.0).abs() < 1e-4);
        for i in 0..mesh.patches.len() {
            prop_assert!(mesh.area(i) > 0.0 && mesh.area(i).is_finite());
        }
    }
}

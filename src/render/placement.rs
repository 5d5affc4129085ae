//! Where the object stands.

use super::Problem;
use super::object::{Object, bounds};
use crate::calibrate::world_from_grid;
use crate::camera::Camera;
use crate::config;
use crate::visibility::Bvh;
use glam::{DAffine3, DQuat, DVec3, Vec3};
use nalgebra::Point3;
use std::f64::consts::FRAC_PI_2;

/// File frame to world frame: upright, scaled, turned about the grid's z, moved, then grid to world.
pub fn world_from_object(settings: &config::Render) -> Result<glam::Affine3A, Problem> {
    let refuse = |name, value, expected| Err(Problem::Setting { name, value, expected });
    if !(settings.scale > 0.0 && settings.scale.is_finite()) {
        return refuse("scale", settings.scale, "a finite number above 0");
    }
    if let Some(bad) = settings.position_m.iter().find(|v| !v.is_finite()) {
        return refuse("position_m", *bad, "finite numbers");
    }
    if !settings.rotation_deg.is_finite() {
        return refuse("rotation_deg", settings.rotation_deg, "a finite number");
    }
    let upright = if settings.y_up { DQuat::from_rotation_x(FRAC_PI_2) } else { DQuat::IDENTITY };
    let grid_from_object = DAffine3::from_scale_rotation_translation(
        DVec3::splat(settings.scale),
        DQuat::from_rotation_z(settings.rotation_deg.to_radians()) * upright,
        DVec3::from_array(settings.position_m),
    );
    let grid = world_from_grid();
    let world_from_grid = DAffine3::from_rotation_translation(
        DQuat::from_array(grid.rotation.coords.into()),
        DVec3::from_array(grid.translation.vector.into()),
    );
    Ok((world_from_grid * grid_from_object).as_affine3a())
}

/// Rigid motions that take the object from where the settings place it to each pose of their path.
pub fn motions(settings: &config::Render) -> Result<Vec<glam::Affine3A>, Problem> {
    let object_from_world = world_from_object(settings)?.inverse();
    let motion = |pose: &config::Pose| {
        let (position_m, rotation_deg) = (pose.position_m, pose.rotation_deg);
        let there = config::Render { position_m, rotation_deg, ..settings.clone() };
        Ok(world_from_object(&there)? * object_from_world)
    };
    settings.path.iter().map(motion).collect()
}

/// Refuses an object that cannot be seen or stands outside the scene; warns of one that sinks into its support.
/// `scene` holds the corners of the scene model's faces, `scene_bvh` its triangles.
pub fn check_placement(
    object: &Object,
    camera: &Camera,
    scene: &[Vec3],
    scene_bvh: &Bvh,
) -> Result<Vec<String>, Problem> {
    check_scene(object, scene, scene_bvh)?;
    check_view(object, camera)?;
    Ok(sinking(object, scene_bvh).into_iter().collect())
}

/// Beside or below everything, or above the ceiling. An object may float above an open scene.
fn check_scene(object: &Object, scene: &[Vec3], scene_bvh: &Bvh) -> Result<(), Problem> {
    if scene.is_empty() {
        return Ok(());
    }
    let ([low, high], [scene_low, scene_high]) = (object.bounds(), bounds(scene));
    for (k, axis) in ['x', 'y', 'z'].into_iter().enumerate() {
        let below = high[k] < scene_low[k];
        let mut above = low[k] > scene_high[k];
        if axis == 'y' && above {
            // Between floor and object there is a ceiling, or just air.
            let down = |x: f32, z: f32| {
                let from = Vec3::new(x, low.y, z);
                let mut t = 1e-4;
                let mut surfaces = 0;
                while let Some(hit) = scene_bvh.closest(from, -Vec3::Y, t, f32::INFINITY) {
                    surfaces += 1;
                    t = hit.t + 1e-4;
                }
                surfaces
            };
            above = down((low.x + high.x) / 2.0, (low.z + high.z) / 2.0) >= 2;
        }
        if below || above {
            return Err(Problem::OutsideScene {
                axis,
                object_m: [low[k], high[k]],
                scene_m: [scene_low[k], scene_high[k]],
            });
        }
    }
    Ok(())
}

fn check_view(object: &Object, camera: &Camera) -> Result<(), Problem> {
    let (mut x_px, mut y_px) = ([f64::INFINITY, f64::NEG_INFINITY], [f64::INFINITY, f64::NEG_INFINITY]);
    let mut nearest_m = f64::NEG_INFINITY;
    let mut all_before = true;
    for v in &object.vertices {
        let p = camera.world_from_camera.inverse_transform_point(&Point3::from(v.as_dvec3().to_array()));
        nearest_m = nearest_m.max(p.z);
        match camera.intrinsics.project(&p) {
            Some(pixel) => {
                x_px = [x_px[0].min(pixel.x), x_px[1].max(pixel.x)];
                y_px = [y_px[0].min(pixel.y), y_px[1].max(pixel.y)];
            }
            None => all_before = false,
        }
    }
    if nearest_m <= 0.0 {
        return Err(Problem::BehindCamera { nearest_m });
    }
    let size_px = [camera.intrinsics.width_px, camera.intrinsics.height_px];
    let misses = |[low, high]: [f64; 2], size: u32| high < 0.0 || low > f64::from(size);
    if all_before && (misses(x_px, size_px[0]) || misses(y_px, size_px[1])) {
        return Err(Problem::OutsideView { x_px, y_px, size_px });
    }
    Ok(())
}

/// More than a millimetre below the first surface under the object's top.
fn sinking(object: &Object, scene_bvh: &Bvh) -> Option<String> {
    let [low, high] = object.bounds();
    let top = Vec3::new((low.x + high.x) / 2.0, high.y, (low.z + high.z) / 2.0);
    let hit = scene_bvh.closest(top, -Vec3::Y, 0.0, f32::INFINITY)?;
    let depth = top.y - hit.t - low.y;
    (depth > 1e-3).then(|| {
        format!("the object sinks {:.1} mm below the surface it stands on; that part is hidden", depth * 1e3)
    })
}

#[cfg(test)]
mod tests {
    use super::super::object::{Material, Soup};
    use super::*;
    use crate::camera::Intrinsics;
    use nalgebra::{Isometry3, Vector3};

    /// A triangle of side 0.2 m in a horizontal plane at `centre`, with an apex 0.1 m above.
    fn object(centre: Vec3) -> Object {
        let mut soup = Soup {
            positions: [[-0.1, 0.0, -0.1], [0.1, 0.0, -0.1], [0.0, 0.0, 0.1], [0.0, 0.1, 0.0]]
                .map(|p| Vec3::from_array(p) + centre)
                .to_vec(),
            materials: vec![Material {
                diffuse: [0.5; 3],
                specular: [0.0; 3],
                shininess: 1.0,
                roughness: None,
            }],
            ..Soup::default()
        };
        for t in [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]] {
            soup.add_polygon(&t, None, 0);
        }
        Object::new(soup, 0.5).unwrap()
    }

    /// Floor at y = 0 and ceiling at y = 3, 4 m × 4 m.
    fn room(ceiling: bool) -> (Vec<Vec3>, Bvh) {
        let mut v = vec![];
        for y in [0.0, 3.0] {
            v.extend([[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]].map(|[x, z]| Vec3::new(x, y, z)));
        }
        let mut t = vec![[0, 1, 2], [0, 2, 3]];
        if ceiling {
            t.extend([[4, 5, 6], [4, 6, 7]]);
        } else {
            v.truncate(4);
        }
        let bvh = Bvh::new(&v, &t);
        (v, bvh)
    }

    /// Looks along +Z from (0, 1, −2).
    fn camera() -> Camera {
        let upright = Isometry3::rotation(Vector3::z() * std::f64::consts::PI);
        Camera {
            intrinsics: Intrinsics::pinhole(640, 480, 600.0),
            world_from_camera: Isometry3::translation(0.0, 1.0, -2.0) * upright,
        }
    }

    fn check(centre: Vec3, ceiling: bool) -> Result<Vec<String>, Problem> {
        let (corners, bvh) = room(ceiling);
        check_placement(&object(centre), &camera(), &corners, &bvh)
    }

    #[test]
    fn an_object_on_the_floor_is_fine_and_one_in_it_is_warned_of() {
        assert_eq!(check(Vec3::new(0.0, 0.0, 1.0), true).unwrap(), Vec::<String>::new());
        assert_eq!(check(Vec3::new(0.0, 1.0, 1.0), false).unwrap(), Vec::<String>::new());
        let sunk = check(Vec3::new(0.0, -0.025, 1.0), true).unwrap();
        assert!(sunk[0].contains("sinks 25.0 mm"), "{sunk:?}");
    }

    #[test]
    fn a_path_moves_the_object_to_its_poses() {
        let pose = |position_m, rotation_deg| config::Pose { position_m, rotation_deg };
        let path = vec![pose([1.0, 2.0, 0.0], 30.0), pose([1.0, 2.0, 0.5], 120.0)];
        let settings = config::Render {
            position_m: [1.0, 2.0, 0.0],
            rotation_deg: 30.0,
            scale: 2.0,
            path,
            ..Default::default()
        };
        let motions = motions(&settings).unwrap();
        let at = world_from_object(&settings).unwrap().transform_point3(Vec3::X);
        assert!(motions[0].transform_point3(at).distance(at) < 1e-5, "where it stands");
        // The grid's (x, y, z) is the world's (x, z, −y): half a metre up, a quarter turn about the object's origin.
        let origin = Vec3::new(1.0, 0.5, -2.0);
        let turned = motions[1].transform_point3(at) - origin;
        assert!(
            (turned.length() - 2.0).abs() < 1e-5 && turned.dot(at - Vec3::new(1.0, 0.0, -2.0)).abs() < 1e-4
        );
    }

    #[test]
    fn outside_the_room_is_refused_by_axis() {
        for (centre, expected) in [
            (Vec3::new(2.5, 0.0, 1.0), 'x'),
            (Vec3::new(0.0, -0.5, 1.0), 'y'),
            (Vec3::new(0.0, 3.5, 1.0), 'y'),
            (Vec3::new(0.0, 0.0, 5.0), 'z'),
        ] {
            match check(centre, true) {
                Err(Problem::OutsideScene { axis, .. }) => assert_eq!(axis, expected),
                other => panic!("{centre}: {other:?}"),
            }
        }
        assert!(
            !matches!(check(Vec3::new(0.0, 3.5, 1.9), false), Err(Problem::OutsideScene { .. })),
            "above open ground is not outside"
        );
    }

    #[test]
    fn outside_the_view_is_refused_with_pixels() {
        assert!(matches!(check(Vec3::new(-1.8, 0.0, -1.5), true), Err(Problem::OutsideView { .. })));
        let mut turned = camera();
        turned.world_from_camera.rotation *=
            nalgebra::UnitQuaternion::from_scaled_axis(Vector3::y() * std::f64::consts::PI);
        let (corners, bvh) = room(true);
        let e = check_placement(&object(Vec3::new(0.0, 0.0, 1.0)), &turned, &corners, &bvh).unwrap_err();
        assert!(
            e.to_string().starts_with("object behind the camera: its nearest point has depth -2.9"),
            "{e}"
        );
    }
}

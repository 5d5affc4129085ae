//! Synthetic rooms with clutter, whose faces must be found where they are, and pictures without a room.

use super::*;
use crate::annotations::{Annotations, Primitive};
use crate::exposure::Photograph;
use crate::image::{Code, Image};
use crate::model::{self, FaceSource, Scene, Views};
use nalgebra::{Point2, Point3, Rotation3, Vector3};
use rand::{Rng, SeedableRng, rngs::SmallRng};
use std::collections::BTreeMap;
use std::path::Path;

const SIZE: (usize, usize) = (640, 480);

/// What a picture shows: the inside of a box with things in it, in axes of its own, turned in the world.
struct Place {
    /// x, z of the room's left and back, right and front; its height, m.
    walls: [[f64; 2]; 2],
    height: f64,
    turn_deg: f64,
    /// Lowest and highest corners of boxes.
    things: Vec<[[f64; 3]; 2]>,
    skirting_m: f64,
    /// Ground and sky instead of walls.
    outdoors: bool,
}

fn lit(colour: [f64; 3], light: f64) -> [f64; 3] {
    colour.map(|c| c * light)
}

impl Place {
    fn room() -> Self {
        Self {
            walls: [[-2.2, -2.6], [2.0, 2.4]],
            height: 2.5,
            turn_deg: 20.0,
            things: vec![
                [[-2.1, 0.0, -1.4], [-1.6, 1.1, -0.5]],
                [[-0.6, 0.0, -2.5], [0.5, 0.75, -1.9]],
                [[0.9, 0.0, -1.2], [1.3, 0.4, -0.8]],
            ],
            skirting_m: 0.0,
            outdoors: false,
        }
    }

    /// Colour of what a ray meets, both in the place's axes.
    fn colour(&self, from: &Point3<f64>, ray: &Vector3<f64>) -> [f64; 3] {
        let mut nearest: Option<(f64, [f64; 3])> = None;
        let mut meet = |far: f64, colour: [f64; 3]| {
            if far > 1e-6 && nearest.is_none_or(|n| far < n.0) {
                nearest = Some((far, colour));
            }
        };
        for (k, thing) in self.things.iter().enumerate() {
            for (axis, end) in (0..3).flat_map(|a| [(a, 0), (a, 1)]) {
                let far = (thing[end][axis] - from[axis]) / ray[axis];
                let at = from + ray * far;
                let inside =
                    (0..3).filter(|a| *a != axis).all(|a| at[a] > thing[0][a] && at[a] < thing[1][a]);
                if inside && far.is_finite() {
                    let base = [[0.5, 0.35, 0.2], [0.25, 0.4, 0.6], [0.35, 0.45, 0.3]][k % 3];
                    meet(far, lit(base, [0.8, 1.0, 0.6][axis]));
                }
            }
        }
        let floor = -from.y / ray.y;
        let at = from + ray * floor;
        // Tiles with dark grooves, each a little different.
        let tile = (at.x / 0.4).floor() + 7.0 * (at.z / 0.4).floor();
        let groove = [at.x, at.z].iter().any(|v| (v / 0.4).rem_euclid(1.0) < 0.03);
        let shade = if groove { 0.5 } else { 0.95 + 0.05 * (tile * 1.7).sin() };
        meet(floor, lit([0.62, 0.58, 0.52], shade));
        if !self.outdoors {
            meet((self.height - from.y) / ray.y, [0.82, 0.82, 0.8]);
            for (axis, end) in [(0, 0), (0, 1), (2, 0), (2, 1)] {
                let far = (self.walls[end][axis / 2] - from[axis]) / ray[axis];
                let at = from + ray * far;
                let base = if at.y < self.skirting_m { [0.9, 0.9, 0.88] } else { [0.45, 0.55, 0.65] };
                let light = [0.75, 0.9, 1.0, 0.85][axis + end];
                // A picture on the wall at the back.
                let picture = axis == 2 && end == 0 && (at.x - 1.0).abs() < 0.35 && (at.y - 1.5).abs() < 0.25;
                meet(far, if picture { [0.6, 0.2, 0.15] } else { lit(base, light) });
            }
        }
        nearest.map_or([0.7, 0.8, 0.95], |n| n.1)
    }

    fn own_from_world(&self) -> Rotation3<f64> {
        Rotation3::from_axis_angle(&Vector3::y_axis(), -self.turn_deg.to_radians())
    }

    /// What the camera sees, with noise of 2 %.
    fn photograph(&self, camera: &Camera) -> Photograph {
        let turn = self.own_from_world();
        let from = turn * camera.centre();
        let mut rng = SmallRng::seed_from_u64(3);
        let mut noise = || 0.02 * (0..3).map(|_| rng.random_range(-1.0..1.0)).sum::<f64>();
        Photograph::Codes(Image::from_fn(SIZE.0, SIZE.1, |x, y| {
            let mut sum = [0.0; 3];
            for (u, v) in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)] {
                let ray = camera.ray(&Point2::new(x as f64 + u, y as f64 + v)).direction.into_inner();
                let colour = self.colour(&from, &(turn * ray));
                (0..3).for_each(|k| sum[k] += colour[k] / 4.0);
            }
            Code(sum.map(|c| (c + noise()).clamp(0.0, 1.0) as f32))
        }))
    }

    /// Distance of a wall from the camera, by axis (0: x, 1: z) and end, m.
    fn distance(&self, camera: &Camera, axis: usize, end: usize) -> f64 {
        let from = self.own_from_world() * camera.centre();
        (self.walls[end][axis] - from[2 * axis]).abs()
    }
}

/// A camera in the place's own axes.
fn camera(place: &Place, from: [f64; 3], to: [f64; 3], focal_px: f64) -> Camera {
    let world = |p: [f64; 3]| (place.own_from_world().inverse() * Point3::from(p)).into();
    crate::synthetic::camera(world(from), world(to), SIZE.0 as u32, SIZE.1 as u32, focal_px)
}

fn room(more: &str) -> Primitive {
    let text = format!("[[primitive]]\nname = \"room\"\nkind = \"room\"\nsearch = true\n{more}");
    let mut read: Annotations = config::parse(&text, Path::new("annotations.toml")).unwrap();
    read.primitive.remove(0)
}

fn fitted(
    primitive: Primitive,
    place: &Place,
    camera: &Camera,
) -> std::result::Result<Scene, model::Problem> {
    let plate = || Ok(place.photograph(camera));
    let settings = config::Model::default();
    let (primitives, rooms) =
        searched(&[primitive], ("plate.jpg", camera), plate, 0.0, &settings).expect("no file is read")?;
    let cameras = BTreeMap::from([("plate.jpg".to_string(), camera.clone())]);
    model::fit(&primitives, &Views { cameras: &cameras, ball: None, ground_y: 0.0, rooms: &rooms }, &settings)
}

/// Faces that the plate tells are within 2 % of 5 m and four standard deviations of the true ones.
fn check(scene: &Scene, expected: &[(&str, f64)]) {
    let faces = &scene.primitives[0].faces;
    for (side, distance) in expected {
        let face = faces.iter().find(|f| f.side == *side).unwrap();
        assert_eq!(face.source, FaceSource::Plate, "{side}: {faces:?}");
        let off = (face.distance_m - distance).abs();
        assert!(off < 0.1 && off < 4.0 * face.sigma_m, "{side}: {face:?}, is at {distance}");
    }
    let told = faces.iter().filter(|f| f.source == FaceSource::Plate).count();
    assert_eq!(told, expected.len(), "{faces:?}");
}

#[test]
fn a_room_with_furniture_is_found_and_the_rest_is_presumed() {
    let place = Place::room();
    let camera = camera(&place, [1.2, 1.5, 1.6], [-0.9, 0.4, -1.6], 560.0);
    let scene = fitted(room("yaw = \"free\"\n"), &place, &camera).unwrap();
    let [left, back] = [(0, 0), (1, 0)].map(|(axis, end)| place.distance(&camera, axis, end));
    check(&scene, &[("left", left), ("back", back)]);
    let ceiling = scene.primitives[0].faces.iter().find(|f| f.side == "ceiling").unwrap();
    assert_eq!(ceiling.source, FaceSource::Presumed);
    assert!((ceiling.distance_m - 1.1).abs() < 0.2 && ceiling.sigma_m > 0.3, "{ceiling:?}");
}

#[test]
fn three_walls_and_a_ceiling_are_found() {
    let place = Place::room();
    let camera = camera(&place, [0.1, 1.3, 2.2], [-0.1, 1.2, -2.6], 330.0);
    let scene = fitted(room("yaw = \"free\"\n"), &place, &camera).unwrap();
    let [left, right, back] = [(0, 0), (0, 1), (1, 0)].map(|(a, e)| place.distance(&camera, a, e));
    check(&scene, &[("left", left), ("right", right), ("back", back), ("ceiling", 1.2)]);
}

#[test]
fn the_foot_of_a_wall_is_that_of_its_skirting_board() {
    let place = Place { skirting_m: 0.12, ..Place::room() };
    let camera = camera(&place, [1.2, 1.5, 1.6], [-0.9, 0.4, -1.6], 560.0);
    let scene = fitted(room("yaw = \"free\"\n"), &place, &camera).unwrap();
    let [left, back] = [(0, 0), (1, 0)].map(|(axis, end)| place.distance(&camera, axis, end));
    check(&scene, &[("left", left), ("back", back)]);
}

#[test]
fn a_known_turn_and_sizes_name_the_faces() {
    let place = Place::room();
    let camera = camera(&place, [1.2, 1.5, 1.6], [-0.9, 0.4, -1.6], 560.0);
    // The room's own left and back are the place's back and right by a quarter turn to the left.
    let turned = room("turn_deg = 110.0\nsize_m = [5.0, 2.5, 4.2]\n");
    let scene = fitted(turned, &place, &camera).unwrap();
    let [left, back] = [(0, 0), (1, 0)].map(|(axis, end)| place.distance(&camera, axis, end));
    let faces = &scene.primitives[0].faces;
    assert_eq!(scene.primitives[0].size_m, [5.0, 2.5, 4.2]);
    assert!(faces.iter().all(|f| f.source != FaceSource::Presumed), "{faces:?}");
    let near = |side: &str, distance: f64| {
        let face = faces.iter().find(|f| f.side == side).unwrap();
        assert!((face.distance_m - distance).abs() < 0.1, "{side}: {face:?}, is at {distance}");
    };
    near("front", 4.2 - left);
    near("back", left);
    near("right", back);
    near("left", 5.0 - back);
}

#[test]
fn what_is_no_room_is_refused_with_its_share() {
    let place = Place { outdoors: true, ..Place::room() };
    let camera = camera(&place, [1.2, 1.5, 1.6], [-0.9, 0.4, -1.6], 560.0);
    let refused = fitted(room("yaw = \"free\"\n"), &place, &camera).unwrap_err();
    let model::Problem::Room { problem: Problem::NoRoom(weak), .. } = &refused else { panic!("{refused}") };
    assert!(
        weak.walls < 2 || weak.foot < LEAST_FOOT || weak.corner < LEAST_CORNER || weak.colour < LEAST_COLOUR,
        "{refused}"
    );
}

#[test]
fn a_picture_of_nothing_is_refused() {
    let place = Place::room();
    let camera = camera(&place, [1.2, 1.5, 1.6], [-0.9, 0.4, -1.6], 560.0);
    let mut rng = SmallRng::seed_from_u64(5);
    let noise =
        Image::from_fn(SIZE.0, SIZE.1, |_, _| Code([0.0; 3].map(|_: f32| rng.random_range(0.2..0.8))));
    let photograph = Photograph::Codes(noise);
    let found =
        find(&room("yaw = \"free\"\n"), "plate.jpg", &photograph, &camera, 0.0, &config::Model::default());
    assert!(matches!(found, Err(Problem::Directions(calibrate::Problem::NoRoom { .. }))), "{found:?}");
}

#[test]
fn only_rooms_are_searched_and_from_above_their_floor() {
    let place = Place::room();
    let camera = camera(&place, [1.2, 1.5, 1.6], [-0.9, 0.4, -1.6], 560.0);
    let thing = Primitive { kind: Kind::Box, ..room("") };
    assert!(matches!(fitted(thing, &place, &camera), Err(model::Problem::Search { .. })));
    let below = Primitive { level_m: 2.0, ..room("") };
    let refused = fitted(below, &place, &camera).unwrap_err();
    assert!(refused.to_string().contains("the camera is -0.50 m over the room's floor"), "{refused}");
}

//! The light dome: as a method for stills against the ray-traced reference on the same model; live on a rendered film with truth.

mod room;

use glam::Vec3;
use insitu::composite::write_png;
use insitu::config::{Pipeline, Render, ShadowMethod};
use insitu::dome::{CubeMap, irradiance};
use insitu::error::Problem as _;
use insitu::exposure::{Photograph, decode};
use insitu::illuminate::patch::{DistantSource, LightModel};
use insitu::image::{Code, CodeImage, Image, RadianceImage, luminance};
use insitu::live::{Live, Output, Phantoms, Sight};
use insitu::render::load_object;
use insitu::response::Response;
use insitu::shadow::{Problem, removed_radiance};
use insitu::subtractive::Surface;
use insitu::synthetic::table;
use insitu::visibility::Bvh;
use insitu::vision::{Expected, markers};
use nalgebra::{Isometry3, Point2, Point3};
use room::{Stage, camera, cuboid, errors, face, object, stage};
use std::path::{Path, PathBuf};

fn settings() -> Render {
    Render { method: ShadowMethod::LightDome, ..Default::default() }
}

#[test]
fn centroids_and_splits_come_nearer_to_the_reference() {
    let stage = stage(0.2, 128, 1.0);
    let slow = Render { method: ShadowMethod::Raytraced, rays: 512, ..Default::default() };
    let reference = removed_radiance(&stage.scene(), &object(), &slow).unwrap();
    let error = |settings: Render| {
        let found = removed_radiance(&stage.scene(), &object(), &settings).unwrap();
        let (error, bias) = errors(&stage.plate, &found.epsilon, &reference.epsilon);
        println!("{} lights: error {error:.3}, bias {bias:+.3}", found.sources_used);
        assert!(bias.abs() < 0.12, "{bias}");
        error
    };
    for (dome_texels, bounds) in [(2, [0.45, 0.12]), (4, [0.2, 0.08]), (8, [0.1, 0.05])] {
        let plain = error(Render { dome_texels, dome_centroid: false, dome_splits: 0, ..settings() });
        let split = error(Render { dome_texels, ..settings() });
        assert!(plain < bounds[0] && split < bounds[1] && split < 0.55 * plain, "{plain} {split}");
    }
}

/// A floor under a dim sky and a sun.
fn sunny(sun: Vec3) -> Stage {
    let sun = DistantSource { direction: sun.normalize(), solid_angle_sr: 1e-3, radiance: [3e3; 3] };
    let around = (0..200).map(|i| {
        let (a, y) = (i as f32 * 2.399_963, (i as f32 + 0.5) / 200.0);
        let direction = Vec3::new((1.0 - y * y).sqrt() * a.cos(), y, (1.0 - y * y).sqrt() * a.sin());
        DistantSource { direction, solid_angle_sr: std::f32::consts::TAU / 200.0, radiance: [0.3; 3] }
    });
    let mut light = LightModel { distant: around.chain([sun]).collect(), ..Default::default() };
    face(&mut light.mesh, Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, 0.1, |_| [0.1; 3]);
    let share = insitu::config::Transfer { source_share: 1.0, ..Default::default() };
    Stage::new(light, &camera([0.3, 0.9, 0.9], [0.0, 0.0, 0.0], 128, 96, 130.0), &share)
}

#[test]
fn a_small_bright_light_between_two_of_the_dome_is_cured_by_each_option() {
    let object = cuboid(Vec3::new(0.0, 0.15, 0.0), Vec3::new(0.05, 0.15, 0.05));
    // Off the middle of its texel, and on the border of two.
    for sun in [Vec3::new(0.36, 1.0, 0.1), Vec3::new(0.5, 1.0, 0.28)] {
        let stage = sunny(sun);
        let slow = Render { method: ShadowMethod::Raytraced, rays: 512, ..Default::default() };
        let reference = removed_radiance(&stage.scene(), &object, &slow).unwrap();
        let error = |dome_centroid, dome_splits| {
            let settings = Render { dome_texels: 4, dome_centroid, dome_splits, ..settings() };
            let found = removed_radiance(&stage.scene(), &object, &settings).unwrap();
            errors(&stage.plate, &found.epsilon, &reference.epsilon).0
        };
        let [plain, centroid, split] = [error(false, 0), error(true, 0), error(true, 16)];
        println!("plain {plain:.3}, at centroids {centroid:.3}, split {split:.3}");
        assert!(centroid < 0.6 * plain && split < 0.5 * plain, "{plain} {centroid} {split}");
    }
}

#[test]
fn a_near_lamp_stands_on_the_face_that_shines() {
    // A lamp with four bright sides near the object, one edge towards it.
    let mut light = sunny(Vec3::Y).light;
    light.distant.pop();
    let corner = |k: i32| {
        let angle = (k as f32 + 0.1) * std::f32::consts::FRAC_PI_2 + 2.9;
        Vec3::new(0.42 + 0.09 * angle.cos(), 0.2, 0.13 + 0.09 * angle.sin())
    };
    for k in 0..4 {
        face(&mut light.mesh, corner(k), Vec3::Y * 0.2, corner(k + 1) - corner(k), 0.05, |_| [40.0; 3]);
    }
    let share = insitu::config::Transfer { source_share: 1.0, ..Default::default() };
    let stage = Stage::new(light, &camera([0.3, 0.9, 0.9], [0.0, 0.0, 0.0], 128, 96, 130.0), &share);
    let object = cuboid(Vec3::new(0.0, 0.1, 0.0), Vec3::new(0.05, 0.1, 0.05));
    let slow = Render { method: ShadowMethod::Raytraced, rays: 512, ..Default::default() };
    let reference = removed_radiance(&stage.scene(), &object, &slow).unwrap();
    for (dome_texels, dome_splits, bound) in [(4, 0, 0.4), (8, 0, 0.3), (8, 16, 0.2)] {
        let settings = Render { dome_texels, dome_splits, ..settings() };
        let found = removed_radiance(&stage.scene(), &object, &settings).unwrap();
        let (error, bias) = errors(&stage.plate, &found.epsilon, &reference.epsilon);
        println!("{dome_texels} texels, {dome_splits} split: error {error:.3}, bias {bias:+.3}");
        assert!(error < bound && bias.abs() < 0.1, "{error} {bias}");
    }
}

#[test]
fn no_more_is_removed_than_was_there_and_nothing_far_from_the_object() {
    room::removes_no_more_than_was_there(&settings());
}

#[test]
fn bad_settings_and_darkness_are_refused() {
    let stage = stage(0.8, 40, 0.9);
    let refused = |settings: Render| removed_radiance(&stage.scene(), &object(), &settings).unwrap_err();
    let odd = refused(Render { dome_texels: 6, ..settings() });
    assert_eq!(odd.to_string(), "dome_texels is 6, which is not 1, 2, 4, 8, 16 or 32");
    let mut dark = stage.light.clone();
    dark.mesh.patches.iter_mut().for_each(|p| p.radiance = [0.0; 3]);
    let scene = insitu::shadow::Scene { light: &dark, ..stage.scene() };
    let error = removed_radiance(&scene, &object(), &settings()).unwrap_err();
    assert!(matches!(error, Problem::Dark), "{error}");
}

/// Of the film's frames.
const FIRST_AFTER_START: usize = 5;

fn sequence() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/sequence")
}

fn codes(path: &Path) -> CodeImage {
    match decode(path).unwrap() {
        Photograph::Codes(codes) => codes,
        Photograph::Linear(_) => panic!("{} is linear", path.display()),
    }
}

/// A film of the sequence in one of its set-ups.
struct Film {
    live: Live,
    second: Option<&'static str>,
}

impl Film {
    fn new(name: &str, change: impl FnOnce(&mut Pipeline)) -> Self {
        let folder = sequence();
        let mut pipeline = Pipeline::read(&folder.join(name)).unwrap();
        pipeline.render.antialiasing = 1;
        change(&mut pipeline);
        let second = match name {
            "two_cameras.toml" => Some("ball"),
            "fisheye.toml" => Some("fisheye"),
            _ => None,
        };
        let size = second.map(|folder| codes(&sequence().join(folder).join("0000.jpg")).size());
        let object = load_object(&folder.join(&pipeline.render.object), &pipeline.render).unwrap();
        let phantoms = Phantoms::of(&pipeline.live, None).unwrap();
        let live = Live::new(&pipeline, Response::srgb(), object, phantoms, (400, 300), size).unwrap();
        Self { live, second }
    }

    fn frame(&mut self, i: usize) -> Output {
        self.shown(&scene(i), i)
    }

    fn shown(&mut self, frame: &CodeImage, i: usize) -> Output {
        let second = self.second.map(|folder| codes(&sequence().join(format!("{folder}/{i:04}.jpg"))));
        self.live.frame(frame, second.as_ref()).unwrap()
    }
}

fn scene(i: usize) -> CodeImage {
    codes(&sequence().join(format!("frames/{i:04}.jpg")))
}

fn linear(image: &CodeImage) -> RadianceImage {
    let response = Response::srgb();
    image.map(|c| insitu::image::Radiance(response.exposure_of(c.0)))
}

/// Corners of the board and the object's place, as a pose shows them, px.
fn shown(pose: &Isometry3<f64>) -> Vec<Point2<f64>> {
    let mut camera = table::camera_of(0);
    camera.world_from_camera = *pose;
    let places =
        [[-0.17, 0.0, -0.12], [0.17, 0.0, -0.12], [0.17, 0.0, 0.12], [-0.17, 0.0, 0.12], [0.0, 0.1, 0.0]];
    places.iter().map(|p| camera.project(&Point3::from(*p)).unwrap()).collect()
}

fn apart(a: &[Point2<f64>], b: &[Point2<f64>]) -> f64 {
    (a.iter().zip(b).map(|(a, b)| (a - b).norm_squared()).sum::<f64>() / a.len() as f64).sqrt()
}

#[test]
fn a_still_camera_does_not_tremble_and_a_moving_one_does_not_lag() {
    let mut film = Film::new("one_camera.toml", |_| {});
    let (mut still, mut raw, mut off) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..table::FRAMES {
        let tracked = film.frame(i).tracked;
        let pose = tracked.camera.unwrap().world_from_camera;
        if (FIRST_AFTER_START..table::MOVES_FROM).contains(&i) {
            still.push(shown(&pose));
            raw.push(shown(&tracked.measured.unwrap()));
        }
        off.push(apart(&shown(&pose), &shown(&table::camera_of(i).world_from_camera)));
    }
    let jitter = |poses: &[Vec<Point2<f64>>]| {
        let mean: Vec<Point2<f64>> = (0..poses[0].len())
            .map(|k| {
                Point2::from(
                    poses.iter().map(|p| p[k].coords).sum::<nalgebra::Vector2<f64>>() / poses.len() as f64,
                )
            })
            .collect();
        (poses.iter().map(|p| apart(p, &mean).powi(2)).sum::<f64>() / poses.len() as f64).sqrt()
    };
    let moving = &off[table::MOVES_FROM..];
    let rms = (moving.iter().map(|o| o * o).sum::<f64>() / moving.len() as f64).sqrt();
    println!(
        "jitter {:.3} px, of the markers' poses {:.3} px; off when still {:.3} px, in motion {rms:.3} px rms, {:.3} at most",
        jitter(&still),
        jitter(&raw),
        off[table::MOVES_FROM - 1],
        moving.iter().fold(0.0f64, |a, b| a.max(*b))
    );
    assert!(jitter(&still) < 0.3 && jitter(&still) < jitter(&raw));
    assert!(rms < 0.6, "{rms}");
}

/// Share of its light that a place of the table loses, and R of it.
fn lost(live: &Live, place: Vec3) -> ([f32; 3], f32) {
    let up = Vec3::Y;
    let surface =
        Surface { position: place, normal: up, face_normal: up, viewer: up, material: 0, pixel_m: 1e-3 };
    let lights: Vec<_> = live.maps().lights().copied().collect();
    let (gone, all) = (live.maps().shadow_buffer(&[surface], |_, _| false)[0], irradiance(&lights, up));
    (gone, luminance(gone) / luminance(all))
}

#[test]
fn the_shadow_follows_the_lamp_in_direction_and_colour() {
    for name in ["one_camera.toml", "two_cameras.toml", "fisheye.toml"] {
        let mut film = Film::new(name, |_| {});
        let lamp = Vec3::new(1.325, 1.9, 0.525);
        let mut before = 0.0;
        for i in table::LAMP_FROM - 3..table::LAMP_FROM + 14 {
            film.frame(i);
            // The path begins with the film.
            let anchor = table::pose_of(i + 3 - table::LAMP_FROM).0 + Vec3::Y * 0.07;
            let towards = (lamp - anchor).normalize();
            // Where the lamp's shadow of the object's middle falls.
            let behind = anchor - towards * (anchor.y / towards.y);
            let (gone, share) = lost(&film.live, behind);
            if i < table::LAMP_FROM {
                before = share;
                continue;
            }
            // Brightness and direction count at once, a map of its own within two frames for the worst light.
            if i >= table::LAMP_FROM + 2 {
                let lights: Vec<_> = film.live.maps().lights().copied().collect();
                let warm = |l: &&insitu::dome::DomeLight| l.power()[0] > 1.4 * l.power()[2];
                let (mut mean, mut power) = (Vec3::ZERO, 0.0);
                for light in lights.iter().filter(|l| l.source.direction.dot(towards) > 0.9).filter(warm) {
                    mean += light.source.direction * luminance(light.power());
                    power += luminance(light.power());
                }
                let off = (mean / power).angle_between(towards).to_degrees();
                println!("{name}, frame {i}: {share:.2} after {before:.2}, {gone:?}, {off:.1}° off");
                assert!(share > before + 0.2, "frame {i}: {share} after {before}");
                assert!(gone[0] > 1.3 * gone[2], "the lamp is warm, its shadow takes warm light: {gone:?}");
                // A pixel of the ball is some 4° of its surroundings.
                assert!(off < 5.0, "{off}°");
            }
        }
    }
}

#[test]
fn nothing_pops() {
    let mut film = Film::new("one_camera.toml", |_| {});
    let places: Vec<Vec3> = (0..900)
        .map(|i| Vec3::new(i as f32 % 30.0 * 0.02 - 0.3, 0.0, i as f32 / 30.0 * 0.02 - 0.3))
        .collect();
    let (mut last, mut worst, mut worst_mean): (Vec<f32>, f32, f32) = (Vec::new(), 0.0, 0.0);
    let mut most_lights = 0;
    for i in 0..table::FRAMES {
        let output = film.frame(i);
        let shares: Vec<f32> = places.iter().map(|p| lost(&film.live, *p).1).collect();
        most_lights = most_lights.max(output.lights);
        let age = film.live.maps().oldest();
        assert!(age <= (2 * most_lights + 16) as u64, "frame {i}: {age} drawings with {most_lights} lights");
        if i > 0 && i != table::LAMP_FROM {
            // Where a place was or is under the object itself nobody looks.
            let foot = table::pose_of(i).0;
            let changes =
                places.iter().zip(shares.iter().zip(&last)).filter(|(p, _)| p.distance(foot) > 0.06);
            let changes: Vec<f32> = changes.map(|(_, (a, b))| (a - b).abs()).collect();
            let mean = changes.iter().sum::<f32>() / changes.len() as f32;
            let most = changes.iter().fold(0.0f32, |a, b| a.max(*b));
            (worst, worst_mean) = (worst.max(most), worst_mean.max(mean));
        }
        last = shares;
    }
    println!(
        "from frame to frame a place's share changes by {worst:.3} at most, by {worst_mean:.4} in the mean"
    );
    assert!(worst < 0.5 && worst_mean < 0.02, "{worst} {worst_mean}");
}

/// The environment of the ball's place, as rays find it.
fn true_light(lamp_on: bool) -> CubeMap {
    let cells = (0..12).map(|id| insitu::vision::marker_cells("4x4_50", id).unwrap()).collect();
    let board = table::Board { markers: [4, 3], side_m: 0.07, gap_m: 0.02, cells };
    let map = table::with_scene(&board, lamp_on, None, |scene| {
        scene.picture((256, 128), 4, 7, |x, y| {
            Some((table::BALL, insitu::probe::latlong::direction(x as f32, y as f32, 256, 128)))
        })
    });
    CubeMap::from_latlong(&map, 32)
}

/// Error and bias of what is removed where truth removes more than 5 %, objects left out, over the frames with truth, before and
/// after the lamp is switched on.
fn against_truth(name: &str, known: Option<[CubeMap; 2]>) -> [[f64; 2]; 2] {
    let mut film = Film::new(name, |p| p.render.antialiasing = 2);
    let mut halves = [[0.0f64; 4]; 2];
    for i in 0..table::FRAMES {
        if let Some(known) = &known {
            film.live.light(known[usize::from(i >= table::LAMP_FROM)].clone());
        }
        let output = film.frame(i);
        if i % 10 != 9 {
            continue;
        }
        let file = |name: String| linear(&codes(&sequence().join("truth").join(name)));
        let (with, empty, plate) =
            (file(format!("{i:04}.jpg")), file(format!("empty_{i:04}.jpg")), linear(&scene(i)));
        let half = usize::from(i >= table::LAMP_FROM);
        let sums = table::shadow_sums(&with, &empty, &plate, &output.radiance);
        halves[half].iter_mut().zip(sums).for_each(|(all, sum)| *all += sum);
    }
    halves.map(|s| [(s[0] / s[1]).sqrt(), s[2] / s[3] - 1.0])
}

#[test]
fn frames_come_near_to_those_with_a_real_object() {
    for name in ["one_camera.toml", "two_cameras.toml", "fisheye.toml"] {
        let found = against_truth(name, None);
        println!(
            "{name}: relative shadow error and bias {found:.3?}, before and after the lamp is switched on"
        );
        for [error, bias] in found {
            assert!(error < 0.27 && bias.abs() < 0.15, "{name}: {found:?}");
        }
    }
}

#[test]
fn light_that_is_known_leaves_little_of_the_error() {
    let found = against_truth("one_camera.toml", Some([false, true].map(true_light)));
    println!("with the true light: {found:.3?}");
    assert!(found.iter().all(|[error, bias]| *error < 0.25 && bias.abs() < 0.13), "{found:?}");
}

#[test]
fn lost_markers_hold_the_pose_then_fade_the_object_and_it_says_so() {
    let mut film = Film::new("one_camera.toml", |p| (p.live.hold_frames, p.live.fade_frames) = (3, 4));
    let grey = Image::from_fn(400, 300, |_, _| Code([0.4; 3]));
    let mut said = Vec::new();
    let mut opacity = Vec::new();
    for i in 0..14 {
        let output = if (4..13).contains(&i) { film.shown(&grey, i) } else { film.frame(i) };
        said.extend(output.notices);
        opacity.push(output.tracked.opacity);
        if i == 5 {
            assert_eq!(output.tracked.sight, Sight::Held(2));
            assert!(output.picture != grey, "the object is still there");
        }
    }
    assert_eq!(opacity[..7], [1.0; 7]);
    assert!(
        opacity[6..12].windows(2).all(|w| w[1] < w[0]) && opacity[12] == 0.0 && opacity[13] == 1.0,
        "{opacity:?}"
    );
    assert_eq!(
        said,
        [
            "frame 4: no marker is seen; the last pose is held",
            "frame 7: no marker was seen in 4 frames; the object fades",
            "frame 11: the object is gone until a marker is seen",
            "frame 13: 10 markers are seen again",
        ]
    );
}

#[test]
fn a_ball_out_of_the_frame_keeps_the_last_light_or_is_refused() {
    let mut film = Film::new("one_camera.toml", |p| p.live.ball_centre_m = [2.0, 0.0, 0.06]);
    let output = film.frame(0);
    assert_eq!(
        output.notices,
        [
            "frame 0: the mirror ball is out of the frame: 100 % of its outline lie outside; there is no light yet"
        ]
    );
    assert!(output.picture == scene(0), "nothing is put into the frame");
    let refused = film.live.finish().unwrap_err();
    assert_eq!(
        (refused.to_string().as_str(), refused.hint().as_str()),
        (
            "in none of 1 frames is the environment seen: the mirror ball is out of the frame: 100 % of its outline lie outside",
            "check live.ball_centre_m and probe.radius_m, or keep the ball in the picture"
        )
    );
}

#[test]
fn frames_of_another_size_are_refused() {
    let mut film = Film::new("one_camera.toml", |_| {});
    film.frame(0);
    let small = Image::from_fn(320, 240, |_, _| Code([0.4; 3]));
    let Err(refused) = film.live.frame(&small, None) else { panic!("taken") };
    assert_eq!(refused.to_string(), "frame 1 is 320×240 px, those before it 400×300 px");
    assert_eq!(refused.hint(), "give frames of one size: cut the film where its size changes");
}

/// What leaves a frame at a place of the real scene.
fn removed_at(frame: &CodeImage, output: &Output, place: Vec3) -> f32 {
    let camera = output.tracked.camera.as_ref().unwrap();
    let p = camera.project(&Point3::new(place.x, place.y, place.z).cast()).unwrap();
    let at = |picture: &RadianceImage| picture.at(p.x as usize, p.y as usize).luminance();
    1.0 - at(&output.radiance) / at(&linear(frame))
}

/// A box in the world (m), as the settings have it.
fn solid(centre: Vec3, size: Vec3) -> insitu::config::PhantomBox {
    let grid = |v: Vec3| [v.x, -v.z, v.y].map(f64::from);
    let size_m = [size.x, size.z, size.y].map(f64::from);
    insitu::config::PhantomBox { centre_m: grid(centre), size_m, rotation_deg: 0.0 }
}

#[test]
fn boxes_receive_shadows_and_hide_the_object() {
    let foot = table::pose_of(0).0;
    // The window lies at −x: beside the object, at +x, is its shadow.
    let beside = foot + Vec3::X * 0.13;
    let front = foot + Vec3::new(-0.02, 0.05, 0.15);
    let boxes = vec![
        solid(beside + Vec3::Y * 0.02, Vec3::new(0.06, 0.04, 0.06)),
        solid(front, Vec3::new(0.04, 0.1, 0.01)),
    ];
    let mut film = Film::new("one_camera.toml", |p| p.live.boxes = boxes);
    let output = film.frame(0);
    let top = removed_at(&scene(0), &output, beside + Vec3::Y * 0.04);
    assert!(top > 0.05, "the shadow falls on the box: {top}");
    let plain = Film::new("one_camera.toml", |_| {}).frame(0);
    let (camera, eye) = (plain.tracked.camera.clone().unwrap(), plain.tracked.camera.unwrap().centre());
    let front = front + Vec3::Z * 0.005;
    let through = Vec3::new(eye.x as f32, eye.y as f32, eye.z as f32) - front;
    let p = camera.project(&Point3::new(front.x, front.y, front.z).cast()).unwrap();
    let at = |picture: &CodeImage| *picture.at(p.x as usize, p.y as usize);
    assert!(
        through.z > 0.0 && at(&plain.picture) != at(&scene(0)),
        "the object is seen there without the box"
    );
    let (before, after) = (at(&scene(0)).0, at(&output.picture).0);
    assert!((0..3).all(|k| after[k] <= before[k] && after[k] > 0.5 * before[k]), "{after:?} for {before:?}");
}

#[test]
fn real_things_shadow_the_object() {
    let foot = table::pose_of(table::FRAMES - 1).0;
    // A board before the lamp, out of the camera's sight.
    let lamp = Vec3::new(1.325, 1.9, 0.525);
    let before = foot + (lamp - foot) * 0.2;
    let board = vec![solid(before, Vec3::new(0.3, 0.01, 0.3))];
    let brightness = |boxes: Vec<_>| {
        let mut film = Film::new("two_cameras.toml", |p| {
            p.live.boxes = boxes;
            p.live.maps_per_frame = 0;
        });
        film.frame(0);
        let output = film.frame(table::FRAMES - 1);
        let red = output.radiance.pixels().iter().filter(|p| p.0[0] > 1.6 * p.0[1]);
        let values: Vec<f32> = red.map(|p| p.luminance()).collect();
        (values.iter().sum::<f32>() / values.len() as f32, values.len())
    };
    let ((lit, seen), (dim, still)) = (brightness(vec![]), brightness(board));
    assert!(seen > 1000 && still > seen / 2, "{seen} {still} px");
    assert!(dim < 0.8 * lit, "in the board's shadow {dim}, without it {lit}");
}

#[test]
fn light_that_a_real_thing_takes_already_is_not_taken_again() {
    let (foot, turn) = table::pose_of(1);
    let lamp = Vec3::new(1.325, 1.9, 0.525);
    // A board that hides the lamp from the object and its shadow, not from the ball.
    let (middle, size) = (foot + (lamp - foot) * 0.2, Vec3::new(0.2, 0.01, 0.2));
    let mut film = Film::new("two_cameras.toml", |p| {
        p.live.boxes = vec![solid(middle, size)];
        p.live.maps_per_frame = 0;
    });
    film.frame(0);
    let i = table::FRAMES - 1;
    let output = film.frame(i);
    let board = cuboid(middle, size / 2.0);
    let mut object = table::object();
    object.vertices.iter_mut().for_each(|v| *v = glam::Quat::from_rotation_y(turn) * *v + foot);
    let [board, object] = [board, object].map(|o| Bvh::new(&o.vertices, &o.triangles));
    let camera = output.tracked.camera.as_ref().unwrap();
    let (plate, ours) = (linear(&scene(i)), &output.radiance);
    // Places around the object: share that leaves, share that should, and what would if nothing but the object hid a light.
    let (mut off, mut without, mut count) = (0.0, 0.0, 0.0);
    for (y, x) in (0..300).step_by(2).flat_map(|y| (0..400).step_by(2).map(move |x| (y, x))) {
        let ray = camera.ray(&Point2::new(x as f64 + 0.5, y as f64 + 0.5));
        let vec3 = |v: [f64; 3]| Vec3::from_array(v.map(|c| c as f32));
        let (origin, direction) = (vec3(ray.origin.coords.into()), vec3(ray.direction.into_inner().into()));
        let place = origin - direction * (origin.y / direction.y);
        let shown = object.any_hit(origin, direction, 0.0, f32::INFINITY);
        if direction.y >= 0.0
            || place.distance(foot) > 0.16
            || shown
            || ours.at(x, y).0[0] > 1.6 * ours.at(x, y).0[1]
        {
            continue;
        }
        let (mut taken, mut all) = ([0.0f32; 2], [0.0f32; 2]);
        for light in film.live.maps().lights() {
            let towards = light.source.direction;
            let sent = towards.y.max(0.0) * light.power()[0];
            let from = place + Vec3::Y * 1e-4;
            let blocked = object.any_hit(from, towards, 0.0, f32::INFINITY);
            let hidden = board.any_hit(from, towards, 0.0, f32::INFINITY);
            for (k, counts) in [(0, !hidden), (1, true)] {
                all[k] += if counts { sent } else { 0.0 };
                taken[k] += if counts && blocked { sent } else { 0.0 };
            }
        }
        let found = 1.0 - ours.at(x, y).0[0] / plate.at(x, y).0[0];
        off += (found - taken[0] / all[0]).abs();
        without += (found - taken[1] / all[1]).abs();
        count += 1.0;
    }
    println!("off by {:.3}, without the board by {:.3}, {count} places", off / count, without / count);
    assert!(
        count > 500.0 && off / count < 0.02 && without > 3.0 * off,
        "{} {}",
        off / count,
        without / count
    );
}

#[test]
fn markers_are_found_alike_where_they_are_expected() {
    for i in [0, 25, 45] {
        let grey = insitu::calibrate::grey(&scene(i));
        let all = markers(&grey, "4x4_50", None).unwrap();
        let camera = table::camera_of(i);
        let at = |x: f64, z: f64| camera.project(&Point3::new(x, 0.0, z)).unwrap();
        let corners = [at(-0.18, -0.14), at(0.18, -0.14), at(0.18, 0.14), at(-0.18, 0.14)];
        let low = |k: usize| corners.iter().map(|c| c[k]).fold(f64::MAX, f64::min).max(0.0) as usize;
        let high = |k: usize| corners.iter().map(|c| c[k]).fold(0.0, f64::max) as usize;
        let within = [low(0), low(1), (high(0) + 8).min(400), (high(1) + 8).min(300)];
        let found = markers(&grey, "4x4_50", Some(&Expected { within, side_px: 20.0 })).unwrap();
        assert!(all.len() >= 8 && found.len() == all.len(), "frame {i}: {} of {}", found.len(), all.len());
        for (a, b) in all.iter().zip(&found) {
            assert!(a.id == b.id && a.corners.iter().zip(&b.corners).all(|(p, q)| (p - q).norm() < 0.3));
        }
    }
}

#[test]
fn a_response_and_a_scene_model_of_the_settings_are_used() {
    let face = insitu::model::Face {
        name: "table.top".into(),
        vertices: [[-0.8, 0.0, 0.8], [0.8, 0.0, 0.8], [0.8, 0.0, -0.8], [-0.8, 0.0, -0.8]]
            .map(Point3::from)
            .into(),
        gloss: None,
    };
    let model = insitu::model::Scene { primitives: vec![], faces: vec![face], rms_px: 0.0 };
    let run_with = |change: &str, to: &str, response: &Response| {
        let (status, said, folder) = run(|folder| {
            std::fs::copy(sequence().join("frames/0000.jpg"), folder.join("frames/0000.jpg")).unwrap();
            insitu::artefact::json::write(&folder.join("curve.json"), response).unwrap();
            insitu::artefact::json::write(&folder.join("scene.json"), &model).unwrap();
            let settings = folder.join("one_camera.toml");
            let text = std::fs::read_to_string(&settings).unwrap();
            assert!(text.contains(change));
            std::fs::write(settings, text.replace(change, to)).unwrap();
        });
        assert_eq!(status, Some(0), "{said}");
        codes(&folder.path().join("live/frame_0000.png"))
    };
    let focal = "focal_px = 430.0\n";
    let plain = run_with(focal, focal, &Response::srgb());
    let curve = format!("response = \"curve.json\"\n{focal}");
    assert!(run_with(focal, &curve, &Response::srgb()) == plain, "the same curve, the same picture");
    let mut flat = Response::srgb();
    for curve in &mut flat.curves {
        let last = curve.exposure.len() - 1;
        curve.exposure.iter_mut().enumerate().for_each(|(i, v)| *v = (i as f64 / last as f64).max(1e-6));
    }
    assert!(run_with(focal, &curve, &flat) != plain, "another curve, another picture");
    let text = std::fs::read_to_string(sequence().join("one_camera.toml")).unwrap();
    let planes = text.lines().find(|l| l.starts_with("planes")).unwrap();
    let by_model = run_with(planes, "scene = \"scene.json\"", &Response::srgb());
    let other = by_model.pixels().iter().zip(plain.pixels()).filter(|(a, b)| a != b).count();
    assert!(other < plain.pixels().len() / 1000, "the same table, by the model: {other} px differ");
}

/// Runs `insitu live` on settings in a folder of their own beside the sequence's files.
fn run(change: impl FnOnce(&Path)) -> (Option<i32>, String, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(sequence().join("one_camera.toml")).unwrap();
    std::fs::write(folder.path().join("one_camera.toml"), text).unwrap();
    std::fs::copy(sequence().join("object.obj"), folder.path().join("object.obj")).unwrap();
    std::fs::create_dir(folder.path().join("frames")).unwrap();
    change(folder.path());
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_insitu"))
        .current_dir(folder.path())
        .args(["live", "one_camera.toml"])
        .output()
        .unwrap();
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned(), folder)
}

#[test]
fn the_command_writes_frames_and_a_video_that_it_can_read_again() {
    let (status, said, folder) = run(|folder| {
        for i in 0..3 {
            let name = format!("frames/{i:04}.jpg");
            std::fs::copy(sequence().join(&name), folder.join(&name)).unwrap();
        }
    });
    assert_eq!(status, Some(0), "{said}");
    let first = codes(&folder.path().join("live/frame_0000.png"));
    assert!(first.size() == (400, 300) && first != scene(0), "the object is in it");
    // The film as a video.
    let (status, said, again) = run(|other| {
        std::fs::copy(folder.path().join("live/live.avi"), other.join("film.avi")).unwrap();
        let settings = other.join("one_camera.toml");
        let text = std::fs::read_to_string(&settings)
            .unwrap()
            .replace("frames = \"frames\"", "frames = \"film.avi\"");
        std::fs::write(settings, text).unwrap();
    });
    assert_eq!(status, Some(0), "{said}");
    assert!(again.path().join("live/frame_0002.png").exists());
}

#[test]
fn sources_that_are_not_there_are_named() {
    let frames_from = |source: &str| {
        let source = format!("frames = \"{source}\"");
        let (status, said, _) = run(|folder| {
            std::fs::write(folder.join("empty.avi"), "").unwrap();
            let settings = folder.join("one_camera.toml");
            let text = std::fs::read_to_string(&settings).unwrap().replace("frames = \"frames\"", &source);
            std::fs::write(settings, text).unwrap();
        });
        assert_eq!(status, Some(1), "{said}");
        // OpenCV has words of its own.
        let ours = said.lines().filter(|l| l.starts_with("error:") || l.starts_with("hint:"));
        ours.collect::<Vec<_>>().join("\n")
    };
    assert_eq!(
        frames_from("camera:97"),
        "error: reading the frames: camera:97: camera 97 cannot be opened\nhint: plug it in, close what else uses it, and check its number (on \
         Linux 0 is /dev/video0); frames may also come as a video file or a folder of pictures"
    );
    let said = frames_from("empty.avi");
    assert!(
        said.contains("empty.avi: is no video that OpenCV can read") && said.contains("hint: check it with"),
        "{said}"
    );
    let said = frames_from("no_such_folder");
    assert!(said.contains("no_such_folder"), "{said}");
}

#[test]
fn a_film_whose_frames_change_in_size_stops_there() {
    let (status, said, folder) = run(|folder| {
        std::fs::copy(sequence().join("frames/0000.jpg"), folder.join("frames/0000.jpg")).unwrap();
        write_png(&folder.join("frames/0001.png"), &Image::from_fn(320, 240, |_, _| Code([0.4; 3]))).unwrap();
    });
    assert_eq!(status, Some(1));
    assert_eq!(
        said,
        "error: putting the object into the film: frame 1 is 320×240 px, those before it 400×300 px\nhint: give frames of one \
         size: cut the film where its size changes\n"
    );
    assert!(folder.path().join("live/frame_0000.png").exists(), "what came before stays");
}

#[test]
fn what_is_no_film_is_refused_with_what_to_do() {
    let (status, said, _) = run(|_| {});
    assert_eq!(status, Some(1));
    assert_eq!(
        said,
        "error: putting the object into the film: the video has no frames\nhint: check live.frames, and play the video\n"
    );
    let blank = |folder: &Path| {
        let grey = Image::from_fn(400, 300, |_, _| Code([0.4; 3]));
        write_png(&folder.join("frames/0000.png"), &grey).unwrap();
    };
    let (status, said, _) = run(blank);
    assert_eq!(status, Some(1));
    assert_eq!(
        said,
        "warning: frame 0: no marker is seen yet\nerror: putting the object into the film: no marker of the settings was seen \
         in any of 1 frames\nhint: check live.dictionary, the numbers of the markers, and that they are in focus\n"
    );
    let (status, said, _) = run(|folder| {
        blank(folder);
        let settings = folder.join("one_camera.toml");
        let text =
            std::fs::read_to_string(&settings).unwrap().replace("focal_px = 430.0", "dictionary = \"4x4_5\"");
        std::fs::write(settings, text).unwrap();
    });
    assert_eq!(status, Some(1));
    assert!(said.contains("`live.focal_px` is not given"), "{said}");
}

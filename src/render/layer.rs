//! The object as the plate's camera sees it: premultiplied colour, coverage, depth.

use super::object::Object;
use super::shade::{Lighting, Sample, Scene, shade};
use crate::artefact::exr::Planes;
use crate::camera::Camera;
use crate::image::{Image, Radiance, RadianceImage};
use crate::visibility::{Bvh, Screen};
use glam::Vec3;
use nalgebra::{Point2, Point3};
use rand::{Rng, SeedableRng, rngs::SmallRng};
use rayon::prelude::*;

/// A picture of the object alone.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Radiance times coverage, plate units.
    pub colour: RadianceImage,
    /// Share of the pixel that shows the object, 0..1.
    pub coverage: Image<f32>,
    /// Mean depth along the viewing axis, m; 0 where there is no object.
    pub depth: Image<f32>,
}

/// A layer and how much of the object the scene hides.
#[derive(Debug, Clone)]
pub struct Rendered {
    /// The picture.
    pub layer: Layer,
    /// Area that shows the object, px.
    pub visible_px: f64,
    /// Area of the object behind surfaces of the scene, px.
    pub hidden_px: f64,
}

impl Layer {
    /// Planes `R G B A Z`.
    pub fn to_planes(&self) -> Planes {
        Planes::from_radiance(&self.colour)
            .with("A", self.coverage.pixels().to_vec())
            .with("Z", self.depth.pixels().to_vec())
    }

    /// From planes `R G B A Z`; `None` if one is missing.
    pub fn from_planes(planes: &Planes) -> Option<Self> {
        let plane =
            |name| Some(Image::from_pixels(planes.width, planes.height, planes.plane(name)?.to_vec()));
        Some(Self { colour: planes.radiance()?, coverage: plane("A")?, depth: plane("Z")? })
    }
}

/// Renders with `antialiasing²` stratified rays a pixel, tested in depth against the scene model. The same seed gives
/// the same picture on any number of threads.
pub fn render(
    object: &Object,
    camera: &Camera,
    scene_bvh: &Bvh,
    lighting: &Lighting,
    antialiasing: usize,
    seed: u64,
) -> Rendered {
    let bvh = Bvh::new(&object.vertices, &object.triangles);
    let scene = Scene::new(object, &bvh);
    let radiance = |_, samples: &[Sample], rng: &mut SmallRng| shade(&scene, lighting, samples, rng);
    render_with(&scene, camera, scene_bvh, antialiasing, seed, radiance)
}

/// The same, with the mean radiance (plate units) of a pixel's samples given by `radiance` of its column and row, the
/// samples, which are never none, and random numbers of its own.
pub(crate) fn render_with(
    scene: &Scene,
    camera: &Camera,
    scene_bvh: &Bvh,
    antialiasing: usize,
    seed: u64,
    radiance: impl Fn([usize; 2], &[Sample], &mut SmallRng) -> [f32; 3] + Sync,
) -> Rendered {
    let (width, height) = (camera.intrinsics.width_px as usize, camera.intrinsics.height_px as usize);
    let side = antialiasing.max(1);
    let window = window(scene.object, camera);
    let screens = [scene.bvh, scene_bvh].map(|bvh| Screen::new(bvh, camera));
    let share = 1.0 / (side * side) as f32;
    let rows: Vec<Vec<Pixel>> = (window[1]..window[3])
        .into_par_iter()
        .map(|y| {
            let mut samples = Vec::with_capacity(side * side);
            let row = (window[0]..window[2]).map(|x| {
                if screens[0].is_empty(x, y) {
                    return Pixel::default();
                }
                let mut rng = SmallRng::seed_from_u64(seed ^ ((y * width + x) as u64 + 1) << 16);
                samples.clear();
                let mut hidden = 0;
                for s in 0..side * side {
                    let place = |k: usize, u: f64| (k as f64 + u) / side as f64;
                    let pixel = Point2::new(
                        x as f64 + place(s % side, rng.random()),
                        y as f64 + place(s / side, rng.random()),
                    );
                    match see(scene, camera, &screens, [x, y], &pixel) {
                        Seen::Object(sample) => samples.push(sample),
                        Seen::Hidden => hidden += 1,
                        Seen::Nothing => {}
                    }
                }
                let hidden = hidden as f32 * share;
                if samples.is_empty() {
                    return Pixel { hidden, ..Pixel::default() };
                }
                let coverage = samples.len() as f32 * share;
                let depth = samples.iter().map(|s| s.depth).sum::<f32>() / samples.len() as f32;
                let radiance = radiance([x, y], &samples, &mut rng);
                Pixel { colour: radiance.map(|v| v * coverage), coverage, depth, hidden }
            });
            row.collect()
        })
        .collect();
    let mut rendered = Rendered {
        layer: Layer {
            colour: Image::filled(width, height, Radiance::default()),
            coverage: Image::filled(width, height, 0.0),
            depth: Image::filled(width, height, 0.0),
        },
        visible_px: 0.0,
        hidden_px: 0.0,
    };
    for (y, row) in (window[1]..).zip(rows) {
        for (x, Pixel { colour, coverage, depth, hidden }) in (window[0]..).zip(row) {
            *rendered.layer.colour.at_mut(x, y) = Radiance(colour);
            *rendered.layer.coverage.at_mut(x, y) = coverage;
            *rendered.layer.depth.at_mut(x, y) = depth;
            rendered.visible_px += f64::from(coverage);
            rendered.hidden_px += f64::from(hidden);
        }
    }
    rendered
}

/// What the centre of each pixel sees of the object, nothing where the scene hides it.
pub(crate) fn visible(scene: &Scene, camera: &Camera, scene_bvh: &Bvh) -> Image<Option<Sample>> {
    let (width, height) = (camera.intrinsics.width_px as usize, camera.intrinsics.height_px as usize);
    let [left, top, right, bottom] = window(scene.object, camera);
    let screens = [scene.bvh, scene_bvh].map(|bvh| Screen::new(bvh, camera));
    let pixel = |i: usize| {
        let (x, y) = (i % width, i / width);
        if !(left..right).contains(&x) || !(top..bottom).contains(&y) {
            return None;
        }
        match see(scene, camera, &screens, [x, y], &Point2::new(x as f64 + 0.5, y as f64 + 0.5)) {
            Seen::Object(sample) => Some(sample),
            _ => None,
        }
    };
    Image::from_pixels(width, height, (0..width * height).into_par_iter().map(pixel).collect())
}

#[derive(Debug, Clone, Copy, Default)]
struct Pixel {
    /// Premultiplied.
    colour: [f32; 3],
    coverage: f32,
    depth: f32,
    /// Share of the pixel where the scene hides the object.
    hidden: f32,
}

enum Seen {
    Object(Sample),
    Hidden,
    Nothing,
}

/// What is seen at a place of the picture, in pixel `at`; the screens are those of object and scene.
fn see(scene: &Scene, camera: &Camera, screens: &[Screen; 2], at: [usize; 2], pixel: &Point2<f64>) -> Seen {
    let ray = camera.ray(pixel);
    let vec3 = |x: f64, y: f64, z: f64| Vec3::new(x as f32, y as f32, z as f32);
    let origin = vec3(ray.origin.x, ray.origin.y, ray.origin.z);
    let direction = vec3(ray.direction.x, ray.direction.y, ray.direction.z);
    let Some(hit) = screens[0].closest(at, origin, direction, 0.0, f32::INFINITY) else {
        return Seen::Nothing;
    };
    // A surface that the object touches does not hide it.
    if screens[1].any_hit(at, origin, direction, 0.0, hit.t - scene.offset) {
        return Seen::Hidden;
    }
    let position = origin + direction * hit.t;
    let (normal, face_normal) = scene.normals(hit.triangle, hit.barycentric, direction);
    let in_camera = camera.world_from_camera.rotation.inverse() * ray.direction.into_inner();
    Seen::Object(Sample {
        position,
        normal,
        face_normal,
        view: direction,
        material: scene.object.material_of[hit.triangle as usize],
        depth: hit.t * in_camera.z as f32,
    })
}

/// Pixels that the object can cover: `[left, top, right, bottom]`. The whole picture if it reaches behind the camera
/// or near it, where projections of corners no longer bound it.
fn window(object: &Object, camera: &Camera) -> [usize; 4] {
    let (width, height) = (camera.intrinsics.width_px as usize, camera.intrinsics.height_px as usize);
    let mut bounds = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for v in &object.vertices {
        let p = Point3::from(v.as_dvec3().to_array());
        match camera.project(&p) {
            Some(pixel) => {
                bounds[0] = bounds[0].min(pixel.x);
                bounds[1] = bounds[1].min(pixel.y);
                bounds[2] = bounds[2].max(pixel.x);
                bounds[3] = bounds[3].max(pixel.y);
            }
            None => return [0, 0, width, height],
        }
    }
    // Distortion bends edges between projected corners.
    let bend = if camera.intrinsics.distortion == [0.0; 5] { 1.0 } else { 0.02 * width.max(height) as f64 };
    let low = |v: f64, size: usize| (v - bend).floor().clamp(0.0, size as f64) as usize;
    let high = |v: f64, size: usize| (v + bend).ceil().clamp(0.0, size as f64) as usize;
    [low(bounds[0], width), low(bounds[1], height), high(bounds[2], width), high(bounds[3], height)]
}

#[cfg(test)]
mod tests {
    use super::super::environment::Environment;
    use super::super::object::{Material, Soup};
    use super::*;
    use crate::camera::Intrinsics;
    use nalgebra::Isometry3;
    use std::f32::consts::PI;

    /// A sphere of radius `r` at `centre`, 64 × 32 quads.
    fn sphere(centre: Vec3, r: f32, material: Material) -> Object {
        let (n, m) = (128u32, 64u32);
        let mut soup = Soup { materials: vec![material], ..Soup::default() };
        for j in 0..=m {
            for i in 0..n {
                let (theta, phi) = (PI * j as f32 / m as f32, 2.0 * PI * i as f32 / n as f32);
                let d = Vec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin());
                soup.positions.push(if j == 0 {
                    centre + Vec3::Y * r
                } else if j == m {
                    centre - Vec3::Y * r
                } else {
                    centre + d * r
                });
            }
        }
        for j in 0..m {
            for i in 0..n {
                let k = (i + 1) % n;
                soup.add_polygon(&[j * n + i, j * n + k, (j + 1) * n + k, (j + 1) * n + i], None, 0);
            }
        }
        Object::new(soup, 1.0).unwrap()
    }

    fn camera(size: u32) -> Camera {
        Camera {
            intrinsics: Intrinsics::pinhole(size, size, 200.0),
            world_from_camera: Isometry3::identity(),
        }
    }

    const CLAY: Material =
        Material { diffuse: [0.6, 0.3, 0.1], specular: [0.0; 3], shininess: 1.0, roughness: None };

    fn furnace(radiance: f32) -> Environment {
        Environment { map: Image::from_fn(32, 16, |_, _| Radiance([radiance; 3])) }
    }

    fn show(object: &Object, camera: &Camera, scene: &Bvh) -> Rendered {
        let irradiance = |_: Vec3, _: Vec3| [2.0 * PI; 3];
        let lighting = Lighting::new(&irradiance, &furnace(2.0), object, 64, None);
        render(object, camera, scene, &lighting, 4, 1)
    }

    #[test]
    fn a_convex_object_in_a_white_furnace_shows_its_reflectance() {
        let object = sphere(Vec3::new(0.1, 0.0, 3.0), 0.5, CLAY);
        assert!(
            object.closed && object.warnings.iter().all(|w| w.contains("no area")),
            "{:?}",
            object.warnings
        );
        let seen = show(&object, &camera(100), &Bvh::new(&[], &[]));
        let mut covered = 0;
        for (c, a) in seen.layer.colour.pixels().iter().zip(seen.layer.coverage.pixels()) {
            if *a > 0.0 {
                covered += 1;
                for k in 0..3 {
                    let expected = 2.0 * CLAY.diffuse[k];
                    assert!((c.0[k] / a / expected - 1.0).abs() < 1e-4, "{} {expected}", c.0[k] / a);
                }
            }
        }
        assert!(covered > 1000);
    }

    #[test]
    fn coverage_of_a_sphere_is_its_silhouettes_area() {
        let (r, d) = (0.5f64, 3.0f64);
        let seen = show(&sphere(Vec3::Z * d as f32, r as f32, CLAY), &camera(100), &Bvh::new(&[], &[]));
        let silhouette = 200.0 * r / (d * d - r * r).sqrt();
        let area = std::f64::consts::PI * silhouette * silhouette;
        assert!((seen.visible_px / area - 1.0).abs() < 5e-3, "{} {area}", seen.visible_px);
        let centre = seen.layer.depth.at(50, 50);
        assert!((centre - 2.5).abs() < 2e-3, "{centre}");
        let edge: Vec<f32> =
            seen.layer.coverage.pixels().iter().copied().filter(|a| *a > 0.0 && *a < 1.0).collect();
        assert!(edge.len() > 100, "edges are smooth");
    }

    #[test]
    fn the_scene_hides_what_lies_behind_it() {
        let object = sphere(Vec3::Z * 3.0, 0.5, CLAY);
        let wall = [
            Vec3::new(0.0, -9.0, 1.0),
            Vec3::new(0.0, 9.0, 1.0),
            Vec3::new(9.0, 9.0, 1.0),
            Vec3::new(9.0, -9.0, 1.0),
        ];
        let seen = show(&object, &camera(100), &Bvh::new(&wall, &[[0, 1, 2], [0, 2, 3]]));
        assert!(
            (seen.visible_px / seen.hidden_px - 1.0).abs() < 1e-2,
            "{} {}",
            seen.visible_px,
            seen.hidden_px
        );
        assert!((50..100).all(|x| *seen.layer.coverage.at(x, 50) == 0.0), "the wall covers +x");
        let floor = [Vec3::new(-9.0, 0.5, -9.0), Vec3::new(9.0, 0.5, -9.0), Vec3::new(0.0, 0.5, 99.0)];
        let seen = show(&object, &camera(100), &Bvh::new(&floor, &[[0, 1, 2]]));
        assert!(seen.hidden_px < 1.0, "a surface it stands on does not: {}", seen.hidden_px);
    }

    #[test]
    fn a_mirroring_sphere_in_a_furnace_sends_no_more_than_it_gets() {
        let mirror = Material { diffuse: [0.2; 3], specular: [0.8; 3], shininess: 200.0, roughness: None };
        let seen = show(&sphere(Vec3::Z * 3.0, 0.5, mirror), &camera(100), &Bvh::new(&[], &[]));
        let brightest = seen.layer.colour.pixels().iter().map(|c| c.0[0]).fold(0.0, f32::max);
        assert!(brightest <= 2.002 && brightest > 1.9, "{brightest}");
    }

    /// Two large facing plates, nearly closed: light between them comes from the rim alone.
    #[test]
    fn an_object_darkens_itself() {
        let mut soup = Soup { materials: vec![CLAY], ..Soup::default() };
        for y in [-0.05f32, 0.05] {
            let base = soup.positions.len() as u32;
            soup.positions
                .extend([[-1.0, 2.0], [1.0, 2.0], [1.0, 4.0], [-1.0, 4.0]].map(|[x, z]| Vec3::new(x, y, z)));
            soup.add_polygon(&[base, base + 1, base + 2, base + 3], None, 0);
        }
        let object = Object::new(soup, 1.0).unwrap();
        let seen = show(&object, &camera(100), &Bvh::new(&[], &[]));
        let (c, a) = (seen.layer.colour.at(50, 53).0[0], seen.layer.coverage.at(50, 53));
        assert_eq!(*a, 1.0);
        let share = c / (2.0 * CLAY.diffuse[0]);
        assert!(share > 0.0 && share < 0.9, "deep between the plates only a part arrives: {share}");
    }

    #[test]
    fn the_same_seed_gives_the_same_picture() {
        let object = sphere(Vec3::Z * 3.0, 0.5, CLAY);
        let a = show(&object, &camera(60), &Bvh::new(&[], &[]));
        let b = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap()
            .install(|| show(&object, &camera(60), &Bvh::new(&[], &[])));
        assert_eq!(a.layer, b.layer);
    }
}

//! The graphics processor against plain Rust: shadow maps and ε. Without an adapter the tests say that they are
//! skipped; with `INSITU_GPU=require` that is a failure.

mod room;

use glam::Vec3;
use insitu::config::{Render, Transfer};
use insitu::illuminate::patch::{DistantSource, LightModel};
use insitu::image::RadianceImage;
use insitu::shadow::{self, Occluder, ShadowMap};
use insitu::{error::Problem, gpu};
use rand::{Rng, SeedableRng, rngs::SmallRng};
use room::{Stage, blob, camera, cuboid, stage};

/// `None`, said aloud, where there is no adapter.
fn gpu<'a>(stage: &'a Stage, settings: &Render) -> Option<gpu::RadianceTransfer<'a>> {
    match gpu::RadianceTransfer::prepare(&stage.scene(), settings) {
        Ok(gpu) => Some(gpu),
        Err(e @ shadow::Problem::Gpu(gpu::Problem::NoAdapter(_))) => {
            assert!(std::env::var("INSITU_GPU").as_deref() != Ok("require"), "{e}");
            println!("skipped: {e}; {}", e.hint());
            None
        }
        Err(e) => panic!("{e}"),
    }
}

/// What two results differ by.
#[derive(Debug)]
struct Difference {
    /// Largest difference over the larger of the two, outside one-pixel borders of the shadow.
    relative: f64,
    /// Rms difference over rms ε.
    rmse: f64,
}

/// A pixel is on a border where ε changes by more than 2 % of the plate within one pixel.
fn compare(plate: &RadianceImage, a: &RadianceImage, b: &RadianceImage) -> Difference {
    let (width, height) = a.size();
    let (mut relative, mut difference, mut signal) = (0.0f64, 0.0, 0.0);
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        let (p, q) = (a.at(x, y).0, b.at(x, y).0);
        let near = (y.saturating_sub(1)..(y + 2).min(height))
            .flat_map(|v| (x.saturating_sub(1)..(x + 2).min(width)).map(move |u| (u, v)));
        let share = |u: usize, v: usize| a.at(u, v).luminance() / plate.at(u, v).luminance();
        let border = near.into_iter().any(|(u, v)| (share(u, v) - share(x, y)).abs() > 0.02);
        for c in 0..3 {
            let (p, q) = (f64::from(p[c]), f64::from(q[c]));
            difference += (p - q).powi(2);
            signal += p * p;
            // Below a thousandth of the plate a difference is below any code value.
            let floor = 1e-3 * f64::from(plate.at(x, y).0[c]);
            if !border && p.max(q) > floor {
                relative = relative.max((p - q).abs() / p.max(q));
            }
        }
    }
    Difference { relative, rmse: (difference / signal.max(1e-300)).sqrt() }
}

impl Difference {
    fn agrees(&self) -> bool {
        self.relative <= 0.01 && self.rmse <= 0.002
    }
}

/// Share of texels that differ in depth by more than rounding, texels with an outline or a crease beside them excepted.
fn map_difference(a: &ShadowMap, b: &ShadowMap) -> f64 {
    let n = a.size;
    let mut bad = 0;
    for (x, y) in (1..n - 1).flat_map(|y| (1..n - 1).map(move |x| (x, y))) {
        let around = |m: &ShadowMap| {
            let near = (0..9).map(|k| m.depth[(y + k / 3 - 1) * n + x + k % 3 - 1]);
            near.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), d| (l.min(d), h.max(d)))
        };
        let (low, high) = around(a);
        let d = b.depth[y * n + x];
        bad += usize::from(d < low - 1e-3 || d > high + 1e-3);
    }
    bad as f64 / (n * n) as f64
}

fn check(stage: &Stage, object: &Occluder, settings: &Render, name: &str) {
    let Some(gpu) = gpu(stage, settings) else { return };
    let cpu = shadow::RadianceTransfer::prepare(&stage.scene(), settings).unwrap();
    let (a, b) = (cpu.shadow_maps(object).unwrap(), gpu.shadow_maps(object).unwrap());
    assert_eq!(a.len(), b.len());
    let worst = a.iter().zip(&b).map(|(a, b)| map_difference(a, b)).fold(0.0, f64::max);
    let (a, b) = (cpu.removed_radiance(object).unwrap(), gpu.removed_radiance(object).unwrap());
    let difference = compare(&stage.plate, &a.epsilon, &b.epsilon);
    println!("{name} on {}: {} maps, texels off {worst:.1e}, {difference:?}", gpu.adapter(), a.shadow_maps);
    assert!(worst <= 1e-4, "{name}: {worst} of the texels differ");
    assert!(difference.agrees(), "{name}: {difference:?}");
}

#[test]
fn random_rooms_agree() {
    let mut random = SmallRng::seed_from_u64(7);
    let stage = stage(0.4, 96, 0.8);
    for i in 0..4 {
        let mut at = |low: f32, high: f32| random.random_range(low..high);
        let centre = Vec3::new(at(-0.4, 0.4), at(0.2, 0.6), at(-0.4, 0.4));
        let object = blob(centre, at(0.08, 0.2), at(0.0, 0.25), 20);
        check(&stage, &object, &Render { shadow_map_px: 128, ..Default::default() }, &format!("blob {i}"));
    }
    let standing = cuboid(Vec3::new(0.1, 0.12, 0.0), Vec3::new(0.10, 0.12, 0.08));
    check(&stage, &standing, &Render::default(), "box on the floor");
}

#[test]
fn degenerate_objects_agree() {
    let stage = stage(0.5, 64, 0.6);
    let settings = Render { shadow_map_px: 96, ..Default::default() };
    let flat = cuboid(Vec3::new(0.0, 0.3, 0.0), Vec3::new(0.3, 0.0, 0.2));
    check(&stage, &flat, &settings, "flat");
    let mut slivers = blob(Vec3::new(0.0, 0.3, 0.0), 0.2, 0.1, 10);
    slivers.triangles.extend([[0, 0, 0], [1, 1, 5], [30, 31, 30]]);
    check(&stage, &slivers, &settings, "degenerate triangles");
    let mut unused = cuboid(Vec3::new(0.0, 0.3, 0.0), Vec3::splat(0.15));
    unused.vertices.push(Vec3::splat(1e6));
    check(&stage, &unused, &settings, "a stray vertex far away");
    let around_lamp = cuboid(Vec3::new(0.0, 2.5, 0.8), Vec3::new(0.3, 0.2, 0.3));
    check(&stage, &around_lamp, &settings, "lights inside the object");
}

#[test]
fn distant_light_agrees() {
    let mut light = LightModel::default();
    room::face(&mut light.mesh, Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, 0.25, |_| [0.1; 3]);
    let mut random = SmallRng::seed_from_u64(3);
    for _ in 0..40 {
        let mut at = || random.random_range(-1.0f32..1.0);
        let direction = Vec3::new(at(), at().abs() + 0.1, at()).normalize();
        light.distant.push(DistantSource { direction, solid_angle_sr: 0.05, radiance: [1.0, 0.8, 0.5] });
    }
    let camera = camera([0.5, 0.9, 1.2], [0.0, 0.0, 0.0], 96, 72, 90.0);
    let stage = Stage::new(light, &camera, &Transfer { source_share: 1.0, ..Default::default() });
    let object = blob(Vec3::new(0.0, 0.2, 0.0), 0.15, 0.1, 24);
    check(&stage, &object, &Render::default(), "distant light");
}

#[test]
fn a_spoilt_result_is_noticed() {
    let stage = stage(0.5, 64, 0.6);
    let object = blob(Vec3::new(0.0, 0.3, 0.0), 0.2, 0.1, 16);
    let cpu = shadow::RadianceTransfer::prepare(&stage.scene(), &Render::default()).unwrap();
    let good = cpu.removed_radiance(&object).unwrap().epsilon;
    assert!(compare(&stage.plate, &good, &good).agrees());
    let mut brighter = good.clone();
    brighter.pixels_mut().iter_mut().for_each(|p| p.0 = p.0.map(|c| c * 1.02));
    assert!(!compare(&stage.plate, &good, &brighter).agrees(), "2 % too much");
    let (width, height) = good.size();
    let shifted = RadianceImage::from_fn(width, height, |x, y| *good.at((x + 1).min(width - 1), y));
    assert!(!compare(&stage.plate, &good, &shifted).agrees(), "shifted by a pixel");
    let missing = cpu_without_one_source(&stage, &object);
    assert!(!compare(&stage.plate, &good, &missing).agrees(), "one of the strong sources left out");
    let maps = cpu.shadow_maps(&object).unwrap();
    let mut bent = maps[0].clone();
    bent.depth.iter_mut().for_each(|d| *d = (*d + 0.01).min(1.0));
    assert!(map_difference(&maps[0], &bent) > 1e-4);
}

fn cpu_without_one_source(stage: &Stage, object: &Occluder) -> RadianceImage {
    let mut transfers = stage.transfers.clone();
    let share = |i: &usize| transfers.sources[*i].power_share;
    let strongest = (0..transfers.sources.len()).max_by(|a, b| share(a).total_cmp(&share(b))).unwrap() as u32;
    let (tree, links) = (&transfers.tree, &mut transfers.links);
    for (node, irradiance) in links.node.iter().zip(&mut links.irradiance) {
        if tree.nodes[*node as usize].leaves.contains(&strongest) {
            *irradiance = [0.0; 3];
        }
    }
    let scene = shadow::Scene { transfers: &transfers, ..stage.scene() };
    shadow::RadianceTransfer::prepare(&scene, &Render::default())
        .unwrap()
        .removed_radiance(object)
        .unwrap()
        .epsilon
}

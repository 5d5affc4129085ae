//! The graphics processor against plain Rust: shadow maps and ε. Without an adapter the tests say that they are
//! skipped and how many checks that leaves out; with `INSITU_GPU=require` that is a failure.

mod room;

use glam::Vec3;
use insitu::config::{Backend, Combination, OcclusionFilter, Render, ShadowMethod, Transfer};
use insitu::gpu::{self, Budget, Difference, Twin};
use insitu::illuminate::patch::{DistantSource, LightModel};
use insitu::image::RadianceImage;
use insitu::shadow::{self, Occluder, ShadowMap};
use rand::{Rng, SeedableRng, rngs::SmallRng};
use room::{Stage, blob, camera, cuboid, stage};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Checks that were left out for want of an adapter.
static SKIPPED: AtomicUsize = AtomicUsize::new(0);

/// `None`, said aloud, where there is no adapter.
fn gpu<'a>(stage: &'a Stage, settings: &Render, budget: Budget) -> Option<gpu::RadianceTransfer<'a>> {
    or_skipped(gpu::RadianceTransfer::prepare_within(&stage.scene(), settings, budget))
}

fn or_skipped<M>(prepared: Result<M, shadow::Problem>) -> Option<M> {
    match prepared {
        Ok(method) => Some(method),
        Err(e @ shadow::Problem::Gpu(gpu::Problem::NoAdapter(_))) => {
            assert!(std::env::var("INSITU_GPU").as_deref() != Ok("require"), "{e}");
            println!("skipped ({} checks so far): {e}", SKIPPED.fetch_add(1, Ordering::Relaxed) + 1);
            None
        }
        Err(e) => panic!("{e}"),
    }
}

/// Number of texels that differ in depth by more than rounding, texels with an outline or a crease beside them excepted.
fn map_difference(a: &ShadowMap, b: &ShadowMap) -> usize {
    let n = a.size;
    let differs = |x: usize, y: usize| {
        let near = (0..9).map(|k| a.depth[(y + k / 3 - 1) * n + x + k % 3 - 1]);
        let (low, high) =
            near.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), d: f32| (l.min(d), h.max(d)));
        let d = b.depth[y * n + x];
        d < low - 1e-3 || d > high + 1e-3
    };
    (1..n - 1).flat_map(|y| (1..n - 1).map(move |x| (x, y))).filter(|&(x, y)| differs(x, y)).count()
}

/// Rounding may move a sliver of the outline by a texel, in few places.
fn most_texels(map: &ShadowMap) -> usize {
    2.max(map.size * map.size / 10_000)
}

fn check(stage: &Stage, object: &Occluder, settings: &Render, name: &str) {
    check_within(stage, object, settings, Budget::default(), name);
}

fn check_maps(a: &[ShadowMap], b: &[ShadowMap], name: &str) {
    assert_eq!(a.len(), b.len());
    let off: Vec<usize> = a.iter().zip(b).map(|(a, b)| map_difference(a, b)).collect();
    let (sum, texels): (usize, usize) = (off.iter().sum(), a.iter().map(|m| m.size * m.size).sum());
    assert!(off.iter().zip(a).all(|(off, map)| *off <= most_texels(map)), "{name}: {off:?}");
    assert!(sum * 10_000 <= texels || sum <= 2, "{name}: {sum} of {texels} texels differ");
}

/// Gives ε, if there is an adapter.
fn check_within(
    stage: &Stage,
    object: &Occluder,
    settings: &Render,
    budget: Budget,
    name: &str,
) -> Option<RadianceImage> {
    let mut gpu = gpu(stage, settings, budget)?;
    let cpu = shadow::RadianceTransfer::prepare(&stage.scene(), settings).unwrap();
    // Maps are read by whole layers, which takes large buffers.
    if budget.buffer_bytes == u64::MAX {
        check_maps(&cpu.shadow_maps(object).unwrap(), &gpu.shadow_maps(object).unwrap(), name);
    }
    let (a, b) = (cpu.removed_radiance(object).unwrap(), gpu.removed_radiance(object).unwrap());
    let difference = Difference::between(&stage.plate, &a.epsilon, &b.epsilon);
    println!("{name} on {}: {} maps, {difference:?}", gpu.adapter(), a.shadow_maps);
    assert!(difference.agrees(), "{name}: {difference:?}");
    assert_eq!((a.shadow_maps, a.passes, a.sources_used), (b.shadow_maps, b.passes, b.sources_used));
    // A frame leaves nothing behind: the same object after another one gives the same.
    gpu.removed_radiance(&cuboid(Vec3::new(0.3, 0.5, -0.3), Vec3::splat(0.2))).unwrap();
    assert_eq!(gpu.removed_radiance(object).unwrap().epsilon, b.epsilon, "{name}, drawn again");
    Some(b.epsilon)
}

fn is_shadowed(epsilon: &RadianceImage) -> bool {
    epsilon.pixels().iter().any(|p| p.luminance() > 0.0)
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
    let below_lamp = blob(Vec3::new(0.0, 2.45, 0.8), 0.14, 0.1, 12);
    check(&stage, &below_lamp, &settings, "an object near a source");
    let hidden = cuboid(Vec3::new(0.0, -1.0, 0.0), Vec3::splat(0.2));
    check(&stage, &hidden, &settings, "an object below the floor");
}

#[test]
fn one_map_agrees() {
    let stage = stage(0.5, 64, 0.6);
    let object = blob(Vec3::new(0.0, 0.3, 0.0), 0.2, 0.1, 16);
    let settings = Render { passes: 1, origins: 1, shadow_map_px: 97, ..Default::default() };
    let epsilon = check_within(&stage, &object, &settings, Budget::default(), "one map");
    assert!(epsilon.is_none_or(|e| is_shadowed(&e)));
}

#[test]
fn any_budget_gives_the_same() {
    let stage = stage(0.5, 96, 0.8);
    let object = blob(Vec3::new(0.1, 0.3, 0.0), 0.2, 0.1, 16);
    let settings = Render { shadow_map_px: 96, ..Default::default() };
    // One layer of maps at a time; a few tiles of pixels in a block and a few clusters in a batch.
    let budgets = [
        Budget { texels: 1, ..Budget::default() },
        Budget { buffer_bytes: 1 << 16, ..Budget::default() },
        Budget { texels: 1, buffer_bytes: 1 << 15 },
    ];
    for (i, budget) in budgets.into_iter().enumerate() {
        let settings = Render { passes: if i == 1 { 0 } else { 60 }, ..settings.clone() };
        check_within(&stage, &object, &settings, budget, &format!("{budget:?}"));
    }
}

#[test]
fn plates_of_any_shape_agree() {
    let object = blob(Vec3::new(0.0, 0.3, 0.0), 0.2, 0.1, 16);
    let settings = Render { shadow_map_px: 96, ..Default::default() };
    for (width, height) in [(161, 23), (23, 117), (1, 1)] {
        let camera = camera([0.9, 1.3, 1.7], [0.0, 0.1, 0.0], width, height, 60.0);
        let stage =
            Stage::new(room::room(0.5), &camera, &Transfer { source_share: 0.6, ..Default::default() });
        check(&stage, &object, &settings, &format!("{width}×{height} px"));
    }
}

#[test]
fn a_plate_without_receivers_stays_as_it_is() {
    let mut stage = stage(0.5, 64, 0.6);
    let object = blob(Vec3::new(0.0, 0.3, 0.0), 0.2, 0.1, 16);
    stage.receivers.pixels.pixels_mut().iter_mut().for_each(|r| *r = None);
    let epsilon = check_within(&stage, &object, &Render::default(), Budget::default(), "no receivers");
    assert!(epsilon.is_none_or(|e| !is_shadowed(&e)));
}

#[test]
fn too_little_of_a_device_is_refused() {
    let stage = stage(0.5, 64, 0.6);
    let none = Budget { buffer_bytes: 1 << 10, ..Budget::default() };
    let settings = Render { shadow_map_px: 8192, ..Default::default() };
    for (settings, budget) in [(Render::default(), none), (settings, none)] {
        let Err(e) = gpu::RadianceTransfer::prepare_within(&stage.scene(), &settings, budget) else {
            panic!("a device of {budget:?} was used");
        };
        match &e {
            shadow::Problem::Gpu(gpu::Problem::NoAdapter(_)) => println!("skipped: {e}"),
            shadow::Problem::Gpu(gpu::Problem::Limit { .. }) => {
                assert!(insitu::error::Problem::hint(&e).contains("render.backend"), "{e}");
            }
            other => panic!("{other}"),
        }
    }
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

/// ε of an object, by plain Rust too, and again after a frame with another one.
fn check_twin(gpu: &mut impl Twin, object: &Occluder, name: &str) -> shadow::Removed {
    let (found, difference) = gpu.parity(object).unwrap();
    println!("{name} on {}: {} maps or textures, {difference:?}", gpu.adapter(), found.shadow_maps);
    assert!(difference.agrees(), "{name}: {difference:?}");
    gpu.removed_radiance(&cuboid(Vec3::new(0.3, 0.5, -0.3), Vec3::splat(0.2))).unwrap();
    assert_eq!(gpu.removed_radiance(object).unwrap(), found, "{name}, drawn again");
    found
}

/// Gives ε, if there is an adapter.
fn check_textures(
    stage: &Stage,
    object: &Occluder,
    settings: &Render,
    buffer_bytes: u64,
    name: &str,
) -> Option<RadianceImage> {
    let scene = stage.scene();
    let mut gpu = or_skipped(gpu::OcclusionTextures::prepare_within(&scene, settings, buffer_bytes))?;
    let found = check_twin(&mut gpu, object, name);
    let settings =
        Render { method: ShadowMethod::OcclusionTextures, backend: Backend::Gpu, ..settings.clone() };
    let session = shadow::Session::prepare(&scene, &settings).unwrap().frame(object).unwrap();
    assert_eq!(session.removed, found, "{name}, by a session");
    Some(found.epsilon)
}

#[test]
fn occlusion_textures_agree() {
    let stage = stage(0.2, 96, 0.8);
    let objects = [
        ("blob", blob(Vec3::new(-0.3, 0.4, 0.1), 0.25, 0.2, 20)),
        ("box on the floor", cuboid(Vec3::new(0.1, 0.12, 0.0), Vec3::new(0.10, 0.12, 0.08))),
        ("object through the window", cuboid(Vec3::new(-2.0, 1.2, 0.0), Vec3::splat(0.3))),
    ];
    for (name, object) in &objects {
        for occlusion_filter in OcclusionFilter::ALL {
            let settings = Render { occlusion_filter, occlusion_px: 256, ..Default::default() };
            let name = format!("{name}, {occlusion_filter:?}");
            let found = check_textures(&stage, object, &settings, u64::MAX, &name);
            assert!(found.is_none_or(|e| is_shadowed(&e)), "{name}");
        }
        for (combination, close_leaks) in Combination::ALL.into_iter().flat_map(|c| [(c, false), (c, true)]) {
            let settings =
                Render { combination, close_leaks, occlusion_px: 128, slices: 7, ..Default::default() };
            let name = format!("{name}, {combination:?}, closed: {close_leaks}");
            check_textures(&stage, object, &settings, u64::MAX, &name);
        }
    }
}

#[test]
fn occlusion_textures_agree_however_little_the_device_holds() {
    let stage = stage(0.2, 96, 0.8);
    let object = blob(Vec3::new(-0.3, 0.4, 0.1), 0.25, 0.2, 20);
    for occlusion_filter in OcclusionFilter::ALL {
        // One layer of 64² texels a batch, or few; some tiles of pixels a block.
        let settings = Render { occlusion_filter, occlusion_px: 64, ..Default::default() };
        let within = |bytes| {
            let scene = stage.scene();
            let mut gpu = or_skipped(gpu::OcclusionTextures::prepare_within(&scene, &settings, bytes))?;
            Some(gpu.removed_radiance(&object).unwrap())
        };
        let whole = within(u64::MAX);
        for bytes in [7 * 4 * 64 * 64, 1 << 18] {
            assert_eq!(within(bytes), whole, "{occlusion_filter:?} in {bytes} bytes");
        }
        let little = gpu::OcclusionTextures::prepare_within(&stage.scene(), &settings, 1 << 13);
        match little.map(|_| ()) {
            Err(shadow::Problem::Gpu(gpu::Problem::NoAdapter(e))) => println!("skipped: {e}"),
            Err(e @ shadow::Problem::Gpu(gpu::Problem::Limit { .. })) => {
                assert!(insitu::error::Problem::hint(&e).contains("render.occlusion_px"), "{e}");
            }
            other => panic!("{other:?}"),
        }
    }
}

/// Gives what is removed, if there is an adapter.
fn check_lights(
    stage: &Stage,
    object: &Occluder,
    settings: &Render,
    budget: Budget,
    name: &str,
) -> Option<shadow::Removed> {
    let scene = stage.scene();
    let mut gpu = or_skipped(gpu::Subtractive::prepare_within(&scene, settings, budget))?;
    let found = check_twin(&mut gpu, object, name);
    let settings = Render { method: ShadowMethod::Subtractive, ..settings.clone() };
    let plain = shadow::removed_radiance(&scene, object, &settings).unwrap();
    assert_eq!((found.shadow_maps, found.sources_used), (plain.shadow_maps, plain.sources_used), "{name}");
    let [a, b] = [&found, &plain].map(|r| r.expected_error.unwrap_or(-1.0));
    assert!((a - b).abs() <= 0.01 * b.abs(), "{name}: expected error {a}, on the CPU {b}");
    let settings = Render { backend: Backend::Gpu, ..settings };
    if budget.texels == Budget::default().texels {
        let session = shadow::Session::prepare(&scene, &settings).unwrap().frame(object).unwrap();
        assert_eq!(session.removed, found, "{name}, by a session");
    }
    Some(found)
}

#[test]
fn subtractive_shadows_agree() {
    let stage = stage(0.4, 96, 0.8);
    let objects = [
        ("blob", blob(Vec3::new(-0.3, 0.4, 0.1), 0.25, 0.2, 20)),
        ("box on the floor", cuboid(Vec3::new(0.1, 0.12, 0.0), Vec3::new(0.10, 0.12, 0.08))),
        ("object near a source", blob(Vec3::new(0.0, 2.45, 0.8), 0.14, 0.1, 12)),
        ("object through the wall", cuboid(Vec3::new(-2.0, 1.2, 0.0), Vec3::splat(0.3))),
    ];
    for (name, object) in &objects {
        for pixels_per_sample in [1, 4, 64, 1024] {
            let settings = Render { pixels_per_sample, shadow_map_px: 128, lights: 60, ..Default::default() };
            let name = format!("{name}, a sample in {pixels_per_sample} pixels");
            check_lights(&stage, object, &settings, Budget::default(), &name);
        }
    }
    // So many lights that one loop over all of them and their rays would be too long for llvmpipe.
    let many = Render { lights: 400, pixels_per_sample: 1, shadow_map_px: 128, ..Default::default() };
    check_lights(&stage, &objects[1].1, &many, Budget::default(), "many lights");
    let standing = check_lights(&stage, &objects[1].1, &Render::default(), Budget::default(), "by default");
    assert!(standing.is_none_or(|r| is_shadowed(&r.epsilon)));
}

#[test]
fn subtractive_shadows_agree_however_little_the_device_holds() {
    let stage = stage(0.4, 96, 0.8);
    let object = blob(Vec3::new(-0.3, 0.4, 0.1), 0.25, 0.2, 20);
    for (budget, lights) in
        [(Budget { texels: 1, ..Budget::default() }, 150), (Budget { texels: 1, buffer_bytes: 1 << 19 }, 150)]
    {
        for pixels_per_sample in [4, 256] {
            let settings = Render { lights, pixels_per_sample, shadow_map_px: 256, ..Default::default() };
            check_lights(&stage, &object, &settings, budget, &format!("{budget:?}"));
        }
    }
}

/// A floor and a wall under sun and sky.
fn outdoors() -> Stage {
    let mut light = LightModel::default();
    room::face(&mut light.mesh, Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, 0.25, |_| [0.1; 3]);
    room::face(&mut light.mesh, Vec3::new(0.3, 0.0, -0.6), Vec3::Z * 0.5, Vec3::Y * 0.5, 0.25, |_| [0.1; 3]);
    let sun = DistantSource {
        direction: Vec3::new(0.6, 0.7, 0.1).normalize(),
        solid_angle_sr: 7e-5,
        radiance: [3e4; 3],
    };
    let sky = |i: i32| DistantSource {
        direction: Vec3::new((i as f32).sin(), 1.0, (i as f32).cos()).normalize(),
        solid_angle_sr: 0.3,
        radiance: [1.0, 1.2, 1.5],
    };
    light.distant = std::iter::once(sun).chain((0..9).map(sky)).collect();
    let camera = camera([0.5, 0.9, 1.2], [0.0, 0.0, 0.0], 96, 72, 90.0);
    Stage::new(light, &camera, &Transfer { source_share: 1.0, ..Default::default() })
}

#[test]
fn subtractive_shadows_of_distant_light_agree() {
    let object = blob(Vec3::new(0.0, 0.2, 0.0), 0.15, 0.1, 24);
    let settings = Render { lights: 60, ..Default::default() };
    check_lights(&outdoors(), &object, &settings, Budget::default(), "sun and sky");
}

/// Gives ε, if there is an adapter.
fn check_dome(
    stage: &Stage,
    object: &Occluder,
    settings: &Render,
    budget: Budget,
    name: &str,
) -> Option<RadianceImage> {
    let settings = Render { method: ShadowMethod::LightDome, backend: Backend::Gpu, ..settings.clone() };
    let scene = stage.scene();
    let mut gpu = or_skipped(gpu::LightDome::prepare_within(&scene, &settings, budget))?;
    let found = check_twin(&mut gpu, object, name);
    assert_eq!(found.expected_error, None);
    if budget.texels == Budget::default().texels {
        let session = shadow::Session::prepare(&scene, &settings).unwrap().frame(object).unwrap();
        assert_eq!(session.removed, found, "{name}, by a session");
    }
    Some(found.epsilon)
}

#[test]
fn light_domes_agree() {
    let room = stage(0.4, 96, 0.8);
    let objects = [
        ("blob", &room, blob(Vec3::new(-0.3, 0.4, 0.1), 0.25, 0.2, 20)),
        ("box on the floor", &room, cuboid(Vec3::new(0.1, 0.12, 0.0), Vec3::new(0.10, 0.12, 0.08))),
        ("object near a source", &room, blob(Vec3::new(0.05, 2.4, 0.75), 0.14, 0.1, 12)),
        ("sun and sky", &outdoors(), blob(Vec3::new(0.0, 0.2, 0.0), 0.15, 0.1, 24)),
    ];
    for (name, stage, object) in &objects {
        for (dome_at_infinity, dome_texels) in [(false, 2), (false, 8), (true, 4)] {
            let settings = Render { dome_at_infinity, dome_texels, shadow_map_px: 128, ..Default::default() };
            let name = format!("{name}, {dome_texels}² texels, at infinity: {dome_at_infinity}");
            let found = check_dome(stage, object, &settings, Budget::default(), &name);
            assert!(found.is_none_or(|e| is_shadowed(&e)), "{name}");
        }
    }
    // One layer of maps at a time; a few tiles of pixels in a block.
    for budget in [Budget { texels: 1, ..Budget::default() }, Budget { texels: 1, buffer_bytes: 1 << 19 }] {
        let settings = Render { shadow_map_px: 256, ..Default::default() };
        check_dome(&room, &objects[0].2, &settings, budget, &format!("{budget:?}"));
    }
}

/// A method's ε in the default settings differs from that in spoilt ones, patches of the room so large, m.
fn check_noticed(edge: f32, method: ShadowMethod, spoilt: &[(&str, Render)]) {
    let stage = stage(edge, 96, 0.8);
    let object = blob(Vec3::new(-0.3, 0.4, 0.1), 0.25, 0.2, 20);
    let of = |settings: &Render| {
        let settings = Render { method, ..settings.clone() };
        shadow::removed_radiance(&stage.scene(), &object, &settings).unwrap().epsilon
    };
    let good = of(&Render::default());
    for (what, spoilt) in spoilt {
        let difference = Difference::between(&stage.plate, &good, &of(spoilt));
        assert!(!difference.agrees(), "{what}: {difference:?}");
    }
}

#[test]
fn a_spoilt_dome_is_noticed() {
    let spoilt = [
        ("a split less", Render { dome_splits: Render::default().dome_splits - 1, ..Default::default() }),
        ("lights in the middle", Render { dome_centroid: false, ..Default::default() }),
        ("lights at infinity", Render { dome_at_infinity: true, ..Default::default() }),
        ("coarser maps", Render { shadow_map_px: 64, ..Default::default() }),
    ];
    check_noticed(0.4, ShadowMethod::LightDome, &spoilt);
}

#[test]
fn a_spoilt_shadow_buffer_is_noticed() {
    let spoilt = [
        ("a light less", Render { lights: 199, ..Default::default() }),
        ("coarser samples", Render { pixels_per_sample: 16, ..Default::default() }),
        ("coarser maps", Render { shadow_map_px: 64, ..Default::default() }),
    ];
    check_noticed(0.4, ShadowMethod::Subtractive, &spoilt);
}

#[test]
fn a_spoilt_occlusion_texture_is_noticed() {
    let spoilt = [
        ("another filter", Render { occlusion_filter: OcclusionFilter::NBuffers, ..Default::default() }),
        ("another rule", Render { combination: Combination::Sum, ..Default::default() }),
        ("a slice less", Render { slices: 15, ..Default::default() }),
        ("coarser texels", Render { occlusion_px: 256, ..Default::default() }),
    ];
    check_noticed(0.2, ShadowMethod::OcclusionTextures, &spoilt);
}

#[test]
fn a_spoilt_result_is_noticed() {
    let stage = stage(0.5, 64, 0.6);
    let object = blob(Vec3::new(0.0, 0.3, 0.0), 0.2, 0.1, 16);
    let cpu = shadow::RadianceTransfer::prepare(&stage.scene(), &Render::default()).unwrap();
    let good = cpu.removed_radiance(&object).unwrap().epsilon;
    let compare = |other: &RadianceImage| Difference::between(&stage.plate, &good, other);
    assert!(compare(&good).agrees());
    let mut brighter = good.clone();
    brighter.pixels_mut().iter_mut().for_each(|p| p.0 = p.0.map(|c| c * 1.02));
    assert!(!compare(&brighter).agrees(), "2 % too much");
    let (width, height) = good.size();
    let shifted = RadianceImage::from_fn(width, height, |x, y| *good.at((x + 1).min(width - 1), y));
    assert!(!compare(&shifted).agrees(), "shifted by a pixel");
    let missing = cpu_without_one_source(&stage, &object);
    assert!(!compare(&missing).agrees(), "one of the strong sources left out");
    let maps = cpu.shadow_maps(&object).unwrap();
    let mut bent = maps[0].clone();
    bent.depth.iter_mut().for_each(|d| *d = (*d + 0.01).min(1.0));
    assert!(map_difference(&maps[0], &bent) > most_texels(&bent));
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

//! Radiance transfer against the ray-traced reference on the same model.

mod room;

use glam::Vec3;
use insitu::config::{Render, ShadowMethod};
use insitu::shadow::{Occluder, removed_radiance};
use room::{blob, cuboid, errors, stage};

fn objects() -> Vec<(&'static str, Occluder)> {
    let at = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    vec![
        ("box on the floor", cuboid(at(0.1, 0.12, 0.0), at(0.10, 0.12, 0.08))),
        ("sphere on the floor", blob(at(-0.1, 0.15, 0.1), 0.15, 0.0, 24)),
        ("blob on the floor", blob(at(0.0, 0.17, 0.0), 0.15, 0.15, 32)),
        ("blob raised by 0.3 m", blob(at(0.0, 0.47, 0.0), 0.15, 0.15, 32)),
        ("thin plate raised", cuboid(at(0.0, 0.25, 0.0), at(0.2, 0.004, 0.15))),
    ]
}

#[test]
fn radiance_transfer_agrees_with_the_reference() {
    let edge = std::env::var("EDGE").ok().and_then(|s| s.parse().ok()).unwrap_or(0.2);
    let t = std::time::Instant::now();
    let stage = stage(edge, 160, 1.0);
    let scene = stage.scene();
    println!("{} sources, {} vertices, {:?}", stage.transfers.sources.len(), stage.transfers.receiver_vertices.len(), t.elapsed());
    for (sources, bound) in [(0, 0.05), (64, 0.10)] {
        for (name, object) in objects() {
            let fast = Render { max_sources: sources, source_angle_deg: std::env::var("ANGLE").ok().and_then(|s| s.parse().ok()).unwrap_or(10.0), ..Default::default() };
            let slow = Render { method: ShadowMethod::Raytraced, rays: 2048, ..fast.clone() };
            let t0 = std::time::Instant::now();
            let found = removed_radiance(&scene, &object, &fast).unwrap();
            let t1 = t0.elapsed();
            let reference = removed_radiance(&scene, &object, &slow).unwrap();
            let t2 = t0.elapsed() - t1;
            let (error, bias) = errors(&stage.plate, &found.epsilon, &reference.epsilon);
            println!("{name}: {} sources, {} maps: error {error:.4}, bias {bias:+.4}, noise {:.4} {t1:?} {t2:?}", found.sources_used, found.shadow_maps, reference.noise.unwrap());
            assert!(error <= bound && bias.abs() <= 0.01 || std::env::var("EDGE").is_ok(), "{name}: error {error}, bias {bias}");
        }
    }
}

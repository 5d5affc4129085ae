//! A synthetic room, 4 × 2.6 × 4 m: floor, walls, ceiling with their own radiance, a bright window, a ceiling lamp.
#![allow(dead_code)] // each test program uses its part

use glam::Vec3;
use insitu::camera::Camera;
use insitu::config;
use insitu::illuminate::patch::{LightModel, PatchMesh};
use insitu::image::{Image, Radiance, RadianceImage, luminance};
use insitu::shadow::{Occluder, Receivers, Scene, removed_radiance};
use insitu::transfer::{Transfers, solve};

#[allow(unused_imports)] // each test program uses its part
pub use insitu::synthetic::{blob, camera, cuboid, face};

/// The room. The window (2 × 1.2 m) is part of the wall at x = −2, its patches of the wall's size.
pub fn room(edge: f32) -> LightModel {
    let mut mesh = PatchMesh::default();
    let (x, y, z) = (Vec3::X * 4.0, Vec3::Y * 2.6, Vec3::Z * 4.0);
    let low = Vec3::new(-2.0, 0.0, -2.0);
    face(&mut mesh, low, z, x, edge, |p| [0.20, 0.16, 0.12].map(|c| c * (1.0 + 0.3 * p.x)));
    face(&mut mesh, low + y, x, z, edge, |p| {
        if p.x.abs() < 0.2 && (p.z - 0.8).abs() < 0.2 { [25.0, 20.0, 14.0] } else { [0.5, 0.5, 0.5] }
    });
    face(&mut mesh, low, y, z, edge, |p| {
        if (p.y - 1.4).abs() < 0.6 && p.z.abs() < 1.0 { [6.0, 7.0, 9.0] } else { [0.3, 0.3, 0.3] }
    });
    face(&mut mesh, low + x, z, y, edge, |_| [0.6, 0.55, 0.5]);
    face(&mut mesh, low, x, y, edge, |_| [0.5, 0.3, 0.2]);
    face(&mut mesh, low + z, y, x, edge, |_| [0.4, 0.4, 0.5]);
    LightModel { mesh, distant: Vec::new() }
}

/// What a test shadows: light, transfers, receivers and a plate that is consistent with them.
pub struct Stage {
    pub light: LightModel,
    pub receivers: Receivers,
    pub transfers: Transfers,
    pub plate: RadianceImage,
}

impl Stage {
    pub fn new(light: LightModel, camera: &Camera, settings: &config::Transfer) -> Self {
        let receivers = Receivers::cast(camera, &light.mesh);
        let transfers = solve(&light, &receivers, settings, || {}).unwrap();
        let (width, height) = receivers.pixels.size();
        let plate =
            Image::from_fn(width, height, |x, y| Radiance([0.2 + 0.1 * ((x / 8 + y / 8) % 2) as f32; 3]));
        Self { light, receivers, transfers, plate }
    }

    pub fn scene(&self) -> Scene<'_> {
        Scene {
            light: &self.light,
            transfers: &self.transfers,
            receivers: &self.receivers,
            plate: &self.plate,
            finish: None,
            stored: None,
        }
    }
}

/// The room seen from 1.5 m above the floor towards its middle.
pub fn stage(edge: f32, width: u32, share: f64) -> Stage {
    let camera = camera([0.9, 1.3, 1.7], [0.0, 0.1, 0.0], width, width * 3 / 4, f64::from(width) * 0.9);
    Stage::new(room(edge), &camera, &config::Transfer { source_share: share, ..Default::default() })
}

/// A blob on the room's floor.
pub fn object() -> Occluder {
    blob(Vec3::new(0.0, 0.17, 0.0), 0.15, 0.15, 24)
}

/// Relative shadow error and energy bias where the reference removes more than 2 % (DESIGN §8, method error).
pub fn errors(plate: &RadianceImage, found: &RadianceImage, reference: &RadianceImage) -> (f64, f64) {
    let (mut difference, mut signal, mut sum, mut sum_reference) = (0.0, 0.0, 0.0, 0.0);
    for ((b, f), r) in plate.pixels().iter().zip(found.pixels()).zip(reference.pixels()) {
        if luminance(r.0) <= 0.02 * b.luminance() {
            continue;
        }
        for c in 0..3 {
            let (f, r) = (f64::from(f.0[c]), f64::from(r.0[c]));
            difference += (f - r).powi(2);
            signal += r * r;
            sum += f;
            sum_reference += r;
        }
    }
    ((difference / signal).sqrt(), sum / sum_reference - 1.0)
}

/// A lid over the whole floor takes no more light than there was, a crumb under the ceiling next to none.
pub fn removes_no_more_than_was_there(settings: &config::Render) {
    let stage = stage(0.4, 64, 1.0);
    let lid = cuboid(Vec3::new(0.0, 0.05, 0.0), Vec3::new(1.99, 0.002, 1.99));
    let removed = removed_radiance(&stage.scene(), &lid, settings).unwrap();
    for (b, e) in stage.plate.pixels().iter().zip(removed.epsilon.pixels()) {
        assert!((0..3).all(|c| e.0[c] >= 0.0 && e.0[c] <= b.0[c]), "{e:?} of {b:?}");
    }
    let crumb = cuboid(Vec3::new(1.5, 2.5, -1.5), Vec3::splat(0.005));
    let removed = removed_radiance(&stage.scene(), &crumb, settings).unwrap();
    let gone: f32 = removed.epsilon.pixels().iter().map(|e| e.luminance()).sum();
    let there: f32 = stage.plate.pixels().iter().map(|p| p.luminance()).sum();
    assert!(gone < 1e-3 * there, "{gone} of {there}");
}

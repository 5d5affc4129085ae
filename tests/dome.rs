//! The light dome: as a method for stills against the ray-traced reference on the same model.

mod room;

use glam::Vec3;
use insitu::config::{Render, ShadowMethod};
use insitu::error::Problem as _;
use insitu::image::{Image, Radiance};
use insitu::shadow::{Occluder, Problem, removed_radiance};
use room::{blob, cuboid, errors, stage};

fn object() -> Occluder {
    blob(Vec3::new(0.0, 0.17, 0.0), 0.15, 0.15, 24)
}

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
        println!(
            "{} a face, centroid {}, {} splits, at infinity {}: {} lights, error {error:.3}, bias {bias:+.3}",
            settings.dome_texels,
            settings.dome_centroid,
            settings.dome_splits,
            settings.dome_at_infinity,
            found.sources_used
        );
        (error, bias)
    };
    for at_infinity in [true, false] {
        for texels in [2, 4, 8] {
            let of = |dome_centroid, dome_splits| {
                let dome_at_infinity = at_infinity;
                Render { dome_texels: texels, dome_centroid, dome_splits, dome_at_infinity, ..settings() }
            };
            let (plain, _) = error(of(false, 0));
            let (centroid, _) = error(of(true, 0));
            let (split, bias) = error(of(true, 16));
            let _ = (plain, centroid, split, bias);
        }
    }
}

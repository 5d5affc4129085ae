//! The method `radiance-transfer-ldr` against the same passes in radiance.

mod room;

use insitu::config::{Render, ShadowMethod};
use insitu::error::Problem as _;
use insitu::image::{Code, CodeImage};
use insitu::response::Response;
use insitu::shadow::{Problem, Removed, Scene, Stored, removed_radiance};
use room::{Stage, cuboid, errors, stage};

fn codes(stage: &Stage, response: &Response) -> CodeImage {
    stage.plate.map(|p| Code(response.code_of(p.0).map(|c| (c * 255.0).round() / 255.0)))
}

fn removed(stage: &Stage, stored: Option<Stored>, method: ShadowMethod, passes: usize) -> Removed {
    let settings = Render { method, passes, ..Default::default() };
    let occluder = cuboid([0.1, 0.35, 0.0].into(), [0.15, 0.15, 0.12].into());
    removed_radiance(&Scene { stored, ..stage.scene() }, &occluder, &settings).unwrap()
}

#[test]
fn eight_bits_remove_what_radiance_does() {
    let (stage, response) = (stage(0.4, 160, 0.98), Response::srgb());
    let codes = codes(&stage, &response);
    let stored = Some(Stored { codes: &codes, response: &response });
    // Where few of the strong sources are hidden, as here, the assumption of two sets takes too much (gibson, Figure 3).
    for passes in [20, 50] {
        let exact = removed(&stage, None, ShadowMethod::RadianceTransfer, passes);
        let ldr = removed(&stage, stored, ShadowMethod::RadianceTransferLdr, passes);
        let (error, bias) = errors(&stage.plate, &ldr.epsilon, &exact.epsilon);
        println!("{passes} passes: error {error:.3}, bias {bias:+.3}");
        assert!(error < 0.22 && (0.0..0.16).contains(&bias), "{passes} passes: error {error}, bias {bias}");
    }
}

#[test]
fn codes_stay_whole_and_only_fall_where_light_is_removed() {
    let (stage, response) = (stage(0.4, 160, 0.98), Response::srgb());
    let codes = codes(&stage, &response);
    let stored = Some(Stored { codes: &codes, response: &response });
    let ldr = removed(&stage, stored, ShadowMethod::RadianceTransferLdr, 20);
    let after = ldr.codes.unwrap();
    let mut fallen = 0;
    for ((before, after), gone) in codes.pixels().iter().zip(after.pixels()).zip(ldr.epsilon.pixels()) {
        for c in 0..3 {
            let (before, after) = (before.0[c] * 255.0, after.0[c] * 255.0);
            assert!((after - after.round()).abs() < 1e-3 && after >= 0.0 && after <= before + 1e-3);
            assert_eq!(after < before - 0.5, gone.0[c] > 0.0);
            fallen += usize::from(after < before - 0.5);
        }
    }
    assert!(fallen > 1000, "{fallen} codes fell");
}

#[test]
fn a_linear_plate_is_refused() {
    let stage = stage(0.8, 40, 0.9);
    let settings = Render { method: ShadowMethod::RadianceTransferLdr, ..Default::default() };
    let occluder = cuboid([0.1, 0.35, 0.0].into(), [0.15, 0.15, 0.12].into());
    let e = removed_radiance(&stage.scene(), &occluder, &settings).unwrap_err();
    assert!(matches!(e, Problem::NoCodes) && e.hint().contains("radiance-transfer"), "{e}");
}

use super::*;
use proptest::prelude::*;
use rand::{Rng, SeedableRng, rngs::SmallRng};

fn shoot(radiance: &[f64], exposure: f64, seed: Option<u64>) -> CodeImage {
    let response = Response::srgb();
    let mut random = SmallRng::seed_from_u64(seed.unwrap_or(0));
    let pixels = radiance.iter().map(|r| {
        let x = r * exposure;
        let sigma = if seed.is_some() { (x / 12_000.0 + (5.0 / 12_000.0_f64).powi(2)).sqrt() } else { 0.0 };
        let normal: f64 = (0..4).map(|_| random.random_range(-0.866..0.866_f64)).sum();
        let code = response.code_of([(x + sigma * normal) as f32; 3]);
        Code(code.map(|c| (c * 255.0).round() / 255.0))
    });
    Image::from_pixels(radiance.len(), 1, pixels.collect())
}

fn merged(radiance: &[f64], exposures: &[f64], noisy: bool) -> Merged {
    let images: Vec<_> =
        exposures.iter().zip(0..).map(|(e, seed)| shoot(radiance, *e, noisy.then_some(seed))).collect();
    let frames: Vec<_> =
        images.iter().zip(exposures).map(|(codes, e)| Frame { codes, exposure: *e }).collect();
    merge(&frames, &Response::srgb(), 1.0, &config::Merge::default()).unwrap()
}

const EXPOSURES: [f64; 4] = [1.0 / 16.0, 0.25, 1.0, 4.0];

#[test]
fn noise_averages_to_the_truth_with_the_variance_promised() {
    let truth: Vec<f64> = (0..20_000).map(|i| 10_f64.powf(f64::from(i % 100) / 100.0 * 3.0 - 2.0)).collect();
    let merged = merged(&truth, &EXPOSURES, true);
    let (mut bias, mut square, mut promised) = (0.0, 0.0, 0.0);
    for ((r, v), t) in merged.radiance.pixels().iter().zip(merged.variance.pixels()).zip(&truth) {
        let relative = f64::from(r.0[1]) / t - 1.0;
        bias += relative;
        square += relative * relative;
        promised += f64::from(v[1]) / (t * t);
    }
    let n = truth.len() as f64;
    assert!((bias / n).abs() < 2e-3, "bias {}", bias / n);
    let ratio = (square / promised).sqrt();
    assert!((0.8..1.25).contains(&ratio), "error over promised error: {ratio}");
}

#[test]
fn saturated_everywhere_is_a_flagged_lower_bound() {
    let merged = merged(&[100.0, 0.5], &EXPOSURES, false);
    assert_eq!(merged.clipped.pixels(), [true, false]);
    assert_eq!(merged.radiance.pixels()[0].0, [16.0; 3]);
    assert_eq!(merged.clipped_share(), 0.5);
}

#[test]
fn a_clipped_code_that_strays_below_the_level_is_no_reading() {
    // As JPEG leaves it: saturated, but one channel reads 97 % in all but the shortest exposure.
    let images: Vec<_> = EXPOSURES.iter().map(|e| shoot(&[8.0], *e, None)).collect();
    let strayed = |codes: &CodeImage| codes.map(|c| Code([c.0[0], c.0[1], c.0[2].min(0.97)]));
    let images: Vec<_> = images.iter().map(strayed).collect();
    let frames: Vec<_> =
        images.iter().zip(EXPOSURES).map(|(codes, exposure)| Frame { codes, exposure }).collect();
    let merged = merge(&frames, &Response::srgb(), 1.0, &config::Merge::default()).unwrap();
    let found = merged.radiance.pixels()[0].0;
    assert!(found.iter().all(|r| (r / 8.0 - 1.0).abs() < 0.02), "{found:?}");
}

#[test]
fn black_everywhere_stays_near_black_with_its_error() {
    let merged = merged(&[1e-9], &EXPOSURES, false);
    let (radiance, variance) = (merged.radiance.pixels()[0].0[1], merged.variance.pixels()[0][1]);
    assert!(
        !merged.clipped.pixels()[0] && radiance < 1e-4 && variance.sqrt() > radiance,
        "{radiance} {variance}"
    );
}

#[test]
fn equal_exposures_halve_the_variance() {
    let (one, two) = (merged(&[0.3], &[1.0], false), merged(&[0.3], &[1.0, 1.0], false));
    let ratio = two.variance.pixels()[0][0] / one.variance.pixels()[0][0];
    assert!((ratio - 0.5).abs() < 1e-3, "{ratio}");
    assert_eq!(one.radiance.pixels()[0].0[0], two.radiance.pixels()[0].0[0]);
}

#[test]
fn a_wrong_exposure_shows_as_disagreement() {
    let truth: Vec<f64> = (0..500).map(|i| 0.05 + f64::from(i) / 600.0).collect();
    let images: Vec<_> = [0.25, 1.0].iter().map(|e| shoot(&truth, *e, None)).collect();
    let response = Response::srgb();
    let disagreement = |said: f64| {
        let frames =
            [Frame { codes: &images[0], exposure: 0.25 }, Frame { codes: &images[1], exposure: said }];
        let merged = merge(&frames, &response, 1.0, &config::Merge::default()).unwrap();
        disagreement_stops(&frames, &merged, &response, 1.0).into_iter().fold(0.0, f64::max)
    };
    assert!(
        disagreement(1.0) < 0.02 && disagreement(2.0) > 0.3,
        "{} {}",
        disagreement(1.0),
        disagreement(2.0)
    );
}

#[test]
fn planes_hold_everything() {
    let merged = merged(&[100.0, 0.5, 1e-9], &EXPOSURES, false);
    assert_eq!(Merged::from_planes(&merged.planes()), Some(merged.clone()));
    assert_eq!(Merged::from_planes(&Planes::from_radiance(&merged.radiance)), None);
}

#[test]
fn what_cannot_be_merged_is_refused() {
    let (a, b) = (shoot(&[1.0], 1.0, None), shoot(&[1.0, 1.0], 1.0, None));
    let frame = |codes, exposure| Frame { codes, exposure };
    let merge = |frames: &[Frame], unit| merge(frames, &Response::srgb(), unit, &config::Merge::default());
    assert_eq!(merge(&[], 1.0).unwrap_err(), Problem::NoFrame);
    let e = merge(&[frame(&a, 1.0), frame(&b, 1.0)], 1.0).unwrap_err();
    assert_eq!(e.to_string(), "frame 2 is 2×1 px, the first 1×1 px");
    assert!(matches!(merge(&[frame(&a, f64::NAN)], 1.0), Err(Problem::Exposure { .. })));
    assert!(matches!(merge(&[frame(&a, 1.0)], 0.0), Err(Problem::Exposure { .. })));
}

proptest! {
    #[test]
    fn the_unit_is_the_plates_exposure(radiance in 0.01..10.0_f64, unit in 0.01..100.0_f64) {
        let images: Vec<_> = EXPOSURES.iter().map(|e| shoot(&[radiance], *e, None)).collect();
        let frames: Vec<_> = images.iter().zip(EXPOSURES).map(|(codes, exposure)| Frame { codes, exposure }).collect();
        let merge = |unit| merge(&frames, &Response::srgb(), unit, &config::Merge::default()).unwrap();
        let (one, other) = (merge(1.0), merge(unit));
        let (a, b) = (f64::from(one.radiance.pixels()[0].0[0]), f64::from(other.radiance.pixels()[0].0[0]));
        prop_assert!((b / a / unit - 1.0).abs() < 1e-4);
        prop_assert!((a / radiance - 1.0).abs() < 0.03, "{a} {radiance}");
    }

    #[test]
    fn any_codes_give_finite_radiance(codes in prop::collection::vec(0.0..=1.0_f32, 3), unit in 1e-6..1e6_f64) {
        let images: Vec<_> = codes.iter().map(|c| Image::from_pixels(1, 1, vec![Code([*c; 3])])).collect();
        let frames: Vec<_> = images.iter().zip(EXPOSURES).map(|(codes, exposure)| Frame { codes, exposure }).collect();
        let merged = merge(&frames, &Response::srgb(), unit, &config::Merge::default()).unwrap();
        prop_assert!(merged.radiance.pixels()[0].0.iter().all(|v| v.is_finite() && *v >= 0.0));
        prop_assert!(merged.variance.pixels()[0].iter().all(|v| v.is_finite() && *v > 0.0));
    }
}

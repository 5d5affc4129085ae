use super::*;
use crate::config;
use crate::error::Problem as _;
use crate::exposure::Frame;
use crate::image::{Code, CodeImage, Image};
use proptest::prelude::*;
use rand::{Rng, SeedableRng, rngs::SmallRng};

/// Stored code of a relative exposure: a film-like curve that is neither sRGB nor a power.
fn camera(exposure: f64) -> f64 {
    let x = exposure.clamp(0.0, 1.0);
    let y = x.powf(1.0 / 1.8);
    1.1 * y / (1.0 + 0.1 * y.powi(3))
}

/// A view of patches over five decades of radiance, photographed with noise (electrons of 12,000).
fn photograph(exposure: f64, noise: f64, seed: u64, store: impl Fn(f64) -> f64) -> CodeImage {
    let mut random = SmallRng::seed_from_u64(seed);
    let (width, height) = (200, 160);
    Image::from_fn(width, height, |x, y| {
        let place = (x / 16 * 7 + y / 16 * 13) % 97;
        let radiance = 10_f64.powf(place as f64 / 97.0 * 5.0 - 4.0);
        Code([1.0, 0.8, 0.6].map(|tint| {
            let sigma = noise * (radiance * tint * exposure / 12_000.0 + (5.0 / 12_000.0_f64).powi(2)).sqrt();
            // The sum of four uniforms is near enough to a normal.
            let normal: f64 = (0..4).map(|_| random.random_range(-0.866..0.866_f64)).sum();
            let code = store(radiance * tint * exposure + sigma * normal).clamp(0.0, 1.0);
            ((code * 255.0).round() / 255.0) as f32
        }))
    })
}

fn fit_exposures(taken: &[f64], said: &[f64], noise: f64) -> Result<Response, Problem> {
    let images: Vec<_> = taken.iter().zip(0..).map(|(e, seed)| photograph(*e, noise, seed, camera)).collect();
    let frames: Vec<_> = images.iter().zip(said).map(|(codes, e)| Frame { codes, exposure: *e }).collect();
    fit(&frames, &config::Response::default())
}

/// Largest relative error of exposure from `low` to the brightest code.
fn worst_error(response: &Response, low: usize) -> f64 {
    let error = |curve: &Curve, z: usize| (camera(curve.exposure[z]) / (z as f64 / 255.0)).ln().abs();
    (low..254).flat_map(|z| response.curves.iter().map(move |c| error(c, z))).fold(0.0, f64::max)
}

const STEPS: [f64; 6] = [0.25, 1.0, 4.0, 16.0, 64.0, 256.0];

#[test]
fn brackets_give_the_curve_and_its_scale() {
    let response = fit_exposures(&STEPS, &STEPS, 1.0).unwrap();
    assert!(worst_error(&response, 20) < 0.02, "{}", worst_error(&response, 20));
    let quality = response.quality.as_ref().unwrap();
    assert!(quality.rms_stops.iter().all(|r| *r < 0.05), "{quality:?}");
    assert!(quality.frame_stops.iter().all(|s| s.abs() < 0.03), "{quality:?}");
    assert!(response.curves.iter().all(|c| (c.exposure_of(1.0) - 1.0).abs() < 1e-6));
}

#[test]
fn the_count_of_samples_hardly_matters() {
    let images: Vec<_> = STEPS.iter().zip(0..).map(|(e, seed)| photograph(*e, 1.0, seed, camera)).collect();
    let frames: Vec<_> =
        images.iter().zip(STEPS).map(|(codes, exposure)| Frame { codes, exposure }).collect();
    let with = |samples| fit(&frames, &config::Response { samples, ..Default::default() }).unwrap();
    let (few, many) = (with(200), with(3000));
    for z in (20..255).step_by(5) {
        let ratio = few.curves[1].exposure[z] / many.curves[1].exposure[z];
        assert!((ratio - 1.0).abs() < 0.02, "level {z}: {ratio}");
    }
}

#[test]
fn two_exposures_are_enough() {
    let response = fit_exposures(&[8.0, 32.0], &[8.0, 32.0], 1.0).unwrap();
    assert!(worst_error(&response, 40) < 0.05, "{}", worst_error(&response, 40));
}

#[test]
fn equal_exposures_are_refused_but_a_double_is_not() {
    let e = fit_exposures(&[8.0; 3], &[8.0; 3], 1.0).unwrap_err();
    assert_eq!(e.to_string(), "3 frames have 1 distinct exposure, at least 2 are needed");
    let double = [1.0, 8.0, 8.0, 64.0];
    assert!(worst_error(&fit_exposures(&double, &double, 1.0).unwrap(), 40) < 0.04);
}

#[test]
fn two_and_three_exposures_are_judged_on_places_left_out_too() {
    for taken in [&[8.0, 32.0][..], &[2.0, 8.0, 32.0]] {
        let quality = fit_exposures(taken, taken, 1.0).unwrap().quality.unwrap();
        for (held_out, rms) in quality.held_out_stops.iter().zip(quality.rms_stops) {
            assert!((0.8 * rms..1.5 * rms + 0.005).contains(held_out), "{taken:?}: {quality:?}");
            assert!(*held_out < 0.05, "{taken:?}: {quality:?}");
        }
    }
    // Of three, one that is wrong shows; of two, any ratio is some camera's.
    let wrong = fit_exposures(&[2.0, 8.0, 32.0], &[2.0, 16.0, 32.0], 1.0).unwrap().quality.unwrap();
    assert!(wrong.held_out_stops.iter().all(|s| *s > 0.1), "{wrong:?}");
}

fn fit_with(taken: &[f64], said: &[f64], settings: &config::Response) -> Response {
    let images: Vec<_> = taken.iter().zip(0..).map(|(e, seed)| photograph(*e, 1.0, seed, camera)).collect();
    let frames: Vec<_> = images.iter().zip(said).map(|(codes, e)| Frame { codes, exposure: *e }).collect();
    fit(&frames, settings).unwrap()
}

#[test]
fn an_exposure_one_stop_off_shows_where_what_is_stated_is_taken() {
    let mut said = STEPS;
    said[3] *= 2.0;
    let settings = config::Response { exposures_from_pixels: false, ..Default::default() };
    let quality = fit_with(&STEPS, &said, &settings).quality.unwrap();
    let worst = (0..STEPS.len())
        .max_by(|a, b| quality.frame_stops[*a].abs().total_cmp(&quality.frame_stops[*b].abs()));
    assert!(quality.rms_stops[1] > 0.15, "{quality:?}");
    assert!(worst.is_some_and(|w| quality.frame_stops[w].abs() > 0.15), "{quality:?}");
}

#[test]
fn an_exposure_one_stop_off_is_found_from_the_pixels_and_no_other_is() {
    for (wrong, factor) in [(0, 2.0), (2, 0.5), (3, 2.0), (5, 0.5)] {
        let mut said = STEPS;
        said[wrong] *= factor;
        let response = fit_with(&STEPS, &said, &config::Response::default());
        for (i, e) in response.exposures.iter().enumerate() {
            assert_eq!(e.is_corrected(), i == wrong, "{i} of {wrong}: {e:?}");
            assert!((e.used / STEPS[i]).log2().abs() < 0.1, "{i} of {wrong}: {e:?}");
            assert!(e.found.is_finite() && e.sigma_stops.is_none_or(f64::is_finite));
        }
        assert!(worst_error(&response, 40) < 0.05, "{wrong}: {}", worst_error(&response, 40));
    }
}

#[test]
fn exposures_that_are_right_stay_as_stated() {
    for taken in [&STEPS[..], &[1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0], &[1.0, 8.0, 8.0, 64.0, 256.0]] {
        let response = fit_with(taken, taken, &config::Response::default());
        assert!(response.exposures.iter().all(|e| !e.is_doubtful()), "{:?}", response.exposures);
    }
}

#[test]
fn a_known_curve_tells_exposures_too() {
    let response = fit_with(&STEPS, &STEPS, &config::Response::default());
    let mut said = STEPS;
    said[1] *= 1.5;
    let images: Vec<_> = STEPS.iter().zip(10..).map(|(e, seed)| photograph(*e, 1.0, seed, camera)).collect();
    let sampled: Vec<_> = images
        .iter()
        .zip(said)
        .map(|(codes, exposure)| Sampled::new(&Frame { codes, exposure }).unwrap())
        .collect();
    let found = by_curve(&sampled, &response);
    for (i, e) in found.iter().enumerate() {
        assert_eq!(e.is_corrected(), i == 1, "{e:?}");
        assert!((e.used / STEPS[i]).log2().abs() < 0.06, "{e:?}");
    }
}

#[test]
fn every_method_finds_the_curve_and_auto_takes_one_of_them() {
    for method in config::ResponseMethod::ALL {
        let response = fit_with(&STEPS, &STEPS, &config::Response { method, ..Default::default() });
        assert_eq!(response.method, Some(method));
        response.check().unwrap();
        // Robertson's curve is not smooth: the worst of its levels is further off.
        let error = worst_error(&response, 40);
        assert!(error < 0.06, "{method:?}: {error}");
    }
    let auto = fit_with(&STEPS, &STEPS, &config::Response::default());
    assert!(auto.method.is_some_and(|m| config::ResponseMethod::ALL.contains(&m)));
    assert!(auto.quality.unwrap().held_out_stops.iter().all(|s| *s < 0.05));
}

#[test]
fn the_truth_lies_within_the_band() {
    let response = fit_with(&STEPS, &STEPS, &config::Response::default());
    let (mut inside, mut all) = (0_usize, 0_i32);
    for curve in &response.curves {
        // ln exposure at which the camera stores a level, by bisection.
        let truth = |z: usize| {
            let (mut low, mut high) = (1e-6_f64, 1.0);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if camera(middle) < z as f64 / 255.0 { low = middle } else { high = middle }
            }
            low.ln()
        };
        for z in 20..250 {
            all += 1;
            inside += usize::from(
                (curve.exposure[z].ln() - truth(z)).abs() <= 1.96 * curve.standard_error[z] + 0.003,
            );
        }
    }
    assert!(inside as f64 > 0.9 * f64::from(all), "{inside} of {all}");
}

#[test]
fn seeds_and_counts_stay_within_the_band() {
    let images: Vec<_> = STEPS.iter().zip(0..).map(|(e, seed)| photograph(*e, 1.0, seed, camera)).collect();
    let frames: Vec<_> =
        images.iter().zip(STEPS).map(|(codes, exposure)| Frame { codes, exposure }).collect();
    let with =
        |samples, seed| fit(&frames, &config::Response { samples, seed, ..Default::default() }).unwrap();
    let reference = with(100_000, 0);
    for (samples, seed) in [(50, 0), (200, 1), (200, 2), (1000, 3)] {
        let other = with(samples, seed);
        for (a, b) in other.curves.iter().zip(&reference.curves) {
            let outside = (20..250).filter(|z| {
                let band = 1.96 * a.standard_error[*z].hypot(b.standard_error[*z]) + 1e-3;
                (a.exposure[*z] / b.exposure[*z]).ln().abs() > band
            });
            assert!(outside.count() < 30, "{samples} samples, seed {seed}");
        }
    }
}

#[test]
fn all_clipped_or_all_black_is_refused_with_the_share() {
    let bright = [1e6, 2e6, 4e6];
    let e = fit_exposures(&bright, &bright, 1.0).unwrap_err();
    assert!(matches!(e, Problem::TooFew { clipped, .. } if clipped > 0.99), "{e}");
    assert_eq!(e.hint(), "add shorter exposures");
    let dark = [1e-6, 2e-6];
    let e = fit_exposures(&dark, &dark, 1.0).unwrap_err();
    assert!(matches!(e, Problem::TooFew { dark, .. } if dark > 0.99), "{e}");
}

#[test]
fn strong_noise_costs_accuracy_not_sense() {
    let response = fit_exposures(&STEPS, &STEPS, 8.0).unwrap();
    assert!(response.curves.iter().all(|c| c.exposure.windows(2).all(|w| w[0] < w[1])));
    assert!(worst_error(&response, 60) < 0.1, "{}", worst_error(&response, 60));
}

#[test]
fn frames_shifted_by_two_pixels_do_not_spoil_the_curve() {
    let images: Vec<_> = STEPS.iter().zip(0..).map(|(e, seed)| photograph(*e, 1.0, seed, camera)).collect();
    let moved: Vec<CodeImage> = images
        .iter()
        .enumerate()
        .map(|(i, image)| Image::from_fn(190, 150, |x, y| *image.at(x + 2 * (i % 3), y + i % 2)))
        .collect();
    let frames: Vec<_> = moved.iter().zip(STEPS).map(|(codes, exposure)| Frame { codes, exposure }).collect();
    let response = fit(&frames, &config::Response::default()).unwrap();
    // A quarter of all patches' area is seen beside its place in some frame.
    assert!(worst_error(&response, 30) < 0.08, "{}", worst_error(&response, 30));
}

#[test]
fn a_curve_that_falls_is_made_to_rise() {
    // Local tone mapping makes codes fall where light rises.
    let dented = |x: f64| camera(x) - 0.25 * (-((camera(x) - 0.6) / 0.06).powi(2)).exp();
    let images: Vec<_> = STEPS.iter().zip(0..).map(|(e, seed)| photograph(*e, 1.0, seed, dented)).collect();
    let frames: Vec<_> =
        images.iter().zip(STEPS).map(|(codes, exposure)| Frame { codes, exposure }).collect();
    let response = fit(&frames, &config::Response::default()).unwrap();
    response.check().unwrap();
    assert!(response.quality.unwrap().rms_stops[1] > 0.05);
}

#[test]
fn a_black_level_is_found_and_left_out() {
    let lifted = |x: f64| 16.0 / 255.0 + camera(x) * 239.0 / 255.0;
    let images: Vec<_> = STEPS.iter().zip(0..).map(|(e, seed)| photograph(*e, 1.0, seed, lifted)).collect();
    let frames: Vec<_> =
        images.iter().zip(STEPS).map(|(codes, exposure)| Frame { codes, exposure }).collect();
    let response = fit(&frames, &config::Response::default()).unwrap();
    for curve in &response.curves {
        assert!((curve.floor * 255.0 - 16.0).abs() < 2.0, "{}", curve.floor * 255.0);
        let error = (lifted(curve.exposure[120]) * 255.0 / 120.0).ln();
        assert!(error.abs() < 0.02, "{error}");
    }
}

#[test]
fn saturation_below_the_largest_code_is_found() {
    let low = |x: f64| camera(x) * 240.0 / 255.0;
    let images: Vec<_> = STEPS.iter().zip(0..).map(|(e, seed)| photograph(*e, 1.0, seed, low)).collect();
    let frames: Vec<_> =
        images.iter().zip(STEPS).map(|(codes, exposure)| Frame { codes, exposure }).collect();
    let response = fit(&frames, &config::Response::default()).unwrap();
    for curve in &response.curves {
        assert_eq!((curve.clip * 255.0).round(), 240.0);
        assert!((curve.exposure_of(240.0 / 255.0) - 1.0).abs() < 1e-6);
        assert!((low(curve.exposure[120]) * 255.0 / 120.0 - 1.0).abs() < 0.02);
    }
}

#[test]
fn unequal_sizes_and_impossible_exposures_are_refused() {
    let (a, b) = (
        CodeImage::from_fn(20, 20, |_, _| Code::default()),
        CodeImage::from_fn(21, 20, |_, _| Code::default()),
    );
    let frame = |codes, exposure| Frame { codes, exposure };
    let e = fit(&[frame(&a, 1.0), frame(&b, 2.0)], &config::Response::default()).unwrap_err();
    assert_eq!(e.to_string(), "frame 2 is 21×20 px, the first 20×20 px");
    let e = fit(&[frame(&a, 1.0), frame(&a, 0.0)], &config::Response::default()).unwrap_err();
    assert_eq!(e.to_string(), "frame 2 has the exposure 0");
    assert!(matches!(fit(&[], &config::Response::default()), Err(Problem::OneExposure { frames: 0, .. })));
}

proptest! {
    #[test]
    fn codes_and_exposures_are_inverse(code in prop::array::uniform3(0.0..=1.0_f32), steps in prop::collection::vec(0.01..1.0_f64, LEVELS)) {
        let mut response = Response::srgb();
        let mut sum = 0.0;
        let mut exposure: Vec<f64> = steps.iter().map(|s| { sum += s; sum }).collect();
        exposure.iter_mut().for_each(|e| *e /= sum);
        response.curves[1].exposure = exposure;
        let back = response.code_of(response.exposure_of(code));
        for k in 0..3 {
            prop_assert!((back[k] - code[k]).abs() < 2e-4, "{code:?} {back:?}");
        }
    }

    #[test]
    fn codes_rise_with_exposure_and_stay_in_range(a in -1.0..2.0_f32, b in -1.0..2.0_f32) {
        let response = Response::srgb();
        let code = |x: f32| response.code_of([x; 3])[0];
        prop_assert!((0.0..=1.0).contains(&code(a)));
        prop_assert!((a <= b) == (code(a) <= code(b)) || code(a) == code(b));
    }
}

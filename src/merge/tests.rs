use super::*;
use crate::image::Code;
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
fn a_pixel_is_merged_alike_wherever_it_stands() {
    let truth: Vec<f64> = (0..300).map(|i| 10_f64.powf(f64::from(i) / 60.0 - 3.0)).collect();
    let of = |images: &[CodeImage]| {
        let frames: Vec<_> =
            images.iter().zip(EXPOSURES).map(|(codes, exposure)| Frame { codes, exposure }).collect();
        merge(&frames, &Response::srgb(), 1.0, &config::Merge { deghost: false, ..Default::default() })
            .unwrap()
    };
    let row: Vec<_> = EXPOSURES.iter().zip(0..).map(|(e, seed)| shoot(&truth, *e, Some(seed))).collect();
    let merged = of(&row);
    for i in 0..truth.len() {
        let alone: Vec<_> = row.iter().map(|r| Image::from_pixels(1, 1, vec![r.pixels()[i]])).collect();
        let alone = of(&alone);
        assert_eq!(alone.radiance.pixels()[0].0, merged.radiance.pixels()[i].0, "{i}");
        assert_eq!(alone.variance.pixels()[0], merged.variance.pixels()[i], "{i}");
        assert_eq!(alone.clipped.pixels()[0], merged.clipped.pixels()[i], "{i}");
    }
}

#[test]
fn a_wrong_exposure_shows_as_disagreement() {
    let truth: Vec<f64> = (0..500).map(|i| 0.05 + f64::from(i) / 600.0).collect();
    let images: Vec<_> = [0.25, 1.0].iter().map(|e| shoot(&truth, *e, None)).collect();
    let response = Response::srgb();
    let disagreement = |said: f64| {
        let frames =
            [Frame { codes: &images[0], exposure: 0.25 }, Frame { codes: &images[1], exposure: said }];
        let settings = config::Merge { deghost: false, ..Default::default() };
        let summary = merge_in_bands(&frames, &response, 1.0, &settings, |_| Ok::<_, Problem>(())).unwrap();
        summary.frames.iter().map(|f| f.residual_stops).fold(0.0, f64::max)
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

/// What comes of four frames of 10 × 6 px as they are and in another order, told in the first one: radiance, who is left
/// out where, the summary.
fn in_two_orders(codes: &[[f32; 3]], exposures: [f64; 4], turn: usize) -> [(Merged, Vec<u64>, Summary); 2] {
    let images: Vec<CodeImage> =
        codes.chunks(60).map(|c| Image::from_pixels(10, 6, c.iter().map(|v| Code(*v)).collect())).collect();
    let mut turned = [0, 1, 2, 3];
    turned.rotate_left(turn);
    turned.swap(0, 1);
    [[0, 1, 2, 3], turned].map(|order| {
        let frames = order.map(|i| Frame { codes: &images[i], exposure: exposures[i] });
        let mut bands = Vec::new();
        let take = |band| {
            bands.push(band);
            Ok::<_, Problem>(())
        };
        let mut summary =
            merge_in_bands(&frames, &Response::srgb(), 1.0, &config::Merge::default(), take).unwrap();
        let Band { merged, left_out, .. } = bands.remove(0);
        let back = |bits: &u64| (0..4).filter(|k| bits & 1 << k != 0).fold(0, |b, k| b | 1 << order[k]);
        let of = summary.frames.clone();
        order.iter().zip(of).for_each(|(i, figures)| summary.frames[*i] = figures);
        let of = summary.residuals.clone();
        order.iter().zip(of).for_each(|(i, map)| summary.residuals[*i] = map);
        (merged, left_out.pixels().iter().map(back).collect(), summary)
    })
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

    #[test]
    fn scaling_all_exposures_scales_radiance_by_the_inverse(codes in prop::collection::vec(0.0..=1.0_f32, 4), k in 0.01..100.0_f64) {
        let images: Vec<CodeImage> = codes.iter().map(|c| Image::from_pixels(1, 1, vec![Code([*c; 3])])).collect();
        let merged = |k: f64| {
            let frames: Vec<_> = images.iter().zip(EXPOSURES).map(|(codes, e)| Frame { codes, exposure: e * k }).collect();
            merge(&frames, &Response::srgb(), 1.0, &config::Merge::default()).unwrap()
        };
        let (one, other) = (merged(1.0), merged(k));
        for c in 0..3 {
            let (a, b) = (f64::from(one.radiance.pixels()[0].0[c]), k * f64::from(other.radiance.pixels()[0].0[c]));
            prop_assert!((a - b).abs() <= 1e-4 * a.abs() + 1e-12, "{a} {b}");
        }
        prop_assert_eq!(one.clipped.pixels(), other.clipped.pixels());
    }

    #[test]
    fn the_order_of_frames_does_not_matter(codes in prop::collection::vec(prop::array::uniform3(0.0..=1.0_f32), 4 * 60), turn in 1..4_usize) {
        for exposures in [EXPOSURES, [1.0, 0.25, 1.0, 1.0]] {
            let [one, other] = in_two_orders(&codes, exposures, turn);
            prop_assert_eq!(one, other);
        }
    }

    #[test]
    fn one_frame_merges_to_its_linearisation(codes in prop::collection::vec(prop::array::uniform3(0.01..0.97_f32), 24)) {
        let image = Image::from_pixels(6, 4, codes.iter().map(|c| Code(*c)).collect());
        let response = Response::srgb();
        let merged = linearise(&image, &response, &config::Merge::default()).unwrap();
        for (merged, codes) in merged.radiance.pixels().iter().zip(&codes) {
            let exposure = response.exposure_of(*codes);
            for c in 0..3 {
                prop_assert!((merged.0[c] / exposure[c] - 1.0).abs() < 1e-5, "{merged:?} {exposure:?}");
            }
        }
    }

    #[test]
    fn bands_and_files_make_no_difference(codes in prop::collection::vec(prop::array::uniform3(0_u8..=255), 3 * 16 * 12)) {
        use crate::exposure::{Rows, Samples, Spooled, Stored};
        let stored: Vec<Stored> = codes
            .chunks(16 * 12)
            .map(|c| Stored { width: 16, height: 12, samples: Samples::Eight(c.concat()) })
            .collect();
        let spooled: Vec<Spooled> = stored.iter().map(|s| Spooled::new(s).unwrap()).collect();
        let frame = |codes, exposure| Frame { codes, exposure };
        let held: Vec<_> = stored.iter().zip(EXPOSURES).map(|(s, e)| frame(s as &dyn Rows, e)).collect();
        let aside: Vec<_> = spooled.iter().zip(EXPOSURES).map(|(s, e)| frame(s as &dyn Rows, e)).collect();
        let of = |frames: &[Frame]| merge(frames, &Response::srgb(), 1.0, &config::Merge::default()).unwrap();
        prop_assert_eq!(of(&held), of(&aside));
    }
}

/// Light that rises slowly from left to right; a patch of the second frame shows something else.
fn with_ghost(patch: std::ops::Range<usize>, light: f32) -> (Vec<CodeImage>, Image<f32>) {
    let response = Response::srgb();
    let truth = Image::from_fn(80, 60, |x, y| 0.03 + 0.0015 * x as f32 + 0.0005 * y as f32);
    let images = EXPOSURES.iter().enumerate().map(|(i, e)| {
        Image::from_fn(80, 60, |x, y| {
            let ghost = i == 1 && patch.contains(&x) && patch.contains(&y);
            let seen = if ghost { light } else { *truth.at(x, y) };
            Code(response.code_of([seen * *e as f32; 3]).map(|c| (c * 255.0).round() / 255.0))
        })
    });
    (images.collect(), truth)
}

#[test]
fn what_moved_is_taken_from_the_other_frames_and_masked() {
    // Brighter, darker, clipped in a short exposure.
    for light in [0.6, 0.002, 40.0] {
        let (images, truth) = with_ghost(20..36, light);
        let frames: Vec<_> =
            images.iter().zip(EXPOSURES).map(|(codes, exposure)| Frame { codes, exposure }).collect();
        let (mut worst, mut inside, mut outside) = (0.0_f32, 0, 0);
        let check = |band: Band| {
            for y in 0..band.left_out.height() {
                for x in 0..80 {
                    let truth = truth.at(x, band.top + y);
                    worst = worst.max((band.merged.radiance.at(x, y).0[1] / truth - 1.0).abs());
                    let within = |i: usize| (20..36).contains(&i);
                    let near = |i: usize| (17..39).contains(&i);
                    let masked = *band.left_out.at(x, y) == 0b10;
                    inside += usize::from(within(x) && within(band.top + y) && masked);
                    outside += usize::from(!(near(x) && near(band.top + y)) && *band.left_out.at(x, y) != 0);
                }
            }
            Ok::<_, Problem>(())
        };
        let summary =
            merge_in_bands(&frames, &Response::srgb(), 1.0, &config::Merge::default(), check).unwrap();
        assert!(worst < 0.06, "light {light}: {worst}");
        assert_eq!((inside, outside), (256, 0), "light {light}");
        assert!(summary.frames[1].left_out_share > 0.05 && summary.frames[2].left_out_share == 0.0);
    }
}

#[test]
fn a_frame_that_is_clipped_where_longer_ones_are_not_is_no_lower_bound() {
    // As the painted border of a scan: one channel saturated, the others black, in the shorter frames.
    let (mut images, truth) = with_ghost(0..0, 0.0);
    for image in &mut images[..2] {
        *image = Image::from_fn(80, 60, |x, y| if x < 12 { Code([0.0, 0.0, 1.0]) } else { *image.at(x, y) });
    }
    let frames: Vec<_> =
        images.iter().zip(EXPOSURES).map(|(codes, exposure)| Frame { codes, exposure }).collect();
    let merged = merge(&frames, &Response::srgb(), 1.0, &config::Merge::default()).unwrap();
    for (x, y) in (0..60).flat_map(|y| (0..80).map(move |x| (x, y))) {
        let (seen, truth) = (merged.radiance.at(x, y).0, truth.at(x, y));
        assert!(seen.iter().all(|v| (v / truth - 1.0).abs() < 0.06), "{x} {y}: {seen:?} {truth}");
        assert!(!merged.clipped.at(x, y));
    }
}

#[test]
fn a_small_lamp_that_two_short_frames_alone_hold_is_not_lost_to_their_ringing() {
    const LAMP: f32 = 300.0;
    let exposures = [1.0 / 512.0, 1.0 / 128.0, 1.0 / 32.0, 0.25, 1.0];
    let response = Response::srgb();
    let lamp = |x: usize, y: usize| (10..12).contains(&x) && (10..12).contains(&y);
    let near = |x: usize, y: usize| (8..16).contains(&x) && (8..16).contains(&y);
    let images: Vec<CodeImage> = exposures
        .iter()
        .map(|e| {
            Image::from_fn(24, 24, |x, y| {
                let seen = if lamp(x, y) { LAMP } else { 0.3 };
                let code = response.code_of([seen * *e; 3]).map(|c| (c * 255.0).round() / 255.0);
                // What JPEG leaves in the lamp's block.
                let rings = near(x, y) && !lamp(x, y) && (x + y).is_multiple_of(2);
                Code(code.map(|c| if rings { c.max(10.0 / 255.0) } else { c }))
            })
        })
        .collect();
    let frames: Vec<_> = (images.iter().zip(exposures))
        .map(|(codes, exposure)| Frame { codes, exposure: f64::from(exposure) })
        .collect();
    let merged = merge(&frames, &response, 1.0, &config::Merge::default()).unwrap();
    for (x, y) in (10..12).flat_map(|y| (10..12).map(move |x| (x, y))) {
        assert!(!merged.clipped.at(x, y));
        let seen = merged.radiance.at(x, y).0;
        assert!(seen.iter().all(|v| (v / LAMP - 1.0).abs() < 0.03), "{x} {y}: {seen:?}");
    }
    // The ringing itself is not believed.
    let seen = merged.radiance.at(8, 8).0;
    assert!(seen.iter().all(|v| (v / 0.3 - 1.0).abs() < 0.06), "{seen:?}");
}

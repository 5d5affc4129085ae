//! How far curves and radiance are off.

use crate::image::{Image, RadianceImage};

/// Codes over which curves are compared.
pub(super) const CODES: std::ops::RangeInclusive<usize> = 10..=245;

/// RMS of log2 of the ratio of two curves over [`CODES`], stops, one factor free.
pub(super) fn curve_stops(curve: &[f64], truth: &[f64]) -> f64 {
    let logs: Vec<f64> = CODES.map(|z| (curve[z].max(1e-12) / truth[z].max(1e-12)).log2()).collect();
    let mean = logs.iter().sum::<f64>() / logs.len() as f64;
    (logs.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / logs.len() as f64).sqrt()
}

/// Median and 95th percentile.
pub(super) fn quantiles(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| {
        values.get(((values.len() as f64 - 1.0) * share).round() as usize).copied().unwrap_or(f64::NAN)
    };
    [at(0.5), at(0.95)]
}

/// Factor that brings each channel to the truth: the median ratio where `counts`.
pub(super) fn scales(radiance: &RadianceImage, truth: &RadianceImage, counts: &Image<[bool; 3]>) -> [f64; 3] {
    std::array::from_fn(|k| {
        let ratios = (0..truth.pixels().len())
            .filter(|i| counts.pixels()[*i][k] && radiance.pixels()[*i].0[k] > 0.0)
            .map(|i| f64::from(truth.pixels()[i].0[k] / radiance.pixels()[i].0[k]));
        quantiles(ratios.collect())[0]
    })
}

/// Relative errors of all channels of all pixels that count, and the same in units of σ where a variance is given.
pub(super) fn relative(
    radiance: &RadianceImage,
    variance: Option<&Image<[f32; 3]>>,
    truth: &RadianceImage,
    counts: &Image<[bool; 3]>,
) -> (Vec<f64>, Vec<f64>) {
    let scales = scales(radiance, truth, counts);
    let (mut errors, mut sigmas) = (Vec::new(), Vec::new());
    for (i, t) in truth.pixels().iter().enumerate() {
        for k in (0..3).filter(|k| counts.pixels()[i][*k]) {
            let (ours, truth) = (f64::from(radiance.pixels()[i].0[k]) * scales[k], f64::from(t.0[k]));
            errors.push(if ours.is_finite() { (ours / truth - 1.0).abs() } else { f64::INFINITY });
            if let Some(variance) = variance {
                sigmas.push((ours - truth).abs() / (f64::from(variance.pixels()[i][k]).sqrt() * scales[k]));
            }
        }
    }
    (errors, sigmas)
}

/// Median |log2 ratio| per channel where both are above 0, after one factor a channel.
pub(super) fn log_ratio_stops(
    radiance: &RadianceImage,
    published: &RadianceImage,
    counts: &Image<bool>,
) -> [f64; 3] {
    std::array::from_fn(|k| {
        let logs = || {
            (0..published.pixels().len()).filter(|i| counts.pixels()[*i]).filter_map(|i| {
                let (a, b) = (radiance.pixels()[i].0[k], published.pixels()[i].0[k]);
                (a > 0.0 && b > 0.0 && a.is_finite()).then(|| f64::from(a / b).log2())
            })
        };
        let middle = quantiles(logs().collect())[0];
        quantiles(logs().map(|l| (l - middle).abs()).collect())[0]
    })
}

//! All picture figures of one composite against one reference.

use super::figures::Measured;
use super::{display, errors, region};
use crate::composite::view;
use crate::image::{CodeImage, Image, Radiance, RadianceImage};

/// What the pipeline made, plate units.
pub struct Ours<'a> {
    /// Merged plate.
    pub plate: &'a RadianceImage,
    /// Augmented picture.
    pub composite: &'a RadianceImage,
    /// Coverage of the object.
    pub coverage: &'a Image<f32>,
    /// Where the plate is clipped in every exposure.
    pub clipped: &'a Image<bool>,
}

/// What it should be, in a unit of its own.
pub struct Reference {
    /// The scene with the object.
    pub with: RadianceImage,
    /// The scene without it; the plate takes its place if there is none.
    pub empty: Option<RadianceImage>,
    /// Coverage of the object; ours takes its place if there is none.
    pub mask: Option<Image<f32>>,
}

/// Why pictures cannot be compared.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum Problem {
    /// Sizes differ.
    #[error("{what} is {}×{} px, the plate {}×{} px", size.0, size.1, plate.0, plate.1)]
    Size {
        /// Which reference.
        what: &'static str,
        /// Its size, px.
        size: (usize, usize),
        /// Size of the plate, px.
        plate: (usize, usize),
    },
    /// Nothing to find the scale by.
    #[error("no pixel is bright and unclipped in both plate and reference, so their scale is unknown")]
    NoScale,
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::Size { .. } => "give references of the plate's view and size, or none",
            Self::NoScale => "check `evaluate.reference_empty`: it must show the plate's scene, linear",
        }
        .into()
    }
}

/// Pictures for the report, plate units.
#[derive(Debug, Clone)]
pub struct Comparison {
    /// The reference.
    pub with: RadianceImage,
    /// ε − ε*.
    pub removal_error: RadianceImage,
    /// Where the shadow is measured.
    pub shadow_region: Image<bool>,
    /// rms(ε*) over the region and mean of T there, plate units.
    pub rms_and_mean: Option<(f64, f64)>,
}

/// Measures all figures of pictures; `encode` maps radiance to display codes.
pub fn compare(
    ours: &Ours,
    reference: &Reference,
    encode: impl Fn([f32; 3]) -> [f32; 3],
    out: &mut Measured,
) -> Result<Comparison, Problem> {
    let plate = ours.plate.size();
    let check = |what, size| if size == plate { Ok(()) } else { Err(Problem::Size { what, size, plate }) };
    check("the reference", reference.with.size())?;
    reference.empty.iter().try_for_each(|e| check("the empty reference", e.size()))?;
    reference.mask.iter().try_for_each(|m| check("the reference's mask", m.size()))?;
    let mask = reference.mask.as_ref().unwrap_or(ours.coverage);
    let usable = ours.clipped.map(|c| !c);
    let scale = errors::scale(ours.plate, reference.empty.as_ref().unwrap_or(&reference.with), &usable)
        .ok_or(Problem::NoScale)?;
    out.put("reference_scale", scale.global);
    let tint = scale.channels.iter().map(|c| (c / scale.global - 1.0).abs()).fold(0.0, f64::max);
    out.put("reference_tint", tint);
    let scaled =
        |image: &RadianceImage| image.map(|p| Radiance(p.0.map(|v| (f64::from(v) * scale.global) as f32)));
    let with = scaled(&reference.with);
    let empty = reference.empty.as_ref().map_or_else(|| ours.plate.clone(), scaled);

    let near = region::near_object(ours.coverage, mask);
    let shadow = region::shadow(&with, &empty, &near);
    let object = region::object_interior(ours.coverage, mask);
    let count = |r: &Image<bool>| r.pixels().iter().filter(|p| **p).count();
    out.put("shadow_region_px", count(&shadow) as f64);
    out.put("object_region_px", count(&object) as f64);

    let removed = errors::difference(ours.plate, ours.composite);
    let removed_in_truth = errors::difference(&empty, &with);
    let removal = errors::removal(&removed, &removed_in_truth, &shadow);
    if let Some(e) = removal {
        out.put_with_baseline("relative_shadow_error", e.relative, Some(1.0));
        out.put_with_baseline("shadow_energy_bias", e.energy_bias, Some(-1.0));
    }
    let block = |image: &RadianceImage, r: &Image<bool>| errors::block_means(image, r).0;
    let (_, shadow_blocks) = errors::block_means(&removed, &shadow);
    let coarse =
        errors::removal(&block(&removed, &shadow), &block(&removed_in_truth, &shadow), &shadow_blocks);
    if let Some(e) = coarse {
        out.put_with_baseline("relative_shadow_error_4x4", e.relative, Some(1.0));
    }
    let composite = |image: &RadianceImage| errors::picture(image, &with, &shadow).map(|e| e.relative_rmse);
    if let Some(e) = composite(ours.composite) {
        out.put_with_baseline("composite_relative_rmse", e, composite(ours.plate));
    }
    let composite_blocks = |image: &RadianceImage| {
        errors::picture(&block(image, &shadow), &block(&with, &shadow), &shadow_blocks)
            .map(|e| e.relative_rmse)
    };
    if let Some(e) = composite_blocks(ours.composite) {
        out.put_with_baseline("composite_relative_rmse_4x4", e, composite_blocks(ours.plate));
    }
    if let Some(e) = errors::picture(ours.composite, &with, &object) {
        out.put("object_relative_rmse", e.relative_rmse);
        out.put("object_bias", e.bias);
    }
    let (means, object_blocks) = errors::block_means(ours.composite, &object);
    if let Some(e) = errors::picture(&means, &block(&with, &object), &object_blocks) {
        out.put("object_relative_rmse_4x4", e.relative_rmse);
    }
    if reference.mask.is_some() {
        let total: f64 = mask.pixels().iter().map(|m| f64::from(*m)).sum();
        let off = ours.coverage.pixels().iter().zip(mask.pixels()).map(|(a, m)| f64::from((a - m).abs()));
        out.put("coverage_error", off.sum::<f64>() / total);
    }
    let show = |image: &RadianceImage| -> CodeImage { view(image, 0.0, &encode) };
    let (ours_seen, plate_seen, truth_seen) = (show(ours.composite), show(ours.plate), show(&with));
    let baseline = display::flip(&plate_seen, &truth_seen);
    out.put_with_baseline("flip", display::flip(&ours_seen, &truth_seen), Some(baseline));
    if let Some(s) = display::ssim(&ours_seen, &truth_seen) {
        out.put_with_baseline("ssim", s, display::ssim(&plate_seen, &truth_seen));
    }
    if let Some(empty) = &reference.empty {
        let error = errors::median_relative_error(ours.plate, empty, &usable, scale.global);
        error.into_iter().for_each(|e| out.put("radiance_error_percent", 100.0 * e));
    }
    let mean = with
        .pixels()
        .iter()
        .zip(shadow.pixels())
        .filter(|(_, s)| **s)
        .map(|(p, _)| p.0.iter().map(|v| f64::from(*v)).sum::<f64>() / 3.0);
    let mean = mean.sum::<f64>() / count(&shadow).max(1) as f64;
    Ok(Comparison {
        removal_error: errors::difference(&removed, &removed_in_truth),
        with,
        shadow_region: shadow,
        rms_and_mean: removal.map(|e| (e.rms, mean)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (48, 32);

    fn linear(v: [f32; 3]) -> [f32; 3] {
        v
    }

    fn empty() -> RadianceImage {
        Image::from_fn(SIZE.0, SIZE.1, |x, y| Radiance([0.4 + 0.01 * ((x * 5 + y * 3) % 7) as f32; 3]))
    }

    /// Shadow in columns 10..30, object in columns 20..24.
    fn with() -> RadianceImage {
        let e = empty();
        Image::from_fn(SIZE.0, SIZE.1, |x, y| {
            let left = if (20..24).contains(&x) {
                0.2
            } else if (10..30).contains(&x) {
                0.7
            } else {
                1.0
            };
            Radiance(e.at(x, y).0.map(|v| v * left))
        })
    }

    fn coverage() -> Image<f32> {
        Image::from_fn(SIZE.0, SIZE.1, |x, _| if (20..24).contains(&x) { 1.0 } else { 0.0 })
    }

    fn measure(composite: &RadianceImage, scale: f32) -> BTreeFigures {
        let clipped = Image::from_fn(SIZE.0, SIZE.1, |_, _| false);
        let (plate, coverage) = (empty(), coverage());
        let ours = Ours { plate: &plate, composite, coverage: &coverage, clipped: &clipped };
        let unscale = |i: RadianceImage| i.map(|p| Radiance(p.0.map(|v| v / scale)));
        let reference =
            Reference { with: unscale(with()), empty: Some(unscale(empty())), mask: Some(coverage.clone()) };
        let mut out = Measured::default();
        compare(&ours, &reference, linear, &mut out).unwrap();
        out.figures(&Default::default()).into_iter().map(|f| (f.name.clone(), f)).collect()
    }

    type BTreeFigures = std::collections::BTreeMap<String, super::super::Figure>;

    #[test]
    fn the_truth_itself_has_no_error_in_any_unit() {
        for scale in [1.0, 0.25] {
            let f = measure(&with(), scale);
            for (name, expected) in [
                ("relative_shadow_error", 0.0),
                ("relative_shadow_error_4x4", 0.0),
                ("shadow_energy_bias", 0.0),
                ("composite_relative_rmse", 0.0),
                ("object_relative_rmse", 0.0),
                ("object_bias", 0.0),
                ("coverage_error", 0.0),
                ("flip", 0.0),
                ("ssim", 1.0),
                ("radiance_error_percent", 0.0),
                ("reference_scale", f64::from(scale)),
            ] {
                let value = f[name].value.unwrap();
                assert!((value - expected).abs() < 1e-6, "{name} = {value}");
            }
        }
    }

    #[test]
    fn doing_nothing_has_relative_shadow_error_one() {
        let f = measure(&empty(), 1.0);
        assert_eq!(f["relative_shadow_error"].value, Some(1.0));
        assert_eq!(f["shadow_energy_bias"].value, Some(-1.0));
        assert_eq!(f["composite_relative_rmse"].value, f["composite_relative_rmse"].baseline);
        assert_eq!(f["flip"].value, f["flip"].baseline);
        assert_eq!(f["shadow_region_px"].value, Some(((20 - 2 - 10) + (30 - 26)) as f64 * SIZE.1 as f64));
    }

    #[test]
    fn half_a_shadow_has_half_the_error() {
        let (e, t) = (empty(), with());
        let half = Image::from_fn(SIZE.0, SIZE.1, |x, y| {
            Radiance(std::array::from_fn(|k| (e.at(x, y).0[k] + t.at(x, y).0[k]) / 2.0))
        });
        let f = measure(&half, 1.0);
        assert!((f["relative_shadow_error"].value.unwrap() - 0.5).abs() < 1e-5);
        assert!((f["shadow_energy_bias"].value.unwrap() + 0.5).abs() < 1e-5);
    }

    #[test]
    fn another_size_is_refused() {
        let (plate, coverage) = (empty(), coverage());
        let clipped = Image::from_fn(SIZE.0, SIZE.1, |_, _| false);
        let ours = Ours { plate: &plate, composite: &plate, coverage: &coverage, clipped: &clipped };
        let small = Image::from_fn(8, 8, |_, _| Radiance([1.0; 3]));
        let reference = Reference { with: small, empty: None, mask: None };
        let e = compare(&ours, &reference, linear, &mut Measured::default()).unwrap_err();
        assert_eq!(e.to_string(), "the reference is 8×8 px, the plate 48×32 px");
    }
}

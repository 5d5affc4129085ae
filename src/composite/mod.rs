//! Differential rendering in linear radiance (Debevec 1998; tutorial eq. 2–3) and the way back to stored codes.

mod png;

pub(crate) use png::encode_png;
pub use png::write_png;

use crate::image::{Code, CodeImage, Image, Radiance, RadianceImage};
use crate::render::Layer;
use rayon::prelude::*;

/// Why layers cannot be put together.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum Problem {
    /// Layers of different sizes.
    #[error("{layer} is {}×{} px, the plate {}×{} px", size.0, size.1, plate.0, plate.1)]
    Size {
        /// Which layer.
        layer: &'static str,
        /// Its size, px.
        size: (usize, usize),
        /// Size of the plate, px.
        plate: (usize, usize),
    },
    /// Coverage beyond 0..1.
    #[error("the object's coverage at pixel ({x}, {y}) is {coverage}, expected 0..1")]
    Coverage {
        /// Column.
        x: usize,
        /// Row.
        y: usize,
        /// What it is.
        coverage: f32,
    },
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        "run `insitu run --from merge` so that all layers belong to the same plate".into()
    }
}

/// The augmented picture and what had to be clamped.
#[derive(Debug, Clone, PartialEq)]
pub struct Composite {
    /// Linear radiance, plate units, never negative.
    pub radiance: RadianceImage,
    /// Pixels where more radiance was to be removed than was there.
    pub clamped_px: usize,
    /// Share of all removed radiance that could not be removed.
    pub clamped_share: f64,
}

/// What the object removes less what it reflects.
pub fn net(removed: &RadianceImage, reflected: &RadianceImage) -> Result<RadianceImage, Problem> {
    check_size(removed.size(), "the reflected radiance", reflected.size())?;
    let pixels = removed.pixels().iter().zip(reflected.pixels());
    let pixels = pixels.map(|(e, a)| Radiance(std::array::from_fn(|k| e.0[k] - a.0[k]))).collect();
    Ok(Image::from_pixels(removed.width(), removed.height(), pixels))
}

/// `C = (B − ε)(1 − A) + O` with plate B, removed radiance ε (less what the object adds, so it may be negative),
/// premultiplied object O of coverage A. Where the object
/// changes nothing (ε = 0, A = 0), C is B, bit for bit. Where the object covers a pixel in part, ε is that of the
/// neighbours that it leaves free: the pixel's own may be that of the floor below the object, which nobody sees.
pub fn composite(
    plate: &RadianceImage,
    removed: &RadianceImage,
    object: &Layer,
) -> Result<Composite, Problem> {
    check_size(plate.size(), "the removed radiance", removed.size())?;
    check_size(plate.size(), "the object", object.colour.size())?;
    let outside = |a: &f32| !(0.0..=1.0).contains(a);
    if let Some(i) = object.coverage.pixels().iter().position(outside) {
        let coverage = object.coverage.pixels()[i];
        return Err(Problem::Coverage { x: i % plate.width(), y: i / plate.width(), coverage });
    }
    let mut pixels = vec![Radiance::default(); plate.pixels().len()];
    let row = |(y, row): (usize, &mut [Radiance])| {
        let mut clamps = Clamps::default();
        for (x, to) in row.iter_mut().enumerate() {
            let i = y * plate.width() + x;
            let (b, o, a) = (plate.pixels()[i].0, object.colour.pixels()[i].0, object.coverage.pixels()[i]);
            let e = if a > 0.0 && a < 1.0 {
                removed_beside(plate, removed, object, i)
            } else {
                removed.pixels()[i].0
            };
            let mut clamped = false;
            for k in 0..3 {
                let left = b[k] - e[k];
                if e[k] > 0.0 && a < 1.0 {
                    clamps.total += f64::from(e[k]);
                    if left < 0.0 {
                        clamps.excess += f64::from(-left);
                        clamped = true;
                    }
                }
                to.0[k] = left.max(0.0) * (1.0 - a) + o[k].max(0.0);
            }
            clamps.px += usize::from(clamped);
        }
        clamps
    };
    let rows: Vec<Clamps> = pixels.par_chunks_mut(plate.width().max(1)).enumerate().map(row).collect();
    let all = rows.into_iter().fold(Clamps::default(), |a, b| Clamps {
        px: a.px + b.px,
        excess: a.excess + b.excess,
        total: a.total + b.total,
    });
    Ok(Composite {
        radiance: Image::from_pixels(plate.width(), plate.height(), pixels),
        clamped_px: all.px,
        clamped_share: if all.total > 0.0 { all.excess / all.total } else { 0.0 },
    })
}

/// Pixels that were clamped, radiance that could not be removed, and all that was to be.
#[derive(Default)]
struct Clamps {
    px: usize,
    excess: f64,
    total: f64,
}

/// ε of a pixel that removes the same share of the plate as its neighbours without object do; its own if it has none.
fn removed_beside(plate: &RadianceImage, removed: &RadianceImage, object: &Layer, i: usize) -> [f32; 3] {
    let (width, height) = plate.size();
    let (x, y) = (i % width, i / width);
    let (mut before, mut gone) = ([0.0f32; 3], [0.0f32; 3]);
    for v in y.saturating_sub(1)..(y + 2).min(height) {
        for u in x.saturating_sub(1)..(x + 2).min(width) {
            if *object.coverage.at(u, v) == 0.0 {
                let (b, e) = (plate.at(u, v).0, removed.at(u, v).0);
                (0..3).for_each(|k| (before[k], gone[k]) = (before[k] + b[k], gone[k] + e[k]));
            }
        }
    }
    let (own, b) = (removed.pixels()[i].0, plate.pixels()[i].0);
    std::array::from_fn(|k| if before[k] > 0.0 { b[k] * gone[k] / before[k] } else { own[k] })
}

/// Stored codes of the augmented picture. `codes` is the plate as the camera stored it; `encode` maps radiance in plate
/// units to codes. A pixel that did not change keeps its code; elsewhere the code of C carries on what the photograph
/// has beyond its mean, its code less the code of B: grain, quantisation, the camera's own processing. Photon noise is about
/// even in codes of a photographic response, so grain in shadow has the strength that a camera would give it. Where
/// the shadow was subtracted from the codes themselves, `shadowed` is what that left: it stands where no object is.
pub fn picture(
    codes: &CodeImage,
    shadowed: Option<&CodeImage>,
    plate: &RadianceImage,
    composite: &RadianceImage,
    object: &Layer,
    encode: impl Fn([f32; 3]) -> [f32; 3],
) -> Result<CodeImage, Problem> {
    check_size(plate.size(), "the photograph", codes.size())?;
    if let Some(shadowed) = shadowed {
        check_size(plate.size(), "the shadowed photograph", shadowed.size())?;
    }
    let pixels = (0..plate.pixels().len()).map(|i| {
        let (stored, b, c) = (codes.pixels()[i].0, plate.pixels()[i].0, composite.pixels()[i].0);
        let a = object.coverage.pixels()[i];
        if let Some(shadowed) = shadowed.filter(|_| a == 0.0) {
            return shadowed.pixels()[i];
        }
        if a == 0.0 && b == c {
            return Code(stored);
        }
        let (code, before) = (encode(c), encode(b));
        Code(std::array::from_fn(|k| (code[k] + (1.0 - a) * (stored[k] - before[k])).clamp(0.0, 1.0)))
    });
    Ok(Image::from_pixels(plate.width(), plate.height(), pixels.collect()))
}

/// A view of a linear picture through `encode`, scaled by `exposure_ev` stops.
pub fn view(image: &RadianceImage, exposure_ev: f32, encode: impl Fn([f32; 3]) -> [f32; 3]) -> CodeImage {
    let scale = exposure_ev.exp2();
    image.map(|p| Code(encode(p.0.map(|v| v * scale)).map(|v| v.clamp(0.0, 1.0))))
}

fn check_size(plate: (usize, usize), layer: &'static str, size: (usize, usize)) -> Result<(), Problem> {
    if size == plate { Ok(()) } else { Err(Problem::Size { layer, size, plate }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn image(values: &[[f32; 3]]) -> RadianceImage {
        Image::from_pixels(values.len(), 1, values.iter().map(|v| Radiance(*v)).collect())
    }

    fn layer(colour: &[[f32; 3]], coverage: &[f32]) -> Layer {
        Layer {
            colour: image(colour),
            coverage: Image::from_pixels(coverage.len(), 1, coverage.to_vec()),
            depth: Image::from_pixels(coverage.len(), 1, vec![1.0; coverage.len()]),
        }
    }

    fn gamma(v: [f32; 3]) -> [f32; 3] {
        v.map(|v| v.clamp(0.0, 1.0).powf(1.0 / 2.2))
    }

    #[test]
    fn the_equation_holds() {
        let c = composite(
            &image(&[[1.0, 0.5, 0.25]; 3]),
            &image(&[[0.5, 0.25, 0.5], [0.5; 3], [9.0; 3]]),
            &layer(&[[0.0; 3], [0.125; 3], [0.75; 3]], &[0.0, 0.5, 1.0]),
        )
        .unwrap();
        assert_eq!(c.radiance.pixels()[0].0, [0.5, 0.25, 0.0]);
        assert_eq!(c.radiance.pixels()[1].0, [0.375, 0.25, 0.125], "as much goes as beside it");
        assert_eq!(c.radiance.pixels()[2].0, [0.75; 3], "under full coverage the plate does not matter");
        assert_eq!(c.clamped_px, 2);
        assert!((c.clamped_share - 0.5 / 2.5).abs() < 1e-6, "{}", c.clamped_share);
    }

    #[test]
    fn the_outline_of_a_base_shows_the_floor_beside_it() {
        let object = layer(&[[0.0; 3], [0.1; 3], [0.2; 3]], &[0.0, 0.5, 1.0]);
        // The pixel in the middle looks at the floor under the base, where no light is left.
        let c = composite(&image(&[[1.0; 3]; 3]), &image(&[[0.1; 3], [1.0; 3], [1.0; 3]]), &object).unwrap();
        assert!((c.radiance.pixels()[1].0[0] - (0.5 * 0.9 + 0.1)).abs() < 1e-6);
    }

    #[test]
    fn other_sizes_are_refused() {
        let e = composite(&image(&[[1.0; 3]; 2]), &image(&[[0.0; 3]]), &layer(&[[0.0; 3]; 2], &[0.0; 2]))
            .unwrap_err();
        assert_eq!(e.to_string(), "the removed radiance is 1×1 px, the plate 2×1 px");
        let e = composite(&image(&[[1.0; 3]]), &image(&[[0.0; 3]]), &layer(&[[0.0; 3]], &[1.5])).unwrap_err();
        assert!(matches!(e, Problem::Coverage { x: 0, y: 0, .. }));
    }

    #[test]
    fn grain_survives_in_shadow() {
        let plate = image(&[[0.5; 3]; 2]);
        let codes = plate.map(|p| Code(gamma(p.0))).map(|c| Code(c.0.map(|v| v + 0.01)));
        let object = layer(&[[0.0; 3]; 2], &[0.0; 2]);
        let c = composite(&plate, &image(&[[0.25; 3], [0.0; 3]]), &object).unwrap();
        let out = picture(&codes, None, &plate, &c.radiance, &object, gamma).unwrap();
        assert!((out.pixels()[0].0[0] - gamma([0.25; 3])[0] - 0.01).abs() < 1e-6);
        assert_eq!(out.pixels()[1], codes.pixels()[1]);
    }

    #[test]
    fn codes_that_were_subtracted_from_stand_beside_the_object() {
        let plate = image(&[[0.5; 3]; 2]);
        let codes = plate.map(|p| Code(gamma(p.0)));
        let shadowed = codes.map(|c| Code(c.0.map(|v| v - 0.1)));
        let object = layer(&[[0.0; 3], [0.25; 3]], &[0.0, 1.0]);
        let c = composite(&plate, &image(&[[0.2; 3]; 2]), &object).unwrap();
        let out = picture(&codes, Some(&shadowed), &plate, &c.radiance, &object, gamma).unwrap();
        assert_eq!(out.pixels()[0], shadowed.pixels()[0]);
        assert!((out.pixels()[1].0[0] - gamma([0.25; 3])[0]).abs() < 1e-6);
    }

    proptest! {
        #[test]
        fn an_untouched_pixel_is_kept_bit_for_bit(b in prop::array::uniform3(0.0f32..30.0), stored in prop::array::uniform3(0u8..)) {
            let plate = image(&[b]);
            let object = layer(&[[0.0; 3]], &[0.0]);
            let c = composite(&plate, &image(&[[0.0; 3]]), &object).unwrap();
            prop_assert_eq!(&c.radiance, &plate);
            let codes = Image::from_pixels(1, 1, vec![Code(stored.map(|v| f32::from(v) / 255.0))]);
            let out = picture(&codes, None, &plate, &c.radiance, &object, gamma).unwrap();
            prop_assert_eq!(out.pixels()[0].0.map(|v| (v * 255.0).round() as u8), stored);
        }

        #[test]
        fn never_negative(b in 0.0f32..2.0, e in -1.0f32..5.0, o in 0.0f32..1.0, a in 0.0f32..=1.0) {
            let c = composite(&image(&[[b; 3]]), &image(&[[e; 3]]), &layer(&[[o * a; 3]], &[a])).unwrap();
            prop_assert!(c.radiance.pixels()[0].0[0] >= 0.0);
        }
    }
}

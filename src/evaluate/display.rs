//! What a person would see: ꟻLIP and SSIM on display images.

use crate::image::{CodeImage, luminance};

/// Mean ꟻLIP (Andersson et al. 2020) at 67 pixels per degree; 0 = no visible difference, 1 = the largest.
pub fn flip(ours: &CodeImage, reference: &CodeImage) -> f64 {
    let bytes = |image: &CodeImage| {
        let data: Vec<u8> = image
            .pixels()
            .iter()
            .flat_map(|p| p.0.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8))
            .collect();
        nv_flip::FlipImageRgb8::with_data(image.width() as u32, image.height() as u32, &data)
    };
    let map = nv_flip::flip(bytes(reference), bytes(ours), nv_flip::DEFAULT_PIXELS_PER_DEGREE);
    let values = map.to_vec();
    values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len().max(1) as f64
}

/// Half width of SSIM's window, px; its Gaussian has σ = 1.5 px.
const HALF: usize = 5;

/// Mean SSIM (Wang et al. 2004) of the luma, 11×11 Gaussian windows that lie wholly inside; `None` if none does.
pub fn ssim(a: &CodeImage, b: &CodeImage) -> Option<f64> {
    let (w, h) = a.size();
    if w <= 2 * HALF || h <= 2 * HALF || b.size() != a.size() {
        return None;
    }
    let luma = |i: &CodeImage| -> Vec<f64> { i.pixels().iter().map(|p| f64::from(luminance(p.0))).collect() };
    let (x, y) = (luma(a), luma(b));
    let product = |p: &[f64], q: &[f64]| -> Vec<f64> { p.iter().zip(q).map(|(p, q)| p * q).collect() };
    let [mx, my, xx, yy, xy] =
        [x.clone(), y.clone(), product(&x, &x), product(&y, &y), product(&x, &y)].map(|p| blur(&p, w, h));
    let (c1, c2) = (0.01f64.powi(2), 0.03f64.powi(2));
    let sum: f64 = (0..mx.len())
        .map(|i| {
            let (vx, vy, cov) = (xx[i] - mx[i] * mx[i], yy[i] - my[i] * my[i], xy[i] - mx[i] * my[i]);
            (2.0 * mx[i] * my[i] + c1) * (2.0 * cov + c2)
                / ((mx[i] * mx[i] + my[i] * my[i] + c1) * (vx + vy + c2))
        })
        .sum();
    Some(sum / mx.len() as f64)
}

/// Separable Gaussian over windows wholly inside.
fn blur(plane: &[f64], w: usize, h: usize) -> Vec<f64> {
    let raw: Vec<f64> =
        (0..=2 * HALF).map(|i| (-(i as f64 - HALF as f64).powi(2) / (2.0 * 1.5 * 1.5)).exp()).collect();
    let total: f64 = raw.iter().sum();
    let kernel: Vec<f64> = raw.iter().map(|v| v / total).collect();
    let (iw, ih) = (w - 2 * HALF, h - 2 * HALF);
    let rows: Vec<f64> = (0..iw * h)
        .map(|i| (0..kernel.len()).map(|k| kernel[k] * plane[i / iw * w + i % iw + k]).sum())
        .collect();
    (0..iw * ih)
        .map(|i| (0..kernel.len()).map(|k| kernel[k] * rows[(i / iw + k) * iw + i % iw]).sum())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Code, Image};

    fn picture(contrast: f32) -> CodeImage {
        Image::from_fn(48, 32, |x, y| Code([0.5 + contrast * ((x * 7 + y * 13) % 11) as f32 / 22.0; 3]))
    }

    #[test]
    fn identical_pictures_look_identical() {
        assert_eq!(flip(&picture(0.5), &picture(0.5)), 0.0);
        assert!((ssim(&picture(0.5), &picture(0.5)).unwrap() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn black_against_white_is_the_largest_difference() {
        let (black, white) =
            (Image::from_fn(32, 32, |_, _| Code([0.0; 3])), Image::from_fn(32, 32, |_, _| Code([1.0; 3])));
        assert!(flip(&black, &white) > 0.9);
        // Flat pictures differ in luminance alone: c1 / (1 + c1).
        assert!((ssim(&black, &white).unwrap() - 1e-4 / 1.0001).abs() < 1e-9);
    }

    #[test]
    fn more_change_looks_worse() {
        let (a, b, c) = (picture(0.5), picture(0.4), picture(0.1));
        assert!(flip(&b, &a) < flip(&c, &a));
        assert!(ssim(&b, &a).unwrap() > ssim(&c, &a).unwrap());
        assert!(ssim(&Image::from_fn(9, 40, |_, _| Code::default()), &a).is_none());
    }
}

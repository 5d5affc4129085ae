//! How far two back ends lie apart.

use crate::image::RadianceImage;

/// What two results differ by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    /// Largest difference over the larger of the two, outside one-pixel borders of the shadow.
    pub relative: f64,
    /// Rms difference over rms ε.
    pub rmse: f64,
}

/// ε changes by more than this share of the plate from pixel to pixel: a border of the shadow.
const BORDER: f64 = 0.02;
/// The same for a faint shadow, as a share of ε itself: one of many hard shadows ends here.
const FAINT_BORDER: f64 = 0.1;
/// Below this share of the plate 1 % of ε is below any code value, even of 12 bits.
const FLOOR: f64 = 1e-2;

impl Difference {
    /// Of ε from one back end and from another, on one plate.
    pub fn between(plate: &RadianceImage, a: &RadianceImage, b: &RadianceImage) -> Self {
        let (width, height) = a.size();
        let (mut relative, mut difference, mut signal) = (0.0f64, 0.0, 0.0);
        let share = |u: usize, v: usize| {
            let whole = plate.at(u, v).luminance();
            if whole > 0.0 { f64::from(a.at(u, v).luminance() / whole) } else { 0.0 }
        };
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
            let (p, q) = (a.at(x, y).0, b.at(x, y).0);
            let here = share(x, y);
            let mut near = (y.saturating_sub(1)..(y + 2).min(height))
                .flat_map(|v| (x.saturating_sub(1)..(x + 2).min(width)).map(move |u| (u, v)));
            let border = near.any(|(u, v)| {
                let there = share(u, v);
                (there - here).abs() > BORDER.min(FAINT_BORDER * there.max(here))
            });
            for c in 0..3 {
                let (p, q) = (f64::from(p[c]), f64::from(q[c]));
                difference += (p - q).powi(2);
                signal += p * p;
                if !border && p.max(q) > FLOOR * f64::from(plate.at(x, y).0[c]) {
                    relative = relative.max((p - q).abs() / p.max(q));
                }
            }
        }
        Self { relative, rmse: (difference / signal.max(1e-300)).sqrt() }
    }

    /// Whether the two are the same for all that can be seen: 1 % at most, 0.2 % rms.
    pub fn agrees(&self) -> bool {
        self.relative <= 0.01 && self.rmse <= 0.002
    }
}

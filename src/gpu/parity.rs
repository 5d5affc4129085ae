//! How far two back ends lie apart.

use crate::image::RadianceImage;

/// What two results differ by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    /// Largest difference, over the larger of the two, from what a pixel and its neighbours have in the first: an outline of
    /// one of many hard shadows may lie a pixel further.
    pub relative: f64,
    /// Rms difference over rms ε.
    pub rmse: f64,
}

/// Below this share of the plate 1 % of ε is below any code value, even of 12 bits.
const FLOOR: f64 = 1e-2;

impl Difference {
    /// Of ε from one back end and from another, on one plate.
    pub fn between(plate: &RadianceImage, a: &RadianceImage, b: &RadianceImage) -> Self {
        let (width, height) = a.size();
        let (mut relative, mut difference, mut signal) = (0.0f64, 0.0, 0.0);
        let share = |of: &RadianceImage, x: usize, y: usize, c: usize| {
            let whole = f64::from(plate.at(x, y).0[c]);
            if whole > 0.0 { f64::from(of.at(x, y).0[c]) / whole } else { 0.0 }
        };
        for (x, y, c) in
            (0..height).flat_map(|y| (0..width).flat_map(move |x| (0..3).map(move |c| (x, y, c))))
        {
            let (p, q) = (f64::from(a.at(x, y).0[c]), f64::from(b.at(x, y).0[c]));
            difference += (p - q).powi(2);
            signal += p * p;
            let (found, larger) = (share(b, x, y, c), share(a, x, y, c).max(share(b, x, y, c)));
            if larger > FLOOR {
                let near = (y.saturating_sub(1)..(y + 2).min(height))
                    .flat_map(|v| (x.saturating_sub(1)..(x + 2).min(width)).map(move |u| (u, v)));
                let [low, high] = near.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], (u, v)| {
                    let there = share(a, u, v, c);
                    [low.min(there), high.max(there)]
                });
                relative = relative.max((low - found).max(found - high).max(0.0) / larger);
            }
        }
        Self { relative, rmse: (difference / signal.max(1e-300)).sqrt() }
    }

    /// Whether the two are the same for all that can be seen: 1 % at most, 0.2 % rms.
    pub fn agrees(&self) -> bool {
        self.relative <= 0.01 && self.rmse <= 0.002
    }
}

//! Inner orientation from photographs of the grid, with no more distortion than the data show.

use super::Problem;
use super::bundle::{self, Bundle, FreeLens};
use crate::camera::Intrinsics;
use crate::vision::BoardView;

/// A part of the lens model is dropped when it is below this many standard deviations.
const SIGNIFICANT: f64 = 3.0;
/// Poses that tell the focal length worse than this are refused ([`Bundle::condition`]): boards that fill the
/// picture tilted by 30° reach 25, small ones 50, boards tilted by 3° 100.
pub(super) const MAX_CONDITION: f64 = 80.0;
/// A focal length less certain than this is refused.
const MAX_RELATIVE_SIGMA: f64 = 0.02;
/// Views whose corners fit worse than this many times the median are left out.
const OUTLYING_VIEW: f64 = 4.0;

/// A calibrated lens and what was left out to get it.
#[derive(Debug, Clone)]
pub struct Lens {
    /// The fit.
    pub fit: Bundle,
    /// Parts of the lens model found insignificant.
    pub dropped: Vec<&'static str>,
    /// Indices of views left out as outliers.
    pub outliers: Vec<usize>,
}

/// Fits the whole model, then drops one insignificant part after the other: k3, tangential, k2, k1, the second focal
/// length, the principal point.
pub fn fit(
    views: &[BoardView],
    width_px: u32,
    height_px: u32,
    focal_px: Option<f64>,
) -> Result<Lens, Problem> {
    if views.len() < 3 {
        return Err(Problem::FewGrids { found: views.len() });
    }
    let found = || bundle::first_focal_px(views, width_px, height_px);
    let start = focal_px.or_else(found).unwrap_or(f64::from(width_px.max(height_px)));
    let start = Intrinsics::pinhole(width_px, height_px, start);
    let calibrate = |views: &[BoardView], free| bundle::fit(views, &start, free);
    let mut free = FreeLens::ALL;
    let mut fit = calibrate(views, free)?;
    let mut sorted = fit.view_rms_px.clone();
    sorted.sort_by(f64::total_cmp);
    let limit = OUTLYING_VIEW * sorted[sorted.len() / 2];
    let (mut outliers, mut kept) = (Vec::new(), Vec::new());
    for (k, view) in views.iter().enumerate() {
        if fit.view_rms_px[k] > limit { outliers.push(k) } else { kept.push(view.clone()) }
    }
    if !outliers.is_empty() && kept.len() >= 3 {
        fit = calibrate(&kept, free)?;
    } else {
        (outliers, kept) = (Vec::new(), views.to_vec());
    }
    let mut dropped = Vec::new();
    while let Some((part, simpler)) = insignificant(&fit, free) {
        dropped.push(part);
        free = simpler;
        fit = calibrate(&kept, free)?;
    }
    if fit.condition.is_nan() || fit.condition > MAX_CONDITION {
        return Err(Problem::PosesAlike { condition: fit.condition, limit: MAX_CONDITION });
    }
    let relative = focal_sigma_px(&fit) / fit.intrinsics.focal_px[0];
    if relative.is_nan() || relative > MAX_RELATIVE_SIGMA {
        return Err(Problem::FocalUncertain { relative, limit: MAX_RELATIVE_SIGMA });
    }
    Ok(Lens { fit, dropped, outliers })
}

/// Of the focal lengths the larger standard deviation, px.
fn focal_sigma_px(fit: &Bundle) -> f64 {
    fit.sigma(0).max(fit.sigma(1))
}

impl Lens {
    /// Standard deviation of the focal length, px.
    pub fn focal_sigma_px(&self) -> f64 {
        focal_sigma_px(&self.fit)
    }
}

fn insignificant(fit: &Bundle, free: FreeLens) -> Option<(&'static str, FreeLens)> {
    let [k1, k2, p1, p2, k3] = could_be_zero(fit);
    let i = &fit.intrinsics;
    let [fx, fy] = i.focal_px;
    let focal_sigma = focal_sigma_px(fit);
    let [cx, cy] = i.principal_point_px;
    let off = [cx - f64::from(i.width_px) / 2.0, cy - f64::from(i.height_px) / 2.0];
    let central = (0..2).all(|k| off[k].abs() < SIGNIFICANT * fit.sigma(2 + k));
    let [r1, r2, r3] = free.radial;
    if r3 && k3 {
        Some(("k3", FreeLens { radial: [r1, r2, false], ..free }))
    } else if free.tangential && p1 && p2 {
        Some(("tangential", FreeLens { tangential: false, ..free }))
    } else if r2 && !r3 && k2 {
        Some(("k2", FreeLens { radial: [r1, false, false], ..free }))
    } else if r1 && !r2 && k1 {
        Some(("k1", FreeLens { radial: [false; 3], ..free }))
    } else if free.aspect && (fx - fy).abs() < SIGNIFICANT * focal_sigma {
        Some(("aspect ratio", FreeLens { aspect: false, ..free }))
    } else if free.principal_point && central {
        Some(("off-centre principal point", FreeLens { principal_point: false, ..free }))
    } else {
        None
    }
}

/// For each coefficient whether it could as well be zero.
fn could_be_zero(fit: &Bundle) -> [bool; 5] {
    std::array::from_fn(|k| fit.intrinsics.distortion[k].abs() < SIGNIFICANT * fit.sigma(4 + k))
}

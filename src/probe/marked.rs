//! The ball from points marked on its outline: for a known radius the tangent cone fixes its centre in space, wherever it
//! stands.

use super::outline::{self, Rim};
use super::{ProbeFit, Problem, find};
use crate::camera::Camera;
use crate::config::{self, ProbeSource};
use crate::image::RadianceImage;
use crate::least_squares::{self, Loss};
use nalgebra::{DVector, Point2, Vector2, Vector3};

/// Marks that are needed: the centre has 3 unknowns, and the rest must tell whether it is a ball at all.
const NEEDED: usize = 5;
/// A mark further off than this is a slip, px.
const ROBUST_PX: f64 = 2.0;
/// Rms of the marks that is accepted, px, and as a share of the ball's radius in the picture.
const MAX_RMS_PX: f64 = 1.0;
const MAX_RMS_SHARE: f64 = 0.02;
/// A distance less certain than this is refused.
const MAX_RELATIVE_SIGMA: f64 = 0.05;
/// Turn by which the tangent of the outline is taken, rad.
const STEP: f64 = 1e-4;
/// Points at which the outline is measured.
const FINE: usize = 240;

/// Finds the ball of known radius whose outline passes through the marks, px.
pub fn fit(
    camera: &Camera,
    picture: &RadianceImage,
    marks: &[[f64; 2]],
    settings: &config::Probe,
) -> Result<ProbeFit, Problem> {
    let radius_m = settings.radius_m;
    if !(radius_m.is_finite() && radius_m > 0.0) {
        return Err(Problem::Radius(radius_m));
    }
    if marks.len() < NEEDED {
        return Err(Problem::FewMarks { found: marks.len(), needed: NEEDED });
    }
    let eye = camera.centre();
    let marks: Vec<(Point2<f64>, Vector3<f64>)> =
        marks.iter().map(|m| Point2::from(*m)).map(|p| (p, camera.ray(&p).direction.into_inner())).collect();
    let centre = |x: &DVector<f64>| eye + Vector3::new(x[0], x[1], x[2]);
    let residuals = |x: &DVector<f64>| {
        let rim = Rim::new(&eye, &centre(x), radius_m)?;
        let off = marks.iter().map(|(pixel, d)| off_outline(camera, &rim, pixel, d));
        Some(DVector::from_vec(off.collect::<Option<Vec<f64>>>()?))
    };
    let no_ball = || Problem::NoBall { radius_m };
    let start = start(&marks, radius_m).ok_or_else(no_ball)?;
    let names = ["the ball's x", "the ball's y", "the ball's z"].map(String::from);
    let found = |loss| least_squares::minimise(&residuals, &names, start.as_slice(), loss);
    // Marks all over the place can keep the robust fit from settling; the plain one then tells how far off they are.
    let found = found(Loss::Huber(ROBUST_PX)).or_else(|_| found(Loss::Squares)).map_err(|_| no_ball())?;
    let at = centre(&found.parameters);
    let outline = outline::project(camera, &at, radius_m, FINE).ok_or_else(no_ball)?;
    let radius_px = outline::radius_px(&outline);
    let limit_px = MAX_RMS_PX + MAX_RMS_SHARE * radius_px;
    if found.rms > limit_px {
        return Err(Problem::NotAnOutline { rms_px: found.rms, limit_px });
    }
    let line_of_sight = (at - eye).normalize();
    let relative =
        line_of_sight.dot(&(&found.covariance * line_of_sight)).max(0.0).sqrt() / (at - eye).norm();
    if relative > MAX_RELATIVE_SIGMA {
        return Err(Problem::DistanceUncertain { relative, limit: MAX_RELATIVE_SIGMA });
    }
    let (width, height) = picture.size();
    let outside = outline::share_outside(&outline, width, height);
    if outside > find::MAX_OUTSIDE {
        return Err(Problem::CutOff { outside });
    }
    let (diameter_px, needed_px) = (2.0 * radius_px, find::MIN_DIAMETER_PX);
    if diameter_px < needed_px {
        return Err(Problem::TooSmall { diameter_px, needed_px });
    }
    Ok(ProbeFit {
        source: ProbeSource::Ball,
        photographs: Vec::new(),
        camera: camera.clone(),
        centre: at,
        radius_m,
        outline_rms_px: found.rms,
        outline_support: None,
        mirror_correlation: None,
        reflectivity_seen: None,
        centre_sigma_m: std::array::from_fn(|k| found.sigma(k)),
        diameter_px,
    })
}

/// Signed distance of a mark from the outline, px: from the outline's point at the mark's angle, across the outline.
fn off_outline(camera: &Camera, rim: &Rim, pixel: &Point2<f64>, direction: &Vector3<f64>) -> Option<f64> {
    let angle = rim.angle_of(direction);
    let at = camera.project(&rim.at(angle))?;
    let along = camera.project(&rim.at(angle + STEP))? - camera.project(&rim.at(angle - STEP))?;
    Some((pixel - at).dot(&Vector2::new(along.y, -along.x).try_normalize(0.0)?))
}

/// A centre from the eye, m: in the middle of the marks, at the distance that their mean angle from it gives.
fn start(marks: &[(Point2<f64>, Vector3<f64>)], radius_m: f64) -> Option<Vector3<f64>> {
    let axis = marks.iter().map(|(_, d)| d).sum::<Vector3<f64>>().try_normalize(1e-9)?;
    let sine = marks.iter().map(|(_, d)| d.cross(&axis).norm()).sum::<f64>() / marks.len() as f64;
    (sine > 1e-6).then(|| axis * (radius_m / sine))
}

#[cfg(test)]
#[path = "marked_tests.rs"]
mod tests;

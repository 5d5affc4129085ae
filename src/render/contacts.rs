//! Where the object touches what it stands on, and how well that is seen.

use super::Object;
use crate::artefact::json::JsonArtefact;
use crate::calibrate::PosedCamera;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// Vertices so far above the lowest one touch, too, as a share of the object's height.
const TOUCHING: f32 = 0.005;
/// Points at most.
const MOST: usize = 8;

/// A contact point as the camera sees it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Contact {
    /// Where, px.
    pub pixel_px: [f64; 2],
    /// Standard deviations of that along the axes of their ellipse, the larger first, px.
    pub axes_px: [f64; 2],
    /// Direction of the first axis, from the picture's x to its y.
    pub angle_deg: f64,
}

/// `render/contacts.json`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Contacts {
    /// The points.
    pub points: Vec<Contact>,
}

impl JsonArtefact for Contacts {
    const FORMAT: &'static str = "insitu-contacts";
    const VERSION: u32 = 1;
}

/// The object's lowest points, those furthest out first; none where the camera's accuracy is not known.
pub fn contacts(object: &Object, posed: &PosedCamera) -> Contacts {
    let Some(covariance) = &posed.covariance else { return Contacts::default() };
    let [low, high] = object.bounds();
    let limit = low.y + TOUCHING * (high.y - low.y);
    let mut touching: Vec<glam::Vec3> = object.vertices.iter().copied().filter(|v| v.y <= limit).collect();
    touching.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.z.total_cmp(&b.z)));
    touching.dedup();
    let mut chosen: Vec<glam::Vec3> = Vec::new();
    while chosen.len() < MOST.min(touching.len()) {
        let middle = touching.iter().sum::<glam::Vec3>() / touching.len() as f32;
        let away = |v: &glam::Vec3| {
            chosen.iter().map(|c| c.distance(*v)).fold(f32::INFINITY, f32::min).min(1e3 + v.distance(middle))
        };
        let Some(next) = touching.iter().copied().max_by(|a, b| away(a).total_cmp(&away(b))) else { break };
        chosen.push(next);
    }
    let seen = |v: &glam::Vec3| {
        let point = Point3::from(v.as_dvec3().to_array());
        let pixel = posed.camera.project(&point)?;
        let eigen = covariance.of_pixel(&posed.camera, &point)?.symmetric_eigen();
        let first = eigen.eigenvalues.imax();
        let axis = eigen.eigenvectors.column(first);
        Some(Contact {
            pixel_px: [pixel.x, pixel.y],
            axes_px: [first, 1 - first].map(|k| eigen.eigenvalues[k].max(0.0).sqrt()),
            angle_deg: axis.y.atan2(axis.x).to_degrees(),
        })
    };
    Contacts { points: chosen.iter().filter_map(seen).collect() }
}

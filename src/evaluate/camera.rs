//! The report's part on the camera: what is known of it in words, and how far off the object's contact points may be seen.

use super::html::escape;
use crate::artefact::json;
use crate::calibrate::Cameras;
use crate::composite::encode_png;
use crate::error::Result;
use crate::image::CodeImage;
use crate::render::Contact;
use crate::stage::Context;
use std::fmt::Write;

/// Standard deviations that an ellipse shows where that is seen …
const SHOWN: f64 = 2.0;
/// … and the least half axis that the largest ellipse is drawn with, as a share of the picture's width.
const LEAST: f64 = 0.012;

/// HTML of that part.
pub fn section(ctx: &Context, cameras: &Cameras, plate: &CodeImage) -> Result<String> {
    let mut html = String::from("<h2>Camera</h2><ul>");
    let manifest = ctx.manifest("calibrate")?;
    let said = told(cameras).into_iter().chain(manifest.warnings.iter().cloned());
    said.for_each(|line| html += &format!("<li>{}", escape(&line)));
    html += "</ul>";
    let contacts: Vec<Contact> = match ctx.has_artefact("render", "contacts.json") {
        true => json::read::<crate::render::Contacts>(&ctx.artefact("render", "contacts.json")?)?.points,
        false => Vec::new(),
    };
    if !contacts.is_empty() {
        html += &drawn(&contacts, plate)?;
    }
    Ok(html)
}

/// Lens and pose in words.
fn told(cameras: &Cameras) -> Vec<String> {
    let posed = cameras.posed_plate();
    let lens = &posed.camera.intrinsics;
    let [f, g] = lens.focal_px;
    let sigma = cameras.focal_sigma_px.map_or("of unknown accuracy".into(), |s| format!("± {s:.1} px"));
    let mut lines = vec![if (f - g).abs() < 1e-6 * f {
        format!("focal length {f:.1} px {sigma}")
    } else {
        format!("focal lengths {f:.1} and {g:.1} px {sigma}")
    }];
    let [x, y] = lens.principal_point_px;
    lines.push(format!(
        "principal point {x:.1}, {y:.1} px of {}×{} px{}",
        lens.width_px,
        lens.height_px,
        if lens.distortion == [0.0; 5] { ", no distortion" } else { ", distortion taken off" }
    ));
    if let Some(covariance) = &posed.covariance {
        let [px, py, pz] = covariance.position_sigma_m().map(|s| 1e3 * s);
        let turn = covariance.rotation_sigma_rad().into_iter().fold(0.0, f64::max).to_degrees();
        let at = posed.camera.centre();
        lines.push(format!(
            "camera at {:.3}, {:.3}, {:.3} m (y up), ± {px:.1}, {py:.1}, {pz:.1} mm; its direction is known to {turn:.3}°",
            at.x, at.y, at.z
        ));
    }
    lines
}

/// The plate with an ellipse at each contact point.
fn drawn(contacts: &[Contact], plate: &CodeImage) -> Result<String> {
    let (width, height) = (plate.width() as f64, plate.height() as f64);
    let largest = contacts.iter().map(|c| SHOWN * c.axes_px[0]).fold(1e-9, f64::max);
    let factor = nice((LEAST * width / largest).max(1.0));
    let mut marks = String::new();
    for contact in contacts {
        let [x, y] = contact.pixel_px;
        let [a, b] = contact.axes_px.map(|s| SHOWN * s * factor);
        let _ = write!(
            marks,
            "<g transform=\"translate({x:.2} {y:.2}) rotate({:.2})\"><ellipse rx={a:.2} ry={b:.2} fill=none stroke=#ff2bd6 stroke-width={:.2} /></g>\
             <circle cx={x:.2} cy={y:.2} r={:.2} fill=#ff2bd6 />",
            contact.angle_deg,
            width / 500.0,
            width / 500.0
        );
    }
    let data = super::html::base64(&encode_png(plate)?);
    let sigma = contacts.iter().map(|c| c.axes_px[0]).fold(0.0, f64::max);
    let caption = format!(
        "where the object touches, and how far off the camera may see that: {SHOWN} standard deviations{}, the largest {sigma:.2} px",
        if factor > 1.0 { format!(", drawn {factor} times as large") } else { String::new() }
    );
    Ok(format!(
        "<div class=row><figure><svg viewBox=\"0 0 {width} {height}\" width=\"100%\" role=img aria-label=\"contact points\">\
         <image href=\"data:image/png;base64,{data}\" width={width} height={height} />{marks}</svg><figcaption>{caption}</figcaption></figure></div>"
    ))
}

/// 1, 2 or 5 times a power of ten, at most that.
fn nice(factor: f64) -> f64 {
    let decade = 10f64.powf(factor.log10().floor());
    [5.0, 2.0, 1.0].into_iter().map(|k| k * decade).find(|f| *f <= factor * (1.0 + 1e-9)).unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Code, Image};

    #[test]
    fn contact_points_are_drawn_over_the_plate() {
        let plate = Image::from_fn(200, 100, |_, _| Code([0.5; 3]));
        let contact = Contact { pixel_px: [50.0, 60.0], axes_px: [0.1, 0.05], angle_deg: 30.0 };
        let html = drawn(&[contact], &plate).unwrap();
        assert!(html.contains("translate(50.00 60.00) rotate(30.00)"), "{html}");
        assert!(html.contains("<ellipse rx=2.00 ry=1.00"), "{html}");
        assert!(html.contains("drawn 10 times as large, the largest 0.10 px"), "{html}");
        assert_eq!([1.0, 1.9, 2.0, 7.0, 11.9, 60.0].map(nice), [1.0, 1.0, 2.0, 5.0, 10.0, 50.0]);
    }
}

//! The report's part on exposures and their radiance: curves with their band, exposures found against stated, what became
//! of each frame and where it differs from the merged picture.

use super::html::{escape, mapped};
use super::pictures::{count_map, residual_map};
use crate::artefact::exr::Planes;
use crate::error::Result;
use crate::image::Image;
use crate::response::{LEVELS, Response};
use crate::stage::Manifest;
use serde_json::Value;
use std::fmt::Write;

/// Plot area, px; ln exposure from this many stops below saturation on.
const PLOT: [f64; 2] = [460.0, 300.0];
const STOPS: f64 = 12.0;
const COLOURS: [&str; 3] = ["#c82828", "#288c3c", "#3250c8"];
/// Standard errors to either side of a 95 % band.
const BAND: f64 = 1.96;

/// Ends of the residuals' legend, stops.
const RESIDUAL_STOPS: f32 = 0.15;

/// What stage `merge` left.
pub struct Merging {
    /// Its manifest.
    pub manifest: Manifest,
    /// `residuals.exr`, where frames were merged.
    pub residuals: Option<Planes>,
    /// `plate.exr`.
    pub plate: Planes,
}

/// HTML of that part; empty where nothing was fitted.
pub fn section(response: &Response, merge: Option<&Merging>) -> Result<String> {
    if response.assumed {
        return Ok(String::new());
    }
    let mut html = String::from("<h2>Exposures and radiance</h2><div class=row><figure>");
    html += &plot(response);
    html += "<figcaption>Response: code against exposure, stops below saturation, with its 95 % band</figcaption></figure>";
    html += &exposures(response);
    html += &merge.map_or(String::new(), |m| frames(&m.manifest));
    html += "</div>";
    html += &merge.map_or(Ok(String::new()), maps)?;
    Ok(html)
}

/// Where each frame differs from the merged picture, where frames are left out, and what is clipped in all.
fn maps(merge: &Merging) -> Result<String> {
    let Some(residuals) = &merge.residuals else { return Ok(String::new()) };
    let mut html = String::from("<h3>Frames against the merged picture, stops</h3><div class=row>");
    let files = list(&merge.manifest, "frames");
    for ((_, stops), file) in residuals.channels.iter().zip(&files) {
        let map = Image::from_pixels(residuals.width, residuals.height, stops.clone());
        html += &mapped(&residual_map(&map, RESIDUAL_STOPS), file.as_str().unwrap_or_default())?;
    }
    let plate = &merge.plate;
    for (plane, caption) in [
        ("ghosts", "exposures left out since they show something else"),
        ("clipped", "clipped in every exposure"),
    ] {
        let Some(values) = plate.plane(plane).filter(|v| v.iter().any(|v| *v > 0.0)) else { continue };
        let map = largest_of_cells(&Image::from_pixels(plate.width, plate.height, values.to_vec()));
        html += &mapped(&count_map(&map), caption)?;
    }
    Ok(html + "</div>")
}

/// A picture of about the maps' size: the largest value of each cell, so that small lights and ghosts show.
fn largest_of_cells(image: &Image<f32>) -> Image<f32> {
    let (width, height) = image.size();
    let cell = width.div_ceil(480).max(1);
    Image::from_fn(width / cell, height / cell, |x, y| {
        let all = (0..cell * cell).map(|k| *image.at(x * cell + k % cell, y * cell + k / cell));
        all.fold(0.0, f32::max)
    })
}

fn list(merge: &Manifest, name: &str) -> Vec<Value> {
    merge.figures.get(name).and_then(|v| v.as_array()).cloned().unwrap_or_default()
}

fn plot(response: &Response) -> String {
    let [w, h] = PLOT;
    let mut svg = format!("<svg viewBox=\"0 0 {w} {h}\" width=\"100%\" role=img aria-label=\"response\">");
    for stops in 0..=STOPS as u32 {
        let x = w * (1.0 - f64::from(stops) / STOPS);
        let _ =
            write!(svg, "<line x1={x:.1} y1=0 x2={x:.1} y2={h} stroke=currentColor stroke-opacity=.12 />");
    }
    for (curve, colour) in response.curves.iter().zip(COLOURS) {
        let from = (curve.floor * (LEVELS - 1) as f32) as usize + 1;
        let levels = || (from..LEVELS).step_by(3);
        let point = |z: usize, errors: f64| {
            let stops = curve.exposure[z].log2() + errors * curve.standard_error[z] / std::f64::consts::LN_2;
            let x = w * (1.0 + stops / STOPS).clamp(0.0, 1.1);
            format!("{x:.1},{:.1} ", h * (1.0 - z as f64 / (LEVELS - 1) as f64))
        };
        let line: String = levels().map(|z| point(z, 0.0)).collect();
        let band: String =
            levels().map(|z| point(z, BAND)).chain(levels().rev().map(|z| point(z, -BAND))).collect();
        let _ = write!(
            svg,
            "<polygon points=\"{band}\" fill=\"{colour}\" fill-opacity=.25 /><polyline points=\"{line}\" fill=none stroke=\"{colour}\" />"
        );
    }
    svg + "</svg>"
}

fn exposures(response: &Response) -> String {
    if response.exposures.is_empty() {
        return String::new();
    }
    let mut html = String::from(
        "<table><tr><th>exposure<th class=n>stated<th class=n>by pixels, stops off<th>used</tr>",
    );
    for e in &response.exposures {
        let found =
            e.sigma_stops.map_or("not told".into(), |s| format!("{:+.2} ± {s:.2}", e.departure_stops()));
        let used = if e.is_corrected() { "by pixels" } else { "stated" };
        let _ = write!(
            html,
            "<tr><td>{}<td class=n>{:.3e}<td class=n>{found}<td>{used}</tr>",
            escape(&e.file),
            e.stated
        );
    }
    html + "</table>"
}

/// Columns of the frames that were merged, from the figures of stage `merge`.
fn frames(merge: &Manifest) -> String {
    let files = list(merge, "frames");
    let motion = merge.figures.get("motion_px");
    let columns = [
        ("residual, stops", "frame_residual_stops", 1.0),
        ("clipped, %", "frame_clipped_share", 100.0),
        ("ghosts, %", "frame_ghost_share", 100.0),
    ];
    let columns = columns.map(|(head, name, factor)| (head, list(merge, name), factor));
    let mut html = String::from("<table><tr><th>frame");
    columns.iter().for_each(|(head, ..)| html += &format!("<th class=n>{head}"));
    html += "<th class=n>moved, px";
    for (i, file) in files.iter().enumerate() {
        let _ = write!(html, "<tr><td>{}", escape(file.as_str().unwrap_or_default()));
        for (_, values, factor) in &columns {
            let value = values.get(i).and_then(|v| v.as_f64()).map(|v| format!("{:.2}", v * factor));
            let _ = write!(html, "<td class=n>{}", value.unwrap_or_default());
        }
        let px = motion.and_then(|m| m[file.as_str().unwrap_or_default()].as_f64());
        let _ = write!(html, "<td class=n>{}", px.map_or(String::new(), |px| format!("{px:.1}")));
    }
    html + "</table>"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::response::FoundExposure;

    #[test]
    fn a_fitted_curve_is_drawn_and_a_corrected_exposure_named() {
        let mut response = Response { assumed: false, ..Response::srgb() };
        let wrong = FoundExposure {
            file: "a<b.jpg".into(),
            sigma_stops: Some(0.02),
            used: 0.02,
            found: 0.02,
            stated: 0.01,
        };
        response.exposures = vec![wrong, FoundExposure::stated(0.5)];
        let html = section(&response, None).unwrap();
        for part in ["<polyline", "<polygon", "a&lt;b.jpg", "+1.00 ± 0.02", "by pixels</tr>", "not told"] {
            assert!(html.contains(part), "{part}");
        }
        assert!(!html.contains("NaN") && !html.contains("inf"));
        assert!(section(&Response::srgb(), None).unwrap().is_empty());
    }

    #[test]
    fn frames_have_their_maps_and_the_motion_that_was_mended() {
        let figures = serde_json::json!({
            "frames": ["a.jpg", "b&c.jpg"], "frame_residual_stops": [0.01, 0.02], "motion_px": { "b&c.jpg": 2.34 },
        });
        let manifest = Manifest {
            stage: "merge".into(),
            stage_version: 1,
            program: "0".into(),
            settings: Value::Null,
            inputs: Default::default(),
            outputs: Default::default(),
            wall_s: 1.0,
            peak_memory_mib: 1.0,
            warnings: Vec::new(),
            figures: serde_json::from_value(figures).unwrap(),
        };
        let planes = |names: &[&str], value: f32| Planes {
            width: 4,
            height: 3,
            channels: names.iter().map(|n| (n.to_string(), vec![value; 12])).collect(),
        };
        let merging = Merging {
            manifest,
            residuals: Some(planes(&["F00", "F01"], 0.1)),
            plate: planes(&["ghosts"], 1.0),
        };
        let response = Response { assumed: false, ..Response::srgb() };
        let html = section(&response, Some(&merging)).unwrap();
        assert_eq!(html.matches("data:image/png").count(), 3);
        for part in ["<td class=n>2.3", "b&amp;c.jpg</figcaption>", "show something else"] {
            assert!(html.contains(part), "{part}: {html}");
        }
        assert!(!html.contains("clipped in every"));
    }
}

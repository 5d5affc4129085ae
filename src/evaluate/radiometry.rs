//! The report's part on exposures and their radiance: curves with their band, exposures found against stated, what became
//! of each frame.

use super::html::escape;
use crate::response::{LEVELS, Response};
use crate::stage::Manifest;
use std::fmt::Write;

/// Plot area, px; ln exposure from this many stops below saturation on.
const PLOT: [f64; 2] = [460.0, 300.0];
const STOPS: f64 = 12.0;
const COLOURS: [&str; 3] = ["#c82828", "#288c3c", "#3250c8"];
/// Standard errors to either side of a 95 % band.
const BAND: f64 = 1.96;

/// HTML of that part; empty where nothing was fitted.
pub fn section(response: &Response, merge: Option<&Manifest>) -> String {
    if response.assumed {
        return String::new();
    }
    let mut html = String::from("<h2>Exposures and radiance</h2><div class=row><figure>");
    html += &plot(response);
    html += "<figcaption>Response: code against exposure, stops below saturation, with its 95 % band</figcaption></figure>";
    html += &exposures(response);
    html += &merge.map_or(String::new(), frames);
    html + "</div>"
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
    let list = |name: &str| merge.figures.get(name).and_then(|v| v.as_array()).cloned().unwrap_or_default();
    let files = list("frames");
    let columns = [
        ("residual, stops", "frame_residual_stops", 1.0),
        ("clipped, %", "frame_clipped_share", 100.0),
        ("ghosts, %", "frame_ghost_share", 100.0),
    ];
    let columns = columns.map(|(head, name, factor)| (head, list(name), factor));
    let mut html = String::from("<table><tr><th>frame");
    columns.iter().for_each(|(head, ..)| html += &format!("<th class=n>{head}"));
    for (i, file) in files.iter().enumerate() {
        let _ = write!(html, "<tr><td>{}", escape(file.as_str().unwrap_or_default()));
        for (_, values, factor) in &columns {
            let value = values.get(i).and_then(|v| v.as_f64()).map(|v| format!("{:.2}", v * factor));
            let _ = write!(html, "<td class=n>{}", value.unwrap_or_default());
        }
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
        let html = section(&response, None);
        for part in ["<polyline", "<polygon", "a&lt;b.jpg", "+1.00 ± 0.02", "by pixels</tr>", "not told"] {
            assert!(html.contains(part), "{part}");
        }
        assert!(!html.contains("NaN") && !html.contains("inf"));
        assert!(section(&Response::srgb(), None).is_empty());
    }
}

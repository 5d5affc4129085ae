//! `report.html`: one file with everything in it.

use super::figures::{DEFINITIONS, Report, short};
use super::pictures::ErrorMap;
use crate::composite::encode_png;
use crate::error::Result;
use crate::image::CodeImage;
use crate::stage::Manifest;
use std::fmt::Write;

/// What the report shows.
pub struct Page<'a> {
    /// Heading.
    pub title: &'a str,
    /// Figures.
    pub report: &'a Report,
    /// Pictures side by side, with captions.
    pub pictures: Vec<(&'a str, CodeImage)>,
    /// False-colour maps, with captions.
    pub maps: Vec<(&'a str, ErrorMap)>,
    /// Manifests of the stages that ran.
    pub stages: Vec<Manifest>,
    /// Further parts, as HTML.
    pub sections: Vec<String>,
    /// Remarks on how the figures came about.
    pub notes: Vec<String>,
}

const STYLE: &str = "\
:root{color-scheme:light dark;--line:color-mix(in srgb,currentColor 18%,transparent);--soft:color-mix(in srgb,currentColor 60%,transparent)}\
body{font:15px/1.5 system-ui,sans-serif;max-width:1500px;margin:2rem auto;padding:0 1.5rem}\
h1{font-size:1.6rem;margin:0 0 .2rem}h2{font-size:1.15rem;margin:2.2rem 0 .7rem}\
p,.soft{color:var(--soft)}\
.row{display:grid;grid-template-columns:repeat(auto-fit,minmax(300px,1fr));gap:1rem}\
figure{margin:0}img{width:100%;height:auto;display:block;border-radius:4px}\
figcaption{font-size:.85rem;color:var(--soft);margin-top:.3rem}\
.legend{display:flex;gap:.5rem;align-items:center;font-size:.8rem;margin-top:.3rem;font-variant-numeric:tabular-nums}\
.legend i{flex:1;height:.7rem;border-radius:2px}\
table{border-collapse:collapse;width:100%;font-size:.9rem}\
th,td{text-align:left;padding:.35rem .8rem .35rem 0;border-bottom:1px solid var(--line);vertical-align:top}\
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}\
.ok{color:#1a8f4c}.bad{color:#d6394a;font-weight:600}ul{margin:.2rem 0;padding-left:1.1rem}\
code{font-size:.85em}details summary{cursor:pointer;color:var(--soft)}";

/// Writes the page; pictures are embedded.
pub fn page(page: &Page) -> Result<String> {
    let mut html = String::new();
    let title = escape(page.title);
    // Writing into a string cannot fail.
    let _ = write!(
        html,
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width\">\
         <title>{title}</title><style>{STYLE}</style><h1>{title}</h1>"
    );
    let [w, h] = page.report.size_px;
    let against: Vec<String> = page.report.references.values().map(|r| escape(r)).collect();
    let against = if page.report.judged {
        format!("judged against {}", against.join(", "))
    } else {
        "no reference was given: there is nothing to judge against".into()
    };
    let _ = write!(html, "<p>{w}×{h} px, insitu {}, {against}</p><div class=row>", env!("CARGO_PKG_VERSION"));
    for (caption, image) in &page.pictures {
        let _ = write!(html, "{}</figure>", figure(image, caption)?);
    }
    html += "</div>";
    if !page.report.figures.is_empty() {
        html += "<h2>Figures</h2>";
        html += &figures_table(page.report);
    }
    page.notes.iter().for_each(|n| html += &format!("<p>{}</p>", escape(n)));
    if !page.maps.is_empty() {
        html += "<h2>Removed radiance</h2><div class=row>";
        for (caption, map) in &page.maps {
            html += &mapped(map, caption)?;
        }
        html += "</div>";
    }
    page.sections.iter().for_each(|s| html += s);
    html += "<h2>Stages</h2>";
    html += &stages_table(&page.stages);
    html += "</html>\n";
    Ok(html)
}

/// A map with its legend.
pub(super) fn mapped(map: &ErrorMap, caption: &str) -> Result<String> {
    Ok(format!("{}{}</figure>", figure(&map.image, caption)?, legend(map)))
}

fn figure(image: &CodeImage, caption: &str) -> Result<String> {
    let data = base64(&encode_png(image)?);
    let caption = escape(caption);
    Ok(format!(
        "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{data}\"><figcaption>{caption}</figcaption>"
    ))
}

fn legend(map: &ErrorMap) -> String {
    let colours: Vec<String> = map
        .colours
        .iter()
        .map(|c| {
            let [r, g, b] = c.map(|v| (v * 255.0).round() as u8);
            format!("rgb({r} {g} {b})")
        })
        .collect();
    format!(
        "<div class=legend>{}<i style=\"background:linear-gradient(90deg,{})\"></i>{}</div>",
        short(f64::from(map.low)),
        colours.join(","),
        short(f64::from(map.high))
    )
}

fn figures_table(report: &Report) -> String {
    let mut html = String::from(
        "<table><tr><th>figure<th class=n>value<th class=n>nothing done<th class=n>bound<th>reads</tr>",
    );
    for f in &report.figures {
        let about = DEFINITIONS.iter().find(|d| d.name == f.name).map_or("", |d| d.about);
        let number = |v: Option<f64>| v.map(short).unwrap_or_default();
        let class = match f.passed {
            Some(true) => "n ok",
            Some(false) => "n bad",
            None => "n",
        };
        let value = f.value.map_or("not measured".into(), |v| format!("{} {}", short(v), f.unit));
        let _ = write!(
            html,
            "<tr><td><code>{}</code><td class=\"{class}\">{value}<td class=n>{}<td class=n>{}<td>{}</tr>",
            f.name,
            number(f.baseline),
            f.bound.map(|b| format!("≤ {}", short(b))).unwrap_or_default(),
            escape(about)
        );
    }
    html + "</table>"
}

fn stages_table(stages: &[Manifest]) -> String {
    let mut html = String::from(
        "<table><tr><th>stage<th class=n>wall time, s<th class=n>peak memory, MiB<th>warnings<th>figures</tr>",
    );
    for m in stages {
        let warnings: String = m.warnings.iter().map(|w| format!("<li>{}", escape(w))).collect();
        let warnings = if warnings.is_empty() { "–".into() } else { format!("<ul>{warnings}</ul>") };
        let figures: String = m
            .figures
            .iter()
            .map(|(name, v)| {
                let value = v.as_f64().map_or_else(|| v.to_string(), short);
                format!("<li><code>{}</code> {}", escape(name), escape(&value))
            })
            .collect();
        let figures = if figures.is_empty() {
            "–".into()
        } else {
            format!("<details><summary>{}</summary><ul>{figures}</ul></details>", m.figures.len())
        };
        let _ = write!(
            html,
            "<tr><td>{}<td class=n>{:.2}<td class=n>{:.0}<td>{warnings}<td>{figures}</tr>",
            escape(&m.stage),
            m.wall_s,
            m.peak_memory_mib
        );
    }
    html + "</table>"
}

pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// RFC 4648 with padding.
pub(super) fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let bits = chunk.iter().fold(0u32, |bits, b| bits << 8 | u32::from(*b)) << (8 * (3 - chunk.len()));
        for i in 0..4 {
            let digit = (bits >> (18 - 6 * i)) & 63;
            text.push(if i <= chunk.len() { char::from(ALPHABET[digit as usize]) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::figures::Measured;
    use super::super::pictures::error_map;
    use super::*;
    use crate::image::{Code, Image, Radiance};

    #[test]
    fn base64_follows_the_rfc() {
        for (plain, encoded) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(plain.as_bytes()), encoded);
        }
    }

    #[test]
    fn the_page_holds_everything_and_points_nowhere() {
        let mut measured = Measured::default();
        measured.put_with_baseline("relative_shadow_error", 0.5, Some(1.0));
        let bounds = [("relative_shadow_error".to_string(), 0.35)].into();
        let report = Report { judged: true, figures: measured.figures(&bounds), ..Report::default() };
        let manifest = Manifest {
            stage: "render".into(),
            stage_version: 1,
            program: "0".into(),
            settings: serde_json::Value::Null,
            inputs: Default::default(),
            outputs: Default::default(),
            wall_s: 1.25,
            peak_memory_mib: 64.0,
            warnings: vec!["a < b".into()],
            figures: [("sources_used".to_string(), 12.into())].into(),
        };
        let html = page(&Page {
            title: "office & more",
            report: &report,
            pictures: vec![("plate", Image::from_fn(8, 8, |_, _| Code([0.5; 3])))],
            maps: vec![("error", error_map(&Image::from_fn(8, 8, |_, _| Radiance([0.1; 3])), 0.2))],
            stages: vec![manifest],
            sections: vec!["<p>a part".into()],
            notes: vec!["a note".into()],
        })
        .unwrap();
        for part in [
            "office &amp; more",
            "data:image/png;base64,",
            "class=\"n bad\">0.5000",
            "≤ 0.3500",
            "a &lt; b",
            "sources_used",
            "<p>a part",
        ] {
            assert!(html.contains(part), "{part}");
        }
        assert!(!html.contains("http"), "nothing is fetched");
    }
}

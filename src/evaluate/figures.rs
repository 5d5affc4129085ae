//! The figures of a report: what they mean, and the bounds they are held to.

use crate::artefact::json::JsonArtefact;
use crate::config;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// What a figure is.
#[derive(Debug, Clone, Copy)]
pub struct Definition {
    /// Name, as in `[evaluate.bounds]`.
    pub name: &'static str,
    /// Unit; empty for a ratio.
    pub unit: &'static str,
    /// How to read it.
    pub about: &'static str,
}

const fn define(name: &'static str, unit: &'static str, about: &'static str) -> Definition {
    Definition { name, unit, about }
}

/// Every figure there is, in the order of the report.
pub const DEFINITIONS: &[Definition] = &[
    define(
        "relative_shadow_error",
        "",
        "rms(ε − ε*) / rms(ε*) over the shadow region: 0 exact, 1 nothing done",
    ),
    define("relative_shadow_error_4x4", "", "the same on means of 4×4 pixels: what of it is not noise"),
    define("shadow_energy_bias", "", "Σε / Σε* − 1 over the shadow region: + too dark, − too light"),
    define("composite_relative_rmse", "", "rms((C − T) / T) over the shadow region"),
    define("composite_relative_rmse_4x4", "", "the same on means of 4×4 pixels"),
    define("object_relative_rmse", "", "rms((C − T) / T) inside the object"),
    define("object_relative_rmse_4x4", "", "the same on means of 4×4 pixels"),
    define("object_bias", "", "ΣC / ΣT − 1 inside the object: + too bright, − too dark"),
    define("coverage_error", "", "Σ|A − A*| / ΣA*: how far the object's outline is off"),
    define("flip", "", "mean ꟻLIP of the display images at 67 px per degree: 0 no visible difference"),
    define("ssim", "", "mean SSIM of the display images: 1 identical"),
    define(
        "reference_noise",
        "",
        "noise of the reference's own ε* over rms(ε*): no smaller shadow error means anything",
    ),
    define("reference_scale", "", "plate units in one unit of the reference"),
    define("reference_tint", "", "largest departure of one channel's scale from the common one"),
    define("shadow_region_px", "px", "size of the shadow region"),
    define("object_region_px", "px", "size of the object's inside"),
    define(
        "radiance_error_percent",
        "%",
        "median |B / T − 1| of the merged plate at the common scale, unclipped pixels",
    ),
    define("radiance_error_unscaled_percent", "%", "the same without a free scale"),
    define("focal_error_percent", "%", "focal length against truth: + too long"),
    define(
        "camera_position_error_percent",
        "%",
        "distance of the plate's camera from its true place, of its distance to the grid",
    ),
    define("ball_centre_error_mm", "mm", "distance of the ball's centre from its true place"),
    define(
        "response_error_stops",
        "stops",
        "rms error of the response for 0.02 < x < 1, but for a common scale",
    ),
    define("response_scale_stops", "stops", "that common scale"),
];

/// One figure of a report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// One of [`DEFINITIONS`].
    pub name: String,
    /// The value; none if it could not be measured.
    pub value: Option<f64>,
    /// Unit; empty for a ratio.
    pub unit: String,
    /// The same figure of the plate as it was, nothing done.
    pub baseline: Option<f64>,
    /// Largest allowed magnitude.
    pub bound: Option<f64>,
    /// Whether the value keeps to the bound; a figure that could not be measured does not.
    pub passed: Option<bool>,
}

/// `report.json`: what `insitu validate` prints.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Whether there was anything to judge against.
    pub judged: bool,
    /// Size of the pictures, px.
    pub size_px: [usize; 2],
    /// File names of the references.
    pub references: BTreeMap<String, String>,
    /// The figures.
    pub figures: Vec<Figure>,
}

impl JsonArtefact for Report {
    const FORMAT: &'static str = "insitu-report";
    const VERSION: u32 = 1;
}

/// Refuses a bound on a figure that does not exist, naming the nearest that does.
pub fn check_bounds(bounds: &BTreeMap<String, f64>) -> Result<()> {
    for (name, bound) in bounds {
        if !DEFINITIONS.iter().any(|d| d.name == name) {
            let nearest = DEFINITIONS
                .iter()
                .map(|d| d.name)
                .max_by(|a, b| strsim::jaro_winkler(a, name).total_cmp(&strsim::jaro_winkler(b, name)));
            return Err(Error::Usage {
                problem: format!("`evaluate.bounds` names a figure `{name}`, which there is not"),
                hint: format!("did you mean `{}`?", nearest.unwrap_or_default()),
            });
        }
        if !(bound.is_finite() && *bound >= 0.0) {
            return Err(Error::Usage {
                problem: format!(
                    "`evaluate.bounds.{name}` is {bound}, expected a finite number of at least 0"
                ),
                hint: "bounds are largest allowed magnitudes".into(),
            });
        }
    }
    Ok(())
}

/// Values as they are measured.
#[derive(Debug, Clone, Default)]
pub struct Measured {
    values: BTreeMap<&'static str, (f64, Option<f64>)>,
}

impl Measured {
    /// A figure.
    pub fn put(&mut self, name: &'static str, value: f64) {
        self.values.insert(name, (value, None));
    }

    /// A figure beside the one of having done nothing.
    pub fn put_with_baseline(&mut self, name: &'static str, value: f64, baseline: Option<f64>) {
        self.values.insert(name, (value, baseline));
    }

    /// In the report's order, held to bounds; figures that are bounded but were not measured come without a value.
    pub fn figures(&self, bounds: &BTreeMap<String, f64>) -> Vec<Figure> {
        let figure = |d: &Definition| {
            // A value that is not finite was not measured.
            let measured = self.values.get(d.name).filter(|(v, _)| v.is_finite());
            let bound = bounds.get(d.name).copied();
            (measured.is_some() || bound.is_some()).then(|| Figure {
                name: d.name.into(),
                value: measured.map(|m| m.0),
                unit: d.unit.into(),
                baseline: measured.and_then(|m| m.1).filter(|v| v.is_finite()),
                bound,
                passed: bound.map(|b| measured.is_some_and(|m| within(d.name, m.0, b))),
            })
        };
        DEFINITIONS.iter().filter_map(figure).collect()
    }
}

/// SSIM grows with quality: its bound is on 1 − SSIM.
fn within(name: &str, value: f64, bound: f64) -> bool {
    if name == "ssim" { 1.0 - value <= bound } else { value.abs() <= bound }
}

impl Report {
    /// Holds what was measured to the settings' bounds.
    pub fn new(measured: &Measured, settings: &config::Evaluate, size_px: [usize; 2]) -> Self {
        let named = [
            ("reference", &settings.reference),
            ("reference_empty", &settings.reference_empty),
            ("reference_mask", &settings.reference_mask),
            ("truth", &settings.truth),
        ];
        let shown = |(role, path): (&str, &Option<PathBuf>)| {
            path.as_ref().map(|p| (role.to_string(), p.display().to_string()))
        };
        Self {
            judged: settings.reference.is_some() || settings.truth.is_some(),
            size_px,
            references: named.into_iter().filter_map(shown).collect(),
            figures: measured.figures(&settings.bounds),
        }
    }

    /// `name,value,unit,baseline,bound,passed`.
    pub fn to_csv(&self) -> String {
        let number = |v: Option<f64>| v.map(|v| v.to_string()).unwrap_or_default();
        let mut text = String::from("name,value,unit,baseline,bound,passed\n");
        for f in &self.figures {
            let passed = f.passed.map(|p| p.to_string()).unwrap_or_default();
            let (value, baseline, bound) = (number(f.value), number(f.baseline), number(f.bound));
            text += &format!("{},{value},{},{baseline},{bound},{passed}\n", f.name, f.unit);
        }
        text
    }

    /// One line a figure, aligned.
    pub fn table(&self) -> Vec<String> {
        self.figures
            .iter()
            .map(|f| {
                let value = f.value.map_or("not measured".into(), |v| format!("{} {}", short(v), f.unit));
                let bound = match (f.bound, f.passed) {
                    (Some(b), Some(true)) => format!("≤ {}  ok", short(b)),
                    (Some(b), _) => format!("≤ {}  FAILED", short(b)),
                    _ => String::new(),
                };
                format!("{:32} {value:>14}  {bound}", f.name).trim_end().to_string()
            })
            .collect()
    }
}

/// Four significant digits.
pub fn short(v: f64) -> String {
    match v.abs() {
        0.0 => "0".into(),
        a if a >= 1000.0 => format!("{v:.0}"),
        a => format!("{v:.*}", (3 - a.log10().floor() as i32).clamp(0, 9) as usize),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bounds(pairs: &[(&str, f64)]) -> BTreeMap<String, f64> {
        pairs.iter().map(|(n, v)| (n.to_string(), *v)).collect()
    }

    #[test]
    fn a_bound_on_an_unknown_figure_names_the_nearest() {
        let e = check_bounds(&bounds(&[("relative_shadw_error", 0.3)])).unwrap_err();
        assert!(e.to_string().contains("`relative_shadw_error`"), "{e}");
        assert_eq!(e.hint(), "did you mean `relative_shadow_error`?");
        assert!(check_bounds(&bounds(&[("flip", f64::NAN)])).is_err());
        assert!(check_bounds(&bounds(&[("flip", 0.2), ("ssim", 0.1)])).is_ok());
    }

    #[test]
    fn bounds_are_on_magnitudes_and_unmeasured_figures_fail() {
        let mut measured = Measured::default();
        measured.put("shadow_energy_bias", -0.25);
        measured.put("ssim", 0.95);
        measured.put("object_bias", f64::NAN);
        let figures = measured.figures(&bounds(&[
            ("shadow_energy_bias", 0.2),
            ("ssim", 0.1),
            ("flip", 1.0),
            ("object_bias", 1.0),
        ]));
        let passed: Vec<_> = figures.iter().map(|f| (f.name.as_str(), f.value.is_some(), f.passed)).collect();
        assert_eq!(
            passed,
            [
                ("shadow_energy_bias", true, Some(false)),
                ("object_bias", false, Some(false)),
                ("flip", false, Some(false)),
                ("ssim", true, Some(true)),
            ]
        );
    }

    #[test]
    fn the_csv_has_a_line_a_figure() {
        let mut measured = Measured::default();
        measured.put_with_baseline("relative_shadow_error", 0.25, Some(1.0));
        let report = Report {
            figures: measured.figures(&bounds(&[("relative_shadow_error", 0.35)])),
            ..Report::default()
        };
        assert_eq!(
            report.to_csv(),
            "name,value,unit,baseline,bound,passed\nrelative_shadow_error,0.25,,1,0.35,true\n"
        );
        assert!(report.table()[0].ends_with("0.2500   ≤ 0.3500  ok"), "{:?}", report.table());
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(
            [0.0, 0.012345, 1.5, 123.456, 6645.0].map(short),
            ["0", "0.01235", "1.500", "123.5", "6645"]
        );
    }
}

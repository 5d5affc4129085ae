//! What each number of a settings file may be. Checked when the file is read, so that a mistake in the last stage does
//! not wait for the first ones, and with ends that keep a slip of the pen from exhausting memory.

use super::Pipeline;
use toml_edit::Item;

/// Values that make sense.
#[derive(Debug, Clone, Copy)]
enum Range {
    /// Above the first, up to the second.
    Above(f64, f64),
    /// From the first to the second.
    From(f64, f64),
}

use Range::{Above, From};

impl Range {
    /// NaN lies in none.
    fn holds(self, value: f64) -> bool {
        match self {
            Above(low, high) => value > low && value <= high,
            From(low, high) => value >= low && value <= high,
        }
    }
}

impl std::fmt::Display for Range {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Above(low, high) => write!(f, "above {low}, at most {high}"),
            From(low, high) => write!(f, "from {low} to {high}"),
        }
    }
}

/// Table, key and range; of lists every element. Lengths in metres end where no room or camera is.
const RANGES: &[(&str, &str, Range)] = &[
    ("ingest", "sensor_width_mm", Above(0.0, 1000.0)),
    ("ingest", "focal_mm", Above(0.0, 10_000.0)),
    ("response", "samples", From(1.0, 100_000.0)),
    ("response", "smoothness", Above(0.0, 1e12)),
    ("response", "vignetting", From(-2.0, 2.0)),
    ("response", "seed", From(0.0, 1e15)),
    ("merge", "full_well_electrons", From(0.0, 1e9)),
    ("merge", "read_noise_electrons", From(0.0, 1e6)),
    ("merge", "clip", Above(0.5, 1.0)),
    ("calibrate", "inner_corners", From(3.0, 100.0)),
    ("calibrate", "square_m", Above(0.0, 100.0)),
    ("calibrate", "thickness_m", From(0.0, 10.0)),
    ("calibrate", "mark_sigma_px", Above(0.0, 100.0)),
    ("calibrate", "stated_focal_sigma", Above(0.0, 1.0)),
    ("calibrate", "camera_height_m", From(0.0, 1000.0)),
    ("calibrate", "max_rms_px", Above(0.0, 100.0)),
    ("probe", "radius_m", Above(0.0, 10.0)),
    ("probe", "reflectivity", Above(0.0, 1.0)),
    ("probe", "support_m", From(-1000.0, 1000.0)),
    ("probe", "width_px", From(16.0, 8192.0)),
    ("probe", "photographer_deg", From(0.0, 60.0)),
    ("probe", "position_m", From(-1000.0, 1000.0)),
    ("probe", "azimuth_deg", From(-360.0, 360.0)),
    ("probe", "elevation_deg", From(-90.0, 90.0)),
    ("probe", "distance_m", Above(0.0, 1000.0)),
    ("probe", "focal_px", From(0.0, 1e5)),
    ("probe", "principal_point_px", From(0.0, 1e5)),
    ("probe", "field_deg", Above(0.0, 360.0)),
    ("model", "mark_sigma_px", Above(0.0, 100.0)),
    ("model", "max_rms_px", Above(0.0, 1000.0)),
    ("model", "presumed_height_m", Above(0.0, 100.0)),
    ("model", "presumed_wall_m", Above(0.0, 100.0)),
    ("illuminate", "max_edge_m", From(0.01, 1000.0)),
    ("illuminate", "min_edge_m", From(0.001, 1000.0)),
    ("illuminate", "max_power_share", Above(0.0, 1.0)),
    ("illuminate", "unseen_reflectance", From(0.0, 1.0)),
    ("illuminate", "distant_sources", From(1.0, 65_536.0)),
    ("irradiance", "spacing_m", From(0.01, 1000.0)),
    ("irradiance", "reach_m", Above(0.0, 1000.0)),
    ("irradiance", "rays", From(16.0, 1e6)),
    ("transfer", "source_share", Above(0.0, 1.0)),
    ("transfer", "rays", From(1.0, 4096.0)),
    ("transfer", "link_tolerance", From(0.0, 0.1)),
    ("transfer", "leaf_patches", From(1.0, 1000.0)),
    ("transfer", "shaft_share", From(0.0, 1.0)),
    ("transfer", "receiver_tolerance", From(0.0, 1.0)),
    ("transfer", "receiver_vertices", From(0.0, 1e7)),
    ("render", "position_m", From(-1000.0, 1000.0)),
    ("render", "rotation_deg", From(-36_000.0, 36_000.0)),
    ("render", "scale", Above(0.0, 1e6)),
    ("render", "diffuse", From(0.0, 1.0)),
    ("render", "specular", From(0.0, 1.0)),
    ("render", "shininess", From(0.0, 1e6)),
    ("render", "roughness", Above(0.0, 1.0)),
    ("render", "smooth_deg", From(0.0, 180.0)),
    ("render", "shading_rays", From(1.0, 65_536.0)),
    ("render", "reflected_rays", From(0.0, 65_536.0)),
    ("render", "environment_px", From(8.0, 4096.0)),
    ("render", "antialiasing", From(1.0, 32.0)),
    ("render", "shadow_map_px", From(16.0, 8192.0)),
    ("render", "passes", From(0.0, 1e6)),
    ("render", "origins", From(1.0, 1024.0)),
    ("render", "register_px", From(0.0, 16.0)),
    ("render", "frame_ms", From(0.0, 1e6)),
    ("render", "max_error", From(0.0, 1.0)),
    ("render", "caster_triangles", From(0.0, 1e9)),
    ("render", "first_set_share", From(0.0, 1.0)),
    ("render", "rays", From(2.0, 1e6)),
    ("render", "lights", From(1.0, 100_000.0)),
    ("render", "pixels_per_sample", From(1.0, 1024.0)),
    ("render", "slices", From(1.0, 16.0)),
    ("render", "occlusion_px", From(16.0, 4096.0)),
    ("render", "dome_texels", From(1.0, 32.0)),
    ("render", "dome_splits", From(0.0, 1000.0)),
    ("live", "frames_per_second", Above(0.0, 1000.0)),
    ("live", "most_frames", From(0.0, 1e9)),
    ("live", "focal_px", From(0.0, 1e5)),
    ("live", "principal_point_px", From(0.0, 1e5)),
    ("live", "distortion", From(-100.0, 100.0)),
    ("live", "paper", Above(0.0, 1.0)),
    ("live", "hold_frames", From(0.0, 1e6)),
    ("live", "fade_frames", From(0.0, 1e6)),
    ("live", "ball_centre_m", From(-1000.0, 1000.0)),
    ("live", "environment_distance_m", From(0.0, 1e5)),
    ("live", "most_lights", From(0.0, 1e5)),
    ("live", "maps_per_frame", From(0.0, 1e5)),
    ("composite", "exposure_ev", From(-30.0, 30.0)),
];

/// Of the entries of `ingest.exposure`.
const EXPOSURE: &[(&str, Range)] =
    &[("time_s", Above(0.0, 1e5)), ("f_number", Above(0.0, 1000.0)), ("iso", Above(0.0, 1e7))];

/// A value outside its range.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Outside {
    /// Table and key.
    pub path: [&'static str; 2],
    /// What is wrong.
    pub problem: String,
    /// What to do.
    pub hint: String,
}

/// The first value outside its range.
pub(super) fn check(pipeline: &Pipeline) -> Option<Outside> {
    // TOML keeps what JSON has no word for: NaN and infinity.
    let value = toml::Value::try_from(pipeline).ok()?;
    let default = toml::Value::try_from(Pipeline::default()).ok()?;
    for &(table, key, range) in RANGES {
        let Some(given) = value.get(table).and_then(|t| t.get(key)) else { continue };
        if let Some(bad) = numbers(given).into_iter().find(|v| !range.holds(*v)) {
            let usual = default.get(table).and_then(|t| t.get(key)).map(numbers);
            let usual = usual.map_or(String::new(), |d| {
                let all: Vec<_> = d.iter().map(|v| shown(*v)).collect();
                format!("; without it, it is {}", all.join(", "))
            });
            return Some(Outside {
                path: [table, key],
                problem: format!("`{table}.{key}` is {}", shown(bad)),
                hint: format!("give a number {range}{usual}"),
            });
        }
    }
    let render = &pipeline.render;
    let sum = (0..3).map(|k| render.diffuse[k] + render.specular[k]).fold(0.0, f32::max);
    if sum > 1.0 + 1e-6 {
        return Some(Outside {
            path: ["render", "specular"],
            problem: format!("`render.diffuse` and `render.specular` together reflect {sum}"),
            hint: "let them add up to at most 1 in every channel".into(),
        });
    }
    views(&value).or_else(|| exposure(&value))
}

/// Of the entries of `probe.views`.
fn views(value: &toml::Value) -> Option<Outside> {
    const VIEW: [(&str, Range); 2] =
        [("azimuth_deg", From(-360.0, 360.0)), ("elevation_deg", From(-90.0, 90.0))];
    for view in value.get("probe")?.get("views")?.as_array()? {
        for (key, range) in VIEW {
            let bad = view.get(key).and_then(|v| numbers(v).into_iter().find(|v| !range.holds(*v)));
            if let Some(bad) = bad {
                return Some(Outside {
                    path: ["probe", "views"],
                    problem: format!("`{key}` of a view is {}", shown(bad)),
                    hint: format!("give a number {range}"),
                });
            }
        }
    }
    None
}

fn exposure(value: &toml::Value) -> Option<Outside> {
    for entry in value.get("ingest")?.get("exposure")?.as_array()? {
        for &(key, range) in EXPOSURE {
            let bad = entry.get(key).and_then(|v| numbers(v).into_iter().find(|v| !range.holds(*v)));
            if let Some(bad) = bad {
                let file = entry.get("file").and_then(|f| f.as_str()).unwrap_or_default();
                return Some(Outside {
                    path: ["ingest", "exposure"],
                    problem: format!("`{key}` of {file} is {}", shown(bad)),
                    hint: format!("give a number {range}, or leave it out to use EXIF"),
                });
            }
        }
    }
    None
}

fn numbers(value: &toml::Value) -> Vec<f64> {
    match value {
        toml::Value::Integer(i) => vec![*i as f64],
        toml::Value::Float(f) => vec![*f],
        toml::Value::Array(a) => a.iter().flat_map(numbers).collect(),
        _ => Vec::new(),
    }
}

/// As it was written, where it was read as f32.
fn shown(value: f64) -> String {
    let short = value as f32;
    if short.is_finite() && f64::from(short) == value { short.to_string() } else { value.to_string() }
}

/// Byte at which a key stands in a settings file.
pub(super) fn place(text: &str, [table, key]: [&str; 2]) -> Option<usize> {
    let document = toml_edit::Document::parse(text).ok()?;
    let table: &Item = document.as_table().get(table)?;
    let (name, _) = table.as_table_like()?.get_key_value(key)?;
    name.span().map(|span| span.start)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_default_lies_in_its_range() {
        assert_eq!(check(&Pipeline::default()), None);
    }

    #[test]
    fn every_number_of_the_settings_has_a_range() {
        let value = toml::Value::try_from(Pipeline::default()).unwrap();
        for (table, content) in value.as_table().unwrap() {
            for (key, v) in content.as_table().into_iter().flatten() {
                let ranged = RANGES.iter().any(|(t, k, _)| t == table && k == key);
                let free = key == "seed";
                assert!(ranged || free || numbers(v).is_empty(), "{table}.{key}");
            }
        }
    }
}

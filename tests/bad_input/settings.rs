//! `pipeline.toml`.

use super::cases::{case, check};
use super::spoil::Spoil::*;

#[test]
fn settings_are_shown_with_line_and_column() {
    check(&[
        case(
            "settings file missing",
            &[],
            "insitu run nowhere.toml",
            2,
            "nowhere.toml: reading the settings: No such file or directory (os error 2)",
            "name a settings file, or write one with `insitu new FOLDER`",
        ),
        case(
            "not TOML",
            &[Write("case.toml", "[probe\n")],
            "ingest",
            2,
            "case.toml:1:7: unclosed table, expected `]`",
            "see the commented pipeline.toml of insitu",
        ),
        case(
            "not text",
            &[Copy("photos/plate_000.jpg", "case.toml")],
            "ingest",
            2,
            "case.toml: reading the settings: stream did not contain valid UTF-8",
            "save it as UTF-8 text",
        ),
        case(
            "unknown key",
            &[Set("[transfer]\nrays = 4\n  sorce_share = 0.5\n")],
            "ingest",
            2,
            "case.toml:4:3: unknown field `sorce_share`, expected one of `source_share`, `rays`, `link_tolerance`, `order`, `leaf_patches`, `shaft_share`, `receiver_tolerance`, `receiver_vertices`",
            "did you mean `source_share`?",
        ),
        case(
            "unknown table",
            &[Set("[rendre]\nscale = 2\n")],
            "ingest",
            2,
            "case.toml:2:2: unknown field `rendre`, expected one of `extends`, `work`, `annotations`, `ingest`, `response`, `merge`, `calibrate`, `probe`, `model`, `illuminate`, `irradiance`, `transfer`, `render`, `composite`, `evaluate`, `live`",
            "did you mean `render`?",
        ),
        case(
            "unknown role",
            &[Set(r#"[ingest.roles]
plaet = ["plate_000.jpg"]
"#)],
            "ingest",
            2,
            "case.toml:3:1: unknown variant `plaet`, expected one of `plate`, `brackets`, `plate_with_grid`, `probe`, `grid`, `flat`, `frames`",
            "did you mean `plate`?",
        ),
        case(
            "wrong type",
            &[Set(r#"[probe]
radius_m = "0.1"
"#)],
            "ingest",
            2,
            r#"case.toml:3:12: invalid type: string "0.1", expected a number"#,
            "see the commented pipeline.toml of insitu",
        ),
        case(
            "negative count",
            &[Set("[render]\nrays = -5\n")],
            "render",
            2,
            "case.toml:3:8: invalid value: integer `-5`, expected a whole number of at least 0",
            "see the commented pipeline.toml of insitu",
        ),
        case(
            "unknown method",
            &[Set(r#"[render]
method = "raytrace"
"#)],
            "render",
            2,
            "case.toml:3:10: unknown variant `raytrace`, expected one of `raytraced`, `radiance-transfer`, `radiance-transfer-ldr`, `subtractive`, `occlusion-textures`, `light-dome`",
            "did you mean `raytraced`?",
        ),
        case(
            "unknown gloss",
            &[Set("[render]\ngloss = \"gxx\"\n")],
            "render",
            2,
            "case.toml:3:9: unknown variant `gxx`, expected one of `by-file`, `phong`, `torrance-sparrow`, `ggx`",
            "did you mean `ggx`?",
        ),
        case(
            "unknown response method",
            &[Set(r#"[response]
method = "debevec"
"#)],
            "response",
            2,
            "case.toml:3:10: unknown variant `debevec`, expected one of `auto`, `debevec-malik`, `mitsunaga-nayar`, `robertson`",
            "did you mean `debevec-malik`?",
        ),
        case(
            "response file not a name",
            &[Set("[response]\nfile = 3\n")],
            "response",
            2,
            "case.toml:3:8: invalid type: integer `3`, expected path string",
            "see the commented pipeline.toml of insitu",
        ),
        case(
            "exposures from pixels neither true nor false",
            &[Set(r#"[response]
exposures_from_pixels = "yes"
"#)],
            "response",
            2,
            r#"case.toml:3:25: invalid type: string "yes", expected a boolean"#,
            "see the commented pipeline.toml of insitu",
        ),
        case(
            "negative seed",
            &[Set("[response]\nseed = -1\n")],
            "response",
            2,
            "case.toml:3:8: invalid value: integer `-1`, expected a whole number of at least 0",
            "see the commented pipeline.toml of insitu",
        ),
        case(
            "align neither true nor false",
            &[Set("[merge]\nalign = 1\n")],
            "merge",
            2,
            "case.toml:3:9: invalid type: integer `1`, expected a boolean",
            "see the commented pipeline.toml of insitu",
        ),
        case(
            "deghost neither true nor false",
            &[Set(r#"[merge]
deghost = "no"
"#)],
            "merge",
            2,
            r#"case.toml:3:11: invalid type: string "no", expected a boolean"#,
            "see the commented pipeline.toml of insitu",
        ),
        case(
            "extends nothing",
            &[Write("case.toml", "extends = \"base.toml\"\n")],
            "ingest",
            2,
            "base.toml: reading the settings: No such file or directory (os error 2)",
            "check `extends` in case.toml",
        ),
        case(
            "extends twice",
            &[Set(""), Write("twice.toml", "extends = \"case.toml\"\n")],
            "insitu status twice.toml",
            2,
            "case.toml: is extended by another file and extends one itself",
            "keep to one level of `extends`",
        ),
    ]);
}

#[test]
fn numbers_out_of_range_are_refused() {
    check(&[
        case(
            "negative radius",
            &[Set("[probe]\nradius_m = -0.1\n")],
            "probe",
            2,
            "case.toml:3:1: `probe.radius_m` is -0.1",
            "give a number above 0, at most 10; without it, it is 0.1",
        ),
        case(
            "radius not a number",
            &[Set("[probe]\nradius_m = nan\n")],
            "probe",
            2,
            "case.toml:3:1: `probe.radius_m` is NaN",
            "give a number above 0, at most 10; without it, it is 0.1",
        ),
        case(
            "reflectivity above 1",
            &[Set("[probe]\nreflectivity = [0.9, 1.2, 0.9]\n")],
            "probe",
            2,
            "case.toml:3:1: `probe.reflectivity` is 1.2",
            "give a number above 0, at most 1; without it, it is 0.9, 0.9, 0.9",
        ),
        case(
            "no environment",
            &[Set("[probe]\nwidth_px = 0\n")],
            "probe",
            2,
            "case.toml:3:1: `probe.width_px` is 0",
            "give a number from 16 to 8192; without it, it is 512",
        ),
        case(
            "huge environment",
            &[Set("[probe]\nwidth_px = 1000000000\n")],
            "probe",
            2,
            "case.toml:3:1: `probe.width_px` is 1000000000",
            "give a number from 16 to 8192; without it, it is 512",
        ),
        case(
            "negative edge",
            &[Set("[illuminate]\nmax_edge_m = -1\n")],
            "illuminate",
            2,
            "case.toml:3:1: `illuminate.max_edge_m` is -1",
            "give a number from 0.01 to 1000; without it, it is 0.25",
        ),
        case(
            "tiny edge",
            &[Set("[illuminate]\nmax_edge_m = 1e-9\n")],
            "illuminate",
            2,
            "case.toml:3:1: `illuminate.max_edge_m` is 0.000000001",
            "give a number from 0.01 to 1000; without it, it is 0.25",
        ),
        case(
            "no share",
            &[Set("[transfer]\nsource_share = 0\n")],
            "transfer",
            2,
            "case.toml:3:1: `transfer.source_share` is 0",
            "give a number above 0, at most 1; without it, it is 0.7",
        ),
        case(
            "share above 1",
            &[Set("[transfer]\nsource_share = 1.5\n")],
            "transfer",
            2,
            "case.toml:3:1: `transfer.source_share` is 1.5",
            "give a number above 0, at most 1; without it, it is 0.7",
        ),
        case(
            "no rays",
            &[Set("[transfer]\nrays = 0\n")],
            "transfer",
            2,
            "case.toml:3:1: `transfer.rays` is 0",
            "give a number from 1 to 4096; without it, it is 8",
        ),
        case(
            "no irradiance rays",
            &[Set("[irradiance]\nrays = 0\n")],
            "irradiance",
            2,
            "case.toml:3:1: `irradiance.rays` is 0",
            "give a number from 16 to 1000000; without it, it is 4096",
        ),
        case(
            "scale 0",
            &[Set("[render]\nscale = 0\n")],
            "render",
            2,
            "case.toml:3:1: `render.scale` is 0",
            "give a number above 0, at most 1000000; without it, it is 1",
        ),
        case(
            "no antialiasing",
            &[Set("[render]\nantialiasing = 0\n")],
            "render",
            2,
            "case.toml:3:1: `render.antialiasing` is 0",
            "give a number from 1 to 32; without it, it is 4",
        ),
        case(
            "huge shadow map",
            &[Set("[render]\nshadow_map_px = 10000000\n")],
            "render",
            2,
            "case.toml:3:1: `render.shadow_map_px` is 10000000",
            "give a number from 16 to 8192; without it, it is 256",
        ),
        case(
            "diffuse above 1",
            &[Set("[render]\ndiffuse = [1.5, 0.5, 0.5]\n")],
            "render",
            2,
            "case.toml:3:1: `render.diffuse` is 1.5",
            "give a number from 0 to 1; without it, it is 0.5, 0.5, 0.5",
        ),
        case(
            "a facet's roughness of 0",
            &[Set("[render]\nroughness = 0\n")],
            "render",
            2,
            "case.toml:3:1: `render.roughness` is 0",
            "give a number above 0, at most 1; without it, it is 0.2",
        ),
        case(
            "rougher than rough",
            &[Set("[render]\nroughness = 1.5\n")],
            "render",
            2,
            "case.toml:3:1: `render.roughness` is 1.5",
            "give a number above 0, at most 1; without it, it is 0.2",
        ),
        case(
            "one inner corner",
            &[Set("[calibrate]\ninner_corners = [1, 5]\n")],
            "calibrate",
            2,
            "case.toml:3:1: `calibrate.inner_corners` is 1",
            "give a number from 3 to 100; without it, it is 7, 5",
        ),
        case(
            "huge seed",
            &[Set("[response]\nseed = 9000000000000000000\n")],
            "response",
            2,
            "case.toml:3:1: `response.seed` is 9000000000000000000",
            "give a number from 0 to 1000000000000000; without it, it is 0",
        ),
        case(
            "negative full well",
            &[Set("[merge]\nfull_well_electrons = -1\n")],
            "merge",
            2,
            "case.toml:3:1: `merge.full_well_electrons` is -1",
            "give a number from 0 to 1000000000; without it, it is 0",
        ),
        case(
            "full well not a number",
            &[Set("[merge]\nfull_well_electrons = nan\n")],
            "merge",
            2,
            "case.toml:3:1: `merge.full_well_electrons` is NaN",
            "give a number from 0 to 1000000000; without it, it is 0",
        ),
        case(
            "exposure time 0",
            &[Set(r#"[ingest]
exposure = [{ file = "probe_*.jpg", time_s = 0.0 }]
"#)],
            "ingest",
            2,
            "case.toml:3:1: `time_s` of probe_*.jpg is 0",
            "give a number above 0, at most 100000, or leave it out to use EXIF",
        ),
        case(
            "exposure time negative",
            &[Set(r#"[ingest]
exposure = [{ file = "probe_*.jpg", time_s = -0.1 }]
"#)],
            "ingest",
            2,
            "case.toml:3:1: `time_s` of probe_*.jpg is -0.1",
            "give a number above 0, at most 100000, or leave it out to use EXIF",
        ),
        case(
            "base file out of range",
            &[Swap("pipeline.toml", "radius_m = 0.1", "radius_m = 0.0")],
            "probe",
            2,
            "pipeline.toml:88:1: `probe.radius_m` is 0",
            "give a number above 0, at most 10; without it, it is 0.1",
        ),
        case(
            "more diffuse and specular than light",
            &[Set("[render]\ndiffuse = [0.8, 0.8, 0.8]\nspecular = [0.5, 0.5, 0.5]\n")],
            "render",
            2,
            "case.toml:4:1: `render.diffuse` and `render.specular` together reflect 1.3",
            "let them add up to at most 1 in every channel",
        ),
        case(
            "nodes without end",
            &[Set("[irradiance]\nspacing_m = 0.01\nreach_m = 100\n")],
            "irradiance",
            1,
            "building the irradiance volume: the irradiance volume would have # nodes, at most 100,000 are sensible",
            "raise irradiance.spacing_m or lower irradiance.reach_m",
        ),
    ]);
}

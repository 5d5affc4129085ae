//! Photographs and their exposures: stages `ingest` and `response`.

use super::cases::{case, check};
use super::spoil::Spoil::*;

#[test]
fn photographs_are_checked() {
    check(&[
        case(
            "photo folder missing",
            &[Set(r#"[ingest]
photos = "fotos"
"#)],
            "ingest",
            1,
            "listing the photographs: ./fotos: No such file or directory (os error 2)",
            "check the name and the folder in pipeline.toml",
        ),
        case(
            "photo folder empty",
            &[
                Set(r#"[ingest]
photos = "empty"
"#),
                Write("empty/readme.txt", "none\n"),
            ],
            "ingest",
            1,
            "listing the photographs: ./empty: holds no JPEG, PNG, TIFF, HDR or EXR file",
            "put the photographs there, or name their folder with `photos` in [ingest]",
        ),
        case(
            "pattern without a match",
            &[Set(r#"[ingest.roles]
probe = ["prob_*.jpg"]
"#)],
            "ingest",
            1,
            "sorting the photographs by role: `prob_*.jpg` (ingest.roles.probe) matches none of 30 image files",
            "did you mean `probe_07.jpg`?",
        ),
        case(
            "file with two roles",
            &[Set(r#"[ingest.roles]
grid = ["calib_*.jpg", "probe_00.jpg"]
"#)],
            "ingest",
            1,
            "sorting the photographs by role: probe_00.jpg has the roles `probe` and `grid`",
            "let each file match one role in [ingest.roles]; only the plate may also be one of the brackets",
        ),
        case(
            "no plate",
            &[Set("[ingest.roles]\nplate = []\n")],
            "ingest",
            1,
            "checking the photographs: no photograph has the role `plate`",
            r#"name it in pipeline.toml: [ingest.roles] plate = ["FILE"]"#,
        ),
        case(
            "photo is text",
            &[Write("photos/probe_03.jpg", "not a picture\n")],
            "ingest",
            1,
            "reading the header of a photograph: ./photos/probe_03.jpg: is not a JPEG, PNG, TIFF, Radiance HDR or OpenEXR image",
            "export it as JPEG or 16-bit TIFF, or leave it out of the roles",
        ),
        case(
            "photo is empty",
            &[Write("photos/probe_03.jpg", "")],
            "ingest",
            1,
            "reading the header of a photograph: ./photos/probe_03.jpg: is not a JPEG, PNG, TIFF, Radiance HDR or OpenEXR image",
            "export it as JPEG or 16-bit TIFF, or leave it out of the roles",
        ),
        case(
            "other size among exposures",
            &[
                Restore("photos/brackets_03.jpg", 320, 240),
                Set(r#"[ingest]
exposure = [{ file = "brackets_03.jpg", time_s = 0.1, f_number = 8, iso = 100 }]
"#),
            ],
            "ingest",
            1,
            "checking the photographs: brackets_03.jpg is 320×240 px, brackets_00.jpg is 640×480 px; they must be of one size for role `brackets`",
            "use photographs of one size, neither cropped nor scaled",
        ),
        case(
            "exposure time missing",
            &[Restore("photos/brackets_03.jpg", 640, 480)],
            "ingest",
            1,
            "checking the photographs: brackets_03.jpg (`brackets`) has no exposure time",
            r#"state it under [ingest] in pipeline.toml: exposure = [{ file = "brackets_03.jpg", time_s = 0.01 }], and f_number and iso if they vary"#,
        ),
        case(
            "another colour profile",
            &[Profile("photos/plate_000.jpg")],
            "ingest",
            1,
            "checking the photographs: plate_000.jpg has Adobe RGB embedded, not sRGB",
            "develop it again as sRGB, all photographs alike: a conversion afterwards would mix the channels' responses",
        ),
        case(
            "photo removed after ingest",
            &[Remove("photos/brackets_03.jpg")],
            "response",
            1,
            "opening an input of stage `response`: ./photos/brackets_03.jpg: No such file or directory (os error 2)",
            "check the name and the folder in pipeline.toml",
        ),
        case(
            "photo changed after ingest",
            &[Restore("photos/brackets_03.jpg", 320, 240)],
            "response",
            1,
            "reading a photograph: ./photos/brackets_03.jpg: is 320×240 px, was 640×480 px at ingest",
            "run again from stage `ingest`",
        ),
        case(
            "JPEG cut short",
            &[Cut("photos/brackets_03.jpg", 60)],
            "response",
            1,
            "decoding a photograph: ./photos/brackets_03.jpg: truncated JPEG: the end-of-image marker is missing",
            "copy the file again from the camera, or leave it out of the roles",
        ),
        case(
            "NaN in an EXR photograph",
            &[
                Exr("photos/plate.exr", 640, 480, true),
                Set(r#"[ingest.roles]
plate = ["plate.exr"]
brackets = []
plate_with_grid = []
"#),
            ],
            "insitu run case.toml --to merge",
            1,
            "reading an EXR: ./photos/plate.exr: channel G is NaN at pixel (1, 0)",
            "repair or leave out the file: every sample must be a finite number",
        ),
    ]);
}

#[test]
fn exposures_must_tell_the_response() {
    check(&[
        case(
            "all exposures equal",
            &[Set(r#"[ingest]
exposure = [{ file = "*.jpg", time_s = 0.01, f_number = 8.0, iso = 100 }]
"#)],
            "insitu run case.toml --to response",
            1,
            "fitting the response to brackets_00.jpg … brackets_06.jpg: 7 frames have 1 distinct exposure, at least 2 are needed",
            "photograph the view with exposure times one or two stops apart, or state the times in [[ingest.exposure]]",
        ),
        case(
            "all white",
            &[Flat("brackets", 255)],
            "response",
            1,
            "fitting the response to brackets_00.jpg … brackets_06.jpg: channel red: 0 of # places are well exposed in two frames, at least 30 are needed (100 % of their exposures are clipped, 0 % black)",
            "add shorter exposures",
        ),
        case(
            "all black",
            &[Flat("brackets", 0)],
            "response",
            1,
            "fitting the response to brackets_00.jpg … brackets_06.jpg: channel red: 0 of # places are well exposed in two frames, at least 30 are needed (0 % of their exposures are clipped, 100 % black)",
            "add longer exposures",
        ),
    ]);
}

#[test]
fn vignetting_must_be_a_lens_s() {
    check(&[
        case(
            "vignetting of no lens",
            &[Set("[response]\nvignetting = [-1.5, 0.0, 0.0]\n")],
            "response",
            1,
            "finding the vignetting: the vignetting would leave 0.04 of the light at some place of the picture, from 0.05 to 1.5 is believed",
            "check `vignetting` in [response], or that role `flat` shows a surface of even brightness alone",
        ),
        case(
            "vignetting out of range",
            &[Set("[response]\nvignetting = [-3.0, 0.0, 0.0]\n")],
            "response",
            2,
            "case.toml:3:1: `response.vignetting` is -3",
            "give a number from -2 to 2; without it, it is 0, 0, 0",
        ),
        case(
            "vignetting that one photograph of the grid does not tell",
            &[Set("[ingest.roles]\ngrid = [\"calib_00.jpg\"]\n[response]\nestimate_vignetting = true\n")],
            "insitu run case.toml --to response",
            1,
            "estimating the vignetting from photographs of the grid: the white squares of 1 photographs of the grid leave the light in the picture's corners uncertain by # %, at most 2 % is allowed",
            "photograph the grid in all parts of the picture, its corners too, its paper neither clipped nor in patchy light; or an even surface (role `flat`)",
        ),
        case(
            "flat field clipped",
            &[
                Flat("plate_001", 255),
                Set("[ingest.roles]\nplate = [\"plate_000.jpg\"]\nflat = [\"plate_001.jpg\"]\n"),
            ],
            "insitu run case.toml --to response",
            1,
            "finding the vignetting: 0 % of a photograph of role `flat` are well exposed, 70 % are needed",
            "photograph a surface of even brightness so that it fills the picture, at a middle grey",
        ),
    ]);
}

#[cfg(not(feature = "raw"))]
#[test]
fn raw_files_are_named_where_insitu_cannot_read_them() {
    check(&[case(
        "RAW file",
        &[Write("photos/plate.cr2", "II*"), Set("[ingest.roles]\nplate = [\"plate.cr2\"]\n")],
        "ingest",
        1,
        "reading the header of a photograph: ./photos/plate.cr2: is a camera's RAW file, and insitu was built without them",
        "build with `cargo build --release --features raw`, or develop all photographs alike to 16-bit TIFF in sRGB",
    )]);
}

#[test]
fn a_saved_response_is_checked() {
    check(&[
        case(
            "saved response missing",
            &[Set(r#"[response]
file = "other/response.json"
"#)],
            "response",
            1,
            "opening an input of stage `response`: ./other/response.json: No such file or directory (os error 2)",
            "check the name and the folder in pipeline.toml",
        ),
        case(
            "saved response cut short",
            &[
                Set(r#"[response]
file = "curve.json"
"#),
                Write("curve.json", "{ \"format\": \"insitu-"),
            ],
            "response",
            1,
            "reading insitu-response: ./curve.json: damaged or cut short (EOF while parsing a string at line 1 column 20)",
            "copy or export the file again",
        ),
        case(
            "saved response of another format",
            &[
                Set(r#"[response]
file = "curve.json"
"#),
                Copy("work/model/scene.json", "curve.json"),
            ],
            "response",
            1,
            "reading insitu-response: ./curve.json: is a `insitu-scene`, expected a `insitu-response`",
            "copy or export the file again",
        ),
        case(
            "saved response of an older version",
            &[
                Set(r#"[response]
file = "curve.json"
"#),
                Copy("work/response/response.json", "curve.json"),
                Swap("curve.json", "\"version\": 3", "\"version\": 1"),
            ],
            "response",
            1,
            "reading insitu-response: ./curve.json: has schema version 1, this insitu reads 3",
            "copy or export the file again",
        ),
        case(
            "saved response that falls",
            &[
                Set(r#"[response]
file = "curve.json"
"#),
                Copy("work/response/response.json", "curve.json"),
                Swap("curve.json", "\"exposure\": [", "\"exposure\": [2.0,"),
            ],
            "response",
            1,
            "reading insitu-response: ./curve.json: channel red: 257 levels that do not rise throughout",
            "copy or export the file again",
        ),
    ]);
}

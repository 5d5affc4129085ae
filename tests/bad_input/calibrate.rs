//! Stage `calibrate`.

use super::cases::{case, check};
use super::spoil::Spoil::*;

#[test]
fn calibration_refuses_what_it_cannot_find() {
    check(&[
        case(
            "grid not found",
            &[Set("[ingest.roles]\ngrid = []\nplate_with_grid = []\n"), Remove("annotations.toml")],
            "insitu run case.toml --to calibrate",
            1,
            "finding lens and pose of plate_000.jpg: no grid of 7×5 inner corners is seen whole",
            "show the whole grid, sharp and larger, and check `calibrate.inner_corners`",
        ),
        case(
            "lines parallel in the picture",
            &[
                Set(r#"[calibrate]
pose = "vanishing_lines"
"#),
                Write(
                    "annotations.toml",
                    r#"[vanishing_lines]
image = "plate_000.jpg"
origin = [250, 300]
scale = { from = [250, 300], to = [250, 200], axis = "z", length_m = 0.5 }
x = [[100, 100, 500, 100], [100, 300, 500, 300]]
z = [[100, 100, 100, 400], [300, 100, 300, 400]]
"#,
                ),
            ],
            "calibrate",
            1,
            "finding lens and pose of plate_000.jpg: of 2 marked directions 0 have a vanishing point at a finite distance, 2 are needed for the focal length: the others are parallel in the picture",
            "use a photograph that shows two directions in perspective, or give grid photographs",
        ),
        case(
            "f² < 0",
            &[
                Set(r#"[calibrate]
pose = "vanishing_lines"
"#),
                Write(
                    "annotations.toml",
                    r#"[vanishing_lines]
image = "plate_000.jpg"
origin = [250, 300]
scale = { from = [250, 300], to = [250, 200], axis = "z", length_m = 0.5 }
x = [[100, 100, 300, 200], [100, 400, 300, 300]]
y = [[100, 120, 320, 210], [100, 390, 320, 290]]
"#,
                ),
            ],
            "calibrate",
            1,
            "finding lens and pose of plate_000.jpg: the marked directions cannot be orthogonal: f² = -# px²",
            "check which edges are marked as x, y and z: they must be at right angles in the room",
        ),
        case(
            "one line along a direction",
            &[
                Set(r#"[calibrate]
pose = "vanishing_lines"
"#),
                Write(
                    "annotations.toml",
                    r#"[vanishing_lines]
image = "plate_000.jpg"
origin = [250, 300]
scale = { from = [250, 300], to = [250, 200], axis = "z", length_m = 0.5 }
x = [[100, 100, 300, 200]]
y = [[500, 100, 300, 200]]
"#,
                ),
            ],
            "calibrate",
            1,
            "finding lens and pose of plate_000.jpg: 1 edges are marked along a direction, 2 are needed for its vanishing point",
            "mark at least two edges along each direction",
        ),
        case(
            "lines in another picture",
            &[Swap("annotations.toml", "image = \"plate_000.jpg\"", "image = \"probe_00.jpg\"")],
            "calibrate",
            1,
            "reading annotations.toml: the vanishing lines are marked in probe_00.jpg, which was not taken from the plate's place",
            "mark them in the plate",
        ),
        case(
            "lines without origin and scale",
            &[Set(r#"[calibrate]
pose = "vanishing_lines"
"#)],
            "calibrate",
            1,
            "finding lens and pose of plate_000.jpg: a pose from vanishing lines alone needs the marks `origin` and `scale`, or the camera's height",
            "mark `origin` and `scale` under [vanishing_lines], or set `calibrate.camera_height_m`",
        ),
        case(
            "mark is infinite",
            &[Swap("annotations.toml", "[7.13, 461.75", "[inf, 461.75")],
            "calibrate",
            2,
            "./annotations.toml:8:6: inf is no number that can be measured",
            "give pixels or metres as finite numbers below a million",
        ),
    ]);
}

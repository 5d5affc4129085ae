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
            "finding lens and pose of plate_000.jpg: no grid of 7×5 inner corners is seen, whole or in part",
            "show more of the grid, sharp and larger, and check `calibrate.inner_corners`",
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

#[test]
fn grids_of_markers_must_be_printable() {
    check(&[
        case(
            "markers larger than their squares",
            &[Set(r#"[calibrate]
grid = { charuco = { dictionary = "6x6_250", marker_m = 0.08 } }
"#)],
            "calibrate",
            1,
            "finding lens and pose of plate_000.jpg: `calibrate.grid` has markers of 0.08 m in squares of 0.06 m",
            "measure the printed grid again, in metres",
        ),
        case(
            "a dictionary that is not",
            &[Set(r#"[calibrate]
grid = { aruco = { dictionary = "6x6_25", board = { columns = 5, rows = 7, side_m = 0.04, gap_m = 0.01 } } }
"#)],
            "calibrate",
            1,
            "finding lens and pose of plate_000.jpg: there is no dictionary of markers `6x6_25`",
            "did you mean `6x6_250`?",
        ),
        case(
            "more markers than the dictionary has",
            &[Set(r#"[calibrate]
grid = { aruco = { dictionary = "4x4_50", board = { columns = 8, rows = 7, side_m = 0.04, gap_m = 0.01 } } }
"#)],
            "calibrate",
            1,
            "finding lens and pose of plate_000.jpg: the dictionary has 50 markers, and none with the number 55",
            "take another dictionary, or markers with smaller numbers",
        ),
    ]);
}

#[test]
fn cameras_of_other_programs_must_be_the_plates() {
    const LENS: &str = "1 PINHOLE 640 480 500 500 320 240\n";
    check(&[
        case(
            "a model without the plate",
            &[
                Set("[calibrate]\nimport = \"sparse\"\n"),
                Write("sparse/cameras.txt", LENS),
                Write("sparse/images.txt", "1 1 0 0 0 0 0 2 1 other.jpg\n\n"),
            ],
            "calibrate",
            1,
            "reading the cameras of sparse: there is no camera of plate_000.jpg among them",
            "let the other program see the plate, too, under its file name",
        ),
        case(
            "a model of a smaller picture",
            &[
                Set("[calibrate]\nimport = \"sparse\"\n"),
                Write("sparse/cameras.txt", "1 PINHOLE 320 240 250 250 160 120\n"),
                Write("sparse/images.txt", "1 1 0 0 0 0 0 2 1 plate_000.jpg\n\n"),
            ],
            "calibrate",
            1,
            "reading the cameras of sparse: the camera of plate_000.jpg is one of 320×240 px, the photograph has 640×480 px",
            "give the other program the photograph as it is here, neither cropped nor scaled",
        ),
        case(
            "a model with a fisheye lens",
            &[
                Set("[calibrate]\nimport = \"sparse\"\n"),
                Write("sparse/cameras.txt", "1 FOV 640 480 500 500 320 240 0.9\n"),
                Write("sparse/images.txt", "1 1 0 0 0 0 0 2 1 plate_000.jpg\n\n"),
            ],
            "calibrate",
            1,
            "reading the cameras of sparse: camera 1 has the model `FOV`",
            "use SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV or FULL_OPENCV without k4 … k6, or undistort the images (`colmap image_undistorter`)",
        ),
        case(
            "no model",
            &[Set("[calibrate]\nimport = \"sparse\"\n")],
            "calibrate",
            1,
            "opening an input of stage `calibrate`: ./sparse/cameras.txt: No such file or directory (os error 2)",
            "check the name and the folder in pipeline.toml",
        ),
        case(
            "no project of fSpy",
            &[Set("[calibrate]\nimport = \"room.fspy\"\n"), Write("room.fspy", "fspy, or is it?\n")],
            "calibrate",
            1,
            "reading the cameras of room.fspy: is cut short or no project of fSpy",
            "export it again",
        ),
    ]);
}

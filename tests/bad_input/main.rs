//! Every bad input gets an exact message, an exit status and leaves earlier results as they were.

#[path = "../common/mod.rs"]
mod common;
mod spoil;

use spoil::Spoil::{self, *};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// A bad input and what is said of it.
struct Case {
    name: &'static str,
    spoils: &'static [Spoil],
    /// A stage, to be run alone on `case.toml`; or a command line of `insitu`.
    program: &'static str,
    /// Exit status: 1 data, 2 settings or usage.
    code: i32,
    /// `#` stands for a measured number.
    error: &'static str,
    hint: &'static str,
}

const fn case(
    name: &'static str,
    spoils: &'static [Spoil],
    program: &'static str,
    code: i32,
    error: &'static str,
    hint: &'static str,
) -> Case {
    Case { name, spoils, program, code, error, hint }
}

/// The office, run through once with fast settings; cases work on copies made of links.
fn prepared() -> &'static Path {
    static PREPARED: OnceLock<PathBuf> = OnceLock::new();
    PREPARED.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bad_input");
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("making a folder");
        let office = common::Capture::office();
        let output = office.run(&["--quiet"]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        link(&office.path(""), &folder);
        folder
    })
}

fn link(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("making a folder");
    for entry in std::fs::read_dir(from).expect("reading a folder").flatten() {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            link(&entry.path(), &target);
        } else if std::fs::hard_link(entry.path(), &target).is_err() {
            std::fs::copy(entry.path(), &target).expect("copying");
        }
    }
}

/// A spoilt copy of the prepared capture.
fn spoilt(spoils: &[Spoil]) -> tempfile::TempDir {
    let parent = prepared().parent().expect("a folder");
    let folder = tempfile::tempdir_in(parent).expect("a temporary folder");
    link(prepared(), folder.path());
    Set("").apply(folder.path());
    spoils.iter().for_each(|s| s.apply(folder.path()));
    folder
}

fn run(folder: &Path, program: &str) -> Output {
    let insitu = Path::new(env!("CARGO_BIN_EXE_insitu"));
    let mut command = match program.strip_prefix("insitu ") {
        Some(arguments) => {
            let mut command = Command::new(insitu);
            command.args(arguments.split(' '));
            command
        }
        None => {
            let mut command = Command::new(insitu.with_file_name(format!("insitu-{program}")));
            command.arg("case.toml");
            command
        }
    };
    command.current_dir(folder).output().expect("starting the program")
}

/// Hashes of all results.
fn results(folder: &Path) -> BTreeMap<PathBuf, String> {
    let mut all = BTreeMap::new();
    let mut folders = vec![folder.join("work")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
            match entry.path().is_dir() {
                true => folders.push(entry.path()),
                false => drop(all.insert(
                    entry.path(),
                    insitu::stage::digest_file(&entry.path()).expect("reading a result"),
                )),
            }
        }
    }
    all
}

/// The lines `error: …` and `hint: …` of the first error.
fn said(output: &Output) -> [String; 2] {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    ["error: ", "hint: "].map(|start| {
        let line = text.lines().find_map(|l| l.strip_prefix(start));
        line.map_or(format!("no `{start}` in {text:?}"), String::from)
    })
}

/// Whether a message is the expected one, in which `#` stands for a measured number.
fn is(said: &str, expected: &str) -> bool {
    let mut rest = said;
    for (i, part) in expected.split('#').enumerate() {
        if i > 0 {
            let end = rest.find(|c: char| !(c.is_ascii_digit() || c == '-')).unwrap_or(rest.len());
            // A point is of the number where digits follow it.
            let fraction =
                rest[end..].strip_prefix('.').map(|f| f.chars().take_while(char::is_ascii_digit).count());
            let number = end + fraction.filter(|n| *n > 0).map_or(0, |n| n + 1);
            if number == 0 {
                return false;
            }
            rest = &rest[number..];
        }
        let Some(after) = rest.strip_prefix(part) else { return false };
        rest = after;
    }
    rest.is_empty()
}

fn check(cases: &[Case]) {
    let mut wrong = String::new();
    for case in cases {
        let folder = spoilt(case.spoils);
        let before = results(folder.path());
        let output = run(folder.path(), case.program);
        let [error, hint] = said(&output);
        let code = output.status.code();
        if code != Some(case.code) || !is(&error, case.error) || hint != case.hint {
            wrong += &format!("@@ {}\ncode {code:?}\nerror {error}\nhint {hint}\n", case.name);
        }
        // A single stage leaves all as it was; `insitu run` may have finished earlier ones.
        if !case.program.starts_with("insitu run") && results(folder.path()) != before {
            wrong += &format!("@@ {}: earlier results changed\n", case.name);
        }
    }
    assert!(wrong.is_empty(), "\n{wrong}");
}

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
            "case.toml:2:2: unknown field `rendre`, expected one of `extends`, `work`, `annotations`, `ingest`, `response`, `merge`, `calibrate`, `probe`, `model`, `illuminate`, `irradiance`, `transfer`, `render`, `composite`, `evaluate`",
            "did you mean `render`?",
        ),
        case(
            "unknown role",
            &[Set(r#"[ingest.roles]
plaet = ["plate_000.jpg"]
"#)],
            "ingest",
            2,
            "case.toml:3:1: unknown variant `plaet`, expected one of `plate`, `brackets`, `plate_with_grid`, `probe`, `grid`, `frames`",
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
            "case.toml:3:10: unknown variant `raytrace`, expected `raytraced` or `radiance-transfer`",
            "did you mean `raytraced`?",
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
            "one inner corner",
            &[Set("[calibrate]\ninner_corners = [1, 5]\n")],
            "calibrate",
            2,
            "case.toml:3:1: `calibrate.inner_corners` is 1",
            "give a number from 3 to 100; without it, it is 7, 5",
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
            "pipeline.toml:73:1: `probe.radius_m` is 0",
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
            "finding lens and pose of plate_000.jpg: a pose from vanishing lines alone needs the marks `origin` and `scale`",
            "mark `origin` and `scale` under [vanishing_lines]",
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
fn the_ball_must_be_whole_and_where_it_is_said_to_be() {
    check(&[
        case(
            "radius too large",
            &[Set("[probe]\nradius_m = 0.3\n")],
            "probe",
            1,
            "looking for the mirror ball in the photographs of role `probe`: the mirror ball was not found: at the best place its mirror image agrees with the surface by a correlation of #, 0.80 is needed",
            "check probe.radius_m and probe.support_m, and that grid and ball stand on the same surface",
        ),
        case(
            "ball half outside",
            &[Turn("probe", 18.0)],
            "probe",
            1,
            "looking for the mirror ball in the photographs of role `probe`: the mirror ball is cut off by the border of the picture: # % of its outline lie outside",
            "use a picture that shows the whole ball",
        ),
        case(
            "ball outside",
            &[Turn("probe", 26.0)],
            "probe",
            1,
            "looking for the mirror ball in the photographs of role `probe`: the mirror ball was not found: at the best place its mirror image agrees with the surface by a correlation of #, 0.80 is needed",
            "check probe.radius_m and probe.support_m, and that grid and ball stand on the same surface",
        ),
        case(
            "support elsewhere",
            &[Set("[probe]\nsupport_m = 5.0\n")],
            "probe",
            1,
            "looking for the mirror ball in the photographs of role `probe`: the camera is # m above the plane through the ball's centre: it must look from above",
            "check probe.support_m and the pose of the grid",
        ),
        case(
            "probe black",
            &[Flat("probe", 0)],
            "probe",
            1,
            "looking for the grid in the photographs of role `probe`: no grid of 7×5 inner corners is seen whole",
            "show the whole grid, sharp and larger, and check `calibrate.inner_corners`",
        ),
        case(
            "no photograph of the ball",
            &[Set(r#"[ingest]
photos = "photos"
[ingest.roles]
probe = []
"#)],
            "insitu run case.toml --to probe",
            1,
            "looking for the mirror ball in the photographs of role `probe`: there is no photograph of the mirror ball",
            "name its photographs in pipeline.toml under [ingest.roles] as `probe`",
        ),
    ]);
}

#[test]
fn marks_must_make_sense() {
    check(&[
        case(
            "annotations missing",
            &[Remove("annotations.toml")],
            "model",
            1,
            "fitting the scene to annotations.toml: no primitive is given",
            "add at least one [[primitive]] to annotations.toml, e.g. a `ground`",
        ),
        case(
            "no primitive",
            &[Write("annotations.toml", "")],
            "model",
            1,
            "fitting the scene to annotations.toml: no primitive is given",
            "add at least one [[primitive]] to annotations.toml, e.g. a `ground`",
        ),
        case(
            "unknown kind",
            &[Write(
                "annotations.toml",
                r#"[[primitive]]
name = "floor"
kind = "floor"
"#,
            )],
            "model",
            2,
            "./annotations.toml:3:8: unknown variant `floor`, expected one of `room`, `ground`, `box`, `quad`, `polygon`",
            "did you mean `room`?",
        ),
        case(
            "unknown key in marks",
            &[Swap("annotations.toml", "reflection = true", "reflected = true")],
            "model",
            2,
            "./annotations.toml:49:68: unknown field `reflected`, expected one of `corner`, `image`, `at`, `reflection`",
            "did you mean `reflection`?",
        ),
        case(
            "unknown parent",
            &[Swap("annotations.toml", "parent = \"desk_top\"", "parent = \"desktop\"")],
            "model",
            1,
            "fitting the scene to annotations.toml: `book` has the parent `desktop`, which is not in the file",
            "name a room, ground or box as the parent, or leave it out",
        ),
        case(
            "parents in a circle",
            &[Write(
                "annotations.toml",
                r#"[[primitive]]
name = "a"
kind = "box"
parent = "b"
[[primitive]]
name = "b"
kind = "box"
parent = "a"
"#,
            )],
            "model",
            1,
            "fitting the scene to annotations.toml: `a` is, by way of its parents, its own parent",
            "let one of them stand on the surface under the grid: leave out its `parent`",
        ),
        case(
            "two of one name",
            &[Swap("annotations.toml", "name = \"carton\"", "name = \"cabinet\"")],
            "model",
            1,
            "fitting the scene to annotations.toml: two primitives are called `cabinet`",
            "give each primitive a name of its own",
        ),
        case(
            "mark in an unknown picture",
            &[Swap(
                "annotations.toml",
                "image = \"plate_000.jpg\", at = [329.5, 172.5]",
                "image = \"plate_007.jpg\", at = [329.5, 172.5]",
            )],
            "model",
            1,
            "fitting the scene to annotations.toml: corner `+--` of `room` is marked in plate_007.jpg, whose pose is not known",
            "mark photographs of the plate's place, or of the probe",
        ),
        case(
            "reflection beside the ball",
            &[Swap("annotations.toml", "at = [382.5, 249.5]", "at = [20.5, 30.5]")],
            "model",
            1,
            "fitting the scene to annotations.toml: corner `---` of `room` is marked as a reflection at [20.5, 30.5] in probe_04.jpg, where there is no ball",
            "mark it within the ball's outline in a photograph of the probe",
        ),
        case(
            "contradictory mark",
            &[Swap("annotations.toml", "at = [25.5, 233.5]", "at = [225.5, 33.5]")],
            "model",
            1,
            "fitting the scene to annotations.toml: the marks contradict each other by # px (rms, limit 5.0 px); the worst is corner `-+-` of `carton` in plate_000.jpg, # px off",
            r#"check this mark first; or set `lift` or `yaw` to "free""#,
        ),
        case(
            "mark is NaN",
            &[Swap("annotations.toml", "at = [25.5, 233.5]", "at = [nan, 33.5]")],
            "model",
            2,
            "./annotations.toml:76:54: nan is no number that can be measured",
            "give pixels or metres as finite numbers below a million",
        ),
        case(
            "parameter without a mark",
            &[Write(
                "annotations.toml",
                r#"[[primitive]]
name = "floor"
kind = "ground"
[[primitive]]
name = "box"
kind = "box"
parent = "floor"
marks = [{ corner = "---", image = "plate_000.jpg", at = [39.5, 303.5] }]
"#,
            )],
            "model",
            1,
            "fitting the scene to annotations.toml: depth of `box` is not determined by the data (condition number inf)",
            "add marks that determine it, or give its value",
        ),
        case(
            "unknown corner",
            &[Swap("annotations.toml", "corner = \"+++\"", "corner = \"++\"")],
            "model",
            1,
            "fitting the scene to annotations.toml: `room` has no corner `++`",
            "corners of boxes are like `-+-` (x, y up, z), of quads `-+`, of polygons `0`, `1`, …",
        ),
        case(
            "negative size",
            &[Write(
                "annotations.toml",
                r#"[[primitive]]
name = "floor"
kind = "ground"
[[primitive]]
name = "box"
kind = "box"
parent = "floor"
size_m = [-1.0, 1.0, 1.0]
"#,
            )],
            "model",
            1,
            "fitting the scene to annotations.toml: `box` has the size -1 m",
            "check its marks, or give its size_m",
        ),
        case(
            "sizes missing",
            &[Write(
                "annotations.toml",
                r#"[[primitive]]
name = "box"
kind = "box"
size_m = [1.0]
"#,
            )],
            "model",
            1,
            "fitting the scene to annotations.toml: `box` gives 1 sizes, its kind has 3",
            "give width, height, depth; 0 for what is to be fitted",
        ),
    ]);
}

#[test]
fn artefacts_are_refused_with_file_and_cure() {
    check(&[
        case(
            "stage missing",
            &[Remove("work/model")],
            "illuminate",
            1,
            "illuminate needs scene.json: ./work/model: stage `model` has not finished",
            "run `insitu run --to illuminate`",
        ),
        case(
            "stage.json damaged",
            &[Write("work/merge/stage.json", r#"{ "format": "insitu-"#)],
            "composite",
            1,
            "reading insitu-stage: ./work/merge/stage.json: damaged or cut short (EOF while parsing a string at line 1 column 20)",
            "run `insitu run --force --from merge`",
        ),
        case(
            "artefact missing",
            &[Remove("work/merge/plate.exr")],
            "composite",
            1,
            "composite needs plate.exr: ./work/merge/plate.exr: is not there any more",
            "run `insitu run --force --from merge`",
        ),
        case(
            "scene.json cut short",
            &[Write("work/model/scene.json", r#"{ "format": "insitu-scene", "version": 1, "faces": ["#)],
            "illuminate",
            1,
            "reading insitu-scene: ./work/model/scene.json: damaged or cut short (EOF while parsing a list at line 1 column 52)",
            "run `insitu run --force --from model`",
        ),
        case(
            "another schema version",
            &[Swap("work/calibrate/cameras.json", "\"version\": 1", "\"version\": 99")],
            "transfer",
            1,
            "reading insitu-cameras: ./work/calibrate/cameras.json: has schema version 99, this insitu reads 1",
            "run `insitu run --force --from calibrate`",
        ),
        case(
            "another format",
            &[Copy("work/model/scene.json", "work/calibrate/cameras.json")],
            "transfer",
            1,
            "reading insitu-cameras: ./work/calibrate/cameras.json: is a `insitu-scene`, expected a `insitu-cameras`",
            "run `insitu run --force --from calibrate`",
        ),
        case(
            "plate without a camera",
            &[Swap(
                "work/calibrate/cameras.json",
                "\"plate\": \"plate_000.jpg\"",
                "\"plate\": \"other.jpg\"",
            )],
            "transfer",
            1,
            "reading insitu-cameras: ./work/calibrate/cameras.json: has no camera of the plate, other.jpg",
            "run `insitu run --force --from calibrate`",
        ),
        case(
            "impossible lens",
            &[Swap("work/calibrate/cameras.json", "\"width_px\": 640", "\"width_px\": 0")],
            "transfer",
            1,
            "reading insitu-cameras: ./work/calibrate/cameras.json: has an impossible lens for plate_000.jpg",
            "run `insitu run --force --from calibrate`",
        ),
        case(
            "links_irradiance.npy cut short",
            &[Cut("work/transfer/links_irradiance.npy", 50)],
            "render",
            1,
            "reading an array: ./work/transfer/links_irradiance.npy: damaged or cut short (reached EOF before reading all data)",
            "run `insitu run --force --from transfer`",
        ),
        case(
            "links_irradiance.npy of another run",
            &[Copy("work/transfer/irradiance.npy", "work/transfer/links_irradiance.npy")],
            "render",
            1,
            "reading the transfers: ./work/transfer/links_irradiance.npy: is (#, #) large, transfer.json says (#, #)",
            "run `insitu run --force --from transfer`",
        ),
        case(
            "patches.ply cut short",
            &[Cut("work/illuminate/patches.ply", 90)],
            "transfer",
            1,
            "reading a PLY: ./work/illuminate/patches.ply: damaged or cut short (Line #: Unexpected end of file while reading binary element 'face' (expected #, got #).",
            "run `insitu run --force --from illuminate`",
        ),
        case(
            "irradiance.ply cut short",
            &[Cut("work/irradiance/irradiance.ply", 50)],
            "render",
            1,
            "reading a PLY: ./work/irradiance/irradiance.ply: damaged or cut short (Line #: Unexpected end of file while reading binary element 'vertex' (expected #, got #).",
            "run `insitu run --force --from irradiance`",
        ),
        case(
            "plate.exr cut short",
            &[Cut("work/merge/plate.exr", 50)],
            "composite",
            1,
            "reading an EXR: ./work/merge/plate.exr: damaged or cut short (invalid: reference to missing bytes)",
            "run `insitu run --force --from merge`",
        ),
        case(
            "plate.exr holds NaN",
            &[Exr("work/merge/plate.exr", 640, 480, true)],
            "composite",
            1,
            "reading an EXR: ./work/merge/plate.exr: channel G is NaN at pixel (1, 0)",
            "run `insitu run --force --from merge`",
        ),
        case(
            "plate.exr of another size",
            &[Exr("work/merge/plate.exr", 320, 240, false)],
            "composite",
            1,
            "putting the object into the plate: the removed radiance is 640×480 px, the plate 320×240 px",
            "run `insitu run --from merge` so that all layers belong to the same plate",
        ),
        case(
            "plate.exr of another size in render",
            &[Exr("work/merge/plate.exr", 320, 240, false)],
            "render",
            1,
            "finding the shadow: size of the plate's camera: (640, 480) px, expected (320, 240) px",
            "run `insitu run --force --from illuminate`",
        ),
        case(
            "environment.exr lacks planes",
            &[Exr("work/probe/environment.exr", 64, 32, false)],
            "illuminate",
            1,
            "reading a picture: ./work/probe/environment.exr: lacks planes that it must have",
            "run `insitu run --force --from probe`",
        ),
        case(
            "response does not rise",
            &[Swap("work/response/response.json", "\"exposure\": [", "\"exposure\": [9.0,")],
            "merge",
            1,
            "reading insitu-response: ./work/response/response.json: channel red: 257 levels that do not rise throughout",
            "run `insitu run --force --from response`",
        ),
    ]);
}

#[test]
fn objects_are_checked() {
    check(&[
        case(
            "object missing",
            &[Set(r#"[render]
object = "chair.glb"
"#)],
            "render",
            1,
            "opening an input of stage `render`: ./chair.glb: No such file or directory (os error 2)",
            "check the name and the folder in pipeline.toml",
        ),
        case(
            "object empty",
            &[
                Write("o.obj", ""),
                Set(r#"[render]
object = "o.obj"
"#),
            ],
            "render",
            1,
            "reading the object ./o.obj: the mesh is empty: 0 vertices, 0 triangles, 0 of them without area",
            "export the object as triangles or polygons, with at least one of them",
        ),
        case(
            "only points",
            &[
                Write("o.obj", "v 0 0 0\nv 1 0 0\np 1 2\n"),
                Set(r#"[render]
object = "o.obj"
"#),
            ],
            "render",
            1,
            "reading the object ./o.obj: the mesh is empty: 0 vertices, 0 triangles, 0 of them without area",
            "export the object as triangles or polygons, with at least one of them",
        ),
        case(
            "vertex NaN",
            &[
                Write("o.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
                Set(r#"[render]
object = "o.obj"
"#),
            ],
            "render",
            1,
            "reading the object ./o.obj: vertex 0 lies at (0, 0, NaN)",
            "repair the mesh (Blender: Mesh > Clean Up) and export it again",
        ),
        case(
            "vertex number out of range",
            &[
                Write("o.obj", "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 7\n"),
                Set(r#"[render]
object = "o.obj"
"#),
            ],
            "render",
            1,
            "reading the object: ./o.obj: not a whole OBJ (face vertex index out of bounds)",
            "export the object again as .glb, .gltf, .obj or .ply",
        ),
        case(
            "all triangles degenerate",
            &[
                Write("o.obj", "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 1 2\n"),
                Set(r#"[render]
object = "o.obj"
"#),
            ],
            "render",
            1,
            "reading the object ./o.obj: the mesh is empty: 2 vertices, 1 triangles, 1 of them without area",
            "export the object as triangles or polygons, with at least one of them",
        ),
        case(
            "object of an unknown format",
            &[
                Write("o.stl", "solid\n"),
                Set(r#"[render]
object = "o.stl"
"#),
            ],
            "render",
            1,
            "reading the object: ./o.stl: has the extension `stl`, expected glb, gltf, obj or ply",
            "export the object again as .glb, .gltf, .obj or .ply",
        ),
        case(
            "object is a picture",
            &[
                Copy("photos/plate_000.jpg", "o.glb"),
                Set(r#"[render]
object = "o.glb"
"#),
            ],
            "render",
            1,
            "reading the object: ./o.glb: not a whole glTF (expected value at line 1 column 1)",
            "export the object again as .glb, .gltf, .obj or .ply",
        ),
        case(
            "outside the scene",
            &[Set("[render]\nposition_m = [50, 0, 0]\n")],
            "render",
            1,
            "placing the object in the scene: object outside the scene: along the world's x it spans #..# m, the scene model #..# m",
            "check `render.position_m` (metres in the grid's frame), `render.scale` and `render.y_up`",
        ),
        case(
            "below the floor",
            &[Set("[render]\nposition_m = [0, 0, -3]\n")],
            "render",
            1,
            "placing the object in the scene: object outside the scene: along the world's y it spans #..# m, the scene model #..# m",
            "check `render.position_m` (metres in the grid's frame), `render.scale` and `render.y_up`",
        ),
        case(
            "outside the view",
            &[Set("[render]\nposition_m = [-0.6, -1.4, 0]\n")],
            "render",
            1,
            "placing the object in the scene: object outside the view: it spans x #..# px, y #..# px, the plate is 640×480 px",
            "check `render.position_m` (metres in the grid's frame), `render.scale` and `render.y_up`",
        ),
    ]);
}

#[test]
fn references_are_checked() {
    check(&[
        case(
            "reference missing",
            &[Set(r#"[evaluate]
reference = "truth/none.exr"
"#)],
            "evaluate",
            1,
            "opening an input of stage `evaluate`: ./truth/none.exr: No such file or directory (os error 2)",
            "check the name and the folder in pipeline.toml",
        ),
        case(
            "reference of another size",
            &[
                Exr("small.exr", 320, 240, false),
                Set(r#"[evaluate]
reference = "small.exr"
"#),
            ],
            "evaluate",
            1,
            "comparing with small.exr: the reference is 320×240 px, the plate 640×480 px",
            "give references of the plate's view and size, or none",
        ),
        case(
            "reference holds NaN",
            &[
                Exr("nan.exr", 640, 480, true),
                Set(r#"[evaluate]
reference = "nan.exr"
"#),
            ],
            "evaluate",
            1,
            "reading an EXR: ./nan.exr: channel G is NaN at pixel (1, 0)",
            "repair or leave out the file: every sample must be a finite number",
        ),
        case(
            "mask missing",
            &[Set(r#"[evaluate]
reference_mask = "photos/none.png"
"#)],
            "evaluate",
            1,
            "opening an input of stage `evaluate`: ./photos/none.png: No such file or directory (os error 2)",
            "check the name and the folder in pipeline.toml",
        ),
        case(
            "unknown bound",
            &[Set("[evaluate.bounds]\nrelative_shadw_error = 0.3\n")],
            "evaluate",
            2,
            "`evaluate.bounds` names a figure `relative_shadw_error`, which there is not",
            "did you mean `relative_shadow_error`?",
        ),
        case(
            "negative bound",
            &[Set("[evaluate.bounds]\nrelative_shadow_error = -0.3\n")],
            "evaluate",
            2,
            "`evaluate.bounds.relative_shadow_error` is -0.3, expected a finite number of at least 0",
            "bounds are largest allowed magnitudes",
        ),
        case(
            "truth is not JSON",
            &[Set(r#"[evaluate]
truth = "object.obj"
"#)],
            "evaluate",
            1,
            "reading the truth: ./object.obj: not JSON (expected value at line 1 column 1)",
            "check the file, or leave out the setting",
        ),
        case(
            "truth of something else",
            &[Set(r#"[evaluate]
truth = "work/model/scene.json"
"#)],
            "evaluate",
            1,
            "judging stages against work/model/scene.json: `intrinsics.fx` is missing or not of the expected shape",
            "`evaluate.truth` takes the truth.json of a rendered capture",
        ),
    ]);
}

#[test]
fn the_driver_says_what_cannot_be() {
    check(&[
        case(
            "unknown stage",
            &[],
            "insitu run case.toml --to trasfer",
            2,
            "no stage `trasfer`; the stages are ingest, response, merge, calibrate, probe, model, illuminate, irradiance, transfer, render, composite, evaluate",
            "did you mean `transfer`?",
        ),
        case(
            "from after to",
            &[],
            "insitu run case.toml --from render --to merge",
            2,
            "stage `render` comes after `merge`",
            "exchange --from and --to",
        ),
        case(
            "new on no folder",
            &[],
            "insitu new nowhere",
            1,
            "looking for photographs: nowhere: no such folder",
            "check the name",
        ),
        case(
            "new on an empty folder",
            &[Write("empty/readme.txt", "none\n")],
            "insitu new empty",
            1,
            "listing the photographs: empty: holds no JPEG, PNG, TIFF, HDR or EXR file",
            "put the photographs there, or name their folder with `photos` in [ingest]",
        ),
        case(
            "new over settings",
            &[],
            "insitu new .",
            1,
            "writing new settings: ./pipeline.toml: exists already",
            "edit it, or move it away first: nothing is written over",
        ),
        case(
            "validate without captures",
            &[Write("empty/readme.txt", "none\n")],
            "insitu validate empty",
            2,
            "no pipeline.toml under empty",
            "write one with `insitu new FOLDER`",
        ),
        case(
            "validate no folder",
            &[],
            "insitu validate nowhere",
            1,
            "looking for captures: nowhere: no such folder",
            "check the name",
        ),
        case(
            "earlier stage missing",
            &[Remove("work/response")],
            "insitu run case.toml --from merge --to merge",
            1,
            "merge needs response.json: ./work/response: stage `response` has not finished",
            "run `insitu run --to merge`",
        ),
    ]);
}

#[test]
fn nothing_is_lost_where_nothing_can_be_written() {
    check(&[
        case(
            "work below a file",
            &[Write("case.toml", "extends = \"pipeline.toml\"\nwork = \"object.obj/work\"\n")],
            "ingest",
            1,
            "making the work folder: ./object.obj/work/.ingest.part: Not a directory (os error 20)",
            "choose a writable folder with `work`",
        ),
        case(
            "work is a file",
            &[Write("case.toml", "extends = \"pipeline.toml\"\nwork = \"object.obj\"\n")],
            "ingest",
            1,
            "making the work folder: ./object.obj/.ingest.part: Not a directory (os error 20)",
            "choose a writable folder with `work`",
        ),
    ]);
}

/// Runs a stage that must succeed, with this warning.
fn warned(spoils: &[Spoil], program: &str, warning: &str) {
    let folder = spoilt(spoils);
    let output = run(folder.path(), program);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && text.contains(warning), "{program}: {text}");
}

#[test]
fn what_can_be_done_in_spite_of_a_defect_is_done_with_a_warning() {
    const OBJECT: Spoil =
        Set("[render]\nobject = \"o.obj\"\nantialiasing = 1\nshading_rays = 16\nposition_m = [0.1, 0, 0]\n");
    // Three triangles on one edge, and one turned the other way.
    let fan = "v 0 0 0\nv 0 0 0.1\nv 0.1 0 0\nv 0 0.1 0\nv -0.1 0 0\nf 1 2 3\nf 1 2 4\nf 1 2 5\n";
    warned(
        &[Write("o.obj", fan), OBJECT],
        "render",
        "1 edges join more than two triangles; the mesh is used as it is",
    );
    let sliver = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 3\nf 1 2 4\nf 1 1 2\nf 1 3 4\n";
    warned(&[Write("o.obj", sliver), OBJECT], "render", "1 of 4 triangles have no area and were left out");
    let equal = "[ingest]\nexposure = [{ file = \"brackets_00.jpg\", time_s = 0.1 }, { file = \"brackets_01.jpg\", time_s = 0.1 }]\n";
    warned(
        &[Set(equal)],
        "ingest",
        "brackets_00.jpg and brackets_01.jpg (brackets) have equal exposures: they are averaged",
    );
}

#[test]
fn marks_that_appear_or_go_make_results_stale() {
    let folder = spoilt(&[]);
    let of = |stage: &str| {
        let output = run(folder.path(), "insitu status fast.toml");
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        text.lines().find(|l| l.starts_with(stage)).map(str::to_string).unwrap_or_default()
    };
    assert_eq!(of("calibrate"), "calibrate   fresh");
    Remove("annotations.toml").apply(folder.path());
    assert_eq!(of("calibrate"), "calibrate   stale    annotations.toml cannot be read any more");
    assert!(run(folder.path(), "insitu run fast.toml --from calibrate --to calibrate").status.success());
    assert_eq!(of("calibrate"), "calibrate   fresh");
    Write("annotations.toml", "").apply(folder.path());
    assert_eq!(of("calibrate"), "calibrate   stale    annotations.toml is there now");
}

/// A limit on the size of files stands for a full disk.
#[cfg(unix)]
#[test]
fn a_full_disk_leaves_earlier_results_whole() {
    for (stage, error) in [
        ("merge", "writing: ./work/.merge.part/plate.exr: File too large (os error 27)"),
        ("transfer", "writing: ./work/.transfer.part/sources.npy: File too large (os error 27)"),
        ("irradiance", "writing: ./work/.irradiance.part/irradiance.ply: File too large (os error 27)"),
        ("composite", "writing: ./work/.composite.part/augmented.exr: File too large (os error 27)"),
    ] {
        let folder = spoilt(&[]);
        let before = results(folder.path());
        let program = Path::new(env!("CARGO_BIN_EXE_insitu")).with_file_name(format!("insitu-{stage}"));
        let script = format!("trap '' XFSZ; ulimit -f 8; exec {} fast.toml", program.display());
        let output = Command::new("bash").args(["-c", &script]).current_dir(folder.path()).output();
        let output = output.expect("starting bash");
        assert_eq!(said(&output), [error, "free some disk space, then run again: earlier results are kept"]);
        assert_eq!(output.status.code(), Some(1));
        assert_eq!(results(folder.path()), before, "{stage}");
    }
}

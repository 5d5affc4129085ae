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

fn check(cases: &[Case]) {
    let mut wrong = String::new();
    for case in cases {
        let folder = spoilt(case.spoils);
        let before = results(folder.path());
        let output = run(folder.path(), case.program);
        let [error, hint] = said(&output);
        let code = output.status.code();
        if code != Some(case.code) || error != case.error || hint != case.hint {
            wrong += &format!("@@ {}\ncode {code:?}\nerror {error}\nhint {hint}\n", case.name);
        }
        // A single stage leaves all as it was; `insitu run` may have finished earlier ones.
        if !case.program.starts_with("insitu run") && results(folder.path()) != before {
            wrong += &format!("@@ {}: earlier results changed\n", case.name);
        }
    }
    assert!(wrong.is_empty(), "\n{wrong}");
}

// CASES
#[test]
fn settings_are_shown_with_line_and_column() {
    check(&[
        case("settings file missing", &[], "insitu run nowhere.toml", 2, "", ""),
        case("not TOML", &[Write("case.toml", "[probe\n")], "ingest", 2, "", ""),
        case("not text", &[Copy("photos/plate_000.jpg", "case.toml")], "ingest", 2, "", ""),
        case("unknown key", &[Set("[transfer]\nrays = 4\n  sorce_share = 0.5\n")], "ingest", 2, "", ""),
        case("unknown table", &[Set("[rendre]\nscale = 2\n")], "ingest", 2, "", ""),
        case(
            "unknown role",
            &[Set(r#"[ingest.roles]
plaet = ["plate_000.jpg"]
"#)],
            "ingest",
            2,
            "",
            "",
        ),
        case(
            "wrong type",
            &[Set(r#"[probe]
radius_m = "0.1"
"#)],
            "ingest",
            2,
            "",
            "",
        ),
        case("negative count", &[Set("[render]\nrays = -5\n")], "render", 2, "", ""),
        case(
            "unknown method",
            &[Set(r#"[render]
method = "raytrace"
"#)],
            "render",
            2,
            "",
            "",
        ),
        case("extends nothing", &[Write("case.toml", "extends = \"base.toml\"\n")], "ingest", 2, "", ""),
        case(
            "extends twice",
            &[Set(""), Write("twice.toml", "extends = \"case.toml\"\n")],
            "insitu status twice.toml",
            2,
            "",
            "",
        ),
    ]);
}

#[test]
fn numbers_out_of_range_are_refused() {
    check(&[
        case("negative radius", &[Set("[probe]\nradius_m = -0.1\n")], "probe", 2, "", ""),
        case("radius not a number", &[Set("[probe]\nradius_m = nan\n")], "probe", 2, "", ""),
        case("reflectivity above 1", &[Set("[probe]\nreflectivity = [0.9, 1.2, 0.9]\n")], "probe", 2, "", ""),
        case("no environment", &[Set("[probe]\nwidth_px = 0\n")], "probe", 2, "", ""),
        case("huge environment", &[Set("[probe]\nwidth_px = 1000000000\n")], "probe", 2, "", ""),
        case("negative edge", &[Set("[illuminate]\nmax_edge_m = -1\n")], "illuminate", 2, "", ""),
        case("tiny edge", &[Set("[illuminate]\nmax_edge_m = 1e-9\n")], "illuminate", 2, "", ""),
        case("no share", &[Set("[transfer]\nsource_share = 0\n")], "transfer", 2, "", ""),
        case("share above 1", &[Set("[transfer]\nsource_share = 1.5\n")], "transfer", 2, "", ""),
        case("no rays", &[Set("[transfer]\nrays = 0\n")], "transfer", 2, "", ""),
        case("no irradiance rays", &[Set("[irradiance]\nrays = 0\n")], "irradiance", 2, "", ""),
        case("scale 0", &[Set("[render]\nscale = 0\n")], "render", 2, "", ""),
        case("no antialiasing", &[Set("[render]\nantialiasing = 0\n")], "render", 2, "", ""),
        case("huge shadow map", &[Set("[render]\nshadow_map_px = 10000000\n")], "render", 2, "", ""),
        case("diffuse above 1", &[Set("[render]\ndiffuse = [1.5, 0.5, 0.5]\n")], "render", 2, "", ""),
        case("one inner corner", &[Set("[calibrate]\ninner_corners = [1, 5]\n")], "calibrate", 2, "", ""),
        case(
            "exposure time 0",
            &[Set(r#"[ingest]
exposure = [{ file = "probe_*.jpg", time_s = 0.0 }]
"#)],
            "ingest",
            2,
            "",
            "",
        ),
        case(
            "exposure time negative",
            &[Set(r#"[ingest]
exposure = [{ file = "probe_*.jpg", time_s = -0.1 }]
"#)],
            "ingest",
            2,
            "",
            "",
        ),
        case(
            "base file out of range",
            &[Swap("pipeline.toml", "radius_m = 0.1", "radius_m = 0.0")],
            "probe",
            2,
            "",
            "",
        ),
        case(
            "more diffuse and specular than light",
            &[Set("[render]\ndiffuse = [0.8, 0.8, 0.8]\nspecular = [0.5, 0.5, 0.5]\n")],
            "render",
            2,
            "",
            "",
        ),
        case(
            "nodes without end",
            &[Set("[irradiance]\nspacing_m = 0.01\nreach_m = 100\n")],
            "irradiance",
            1,
            "",
            "",
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
            "",
            "",
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
            "",
            "",
        ),
        case(
            "pattern without a match",
            &[Set(r#"[ingest.roles]
probe = ["prob_*.jpg"]
"#)],
            "ingest",
            1,
            "",
            "",
        ),
        case(
            "file with two roles",
            &[Set(r#"[ingest.roles]
grid = ["calib_*.jpg", "probe_00.jpg"]
"#)],
            "ingest",
            1,
            "",
            "",
        ),
        case("no plate", &[Set("[ingest.roles]\nplate = []\n")], "ingest", 1, "", ""),
        case("photo is text", &[Write("photos/probe_03.jpg", "not a picture\n")], "ingest", 1, "", ""),
        case("photo is empty", &[Write("photos/probe_03.jpg", "")], "ingest", 1, "", ""),
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
            "",
            "",
        ),
        case("exposure time missing", &[Restore("photos/brackets_03.jpg", 640, 480)], "ingest", 1, "", ""),
        case("photo removed after ingest", &[Remove("photos/brackets_03.jpg")], "response", 1, "", ""),
        case(
            "photo changed after ingest",
            &[Restore("photos/brackets_03.jpg", 320, 240)],
            "response",
            1,
            "",
            "",
        ),
        case("JPEG cut short", &[Cut("photos/brackets_03.jpg", 60)], "response", 1, "", ""),
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
            "",
            "",
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
            "",
            "",
        ),
        case("all white", &[Flat("brackets", 255)], "response", 1, "", ""),
        case("all black", &[Flat("brackets", 0)], "response", 1, "", ""),
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
            "",
            "",
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
            "",
            "",
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
            "",
            "",
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
            "",
            "",
        ),
        case(
            "lines in another picture",
            &[Swap("annotations.toml", "image = \"plate_000.jpg\"", "image = \"probe_00.jpg\"")],
            "calibrate",
            1,
            "",
            "",
        ),
        case(
            "lines without origin and scale",
            &[Set(r#"[calibrate]
pose = "vanishing_lines"
"#)],
            "calibrate",
            1,
            "",
            "",
        ),
        case(
            "mark is infinite",
            &[Swap("annotations.toml", "[7.13, 461.75", "[inf, 461.75")],
            "calibrate",
            2,
            "",
            "",
        ),
    ]);
}

#[test]
fn the_ball_must_be_whole_and_where_it_is_said_to_be() {
    check(&[
        case("radius too large", &[Set("[probe]\nradius_m = 0.3\n")], "probe", 1, "", ""),
        case("ball half outside", &[Turn("probe", 18.0)], "probe", 1, "", ""),
        case("ball outside", &[Turn("probe", 26.0)], "probe", 1, "", ""),
        case("support elsewhere", &[Set("[probe]\nsupport_m = 5.0\n")], "probe", 1, "", ""),
        case("probe black", &[Flat("probe", 0)], "probe", 1, "", ""),
        case(
            "no photograph of the ball",
            &[Set(r#"[ingest]
photos = "photos"
[ingest.roles]
probe = []
"#)],
            "insitu run case.toml --to probe",
            1,
            "",
            "",
        ),
    ]);
}

#[test]
fn marks_must_make_sense() {
    check(&[
        case("annotations missing", &[Remove("annotations.toml")], "model", 1, "", ""),
        case("no primitive", &[Write("annotations.toml", "")], "model", 1, "", ""),
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
            "",
            "",
        ),
        case(
            "unknown key in marks",
            &[Swap("annotations.toml", "reflection = true", "reflected = true")],
            "model",
            2,
            "",
            "",
        ),
        case(
            "unknown parent",
            &[Swap("annotations.toml", "parent = \"desk_top\"", "parent = \"desktop\"")],
            "model",
            1,
            "",
            "",
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
            "",
            "",
        ),
        case(
            "two of one name",
            &[Swap("annotations.toml", "name = \"carton\"", "name = \"cabinet\"")],
            "model",
            1,
            "",
            "",
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
            "",
            "",
        ),
        case(
            "reflection beside the ball",
            &[Swap("annotations.toml", "at = [382.5, 249.5]", "at = [20.5, 30.5]")],
            "model",
            1,
            "",
            "",
        ),
        case(
            "contradictory mark",
            &[Swap("annotations.toml", "at = [25.5, 233.5]", "at = [225.5, 33.5]")],
            "model",
            1,
            "",
            "",
        ),
        case(
            "mark is NaN",
            &[Swap("annotations.toml", "at = [25.5, 233.5]", "at = [nan, 33.5]")],
            "model",
            2,
            "",
            "",
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
            "",
            "",
        ),
        case(
            "unknown corner",
            &[Swap("annotations.toml", "corner = \"+++\"", "corner = \"++\"")],
            "model",
            1,
            "",
            "",
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
            "",
            "",
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
            "",
            "",
        ),
    ]);
}

#[test]
fn artefacts_are_refused_with_file_and_cure() {
    check(&[
        case("stage missing", &[Remove("work/model")], "illuminate", 1, "", ""),
        case("stage.json damaged", &[Cut("work/merge/stage.json", 50)], "composite", 1, "", ""),
        case("artefact missing", &[Remove("work/merge/plate.exr")], "composite", 1, "", ""),
        case("scene.json cut short", &[Cut("work/model/scene.json", 50)], "illuminate", 1, "", ""),
        case(
            "another schema version",
            &[Swap("work/calibrate/cameras.json", "\"version\": 1", "\"version\": 99")],
            "transfer",
            1,
            "",
            "",
        ),
        case(
            "another format",
            &[Copy("work/model/scene.json", "work/calibrate/cameras.json")],
            "transfer",
            1,
            "",
            "",
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
            "",
            "",
        ),
        case(
            "impossible lens",
            &[Swap("work/calibrate/cameras.json", "\"width_px\": 640", "\"width_px\": 0")],
            "transfer",
            1,
            "",
            "",
        ),
        case("transfer.npy cut short", &[Cut("work/transfer/transfer.npy", 50)], "render", 1, "", ""),
        case(
            "transfer.npy of another run",
            &[Copy("work/transfer/irradiance.npy", "work/transfer/transfer.npy")],
            "render",
            1,
            "",
            "",
        ),
        case("patches.ply cut short", &[Cut("work/illuminate/patches.ply", 50)], "transfer", 1, "", ""),
        case("irradiance.ply cut short", &[Cut("work/irradiance/irradiance.ply", 50)], "render", 1, "", ""),
        case("plate.exr cut short", &[Cut("work/merge/plate.exr", 50)], "composite", 1, "", ""),
        case("plate.exr holds NaN", &[Exr("work/merge/plate.exr", 640, 480, true)], "composite", 1, "", ""),
        case(
            "plate.exr of another size",
            &[Exr("work/merge/plate.exr", 320, 240, false)],
            "composite",
            1,
            "",
            "",
        ),
        case(
            "plate.exr of another size in render",
            &[Exr("work/merge/plate.exr", 320, 240, false)],
            "render",
            1,
            "",
            "",
        ),
        case(
            "environment.exr lacks planes",
            &[Exr("work/probe/environment.exr", 64, 32, false)],
            "illuminate",
            1,
            "",
            "",
        ),
        case(
            "response does not rise",
            &[Copy("work/ingest/capture.json", "work/response/response.json")],
            "merge",
            1,
            "",
            "",
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
            "",
            "",
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
            "",
            "",
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
            "",
            "",
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
            "",
            "",
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
            "",
            "",
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
            "",
            "",
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
            "",
            "",
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
            "",
            "",
        ),
        case("outside the scene", &[Set("[render]\nposition_m = [50, 0, 0]\n")], "render", 1, "", ""),
        case("below the floor", &[Set("[render]\nposition_m = [0, 0, -3]\n")], "render", 1, "", ""),
        case("outside the view", &[Set("[render]\nposition_m = [-0.6, -1.4, 0]\n")], "render", 1, "", ""),
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
            "",
            "",
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
            "",
            "",
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
            "",
            "",
        ),
        case(
            "mask missing",
            &[Set(r#"[evaluate]
reference_mask = "photos/none.png"
"#)],
            "evaluate",
            1,
            "",
            "",
        ),
        case(
            "unknown bound",
            &[Set("[evaluate.bounds]\nrelative_shadw_error = 0.3\n")],
            "evaluate",
            2,
            "",
            "",
        ),
        case(
            "negative bound",
            &[Set("[evaluate.bounds]\nrelative_shadow_error = -0.3\n")],
            "evaluate",
            2,
            "",
            "",
        ),
        case(
            "truth is not JSON",
            &[Set(r#"[evaluate]
truth = "object.obj"
"#)],
            "evaluate",
            1,
            "",
            "",
        ),
        case(
            "truth of something else",
            &[Set(r#"[evaluate]
truth = "work/model/scene.json"
"#)],
            "evaluate",
            1,
            "",
            "",
        ),
    ]);
}

#[test]
fn the_driver_says_what_cannot_be() {
    check(&[
        case("unknown stage", &[], "insitu run case.toml --to trasfer", 2, "", ""),
        case("from after to", &[], "insitu run case.toml --from render --to merge", 2, "", ""),
        case("new on no folder", &[], "insitu new nowhere", 1, "", ""),
        case("new on an empty folder", &[Write("empty/readme.txt", "none\n")], "insitu new empty", 1, "", ""),
        case("new over settings", &[], "insitu new .", 1, "", ""),
        case(
            "validate without captures",
            &[Write("empty/readme.txt", "none\n")],
            "insitu validate empty",
            2,
            "",
            "",
        ),
        case("validate no folder", &[], "insitu validate nowhere", 1, "", ""),
        case(
            "earlier stage missing",
            &[Remove("work/response")],
            "insitu run case.toml --from merge --to merge",
            1,
            "",
            "",
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
            "",
            "",
        ),
        case(
            "work is a file",
            &[Write("case.toml", "extends = \"pipeline.toml\"\nwork = \"object.obj\"\n")],
            "ingest",
            1,
            "",
            "",
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
    warned(&[Write("o.obj", fan), OBJECT], "render", "");
    let sliver = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 3\nf 1 2 4\nf 1 1 2\nf 1 3 4\n";
    warned(&[Write("o.obj", sliver), OBJECT], "render", "warning: ");
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
        ("transfer", "writing: ./work/.transfer.part/transfer.npy: File too large (os error 27)"),
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

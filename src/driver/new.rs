//! `insitu new`: a commented `pipeline.toml` for a folder of photographs. The worked example is the template; values are
//! taken from the photographs' names and EXIF, and from a `capture.json` where the folder has one.

use crate::config::{Pipeline, Role};
use crate::error::{Error, FileContext, Result};
use crate::exposure::{self, Header};
use crate::printer::Printer;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use toml_edit::{Array, DocumentMut, Item, Value, value};

/// The worked example, which explains every setting.
const EXAMPLE: &str = include_str!("../../pipeline.toml");

/// `capture.json`: what a person knows of a capture besides its photographs.
#[derive(Debug, Clone, Deserialize)]
pub struct CaptureSheet {
    /// The camera.
    pub camera: Option<CameraSheet>,
    /// The printed grid.
    pub board: Option<BoardSheet>,
    /// The mirror ball.
    pub ball: Option<BallSheet>,
    /// Role → file names.
    pub files: BTreeMap<String, Vec<String>>,
    /// Marked vanishing lines.
    pub vanishing_lines: Option<LinesSheet>,
    /// The synthetic object.
    pub object: Option<ObjectSheet>,
}

/// The camera, of a capture sheet.
#[derive(Debug, Clone, Deserialize)]
pub struct CameraSheet {
    /// Width of the sensor, mm.
    pub sensor_width_mm: f64,
}

/// The printed grid, of a capture sheet.
#[derive(Debug, Clone, Deserialize)]
pub struct BoardSheet {
    /// Inner corners along the long and the short side.
    pub inner_corners: [u32; 2],
    /// Side of a square, m.
    pub square_m: f64,
}

/// The mirror ball, of a capture sheet.
#[derive(Debug, Clone, Deserialize)]
pub struct BallSheet {
    /// Radius, m.
    pub radius_m: f64,
    /// Share of light reflected.
    pub reflectivity: f64,
}

/// Marked vanishing lines, of a capture sheet.
#[derive(Debug, Clone, Deserialize)]
pub struct LinesSheet {
    /// Marked image.
    pub image: String,
    /// Lines along the first horizontal direction.
    pub x: Vec<LineSheet>,
    /// Lines along the second horizontal direction.
    pub y: Vec<LineSheet>,
    /// Vertical lines.
    pub z: Vec<LineSheet>,
}

/// One marked line, px.
#[derive(Debug, Clone, Deserialize)]
pub struct LineSheet {
    /// One end.
    pub p0: [f64; 2],
    /// The other end.
    pub p1: [f64; 2],
}

/// The synthetic object, of a capture sheet.
#[derive(Debug, Clone, Deserialize)]
pub struct ObjectSheet {
    /// Mesh file.
    pub mesh: String,
    /// Diffuse reflectance.
    pub diffuse: [f64; 3],
    /// Name → place.
    pub placements_in_board_frame: BTreeMap<String, PlacementSheet>,
}

/// One place of the object, of a capture sheet.
#[derive(Debug, Clone, Deserialize)]
pub struct PlacementSheet {
    /// Origin of the object in the grid's frame, m.
    pub translation: [f64; 3],
    /// Turn about the grid's z axis.
    pub rotation_z_deg: f64,
}

impl CaptureSheet {
    /// Reads a sheet.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).at("reading the capture sheet", path)?;
        serde_json::from_str(&text)
            .map_err(|e| Error::file("reading the capture sheet", path, e, "mend the file, or take it away"))
    }
}

/// Writes `pipeline.toml`, and `annotations.toml` if there is none, into a folder of photographs.
pub fn new(folder: &Path, printer: &Printer) -> Result<()> {
    if !folder.is_dir() {
        return Err(Error::file("looking for photographs", folder, "no such folder", "check the name"));
    }
    let target = folder.join("pipeline.toml");
    if target.exists() {
        return Err(Error::file(
            "writing new settings",
            &target,
            "exists already",
            "edit it, or move it away first: nothing is written over",
        ));
    }
    let sheet_path = folder.join("capture.json");
    let sheet = sheet_path.exists().then(|| CaptureSheet::read(&sheet_path)).transpose()?;
    let (names, unreadable): (Vec<String>, Vec<String>) =
        exposure::list(folder)?.into_iter().partition(|name| exposure::is_readable(name.as_ref()));
    if let Some(raw) = unreadable.first() {
        printer.warn(&format!(
            "{raw} and what else is a camera's RAW file are left out: insitu was built without the feature `raw`"
        ));
    }
    let roles = match &sheet {
        Some(sheet) => roles_of_sheet(sheet),
        None => {
            let mut roles = BTreeMap::<Role, Vec<String>>::new();
            for (role, file) in exposure::derive(&names) {
                roles.entry(role).or_default().push(file);
            }
            roles
        }
    };
    let mut headers = BTreeMap::new();
    for name in &names {
        headers.insert(name.clone(), Header::read(&folder.join(name))?);
    }
    let named = !roles.is_empty();
    let roles = if named { roles } else { guessed(folder, &headers)? };
    let mut document = describe(sheet.as_ref(), &roles, ".")?;
    if sheet.is_none() {
        without_grid(&mut document, &roles);
    }
    open_questions(named, &roles, &headers).iter().for_each(|question| printer.warn(question));
    if !named {
        let list = headers.iter().map(|(name, h)| {
            let time = h.time_s.map_or("no exposure".into(), |t| format!("{t} s"));
            format!("# {name}: {} x {} px, {time}\n", h.width_px, h.height_px)
        });
        let text = format!("\n# Guessed from content and exposures, check:\n{}", list.collect::<String>());
        if let Some(table) = document["ingest"]["roles"].as_table_mut() {
            table.decor_mut().set_prefix(text);
        }
    }
    document.decor_mut().set_prefix(
        "# Settings for these photographs; every key is explained. Check the roles, the grid and the ball, then run\n\
         # `insitu run pipeline.toml`.\n\n",
    );
    std::fs::write(&target, document.to_string()).at("writing new settings", &target)?;
    printer.data(&target.display().to_string());
    let annotations = folder.join("annotations.toml");
    if !annotations.exists() {
        let lines = sheet.as_ref().and_then(|s| s.vanishing_lines.as_ref());
        let text = format!("{ANNOTATIONS_HEAD}\n{}", lines.map(vanishing_lines).unwrap_or_default());
        std::fs::write(&annotations, text).at("writing new annotations", &annotations)?;
        printer.data(&annotations.display().to_string());
    }
    Ok(())
}

/// Roles by what the photographs show.
fn guessed(folder: &Path, headers: &BTreeMap<String, Header>) -> Result<BTreeMap<Role, Vec<String>>> {
    let grid = Pipeline::default().calibrate;
    let look = |(name, header): (&String, &Header)| {
        Ok((name.clone(), exposure::look(&folder.join(name), header.clone(), &grid)?))
    };
    Ok(exposure::guess(&headers.iter().map(look).collect::<Result<_>>()?))
}

/// What keeps these photographs from being used as they are.
fn open_questions(
    named: bool,
    roles: &BTreeMap<Role, Vec<String>>,
    headers: &BTreeMap<String, Header>,
) -> Vec<String> {
    let mut questions = Vec::new();
    if !named {
        questions.push(
            "the names tell no roles: they are guessed from content and exposures, check [ingest.roles]"
                .into(),
        );
    }
    if !roles.contains_key(&Role::Probe) {
        questions.push(
            "no series of exposures of the mirror ball was found: give them, all of one size, the role `probe`".into(),
        );
    }
    // A linear picture is in the plate's units without one, and one photograph alone sets the unit.
    let counted: BTreeSet<&String> = [Role::Plate, Role::Brackets, Role::Probe]
        .iter()
        .filter_map(|role| roles.get(role))
        .flatten()
        .filter(|name| headers.get(*name).is_some_and(|h| !h.linear))
        .collect();
    let unknown = counted.iter().filter(|name| headers.get(**name).is_some_and(|h| h.time_s.is_none()));
    if counted.len() > 1 {
        questions.extend(
            unknown
                .map(|name| format!("{name} has no exposure in its EXIF: write it under [ingest] exposure")),
        );
    }
    questions
}

/// Without photographs of a grid, the plate's place is the probe's and its pose comes from vanishing lines.
fn without_grid(document: &mut DocumentMut, roles: &BTreeMap<Role, Vec<String>>) {
    if [Role::Grid, Role::PlateWithGrid].iter().all(|r| !roles.contains_key(r)) {
        set(document, &["calibrate"], "pose", "vanishing_lines".into());
        set(document, &["calibrate"], "thickness_m", 0.0.into());
        set(document, &["probe"], "camera", "plate".into());
    }
}

const ANNOTATIONS_HEAD: &str = "\
# What a person marks in the photographs, in px from the outer corner of the top-left pixel (the first pixel's centre is
# at 0.5, 0.5). No stage writes this file.
#
# [vanishing_lines]                      # edges along the room's directions; z is up
# image = \"plate.jpg\"
# x = [[x0, y0, x1, y1], ...]
# origin = [x, y]                        # without a printed grid: where the world's origin is seen, and a known length
# scale = { from = [x, y], to = [x, y], axis = \"x\", length_m = 0.5 }
#
# [ball]                                 # where the ball does not stand on the surface under the grid
# image = \"probe.jpg\"
# outline = [[x, y], ...]                # 5 or more points all round
#
# [[primitive]]                          # kind: room, ground, box, wedge, cylinder, extrusion, quad, polygon
# name = \"room\"
# kind = \"room\"
# yaw = \"free\"
# marks = [{ corner = \"---\", image = \"plate.jpg\", at = [12.0, 34.0] }]   # corner: signs of x, y (up), z
";

/// `[vanishing_lines]` of `annotations.toml` from a capture sheet.
pub fn vanishing_lines(lines: &LinesSheet) -> String {
    let axis = |lines: &[LineSheet]| {
        let rows: Vec<_> = lines
            .iter()
            .map(|l| format!("    [{}, {}, {}, {}],\n", l.p0[0], l.p0[1], l.p1[0], l.p1[1]))
            .collect();
        format!("[\n{}]", rows.concat())
    };
    format!(
        "[vanishing_lines]\nimage = \"{}\"\nx = {}\ny = {}\nz = {}\n",
        lines.image,
        axis(&lines.x),
        axis(&lines.y),
        axis(&lines.z)
    )
}

/// Roles by a capture sheet's own names.
pub fn roles_of_sheet(sheet: &CaptureSheet) -> BTreeMap<Role, Vec<String>> {
    let role = |name: &str| match name {
        "plate" => Some(Role::Plate),
        "brackets" => Some(Role::Brackets),
        "grid_with_probe" | "plate_with_grid" => Some(Role::PlateWithGrid),
        "probe" => Some(Role::Probe),
        "calib" | "grid" => Some(Role::Grid),
        "flat" => Some(Role::Flat),
        "frames" => Some(Role::Frames),
        _ => None,
    };
    sheet.files.iter().filter_map(|(name, files)| Some((role(name)?, files.clone()))).collect()
}

/// The worked example with the values of another capture; `photos` as it shall stand in the file.
pub fn describe(
    sheet: Option<&CaptureSheet>,
    roles: &BTreeMap<Role, Vec<String>>,
    photos: &str,
) -> Result<DocumentMut> {
    let mut document: DocumentMut =
        EXAMPLE.parse().map_err(|e| Error::Bug(format!("the worked example: {e}")))?;
    let defaults = Pipeline::default();
    set(&mut document, &[], "annotations", "annotations.toml".into());
    set(&mut document, &["ingest"], "photos", photos.into());
    if let Some(table) = document["ingest"]["roles"].as_table_mut() {
        table.clear();
        for (role, files) in roles {
            table[exposure::role_name(*role).as_str()] = value(files.iter().collect::<Array>());
        }
    }
    if !roles.contains_key(&Role::Brackets) {
        set(&mut document, &["response"], "role", "probe".into());
    }
    let camera = sheet.and_then(|s| s.camera.as_ref());
    match camera {
        Some(camera) => set(&mut document, &["ingest"], "sensor_width_mm", camera.sensor_width_mm.into()),
        None => drop(document["ingest"].as_table_mut().map(|t| t.remove("sensor_width_mm"))),
    }
    if let Some(board) = sheet.and_then(|s| s.board.as_ref()) {
        let corners = board.inner_corners.iter().map(|c| i64::from(*c)).collect::<Array>();
        set(&mut document, &["calibrate"], "inner_corners", corners.into());
        set(&mut document, &["calibrate"], "square_m", board.square_m.into());
    }
    if let Some(ball) = sheet.and_then(|s| s.ball.as_ref()) {
        set(&mut document, &["probe"], "radius_m", ball.radius_m.into());
        set(
            &mut document,
            &["probe"],
            "reflectivity",
            [ball.reflectivity; 3].into_iter().collect::<Array>().into(),
        );
    }
    let object = sheet.and_then(|s| s.object.as_ref());
    let mesh = object.map_or("object.obj", |o| o.mesh.as_str());
    set(&mut document, &["render"], "object", mesh.into());
    let diffuse = object.map_or(defaults.render.diffuse.map(f64::from), |o| o.diffuse);
    set(&mut document, &["render"], "diffuse", diffuse.into_iter().collect::<Array>().into());
    let placement = object.and_then(|o| o.placements_in_board_frame.values().next());
    let position = placement.map_or(defaults.render.position_m, |p| p.translation);
    set(&mut document, &["render"], "position_m", position.into_iter().collect::<Array>().into());
    set(&mut document, &["render"], "rotation_deg", placement.map_or(0.0, |p| p.rotation_z_deg).into());
    if let Some(evaluate) = document["evaluate"].as_table_mut() {
        for key in ["reference", "reference_empty", "reference_mask", "truth", "bounds"] {
            evaluate.remove(key);
        }
    }
    Ok(document)
}

/// Sets a value and keeps the comments around it.
pub fn set(document: &mut DocumentMut, tables: &[&str], key: &str, mut new: Value) {
    let mut item = document.as_item_mut();
    for table in tables {
        item = &mut item[*table];
    }
    if let Some(old) = item.get(key).and_then(Item::as_value) {
        *new.decor_mut() = old.decor().clone();
    }
    item[key] = Item::Value(new);
}

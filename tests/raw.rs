//! Camera RAW: `cargo test --release --features raw --test raw`. The files are DNGs that the test writes.

use insitu::artefact::exr;
use insitu::exposure::{Header, decode};
use insitu::response::Response;
use std::path::Path;

/// Size, px; a patch of the scene is 16 px wide.
const SIZE: [usize; 2] = [160, 96];
const PATCH: usize = 16;
const BLACK: f64 = 512.0;
const WHITE: f64 = 15_300.0;
/// XYZ (D65) to camera, as makers of converters have measured it for a common camera, in 1/10,000.
const CAMERA_FROM_XYZ: [i32; 9] = [6347, -479, -972, -8297, 15_954, 2480, -1968, 2131, 7649];
const XYZ_FROM_REC709: [[f64; 3]; 3] =
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]];

/// Linear Rec. 709 radiance of the scene, in units in which exposure 1 saturates the camera's green in white.
fn scene(x: usize, y: usize) -> [f64; 3] {
    let (i, j) = (x / PATCH, y / PATCH);
    let bright = 0.004 * 2.0_f64.powf((i + 10 * j) as f64 * 0.17);
    let tints = [[1.0, 1.0, 1.0], [1.0, 0.7, 0.5], [0.6, 0.8, 1.0], [0.7, 1.0, 0.6]];
    tints[(i + j) % 4].map(|t| t * bright)
}

/// What the camera's channels gather for radiance 1 in white, and for a radiance.
fn camera(rgb: [f64; 3]) -> [f64; 3] {
    let xyz = XYZ_FROM_REC709.map(|row| (0..3).map(|k| row[k] * rgb[k]).sum::<f64>());
    std::array::from_fn(|i| (0..3).map(|k| f64::from(CAMERA_FROM_XYZ[3 * i + k]) / 10_000.0 * xyz[k]).sum())
}

/// A DNG of RGGB readings of 16 bits without compression.
fn write_dng(path: &Path, exposure: f64) {
    let most = camera([1.0; 3]).into_iter().fold(0.0, f64::max);
    let mut strip = Vec::new();
    for (y, x) in (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| (y, x))) {
        let channel = x % 2 + y % 2;
        let reading = BLACK + (WHITE - BLACK) * camera(scene(x, y))[channel] / most * exposure;
        strip.extend((reading.round().min(WHITE) as u16).to_le_bytes());
    }
    let shorts = |v: &[u16]| (3_u16, v.len(), v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>());
    let long = |v: usize| (4_u16, 1, (v as u32).to_le_bytes().to_vec());
    let text = |t: &str| (2_u16, t.len() + 1, [t.as_bytes(), &[0]].concat());
    let bytes = |b: &[u8]| (1_u16, b.len(), b.to_vec());
    let rationals = |kind: u16, v: &[(i32, i32)]| {
        (
            kind,
            v.len(),
            v.iter().flat_map(|(n, d)| [n.to_le_bytes(), d.to_le_bytes()].concat()).collect::<Vec<u8>>(),
        )
    };
    let matrix: Vec<(i32, i32)> = CAMERA_FROM_XYZ.iter().map(|n| (*n, 10_000)).collect();
    let exif_at = 8 + strip.len();
    let exif = vec![
        (33_434, rationals(5, &[((exposure * 1000.0).round() as i32, 100_000)])),
        (33_437, rationals(5, &[(8, 1)])),
        (34_855, shorts(&[100])),
    ];
    let exif = directory(&exif, exif_at);
    let main_at = exif_at + exif.len();
    let main = vec![
        (254, long(0)),
        (256, long(SIZE[0])),
        (257, long(SIZE[1])),
        (258, shorts(&[16])),
        (259, shorts(&[1])),
        (262, shorts(&[32_803])),
        (271, text("Maker")),
        (272, text("Camera")),
        (273, long(8)),
        (274, shorts(&[1])),
        (277, shorts(&[1])),
        (278, long(SIZE[1])),
        (279, long(strip.len())),
        (33_421, shorts(&[2, 2])),
        (33_422, bytes(&[0, 1, 1, 2])),
        (34_665, long(exif_at)),
        (50_706, bytes(&[1, 4, 0, 0])),
        (50_708, text("Maker Camera")),
        (50_713, shorts(&[1, 1])),
        (50_714, shorts(&[BLACK as u16])),
        (50_717, long(WHITE as usize)),
        (50_721, rationals(10, &matrix)),
        // A warm white balance, which must make no difference.
        (50_728, rationals(5, &[(7, 10), (1, 1), (5, 10)])),
        (50_778, shorts(&[21])),
    ];
    let header = [b"II*\0".as_slice(), &(main_at as u32).to_le_bytes()].concat();
    std::fs::write(path, [header, strip, exif, directory(&main, main_at)].concat()).unwrap();
}

type Value = (u16, usize, Vec<u8>);

/// An image file directory at an offset, with what does not fit into its entries behind it.
fn directory(entries: &[(u16, Value)], at: usize) -> Vec<u8> {
    let mut table = (entries.len() as u16).to_le_bytes().to_vec();
    let mut rest = Vec::new();
    let rest_at = at + 2 + 12 * entries.len() + 4;
    for (tag, (kind, count, value)) in entries {
        table.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
        table.extend((*count as u32).to_le_bytes());
        if value.len() <= 4 {
            table.extend(value.iter().chain(&[0; 4]).take(4));
        } else {
            table.extend(((rest_at + rest.len()) as u32).to_le_bytes());
            rest.extend(value);
            rest.extend(vec![0; value.len() % 2]);
        }
    }
    table.extend([0; 4]);
    [table, rest].concat()
}

/// Pixels in the middle of patches, where colours are not interpolated across a border.
fn middles() -> impl Iterator<Item = (usize, usize)> {
    let middle = |v: &usize| (5..11).contains(&(v % PATCH));
    (0..SIZE[1]).filter(middle).flat_map(move |y| (0..SIZE[0]).filter(middle).map(move |x| (x, y)))
}

#[test]
fn a_raw_file_is_linear_rec709_and_saturates_in_all_channels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a 1.DNG");
    write_dng(&path, 1.0);
    let header = Header::read(&path).unwrap();
    assert_eq!((header.width_px, header.height_px, header.raw, header.linear), (160, 96, true, false));
    assert_eq!((header.time_s, header.f_number, header.iso), (Some(0.01), Some(8.0), Some(100.0)));
    assert_eq!(header.camera.as_deref(), Some("Maker Camera"));
    let codes = decode(&path).unwrap().codes(&path).unwrap();
    let most = camera([1.0; 3]).into_iter().fold(0.0, f64::max);
    let (mut checked, mut saturated) = (0, 0);
    for (x, y) in middles() {
        let (truth, seen) = (scene(x, y), codes.at(x, y).0);
        if camera(truth).iter().any(|v| *v >= most) {
            assert_eq!(seen, [1.0; 3], "{x} {y}");
            saturated += 1;
            continue;
        }
        // In the dark a step of the sensor's readings is more than that.
        let linear = Response::of_raw().exposure_of(seen);
        for k in (0..3).filter(|k| truth.iter().all(|t| *t > 0.02) && truth[*k] < 0.99) {
            assert!((f64::from(linear[k]) / truth[k] - 1.0).abs() < 0.01, "{x} {y} {linear:?} {truth:?}");
            checked += 1;
        }
    }
    assert!(checked > 2000 && saturated > 100, "{checked} {saturated}");
}

fn insitu(stage: &str, settings: &Path) -> (bool, String) {
    let program = Path::new(env!("CARGO_BIN_EXE_insitu")).with_file_name(format!("insitu-{stage}"));
    let output = std::process::Command::new(program).arg(settings).output().unwrap();
    (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn raw_exposures_merge_to_radiance_and_do_not_mix_with_others() {
    let folder = tempfile::tempdir().unwrap();
    let settings = folder.path().join("pipeline.toml");
    for (i, exposure) in [0.125, 0.5, 2.0, 8.0].into_iter().enumerate() {
        write_dng(&folder.path().join(format!("brackets_{i}.dng")), exposure);
    }
    let roles = "plate = [\"brackets_1.dng\"]\nbrackets = [\"brackets_*.dng\"]\n";
    std::fs::write(&settings, format!("[ingest]\nphotos = \".\"\n[ingest.roles]\n{roles}")).unwrap();
    for stage in ["ingest", "response", "merge"] {
        let (fine, told) = insitu(stage, &settings);
        assert!(fine, "{told}");
    }
    let merged = exr::read_radiance(&folder.path().join("work/merge/plate.exr")).unwrap();
    let worst = middles().flat_map(|(x, y)| {
        // The plate's exposure is the unit.
        (0..3).map(move |k| (x, y, k))
    });
    let worst = worst.map(|(x, y, k)| (f64::from(merged.at(x, y).0[k]) / (0.5 * scene(x, y)[k]) - 1.0).abs());
    let worst = worst.fold(0.0, f64::max);
    assert!(worst < 0.02, "{worst}");

    image::RgbImage::new(160, 96).save(folder.path().join("brackets_9.png")).unwrap();
    let mixed = "plate = [\"brackets_1.dng\"]\nbrackets = [\"brackets_*\"]\n";
    let stated = "exposure = [{ file = \"*.png\", time_s = 1.0, f_number = 8.0, iso = 100.0 }]";
    std::fs::write(&settings, format!("[ingest]\nphotos = \".\"\n{stated}\n[ingest.roles]\n{mixed}"))
        .unwrap();
    let (fine, told) = insitu("ingest", &settings);
    assert!(!fine && told.contains("is a camera's RAW file, brackets_9.png is none"), "{told}");
}

#[test]
fn a_damaged_raw_file_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("a.dng");
    write_dng(&whole, 1.0);
    let bytes = std::fs::read(&whole).unwrap();
    for (name, keep) in [("empty.dng", 0), ("start.dng", 100), ("half.dng", bytes.len() / 2)] {
        let path = folder.path().join(name);
        std::fs::write(&path, &bytes[..keep]).unwrap();
        let message = decode(&path).unwrap_err().to_string();
        assert!(message.contains(name), "{message}");
    }
}

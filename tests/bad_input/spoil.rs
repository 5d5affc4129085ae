//! Ways to spoil a prepared capture. Files are links to the prepared ones, so each is taken away before it is written.

use image::{ImageFormat, Rgb, RgbImage};
use std::path::{Path, PathBuf};

/// One way.
#[derive(Clone, Copy)]
pub enum Spoil {
    /// Settings over those of the capture, as `case.toml`.
    Set(&'static str),
    /// A new file.
    Write(&'static str, &'static str),
    /// A file or folder less.
    Remove(&'static str),
    /// The first bytes of a file alone, per cent.
    Cut(&'static str, usize),
    /// One text for another.
    Swap(&'static str, &'static str, &'static str),
    /// One file in the place of another.
    Copy(&'static str, &'static str),
    /// Photographs whose name starts so, all of one code, EXIF kept.
    Flat(&'static str, u8),
    /// The same stored anew, without EXIF, of another size.
    Restore(&'static str, u32, u32),
    /// The profile of Adobe RGB embedded in a JPEG.
    Profile(&'static str),
    /// The camera turned to the left by so many degrees, exactly (a homography).
    Turn(&'static str, f64),
    /// All patches of the light model of one radiance.
    EvenLight,
    /// An EXR picture of this size, with NaN at (1, 0) if so said.
    Exr(&'static str, usize, usize, bool),
}

impl Spoil {
    pub fn apply(&self, folder: &Path) {
        match *self {
            Self::Set(text) => {
                write(folder.join("case.toml"), format!("extends = \"pipeline.toml\"\n{text}"))
            }
            Self::Write(file, text) => write(folder.join(file), text),
            Self::Remove(file) => remove(&folder.join(file)),
            Self::Cut(file, per_cent) => {
                let bytes = read(&folder.join(file));
                write(folder.join(file), &bytes[..bytes.len() * per_cent / 100]);
            }
            Self::Swap(file, old, new) => {
                let text = String::from_utf8(read(&folder.join(file))).expect("text");
                assert!(text.contains(old), "{file} has no {old:?}");
                write(folder.join(file), text.replacen(old, new, 1));
            }
            Self::Copy(from, to) => write(folder.join(to), read(&folder.join(from))),
            Self::Flat(start, code) => {
                redraw(folder, start, |old| RgbImage::from_pixel(old.width(), old.height(), Rgb([code; 3])))
            }
            Self::Restore(file, width, height) => {
                let image = image::open(folder.join(file)).expect("a photograph").into_rgb8();
                let image = image::imageops::crop_imm(&image, 0, 0, width, height).to_image();
                write(folder.join(file), jpeg(&image));
            }
            Self::Profile(file) => {
                let old = read(&folder.join(file));
                write(folder.join(file), [&old[..2], &adobe_rgb(), &old[2..]].concat());
            }
            Self::Turn(start, degrees) => redraw(folder, start, |old| turned(old, degrees.to_radians())),
            Self::EvenLight => {
                let illuminate = folder.join("work/illuminate");
                let mut light = insitu::illuminate::read_light(&illuminate).expect("a light model");
                light.mesh.patches.iter_mut().for_each(|p| p.radiance = [0.5; 3]);
                ["patches.ply", "distant.json"].iter().for_each(|f| remove(&illuminate.join(f)));
                insitu::illuminate::write_light(&illuminate, &light).expect("writing a light model");
            }
            Self::Exr(file, width, height, nan) => {
                use insitu::image::{Image, Radiance};
                let mut image = Image::from_pixels(width, height, vec![Radiance([0.5; 3]); width * height]);
                if nan {
                    image.at_mut(1, 0).0[1] = f32::NAN;
                }
                remove(&folder.join(file));
                insitu::artefact::exr::write_radiance(&folder.join(file), &image).expect("writing an EXR");
            }
        }
    }
}

fn read(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn write(path: PathBuf, content: impl AsRef<[u8]>) {
    remove(&path);
    std::fs::create_dir_all(path.parent().expect("a folder")).expect("making a folder");
    std::fs::write(path, content).expect("writing");
}

fn remove(path: &Path) {
    if path.is_dir() {
        std::fs::remove_dir_all(path).expect("removing a folder");
    } else if path.exists() {
        std::fs::remove_file(path).expect("removing a file");
    }
}

fn jpeg(image: &RgbImage) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Jpeg).expect("encoding a JPEG");
    bytes.into_inner()
}

/// Draws photographs anew and keeps their EXIF.
fn redraw(folder: &Path, start: &str, draw: impl Fn(&RgbImage) -> RgbImage) {
    for entry in std::fs::read_dir(folder.join("photos")).expect("photos").flatten() {
        if entry.file_name().to_string_lossy().starts_with(start) {
            let old = read(&entry.path());
            let new = jpeg(&draw(&image::load_from_memory(&old).expect("a photograph").into_rgb8()));
            // Start of image, then the old EXIF segment, then the rest.
            write(entry.path(), [&new[..2], exif(&old), &new[2..]].concat());
        }
    }
}

/// The APP1 segment.
fn exif(jpeg: &[u8]) -> &[u8] {
    let mut at = 2;
    while jpeg[at] == 0xFF {
        let end = at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        if jpeg[at + 1] == 0xE1 {
            return &jpeg[at..end];
        }
        at = end;
    }
    panic!("no EXIF")
}

/// The APP2 segment with a profile (ICC.1:2022) of nothing but its primaries.
fn adobe_rgb() -> Vec<u8> {
    let primaries = [
        (b"rXYZ", [0.6097, 0.3111, 0.0195]),
        (b"gXYZ", [0.2053, 0.6257, 0.0609]),
        (b"bXYZ", [0.1492, 0.0632, 0.7446]),
    ];
    let (start, tags, each) = (128, 4 + 12 * primaries.len() as u32, 20_u32);
    let mut icc = vec![0; start];
    icc[16..20].copy_from_slice(b"RGB ");
    icc.extend((primaries.len() as u32).to_be_bytes());
    for (i, (name, _)) in (0..).zip(&primaries) {
        icc.extend(*name);
        icc.extend((start as u32 + tags + each * i).to_be_bytes());
        icc.extend(each.to_be_bytes());
    }
    for (_, colour) in primaries {
        icc.extend(b"XYZ \0\0\0\0");
        colour.iter().for_each(|v: &f64| icc.extend(((v * 65536.0) as i32).to_be_bytes()));
    }
    // The first of one segment.
    let content = [b"ICC_PROFILE\0\x01\x01", &icc[..]].concat();
    [&[0xFF, 0xE2][..], &(content.len() as u16 + 2).to_be_bytes(), &content].concat()
}

/// What the office's camera (f = 593.6 px, centred) sees after a turn to the left.
fn turned(old: &RgbImage, angle: f64) -> RgbImage {
    let (f, cx, cy) = (593.6, 320.0, 240.0);
    RgbImage::from_fn(old.width(), old.height(), |x, y| {
        let (u, v) = ((f64::from(x) + 0.5 - cx) / f, (f64::from(y) + 0.5 - cy) / f);
        let (dx, dz) = (u * angle.cos() - angle.sin(), u * angle.sin() + angle.cos());
        let (px, py) = (f * dx / dz + cx - 0.5, f * v / dz + cy - 0.5);
        // Beyond the border its last pixels are repeated.
        let clamped = |v: f64, n: u32| v.clamp(0.0, f64::from(n - 1)).round() as u32;
        *old.get_pixel(clamped(px, old.width()), clamped(py, old.height()))
    })
}

use super::*;
use crate::exposure::header_digest;
use image::{DynamicImage, ImageBuffer, Luma, Rgb, Rgba};
use std::path::PathBuf;

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn save(&self, name: &str, image: impl Into<DynamicImage>) -> PathBuf {
        let path = self.0.path().join(name);
        image.into().save(&path).unwrap();
        path
    }

    fn cut(&self, path: &Path, name: &str, keep: f64) -> PathBuf {
        let bytes = std::fs::read(path).unwrap();
        let cut = self.0.path().join(name);
        std::fs::write(&cut, &bytes[..(bytes.len() as f64 * keep) as usize]).unwrap();
        cut
    }
}

fn gradient() -> ImageBuffer<Rgb<u8>, Vec<u8>> {
    ImageBuffer::from_fn(48, 32, |x, y| Rgb([x as u8 * 5, y as u8 * 7, 90]))
}

fn codes(path: &Path) -> crate::image::CodeImage {
    decode(path).unwrap().codes(path).unwrap()
}

/// EXIF of a little-endian TIFF header with exposure time 1/50 s and an orientation.
fn exif(orientation: u16) -> Vec<u8> {
    let mut exif = b"Exif\0\0II*\0\x08\0\0\0\x02\0".to_vec();
    exif.extend([0x12, 0x01, 3, 0, 1, 0, 0, 0, orientation as u8, 0, 0, 0]); // Orientation, SHORT
    exif.extend([0x69, 0x87, 4, 0, 1, 0, 0, 0, 38, 0, 0, 0, 0, 0, 0, 0]); // Exif IFD at 38
    exif.extend([1, 0, 0x9A, 0x82, 5, 0, 1, 0, 0, 0, 56, 0, 0, 0, 0, 0, 0, 0]); // ExposureTime, RATIONAL at 56
    exif.extend([1, 0, 0, 0, 50, 0, 0, 0]);
    exif
}

fn with_exif(jpeg: &[u8], exif: &[u8]) -> Vec<u8> {
    let length = (exif.len() as u16 + 2).to_be_bytes();
    [&jpeg[..2], &[0xFF, 0xE1], &length, exif, &jpeg[2..]].concat()
}

#[test]
fn an_embedded_profile_is_told_whatever_the_name_of_the_file() {
    use super::super::profile::tests::profile;
    use image::{ExtendedColorType, ImageEncoder, codecs};
    let folder = Folder::new();
    let p3 = [[0.5151, 0.2412, -0.0011], [0.2920, 0.6922, 0.0419], [0.1571, 0.0666, 0.7841]];
    for name in ["ein Bild.jpg", "画像 1.png"] {
        let path = folder.0.path().join(name);
        let file = std::fs::File::create(&path).unwrap();
        let (pixels, size) = (gradient(), gradient().dimensions());
        if name.ends_with("jpg") {
            let mut encoder = codecs::jpeg::JpegEncoder::new(file);
            encoder.set_icc_profile(profile(&p3)).unwrap();
            encoder.write_image(&pixels, size.0, size.1, ExtendedColorType::Rgb8).unwrap();
        } else {
            let mut encoder = codecs::png::PngEncoder::new(file);
            encoder.set_icc_profile(profile(&p3)).unwrap();
            encoder.write_image(&pixels, size.0, size.1, ExtendedColorType::Rgb8).unwrap();
        }
        assert_eq!(Header::read(&path).unwrap().profile.as_deref(), Some("Display P3"), "{name}");
    }
    let plain = folder.save("plain.png", gradient());
    assert_eq!(Header::read(&plain).unwrap().profile, None);
}

#[test]
fn stored_codes_are_the_codes_and_a_linear_picture_has_none() {
    let folder = Folder::new();
    let path = folder.save("a.png", gradient());
    let stored = decode_stored(&path).unwrap();
    assert_eq!(stored.rows(0..32).unwrap(), codes(&path));
    let linear = ImageBuffer::from_fn(4, 4, |x, _| Rgb([x as f32, 1.0, 2.0]));
    let path = folder.save("a.hdr", linear);
    assert!(decode_stored(&path).unwrap_err().to_string().contains("holds linear radiance"));
}

#[test]
fn eight_and_sixteen_bits_keep_their_codes() {
    let folder = Folder::new();
    let eight = codes(&folder.save("a.png", gradient()));
    assert_eq!(eight.at(3, 2).0, [15.0 / 255.0, 14.0 / 255.0, 90.0 / 255.0]);
    let deep = ImageBuffer::from_fn(4, 4, |x, y| Rgb([x as u16 * 10_000, y as u16, 65_535]));
    for name in ["a16.png", "a16.tif"] {
        let sixteen = codes(&folder.save(name, deep.clone()));
        assert_eq!(sixteen.at(3, 2).0, [30_000.0 / 65_535.0, 2.0 / 65_535.0, 1.0], "{name}");
    }
}

#[test]
fn grey_is_equal_in_all_channels() {
    let grey = ImageBuffer::from_fn(4, 4, |x, _| Luma([x as u8 * 60]));
    assert_eq!(codes(&Folder::new().save("g.png", grey)).at(2, 0).0, [120.0 / 255.0; 3]);
}

#[test]
fn alpha_goes_only_where_it_is_opaque() {
    let folder = Folder::new();
    let opaque = ImageBuffer::from_pixel(4, 4, Rgba([10_u8, 20, 30, 255]));
    assert_eq!(codes(&folder.save("o.png", opaque.clone())).at(0, 0).0[0], 10.0 / 255.0);
    let mut holed = opaque;
    holed.put_pixel(1, 1, Rgba([10, 20, 30, 254]));
    let message = decode(&folder.save("h.png", holed)).unwrap_err().to_string();
    assert!(message.contains("1 of 16 pixels are transparent"), "{message}");
}

#[test]
fn orientation_and_time_come_from_exif() {
    let folder = Folder::new();
    let upright = folder.save("u.jpg", gradient());
    let turned = folder.0.path().join("t.jpg");
    std::fs::write(&turned, with_exif(&std::fs::read(&upright).unwrap(), &exif(6))).unwrap();
    let header = Header::read(&turned).unwrap();
    assert_eq!((header.orientation, header.time_s, header.upright_size()), (6, Some(0.02), (32, 48)));
    // Orientation 6: the stored image is turned by 90° clockwise to stand upright.
    let (stored, shown) = (codes(&upright), codes(&turned));
    assert_eq!(shown.size(), (32, 48));
    assert_eq!(shown.at(31, 0), stored.at(0, 0));
    assert_eq!(shown.at(31 - 5, 7), stored.at(7, 5));
}

#[test]
fn the_header_digest_is_blind_to_pixels_and_sees_exif() {
    let folder = Folder::new();
    let (a, b) = (folder.save("a.jpg", gradient()), folder.0.path().join("b.jpg"));
    let mut other = gradient();
    other.put_pixel(0, 0, Rgb([255, 0, 0]));
    assert_eq!(header_digest(&a).unwrap(), header_digest(&folder.save("c.jpg", other)).unwrap());
    std::fs::write(&b, with_exif(&std::fs::read(&a).unwrap(), &exif(1))).unwrap();
    assert_ne!(header_digest(&a).unwrap(), header_digest(&b).unwrap());
}

#[test]
fn files_cut_short_are_refused_by_name() {
    let folder = Folder::new();
    for (name, expected) in [("a.jpg", "truncated JPEG"), ("a.png", "cut short"), ("a.tif", "cut short")] {
        let whole = folder.save(name, gradient());
        for keep in [0.5, 0.9] {
            let cut = folder.cut(&whole, &format!("cut_{name}"), keep);
            let message = decode(&cut).unwrap_err().to_string();
            assert!(
                message.contains(&format!("cut_{name}"))
                    && message.contains("cut short") | message.contains(expected),
                "{message}"
            );
        }
    }
    let empty = folder.0.path().join("empty.jpg");
    std::fs::write(&empty, b"").unwrap();
    assert!(decode(&empty).unwrap_err().to_string().contains("is not a JPEG, PNG"));
    let message = decode(&folder.0.path().join("none.jpg")).unwrap_err().to_string();
    assert!(message.contains("none.jpg"), "{message}");
}

#[test]
fn the_marker_of_a_thumbnail_does_not_make_a_jpeg_whole() {
    let folder = Folder::new();
    let bytes = std::fs::read(folder.save("a.jpg", gradient())).unwrap();
    let path = folder.0.path().join("t.jpg");
    let thumbnail = [exif(1).as_slice(), &bytes].concat();
    let whole = with_exif(&bytes, &thumbnail);
    std::fs::write(&path, &whole[..whole.len() - 30]).unwrap();
    assert!(decode(&path).unwrap_err().to_string().contains("truncated JPEG"));
    std::fs::write(&path, [whole.as_slice(), b"what some phones append"].concat()).unwrap();
    assert_eq!(codes(&path).size(), (48, 32));
}

#[test]
fn linear_pictures_are_told_from_codes() {
    let folder = Folder::new();
    let bright = ImageBuffer::from_fn(8, 8, |x, y| Rgb([x as f32, y as f32, 100.0]));
    let hdr = folder.save("a.hdr", DynamicImage::ImageRgb32F(bright));
    let exr = folder.0.path().join("a.exr");
    let picture = crate::image::RadianceImage::from_fn(8, 8, |x, y| Radiance([x as f32, y as f32, 100.0]));
    crate::artefact::exr::write_radiance(&exr, &picture).unwrap();
    for path in [&hdr, &exr] {
        let header = Header::read(path).unwrap();
        assert!(header.linear && header.upright_size() == (8, 8));
        let Photograph::Linear(image) = decode(path).unwrap() else { panic!("{path:?} is linear") };
        assert!((image.at(5, 3).0[0] - 5.0).abs() < 0.5 && (image.at(5, 3).0[2] - 100.0).abs() < 1.0);
        let message = decode(path).unwrap().codes(path).unwrap_err().to_string();
        assert!(message.contains("holds linear radiance, not the codes of a camera"), "{message}");
    }
    let cut = folder.cut(&hdr, "cut.hdr", 0.7);
    assert!(decode(&cut).unwrap_err().to_string().contains("cut.hdr"));
}

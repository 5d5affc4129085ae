//! Sparse models of COLMAP (Schönberger and Frahm 2016): `cameras` and `images`, as text or binary. Pixels count as ours do, from the
//! outer corner of the top-left one; camera frames are ours, too.

use super::{Posed, Problem, posed};
use crate::calibrate::world_from_grid;
use crate::camera::Intrinsics;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Names of lens models by their numbers, with the count of their parameters.
const MODELS: [(&str, usize); 11] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
];

/// The lens of a model and its parameters.
fn lens(camera: u32, model: &str, [width_px, height_px]: [u32; 2], p: &[f64]) -> Result<Intrinsics, Problem> {
    let unknown = || Problem::Model { camera, model: model.to_string() };
    let (focal_px, centre, distortion) = match (model, p) {
        ("SIMPLE_PINHOLE", &[f, x, y]) => ([f; 2], [x, y], [0.0; 5]),
        ("PINHOLE", &[f, g, x, y]) => ([f, g], [x, y], [0.0; 5]),
        ("SIMPLE_RADIAL", &[f, x, y, k]) => ([f; 2], [x, y], [k, 0.0, 0.0, 0.0, 0.0]),
        ("RADIAL", &[f, x, y, k1, k2]) => ([f; 2], [x, y], [k1, k2, 0.0, 0.0, 0.0]),
        ("OPENCV", &[f, g, x, y, k1, k2, p1, p2]) => ([f, g], [x, y], [k1, k2, p1, p2, 0.0]),
        ("FULL_OPENCV", &[f, g, x, y, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]) => {
            ([f, g], [x, y], [k1, k2, p1, p2, k3])
        }
        _ => return Err(unknown()),
    };
    let sound = width_px > 0 && height_px > 0 && focal_px.iter().all(|f| f.is_finite() && *f > 0.0);
    let finite = centre.iter().chain(&distortion).all(|v| v.is_finite());
    if !sound || !finite {
        return Err(unknown());
    }
    Ok(Intrinsics { width_px, height_px, focal_px, principal_point_px: centre, distortion })
}

type Lenses = BTreeMap<u32, Intrinsics>;

fn image(lenses: &Lenses, name: String, camera: u32, q: [f64; 4], t: [f64; 3]) -> Result<Posed, Problem> {
    let Some(lens) = lenses.get(&camera) else { return Err(Problem::NoCamera { image: name, camera }) };
    let [w, x, y, z] = q;
    let turn = Quaternion::new(w, x, y, z);
    if !t.iter().chain(&q).all(|v| v.is_finite()) || turn.norm() < 0.5 {
        return Err(Problem::NotOne("model of COLMAP"));
    }
    let camera_from_grid =
        Isometry3::from_parts(Translation3::from(t), UnitQuaternion::from_quaternion(turn));
    Ok(Posed { image: name, camera: posed(lens.clone(), &camera_from_grid) })
}

/// Lines that hold something, with their numbers.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(i, l)| (i + 1, l)).filter(|(_, l)| !l.trim_start().starts_with('#'))
}

/// Of `cameras.txt` and `images.txt`.
pub fn read_text(cameras: &str, images: &str) -> Result<Vec<Posed>, Problem> {
    let mut lenses = Lenses::new();
    for (line, text) in lines(cameras).filter(|(_, l)| !l.trim().is_empty()) {
        let bad = || Problem::Line { line, what: "camera of COLMAP", text: text.to_string() };
        let words: Vec<&str> = text.split_whitespace().collect();
        let [id, model, width, height, parameters @ ..] = words.as_slice() else { return Err(bad()) };
        let id = id.parse().map_err(|_| bad())?;
        let size = [width, height].map(|s| s.parse::<u32>());
        let [Ok(width), Ok(height)] = size else { return Err(bad()) };
        let parameters = parameters.iter().map(|p| p.parse()).collect::<Result<Vec<f64>, _>>();
        lenses.insert(id, lens(id, model, [width, height], &parameters.map_err(|_| bad())?)?);
    }
    let mut all = Vec::new();
    // Every second line holds the image's points, and may be empty.
    let mut rest = lines(images);
    while let Some((line, text)) = rest.next() {
        if text.trim().is_empty() {
            continue;
        }
        let bad = || Problem::Line { line, what: "image of COLMAP", text: text.to_string() };
        let words: Vec<&str> = text.split_whitespace().collect();
        if words.len() < 10 {
            return Err(bad());
        }
        let numbers = words[1..8].iter().map(|w| w.parse()).collect::<Result<Vec<f64>, _>>();
        let [w, x, y, z, a, b, c] = numbers.map_err(|_| bad())?[..] else { return Err(bad()) };
        let camera = words[8].parse().map_err(|_| bad())?;
        // Names may hold spaces.
        let name = words[9..].join(" ");
        all.push(image(&lenses, name, camera, [w, x, y, z], [a, b, c])?);
        rest.next();
    }
    if all.is_empty() { Err(Problem::NotOne("model of COLMAP with images")) } else { Ok(all) }
}

/// Little-endian numbers of a file, one after the other.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], Problem> {
        let (head, rest) =
            self.0.split_first_chunk::<N>().ok_or(Problem::NotOne("binary model of COLMAP"))?;
        self.0 = rest;
        Ok(*head)
    }

    fn skip(&mut self, count: usize) -> Result<(), Problem> {
        self.0 = self.0.get(count..).ok_or(Problem::NotOne("binary model of COLMAP"))?;
        Ok(())
    }

    fn u32(&mut self) -> Result<u32, Problem> {
        Ok(u32::from_le_bytes(self.take()?))
    }

    fn u64(&mut self) -> Result<u64, Problem> {
        Ok(u64::from_le_bytes(self.take()?))
    }

    fn f64(&mut self) -> Result<f64, Problem> {
        Ok(f64::from_le_bytes(self.take()?))
    }

    fn floats<const N: usize>(&mut self) -> Result<[f64; N], Problem> {
        let mut all = [0.0; N];
        for v in &mut all {
            *v = self.f64()?;
        }
        Ok(all)
    }

    fn name(&mut self) -> Result<String, Problem> {
        let end = self.0.iter().position(|b| *b == 0).ok_or(Problem::NotOne("binary model of COLMAP"))?;
        let name = String::from_utf8_lossy(&self.0[..end]).into_owned();
        self.skip(end + 1)?;
        Ok(name)
    }
}

/// Of `cameras.bin` and `images.bin`.
pub fn read_binary(cameras: &[u8], images: &[u8]) -> Result<Vec<Posed>, Problem> {
    let mut file = Reader(cameras);
    let mut lenses = Lenses::new();
    for _ in 0..file.u64()? {
        let (id, model) = (file.u32()?, file.u32()?);
        let size = [file.u64()?, file.u64()?].map(|s| u32::try_from(s).unwrap_or(0));
        let (name, count) = *MODELS
            .get(model as usize)
            .ok_or_else(|| Problem::Model { camera: id, model: model.to_string() })?;
        let parameters = (0..count).map(|_| file.f64()).collect::<Result<Vec<_>, _>>()?;
        lenses.insert(id, lens(id, name, size, &parameters)?);
    }
    let mut file = Reader(images);
    let mut all = Vec::new();
    /// Of a point in an image: its place and its number.
    const POINT: usize = 24;
    for _ in 0..file.u64()? {
        file.u32()?;
        let (q, t) = (file.floats()?, file.floats()?);
        let camera = file.u32()?;
        let name = file.name()?;
        let points = usize::try_from(file.u64()?).ok().and_then(|n| n.checked_mul(POINT));
        file.skip(points.ok_or(Problem::NotOne("binary model of COLMAP"))?)?;
        all.push(image(&lenses, name, camera, q, t)?);
    }
    if all.is_empty() { Err(Problem::NotOne("model of COLMAP with images")) } else { Ok(all) }
}

/// `cameras.txt` and `images.txt`, without points.
pub fn write_text(all: &[Posed]) -> [String; 2] {
    let mut lenses: Vec<&Intrinsics> = Vec::new();
    let mut images = String::from(
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; a line of points, here none, after each\n",
    );
    for (number, Posed { image, camera }) in all.iter().enumerate() {
        let known = lenses.iter().position(|l| **l == camera.intrinsics);
        let lens = known.unwrap_or_else(|| {
            lenses.push(&camera.intrinsics);
            lenses.len() - 1
        });
        let camera_from_grid = camera.world_from_camera.inverse() * world_from_grid();
        let (q, t) = (camera_from_grid.rotation, camera_from_grid.translation.vector);
        let _ = writeln!(
            images,
            "{} {} {} {} {} {} {} {} {} {image}\n",
            number + 1,
            q.w,
            q.i,
            q.j,
            q.k,
            t.x,
            t.y,
            t.z,
            lens + 1
        );
    }
    let mut cameras = String::from("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS\n");
    for (number, lens) in lenses.iter().enumerate() {
        let ([f, g], [x, y], [k1, k2, p1, p2, k3]) =
            (lens.focal_px, lens.principal_point_px, lens.distortion);
        let (width, height) = (lens.width_px, lens.height_px);
        let start = format!("{} {{}} {width} {height} {f} {g} {x} {y} {k1} {k2} {p1} {p2}", number + 1);
        let line = if k3 == 0.0 {
            start.replace("{}", "OPENCV")
        } else {
            format!("{} {k3} 0 0 0", start.replace("{}", "FULL_OPENCV"))
        };
        let _ = writeln!(cameras, "{line}");
    }
    [cameras, images]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use nalgebra::{Point3, Vector3};
    use proptest::prelude::*;

    fn camera(turn: [f64; 3], at: [f64; 3], k3: f64) -> Camera {
        let mut intrinsics = Intrinsics::pinhole(640, 480, 590.0);
        intrinsics.distortion = [-0.2, 0.05, 0.001, -0.002, k3];
        Camera { intrinsics, world_from_camera: Isometry3::new(Vector3::from(at), Vector3::from(turn)) }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_back(
            turn in prop::array::uniform3(-2.0..2.0f64), at in prop::array::uniform3(-5.0..5.0f64), k3 in prop::bool::ANY,
        ) {
            let all = ["a b.jpg", "ö.jpg"].map(|image| Posed {
                image: image.into(), camera: camera(turn, at, if k3 { 0.01 } else { 0.0 }),
            });
            let [cameras, images] = write_text(&all);
            prop_assert_eq!(cameras.lines().count(), 2);
            let read = read_text(&cameras, &images).unwrap();
            for (a, b) in all.iter().zip(&read) {
                prop_assert_eq!(&a.image, &b.image);
                prop_assert_eq!(&a.camera.intrinsics, &b.camera.intrinsics);
                let off = a.camera.world_from_camera.inv_mul(&b.camera.world_from_camera);
                prop_assert!(off.translation.vector.norm() < 1e-9 && off.rotation.angle() < 1e-7);
            }
        }
    }

    #[test]
    fn the_textbook_image_lies_where_colmap_has_it() {
        // A point on the axis, 2 m before a camera that is 2 m from the origin of a z-up world, looking along its +x.
        let cameras = "# comment\n7 SIMPLE_RADIAL 640 480 500 320 240 0.1\n";
        let (s, t) = (0.5, -0.5);
        let images =
            format!("3 {s} {t} {s} {t} 0 0 2 7 one.jpg\n10 20 -1 30 40 5\n4 1 0 0 0 0 0 2 7 two.jpg\n\n");
        let read = read_text(cameras, &images).unwrap();
        assert_eq!(read.len(), 2);
        let grid_point = Point3::new(0.1, 0.0, 0.0);
        let seen = read[1].camera.project(&(world_from_grid() * grid_point)).unwrap();
        let r = 0.05_f64;
        assert!((seen.x - (320.0 + 500.0 * r * (1.0 + 0.1 * r * r))).abs() < 1e-9, "{seen}");
        let turned = UnitQuaternion::from_quaternion(Quaternion::new(s, t, s, t)) * grid_point.coords;
        let expected = turned + Vector3::new(0.0, 0.0, 2.0);
        let seen = read[0].camera.project(&(world_from_grid() * grid_point)).unwrap();
        let ideal = [expected.x / expected.z, expected.y / expected.z];
        let [x, y] = read[0].camera.intrinsics.distort(ideal);
        assert!((seen.x - 320.0 - 500.0 * x).abs() < 1e-9 && (seen.y - 240.0 - 500.0 * y).abs() < 1e-9);
    }

    #[test]
    fn binary_models_say_the_same() {
        let mut cameras = 1_u64.to_le_bytes().to_vec();
        cameras.extend(7_u32.to_le_bytes());
        cameras.extend(2_u32.to_le_bytes());
        [640_u64, 480].iter().for_each(|s| cameras.extend(s.to_le_bytes()));
        [500.0_f64, 320.0, 240.0, 0.1].iter().for_each(|p| cameras.extend(p.to_le_bytes()));
        let mut images = 1_u64.to_le_bytes().to_vec();
        images.extend(3_u32.to_le_bytes());
        [0.5_f64, -0.5, 0.5, -0.5, 0.0, 0.0, 2.0].iter().for_each(|p| images.extend(p.to_le_bytes()));
        images.extend(7_u32.to_le_bytes());
        images.extend(b"one.jpg\0");
        images.extend(1_u64.to_le_bytes());
        images.extend([0; 24]);
        let text =
            read_text("7 SIMPLE_RADIAL 640 480 500 320 240 0.1", "3 0.5 -0.5 0.5 -0.5 0 0 2 7 one.jpg\n\n");
        assert_eq!(read_binary(&cameras, &images).unwrap(), text.unwrap());
        for cut in [4, 20, 60] {
            let refused = read_binary(&cameras, &images[..cut]);
            assert_eq!(refused, Err(Problem::NotOne("binary model of COLMAP")), "{cut}");
        }
    }

    /// `fixtures/colmap` was written by COLMAP 4.2.1 itself (`pycolmap.synthesize_dataset`): three images, a lens with distortion,
    /// eight points and where each image sees them.
    #[test]
    fn models_that_colmap_wrote_see_its_points_where_it_does() {
        macro_rules! model {
            ($name:literal) => {
                concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/colmap/", $name)
            };
        }
        let images = include_str!(model!("images.txt"));
        let text = read_text(include_str!(model!("cameras.txt")), images).unwrap();
        let (cameras, of_images) =
            (include_bytes!(model!("cameras.bin")), include_bytes!(model!("images.bin")));
        let mut binary = read_binary(cameras, of_images).unwrap();
        binary.sort_by(|a, b| a.image.cmp(&b.image));
        assert_eq!(text, binary);
        let numbers =
            |line: &str| line.split_whitespace().map_while(|w| w.parse().ok()).collect::<Vec<f64>>();
        let points = lines(include_str!(model!("points3D.txt"))).map(|(_, l)| numbers(l));
        let points: BTreeMap<i64, Point3<f64>> =
            points.map(|p| (p[0] as i64, Point3::new(p[1], p[2], p[3]))).collect();
        let observed = lines(images).skip(1).step_by(2).map(|(_, line)| numbers(line));
        let mut count = 0;
        for (posed, observed) in text.iter().zip(observed) {
            for seen in observed.chunks(3) {
                let Some(point) = points.get(&(seen[2] as i64)) else { continue };
                let pixel = posed.camera.project(&(world_from_grid() * point)).unwrap();
                assert!((pixel.x - seen[0]).hypot(pixel.y - seen[1]) < 1e-9, "{}: {pixel}", posed.image);
                count += 1;
            }
        }
        assert_eq!(count, 24);
    }

    #[test]
    fn what_cannot_be_read_is_told() {
        let said = |cameras: &str, images: &str| read_text(cameras, images).unwrap_err().to_string();
        assert_eq!(said("1 FOV 640 480 500 500 320 240 0.9", ""), "camera 1 has the model `FOV`");
        assert_eq!(said("1 PINHOLE 640", ""), "line 1 is no camera of COLMAP: 1 PINHOLE 640");
        let pinhole = "1 PINHOLE 640 480 500 500 320 240";
        assert_eq!(
            said(pinhole, "1 1 0 0 0 0 0 2 5 a.jpg\n\n"),
            "a.jpg was taken by camera 5, which is not there"
        );
        assert_eq!(said(pinhole, "# none\n"), "is cut short or no model of COLMAP with images");
    }
}

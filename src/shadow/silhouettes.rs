//! Which surface a pixel beside a silhouette shows. The model's silhouettes are off by a pixel or so: a pixel that it counts to the
//! leg of a table, and that shows the floor beside it, would keep the floor's light in the middle of a shadow. A pixel near the
//! border of two faces goes to the one whose neighbouring pixels, well within it, have its colour.

use super::Problem;
use super::receivers::{Receiver, Receivers, barycentric};
use crate::illuminate::patch::PatchMesh;
use crate::image::{Image, RadianceImage};
use glam::Vec2;
use rayon::prelude::*;

/// How far a silhouette may be moved, px.
const REACH: i32 = 2;
/// Standard deviation of its place, px.
const OPEN: f32 = 1.0;
/// Pixels so far around tell a face's colour.
const RADIUS: i32 = 4;
/// Fewest of them.
const LEAST: usize = 4;
/// Standard deviation of ln B besides what they show: noise, and light that changes.
const NOISE: f32 = 0.1;
/// So many channels say something of their own.
const INDEPENDENT: f32 = 1.5;
/// Another face must be more probable by this much, natural logarithm.
const SURE: f32 = 1.0;

impl Receivers {
    /// The same with pixels beside silhouettes on the faces that the plate shows there.
    pub fn as_shown(&self, plate: &RadianceImage, mesh: &PatchMesh) -> Result<Self, Problem> {
        self.check(plate)?;
        let (width, height) = self.pixels.size();
        let faces = self.pixels.map(|r| r.map(|r| mesh.patches[r.patch as usize].face));
        let colours = plate.map(|b| b.0.map(f32::ln));
        let picture = Picture { faces: &faces, colours: &colours };
        let pixels = (0..width * height).into_par_iter().map(|i| {
            let (x, y) = ((i % width) as i32, (i / width) as i32);
            let own = *self.pixels.at(i % width, i / width);
            picture.face_beside(x, y).map_or(own, |(x, y, by)| {
                let receiver = (*self.pixels.at(x as usize, y as usize))?;
                let position = receiver.at(by);
                let corners = mesh.corners(receiver.patch as usize);
                Some(Receiver { position, barycentric: barycentric(corners, position), ..receiver })
            })
        });
        Ok(Self { pixels: Image::from_pixels(width, height, pixels.collect()), seen: self.seen.clone() })
    }
}

struct Picture<'a> {
    faces: &'a Image<Option<u32>>,
    /// ln B.
    colours: &'a Image<[f32; 3]>,
}

impl Picture<'_> {
    fn face(&self, x: i32, y: i32) -> Option<u32> {
        let (width, height) = self.faces.size();
        let inside = (0..width as i32).contains(&x) && (0..height as i32).contains(&y);
        if inside { *self.faces.at(x as usize, y as usize) } else { None }
    }

    /// Of a pixel that shows another face than the model says: the nearest one of that face, and the way back from it, px.
    fn face_beside(&self, x: i32, y: i32) -> Option<(i32, i32, Vec2)> {
        let own = self.face(x, y)?;
        let mut candidates: Vec<(u32, i32, i32, i32)> = Vec::new();
        for (j, i) in (-REACH..=REACH).flat_map(|j| (-REACH..=REACH).map(move |i| (j, i))) {
            let Some(face) = self.face(x + i, y + j).filter(|f| *f != own) else { continue };
            let far = i * i + j * j;
            match candidates.iter_mut().find(|c| c.0 == face) {
                Some(nearest) if nearest.1 > far => *nearest = (face, far, i, j),
                Some(_) => {}
                None => candidates.push((face, far, i, j)),
            }
        }
        if candidates.is_empty() {
            return None;
        }
        let here = self.likelihood(own, x, y)?;
        let probable = |&(face, far, i, j): &(u32, i32, i32, i32)| {
            Some((self.likelihood(face, x, y)? - far as f32 / (2.0 * OPEN * OPEN), i, j))
        };
        let best = candidates.iter().filter_map(probable).max_by(|a, b| a.0.total_cmp(&b.0))?;
        (best.0 > here + SURE).then(|| (x + best.1, y + best.2, -Vec2::new(best.1 as f32, best.2 as f32)))
    }

    /// Logarithm of how likely a pixel has its colour, were it of a face.
    fn likelihood(&self, face: u32, x: i32, y: i32) -> Option<f32> {
        let within =
            |x: i32, y: i32| (-1..=1).all(|j| (-1..=1).all(|i| self.face(x + i, y + j) == Some(face)));
        let [mut sum, mut squares] = [[0.0f32; 3]; 2];
        let mut count = 0;
        for (j, i) in (-RADIUS..=RADIUS).flat_map(|j| (-RADIUS..=RADIUS).map(move |i| (j, i))) {
            let (u, v) = (x + i, y + j);
            if (i, j) == (0, 0) || self.face(u, v) != Some(face) || !within(u, v) {
                continue;
            }
            let colour = self.colours.at(u as usize, v as usize);
            if colour.iter().all(|c| c.is_finite()) {
                count += 1;
                (0..3).for_each(|k| {
                    (sum[k], squares[k]) = (sum[k] + colour[k], squares[k] + colour[k].powi(2))
                });
            }
        }
        let own = self.colours.at(x as usize, y as usize);
        if count < LEAST || own.iter().any(|c| !c.is_finite()) {
            return None;
        }
        let n = count as f32;
        let channel = |k: usize| {
            let mean = sum[k] / n;
            let variance = (squares[k] / n - mean * mean).max(0.0) + NOISE * NOISE;
            -((own[k] - mean).powi(2) / variance + variance.ln()) / 2.0
        };
        Some((0..3).map(channel).sum::<f32>() * INDEPENDENT / 3.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Radiance;

    /// A leg before a floor: columns 10 to 15 by the model, columns 11 to 16 in the plate.
    #[test]
    fn a_pixel_goes_to_the_face_whose_colour_it_has() {
        let faces = Image::from_fn(30, 20, |x, _| Some(u32::from((10..16).contains(&x))));
        let texture = |x: usize, y: usize| 1.0 + 0.1 * ((x * 7 + y * 5) % 3) as f32;
        let plate = |joint: bool| {
            Image::from_fn(30, 20, move |x, y| {
                let b = match x {
                    11..17 => [0.10, 0.11, 0.14],
                    _ if joint && y % 7 == 3 => [0.25; 3],
                    _ => [0.5, 0.48, 0.45],
                };
                b.map(|b: f32| (b * texture(x, y)).ln())
            })
        };
        for joint in [false, true] {
            let colours = plate(joint);
            let picture = Picture { faces: &faces, colours: &colours };
            for (y, x) in (4..16).flat_map(|y| (4..26).map(move |x| (y, x))) {
                let found = picture.face_beside(x, y);
                let expected = match x {
                    10 => Some((9, y)),
                    16 => Some((15, y)),
                    _ => None,
                };
                // A dark joint of the floor may be anything.
                if !(joint && y % 7 == 3) {
                    assert_eq!(found.map(|f| (f.0, f.1)), expected, "{x}, {y}");
                }
            }
        }
    }

    #[test]
    fn alike_faces_stay_as_they_are() {
        let faces = Image::from_fn(30, 20, |x, _| Some(u32::from(x >= 15)));
        let colours = Image::from_fn(30, 20, |x, y| [(1.0 + 0.2 * ((x * 7 + y * 5) % 4) as f32).ln(); 3]);
        let picture = Picture { faces: &faces, colours: &colours };
        assert!((0..600).all(|i| picture.face_beside(i % 30, i / 30).is_none()));
    }

    #[test]
    fn a_pixel_keeps_its_place_on_the_other_faces_plane() {
        use crate::synthetic::{camera, face};
        use glam::Vec3;
        let mut mesh = PatchMesh::default();
        face(&mut mesh, Vec3::new(-2.0, 0.0, -2.0), Vec3::Z * 4.0, Vec3::X * 4.0, 0.5, |_| [0.0; 3]);
        face(&mut mesh, Vec3::new(-0.2, 0.0, 0.0), Vec3::X * 0.4, Vec3::Y * 0.6, 0.2, |_| [0.0; 3]);
        let camera = camera([0.0, 1.2, 2.5], [0.0, 0.2, 0.0], 64, 48, 60.0);
        let receivers = Receivers::cast(&camera, &mesh);
        let face_at = |r: &Receivers, x, y| r.pixels.at(x, y).map(|r| mesh.patches[r.patch as usize].face);
        let left = (0..64).find(|x| face_at(&receivers, *x, 24) == Some(1)).unwrap();
        // The plate shows the face one pixel less far to the left.
        let plate = Image::from_fn(64, 48, |x, y| {
            let on = face_at(&receivers, x, y) == Some(1) && face_at(&receivers, x - 1, y) == Some(1);
            Radiance([if on { 0.1 } else { 0.5 }; 3])
        });
        let shown = receivers.as_shown(&plate, &mesh).unwrap();
        assert_eq!((face_at(&shown, left, 24), face_at(&shown, left + 1, 24)), (Some(0), Some(1)));
        let found = shown.pixels.at(left, 24).unwrap();
        let pixel = camera.project(&nalgebra::Point3::from(found.position.as_dvec3().to_array())).unwrap();
        assert!((pixel.x - left as f64 - 0.5).abs() < 0.05 && (pixel.y - 24.5).abs() < 0.05, "{pixel}");
        assert!(found.position.y.abs() < 1e-4);
    }
}

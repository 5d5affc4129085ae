//! The plate as the search looks at it: small, by brightness and two opposed colours, and the room's axes in its camera.

use super::layout::{AWAY, RIGHT, UP};
use crate::calibrate::manhattan;
use crate::calibrate::vanishing::{Edge, RoomEdges};
use crate::calibrate::{self};
use crate::camera::{Camera, Intrinsics};
use crate::exposure::Photograph;
use crate::image::Image;
use crate::vision;
use nalgebra::{Point2, Vector3};

/// Longer side to which large plates are reduced, px: a room's edges need no more.
const REDUCED_PX: f64 = 800.0;
/// Nearer than this to the picture's border nothing is looked up, px.
const MARGIN_PX: f64 = 8.0;

/// The reduced plate and where the room's axes point.
pub struct View {
    /// Brightness and two opposed colours, 0 … 1.
    pub picture: Image<[f32; 3]>,
    /// The lens of the reduced plate.
    pub lens: Intrinsics,
    /// Pixels of the plate for one of its own.
    pub reduction: f64,
    /// To the right, up and away, in the camera frame.
    axes: [Vector3<f64>; 3],
    /// Line segments along each of the three, px as an ideal lens would have them.
    pub segments: [Vec<Edge>; 3],
}

impl View {
    /// Looks for the room's directions about the camera's vertical; `along`: a horizontal one in the world, where it is known.
    pub fn new(
        plate: &Photograph,
        camera: &Camera,
        along: Option<Vector3<f64>>,
    ) -> Result<Self, calibrate::Problem> {
        let colours = encoded(plate);
        let longer = colours.width().max(colours.height()) as f64;
        let reduction = (longer / REDUCED_PX).ceil().max(1.0) as usize;
        let colours = reduced(&colours, reduction);
        let opposed = |[r, g, b]: &[f32; 3]| [(r + g + b) / 3.0, r - g, (r + g) / 2.0 - b];
        let grey = colours.map(|c| (255.0 * crate::image::luminance(*c)).round().clamp(0.0, 255.0) as u8);
        let reduction = reduction as f64;
        let own = &camera.intrinsics;
        let lens = Intrinsics {
            width_px: colours.width() as u32,
            height_px: colours.height() as u32,
            focal_px: own.focal_px.map(|f| f / reduction),
            principal_point_px: own.principal_point_px.map(|c| c / reduction),
            distortion: own.distortion,
        };
        let found = vision::line_segments(&grey)?;
        let ideal: Vec<Edge> =
            found.iter().map(|s| s.map(|p| calibrate::undistorted(&lens, [p.x, p.y]))).collect();
        let in_camera = |v: Vector3<f64>| camera.world_from_camera.inverse() * v;
        let (room, RoomEdges { along: [right, away, up] }) = manhattan::about_vertical(
            &ideal,
            Point2::from(lens.principal_point_px),
            (colours.width() as f64).hypot(colours.height() as f64),
            lens.focal_px[0],
            &in_camera(Vector3::y()),
            along.map(in_camera),
        )?;
        let axis = |k: usize| room.camera_from_room * Vector3::ith(k, 1.0);
        Ok(Self {
            picture: colours.map(opposed),
            lens,
            reduction,
            axes: [axis(0), axis(2), axis(1)],
            segments: [right, up, away],
        })
    }

    /// An axis in the camera frame.
    pub fn axis(&self, k: usize) -> Vector3<f64> {
        self.axes[k]
    }

    /// Its diagonal, px.
    pub fn diagonal_px(&self) -> f64 {
        f64::from(self.lens.width_px).hypot(f64::from(self.lens.height_px))
    }

    /// What an ideal lens sees at a pixel, along the room's axes.
    pub fn ray(&self, ideal: &Point2<f64>) -> Vector3<f64> {
        let ([f, g], [cx, cy]) = (self.lens.focal_px, self.lens.principal_point_px);
        let ray = Vector3::new((ideal.x - cx) / f, (ideal.y - cy) / g, 1.0);
        Vector3::new(ray.dot(&self.axes[RIGHT]), ray.dot(&self.axes[UP]), ray.dot(&self.axes[AWAY]))
    }

    /// Where an ideal lens sees the line through the camera's side of a plane about an axis: its part within the picture, px.
    /// `angle` as [`super::layout::Edge::angle`].
    pub fn line(&self, axis: usize, angle: f64) -> Option<[Point2<f64>; 2]> {
        let [a, b] = super::layout::others(axis);
        let foot = self.axes[a] * angle.cos() + self.axes[b] * angle.sin();
        // Points before the camera: from far along one way, or the vanishing point, to the other.
        let far = 1e3;
        let ends = [foot - self.axes[axis] * far, foot + self.axes[axis] * far];
        let [p, q] = before(ends)?.map(|p| {
            let ([f, g], [cx, cy]) = (self.lens.focal_px, self.lens.principal_point_px);
            Point2::new(f * p.x / p.z + cx, g * p.y / p.z + cy)
        });
        let (mut from, mut to) = (0.0f64, 1.0f64);
        let size = [f64::from(self.lens.width_px), f64::from(self.lens.height_px)];
        for (k, size) in size.into_iter().enumerate() {
            for (sign, limit) in [(1.0, MARGIN_PX), (-1.0, MARGIN_PX - size)] {
                let (slope, room) = (sign * (q[k] - p[k]), limit - sign * p[k]);
                match () {
                    () if slope > 0.0 => from = from.max(room / slope),
                    () if slope < 0.0 => to = to.min(room / slope),
                    () if room > 0.0 => return None,
                    () => {}
                }
            }
        }
        (from < to).then(|| [p + (q - p) * from, p + (q - p) * to])
    }

    /// The pixel of the reduced plate that shows what an ideal lens sees there.
    pub fn stored(&self, ideal: &Point2<f64>) -> Point2<f64> {
        if self.lens.distortion == [0.0; 5] {
            return *ideal;
        }
        let ([f, g], [cx, cy]) = (self.lens.focal_px, self.lens.principal_point_px);
        let [x, y] = self.lens.distort([(ideal.x - cx) / f, (ideal.y - cy) / g]);
        Point2::new(f * x + cx, g * y + cy)
    }
}

/// The part of a line before the camera.
fn before([mut a, mut b]: [Vector3<f64>; 2]) -> Option<[Vector3<f64>; 2]> {
    const NEAR: f64 = 1e-3;
    if a.z < NEAR && b.z < NEAR {
        return None;
    }
    if a.z < NEAR {
        a = b + (a - b) * ((b.z - NEAR) / (b.z - a.z));
    } else if b.z < NEAR {
        b = a + (b - a) * ((a.z - NEAR) / (a.z - b.z));
    }
    Some([a, b])
}

/// Colours as a display would show them, 0 … 1.
fn encoded(plate: &Photograph) -> Image<[f32; 3]> {
    match plate {
        Photograph::Codes(codes) => codes.map(|c| c.0),
        Photograph::Linear(linear) => {
            let mut sorted: Vec<f32> = linear.pixels().iter().map(|r| r.luminance()).collect();
            sorted.sort_by(f32::total_cmp);
            let white = sorted.get(sorted.len() * 99 / 100).copied().unwrap_or(1.0).max(f32::MIN_POSITIVE);
            linear.map(|r| r.0.map(|v| (v / white).clamp(0.0, 1.0).powf(1.0 / 2.2)))
        }
    }
}

/// Means over squares of `by` pixels.
fn reduced(image: &Image<[f32; 3]>, by: usize) -> Image<[f32; 3]> {
    if by == 1 {
        return image.clone();
    }
    Image::from_fn(image.width() / by, image.height() / by, |x, y| {
        let mut sum = [0.0; 3];
        for (dx, dy) in (0..by * by).map(|k| (k % by, k / by)) {
            let pixel = image.at(x * by + dx, y * by + dy);
            (0..3).for_each(|k| sum[k] += pixel[k]);
        }
        sum.map(|s| s / (by * by) as f32)
    })
}

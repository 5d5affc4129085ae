//! Straight edges of a photograph.

use super::{HALF, Problem, matrix};
use crate::image::Image;
use nalgebra::Point2;
use opencv::core::{Mat, Size, Vec4f, Vector};
use opencv::imgproc;
use opencv::prelude::LineSegmentDetectorTrait;

/// Longer side to which large photographs are reduced first, px: edges get shorter with their noise, and soon found.
const REDUCED_PX: f64 = 1600.0;

/// Line segments (Grompone von Gioi et al. 2010), ends in px.
pub fn line_segments(image: &Image<u8>) -> Result<Vec<[Point2<f64>; 2]>, Problem> {
    let picture = matrix(image)?;
    let reduction = (image.width().max(image.height()) as f64 / REDUCED_PX).max(1.0);
    let mut reduced = Mat::default();
    let size = Size::new(
        (image.width() as f64 / reduction).round() as i32,
        (image.height() as f64 / reduction).round() as i32,
    );
    imgproc::resize(&picture, &mut reduced, size, 0.0, 0.0, imgproc::INTER_AREA)?;
    let mut detector =
        imgproc::create_line_segment_detector(imgproc::LSD_REFINE_STD, 0.8, 0.6, 2.0, 22.5, 0.0, 0.7, 1024)?;
    let mut found = Vector::<Vec4f>::new();
    let (mut width, mut precision, mut significance) = (Mat::default(), Mat::default(), Mat::default());
    detector.detect(&reduced, &mut found, &mut width, &mut precision, &mut significance)?;
    let scale =
        [image.width() as f64 / f64::from(size.width), image.height() as f64 / f64::from(size.height)];
    let ours =
        |x: f32, y: f32| Point2::new((f64::from(x) + HALF) * scale[0], (f64::from(y) + HALF) * scale[1]);
    Ok(found.iter().map(|s| [ours(s[0], s[1]), ours(s[2], s[3])]).collect())
}

//! Video files and cameras.

use super::Problem;
use crate::image::{Code, CodeImage, Image};
use opencv::core::{Mat, Size, Vec3b};
use opencv::prelude::{MatTraitConst, MatTraitConstManual, VideoCaptureTrait, VideoCaptureTraitConst};
use opencv::prelude::{VideoWriterTrait, VideoWriterTraitConst};
use opencv::videoio::{self, VideoCapture};
use std::path::Path;

/// Frames one by one.
pub struct VideoReader(VideoCapture);

impl VideoReader {
    /// Of a file.
    pub fn file(path: &Path) -> Result<Self, Problem> {
        let capture = VideoCapture::from_file_def(path)?;
        match capture.is_opened()? {
            true => Ok(Self(capture)),
            false => Err(Problem::Video("is no video that OpenCV can read")),
        }
    }

    /// Of a camera device, by its number.
    pub fn device(number: u32) -> Result<Self, Problem> {
        let capture = VideoCapture::new_def(number as i32)?;
        match capture.is_opened()? {
            true => Ok(Self(capture)),
            false => Err(Problem::Camera(number)),
        }
    }

    /// Frames a second, where the source says so.
    pub fn frames_per_second(&self) -> Option<f64> {
        let rate = self.0.get(videoio::CAP_PROP_FPS).ok()?;
        (rate.is_finite() && rate > 0.0).then_some(rate)
    }

    /// The next frame, none at the end.
    pub fn frame(&mut self) -> Result<Option<CodeImage>, Problem> {
        let mut picture = Mat::default();
        if !self.0.read(&mut picture)? || picture.empty() {
            return Ok(None);
        }
        let (width, height) = (picture.cols() as usize, picture.rows() as usize);
        let pixels = picture.data_typed::<Vec3b>()?;
        let code = |p: &Vec3b| Code([p[2], p[1], p[0]].map(|v| f32::from(v) / 255.0));
        Ok(Some(Image::from_pixels(width, height, pixels.iter().map(code).collect())))
    }
}

/// Writes a video of JPEG frames (AVI).
pub struct VideoWriter(videoio::VideoWriter);

impl VideoWriter {
    /// A new file, for frames of a size, px.
    pub fn create(
        path: &Path,
        (width, height): (usize, usize),
        frames_per_second: f64,
    ) -> Result<Self, Problem> {
        let code = videoio::VideoWriter::fourcc('M', 'J', 'P', 'G')?;
        let size = Size::new(width as i32, height as i32);
        let writer = videoio::VideoWriter::new_def(path, code, frames_per_second, size)?;
        match writer.is_opened()? {
            true => Ok(Self(writer)),
            false => Err(Problem::Video("the video cannot be written")),
        }
    }

    /// Appends a frame.
    pub fn write(&mut self, frame: &CodeImage) -> Result<(), Problem> {
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        let pixels: Vec<Vec3b> =
            frame.pixels().iter().map(|p| Vec3b::from([p.0[2], p.0[1], p.0[0]].map(byte))).collect();
        let picture = Mat::new_rows_cols_with_data(frame.height() as i32, frame.width() as i32, &pixels)?;
        Ok(self.0.write(&picture)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_video_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.avi");
        let mut writer = VideoWriter::create(&path, (64, 48), 25.0).unwrap();
        let frame = |i: usize| Image::from_fn(64, 48, |x, _| Code([x as f32 / 64.0, 0.2 * i as f32, 0.5]));
        (0..3).for_each(|i| writer.write(&frame(i)).unwrap());
        drop(writer);
        let mut reader = VideoReader::file(&path).unwrap();
        assert_eq!(reader.frames_per_second(), Some(25.0));
        for i in 0..3 {
            let read = reader.frame().unwrap().unwrap();
            assert_eq!(read.size(), (64, 48));
            let (a, b) = (read.at(40, 20).0, frame(i).at(40, 20).0);
            assert!((0..3).all(|k| (a[k] - b[k]).abs() < 0.04), "{a:?} {b:?}");
        }
        assert_eq!(reader.frame().unwrap(), None);
    }

    #[test]
    fn what_is_no_video_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.avi");
        std::fs::write(&path, "no video").unwrap();
        assert_eq!(VideoReader::file(&path).err(), Some(Problem::Video("is no video that OpenCV can read")));
    }
}

//! OpenCV's own calibration and merging of exposures, which insitu is measured beside.

use super::Problem;
use crate::image::{Image, Radiance, RadianceImage};
use opencv::core::{Mat, Vec3b, Vec3f, Vector};
use opencv::prelude::*;
use opencv::{imgcodecs, photo};
use std::path::Path;

/// Which of its algorithms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// `CalibrateDebevec` and `MergeDebevec`.
    Debevec,
    /// `CalibrateRobertson` and `MergeRobertson`.
    Robertson,
}

/// What OpenCV makes of exposures.
#[derive(Debug)]
pub struct Merged {
    /// Relative exposure at each 8-bit code: red, green, blue.
    pub curves: [Vec<f64>; 3],
    /// Radiance, up to one factor a channel.
    pub radiance: RadianceImage,
}

/// Exposures as OpenCV holds them.
pub struct Exposures {
    images: Vector<Mat>,
    times: Vector<f32>,
}

impl Exposures {
    /// From 8-bit pictures (red, green, blue) of one size and their exposures.
    pub fn new(frames: &[(Image<[u8; 3]>, f64)]) -> Result<Self, Problem> {
        let mut images = Vector::<Mat>::new();
        for (image, _) in frames {
            let pixels: Vec<Vec3b> =
                image.pixels().iter().map(|[r, g, b]| Vec3b::from([*b, *g, *r])).collect();
            let view = Mat::new_rows_cols_with_data(image.height() as i32, image.width() as i32, &pixels)?;
            images.push(view.try_clone()?);
        }
        Ok(Self { images, times: frames.iter().map(|(_, t)| *t as f32).collect() })
    }

    /// From files, decoded by OpenCV.
    pub fn read(files: &[(&Path, f64)]) -> Result<Self, Problem> {
        let read = |(path, _): &(&Path, f64)| {
            imgcodecs::imread(path.to_string_lossy().as_ref(), imgcodecs::IMREAD_COLOR)
        };
        let images = files.iter().map(read).collect::<Result<Vector<Mat>, _>>()?;
        Ok(Self { images, times: files.iter().map(|(_, t)| *t as f32).collect() })
    }

    /// Fits the response and merges, all settings at their defaults. The radiance stays with OpenCV.
    fn calibrate_and_merge(&self, method: Method) -> Result<(Mat, Mat), Problem> {
        let mut response = Mat::default();
        match method {
            Method::Debevec => {
                photo::create_calibrate_debevec_def()?.process(&self.images, &mut response, &self.times)?;
                let radiance = self.merged(photo::create_merge_debevec()?, &response)?;
                Ok((response, radiance))
            }
            Method::Robertson => {
                photo::create_calibrate_robertson_def()?.process(&self.images, &mut response, &self.times)?;
                let radiance = self.merged(photo::create_merge_robertson()?, &response)?;
                Ok((response, radiance))
            }
        }
    }

    fn merged(&self, mut by: impl MergeExposuresTrait, response: &Mat) -> Result<Mat, Problem> {
        let mut radiance = Mat::default();
        MergeExposuresTrait::process(&mut by, &self.images, &mut radiance, &self.times, response)?;
        Ok(radiance)
    }

    /// Fits the response and merges.
    pub fn merge(&self, method: Method) -> Result<Merged, Problem> {
        let (response, radiance) = self.calibrate_and_merge(method)?;
        let curve = response.data_typed::<Vec3f>()?;
        let curves = [2, 1, 0].map(|k: usize| curve.iter().map(|v| f64::from(v[k])).collect());
        let pixels = radiance.data_typed::<Vec3f>()?.iter().map(|v| Radiance([v[2], v[1], v[0]])).collect();
        let radiance = Image::from_pixels(radiance.cols() as usize, radiance.rows() as usize, pixels);
        Ok(Merged { curves, radiance })
    }

    /// The same for its cost alone; gives the mean of the radiance.
    pub fn merge_for_cost(&self, method: Method) -> Result<f64, Problem> {
        let (_, radiance) = self.calibrate_and_merge(method)?;
        Ok(opencv::core::mean_def(&radiance)?[1])
    }
}

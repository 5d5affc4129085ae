//! What a user gives to judge by.

use super::compare::Reference;
use super::truth::Truth;
use crate::artefact::exr;
use crate::error::{Error, Result};
use crate::image::Image;
use crate::stage::Context;

const CHECK: &str = "check the file, or leave out the setting";

/// The reference pictures named in the settings; `None` if there are none.
pub fn read_reference(ctx: &Context) -> Result<Option<Reference>> {
    let settings = &ctx.pipeline.evaluate;
    let Some(with) = &settings.reference else {
        return Ok(None);
    };
    let with = exr::read_radiance(&ctx.user_file(with)?)?;
    let empty = match &settings.reference_empty {
        Some(path) => Some(exr::read_radiance(&ctx.user_file(path)?)?),
        None => {
            ctx.warn("no `evaluate.reference_empty`: the plate stands in, its noise counts as error");
            None
        }
    };
    let mask = match &settings.reference_mask {
        Some(path) => Some(read_mask(&ctx.user_file(path)?)?),
        None => {
            ctx.warn("no `evaluate.reference_mask`: the object is taken to be where ours is");
            None
        }
    };
    Ok(Some(Reference { with, empty, mask }))
}

fn read_mask(path: &std::path::Path) -> Result<Image<f32>> {
    let refuse = |e: image::ImageError| Error::file("reading the reference's mask", path, e, CHECK);
    let grey = image::ImageReader::open(path)
        .map_err(|e| refuse(e.into()))?
        .with_guessed_format()
        .map_err(|e| refuse(e.into()))?
        .decode()
        .map_err(refuse)?
        .into_luma16();
    let pixels = grey.pixels().map(|p| f32::from(p.0[0]) / 65535.0).collect();
    Ok(Image::from_pixels(grey.width() as usize, grey.height() as usize, pixels))
}

/// The `truth.json` named in the settings.
pub fn read_truth(ctx: &Context) -> Result<Option<Truth>> {
    let Some(path) = &ctx.pipeline.evaluate.truth else { return Ok(None) };
    let path = ctx.user_file(path)?;
    let refuse = |e: String| Error::file("reading the truth", &path, e, CHECK);
    let bytes = std::fs::read(&path).map_err(|e| refuse(e.to_string()))?;
    let value = serde_json::from_slice(&bytes).map_err(|e| refuse(format!("not JSON ({e})")))?;
    Ok(Some(Truth::new(value)))
}

//! What a user gives to judge by.

use super::compare::Reference;
use super::truth::Truth;
use crate::artefact::exr;
use crate::config;
use crate::error::{Error, Result};
use crate::image::Image;
use crate::stage::Context;
use std::path::{Path, PathBuf};

const CHECK: &str = "check the file, or leave out the setting";

/// The reference pictures named in the settings; `None` if there are none.
pub fn read_reference(ctx: &Context) -> Result<Option<Reference>> {
    let settings = &ctx.pipeline.evaluate;
    if settings.reference.is_none() {
        return Ok(None);
    }
    for path in [&settings.reference, &settings.reference_empty, &settings.reference_mask] {
        path.as_ref().map(|p| ctx.user_file(p)).transpose()?;
    }
    if settings.reference_empty.is_none() {
        ctx.warn("no `evaluate.reference_empty`: the plate stands in, its noise counts as error");
    }
    if settings.reference_mask.is_none() {
        ctx.warn("no `evaluate.reference_mask`: the object is taken to be where ours is");
    }
    reference_in(ctx.base, settings)
}

/// The same outside of a stage; paths start at `base`.
pub fn reference_in(base: &Path, settings: &config::Evaluate) -> Result<Option<Reference>> {
    let picture = |path: &PathBuf| exr::read_radiance(&base.join(path));
    let Some(with) = &settings.reference else { return Ok(None) };
    Ok(Some(Reference {
        with: picture(with)?,
        empty: settings.reference_empty.as_ref().map(picture).transpose()?,
        mask: settings.reference_mask.as_ref().map(|p| read_mask(&base.join(p))).transpose()?,
    }))
}

fn read_mask(path: &Path) -> Result<Image<f32>> {
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
    ctx.user_file(path)?;
    truth_at(&ctx.base.join(path)).map(Some)
}

/// A `truth.json`.
pub fn truth_at(path: &Path) -> Result<Truth> {
    let refuse = |e: String| Error::file("reading the truth", path, e, CHECK);
    let bytes = std::fs::read(path).map_err(|e| refuse(e.to_string()))?;
    let value = serde_json::from_slice(&bytes).map_err(|e| refuse(format!("not JSON ({e})")))?;
    Ok(Truth::new(value))
}

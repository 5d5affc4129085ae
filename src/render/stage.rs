//! What the stage reads, tells and writes.

use super::{Frame, Object, load_object};
use crate::artefact::{exr, json};
use crate::composite::write_png;
use crate::config::ShadowMethod;
use crate::error::Result;
use crate::exposure::{self, Capture, Photograph};
use crate::image::CodeImage;
use crate::response::Response;
use crate::stage::{Context, Input, digest_file};
use std::path::{Path, PathBuf};

/// More light than this whose shadow is not sought is worth a word, as a share.
const MOST_LEFT_OUT: f64 = 0.5;

/// Figures and warnings of a frame.
pub fn report(ctx: &Context, frame: &Frame) {
    let Frame { removed, shaded, .. } = frame;
    ctx.figure("shadow_s", frame.shadow_s);
    ctx.figure("sources_used", removed.sources_used);
    ctx.figure("passes", removed.passes);
    ctx.figure("shadow_maps", removed.shadow_maps);
    ctx.figure("left_out_share", removed.left_out_share);
    if removed.left_out_share > MOST_LEFT_OUT {
        ctx.warn(format!(
            "the shadow of {:.0} % of the light is left out: render.method = \"radiance-transfer\" takes light of any shape",
            100.0 * removed.left_out_share
        ));
    }
    if let Some(error) = removed.expected_error {
        ctx.figure("expected_shadow_error", error);
    }
    if let Some(noise) = removed.noise {
        ctx.figure("shadow_noise", noise);
    }
    ctx.figure("shade_s", frame.shade_s);
    ctx.figure("object_visible_px", shaded.rendered.visible_px);
    ctx.figure("object_hidden_px", shaded.rendered.hidden_px);
    frame.warnings.iter().for_each(|w| ctx.warn(w));
    if shaded.rendered.visible_px == 0.0 {
        ctx.warn("no pixel shows the object: the scene hides it");
    }
}

/// What `composite` puts into the plate.
pub fn write_layers(ctx: &Context, suffix: &str, Frame { removed, shaded, .. }: &Frame) -> Result<()> {
    let file = |name: &str, kind: &str| ctx.output(&format!("{name}{suffix}.{kind}"));
    exr::write_radiance(&file("removed", "exr"), &removed.epsilon)?;
    exr::write_radiance(&file("reflected", "exr"), &shaded.reflected)?;
    if let Some(codes) = &removed.codes {
        write_png(&file("codes", "png"), codes)?;
    }
    exr::write(&file("object", "exr"), &shaded.rendered.layer.to_planes(), exr::Kind::Picture)
}

/// The folder of an earlier stage, all named files of which are read.
pub fn folder(ctx: &Context, stage: &str, files: &[&str]) -> Result<PathBuf> {
    let paths = files.iter().map(|f| ctx.artefact(stage, f)).collect::<Result<Vec<_>>>()?;
    Ok(paths.first().and_then(|p| p.parent()).unwrap_or(Path::new("")).to_path_buf())
}

/// The plate's codes and the response, where the method works in codes and the plate has some.
pub fn stored(ctx: &Context) -> Result<Option<(CodeImage, Response)>> {
    if ctx.pipeline.render.method != ShadowMethod::RadianceTransferLdr {
        return Ok(None);
    }
    let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
    match exposure::load(ctx, &capture, capture.plate()?)? {
        Photograph::Codes(codes) => {
            Ok(Some((codes, json::read(&ctx.artefact("response", "response.json")?)?)))
        }
        Photograph::Linear(_) => Ok(None),
    }
}

/// The object with its material, and what its file needs.
pub fn load(ctx: &Context) -> Result<Object> {
    let settings = &ctx.pipeline.render;
    let object = load_object(&ctx.user_file(&settings.object)?, settings)?;
    for file in &object.files {
        ctx.depends_on(file, Input::File(digest_file(file)?));
    }
    object.warnings.iter().for_each(|w| ctx.warn(w));
    ctx.figure("object_triangles", object.triangles.len());
    Ok(object)
}

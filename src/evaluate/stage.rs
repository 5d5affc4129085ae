//! What the stage does: figures of all that earlier stages left, and the report.

use super::camera;
use super::gallery::{Gallery, gallery};
use super::radiometry::{self, Merging};
use super::references::{read_reference, read_truth};
use super::{
    Comparison, ErrorMap, Measured, Ours, Page, Reference, Report, check_bounds, compare, error_map, page,
};
use crate::artefact::exr::{self, Planes};
use crate::artefact::{json, remake};
use crate::calibrate::Cameras;
use crate::config::ProbeSource;
use crate::error::{Context as _, Error, FileContext, Result};
use crate::exposure::Capture;
use crate::image::{Image, Radiance, RadianceImage};
use crate::probe::ProbeFit;
use crate::render::Layer;
use crate::response::Response;
use crate::stage::{self, Context};

/// Judges a run and writes `report.html`, `.csv` and `.json`.
pub fn judge(ctx: &Context) -> Result<()> {
    check_bounds(&ctx.pipeline.evaluate.bounds)?;
    let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
    let response: Response = json::read(&ctx.artefact("response", "response.json")?)?;
    let merging = read_merging(ctx)?;
    let (plate, clipped) = plate_of(ctx, &merging.plate)?;
    let composite = exr::read_radiance(&ctx.artefact("composite", "augmented.exr")?)?;
    let path = ctx.artefact("render", "object.exr")?;
    let object = Layer::from_planes(&exr::read(&path)?).ok_or_else(|| {
        Error::file("reading the object's layer", &path, "lacks R, G, B, A or Z", remake(&path))
    })?;
    let ours = Ours { plate: &plate, composite: &composite, coverage: &object.coverage, clipped: &clipped };
    let (srgb, scale) = (Response::srgb(), ctx.pipeline.composite.exposure_ev.exp2());
    let linear = capture.plate()?.linear;
    let encode = |v: [f32; 3]| {
        if linear { srgb.code_of(v.map(|x| x * scale)) } else { response.code_of(v) }
    };
    let mut measured = Measured::default();
    let reference = read_reference(ctx)?;
    let path = ctx.pipeline.evaluate.reference.as_ref();
    let comparing = || format!("comparing with {}", path.map_or(String::new(), |p| p.display().to_string()));
    let comparison = match &reference {
        Some(r) => Some(compare(&ours, r, encode, &mut measured).doing(comparing())?),
        None => None,
    };
    let compared = reference.as_ref().zip(comparison.as_ref());
    let cameras: Cameras = json::read(&ctx.artefact("calibrate", "cameras.json")?)?;
    let notes = judge_stages(ctx, &response, &cameras, &ours, compared, &mut measured)?;
    let mut gallery = gallery(&ours, comparison.as_ref(), encode);
    let as_seen = &gallery.pictures[0].1;
    let sections =
        vec![camera::section(ctx, &cameras, as_seen)?, radiometry::section(&response, Some(&merging))?];
    gallery.maps.extend(light_residual(ctx)?);
    write(ctx, &measured, gallery, sections, notes)
}

/// What stage `merge` left.
fn read_merging(ctx: &Context) -> Result<Merging> {
    let residuals = match ctx.has_artefact("merge", "residuals.exr") {
        true => Some(exr::read(&ctx.artefact("merge", "residuals.exr")?)?),
        false => None,
    };
    let plate = exr::read(&ctx.artefact("merge", "plate.exr")?)?;
    Ok(Merging { manifest: ctx.manifest("merge")?, residuals, plate })
}

/// What the light model does not explain of the plate.
fn light_residual(ctx: &Context) -> Result<Option<(&'static str, ErrorMap)>> {
    if !ctx.has_artefact("illuminate", "predicted_plate.exr") {
        return Ok(None);
    }
    let planes = exr::read(&ctx.artefact("illuminate", "predicted_plate.exr")?)?;
    let Some(residual) = planes.plane("residual") else { return Ok(None) };
    let pixels = residual.iter().map(|v| Radiance([*v; 3])).collect();
    let residual = Image::from_pixels(planes.width, planes.height, pixels);
    let caption = "plate over what the light model predicts with one reflectance a face, stops: red where the plate is brighter, \
                   blue where darker; what is neither texture nor an edge is light in the wrong place";
    Ok(Some((caption, error_map(&residual, 1.0))))
}

/// The merged plate and where it is clipped.
fn plate_of(ctx: &Context, planes: &Planes) -> Result<(RadianceImage, Image<bool>)> {
    let path = ctx.artefact("merge", "plate.exr")?;
    let refuse = || Error::file("reading the plate", &path, "lacks R, G, B or clipped", remake(&path));
    let clipped = planes.plane("clipped").ok_or_else(refuse)?.iter().map(|c| *c > 0.5).collect();
    let clipped = Image::from_pixels(planes.width, planes.height, clipped);
    Ok((planes.radiance().ok_or_else(refuse)?, clipped))
}

/// Single stages against `truth.json`, if it is given. Returns remarks for the report.
fn judge_stages(
    ctx: &Context,
    response: &Response,
    cameras: &Cameras,
    ours: &Ours,
    compared: Option<(&Reference, &Comparison)>,
    out: &mut Measured,
) -> Result<Vec<String>> {
    let settings = &ctx.pipeline.evaluate;
    let Some(truth) = read_truth(ctx)? else {
        return Ok(compared.map(|_| "The noise of the reference is unknown.".into()).into_iter().collect());
    };
    let path = settings.truth.as_ref().map_or(String::new(), |p| p.display().to_string());
    let doing = || format!("judging stages against {path}");
    truth.judge_camera(cameras.plate_camera(), &cameras.plate, out).doing(doing())?;
    truth.judge_response(|c| response.exposure_of(c), out).doing(doing())?;
    let probe: ProbeFit = json::read(&ctx.artefact("probe", "probe.json")?)?;
    if probe.source == ProbeSource::Ball {
        truth.judge_ball(&probe.centre, out).doing(doing())?;
    }
    let Some((reference, comparison)) = compared else { return Ok(Vec::new()) };
    if let Some(empty) = &reference.empty {
        truth.judge_radiance(ours, empty, &cameras.plate, out).doing(doing())?;
    }
    let stem = settings.reference.as_ref().and_then(|p| p.file_stem()).unwrap_or_default();
    Ok(truth.judge_noise(&stem.to_string_lossy(), comparison, out).into_iter().collect())
}

fn write(
    ctx: &Context,
    measured: &Measured,
    gallery: Gallery,
    sections: Vec<String>,
    notes: Vec<String>,
) -> Result<()> {
    let (width, height) = gallery.size();
    let report = Report::new(measured, &ctx.pipeline.evaluate, [width, height]);
    if !report.judged {
        ctx.warn("no reference and no truth is given: there is nothing to judge against");
    }
    report.table().iter().for_each(|line| ctx.printer.say(line));
    for figure in &report.figures {
        ctx.figure(&figure.name, figure.value);
    }
    let earlier = stage::STAGES.iter().filter(|s| s.name != "evaluate");
    let stages = earlier.filter_map(|s| ctx.manifest(s.name).ok()).collect();
    let title = ctx.base.file_name().map_or("insitu".into(), |n| n.to_string_lossy().into_owned());
    let Gallery { pictures, maps } = gallery;
    let html = page(&Page { title: &title, report: &report, pictures, maps, stages, sections, notes })?;
    let write = |name: &str, text: &str| {
        let path = ctx.output(name);
        std::fs::write(&path, text).at("writing", &path)
    };
    write("report.html", &html)?;
    write("report.csv", &report.to_csv())?;
    json::write(&ctx.output("report.json"), &report)
}

//! The methods against the truth of rendered captures, with the true scene model: what the shadow algorithm, the patches
//! and the light's sampling cost, beside what two renderers reach on the same task.

use super::breakdown::true_workspace;
use super::{Static, triptych};
use crate::artefact::{exr, json};
use crate::composite::{composite, net};
use crate::config::Render;
use crate::driver::validate;
use crate::error::{Context as _, Error, Result};
use crate::evaluate::errors::common_error;
use crate::evaluate::references::{reference_in, truth_at};
use crate::evaluate::{Comparison, Measured, Ours, Reference, compare};
use crate::image::{Image, RadianceImage};
use crate::printer::Printer;
use crate::render::Layer;
use crate::response::Response;
use crate::shadow;
use crate::stage::Workspace;
use std::path::{Path, PathBuf};

/// Relative shadow errors of Cycles' shadow catcher lit by the true environment map (70–85 s on two cores) and of Mitsuba
/// at 64 samples (7–12 s) with the true camera, geometry and light, object on the floor (DESIGN.md §8).
const RENDERERS: [(&str, f64, f64); 3] =
    [("office", 0.12, 0.16), ("tablelamp", 0.41, 0.09), ("sunlit", 0.025, 0.04)];

/// Rays per pixel of each of the two ray-traced pictures; what they have in common is free of their noise.
const RAYS: usize = 32;

/// A settings file with true stages, run, and what it is to be compared with.
pub(super) struct Judged {
    pub workspace: Workspace,
    pub statics: Static,
    pub reference: Reference,
    object: Layer,
    /// Radiance that the plate gains from the object.
    reflected: RadianceImage,
    clipped: Image<bool>,
}

/// Figures of one ε against the truth.
pub(super) struct Verdict {
    pub comparison: Comparison,
    pub composite: RadianceImage,
    pub plate: RadianceImage,
    pub error: f64,
    pub bias: f64,
    /// Mean ꟻLIP of the picture.
    pub flip: f64,
    /// Share of the light that is gone at the darkest twentieth of the shadow: ours, and in truth.
    depth: [f64; 2],
}

impl Judged {
    pub fn read(file: &Path) -> Result<Self> {
        let workspace = true_workspace(file, "none", &[])?;
        let settings = &workspace.pipeline.evaluate;
        let reference = reference_in(&workspace.base, settings)?.ok_or_else(|| Error::Usage {
            problem: format!("{} names no true picture with the object", file.display()),
            hint: "give `evaluate.reference`".into(),
        })?;
        let reflected = exr::read_radiance(&workspace.folder("render").join("reflected.exr"))?;
        let path = workspace.folder("render").join("object.exr");
        let object = Layer::from_planes(&exr::read(&path)?)
            .ok_or_else(|| Error::Bug(format!("{} lacks planes", path.display())))?;
        let statics = Static::read(&workspace)?;
        let (width, height) = statics.plate.size();
        let clipped = Image::from_fn(width, height, |_, _| false);
        Ok(Self { workspace, statics, reference, object, reflected, clipped })
    }

    /// What the object takes by its shadow less what it gives by its light.
    pub fn net(&self, removed: &RadianceImage) -> Result<RadianceImage> {
        net(removed, &self.reflected).doing("adding the object's light")
    }

    /// Compares the plate less ε (net), with the object in it, with the truth.
    pub fn verdict(&self, epsilon: &RadianceImage) -> Result<Verdict> {
        let plate = &self.statics.plate;
        let composite = composite(plate, epsilon, &self.object).doing("compositing")?.radiance;
        let (coverage, clipped) = (&self.object.coverage, &self.clipped);
        let ours = Ours { plate, composite: &composite, coverage, clipped };
        let mut measured = Measured::default();
        let comparison =
            compare(&ours, &self.reference, |v| v, &mut measured).doing("comparing with the truth")?;
        let figures = measured.figures(&Default::default());
        let value =
            |name: &str| figures.iter().find(|f| f.name == name).and_then(|f| f.value).unwrap_or(f64::NAN);
        let depth = [epsilon, &removed_in_truth(plate, epsilon, &comparison.removal_error)]
            .map(|removed| depth(plate, removed, &comparison.shadow_region));
        Ok(Verdict {
            error: value("relative_shadow_error"),
            bias: value("shadow_energy_bias"),
            flip: value("flip"),
            depth,
            comparison,
            composite,
            plate: plate.clone(),
        })
    }
}

/// What rays reach on the true scene: the error that no sampling of the shadow can take away.
struct Traced {
    error: f64,
    bias: f64,
    /// By channel: light that the object sends back has its colour.
    tint: [f64; 3],
}

impl Judged {
    fn traced(&self) -> Result<Traced> {
        let trace = |seed| {
            let settings = Render { rays: RAYS, seed, ..self.workspace.pipeline.render.clone() };
            shadow::raytraced(&self.statics.scene(), &self.statics.occluder(), &settings)
                .doing("tracing the shadow")
        };
        let (a, b) = (self.net(&trace(1)?.epsilon)?, self.net(&trace(2)?.epsilon)?);
        let (of_a, of_b) = (self.verdict(&a)?, self.verdict(&b)?);
        let truth = removed_in_truth(&self.statics.plate, &a, &of_a.comparison.removal_error);
        let error = common_error([&a, &b], &truth, &of_a.comparison.shadow_region).unwrap_or(f64::NAN);
        let tint = [0, 1, 2].map(|k| {
            let sum = |image: &RadianceImage| {
                let inside = image.pixels().iter().zip(of_a.comparison.shadow_region.pixels());
                inside.filter(|(_, r)| **r).map(|(p, _)| f64::from(p.0[k])).sum::<f64>()
            };
            (sum(&a) + sum(&b)) / 2.0 / sum(&truth) - 1.0
        });
        Ok(Traced { error, bias: (of_a.bias + of_b.bias) / 2.0, tint })
    }
}

/// Whether a settings file names a true picture with the object and the true scene.
pub(super) fn has_truth(file: &Path) -> Result<bool> {
    let evaluate = Workspace::open(file)?.pipeline.evaluate;
    Ok(evaluate.reference.is_some() && evaluate.truth.is_some())
}

/// ε* = ε − (ε − ε*).
fn removed_in_truth(plate: &RadianceImage, epsilon: &RadianceImage, error: &RadianceImage) -> RadianceImage {
    let (width, height) = plate.size();
    Image::from_fn(width, height, |x, y| {
        let (e, d) = (epsilon.at(x, y).0, error.at(x, y).0);
        crate::image::Radiance(std::array::from_fn(|k| e[k] - d[k]))
    })
}

/// 95th percentile of ε over the plate's radiance, by luminance; the median of each pixel's neighbours takes out noise.
fn depth(plate: &RadianceImage, removed: &RadianceImage, region: &Image<bool>) -> f64 {
    let mut shares: Vec<f64> = (0..plate.pixels().len())
        .filter(|&i| region.pixels()[i] && plate.pixels()[i].luminance() > 0.0)
        .map(|i| f64::from(removed.pixels()[i].luminance() / plate.pixels()[i].luminance()))
        .collect();
    shares.sort_by(f64::total_cmp);
    shares.get(shares.len() * 95 / 100).copied().unwrap_or(f64::NAN)
}

/// Prints a line for each settings file; writes truth, ours and difference into a folder, if one is given.
pub(super) fn print(settings: &[PathBuf], pictures: Option<&Path>, printer: &Printer) -> Result<()> {
    printer.data("\nwith the true camera, plate, scene and light: relative shadow error, energy bias (%), time of the shadow (s); raytraced:\nwithout its own noise, bias also by channel;");
    printer.data("noise: of the truth; depth: share of light gone in the darkest twentieth of the shadow, ours and truth;");
    printer
        .data("Cycles, Mitsuba: their errors with the same truth given, object on the floor (DESIGN.md §8)");
    let width = settings.iter().map(|s| validate::name(s).len()).max().unwrap_or(0).max(7);
    printer.data(&format!(
        "{:<width$}{:>22}{:>34}{:>8}{:>14}{:>8}{:>9}",
        "capture", "by the settings", "raytraced", "noise", "depth", "Cycles", "Mitsuba"
    ));
    for file in settings {
        if !has_truth(file)? {
            printer.data(&format!(
                "{name:<width$}  without a true picture: left out",
                name = validate::name(file)
            ));
            continue;
        }
        let judged = Judged::read(file)?;
        let workspace = &judged.workspace;
        let ours = exr::read_radiance(&workspace.folder("render").join("removed.exr"))?;
        let took = workspace.manifest("render")?.figures.get("shadow_s").and_then(|v| v.as_f64());
        let ours = judged.verdict(&judged.net(&ours)?)?;
        let traced = judged.traced()?;
        let tint = traced.tint.map(|b| format!("{:+.1}", 100.0 * b)).join(" ");
        let truth_file = workspace.pipeline.evaluate.truth.as_ref().map(|p| workspace.base.join(p));
        let truth = truth_file.as_deref().map(truth_at).transpose()?;
        let stem = workspace.pipeline.evaluate.reference.as_ref().and_then(|p| p.file_stem());
        let noise = truth.as_ref().zip(stem).zip(ours.comparison.rms_and_mean).and_then(
            |((t, stem), (rms, mean))| Some(t.difference_noise(&stem.to_string_lossy())? * mean / rms),
        );
        let name = validate::name(file);
        let beside = RENDERERS.iter().find(|(scene, ..)| {
            !name.contains('/') && truth.as_ref().is_some_and(|t| t.scene_name() == *scene)
        });
        let number = |v: Option<f64>| v.map_or("-".into(), |v| format!("{v:.3}"));

        printer.data(&format!(
            "{name:<width$}{:>22}{:>34}{:>8}{:>14}{:>8}{:>9}",
            format!("{:.3} {:>+6.1} {:>6.2}", ours.error, 100.0 * ours.bias, took.unwrap_or(f64::NAN)),
            format!("{:.3} {:>+6.1} ({})", traced.error, 100.0 * traced.bias, tint),
            number(noise),
            format!("{:.2} / {:.2}", ours.depth[0], ours.depth[1]),
            number(beside.map(|b| b.1)),
            number(beside.map(|b| b.2)),
        ));
        if let Some(folder) = pictures {
            let response: Response = json::read(&workspace.folder("response").join("response.json"))?;
            let path = folder.join(format!("{}.jpg", name.replace('/', "_")));
            triptych::write(&path, &name, &ours, |v| response.code_of(v))?;
            printer.data(&path.display().to_string());
        }
    }
    Ok(())
}

//! The method on captures: ε by slices, filters and rules against the ray-traced reference on the same scene model.

use super::super::Static;
use super::super::subject::Subject;
use crate::config::{Combination, OcclusionFilter, Render, ShadowMethod};
use crate::driver::run::{self, Range};
use crate::driver::validate;
use crate::error::{Context as _, Result};
use crate::image::{Image, Radiance, RadianceImage};
use crate::occlusion::PlateShadow;
use crate::printer::Printer;
use crate::shadow::{Removed, Session};
use crate::stage::Workspace;
use crate::visibility::Bvh;
use glam::Vec3;
use nalgebra::Point2;
use std::path::PathBuf;
use std::time::Instant;

/// Rays a pixel of the reference, and to each rectangle.
const REFERENCE: usize = 256;
const RAYS: usize = 256;

/// Prints a table for each settings file; one whose light has no rectangle is left out with a word.
pub(super) fn print(settings: &[PathBuf], frames: usize, printer: &Printer) -> Result<()> {
    for file in settings {
        let workspace = Workspace::open(file)?;
        run::stages(&workspace, &Range::default(), printer)?;
        let statics = Static::read(&workspace)?;
        let subject = Subject::capture(validate::name(file), &statics, &workspace.pipeline.render);
        let covered = covered(&statics);
        table(&subject, &covered, frames, printer)?;
    }
    Ok(())
}

/// Pixels whose centre shows the object.
fn covered(statics: &Static) -> Image<bool> {
    let (camera, object) = (statics.cameras.plate_camera(), &statics.object);
    let bvh = Bvh::new(&object.vertices, &object.triangles);
    let (width, height) = statics.plate.size();
    Image::from_fn(width, height, |x, y| {
        let ray = camera.ray(&Point2::new(x as f64 + 0.5, y as f64 + 0.5));
        let (from, along) = (ray.origin.coords, ray.direction);
        let [from, along] = [[from.x, from.y, from.z], [along.x, along.y, along.z]]
            .map(|v| Vec3::from_array(v.map(|c| c as f32)));
        bvh.any_hit(from, along, 0.0, f32::INFINITY)
    })
}

fn table(subject: &Subject, covered: &Image<bool>, frames: usize, printer: &Printer) -> Result<()> {
    let base = Render { method: ShadowMethod::OcclusionTextures, ..subject.settings.clone() };
    let method = match PlateShadow::prepare(&subject.scene, &base) {
        Ok(method) => method,
        Err(problem) => {
            printer.data(&format!("\n{}: {problem}", subject.name));
            return Ok(());
        }
    };
    let sides = method.lights().iter().map(|l| {
        let [u, v] = l.half.map(|h| 2.0 * h.length());
        format!("{u:.2}×{v:.2} m")
    });
    let reference = subject.traced(REFERENCE, subject.settings.seed ^ 0x5eed)?;
    let (width, height) = subject.scene.plate.size();
    printer.data(&format!(
        "\n{}: {width}×{height} px; rectangles: {}; relative shadow error and energy bias against {REFERENCE} rays a pixel \
         from all light (noise {:.3}),\neverywhere and where the object does not stand before the shadow; ms, medians of {frames} \
         frames\n{:<44}{:>9}{:>9}{:>9}{:>9}{:>9}",
        subject.name,
        sides.collect::<Vec<_>>().join(", "),
        reference.noise.unwrap_or(0.0),
        "",
        "time",
        "error",
        "bias %",
        "beside",
        "bias %"
    ));
    let beside = |image: &RadianceImage| {
        let pixels = image.pixels().iter().zip(covered.pixels());
        let pixels = pixels.map(|(e, covered)| if *covered { Radiance::default() } else { *e });
        Image::from_pixels(width, height, pixels.collect())
    };
    let tell = |name: &str, removed: &Removed, ms: f64| {
        let all = subject.errors(&removed.epsilon, &reference.epsilon);
        let seen = subject.errors(&beside(&removed.epsilon), &beside(&reference.epsilon));
        let cells = [all, seen].map(|(error, bias)| format!("{error:>9.3}{:>+9.1}", 100.0 * bias)).concat();
        printer.data(&format!("{name:<44}{ms:>9.1}{cells}"));
    };
    let mut rows: Vec<(String, Render)> = Vec::new();
    for slices in [4, 8, 16] {
        rows.push((format!("{slices} slices, summed-area, product"), Render { slices, ..base.clone() }));
    }
    let of = |name: &str, settings: Render| (format!("16 slices, {name}"), Render { slices: 16, ..settings });
    rows.extend([
        of("summed-area, maximum", Render { combination: Combination::Maximum, ..base.clone() }),
        of("summed-area, sum", Render { combination: Combination::Sum, ..base.clone() }),
        of("summed-area, product, leaks closed", Render { close_leaks: true, ..base.clone() }),
        of("mipmap, product", Render { occlusion_filter: OcclusionFilter::Mipmap, ..base.clone() }),
        of("N-buffers, product", Render { occlusion_filter: OcclusionFilter::NBuffers, ..base.clone() }),
    ]);
    for (name, settings) in rows {
        let mut session = Session::prepare(&subject.scene, &settings).doing("preparing the shadow method")?;
        let mut frame = || session.frame(&subject.occluder).doing("finding the shadow");
        let removed = frame()?.removed;
        let ms = (0..frames).map(|_| Ok(1e3 * frame()?.seconds)).collect::<Result<Vec<_>>>()?;
        tell(&name, &removed, super::median(ms.into_iter()));
    }
    let shot = subject.passes(subject.settings.passes, frames)?;
    let name = format!("radiance-transfer, {} passes", shot.removed.passes);
    tell(&name, &shot.removed, super::median(shot.ms.into_iter()));
    let started = Instant::now();
    let traced = method.traced(&subject.occluder, RAYS).doing("tracing the rectangles")?;
    tell(&format!("the same rectangles by {RAYS} rays"), &traced, started.elapsed().as_secs_f64() * 1e3);
    Ok(())
}

//! All shadow methods on captures with truth, each by its knob: what they cost and how far they are from rays on the same scene
//! model, and from the true picture with the object.

use super::spread;
use super::subject::Subject;
use super::truth::{Judged, has_truth};
use crate::artefact::json;
use crate::config::{Render, ShadowMethod};
use crate::driver::validate;
use crate::error::Result;
use crate::image::Code;
use crate::printer::Printer;
use crate::response::Response;
use crate::shadow::{Scene, Stored};
use std::path::PathBuf;

/// Rays per pixel of the reference.
const REFERENCE: usize = 1024;

/// A method, and what opens its knob.
const ROWS: [(&str, ShadowMethod, Knob); 18] = {
    use Knob::{Lights, Passes, Rays, Slices, Texels};
    use ShadowMethod::{
        LightDome, OcclusionTextures, RadianceTransfer, RadianceTransferLdr, Raytraced, Subtractive,
    };
    [
        ("radiance-transfer", RadianceTransfer, Passes(10)),
        ("radiance-transfer", RadianceTransfer, Passes(50)),
        ("radiance-transfer", RadianceTransfer, Passes(200)),
        ("radiance-transfer", RadianceTransfer, Passes(0)),
        ("radiance-transfer-ldr", RadianceTransferLdr, Passes(10)),
        ("radiance-transfer-ldr", RadianceTransferLdr, Passes(50)),
        ("subtractive", Subtractive, Lights(15)),
        ("subtractive", Subtractive, Lights(50)),
        ("subtractive", Subtractive, Lights(200)),
        ("subtractive", Subtractive, Lights(1000)),
        ("occlusion-textures", OcclusionTextures, Slices(4)),
        ("occlusion-textures", OcclusionTextures, Slices(16)),
        ("light-dome", LightDome, Texels(2)),
        ("light-dome", LightDome, Texels(4)),
        ("light-dome", LightDome, Texels(8)),
        ("raytraced", Raytraced, Rays(16)),
        ("raytraced", Raytraced, Rays(64)),
        ("raytraced", Raytraced, Rays(256)),
    ]
};

#[derive(Clone, Copy)]
enum Knob {
    Passes(usize),
    Lights(usize),
    Slices(usize),
    Texels(usize),
    Rays(usize),
}

impl Knob {
    fn settings(self, method: ShadowMethod, base: &Render) -> Render {
        let base = Render { method, ..base.clone() };
        match self {
            Self::Passes(passes) => Render { passes, ..base },
            Self::Lights(lights) => Render { lights, ..base },
            Self::Slices(slices) => Render { slices, ..base },
            Self::Texels(dome_texels) => Render { dome_texels, ..base },
            Self::Rays(rays) => Render { rays, ..base },
        }
    }

    fn name(self) -> String {
        match self {
            Self::Passes(0) => "a source each".into(),
            Self::Passes(n) => format!("{n} passes"),
            Self::Lights(n) => format!("{n} lights"),
            Self::Slices(n) => format!("{n} slices"),
            Self::Texels(n) => format!("{n}×{n} texels"),
            Self::Rays(n) => format!("{n} rays"),
        }
    }
}

/// Prints a table for each settings file with truth.
pub(super) fn print(settings: &[PathBuf], frames: usize, printer: &Printer) -> Result<()> {
    printer.data(&format!(
        "\nshadow methods with the true camera, plate, scene and light ({frames} frames; ms; memory above that before, MiB);\n\
         error and bias (%) against {REFERENCE} rays on the same model where they remove more than 2 %, and against the true\n\
         picture with the object; ꟻLIP of the whole picture against the truth"
    ));
    for file in settings {
        if has_truth(file)? {
            table(&validate::name(file), &Judged::read(file)?, frames, printer)?;
        } else {
            printer.data(&format!("{}: without a true picture, left out", validate::name(file)));
        }
    }
    Ok(())
}

fn table(name: &str, judged: &Judged, frames: usize, printer: &Printer) -> Result<()> {
    let (workspace, statics) = (&judged.workspace, &judged.statics);
    let response: Response = json::read(&workspace.folder("response").join("response.json"))?;
    let codes = statics.plate.map(|r| Code(response.code_of(r.0)));
    let stored = Some(Stored { codes: &codes, response: &response });
    let settings = &workspace.pipeline.render;
    let mut subject = Subject::capture(name.into(), statics, settings);
    subject.scene = Scene { stored, ..subject.scene };
    let reference = subject.traced(REFERENCE, settings.seed ^ 0x5eed)?;
    let (width, height) = statics.plate.size();
    let transfer = workspace.manifest("transfer")?;
    printer.data(&format!(
        "\n{name}: {width}×{height} px, {} sources; stage transfer {:.1} s, {:.0} MiB; noise of the rays {:.4}",
        statics.transfers.sources.len(),
        transfer.wall_s,
        transfer.peak_memory_mib,
        reference.noise.unwrap_or(0.0)
    ));
    printer.data(&format!(
        "{:<23}{:<15}{:>9}{:>9}{:>8}{:>10}{:>8}{:>12}{:>8}{:>9}",
        "method", "knob", "prepare", "frame", "MiB", "to rays", "bias", "to truth", "bias", "ꟻLIP"
    ));
    for (method, which, knob) in ROWS {
        let shot = subject.shot(&knob.settings(which, settings), frames);
        let row = format!("{method:<23}{:<15}", knob.name());
        let mut shot = match shot {
            Ok(shot) => shot,
            Err(refusal) => {
                printer.data(&format!("{row}  refused: {}", refusal));
                continue;
            }
        };
        let (error, bias) = subject.errors(&shot.removed.epsilon, &reference.epsilon);
        let verdict = judged.verdict(&judged.net(&shot.removed.epsilon)?)?;
        let [time, ..] = spread(&mut shot.ms);
        printer.data(&format!(
            "{row}{:>9.0}{time:>9.0}{:>8.0}{error:>10.4}{:>+8.1}{:>12.3}{:>+8.1}{:>9.4}",
            shot.prepared_ms,
            shot.memory_mib,
            100.0 * bias,
            verdict.error,
            100.0 * verdict.bias,
            verdict.flip
        ));
    }
    Ok(())
}

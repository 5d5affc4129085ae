//! Stage `irradiance`: the volume of incident light around the world's origin, and the prefiltered environment in its middle.

use insitu::artefact::exr;
use insitu::error::Context as _;
use insitu::illuminate::{read_light, read_sky};
use insitu::irradiance::Volume;
use insitu::render::prefiltered;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("irradiance", |ctx| {
        ctx.artefact("illuminate", "distant.json")?;
        let patches = ctx.artefact("illuminate", "patches.ply")?;
        let light = read_light(patches.parent().unwrap_or(&patches))?;
        let sky = read_sky(&ctx.artefact("illuminate", "distant.exr")?, &light)?;
        let support = ctx.pipeline.probe.support_m.unwrap_or(-ctx.pipeline.calibrate.thickness_m);
        let volume = Volume::build(&light, support, &ctx.pipeline.irradiance)
            .doing("building the irradiance volume")?;
        ctx.figure("nodes", volume.len());
        ctx.figure("nodes_inside_objects", volume.len() - volume.open_nodes());
        volume.write(&ctx.output("irradiance.ply"))?;
        let place = volume.middle().unwrap_or_default();
        ctx.figure("prefiltered_at_m", place.to_array());
        exr::write(
            &ctx.output("prefiltered.exr"),
            &prefiltered(&light, sky.as_ref(), place),
            exr::Kind::LatLong,
        )
    })
}

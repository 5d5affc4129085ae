//! Stage `transfer`: what each source sends to each receiver vertex.

use insitu::artefact::json;
use insitu::calibrate::Cameras;
use insitu::error::Context;
use insitu::illuminate;
use insitu::model::Scene;
use insitu::shadow::Receivers;
use insitu::transfer::{self, Finish};

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("transfer", |ctx| {
        let cameras: Cameras = json::read(&ctx.artefact("calibrate", "cameras.json")?)?;
        let folder = ctx.artefact("illuminate", "patches.ply")?.with_file_name("");
        ctx.artefact("illuminate", "distant.json")?;
        let light = illuminate::read_light(&folder)?;
        let scene: Scene = json::read(&ctx.artefact("model", "scene.json")?)?;
        let gloss: Vec<_> = scene.faces.iter().map(|f| f.gloss).collect();
        let finish = Finish::new(cameras.plate_camera(), &gloss);

        let receivers = Receivers::cast(cameras.plate_camera(), &light.mesh);
        let seen = receivers.pixels.pixels().iter().flatten().count();
        let pixels = receivers.pixels.pixels().len();
        if seen < pixels {
            let share = 100.0 * (pixels - seen) as f64 / pixels as f64;
            ctx.warn(format!(
                "{share:.1} % of the plate's pixels see no part of the model and get no shadow"
            ));
        }

        let bar = ctx.printer.progress("radiance transfers", receivers.seen.len() as u64);
        let transfers =
            transfer::solve_glossy(&light, &receivers, finish, &ctx.pipeline.transfer, || bar.inc(1))
                .doing("finding what light reaches the plate's surfaces")?;
        bar.finish_and_clear();

        ctx.figure("sources", transfers.sources.len());
        ctx.figure("sources_left_out", transfers.left_out);
        ctx.figure("left_out_share", transfers.left_out_share);
        ctx.figure(
            "strongest_source_share",
            transfers.sources.iter().map(|s| s.power_share).fold(0.0, f64::max),
        );
        ctx.figure("receiver_patches", transfers.receivers.patches.len());
        ctx.figure("receiver_vertices", transfers.receivers.positions.len());
        ctx.figure("largest_left_out_share", transfers.largest_left_out_share);
        ctx.figure("links", transfers.links.node.len());
        let counts = transfers.shaft_counts();
        ctx.figure("shafts", counts.shafts);
        ctx.figure("leaf_shafts", counts.leaves);
        transfers.write(&ctx.output(""))
    })
}

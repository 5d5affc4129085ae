//! Stage `illuminate`: carries the probe's and the plate's radiance onto a patch mesh.

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("illuminate", |ctx| {
        insitu::illuminate::put_light(ctx, |_| Ok(Default::default()))
    })
}

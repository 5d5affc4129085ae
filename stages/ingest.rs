//! Stage `ingest`: from a photo folder to `capture.json`. Looks at names and headers alone.

use insitu::artefact::json;
use insitu::error::Context as _;
use insitu::exposure::{self, Header};
use insitu::stage::Input;
use std::collections::BTreeMap;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("ingest", |ctx| {
        let settings = &ctx.pipeline.ingest;
        let folder = ctx.base.join(&settings.photos);
        let names = exposure::list(&folder)?;
        ctx.depends_on(&folder, Input::Listing(exposure::listing_digest(&folder)?));
        let roles = if settings.roles.is_empty() {
            ctx.warn("[ingest.roles] is empty: roles are taken from the file names");
            exposure::derive(&names)
        } else {
            exposure::assign(&names, &settings.roles).doing("sorting the photographs by role")?
        };
        let mut headers = BTreeMap::new();
        for (_, file) in &roles {
            let path = folder.join(file);
            let header = Header::read(&path)?;
            ctx.depends_on(&path, Input::Header(header.digest()?));
            headers.insert(file.clone(), header);
        }
        let (capture, warnings) =
            exposure::assemble(&roles, &headers, settings).doing("checking the photographs")?;
        warnings.into_iter().for_each(|w| ctx.warn(w));
        ctx.figure("photographs", headers.len());
        ctx.figure("plate_px", [capture.plate()?.width_px, capture.plate()?.height_px]);
        json::write(&ctx.output("capture.json"), &capture)
    })
}

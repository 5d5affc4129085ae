//! Stage `ingest`: from a photo folder to `capture.json`. Looks at names and headers alone, and at pixels
//! where neither settings nor names tell the roles.

use insitu::artefact::json;
use insitu::config::Role;
use insitu::error::{Context as _, Result};
use insitu::exposure::{self, Assignment, Header, role_name};
use insitu::stage::{Context, Input, digest_file};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("ingest", |ctx| {
        let settings = &ctx.pipeline.ingest;
        let folder = ctx.base.join(&settings.photos);
        let names = exposure::list(&folder)?;
        ctx.depends_on(&folder, Input::Listing(exposure::listing_digest(&folder)?));
        let (roles, looked_at) = if settings.roles.is_empty() {
            from_the_photographs(ctx, &folder, &names)?
        } else {
            (exposure::assign(&names, &settings.roles).doing("sorting the photographs by role")?, Vec::new())
        };
        let mut headers = BTreeMap::new();
        for (_, file) in &roles {
            let path = folder.join(file);
            let header = Header::read(&path)?;
            ctx.depends_on(&path, Input::Header(header.digest()?));
            headers.insert(file.clone(), header);
        }
        for path in looked_at {
            ctx.depends_on(&path, Input::File(digest_file(&path)?));
        }
        let (capture, warnings) =
            exposure::assemble(&roles, &headers, settings).doing("checking the photographs")?;
        warnings.into_iter().for_each(|w| ctx.warn(w));
        ctx.figure("photographs", headers.len());
        ctx.figure("plate_px", [capture.plate()?.width_px, capture.plate()?.height_px]);
        json::write(&ctx.output("capture.json"), &capture)
    })
}

/// Roles by the names, or else by what the photographs show; and those that had to be looked at.
fn from_the_photographs(
    ctx: &Context,
    folder: &Path,
    names: &[String],
) -> Result<(Assignment, Vec<PathBuf>)> {
    let named = exposure::derive(names);
    if named.iter().any(|(role, _)| *role == Role::Plate) {
        ctx.warn("[ingest.roles] is empty: roles are taken from the file names");
        return Ok((named, Vec::new()));
    }
    let (mut seen, mut looked_at) = (BTreeMap::new(), Vec::new());
    for name in names.iter().filter(|name| exposure::is_readable(name.as_ref())) {
        let path = folder.join(name);
        seen.insert(name.clone(), exposure::look(&path, Header::read(&path)?, &ctx.pipeline.calibrate)?);
        looked_at.push(path);
    }
    let guessed = exposure::guess(&seen);
    let listed = guessed.iter().map(|(role, files)| format!("{} {}", role_name(*role), files.join(", ")));
    ctx.warn(format!(
        "[ingest.roles] is empty and the names tell none: roles are guessed from what is seen: {}",
        listed.collect::<Vec<_>>().join("; ")
    ));
    let roles = guessed.into_iter().flat_map(|(role, files)| files.into_iter().map(move |f| (role, f)));
    Ok((roles.collect(), looked_at))
}

//! Stage `calibrate`: photographs of the grid, marked lines and marked primitives to lens and poses.

use insitu::annotations::Annotations;
use insitu::artefact::json;
use insitu::calibrate::joint::{self, Scene};
use insitu::calibrate::{self, Cameras, Evidence, Problem};
use insitu::camera::SharedCovariance;
use insitu::config::Role;
use insitu::error::{Context as _, Error, Result};
use insitu::exposure::{Capture, Photo};
use insitu::stage::Context;
use std::collections::BTreeMap;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("calibrate", |ctx| {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        let settings = &ctx.pipeline.calibrate;
        let plate = capture.plate()?;
        let annotations = Annotations::load(ctx)?;
        let lines = annotations.vanishing_lines.as_ref();

        let here: Vec<&Photo> = std::iter::once(plate)
            .chain(capture.with_role(Role::Brackets))
            .chain(capture.with_role(Role::PlateWithGrid))
            .collect();
        if let Some(lines) = lines.filter(|lines| here.iter().all(|p| p.file != lines.image)) {
            let image = lines.image.clone();
            return Err(Problem::OtherImage { image })
                .doing(format!("reading {}", ctx.pipeline.annotations.display()));
        }
        if let Some(from) = &settings.import {
            let cameras = calibrate::imported(ctx, &capture, &here, from)?;
            ctx.figure("focal_px", cameras.intrinsics.focal_px[0]);
            ctx.figure("focal_source", "import");
            return write(ctx, &cameras);
        }
        let grids = calibrate::greys(ctx, &capture, plate, capture.with_role(Role::Grid))?;
        let mut plate_grids = calibrate::greys(ctx, &capture, plate, capture.with_role(Role::PlateWithGrid))?;
        // Edges are searched in it where none are marked.
        let unmarked = lines.is_none_or(|lines| !lines.has_edges());
        let plate_grey = if unmarked || plate_grids.is_empty() {
            calibrate::greys(ctx, &capture, plate, std::iter::once(plate))?
        } else {
            Vec::new()
        };
        if plate_grids.is_empty() {
            // The grid may lie in the plate itself.
            plate_grids.clone_from(&plate_grey);
        }
        let evidence = Evidence {
            width_px: plate.width_px,
            height_px: plate.height_px,
            grids: &grids,
            plate_grids: &plate_grids,
            stated_focal_px: capture.approximate_focal_px(plate),
            lines,
            plate: plate_grey.first().map(|(_, image)| image),
        };
        let names = |photos: &[&Photo]| photos.iter().map(|p| p.file.clone()).collect::<Vec<_>>();
        let size = (plate.width_px, plate.height_px);
        let own_pose = [Role::Plate, Role::Frames];
        let others = own_pose.iter().flat_map(|role| capture.with_role(*role));
        let others =
            others.filter(|p| (p.width_px, p.height_px) == size && here.iter().all(|h| h.file != p.file));
        let scene = Scene {
            primitives: &annotations.primitive,
            ground_y: -settings.thickness_m,
            settings: &ctx.pipeline.model,
            here: &names(&here),
            others: &names(&others.collect::<Vec<_>>()),
        };
        let joint = joint::solve(&evidence, settings, &scene)
            .doing(format!("finding lens and pose of {}", plate.file))?;
        let found = joint.solution;

        found.warnings.iter().for_each(|warning| ctx.warn(warning));
        let intrinsics = &found.plate.camera.intrinsics;
        ctx.figure("focal_px", intrinsics.focal_px[0]);
        ctx.figure("focal_sigma_px", found.focal_sigma_px);
        ctx.figure("focal_source", found.focal_source);
        let alone = found.edges.as_ref().filter(|_| found.focal_source != "vanishing_lines and exif");
        ctx.figure("focal_from_lines_px", alone.map(|e| e.room.focal_px));
        ctx.figure("focal_from_lines_sigma_px", alone.map(|e| e.focal_sigma_px()));
        ctx.figure("principal_point_px", intrinsics.principal_point_px);
        ctx.figure("distortion", intrinsics.distortion);
        ctx.figure("lens_condition", found.lens.as_ref().map(|l| l.fit.condition));
        ctx.figure("lens_rms_px", found.lens.as_ref().map(|l| l.fit.rms_px));
        ctx.figure("lens_parts_dropped", found.lens.as_ref().map(|l| l.dropped.join(", ")));
        ctx.figure("rms_px", found.plate.rms_px);
        ctx.figure("lines_rms_px", found.edge_rms_px);
        let covariance = found.plate.covariance.as_ref();
        ctx.figure("plate_position_sigma_m", covariance.map(|c| c.position_sigma_m()));
        ctx.figure(
            "plate_rotation_sigma_deg",
            covariance.map(|c| c.rotation_sigma_rad().map(f64::to_degrees)),
        );

        ctx.figure("joint_marks", joint.marks);
        ctx.figure("joint_marks_rms_px", joint.marks_rms_px);
        ctx.figure("joint_places", 1 + joint.others.len());

        let mut posed: BTreeMap<_, _> = here.iter().map(|p| (p.file.clone(), found.plate.clone())).collect();
        posed.extend(joint.others);
        let cameras = Cameras::new(plate.file.clone(), posed, found.focal_sigma_px);
        let mut cameras = cameras.ok_or_else(|| Error::Bug("the plate has no pose".into()))?;
        let alone = || Some(SharedCovariance::of_one(names(&here), found.plate.covariance.as_ref()?));
        cameras.shared = joint.shared.or_else(alone);
        write(ctx, &cameras)
    })
}

fn write(ctx: &Context, cameras: &Cameras) -> Result<()> {
    calibrate::export(ctx, cameras)?;
    json::write(&ctx.output("cameras.json"), cameras)
}

//! Stage `model`: marks to primitives, faces and a glTF scene.

use insitu::annotations::Annotations;
use insitu::artefact::json;
use insitu::calibrate::Cameras;
use insitu::camera::Camera;
use insitu::config::{ProbeSource, Role};
use insitu::error::Context as _;
use insitu::exposure::{self, Capture};
use insitu::model::{self, Fitter, Off, Views, room, sight::Ball};
use insitu::probe::ProbeFit;
use std::collections::BTreeMap;

fn main() -> std::process::ExitCode {
    insitu::cli::stage_main("model", |ctx| {
        let capture: Capture = json::read(&ctx.artefact("ingest", "capture.json")?)?;
        let cameras: Cameras = json::read(&ctx.artefact("calibrate", "cameras.json")?)?;
        let annotations = Annotations::load(ctx)?;
        let mut views: BTreeMap<String, Camera> =
            cameras.cameras.iter().map(|(file, posed)| (file.clone(), posed.camera.clone())).collect();
        let mut ball = None;
        if ctx.has_artefact("probe", "probe.json") {
            let probe: ProbeFit = json::read(&ctx.artefact("probe", "probe.json")?)?;
            if probe.source == ProbeSource::Ball {
                ball = Some(Ball { centre: probe.centre, radius_m: probe.radius_m });
                // All exposures of a view were taken from one place.
                let files = capture.with_role(Role::Probe).map(|p| &p.file);
                let of_view = files.filter(|f| probe.photographs.is_empty() || probe.photographs.contains(f));
                views.extend(of_view.map(|f| (f.clone(), probe.camera.clone())));
            }
        }
        let doing = || format!("fitting the scene to {}", ctx.pipeline.annotations.display());
        let ground_y = -ctx.pipeline.calibrate.thickness_m;
        let settings = &ctx.pipeline.model;
        let plate = (cameras.plate.as_str(), cameras.plate_camera());
        let photograph = || exposure::load(ctx, &capture, capture.plate()?);
        let (primitives, rooms) =
            room::searched(&annotations.primitive, plate, photograph, ground_y, settings)?.doing(doing())?;
        rooms.iter().flat_map(|room| room.told()).for_each(|words| ctx.warn(words));
        let views = Views { cameras: &views, ball, ground_y, rooms: &rooms };
        let fitter = Fitter::new(&primitives, &views, settings).doing(doing())?;
        let mut fitter = fitter.with_cameras_known_to(cameras.shared.as_ref());
        let scene = fitter.scene().doing(doing())?;
        for Off { name, corner, image, px, .. } in fitter.outlying() {
            ctx.warn(format!("the mark `{corner}` of `{name}` in {image} is {px:.1} px off what the others say, and hardly counts"));
        }

        ctx.figure("rms_px", scene.rms_px);
        ctx.figure("faces", scene.faces.len());
        for primitive in &scene.primitives {
            ctx.figure(&format!("{}_rms_px", primitive.name), primitive.rms_px);
            ctx.figure(&format!("{}_size_m", primitive.name), &primitive.size_m);
            ctx.figure(&format!("{}_size_sigma_m", primitive.name), &primitive.size_sigma_m);
            ctx.figure(&format!("{}_corner_sigma_m", primitive.name), primitive.corner_sigma_m);
            for face in &primitive.faces {
                let name = format!("{}_{}", primitive.name, face.side);
                ctx.figure(&format!("{name}_distance_m"), face.distance_m);
                ctx.figure(&format!("{name}_sigma_m"), face.sigma_m);
            }
        }
        json::write(&ctx.output("scene.json"), &scene)?;
        model::export(ctx, &scene, &cameras, &capture.photos, &[])
    })
}

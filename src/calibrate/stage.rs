//! What the stage reads: brightness of photographs; and what it exchanges with other programs: cameras that they found, and ours
//! for them.

use super::exchange::{self, Posed, colmap, fspy};
use super::{Cameras, PosedCamera, Problem};
use crate::error::{Context as _, Error, FileContext, Result};
use crate::exposure::{self, Capture, Photo};
use crate::image::Image;
use crate::stage::Context;
use std::collections::BTreeMap;
use std::path::Path;

/// Brightness of photographs; one of another size has another lens and is left out.
pub fn greys<'a>(
    ctx: &Context,
    capture: &Capture,
    plate: &Photo,
    photos: impl Iterator<Item = &'a Photo>,
) -> Result<Vec<(String, Image<u8>)>> {
    let mut all = Vec::new();
    for photo in photos {
        if (photo.width_px, photo.height_px) != (plate.width_px, plate.height_px) {
            let (w, h) = (photo.width_px, photo.height_px);
            ctx.warn(format!("{} is not used: it is {w}×{h} px, not of the plate's size", photo.file));
            continue;
        }
        let grey = super::grey_of(&exposure::load(ctx, capture, photo)?);
        all.push((photo.file.clone(), grey));
    }
    Ok(all)
}

/// The cameras of another program, as `calibrate.import` names them: a folder with a model of COLMAP, or a project of fSpy.
/// `here`: photographs from the plate's place.
pub fn imported(ctx: &Context, capture: &Capture, here: &[&Photo], from: &Path) -> Result<Cameras> {
    let doing = || format!("reading the cameras of {}", from.display());
    let plate = capture.plate()?;
    let all = if from.extension().is_some_and(|e| e == "fspy") {
        let path = ctx.user_file(from)?;
        let bytes = std::fs::read(&path).at(&doing(), &path)?;
        vec![Posed { image: plate.file.clone(), camera: fspy::read(&bytes).doing(doing())? }]
    } else {
        model_of_colmap(ctx, from).and_then(|read| read.doing(doing()))?
    };
    let name = |file: &str| Path::new(file).file_name().map(|n| n.to_string_lossy().into_owned());
    let found = |photo: &Photo| all.iter().find(|p| name(&p.image) == name(&photo.file));
    let own = found(plate).ok_or_else(|| Problem::NotImported { plate: plate.file.clone() }).doing(doing())?;
    let size = |p: &Photo| [p.width_px, p.height_px];
    let lens = &own.camera.intrinsics;
    if [lens.width_px, lens.height_px] != size(plate) {
        let theirs = [lens.width_px, lens.height_px];
        return Err(Problem::OtherSize {
            plate: plate.file.clone(),
            plate_px: size(plate),
            theirs_px: theirs,
        })
        .doing(doing());
    }
    let posed = |posed: &Posed| PosedCamera {
        camera: posed.camera.clone(),
        rms_px: 0.0,
        covariance: None,
        rival_rms_px: None,
    };
    let mut cameras: BTreeMap<String, PosedCamera> =
        capture.images.iter().filter_map(|p| Some((p.file.clone(), posed(found(p)?)))).collect();
    cameras.extend(here.iter().map(|p| (p.file.clone(), posed(own))));
    ctx.warn(format!("lens and poses are those of {}: their accuracy is not known", from.display()));
    Cameras::new(plate.file.clone(), cameras, None).ok_or_else(|| Error::Bug("the plate has no pose".into()))
}

fn model_of_colmap(
    ctx: &Context,
    folder: &Path,
) -> Result<std::result::Result<Vec<Posed>, exchange::Problem>> {
    const READING: &str = "reading a model of COLMAP";
    let binary = ctx.base.join(folder).join("images.bin").exists();
    let files = if binary { ["cameras.bin", "images.bin"] } else { ["cameras.txt", "images.txt"] };
    let [cameras, images] = files.map(|f| {
        let path = ctx.user_file(&folder.join(f))?;
        std::fs::read(&path).at(READING, &path)
    });
    let (cameras, images) = (cameras?, images?);
    Ok(if binary {
        colmap::read_binary(&cameras, &images)
    } else {
        colmap::read_text(&String::from_utf8_lossy(&cameras), &String::from_utf8_lossy(&images))
    })
}

/// Writes `colmap/cameras.txt`, `images.txt` and an empty `points3D.txt`.
pub fn export(ctx: &Context, cameras: &Cameras) -> Result<()> {
    let all: Vec<Posed> = (cameras.cameras.iter())
        .map(|(image, posed)| Posed { image: image.clone(), camera: posed.camera.clone() })
        .collect();
    let [lenses, images] = colmap::write_text(&all);
    let folder = ctx.output("colmap");
    std::fs::create_dir_all(&folder).at("making a folder", &folder)?;
    for (name, text) in [("cameras.txt", lenses), ("images.txt", images), ("points3D.txt", String::new())] {
        let path = folder.join(name);
        std::fs::write(&path, text).at("writing", &path)?;
    }
    Ok(())
}

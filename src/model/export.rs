//! What a stage writes of the scene for other programs: `scene.glb`, and what opens it in Blender.

use super::Scene;
use super::gltf::{self, Light, OPEN_IN_BLENDER, View};
use crate::calibrate::Cameras;
use crate::error::{FileContext, Result};
use crate::stage::Context;
use std::path::{Component, Path, PathBuf};

/// Writes both. Photographs taken from one place have one camera; `photos` is their folder, from that of the settings.
pub fn export(
    ctx: &Context,
    scene: &Scene,
    cameras: &Cameras,
    photos: &Path,
    lights: &[Light],
) -> Result<()> {
    let from = ctx.output("").canonicalize().unwrap_or_else(|_| ctx.output(""));
    let photos = ctx.base.join(photos);
    let photos = photos.canonicalize().unwrap_or(photos);
    let plate = cameras.cameras.get_key_value(&cameras.plate);
    let others = cameras.cameras.iter().filter(|(file, _)| **file != cameras.plate);
    let mut views: Vec<(&str, &crate::camera::Camera, String)> = Vec::new();
    for (file, posed) in plate.into_iter().chain(others) {
        if views.iter().all(|(_, camera, _)| **camera != posed.camera) {
            let name = if *file == cameras.plate { "plate" } else { file };
            views.push((name, &posed.camera, relative(&from, &photos.join(file)).display().to_string()));
        }
    }
    let views: Vec<View> =
        views.iter().map(|(name, camera, picture)| View { name, camera, picture: Some(picture) }).collect();
    gltf::write(&ctx.output("scene.glb"), scene, &views, lights)?;
    let script = ctx.output("open_in_blender.py");
    std::fs::write(&script, OPEN_IN_BLENDER).at("writing what opens the scene in Blender", &script)
}

/// The way from a folder to a file.
fn relative(from: &Path, to: &Path) -> PathBuf {
    let (from, to): (Vec<_>, Vec<_>) = (from.components().collect(), to.components().collect());
    let shared = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    let up = from[shared..].iter().map(|_| Component::ParentDir);
    up.chain(to[shared..].iter().copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_to_a_photograph_goes_up_and_down() {
        let way = |a: &str, b: &str| relative(Path::new(a), Path::new(b)).display().to_string();
        assert_eq!(way("/a/work/model", "/a/photos/plate.jpg"), "../../photos/plate.jpg");
        assert_eq!(way("/tmp/model", "/a/plate.jpg"), "../../a/plate.jpg");
        assert_eq!(way("/a", "/a/b.jpg"), "b.jpg");
    }
}

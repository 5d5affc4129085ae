//! What stays when the object moves.

use crate::artefact::{exr, json};
use crate::calibrate::Cameras;
use crate::config::Render;
use crate::error::{Context as _, Result};
use crate::illuminate;
use crate::image::RadianceImage;
use crate::irradiance::Volume;
use crate::model::{Scene, face};
use crate::render::{self, Object, Set};
use crate::shadow::{self, Occluder, Receivers};
use crate::stage::Workspace;
use crate::transfer::{Finish, Transfers};
use crate::visibility::Bvh;
use glam::Vec3;

/// The artefacts that a frame needs, and the object where the settings put it.
pub(super) struct Static {
    pub cameras: Cameras,
    pub plate: RadianceImage,
    pub light: illuminate::patch::LightModel,
    /// Its distant light as a picture, if there is any.
    pub sky: Option<RadianceImage>,
    pub volume: Volume,
    pub transfers: Transfers,
    pub receivers: Receivers,
    pub scene_bvh: Bvh,
    pub light_bvh: Bvh,
    pub object: Object,
    /// Corners of the scene model's faces, m.
    pub faces: Vec<Vec3>,
    /// By face of the scene.
    gloss: Vec<Option<face::Gloss>>,
}

impl Static {
    pub fn read(workspace: &Workspace) -> Result<Self> {
        let file = |stage: &str, name: &str| workspace.folder(stage).join(name);
        let cameras: Cameras = json::read(&file("calibrate", "cameras.json"))?;
        let scene: Scene = json::read(&file("model", "scene.json"))?;
        let light = illuminate::read_light(&workspace.folder("illuminate"))?;
        let faces = face::triangulate(&scene.faces);
        let settings = &workspace.pipeline.render;
        let plate = exr::read_radiance(&file("merge", "plate.exr"))?;
        let receivers = Receivers::cast(cameras.plate_camera(), &light.mesh);
        Ok(Self {
            volume: Volume::read(&file("irradiance", "irradiance.ply"))?,
            transfers: Transfers::read(&workspace.folder("transfer"))?,
            receivers: receivers.as_shown(&plate, &light.mesh).doing("preparing the shadow method")?,
            plate,
            scene_bvh: Bvh::new(&faces.vertices, &faces.triangles),
            light_bvh: Bvh::new(&light.mesh.vertices, &light.mesh.triangles()),
            object: render::load_object(&workspace.base.join(&settings.object), settings)?,
            sky: illuminate::read_sky(&file("illuminate", "distant.exr"), &light)?,
            gloss: scene.faces.iter().map(|f| f.gloss).collect(),
            faces: faces.vertices,
            cameras,
            light,
        })
    }

    pub fn scene(&self) -> shadow::Scene<'_> {
        shadow::Scene {
            light: &self.light,
            transfers: &self.transfers,
            receivers: &self.receivers,
            plate: &self.plate,
            finish: Finish::new(self.cameras.plate_camera(), &self.gloss),
            stored: None,
        }
    }

    /// What shades the object.
    pub fn set<'a>(&'a self, settings: &'a Render) -> Set<'a> {
        Set {
            camera: self.cameras.plate_camera(),
            plate: &self.plate,
            light: &self.light,
            sky: self.sky.as_ref(),
            light_bvh: &self.light_bvh,
            volume: &self.volume,
            scene_bvh: &self.scene_bvh,
            receivers: &self.receivers,
            transfers: &self.transfers,
            settings,
        }
    }

    pub fn occluder(&self) -> Occluder {
        Occluder { vertices: self.object.vertices.clone(), triangles: self.object.triangles.clone() }
    }
}

//! What pixels look at: positions and normals in full detail, for deferred shading.

use crate::camera::Camera;
use crate::image::Image;
use crate::render::Sample;
use crate::shadow::Receivers;
use glam::Vec3;

/// The surface seen by a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// In the world, m.
    pub position: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// Unit normal of the triangle.
    pub face_normal: Vec3,
    /// Unit vector towards the viewer.
    pub viewer: Vec3,
    /// Index of the material.
    pub material: u32,
    /// Longer side of the pixel on the surface, m.
    pub pixel_m: f32,
}

/// A pixel is at most this many times as long on the surface as seen head-on.
const LONGEST: f32 = 8.0;

impl Surface {
    /// A point of the object. `pixel` is the angle of a pixel, rad.
    pub(crate) fn of_object(sample: &Sample, pixel: f32) -> Self {
        let cos = (-sample.view.dot(sample.face_normal)).max(1.0 / LONGEST);
        Self {
            position: sample.position,
            normal: sample.normal,
            face_normal: sample.face_normal,
            viewer: -sample.view,
            material: sample.material,
            pixel_m: sample.depth * pixel / cos,
        }
    }

    /// Whether both can be one smooth surface within a pixel.
    pub(crate) fn adjoins(&self, other: &Self) -> bool {
        let near = self.position.distance(other.position) < 2.0 * self.pixel_m.max(other.pixel_m);
        near && self.normal.dot(other.normal) > 0.8
    }

    /// All receivers of a plate.
    pub fn of_receivers(receivers: &Receivers) -> Image<Option<Self>> {
        receivers.pixels.map(|receiver| {
            receiver.map(|r| Self {
                position: r.position,
                normal: r.normal,
                face_normal: r.normal,
                viewer: r.normal,
                material: 0,
                pixel_m: r.footprint[0].length().max(r.footprint[1].length()),
            })
        })
    }
}

/// Angle of a pixel in the middle of a camera's picture, rad.
pub(crate) fn pixel_angle(camera: &Camera) -> f32 {
    let [x, y] = camera.intrinsics.focal_px;
    (1.0 / x.min(y)) as f32
}

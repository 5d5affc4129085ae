//! The environment as seen from the object's place.

use crate::illuminate::patch::{DistantSource, LightModel, PatchMesh};
use crate::image::{Image, Radiance, RadianceImage, luminance};
use crate::probe::latlong;
use crate::visibility::Bvh;
use glam::Vec3;
use rayon::prelude::*;

/// Radiance arriving at one point, by direction: a `latlong` map.
#[derive(Debug, Clone, PartialEq)]
pub struct Environment {
    /// Radiance, plate units.
    pub map: RadianceImage,
}

/// Rays along each side of a texel.
const SUPERSAMPLING: usize = 3;

impl Environment {
    /// Casts rays from `position` onto the patch mesh; what misses it sees the distant sources.
    pub fn cast(light: &LightModel, bvh: &Bvh, position: Vec3, width: usize, height: usize) -> Self {
        Self::cast_with(&light.mesh, &light.distant, bvh, position, width, height)
    }

    /// The same with other distant sources than the model's.
    pub fn cast_with(
        mesh: &PatchMesh,
        distant: &[DistantSource],
        bvh: &Bvh,
        position: Vec3,
        width: usize,
        height: usize,
    ) -> Self {
        let (mut map, open) = Self::surfaces(mesh, bvh, position, [width, height], |_| [0.0; 3]);
        for source in distant {
            splat(
                &mut map,
                &open,
                source.direction,
                source.angular_radius(),
                source.solid_angle_sr,
                source.radiance,
            );
        }
        Self { map }
    }

    /// As [`Self::cast`], for what mirrors: what misses the mesh sees a picture of the distant light, if there is one, in the
    /// place of a few discs.
    pub fn cast_under(
        light: &LightModel,
        sky: Option<&RadianceImage>,
        bvh: &Bvh,
        position: Vec3,
        width: usize,
        height: usize,
    ) -> Self {
        let Some(sky) = sky else { return Self::cast(light, bvh, position, width, height) };
        let beyond = |direction| latlong::lookup(sky, direction).0;
        Self { map: Self::surfaces(&light.mesh, bvh, position, [width, height], beyond).0 }
    }

    /// Means over texels of what rays from `position` meet, of patches or `beyond` them, and the share that meets none.
    fn surfaces(
        mesh: &PatchMesh,
        bvh: &Bvh,
        position: Vec3,
        [width, height]: [usize; 2],
        beyond: impl Fn(Vec3) -> [f32; 3] + Sync,
    ) -> (RadianceImage, Vec<f32>) {
        let texels: Vec<(Radiance, f32)> = (0..width * height)
            .into_par_iter()
            .map(|i| {
                let (mut sum, mut missed) = ([0.0f32; 3], 0);
                let mut add = |l: [f32; 3]| (0..3).for_each(|k| sum[k] += l[k]);
                for s in 0..SUPERSAMPLING * SUPERSAMPLING {
                    let offset = |k: usize| (k as f32 + 0.5) / SUPERSAMPLING as f32;
                    let direction = latlong::direction(
                        (i % width) as f32 + offset(s % SUPERSAMPLING),
                        (i / width) as f32 + offset(s / SUPERSAMPLING),
                        width,
                        height,
                    );
                    match bvh.closest(position, direction, 0.0, f32::INFINITY) {
                        // Patches send light from their fronts; from behind they are black.
                        Some(hit) if mesh.normal(hit.triangle as usize).dot(direction) < 0.0 => {
                            add(mesh.patches[hit.triangle as usize].radiance);
                        }
                        Some(_) => {}
                        None => {
                            add(beyond(direction));
                            missed += 1;
                        }
                    }
                }
                let count = (SUPERSAMPLING * SUPERSAMPLING) as f32;
                (Radiance(sum.map(|v| v / count)), missed as f32 / count)
            })
            .collect();
        let (radiance, open): (Vec<_>, Vec<_>) = texels.into_iter().unzip();
        (Image::from_pixels(width, height, radiance), open)
    }

    /// Direction and solid angle (sr) of texel `i`'s centre.
    pub fn texel(&self, i: usize) -> (Vec3, f32) {
        let (w, h) = self.map.size();
        let direction = latlong::direction((i % w) as f32 + 0.5, (i / w) as f32 + 0.5, w, h);
        (direction, latlong::texel_solid_angle(i / w, w, h) as f32)
    }

    /// Power per texel: luminance times solid angle.
    pub(crate) fn power(&self) -> Vec<f64> {
        (0..self.map.pixels().len())
            .map(|i| {
                f64::from(luminance(self.map.pixels()[i].0).max(0.0))
                    * latlong::texel_solid_angle(i / self.map.width(), self.map.width(), self.map.height())
            })
            .collect()
    }

    /// Unoccluded irradiance on a surface of unit normal `normal`, by summing all texels.
    pub fn irradiance(&self, normal: Vec3) -> [f32; 3] {
        let mut sum = [0.0f64; 3];
        for (i, radiance) in self.map.pixels().iter().enumerate() {
            let (direction, solid_angle) = self.texel(i);
            let weight = f64::from(normal.dot(direction).max(0.0) * solid_angle);
            (0..3).for_each(|k| sum[k] += weight * f64::from(radiance.0[k]));
        }
        sum.map(|v| v as f32)
    }
}

/// Spreads a distant source over the texels of its disc, so that its whole power `radiance × solid_angle` is kept;
/// the nearest texel takes a disc smaller than it.
fn splat(
    map: &mut RadianceImage,
    open: &[f32],
    direction: Vec3,
    radius: f32,
    solid_angle: f32,
    radiance: [f32; 3],
) {
    let (w, h) = map.size();
    let cos_radius = radius.cos();
    let mut inside: Vec<(usize, f32)> = (0..w * h)
        .filter(|i| {
            let centre = latlong::direction((i % w) as f32 + 0.5, (i / w) as f32 + 0.5, w, h);
            centre.dot(direction) >= cos_radius
        })
        .map(|i| (i, latlong::texel_solid_angle(i / w, w, h) as f32))
        .collect();
    if inside.is_empty() {
        let (x, y) = latlong::pixel(direction, w, h);
        let i = (y as usize).min(h - 1) * w + (x.max(0.0) as usize).min(w - 1);
        inside.push((i, latlong::texel_solid_angle(i / w, w, h) as f32));
    }
    let scale = solid_angle / inside.iter().map(|(_, s)| s).sum::<f32>();
    for (i, _) in inside {
        (0..3).for_each(|k| map.pixels_mut()[i].0[k] += radiance[k] * scale * open[i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illuminate::patch::{DistantSource, Evidence, Patch, PatchMesh};
    use std::f32::consts::PI;

    #[test]
    fn a_floor_of_radiance_l_gives_pi_l_to_what_faces_it() {
        let light = LightModel {
            mesh: PatchMesh {
                vertices: vec![
                    Vec3::new(-1e4, 0.0, -1e4),
                    Vec3::new(0.0, 0.0, 2e4),
                    Vec3::new(1e4, 0.0, -1e4),
                ],
                normals: vec![Vec3::Y; 3],
                patches: vec![Patch {
                    vertices: [0, 1, 2],
                    face: 0,
                    radiance: [2.0, 1.0, 0.5],
                    reflectance: [0.5; 3],
                    evidence: Evidence::Probe,
                }],
            },
            distant: vec![],
        };
        let bvh = Bvh::new(&light.mesh.vertices, &light.mesh.triangles());
        let above = Environment::cast(&light, &bvh, Vec3::Y, 64, 32);
        let e = above.irradiance(-Vec3::Y);
        assert!((e[0] - 2.0 * PI).abs() < 0.02 && (e[2] - 0.5 * PI).abs() < 0.01, "{e:?}");
        assert_eq!(above.irradiance(Vec3::Y), [0.0; 3]);
        let below = Environment::cast(&light, &bvh, -Vec3::Y, 64, 32);
        assert_eq!(below.irradiance(Vec3::Y), [0.0; 3], "the back of a patch is black");
    }

    #[test]
    fn what_misses_the_scene_is_as_the_picture_of_the_distant_light_has_it() {
        let sky = Image::from_fn(128, 64, |x, y| Radiance([x as f32, y as f32, 1.0]));
        let (light, bvh) = (LightModel::default(), Bvh::new(&[], &[]));
        let seen = Environment::cast_under(&light, Some(&sky), &bvh, Vec3::ZERO, 128, 64).map;
        for (x, y) in [(20, 10), (64, 32), (100, 50)] {
            let (a, b) = (seen.at(x, y).0, sky.at(x, y).0);
            assert!((0..3).all(|k| (a[k] - b[k]).abs() < 0.01), "{a:?} {b:?}");
        }
    }

    #[test]
    fn distant_sources_keep_their_power_whatever_their_size() {
        for solid_angle_sr in [6e-5, 0.01, 1.0] {
            let direction = Vec3::new(0.3, 0.8, -0.4).normalize();
            let source =
                DistantSource { direction, solid_angle_sr, radiance: [3.0 / solid_angle_sr, 0.0, 1.0] };
            let light = LightModel { mesh: PatchMesh::default(), distant: vec![source] };
            let environment = Environment::cast(&light, &Bvh::new(&[], &[]), Vec3::ZERO, 128, 64);
            let power: f32 =
                (0..128 * 64).map(|i| environment.map.pixels()[i].0[0] * environment.texel(i).1).sum();
            assert!((power - 3.0).abs() < 1e-3, "{solid_angle_sr} sr: {power}");
        }
    }
}

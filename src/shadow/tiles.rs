//! The static side of a frame: receiver pixels in square tiles, with their columns of the transfers.

use super::{Problem, Scene};
use crate::config::Render;
use crate::image::{Radiance, RadianceImage};
use glam::{Vec2, Vec3};

/// Side of a tile, px.
const TILE_PX: usize = 16;

/// A receiver pixel with what its shadow needs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pixel {
    pub position: Vec3,
    pub normal: Vec3,
    /// One pixel to the right and one down on the surface, m.
    pub footprint: [Vec3; 2],
    /// Their weights.
    pub barycentric: [f32; 3],
    /// Receiver vertices around it.
    pub columns: [u32; 3],
    /// Index into the plate.
    pub index: u32,
    /// Irradiance from all light, plate units.
    pub irradiance: [f32; 3],
}

/// Neighbouring pixels within a sphere.
#[derive(Debug, Clone)]
pub(crate) struct Tile {
    pub pixels: std::ops::Range<usize>,
    pub centre: Vec3,
    pub radius: f32,
    /// Columns of the transfers that its pixels use, ascending.
    pub columns: Vec<u32>,
}

/// All receiver pixels, tile by tile.
#[derive(Debug, Clone)]
pub(crate) struct Prepared {
    pub pixels: Vec<Pixel>,
    pub tiles: Vec<Tile>,
    pub plate: RadianceImage,
}

impl Pixel {
    /// A point of the pixel on the surface; (0, 0) is its centre, ±½ its sides.
    pub fn at(&self, offset: Vec2) -> Vec3 {
        self.position + self.footprint[0] * offset.x + self.footprint[1] * offset.y
    }

    /// Distance from the centre to the farthest corner, m.
    pub fn reach(&self) -> f32 {
        let [a, b] = self.footprint;
        ((a + b).length()).max((a - b).length()) / 2.0
    }

    /// A row of the transfers at this pixel.
    pub fn interpolate(&self, row: &[f32]) -> f32 {
        let [a, b, c] = self.columns.map(|column| row[column as usize]);
        a * self.barycentric[0] + b * self.barycentric[1] + c * self.barycentric[2]
    }

    /// ε from the irradiance that is blocked: the plate's radiance times the blocked share.
    pub fn removed(&self, plate: Radiance, blocked: [f32; 3]) -> Radiance {
        Radiance(std::array::from_fn(|c| {
            let all = self.irradiance[c];
            let share = if all > 0.0 { (blocked[c] / all).clamp(0.0, 1.0) } else { 0.0 };
            plate.0[c].max(0.0) * share
        }))
    }
}

impl Prepared {
    pub fn new(scene: &Scene, settings: &Render) -> Result<Self, Problem> {
        scene.check()?;
        if !(16..=8192).contains(&settings.shadow_map_px) {
            let value = settings.shadow_map_px.to_string();
            return Err(Problem::Setting { name: "shadow_map_px", value, range: "between 16 and 8192" });
        }
        let (width, height) = scene.plate.size();
        let (mut pixels, mut tiles) = (Vec::new(), Vec::new());
        for y in (0..height).step_by(TILE_PX) {
            for x in (0..width).step_by(TILE_PX) {
                let start = pixels.len();
                for (y, x) in (y..height.min(y + TILE_PX))
                    .flat_map(|y| (x..width.min(x + TILE_PX)).map(move |x| (y, x)))
                {
                    pixels.extend(pixel(scene, x, y)?);
                }
                tiles.extend(tile(&pixels, start));
            }
        }
        Ok(Self { pixels, tiles, plate: scene.plate.clone() })
    }

    /// ε of all pixels from the blocked irradiance of each receiver pixel.
    pub fn epsilon(&self, blocked: &[[f32; 3]]) -> RadianceImage {
        let (width, height) = self.plate.size();
        let mut epsilon = vec![Radiance::default(); width * height];
        for (pixel, &blocked) in self.pixels.iter().zip(blocked) {
            let index = pixel.index as usize;
            epsilon[index] = pixel.removed(self.plate.pixels()[index], blocked);
        }
        RadianceImage::from_pixels(width, height, epsilon)
    }
}

fn pixel(scene: &Scene, x: usize, y: usize) -> Result<Option<Pixel>, Problem> {
    let Some(receiver) = scene.receivers.pixels.at(x, y) else { return Ok(None) };
    let mesh = &scene.transfers.receivers;
    let (columns, barycentric) =
        mesh.locate(receiver.patch, receiver.barycentric).ok_or_else(|| Problem::Mismatch {
            what: "patch seen by the plate",
            found: format!("patch {} has no transfers", receiver.patch),
            expected: format!("one of {} receiver patches", mesh.patches.len()),
        })?;
    let mut irradiance = [0.0; 3];
    for (weight, column) in barycentric.iter().zip(columns) {
        for (c, sum) in irradiance.iter_mut().enumerate() {
            *sum += weight * scene.transfers.irradiance[(column as usize, c)];
        }
    }
    Ok(Some(Pixel {
        position: receiver.position,
        normal: receiver.normal,
        footprint: receiver.footprint,
        barycentric,
        columns,
        index: (y * scene.plate.width() + x) as u32,
        irradiance,
    }))
}

fn tile(pixels: &[Pixel], start: usize) -> Option<Tile> {
    let members = &pixels[start..];
    let min = members.iter().map(|p| p.position).reduce(Vec3::min)?;
    let max = members.iter().map(|p| p.position).reduce(Vec3::max)?;
    let centre = (min + max) / 2.0;
    let radius = members.iter().map(|p| p.position.distance(centre) + p.reach()).fold(0.0, f32::max);
    let mut columns: Vec<u32> = members.iter().flat_map(|p| p.columns).collect();
    columns.sort_unstable();
    columns.dedup();
    Some(Tile { columns, pixels: start..pixels.len(), centre, radius })
}

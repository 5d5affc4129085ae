//! The static side of a frame: receiver pixels in square tiles, and in vectors of eight that share a receiver triangle.

use super::projection::OFFSETS;
use super::registration::{Place, Registration};
use super::{Problem, Scene};
use crate::config::Render;
use crate::image::{Radiance, RadianceImage};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::ops::Range;
use wide::f32x8;

/// Side of a tile, px.
pub(crate) const TILE_PX: usize = 16;
/// Side of a block of tiles, px.
const BLOCK_PX: usize = 64;
/// Pixels of a vector.
pub(crate) const LANES: usize = 8;

/// A receiver pixel with what its shadow needs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pixel {
    pub position: Vec3,
    pub normal: Vec3,
    /// One pixel to the right and one down on the surface, m.
    pub footprint: [Vec3; 2],
    /// Receiver vertices around it.
    pub vertices: [u32; 3],
    /// Their weights.
    pub weights: [f32; 3],
    pub patch: u32,
    /// Patch on which these lie, and where from here: light is taken from beside the pixel where the plate shows the scene's
    /// shadows beside the model's (see [`super::registration`]).
    pub lit_patch: u32,
    /// m.
    pub lit_from: Vec3,
    /// Index into the plate.
    pub index: u32,
    /// Irradiance from all light, plate units.
    pub irradiance: [f32; 3],
}

/// Up to eight neighbouring pixels on one receiver triangle; lanes beyond them repeat the first.
#[derive(Debug, Clone)]
pub(crate) struct Vector {
    /// Numbers of its pixels.
    pub pixels: Range<usize>,
    /// Positions at each of [`OFFSETS`], m.
    pub positions: [[f32x8; 3]; OFFSETS.len()],
    /// Weights of the triangle's vertices.
    pub weights: [f32x8; 3],
    /// The triangle's vertices, as indices into [`Tile::vertices`].
    pub corners: [u16; 3],
}

/// Neighbouring pixels within a sphere.
#[derive(Debug, Clone)]
pub(crate) struct Tile {
    pub pixels: Range<usize>,
    pub vectors: Range<usize>,
    pub centre: Vec3,
    pub radius: f32,
    /// Receiver vertices that its pixels use, ascending.
    pub vertices: Vec<u32>,
    /// Receiver patches that its pixels see, ascending.
    pub patches: Vec<u32>,
}

/// Neighbouring tiles within a sphere.
#[derive(Debug, Clone)]
pub(crate) struct Block {
    pub tiles: Range<usize>,
    pub centre: Vec3,
    pub radius: f32,
}

/// All receiver pixels: block by block, tile by tile, vector by vector.
#[derive(Debug, Clone)]
pub(crate) struct Prepared {
    pub pixels: Vec<Pixel>,
    pub vectors: Vec<Vector>,
    pub tiles: Vec<Tile>,
    pub blocks: Vec<Block>,
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

    /// ε from the irradiance that is blocked: the plate's radiance times the blocked share.
    pub fn removed(&self, plate: Radiance, blocked: [f32; 3]) -> Radiance {
        Radiance(std::array::from_fn(|c| {
            let all = self.irradiance[c];
            let share = if all > 0.0 { (blocked[c] / all).clamp(0.0, 1.0) } else { 0.0 };
            plate.0[c].max(0.0) * share
        }))
    }
}

impl Vector {
    /// A share of what is known at the tile's vertices.
    pub fn interpolate(&self, corners: &[[f32; 3]], share: f32x8) -> [f32x8; 3] {
        let at = self.corners.map(|v| corners[v as usize]);
        std::array::from_fn(|c| {
            let [a, b, d] = [0, 1, 2].map(|k| self.weights[k] * f32x8::splat(at[k][c]));
            share * (a + b + d)
        })
    }
}

impl Prepared {
    /// The scene's shadows where the model has them.
    pub fn new(scene: &Scene, settings: &Render) -> Result<Self, Problem> {
        scene.check()?;
        Self::with(scene, settings, None)
    }

    /// The scene's shadows where the plate shows them, as far as the settings allow.
    pub fn registered(scene: &Scene, settings: &Render) -> Result<Self, Problem> {
        scene.check()?;
        let reach = settings.register_px;
        let registration = if reach > 0 { Some(Registration::new(scene, reach)?) } else { None };
        Self::with(scene, settings, registration.as_ref())
    }

    /// Of a scene that has been checked.
    fn with(scene: &Scene, settings: &Render, registration: Option<&Registration>) -> Result<Self, Problem> {
        if !(16..=8192).contains(&settings.shadow_map_px) {
            let value = settings.shadow_map_px.to_string();
            return Err(Problem::Setting { name: "shadow_map_px", value, range: "between 16 and 8192" });
        }
        let (width, height) = scene.plate.size();
        let corners: Vec<(usize, usize)> = squares([0, 0], [width, height], BLOCK_PX).collect();
        let parts: Vec<_> = corners
            .into_par_iter()
            .map(|corner| Part::new(scene, registration, corner))
            .collect::<Result<_, _>>()?;
        let mut all = Self { pixels: Vec::new(), vectors: Vec::new(), tiles: Vec::new(), blocks: Vec::new() };
        for part in parts {
            all.append(part);
        }
        Ok(all)
    }

    fn append(&mut self, part: Part) {
        let (pixels, vectors, tiles) = (self.pixels.len(), self.vectors.len(), self.tiles.len());
        let moved = |r: &Range<usize>, by: usize| r.start + by..r.end + by;
        if let Some((centre, radius)) = sphere(part.tiles.iter().map(|t| (t.centre, t.radius))) {
            self.blocks.push(Block { tiles: tiles..tiles + part.tiles.len(), centre, radius });
        }
        self.pixels.extend(part.pixels);
        self.vectors
            .extend(part.vectors.into_iter().map(|v| Vector { pixels: moved(&v.pixels, pixels), ..v }));
        self.tiles.extend(part.tiles.into_iter().map(|t| Tile {
            pixels: moved(&t.pixels, pixels),
            vectors: moved(&t.vectors, vectors),
            ..t
        }));
    }

    /// ε of all pixels from the blocked irradiance of each receiver pixel.
    pub fn epsilon(&self, plate: &RadianceImage, blocked: &[[f32; 3]]) -> RadianceImage {
        let (width, height) = plate.size();
        let mut epsilon = vec![Radiance::default(); width * height];
        for (pixel, &blocked) in self.pixels.iter().zip(blocked) {
            if blocked != [0.0; 3] {
                let index = pixel.index as usize;
                epsilon[index] = pixel.removed(plate.pixels()[index], blocked);
            }
        }
        RadianceImage::from_pixels(width, height, epsilon)
    }
}

/// Upper left corners of squares that cover a rectangle, row by row.
fn squares(low: [usize; 2], high: [usize; 2], side: usize) -> impl Iterator<Item = (usize, usize)> {
    let columns = move |y| (low[0]..high[0]).step_by(side).map(move |x| (x, y));
    (low[1]..high[1]).step_by(side).flat_map(columns)
}

/// A block with numbers of its own.
#[derive(Default)]
struct Part {
    pixels: Vec<Pixel>,
    vectors: Vec<Vector>,
    tiles: Vec<Tile>,
}

impl Part {
    fn new(
        scene: &Scene,
        registration: Option<&Registration>,
        (x, y): (usize, usize),
    ) -> Result<Self, Problem> {
        let (width, height) = scene.plate.size();
        let mut part = Self::default();
        for (x, y) in squares([x, y], [width.min(x + BLOCK_PX), height.min(y + BLOCK_PX)], TILE_PX) {
            let first = part.pixels.len();
            for (y, x) in
                (y..height.min(y + TILE_PX)).flat_map(|y| (x..width.min(x + TILE_PX)).map(move |x| (y, x)))
            {
                part.pixels.extend(pixel(scene, registration, x, y)?);
            }
            // Stable: within a triangle pixels stay in the order of their rows.
            part.pixels[first..].sort_by_key(|p| (p.patch, p.vertices));
            part.add_tile(first);
        }
        Ok(part)
    }

    fn add_tile(&mut self, first: usize) {
        let members = &self.pixels[first..];
        let Some((centre, radius)) = sphere(members.iter().map(|p| (p.position, p.reach()))) else { return };
        let sorted = |mut ids: Vec<u32>| {
            ids.sort_unstable();
            ids.dedup();
            ids
        };
        let vertices = sorted(members.iter().flat_map(|p| p.vertices).collect());
        let patches = sorted(members.iter().flat_map(|p| [p.patch, p.lit_patch]).collect());
        let (start, mut at) = (self.vectors.len(), first);
        for group in members.chunk_by(|a, b| a.vertices == b.vertices) {
            for lanes in group.chunks(LANES) {
                self.vectors.push(Vector::new(lanes, at, &vertices));
                at += lanes.len();
            }
        }
        let (pixels, vectors) = (first..self.pixels.len(), start..self.vectors.len());
        self.tiles.push(Tile { pixels, vectors, centre, radius, vertices, patches });
    }
}

impl Vector {
    fn new(pixels: &[Pixel], first: usize, vertices: &[u32]) -> Self {
        let lane = |i: usize| pixels.get(i).unwrap_or(&pixels[0]);
        let lanes = |value: &dyn Fn(&Pixel) -> f32| f32x8::new(std::array::from_fn(|i| value(lane(i))));
        Self {
            pixels: first..first + pixels.len(),
            positions: OFFSETS.map(|o| [0, 1, 2].map(|k| lanes(&|p| p.at(o)[k]))),
            weights: [0, 1, 2].map(|k| lanes(&|p| p.weights[k])),
            corners: pixels[0].vertices.map(|v| vertices.partition_point(|&w| w < v) as u16),
        }
    }
}

/// Around spheres.
fn sphere(members: impl Iterator<Item = (Vec3, f32)> + Clone) -> Option<(Vec3, f32)> {
    let min = members.clone().map(|(p, r)| p - r).reduce(Vec3::min)?;
    let max = members.clone().map(|(p, r)| p + r).reduce(Vec3::max)?;
    let centre = (min + max) / 2.0;
    Some((centre, members.map(|(p, r)| p.distance(centre) + r).fold(0.0, f32::max)))
}

fn pixel(
    scene: &Scene,
    registration: Option<&Registration>,
    x: usize,
    y: usize,
) -> Result<Option<Pixel>, Problem> {
    let Some(receiver) = scene.receivers.pixels.at(x, y) else { return Ok(None) };
    let place = registration.and_then(|registration| registration.place(x, y));
    let place = place.unwrap_or(Place {
        patch: receiver.patch,
        barycentric: receiver.barycentric,
        shift: Vec3::ZERO,
    });
    let (vertices, weights) = located(scene, place.patch, place.barycentric)?;
    Ok(Some(Pixel {
        position: receiver.position,
        normal: receiver.normal,
        footprint: receiver.footprint,
        vertices,
        weights,
        patch: receiver.patch,
        lit_patch: place.patch,
        lit_from: place.shift,
        index: (y * scene.plate.width() + x) as u32,
        irradiance: scene.transfers.irradiance_at(vertices, weights),
    }))
}

/// Receiver vertices around a point of a patch, and their weights.
pub(super) fn located(
    scene: &Scene,
    patch: u32,
    barycentric: [f32; 3],
) -> Result<([u32; 3], [f32; 3]), Problem> {
    scene.transfers.receivers.locate(patch, barycentric).ok_or_else(|| Problem::Mismatch {
        what: "patch seen by the plate",
        found: format!("patch {patch} has no transfers"),
        expected: format!("one of {} receiver patches", scene.transfers.receivers.patches.len()),
    })
}

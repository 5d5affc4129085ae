//! The irradiance volume: incident radiance in second-order spherical harmonics on a regular grid, with visibility
//! (Greger et al. 1998; Gibson and Chalmers 2003, §5). The sun is kept apart: [`Beams`].

mod beam;

pub use beam::Beams;
pub(crate) use beam::split as split_beams;

use crate::artefact::ply;
use crate::config;
use crate::error::{Error, Result};
use crate::illuminate::gather::strong_patches;
use crate::illuminate::patch::{DistantSource, LightModel, PatchMesh};
use crate::maps::spherical_triangle;
use crate::sh;
use crate::visibility::Bvh;
use glam::Vec3;
use rayon::prelude::*;
use std::path::Path;

/// Height of the lowest nodes above the support surface, m: on it, half of all rays would start inside.
const LIFT_M: f32 = 0.02;
/// A node is inside something solid if that share of its rays meets surfaces from behind.
const MAX_BEHIND: f64 = 0.5;
/// Points that look at nodes start this far off their surface, m.
const OFF_M: f32 = 5e-3;
/// A strong patch is sampled in parts of at most this solid angle, sr.
const LARGE_SR: f64 = 5e-3;
/// Its sides are halved so many times at most.
const HALVINGS: u32 = 4;
const FORMAT: &str = "insitu-irradiance 1";

/// Why no volume can be made.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum Problem {
    /// A setting makes no sense.
    #[error("irradiance.{name} is {value}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// The grid would be too large.
    #[error("the irradiance volume would have {0:.0} nodes, at most 100,000 are sensible")]
    TooMany(f64),
    /// No node is in the open.
    #[error("all {0} nodes of the irradiance volume lie inside objects or outside the room")]
    AllInside(usize),
}

impl crate::error::Problem for Problem {
    fn hint(&self) -> String {
        match self {
            Self::Setting { .. } => "give a positive number, or leave it out for the default",
            Self::TooMany(_) => "raise irradiance.spacing_m or lower irradiance.reach_m",
            Self::AllInside(_) => {
                "check that the faces of the room point inwards and that the grid lies in it"
            }
        }
        .into()
    }
}

/// Nodes at `origin + spacing × index`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Position of the first node, world, m.
    pub origin: Vec3,
    /// Distance of nodes along x, y, z, m.
    pub spacing: Vec3,
    /// Number of nodes along x, y, z.
    pub size: [usize; 3],
}

/// Harmonics of incident radiance on a grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    /// Position of the first node, world, m.
    origin: Vec3,
    /// Distance of nodes along x, y, z, m.
    spacing: Vec3,
    /// Number of nodes along x, y, z.
    size: [usize; 3],
    /// x fastest, then y, then z; `None` inside objects.
    nodes: Vec<Option<sh::Coefficients>>,
    /// The same with irradiance nowhere below zero.
    windowed: Vec<Option<sh::Coefficients>>,
}

impl Volume {
    /// Fills a box around the world's origin from `support_m` upwards, cut to the mesh's bounds.
    pub fn build(
        light: &LightModel,
        support_m: f64,
        settings: &config::Irradiance,
    ) -> std::result::Result<Self, Problem> {
        for (name, value) in
            [("spacing_m", settings.spacing_m), ("reach_m", settings.reach_m), ("rays", settings.rays as f64)]
        {
            if !(value.is_finite() && value > 0.0) {
                return Err(Problem::Setting { name, value });
            }
        }
        let (origin, end) = bounds(&light.mesh, support_m as f32, settings.reach_m as f32);
        let cells = ((end - origin) / settings.spacing_m as f32).ceil().max(Vec3::ONE);
        let count: f64 = cells.to_array().iter().map(|c| f64::from(*c) + 1.0).product();
        if count > 1e5 {
            return Err(Problem::TooMany(count));
        }
        let size = cells.to_array().map(|c| c as usize + 1);
        Self::on_grid(light, Grid { origin, spacing: (end - origin) / cells, size }, settings.rays)
    }

    /// Fills any grid, with so many rays a node.
    pub fn on_grid(light: &LightModel, grid: Grid, rays: usize) -> std::result::Result<Self, Problem> {
        let mut strong = strong_patches(&light.mesh, |_| true);
        strong.sort_unstable();
        Self::filled(light, grid, rays, &strong)
    }

    /// The same by rays alone, as a reference: it takes very many.
    pub fn by_rays(light: &LightModel, grid: Grid, rays: usize) -> std::result::Result<Self, Problem> {
        Self::filled(light, grid, rays, &[])
    }

    /// `strong` patches, in order, are summed one by one.
    fn filled(
        light: &LightModel,
        grid: Grid,
        rays: usize,
        strong: &[usize],
    ) -> std::result::Result<Self, Problem> {
        let Grid { origin, spacing, size } = grid;
        let bvh = Bvh::new(&light.mesh.vertices, &light.mesh.triangles());
        let (_, soft) = beam::split(&light.distant);
        let nodes: Vec<_> = (0..size.iter().product::<usize>())
            .into_par_iter()
            .map(|i| {
                let at = origin + spacing * index(i, size).map_vec();
                incident(&light.mesh, strong, &soft, &bvh, at, rays)
            })
            .collect();
        if nodes.iter().all(Option::is_none) {
            return Err(Problem::AllInside(nodes.len()));
        }
        Ok(Self::new(origin, spacing, size, nodes))
    }

    fn new(origin: Vec3, spacing: Vec3, size: [usize; 3], nodes: Vec<Option<sh::Coefficients>>) -> Self {
        let windowed = nodes.par_iter().map(|n| n.as_ref().map(sh::windowed)).collect();
        Self { origin, spacing, size, nodes, windowed }
    }

    /// Irradiance on a surface of unit `normal` of all light but [`Beams`], plate units: nodes are interpolated linearly, those
    /// inside objects left out; beyond the grid its border holds.
    pub fn irradiance(&self, position: Vec3, normal: Vec3) -> [f32; 3] {
        sh::irradiance(&self.blended(&self.windowed, position, |_| true), normal)
    }

    /// Irradiance of all light, beams included. Nodes that the scene hides from the point are left out: walls that are thinner
    /// than the grid do not leak.
    pub fn irradiance_with(&self, beams: &Beams, position: Vec3, normal: Vec3) -> [f32; 3] {
        let nodes =
            self.blended(&self.windowed, position, |node| beams.sees(position + normal * OFF_M, node));
        let (soft, hard) = (sh::irradiance(&nodes, normal), beams.irradiance(position, normal));
        std::array::from_fn(|k| soft[k] + hard[k])
    }

    /// Interpolated harmonics of incident radiance, as they are: irradiance by them may ring below zero.
    pub fn harmonics(&self, position: Vec3) -> sh::Coefficients {
        self.blended(&self.nodes, position, |_| true)
    }

    fn blended(
        &self,
        nodes: &[Option<sh::Coefficients>],
        position: Vec3,
        seen: impl Fn(Vec3) -> bool,
    ) -> sh::Coefficients {
        let mut at = [0.0f32; 3];
        let mut low = [0usize; 3];
        for k in 0..3 {
            let last = (self.size[k] - 1) as f32;
            let x =
                if self.spacing[k] > 0.0 { (position[k] - self.origin[k]) / self.spacing[k] } else { 0.0 };
            let x = x.clamp(0.0, last);
            low[k] = (x as usize).min(self.size[k].saturating_sub(2));
            at[k] = x - low[k] as f32;
        }
        let mut sum = [[0.0f32; 3]; sh::COUNT];
        let mut weights = 0.0;
        for corner in 0..8 {
            let bit = |k: usize| corner >> k & 1;
            let weight: f32 = (0..3).map(|k| if bit(k) == 1 { at[k] } else { 1.0 - at[k] }).product();
            let [x, y, z] = [0, 1, 2].map(|k| (low[k] + bit(k)).min(self.size[k] - 1));
            let node = nodes[(z * self.size[1] + y) * self.size[0] + x];
            let place = self.origin + self.spacing * Vec3::new(x as f32, y as f32, z as f32);
            if let (Some(node), true) = (node, weight > 0.0 && seen(place)) {
                sum.iter_mut().zip(node).for_each(|(s, n)| (0..3).for_each(|c| s[c] += weight * n[c]));
                weights += weight;
            }
        }
        if weights < 1e-3 {
            return self.nearest(nodes, position, seen);
        }
        sum.map(|s| s.map(|v| v / weights))
    }

    /// The nearest node in the open, one that is seen if there is any within two spacings.
    fn nearest(
        &self,
        nodes: &[Option<sh::Coefficients>],
        position: Vec3,
        seen: impl Fn(Vec3) -> bool,
    ) -> sh::Coefficients {
        let place = |i: usize| self.origin + self.spacing * index(i, self.size).map_vec();
        let open = || nodes.iter().enumerate().filter_map(|(i, n)| n.map(|n| (i, n)));
        let distance = |i: usize| place(i).distance(position);
        let near = 2.0 * self.spacing.length();
        let visible = open().filter(|(i, _)| distance(*i) < near && seen(place(*i)));
        let closest = |a: &(usize, _), b: &(usize, _)| distance(a.0).total_cmp(&distance(b.0));
        let found = visible.min_by(closest).or_else(|| open().min_by(closest));
        found.map_or([[0.0; 3]; sh::COUNT], |(_, n)| n)
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether there is no node; a built volume has some.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Position and harmonics of the nodes that are not inside an object.
    pub fn open(&self) -> impl Iterator<Item = (Vec3, sh::Coefficients)> + '_ {
        let place = |i: usize| self.origin + self.spacing * index(i, self.size).map_vec();
        self.nodes.iter().enumerate().filter_map(move |(i, n)| n.map(|n| (place(i), n)))
    }

    /// The open node nearest to the middle of the region that an object may move in.
    pub fn middle(&self) -> Option<Vec3> {
        let last = Vec3::from_array(self.size.map(|n| (n - 1) as f32));
        let middle = self.origin + self.spacing * last / 2.0;
        let places = self.open().map(|(place, _)| place);
        places.min_by(|a, b| a.distance(middle).total_cmp(&b.distance(middle)))
    }

    /// How many these are.
    pub fn open_nodes(&self) -> usize {
        self.nodes.iter().flatten().count()
    }

    /// Writes the grid as points with their harmonics.
    pub fn write(&self, path: &Path) -> Result<()> {
        let vector = |v: Vec3| format!("{} {} {}", v.x, v.y, v.z);
        let [nx, ny, nz] = self.size;
        let mesh = ply::Mesh {
            format: FORMAT.into(),
            comments: vec![
                "metres, +Y up; harmonics of incident radiance, real orthonormal, plate units".into(),
                format!("origin {}", vector(self.origin)),
                format!("spacing {}", vector(self.spacing)),
                format!("size {nx} {ny} {nz}"),
            ],
            vertex_properties: properties(),
            vertices: (0..self.nodes.len())
                .map(|i| {
                    let at = self.origin + self.spacing * index(i, self.size).map_vec();
                    let mut row = vec![at.x, at.y, at.z, f32::from(u8::from(self.nodes[i].is_some()))];
                    row.extend(self.nodes[i].unwrap_or_default().as_flattened());
                    row
                })
                .collect(),
            ..Default::default()
        };
        ply::write(path, &mesh)
    }

    /// Reads what [`Self::write`] wrote.
    pub fn read(path: &Path) -> Result<Self> {
        let mesh = ply::read(path, FORMAT)?;
        let refuse = |problem: &str| {
            Error::file(
                "reading the irradiance volume",
                path,
                problem,
                "run `insitu run --force --from irradiance`",
            )
        };
        let numbers = |name: &str| -> Option<[f32; 3]> {
            let line = mesh.comments.iter().find_map(|c| c.strip_prefix(name)?.strip_prefix(' '))?;
            let values: Vec<f32> = line.split(' ').map(|v| v.parse().ok()).collect::<Option<_>>()?;
            values.try_into().ok()
        };
        let (Some(origin), Some(spacing), Some(size)) =
            (numbers("origin"), numbers("spacing"), numbers("size"))
        else {
            return Err(refuse("does not state origin, spacing and size of its grid"));
        };
        let size = size.map(|s| s as usize);
        if mesh.vertex_properties != properties()
            || mesh.vertices.is_empty()
            || mesh.vertices.len() != size.iter().product::<usize>()
        {
            return Err(refuse("its nodes do not fit its grid"));
        }
        let node = |row: &Vec<f32>| {
            (row[3] > 0.5).then(|| std::array::from_fn(|i| [0, 1, 2].map(|c| row[4 + 3 * i + c])))
        };
        let nodes = mesh.vertices.iter().map(node).collect();
        Ok(Self::new(origin.into(), spacing.into(), size, nodes))
    }
}

fn properties() -> Vec<String> {
    let mut names = ["x", "y", "z", "open"].map(String::from).to_vec();
    for i in 0..sh::COUNT {
        names.extend(["red", "green", "blue"].map(|c| format!("sh{i}_{c}")));
    }
    names
}

/// Grid indices of a node.
struct Index([usize; 3]);

impl Index {
    fn map_vec(&self) -> Vec3 {
        Vec3::from_array(self.0.map(|v| v as f32))
    }
}

fn index(i: usize, size: [usize; 3]) -> Index {
    Index([i % size[0], i / size[0] % size[1], i / (size[0] * size[1])])
}

/// The region around the world's origin, cut to the mesh's bounds where these enclose it, a little off its surfaces.
fn bounds(mesh: &PatchMesh, support: f32, reach: f32) -> (Vec3, Vec3) {
    let mut low = Vec3::new(-reach, support + LIFT_M, -reach);
    let mut high = Vec3::new(reach, support + LIFT_M + reach, reach);
    let room = mesh.vertices.iter().fold((Vec3::MAX, Vec3::MIN), |(a, b), v| (a.min(*v), b.max(*v)));
    for k in 0..3 {
        // A face alone, like the ground, has no height to cut to.
        if room.1[k] - room.0[k] > reach && room.0[k] + LIFT_M < high[k] && room.1[k] - LIFT_M > low[k] {
            low[k] = low[k].max(room.0[k] + LIFT_M);
            high[k] = high[k].min(room.1[k] - LIFT_M);
        }
    }
    (low, high.max(low))
}

/// Incident radiance at a point; `None` inside something solid. Patches that stand out, which few rays would meet, are
/// summed one by one, by their solid angle.
fn incident(
    mesh: &PatchMesh,
    strong: &[usize],
    distant: &[DistantSource],
    bvh: &Bvh,
    at: Vec3,
    rays: usize,
) -> Option<sh::Coefficients> {
    let mut sum = sh::Projection::default();
    let solid_angle = 4.0 * std::f64::consts::PI / rays as f64;
    let mut behind = 0usize;
    for i in 0..rays {
        let d = sh::sphere_direction(i, rays);
        if let Some(hit) = bvh.closest(at, d, 0.0, f32::MAX) {
            let patch = hit.triangle as usize;
            if mesh.normal(patch).dot(d) >= 0.0 {
                behind += 1;
            } else if strong.binary_search(&patch).is_err() {
                sum.add(d, mesh.patches[patch].radiance, solid_angle);
            }
        }
    }
    if behind as f64 > MAX_BEHIND * rays as f64 {
        return None;
    }
    for &patch in strong {
        let corners = mesh.corners(patch);
        if mesh.normal(patch).dot(corners[0] - at) < 0.0 {
            add_patch(&mut sum, corners, mesh.patches[patch].radiance, bvh, at, HALVINGS);
        }
    }
    for s in distant {
        if !bvh.any_hit(at, s.direction, 0.0, f32::MAX) {
            sum.add(s.direction, s.radiance, f64::from(s.solid_angle_sr));
        }
    }
    Some(sum.coefficients())
}

/// A triangle of even radiance as seen from a point, in parts of a ray each: the more the larger it is seen, since the scene may
/// hide some of them.
fn add_patch(
    sum: &mut sh::Projection,
    corners: [Vec3; 3],
    radiance: [f32; 3],
    bvh: &Bvh,
    at: Vec3,
    halvings: u32,
) {
    let [a, b, c] = corners;
    let seen = |p: Vec3| (p - at).normalize_or_zero();
    let angle = spherical_triangle(seen(a), seen(b), seen(c));
    if angle > LARGE_SR && halvings > 0 {
        let [ab, bc, ca] = [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0];
        for part in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]] {
            add_patch(sum, part, radiance, bvh, at, halvings - 1);
        }
        return;
    }
    let middle = (a + b + c) / 3.0;
    if !bvh.any_hit(at, middle - at, 0.0, 1.0 - 1e-3) {
        sum.add(seen(middle), radiance, angle);
    }
}

#[cfg(test)]
mod tests;

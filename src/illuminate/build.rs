//! The light model from scene, probe and plate.

use super::distant::{self, Distant, Layer};
use super::gather::Gather;
use super::lamps;
use super::mesh::{FaceMesh, assemble, graded};
use super::patch::{Evidence, LightModel, PatchMesh};
use super::project::{self, PlateSamples, Projected, Samples};
use super::{Problem, power};
use crate::camera::Camera;
use crate::config;
use crate::image::{Image, Radiance, RadianceImage, luminance};
use crate::model::face::Face;
use crate::probe::Environment;
use crate::visibility::Bvh;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The unclipped, empty picture of the scene.
pub struct Plate<'a> {
    /// Its camera.
    pub camera: &'a Camera,
    /// Its radiance.
    pub radiance: &'a RadianceImage,
    /// Where no exposure holds it.
    pub clipped: &'a Image<bool>,
}

/// What is known of the light beforehand, as in a capture with truth.
#[derive(Default)]
pub struct Known {
    /// Radiance of emitting faces, plate units, by index of the face; the rest is found.
    pub faces: BTreeMap<u32, [f32; 3]>,
    /// The whole distant light.
    pub sky: Option<Environment>,
}

/// Largest reflectance: one returns no more light than it gets.
const MAX_REFLECTANCE: f32 = 0.95;
/// Rounds of gathering, so that unseen patches see each other.
const ROUNDS: usize = 3;
/// Rounds of refinement; each halves edges.
const REFINEMENTS: usize = 4;
/// Texels so near to a known emitter may hold its light: a pixel's width and one of resampling.
const BESIDE: usize = 2;
/// What sends so many times the light that it gets shines by itself.
pub(super) const SHINES: f32 = 3.0;
/// Below this share of the sphere, gaps are cracks of the model and not the sky.
const MIN_OPEN: f64 = 0.005;

/// The light model and what is to be said about it.
pub struct Built {
    /// Patches and distant light.
    pub light: LightModel,
    /// Radiance of the distant layer by direction, 0 where the model is met.
    pub distant_picture: RadianceImage,
    /// Irradiance of each patch, plate units.
    pub irradiance: Vec<[f32; 3]>,
    /// Figures by name.
    pub figures: Vec<(&'static str, f64)>,
}

impl Built {
    fn figure(&self, name: &str) -> Option<f64> {
        self.figures.iter().find(|(n, _)| *n == name).map(|(_, v)| *v)
    }

    /// What the figures say against the model.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if let Some(share) = self.figure("behind_power_share").filter(|s| *s > 0.05) {
            let percent = 100.0 * share;
            warnings.push(format!(
                "{percent:.0} % of the probe's light meets faces from behind: the probe must stand inside the room"
            ));
        }
        if let Some(ratio) = self.figure("plate_over_probe_radiance").filter(|r| !(0.8..1.25).contains(r)) {
            warnings.push(format!(
                "surfaces are {ratio:.2} times as bright in the plate as in the probe: check exposures and reflectivity"
            ));
        }
        if let Some(share) = self.figure("power_share_gathered").filter(|s| *s > 0.2) {
            let percent = 100.0 * share;
            warnings.push(format!(
                "{percent:.0} % of the light comes from surfaces seen in neither probe nor plate"
            ));
        }
        warnings
    }
}

/// Builds it. `probe_blur` is the angular standard deviation (per axis, rad) with which the probe shows a point at a
/// direction.
pub fn build(
    faces: &[Face],
    env: &Environment,
    plate: Option<&Plate>,
    known: &Known,
    settings: &config::Illuminate,
    probe_blur: impl Fn(Vec3) -> f64,
) -> Result<Built, Problem> {
    for (name, value) in [
        ("max_edge_m", settings.max_edge_m),
        ("min_edge_m", settings.min_edge_m),
        ("max_power_share", settings.max_power_share),
    ] {
        if !(value.is_finite() && value > 0.0) {
            return Err(Problem::Setting { name, value });
        }
    }
    if env.power() <= 0.0 {
        return Err(Problem::Dark);
    }
    let mut meshes: Vec<Option<FaceMesh>> = faces.iter().map(FaceMesh::new).collect();
    if meshes.iter().all(Option::is_none) {
        return Err(Problem::NoFaces(faces.len()));
    }
    for m in meshes.iter_mut().flatten() {
        m.refine(|p| graded(settings.max_edge_m, p));
    }
    let primitives = primitives(faces);
    let mut emitters = known.faces.clone();
    let mut env = without_known(env, &meshes, &emitters, &probe_blur);
    let mut stage = Stage::new(&meshes, &env, plate, &emitters);
    for _ in 0..REFINEMENTS {
        let sizes = stage.sizes(settings);
        if sizes.iter().all(Option::is_none) {
            break;
        }
        for (f, m) in meshes.iter_mut().enumerate() {
            let marked: Vec<(Vec3, f64, f64)> = (0..sizes.len())
                .filter(|&i| stage.mesh.patches[i].face as usize == f)
                .filter_map(|i| {
                    let c = stage.mesh.centroid(i);
                    let reach = stage.mesh.corners(i).iter().map(|p| p.distance(c)).fold(0.0, f32::max);
                    Some((c, f64::from(reach), sizes[i]?))
                })
                .collect();
            if let (Some(m), false) = (m, marked.is_empty()) {
                m.refine(|p| {
                    let near = marked.iter().filter(|(c, reach, _)| f64::from(p.distance(*c)) < 0.7 * reach);
                    near.map(|(_, _, size)| *size).fold(graded(settings.max_edge_m, p), f64::min)
                });
            }
        }
        stage = Stage::new(&meshes, &env, plate, &emitters);
    }
    let mut lamps = 0;
    loop {
        let distant = stage.distant(&env, known, settings, &probe_blur);
        let lamp = lamps::strongest(
            &stage.mesh,
            &stage.bvh,
            &distant.0.sources,
            &env,
            &primitives,
            &emitters,
            &probe_blur,
        );
        let Some(lamp) = lamp else { return Ok(stage.finish(distant, settings, &primitives, lamps)) };
        lamps += 1;
        for face in lamp.faces.keys() {
            meshes[*face as usize].iter_mut().for_each(|m| m.shift(lamp.offset));
        }
        emitters.extend(lamp.faces);
        env = without_known(&env, &meshes, &emitters, &probe_blur);
        stage = Stage::new(&meshes, &env, plate, &emitters);
    }
}

/// Whether a patch sends far more light than it gets.
pub(super) fn shines(radiance: [f32; 3], irradiance: [f32; 3]) -> bool {
    std::f32::consts::PI * luminance(radiance) > SHINES * luminance(irradiance)
}

/// For each face the number of the primitive that it belongs to.
fn primitives(faces: &[Face]) -> Vec<usize> {
    let mut names: Vec<&str> = Vec::new();
    let mut out = Vec::with_capacity(faces.len());
    for face in faces {
        let name = face.name.split('.').next().unwrap_or_default();
        let at = names.iter().position(|n| *n == name).unwrap_or(names.len());
        if at == names.len() {
            names.push(name);
        }
        out.push(at);
    }
    out
}

/// A mesh with its radiance from probe and plate.
struct Stage {
    mesh: PatchMesh,
    bvh: Bvh,
    projected: Projected,
    plate: Option<PlateSamples>,
    /// Plate over probe luminance where both see a patch.
    ratios: Vec<f64>,
}

impl Stage {
    fn new(
        meshes: &[Option<FaceMesh>],
        env: &Environment,
        plate: Option<&Plate>,
        emitters: &BTreeMap<u32, [f32; 3]>,
    ) -> Self {
        let mut mesh = assemble(meshes);
        let bvh = Bvh::new(&mesh.vertices, &mesh.triangles());
        let mut projected = project::from_probe(env, &mesh, &bvh);
        let plate = plate.map(|p| project::from_plate(p.camera, p.radiance, p.clipped, &mesh, &bvh));
        let mut ratios = Vec::new();
        for i in 0..mesh.patches.len() {
            if let Some(radiance) = emitters.get(&mesh.patches[i].face) {
                projected.samples[i] = Samples::default();
                (mesh.patches[i].radiance, mesh.patches[i].evidence) = (*radiance, Evidence::Probe);
                continue;
            }
            let probe = projected.samples[i].mean();
            let from_plate = plate.as_ref().and_then(|p| p.radiance(&mesh, i));
            if let (Some(a), Some(b)) = (probe, from_plate)
                && luminance(a) > 0.0
                && luminance(b) > 0.0
            {
                ratios.push(f64::from(luminance(b)) / f64::from(luminance(a)));
            }
            let (radiance, evidence) = match (from_plate, probe) {
                (Some(l), _) => (l, Evidence::Plate),
                (None, Some(l)) => (l, Evidence::Probe),
                (None, None) => ([0.0; 3], Evidence::Gathered),
            };
            mesh.patches[i].radiance = radiance;
            mesh.patches[i].evidence = evidence;
        }
        ratios.sort_by(f64::total_cmp);
        Self { mesh, bvh, projected, plate, ratios }
    }

    /// For patches to be split, the longest edge to be.
    fn sizes(&self, settings: &config::Illuminate) -> Vec<Option<f64>> {
        let all: f64 = (0..self.mesh.patches.len()).map(|i| power(&self.mesh, i)).sum();
        let limit = settings.max_power_share * all.max(f64::MIN_POSITIVE);
        (0..self.mesh.patches.len())
            .map(|i| {
                let [a, b, c] = self.mesh.corners(i);
                let longest = f64::from((b - a).length().max((c - b).length()).max((a - c).length()));
                // What a mean over the patch puts in the wrong place counts four times: borders of windows and lamps.
                let samples = match self.mesh.patches[i].evidence {
                    Evidence::Plate => self.plate.as_ref().map(|p| p.samples[i]),
                    _ => Some(self.projected.samples[i]),
                };
                let misplaced = samples.map_or(0.0, |s| s.deviation()) * f64::from(self.mesh.area(i));
                let split = power(&self.mesh, i) > limit || 4.0 * misplaced > limit;
                (split && longest > settings.min_edge_m).then(|| (longest / 2.0).max(settings.min_edge_m))
            })
            .collect()
    }

    fn finish(
        mut self,
        (distant, picture, open): (Distant, RadianceImage, f64),
        settings: &config::Illuminate,
        primitives: &[usize],
        small_lamps: usize,
    ) -> Built {
        let mut seen: Vec<bool> =
            self.mesh.patches.iter().map(|p| p.evidence != Evidence::Gathered).collect();
        let mut gather = Gather::new(&self.mesh, &distant.sources, &self.bvh, |i| seen[i]);
        let rho = settings.unseen_reflectance.clamp(0.0, MAX_REFLECTANCE);
        let mut irradiance = gather.irradiance(&self.mesh);
        let lamps = self.complete_lamps(&mut seen, &irradiance, primitives);
        if lamps > 0 {
            gather = Gather::new(&self.mesh, &distant.sources, &self.bvh, |i| seen[i]);
            irradiance = gather.irradiance(&self.mesh);
        }
        for _ in 0..ROUNDS {
            for (i, p) in self.mesh.patches.iter_mut().enumerate().filter(|(i, _)| !seen[*i]) {
                p.radiance = irradiance[i].map(|e| rho * e / std::f32::consts::PI);
                p.reflectance = [rho; 3];
            }
            irradiance = gather.irradiance(&self.mesh);
        }
        let (mut excess, mut reflected, mut area, mut beyond) = (0.0, 0.0, 0.0, 0.0);
        for i in 0..self.mesh.patches.len() {
            let a = f64::from(self.mesh.area(i));
            let p = &mut self.mesh.patches[i];
            if seen[i] {
                let raw: [f32; 3] = std::array::from_fn(|k| {
                    std::f32::consts::PI * p.radiance[k] / irradiance[i][k].max(1e-12)
                });
                p.reflectance = raw.map(|r| r.clamp(0.0, MAX_REFLECTANCE));
                excess += a * f64::from(u8::from(luminance(raw) > 1.0));
                // What a surface would have to reflect beyond the bound, unless it shines.
                let over = luminance(raw) - MAX_REFLECTANCE;
                if over > 0.0 && luminance(raw) < SHINES {
                    beyond += a * f64::from(over);
                }
            }
            reflected += a * f64::from(luminance(p.reflectance));
            area += a;
        }
        let mut figures = self.figures(&distant, open, excess / area, reflected / area);
        figures.push(("lamps_completed", lamps as f64));
        figures.push(("small_lamps", small_lamps as f64));
        figures.push(("reflectance_excess", beyond / area));
        let light = LightModel { mesh: self.mesh, distant: distant.sources };
        Built { light, distant_picture: picture, irradiance, figures }
    }

    /// A primitive that shines wherever it is seen shines all over: its unseen patches get the mean radiance of the seen ones.
    /// Returns how many such lamps have a side that nothing shows.
    fn complete_lamps(&mut self, seen: &mut [bool], irradiance: &[[f32; 3]], primitives: &[usize]) -> usize {
        let count = primitives.iter().max().map_or(0, |m| m + 1);
        // By primitive: area seen, area that shines, radiance × area that shines, whether there is more.
        let mut sums = vec![(0.0f64, 0.0f64, [0.0f64; 3], false); count];
        let primitive = |patch: &super::patch::Patch| primitives[patch.face as usize];
        for (i, patch) in self.mesh.patches.iter().enumerate() {
            let (sum, area) = (&mut sums[primitive(patch)], f64::from(self.mesh.area(i)));
            if !seen[i] {
                sum.3 = true;
                continue;
            }
            sum.0 += area;
            if shines(patch.radiance, irradiance[i]) {
                sum.1 += area;
                (0..3).for_each(|k| sum.2[k] += area * f64::from(patch.radiance[k]));
            }
        }
        let lamps: Vec<Option<[f32; 3]>> = sums
            .iter()
            .map(|(all, shining, radiance, more)| {
                let is_lamp = *more && *shining > 0.5 * all && *shining > 0.0;
                is_lamp.then(|| radiance.map(|r| (r / shining) as f32))
            })
            .collect();
        for (i, patch) in self.mesh.patches.iter_mut().enumerate() {
            if let (Some(radiance), false) = (lamps[primitives[patch.face as usize]], seen[i]) {
                patch.radiance = radiance;
                seen[i] = true;
            }
        }
        lamps.iter().flatten().count()
    }

    /// The distant light, its picture, and the share of the sphere that it has.
    fn distant(
        &self,
        env: &Environment,
        known: &Known,
        settings: &config::Illuminate,
        probe_blur: impl Fn(Vec3) -> f64,
    ) -> (Distant, RadianceImage, f64) {
        if let Some(sky) = &known.sky {
            return whole_sky(sky, settings);
        }
        let free = &self.projected.free;
        let open = (0..free.len()).map(|i| env.solid_angle(i) * f64::from(free[i])).sum::<f64>()
            / (4.0 * std::f64::consts::PI);
        let (w, h) = env.size();
        if open < MIN_OPEN {
            return (Distant::default(), Image::from_fn(w, h, |_, _| Radiance::default()), open);
        }
        let filled = fill_blind(env, free);
        let layer = Layer { radiance: &filled, share: free };
        (distant::cut(&layer, settings.distant_sources, probe_blur), layer.picture(), open)
    }

    fn figures(
        &self,
        distant: &Distant,
        open: f64,
        excess: f64,
        reflectance: f64,
    ) -> Vec<(&'static str, f64)> {
        let n = self.mesh.patches.len();
        let by = |e: Evidence| (0..n).filter(move |&i| self.mesh.patches[i].evidence == e);
        let power_of = |e: Evidence| by(e).map(|i| power(&self.mesh, i)).sum::<f64>();
        let all: f64 = (0..n).map(|i| power(&self.mesh, i)).sum::<f64>().max(f64::MIN_POSITIVE);
        let mut figures = vec![
            ("patches", n as f64),
            ("patches_from_probe", by(Evidence::Probe).count() as f64),
            ("patches_from_plate", by(Evidence::Plate).count() as f64),
            ("patches_gathered", by(Evidence::Gathered).count() as f64),
            ("power_share_from_probe", power_of(Evidence::Probe) / all),
            ("power_share_from_plate", power_of(Evidence::Plate) / all),
            ("power_share_gathered", power_of(Evidence::Gathered) / all),
            ("mean_reflectance", reflectance),
            ("emitting_area_share", excess),
            ("behind_power_share", self.projected.behind_share),
            ("open_share", open),
            ("distant_sources", distant.sources.len() as f64),
        ];
        if let Some(radius) = distant.sun_radius {
            figures.push(("sun_angular_radius_deg", radius.to_degrees()));
        }
        if let Some(median) = self.ratios.get(self.ratios.len() / 2) {
            figures.push(("plate_over_probe_radiance", *median));
        }
        figures
    }
}

/// The environment blind where it shows a known emitter or blurs one: a texel there holds light that is known already, and would
/// put it a second time on what lies beside or behind.
fn without_known(
    env: &Environment,
    meshes: &[Option<FaceMesh>],
    emitters: &BTreeMap<u32, [f32; 3]>,
    probe_blur: impl Fn(Vec3) -> f64,
) -> Environment {
    let mut masked = env.clone();
    if emitters.is_empty() {
        return masked;
    }
    let mesh = assemble(meshes);
    let bvh = Bvh::new(&mesh.vertices, &mesh.triangles());
    let shows: Vec<bool> = (0..env.weight.len())
        .into_par_iter()
        .map(|i| {
            let hit = bvh.closest(env.origin[i], env.direction(i), 0.0, f32::MAX);
            hit.is_some_and(|h| emitters.contains_key(&mesh.patches[h.triangle as usize].face))
        })
        .collect();
    let (w, h) = env.size();
    for i in (0..w * h).filter(|&i| shows[i]) {
        let (x, y) = (i % w, i / w);
        let blurred = lamps::REACH * probe_blur(env.direction(i)) * h as f64 / std::f64::consts::PI;
        let beside = (blurred.ceil() as usize).max(BESIDE);
        for v in y.saturating_sub(beside)..(y + beside + 1).min(h) {
            // Columns crowd together towards the poles.
            let polar = std::f64::consts::PI * (v as f64 + 0.5) / h as f64;
            let reach = ((beside as f64 / polar.sin()).ceil() as usize).min(w / 2);
            for u in 0..=2 * reach {
                masked.weight[v * w + (x + w + u - reach) % w] = 0.0;
            }
        }
    }
    masked
}

/// All of a known sky, whatever hides from the probe: rays find what the model hides from each receiver.
fn whole_sky(sky: &Environment, settings: &config::Illuminate) -> (Distant, RadianceImage, f64) {
    let layer = Layer { radiance: &sky.radiance, share: &sky.weight };
    let open = (0..sky.weight.len()).map(|i| sky.solid_angle(i) * f64::from(sky.weight[i])).sum::<f64>()
        / (4.0 * std::f64::consts::PI);
    (distant::cut(&layer, settings.distant_sources, |_| 0.0), layer.picture(), open)
}

/// The radiance with texels that the ball does not show taken from their open neighbours, ring by ring.
fn fill_blind(env: &Environment, free: &[f32]) -> RadianceImage {
    let (w, h) = env.size();
    let mut radiance = env.radiance.clone();
    let mut known: Vec<bool> = (0..w * h).map(|i| env.weight[i] > 0.25 && free[i] > 0.0).collect();
    loop {
        let ring: Vec<(usize, [f32; 3])> = (0..w * h)
            .filter(|&i| !known[i] && free[i] > 0.0)
            .filter_map(|i| {
                let (x, y) = (i % w, i / w);
                let (mut sum, mut count) = ([0.0f32; 3], 0.0f32);
                for v in y.saturating_sub(1)..(y + 2).min(h) {
                    for u in [(x + w - 1) % w, x, (x + 1) % w] {
                        if known[v * w + u] {
                            (0..3).for_each(|k| sum[k] += radiance.at(u, v).0[k]);
                            count += 1.0;
                        }
                    }
                }
                (count > 0.0).then(|| (i, sum.map(|s| s / count)))
            })
            .collect();
        if ring.is_empty() {
            break;
        }
        for (i, l) in ring {
            radiance.pixels_mut()[i] = Radiance(l);
            known[i] = true;
        }
    }
    for i in (0..w * h).filter(|&i| !known[i]) {
        radiance.pixels_mut()[i] = Radiance::default();
    }
    radiance
}

#[cfg(test)]
#[path = "build_tests.rs"]
mod tests;

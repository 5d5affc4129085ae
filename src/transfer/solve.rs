//! From lights and what the plate sees to transfers: sets, trees, sparse rows, refinement, shafts.

use super::field::LightField;
use super::lights::Light;
use super::links::Links;
use super::refine::{Limits, refine};
use super::rows::{Lighting, Row, Surroundings, strong_clusters, vertex_points};
use super::sets;
use super::shafts::{Ends, ShaftHierarchy};
use super::{Finish, Problem, ReceiverMesh, Source, SourceTree, Transfers};
use crate::config;
use crate::illuminate::patch::LightModel;
use crate::image::luminance;
use crate::shadow::Receivers;
use crate::visibility::Bvh;
use ndarray::Array2;
use std::collections::BTreeMap;

/// Receiver vertices at which the power of sources is estimated, at most.
const SAMPLES: usize = 256;
/// How finely that is done: clusters that send less than this share of a vertex's light are taken as one.
const SAMPLE_TOLERANCE: f64 = 2e-3;
/// Vertices that get less than this share of the average, as under the feet of furniture, do not count in the largest share
/// that is left out.
const DARK: f64 = 0.01;
/// Clusters of sources by which receivers are judged to be fine enough.
const PROFILE: usize = 64;

/// Transfers from every light to the vertices of what the plate sees.
///
/// The source set is made of the strongest lights that together have the share `source_share`, by their part in the light of
/// the receivers' places (share of the luminance of irradiance, integrated over the receivers' area, estimated at up to 256
/// receiver vertices: what lies under a table counts like what a lamp shines on) or by their power (gibson §4), as the
/// settings say. All others count in the total irradiance and are reported. `advance` is called once for each point that is
/// gathered.
pub fn solve(
    light: &LightModel,
    receivers: &Receivers,
    settings: &config::Transfer,
    advance: impl Fn() + Sync,
) -> Result<Transfers, Problem> {
    solve_glossy(light, receivers, None, settings, advance)
}

/// The same where receivers also mirror: transfers hold the lobes' share as irradiance.
pub fn solve_glossy(
    light: &LightModel,
    receivers: &Receivers,
    finish: Option<Finish>,
    settings: &config::Transfer,
    advance: impl Fn() + Sync,
) -> Result<Transfers, Problem> {
    check(light, settings)?;
    let mesh = &light.mesh;
    if receivers.seen.is_empty() {
        return Err(Problem::NoReceiver { patches: mesh.patches.len() });
    }
    let mut receiver_mesh = ReceiverMesh::new(mesh, receivers.seen.clone());
    let bvh = Bvh::new(&mesh.vertices, &mesh.outlined());
    let surroundings = Surroundings::new(mesh, finish, &receiver_mesh, &bvh, settings.rays as u32);
    let points = vertex_points(&receiver_mesh, &surroundings);
    let areas = receiver_mesh.vertex_areas();
    let area: f64 = areas.iter().sum();

    let all = LightField::new(&Light::all(light));
    let lights = &all.lights;
    let sample = sets::sample(&areas, SAMPLES).into_iter().map(|(v, weight)| (points[v].1, weight));
    let [received, shares] = surroundings.received(&all, &sample.collect::<Vec<_>>(), SAMPLE_TOLERANCE);
    let total: f64 = received.iter().sum();
    if total <= 0.0 {
        return Err(Problem::NoLight { sources: mesh.patches.len() + light.distant.len() });
    }
    let facing: Vec<_> = receiver_mesh.normals.iter().copied().zip(areas).collect();
    let set = sets::source_set(lights, [&received, &shares], settings.order, settings.source_share, &facing);
    let mut in_set = vec![false; lights.len()];
    set.iter().for_each(|&i| in_set[i] = true);
    let part = |member: bool| -> Vec<Light> {
        lights.iter().zip(&in_set).filter(|(_, m)| **m == member).map(|(l, _)| *l).collect()
    };
    let members = surroundings.field(LightField::new(&part(true)));
    let rest = surroundings.field(LightField::new(&part(false)));
    let power: BTreeMap<_, _> = lights.iter().zip(&received).map(|(l, &r)| (l.kind, r)).collect();
    let source = |l: &Light| {
        let power = power[&l.kind];
        Source { kind: l.kind, power_share: power / total, mean: power / area }
    };
    let sources: Vec<Source> = members.lights.lights.iter().map(source).collect();
    let tree = SourceTree::of(&members.lights.tree, &sources);

    let profile = strong_clusters(&tree, PROFILE);
    let lighting = Lighting {
        set: &members,
        rest: &rest,
        tree: &tree,
        profile: &profile,
        tolerance: settings.link_tolerance,
    };
    let mut rows = surroundings.rows(&lighting, &points, &advance);
    if settings.receiver_tolerance > 0.0 {
        let limits = Limits {
            tolerance: settings.receiver_tolerance,
            vertices: settings.receiver_vertices,
            plate: &receivers.pixels,
        };
        refine(&mut receiver_mesh, &mut rows, &surroundings, &lighting, &limits, &advance);
    }
    let irradiance = Array2::from(rows.iter().map(|r| r.irradiance).collect::<Vec<_>>());
    let bright = |r: &Row| f64::from(luminance(r.irradiance));
    let floor = DARK * rows.iter().map(bright).sum::<f64>() / rows.len() as f64;
    let lit = rows.iter().filter(|r| bright(r) > floor);
    let largest_left_out_share = lit.map(|r| r.left_out).fold(0.0, f64::max);
    let links = Links::of(&rows.into_iter().map(|r| r.cut).collect::<Vec<_>>());
    let shafts = ShaftHierarchy::build(
        &Ends {
            tree: &tree,
            lights: &members.lights.tree,
            receivers: &receiver_mesh,
            links: &links,
            irradiance: &irradiance,
        },
        settings.leaf_patches,
        settings.shaft_share,
    );
    let kept: f64 = sources.iter().map(|s| s.power_share).sum();
    Ok(Transfers {
        left_out: received.iter().filter(|&&r| r > 0.0).count() - sources.len(),
        left_out_share: (1.0 - kept).max(0.0),
        largest_left_out_share,
        sources,
        tree,
        receivers: receiver_mesh,
        links,
        irradiance,
        shafts,
    })
}

fn check(light: &LightModel, settings: &config::Transfer) -> Result<(), Problem> {
    if !(settings.source_share > 0.0 && settings.source_share <= 1.0) {
        return Err(Problem::Share(settings.source_share));
    }
    if settings.rays == 0 {
        return Err(Problem::NoRays);
    }
    let patches = light.mesh.patches.iter().enumerate().map(|(i, p)| ("patch", i, p.radiance));
    let distant = light.distant.iter().enumerate().map(|(i, d)| ("distant source", i, d.radiance));
    match patches.chain(distant).find(|(_, _, r)| r.iter().any(|c| !(c.is_finite() && *c >= 0.0))) {
        Some((what, index, radiance)) => Err(Problem::Radiance { what, index, radiance }),
        None => Ok(()),
    }
}

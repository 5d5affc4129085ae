//! Maps of others: our environment of a ball against a map that was published of the same photographs, and irradiance by
//! harmonics against pictures of it by Monte Carlo.

use crate::artefact::exr;
use crate::config::ProbeSource;
use crate::driver::validate;
use crate::error::{Error, FileContext, Result};
use crate::exposure::{Photograph, decode};
use crate::image::{Image, RadianceImage, luminance};
use crate::printer::Printer;
use crate::probe::views::{self, View};
use crate::probe::{Environment, ProbeFit, Unwrapped, latlong, mirror_ball};
use crate::sh;
use crate::stage::Workspace;
use glam::Vec3;
use nalgebra::{Point2, UnitQuaternion, Vector3};
use std::path::{Path, PathBuf};

/// Pictures of irradiance by Monte Carlo are called so after their map.
const MONTE_CARLO: &str = "_irradianceMCIS.png";
/// A lamp is brighter than this share of the brightest texel, and its surroundings reach so far, rad.
const LAMP: f32 = 0.15;
const AROUND: f32 = 0.12;
/// Smaller lamps are left out, sr.
const LEAST_SR: f64 = 2e-3;
/// Width to which maps are brought, texels.
const WIDTH: usize = 256;

/// Prints a line for each map of the folder.
pub(in crate::bench) fn print(settings: &[PathBuf], folder: Option<&Path>, printer: &Printer) -> Result<()> {
    let folder = folder.ok_or_else(|| Error::Usage {
        problem: "the table `panorama` needs published maps".into(),
        hint: "name a folder of latlong .hdr files: --environments DIR".into(),
    })?;
    let doing = "looking for maps";
    let mut maps = Vec::new();
    for entry in std::fs::read_dir(folder).at(doing, folder)? {
        let path = entry.at(doing, folder)?.path();
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("hdr")) {
            maps.push(path);
        }
    }
    maps.sort();
    for path in &maps {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let Photograph::Linear(map) = decode(path)? else { continue };
        let picture = path.with_file_name(format!("{name}{MONTE_CARLO}"));
        if picture.exists() {
            let [raw, windowed] = against_monte_carlo(&map, &picture)?;
            printer.data(&format!(
                "{name}: irradiance in harmonics against Monte Carlo, rank correlation over normals: {raw:.4}, windowed {windowed:.4}"
            ));
        } else {
            for file in settings {
                against_published(file, &name, &map, printer)?;
            }
        }
    }
    Ok(())
}

/// Spearman's correlation over all normals: a picture's tone curve does not change it.
fn against_monte_carlo(map: &RadianceImage, picture: &Path) -> Result<[f64; 2]> {
    let Photograph::Codes(codes) = decode(picture)? else {
        return Err(Error::file("reading a picture", picture, "is linear", "give a PNG"));
    };
    let (w, h) = map.size();
    let texels = map.pixels().iter().enumerate().map(|(i, l)| {
        let d = latlong::direction((i % w) as f32 + 0.5, (i / w) as f32 + 0.5, w, h);
        (d, l.0, latlong::texel_solid_angle(i / w, w, h))
    });
    let raw = sh::project(texels);
    let (w, h) = codes.size();
    let theirs: Vec<f32> = codes.pixels().iter().map(|c| luminance(c.0)).collect();
    Ok([raw, sh::windowed(&raw)].map(|c| {
        let ours: Vec<f32> = (0..w * h)
            .map(|i| {
                let n = latlong::direction((i % w) as f32 + 0.5, (i / w) as f32 + 0.5, w, h);
                luminance(sh::irradiance(&c, n))
            })
            .collect();
        rank_correlation(&ours, &theirs)
    }))
}

fn rank_correlation(a: &[f32], b: &[f32]) -> f64 {
    let ranks = |values: &[f32]| {
        let mut order: Vec<usize> = (0..values.len()).collect();
        order.sort_by(|i, j| values[*i].total_cmp(&values[*j]));
        let mut ranks = vec![0.0f64; values.len()];
        let mut from = 0;
        while from < order.len() {
            // Equal values share their mean rank.
            let equal = order[from..].iter().take_while(|i| values[**i] == values[order[from]]).count();
            let mean = from as f64 + (equal as f64 - 1.0) / 2.0;
            order[from..from + equal].iter().for_each(|i| ranks[*i] = mean);
            from += equal;
        }
        ranks
    };
    let (a, b) = (ranks(a), ranks(b));
    let middle = (a.len() as f64 - 1.0) / 2.0;
    let dot =
        |x: &[f64], y: &[f64]| -> f64 { x.iter().zip(y).map(|(p, q)| (p - middle) * (q - middle)).sum() };
    dot(&a, &b) / (dot(&a, &a) * dot(&b, &b)).sqrt()
}

/// Our environment, as stage `probe` left it, against a published map: turned, or mirrored and turned, until both agree best. A
/// ball's also as a camera at infinity would have it, as many published maps take it.
fn against_published(file: &Path, name: &str, map: &RadianceImage, printer: &Printer) -> Result<()> {
    let workspace = Workspace::open(file)?;
    let path = workspace.folder("probe").join("environment.exr");
    let refuse = || Error::file("reading a picture", &path, "lacks planes", "run `insitu-probe` first");
    let ours = Environment::from_planes(&exr::read(&path)?).ok_or_else(refuse)?;
    let fit: ProbeFit = crate::artefact::json::read(&workspace.folder("probe").join("probe.json"))?;
    let mut ways = vec![(ours.clone(), "")];
    if fit.source == ProbeSource::Ball {
        ways.push((from_infinity(&ours, &fit), ", ours as if seen from infinity"));
    }
    for (ours, how) in ways {
        compare(&format!("{}{how}", validate::name(file)), &ours, &fit, name, map, printer);
    }
    Ok(())
}

/// The environment of who takes the ball as seen from infinity: what a pixel mirrors is put where parallel rays would be
/// mirrored to.
fn from_infinity(ours: &Environment, fit: &ProbeFit) -> Environment {
    let view = (fit.camera.centre() - fit.centre).normalize();
    let rotation = fit.camera.world_from_camera.rotation;
    let [right, down] = [Vector3::x(), Vector3::y()].map(|axis| rotation * axis);
    let lens = &fit.camera.intrinsics;
    let at = |d: Vec3| {
        let d = Vector3::new(f64::from(d.x), f64::from(d.y), f64::from(d.z));
        let normal = (view + d).try_normalize(1e-9)?;
        let disc = [normal.dot(&right), normal.dot(&down)];
        let [x, y] = [0, 1].map(|k| lens.principal_point_px[k] + 0.5 * fit.diameter_px * disc[k]);
        let ray = mirror_ball::reflected_ray(&fit.camera, &fit.centre, fit.radius_m, &Point2::new(x, y))?;
        let d = ray.direction;
        Some(Vec3::new(d.x as f32, d.y as f32, d.z as f32))
    };
    let mut made = ours.clone();
    for i in 0..ours.weight.len() {
        let seen = at(ours.direction(i));
        made.radiance.pixels_mut()[i] =
            seen.map_or(Default::default(), |d| latlong::lookup(&ours.radiance, d));
        made.weight[i] = seen.map_or(0.0, |d| ours.weight[ours.texel(d)]);
    }
    made
}

/// Prints how two environments of one place agree.
fn compare(
    what: &str,
    ours: &Environment,
    fit: &ProbeFit,
    name: &str,
    map: &RadianceImage,
    printer: &Printer,
) {
    let ours = View { fit: fit.clone(), seen: brought(&ours.radiance, Some(ours)) };
    let mirrored = Image::from_fn(map.width(), map.height(), |x, y| *map.at(map.width() - 1 - x, y));
    let tried = [(map, ""), (&mirrored, "mirrored, ")].map(|(map, how)| {
        let theirs = View { fit: fit.clone(), seen: brought(map, None) };
        let (turn, agreement) = views::turn(&theirs, &ours, 0.0);
        (agreement, turn, theirs, how)
    });
    let [a, b] = tried;
    let (agreement, turn, theirs, how) = if a.0 >= b.0 { a } else { b };
    let mut shifts = lamps(&theirs.seen.environment, &ours.seen.environment, &turn);
    shifts.sort_by(f64::total_cmp);
    let listed: Vec<String> = shifts.iter().map(|s| format!("{s:.1}")).collect();
    printer.data(&format!(
        "{what}: against {name}.hdr ({how}turned by {:.0}°): correlation of log luminance {agreement:.3}; lamps off by {}°",
        turn.angle().to_degrees(),
        listed.join(", ")
    ));
}

/// A map at a common width, its vertical ours, shown where the environment it is of is shown.
fn brought(map: &RadianceImage, of: Option<&Environment>) -> Unwrapped {
    let (w, h) = (WIDTH, WIDTH / 2);
    let small = crate::maps::convert(map, crate::maps::Layout::Latlong, crate::maps::Layout::Latlong, h);
    let weight = |i: usize| {
        of.map_or(1.0, |e| {
            let d = latlong::direction((i % w) as f32 + 0.5, (i / w) as f32 + 0.5, w, h);
            e.weight[e.texel(d)]
        })
    };
    let environment = Environment {
        radiance: small,
        origin: vec![Vec3::ZERO; w * h],
        weight: (0..w * h).map(weight).collect(),
    };
    Unwrapped { environment, clipped_power_share: 0.0, blind_share: 0.0 }
}

/// For each lamp of a map, degrees between its centroid, turned, and that of what is bright there in ours.
fn lamps(theirs: &Environment, ours: &Environment, turn: &UnitQuaternion<f64>) -> Vec<f64> {
    let (w, h) = theirs.size();
    let bright: Vec<f32> = theirs.radiance.pixels().iter().map(|l| l.luminance()).collect();
    let top = bright.iter().copied().fold(0.0, f32::max);
    let mut free: Vec<bool> = bright.iter().map(|l| *l > LAMP * top).collect();
    let mut shifts = Vec::new();
    for start in 0..w * h {
        if !free[start] {
            continue;
        }
        let (mut lamp, mut next) = (Vec::new(), vec![start]);
        free[start] = false;
        while let Some(i) = next.pop() {
            lamp.push(i);
            let (x, y) = (i % w, i / w);
            for (u, v) in
                [((x + 1) % w, y), ((x + w - 1) % w, y), (x, (y + 1).min(h - 1)), (x, y.saturating_sub(1))]
            {
                if std::mem::take(&mut free[v * w + u]) {
                    next.push(v * w + u);
                }
            }
        }
        if lamp.iter().map(|i| theirs.solid_angle(*i)).sum::<f64>() < LEAST_SR {
            continue;
        }
        let centroid = |e: &Environment, of: &[usize]| -> Vec3 {
            let sum: Vec3 = of
                .iter()
                .map(|i| e.direction(*i) * (e.radiance.pixels()[*i].luminance() * e.solid_angle(*i) as f32))
                .sum();
            sum.normalize_or_zero()
        };
        let turned = |d: Vec3| {
            let d = turn * Vector3::new(f64::from(d.x), f64::from(d.y), f64::from(d.z));
            Vec3::new(d.x as f32, d.y as f32, d.z as f32)
        };
        let there = turned(centroid(theirs, &lamp));
        let reach =
            lamp.iter().map(|i| turned(theirs.direction(*i)).angle_between(there)).fold(0.0, f32::max);
        let around: Vec<usize> = (0..w * h)
            .filter(|i| ours.direction(*i).angle_between(there) < reach + AROUND && ours.weight[*i] > 0.9)
            .collect();
        let most = around.iter().map(|i| ours.radiance.pixels()[*i].luminance()).fold(0.0, f32::max);
        let shines: Vec<usize> =
            around.into_iter().filter(|i| ours.radiance.pixels()[*i].luminance() > 0.5 * most).collect();
        shifts.push(f64::from(centroid(ours, &shines).angle_between(there)).to_degrees());
    }
    shifts
}

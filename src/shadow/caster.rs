//! A coarser object for shadow maps (Gibson et al. 2003, §7.2).

use super::Occluder;
use crate::config::{Render, ShadowMethod};
use glam::Vec3;
use meshopt::{SimplifyOptions, simplify_decoder};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// A simplified object may depart from the whole by this share of its diameter: less than a texel of most shadow maps.
const MOST_ERROR: f32 = 0.006;
/// Vertices at which the departure is measured.
const PROBED: usize = 4096;

/// What is drawn into shadow maps.
#[derive(Debug, Clone, PartialEq)]
pub struct Caster {
    /// The object, perhaps with fewer triangles.
    pub occluder: Occluder,
    /// Largest distance found from the whole object's vertices to the simplified surface, m.
    pub error_m: f32,
}

impl Caster {
    /// What the method that the settings name looks at.
    pub fn of(occluder: &Occluder, settings: &Render) -> Self {
        match settings.method {
            // Rays see the whole object, and slices cost the same whatever it has.
            ShadowMethod::Raytraced | ShadowMethod::OcclusionTextures => Self::new(occluder, 0),
            ShadowMethod::RadianceTransfer
            | ShadowMethod::RadianceTransferLdr
            | ShadowMethod::Subtractive
            | ShadowMethod::LightDome => Self::new(occluder, settings.caster_triangles),
        }
    }

    /// The object with about `triangles` triangles (0: as it is), more where they are needed to keep its shape. An
    /// object that has few is left as it is. Open borders stay where they are.
    pub fn new(occluder: &Occluder, triangles: usize) -> Self {
        let whole = || Self { occluder: occluder.clone(), error_m: 0.0 };
        if triangles == 0 || occluder.triangles.len() <= triangles {
            return whole();
        }
        let welded = welded(occluder);
        let (low, high) = welded
            .vertices
            .iter()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), p| (a.min(*p), b.max(*p)));
        let most = MOST_ERROR * low.distance(high);
        let indices = welded.triangles.as_flattened();
        let mut target = triangles;
        while target < welded.triangles.len() {
            let options = SimplifyOptions::LockBorder | SimplifyOptions::ErrorAbsolute;
            let kept =
                simplify_decoder(indices, &positions(&welded.vertices), 3 * target, most, options, None);
            let triangles = kept.as_chunks::<3>().0.to_vec();
            if !triangles.is_empty() {
                let simple = compacted(&welded.vertices, &triangles).with_volume_of(&welded);
                let error_m = departure(&welded.vertices, &simple);
                if error_m <= most {
                    return Self { occluder: simple, error_m };
                }
            }
            target *= 2;
        }
        whole()
    }

    /// The same shape elsewhere; the motion is rigid.
    pub fn moved(&self, motion: &glam::Affine3A) -> Self {
        Self { occluder: self.occluder.moved(motion), error_m: self.error_m }
    }
}

impl Occluder {
    /// The same object elsewhere.
    pub fn moved(&self, motion: &glam::Affine3A) -> Self {
        let vertices = self.vertices.iter().map(|&v| motion.transform_point3(v)).collect();
        Self { vertices, triangles: self.triangles.clone() }
    }
}

impl Occluder {
    /// A simplified surface lies inside a convex one, and so casts too small a shadow: closed ones are blown up along
    /// their normals until they hold what the whole holds.
    fn with_volume_of(mut self, whole: &Self) -> Self {
        let (Some(inside), Some(wanted)) = (self.volume(), whole.volume()) else { return self };
        let mut normals = vec![Vec3::ZERO; self.vertices.len()];
        let mut area = 0.0;
        for t in &self.triangles {
            let [a, b, c] = t.map(|v| self.vertices[v as usize]);
            let n = (b - a).cross(c - a);
            area += f64::from(n.length()) / 2.0;
            t.iter().for_each(|&v| normals[v as usize] += n);
        }
        if area > 0.0 {
            let by = ((wanted - inside) / area) as f32;
            self.vertices.iter_mut().zip(normals).for_each(|(p, n)| *p += n.normalize_or_zero() * by);
        }
        self
    }

    /// Volume of a closed surface, m³, below 0 where it is inside out.
    fn volume(&self) -> Option<f64> {
        let edges = || self.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
        let found: HashSet<(u32, u32)> = edges().collect();
        let closed = found.len() == 3 * self.triangles.len() && edges().all(|(a, b)| found.contains(&(b, a)));
        let part = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| (self.vertices[v as usize] - self.vertices[0]).as_dvec3());
            a.dot(b.cross(c)) / 6.0
        };
        closed.then(|| self.triangles.iter().map(part).sum())
    }
}

fn positions(vertices: &[Vec3]) -> Vec<[f32; 3]> {
    vertices.iter().map(|v| v.to_array()).collect()
}

/// One vertex a place, no degenerate triangles: normals that split vertices are no borders of a shadow.
fn welded(occluder: &Occluder) -> Occluder {
    let mut index = HashMap::new();
    let mut vertices = Vec::new();
    let triangles = occluder.triangles.iter().map(|t| {
        t.map(|v| {
            // + 0 makes −0 and 0 one.
            let p = occluder.vertices[v as usize] + Vec3::ZERO;
            *index.entry(p.to_array().map(f32::to_bits)).or_insert_with(|| {
                vertices.push(p);
                vertices.len() as u32 - 1
            })
        })
    });
    let triangles: Vec<_> = triangles.filter(|[a, b, c]| a != b && b != c && c != a).collect();
    Occluder { vertices, triangles }
}

/// Without the vertices that no triangle uses.
fn compacted(vertices: &[Vec3], triangles: &[[u32; 3]]) -> Occluder {
    let mut place = vec![u32::MAX; vertices.len()];
    let mut kept = Vec::new();
    let triangles = triangles
        .iter()
        .map(|t| {
            t.map(|v| {
                if place[v as usize] == u32::MAX {
                    place[v as usize] = kept.len() as u32;
                    kept.push(vertices[v as usize]);
                }
                place[v as usize]
            })
        })
        .collect();
    Occluder { vertices: kept, triangles }
}

/// Largest distance from some vertices to a surface.
fn departure(vertices: &[Vec3], surface: &Occluder) -> f32 {
    let step = vertices.len().div_ceil(PROBED).max(1);
    let corners: Vec<[Vec3; 3]> =
        surface.triangles.iter().map(|t| t.map(|v| surface.vertices[v as usize])).collect();
    let distance = |p: Vec3| {
        let nearest = corners.iter().map(|&t| on_triangle(p, t).distance_squared(p));
        nearest.fold(f32::INFINITY, f32::min).sqrt()
    };
    let probed: Vec<Vec3> = vertices.iter().step_by(step).copied().collect();
    probed.into_par_iter().map(distance).reduce(|| 0.0, f32::max)
}

/// The point of a triangle that lies nearest to `p` (Ericson, Real-Time Collision Detection, 2004, §5.1.5).
fn on_triangle(p: Vec3, [a, b, c]: [Vec3; 3]) -> Vec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    if sum > 0.0 { a + ab * (vb / sum) + ac * (vc / sum) } else { a }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f32::consts::{PI, TAU};

    fn sphere(rings: u32) -> Occluder {
        let mut out = Occluder::default();
        let turns = 2 * rings;
        for (i, j) in (0..=rings).flat_map(|i| (0..turns).map(move |j| (i, j))) {
            let (theta, phi) = (PI * i as f32 / rings as f32, TAU * j as f32 / turns as f32);
            // One place at each pole.
            let sine = if i == 0 || i == rings { 0.0 } else { theta.sin() };
            out.vertices.push(Vec3::new(sine * phi.cos(), theta.cos(), sine * phi.sin()) * 0.2);
        }
        for (i, j) in (0..rings).flat_map(|i| (0..turns).map(move |j| (i, j))) {
            let at = |i: u32, j: u32| i * turns + j % turns;
            out.triangles.push([at(i, j), at(i, j + 1), at(i + 1, j)]);
            out.triangles.push([at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)]);
        }
        out
    }

    #[test]
    fn a_sphere_keeps_its_shape_with_fewer_triangles() {
        let whole = sphere(40);
        let caster = Caster::new(&whole, 500);
        let count = caster.occluder.triangles.len();
        assert!((200..=1000).contains(&count), "{count} of {}", whole.triangles.len());
        assert!(
            caster.error_m > 0.0 && caster.error_m <= MOST_ERROR * 0.4 * 3f32.sqrt(),
            "{}",
            caster.error_m
        );
        let (found, expected) = (welded(&caster.occluder).volume(), welded(&whole).volume());
        let (Some(found), Some(expected)) = (found, expected) else { panic!("a sphere is closed") };
        assert!((found / expected - 1.0).abs() < 2e-3, "{found} m³ of {expected}");
        assert_eq!(Caster::new(&whole, 0).occluder, whole);
        assert_eq!(Caster::new(&sphere(6), 500).occluder, sphere(6), "few triangles stay as they are");
        let turned = glam::Affine3A::from_rotation_y(0.3);
        assert_eq!(caster.moved(&turned).occluder, caster.occluder.moved(&turned));
    }

    #[test]
    fn the_border_of_an_open_sheet_stays() {
        let n = 40u32;
        let vertices = (0..=n)
            .flat_map(|j| (0..=n).map(move |i| Vec3::new(i as f32, 0.0, j as f32) / n as f32))
            .collect();
        let quad = |i: u32, j: u32| [j * (n + 1) + i, j * (n + 1) + i + 1, (j + 1) * (n + 1) + i];
        let triangles = (0..n)
            .flat_map(|j| (0..n).map(move |i| (i, j)))
            .flat_map(|(i, j)| [quad(i, j), [quad(i, j)[1], quad(i, j)[2] + 1, quad(i, j)[2]]])
            .collect();
        let sheet = Occluder { vertices, triangles };
        let caster = Caster::new(&sheet, 200);
        assert!(caster.occluder.triangles.len() < sheet.triangles.len() / 4);
        let area: f32 = (caster.occluder.triangles.iter())
            .map(|t| t.map(|v| caster.occluder.vertices[v as usize]))
            .map(|[a, b, c]| (b - a).cross(c - a).length() / 2.0)
            .sum();
        assert!((area - 1.0).abs() < 1e-4 && caster.error_m < 1e-5, "{area}, {}", caster.error_m);
    }

    proptest! {
        #[test]
        fn no_point_of_a_triangle_lies_nearer(
            c in proptest::array::uniform12(-1.0..1.0f32), u in 0.0..1.0f32, v in 0.0..1.0f32,
        ) {
            let [p, a, b, d] = [0, 3, 6, 9].map(|k| Vec3::new(c[k], c[k + 1], c[k + 2]));
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let other = a + (b - a) * u + (d - a) * v;
            prop_assert!(on_triangle(p, [a, b, d]).distance(p) <= other.distance(p) + 1e-5);
        }
    }
}

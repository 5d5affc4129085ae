//! Receivers are split where what reaches them is not linear: at the borders of the scene's own shadows, so that light
//! which furniture hides already is not taken away again beside them.
//!
//! At the middle of an edge the triangles beside it are off by the difference between what is gathered there and the mean
//! of the ends. Its square, weighed by the pixels that see those triangles, is the edge's share in the mean square error
//! of the picture: the edges of the largest shares are halved until the rest is within the tolerance (Dörfler 1996).
//! Middles are gathered in the same order, by what they can be off at most: where clusters of sources are hidden to
//! different parts at the ends, half the difference. Triangles are bisected at their longest edge first (Rivara 1984), so
//! that the mesh stays conforming and its angles stay bounded.

use super::receivers::{Part, ReceiverMesh, Split};
use super::rows::{Lighting, Row, Surroundings};
use crate::image::Image;
use crate::shadow::Receiver;
use glam::Vec3;
use std::collections::{BTreeMap, BTreeSet};

/// Edges are not halved that have fewer pixels beside them.
const LEAST_PIXELS: f64 = 4.0;
/// The picture is judged by about so many of its pixels.
const JUDGED_PIXELS: usize = 1 << 20;

/// Where to stop.
pub(super) struct Limits<'a> {
    /// Root mean square over the picture of how far receivers are off, as a share of the irradiance.
    pub tolerance: f64,
    /// Receiver vertices.
    pub vertices: usize,
    /// What each pixel sees.
    pub plate: &'a Image<Option<Receiver>>,
}

type Edge = (u32, u32);

struct Middle {
    row: Row,
    /// How far it is from the mean of the ends, as a share of the irradiance.
    off: f64,
}

/// The triangles beside an edge.
#[derive(Default)]
struct Beside {
    /// Sum and number of their centroids.
    centroids: (Vec3, f32),
    /// A patch of theirs.
    patch: u32,
    /// Pixels that see them.
    pixels: f64,
}

/// Splits receivers and appends the rows of new vertices; `done` is called for each point that is gathered.
pub(super) fn refine(
    receivers: &mut ReceiverMesh,
    rows: &mut Vec<Row>,
    surroundings: &Surroundings,
    lighting: &Lighting,
    limits: &Limits,
    done: &(impl Fn() + Sync),
) {
    let all = limits.plate.pixels();
    let step = all.len().div_ceil(JUDGED_PIXELS).max(1);
    let place = |r: &Receiver| Some((receivers.root(r.patch)?, r.barycentric));
    let mut judged: Vec<_> = all.iter().step_by(step).flatten().filter_map(place).collect();
    // Each pixel lies beside three edges.
    let most = limits.tolerance.powi(2) * 3.0 * (step * judged.len()) as f64;
    let mut middles: BTreeMap<Edge, Middle> = BTreeMap::new();
    while receivers.positions.len() < limits.vertices {
        let left = limits.vertices - receivers.positions.len();
        let pixels = receivers.count(&mut judged);
        let edges = edges(receivers, pixels.iter().map(|&n| (step * n as usize) as f64));
        let gather = |middles: &mut BTreeMap<Edge, Middle>,
                      receivers: &ReceiverMesh,
                      rows: &[Row],
                      chosen: &[Edge]| {
            let point = |edge: &Edge| {
                let beside = &edges[edge];
                let (position, normal) = (receivers.middle(*edge), receivers.normals[edge.0 as usize]);
                let group = surroundings.group(receivers, beside.patch);
                (group, surroundings.point(beside.patch, position, normal, beside.centroids))
            };
            let points: Vec<_> = chosen.iter().map(point).collect();
            for (&edge, row) in chosen.iter().zip(surroundings.rows(lighting, &points, done)) {
                let off = bent(&rows[edge.0 as usize], &row, &rows[edge.1 as usize]);
                middles.insert(edge, Middle { row, off });
            }
        };
        let seen = || edges.iter().filter(|(_, beside)| beside.pixels >= LEAST_PIXELS);
        let at_most = |(&e, beside): (&Edge, &Beside)| {
            let [a, b] = [e.0, e.1].map(|v| &rows[v as usize]);
            (e, (uneven(a, b) / 2.0).powi(2) * beside.pixels)
        };
        let unknown = seen().filter(|(e, _)| !middles.contains_key(e)).map(at_most).collect();
        let mut candidates = largest(unknown, most);
        candidates.truncate(left);
        gather(&mut middles, receivers, rows, &candidates);
        let square = |(&e, beside): (&Edge, &Beside)| Some((e, middles.get(&e)?.off.powi(2) * beside.pixels));
        let squares: Vec<(Edge, f64)> = seen().filter_map(square).collect();
        if squares.iter().map(|s| s.1).sum::<f64>() <= most {
            break;
        }
        // The other half is for what the parts are still off.
        let mut halved = largest(squares, most / 2.0);
        halved.truncate(left);
        let halved = closed(receivers, halved);
        let missing: Vec<Edge> = halved.iter().copied().filter(|e| !middles.contains_key(e)).collect();
        gather(&mut middles, receivers, rows, &missing);
        let mut vertex_of = BTreeMap::new();
        for edge in halved {
            if let Some(middle) = middles.remove(&edge) {
                vertex_of.insert(edge, receivers.halve(edge));
                rows.push(middle.row);
            }
        }
        receivers.bisect(&vertex_of);
    }
}

/// The fewest edges, largest squares first, without which the squares of the others sum up to no more than `rest`.
fn largest(mut squares: Vec<(Edge, f64)>, rest: f64) -> Vec<Edge> {
    squares.sort_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
    let sums = squares.iter().scan(0.0, |sum, s| {
        *sum += s.1;
        Some(*sum)
    });
    let small = sums.take_while(|&sum| sum <= rest).count();
    squares.drain(..small);
    squares.into_iter().rev().map(|s| s.0).collect()
}

/// Edges of the triangles, which have so many pixels each.
fn edges(receivers: &ReceiverMesh, pixels: impl Iterator<Item = f64>) -> BTreeMap<Edge, Beside> {
    let mut edges: BTreeMap<Edge, Beside> = BTreeMap::new();
    for (t, pixels) in receivers.triangles.iter().zip(pixels) {
        let centroid = receivers.centroid(t);
        for k in 0..3 {
            let beside = edges.entry(edge(t.vertices, k)).or_default();
            beside.centroids = (beside.centroids.0 + centroid, beside.centroids.1 + 1.0);
            beside.patch = t.patch;
            beside.pixels += pixels;
        }
    }
    edges
}

/// The edge from corner `k` of a triangle to the next, its lower vertex first.
fn edge(vertices: [u32; 3], k: usize) -> Edge {
    let (a, b) = (vertices[k], vertices[(k + 1) % 3]);
    (a.min(b), a.max(b))
}

/// How differently clusters are hidden at two points, as a share of their irradiance.
fn uneven(a: &Row, b: &Row) -> f64 {
    let seen = |[sent, open]: [f32; 2]| if open > 0.0 { f64::from(sent / open) } else { 1.0 };
    let both = || a.profile.iter().zip(&b.profile);
    let change: f64 = both()
        .filter(|(p, q)| p[1] > 0.0 && q[1] > 0.0)
        .map(|(&p, &q)| (seen(p) - seen(q)).abs() * f64::from(p[1] + q[1]) / 2.0)
        .sum();
    let all: f64 = both().map(|(p, q)| f64::from(p[0] + q[0]) / 2.0).sum();
    if all > 0.0 { change / all } else { 0.0 }
}

/// How far a middle is from the mean of two ends, as a share of the larger.
fn bent(a: &Row, middle: &Row, b: &Row) -> f64 {
    let sent = |r: &Row, k: usize| f64::from(r.profile[k][0]);
    let clusters = 0..middle.profile.len();
    let mean = |k: usize| (sent(a, k) + sent(b, k)) / 2.0;
    let off: f64 = clusters.clone().map(|k| (sent(middle, k) - mean(k)).abs()).sum();
    let all = clusters.clone().map(mean).sum::<f64>().max(clusters.map(|k| sent(middle, k)).sum());
    if all > 0.0 { off / all } else { 0.0 }
}

/// Some edges, and the longest edges of all triangles that have one of them.
fn closed(receivers: &ReceiverMesh, edges: Vec<Edge>) -> BTreeSet<Edge> {
    let mut all: BTreeSet<Edge> = edges.into_iter().collect();
    loop {
        let before = all.len();
        for t in &receivers.triangles {
            if (0..3).any(|k| all.contains(&edge(t.vertices, k))) {
                all.insert(edge(t.vertices, receivers.longest(t.vertices)));
            }
        }
        if all.len() == before {
            return all;
        }
    }
}

impl ReceiverMesh {
    fn middle(&self, (a, b): Edge) -> Vec3 {
        (self.positions[a as usize] + self.positions[b as usize]) / 2.0
    }

    fn length(&self, (a, b): Edge) -> f32 {
        self.positions[a as usize].distance(self.positions[b as usize])
    }

    /// Corner at which the longest edge starts; of equal ones the same for both triangles beside it.
    fn longest(&self, vertices: [u32; 3]) -> usize {
        let key = |k: usize| (self.length(edge(vertices, k)), edge(vertices, k));
        let longer = |a: &usize, b: &usize| {
            let (x, y) = (key(*a), key(*b));
            x.0.total_cmp(&y.0).then(x.1.cmp(&y.1))
        };
        (0..3).max_by(longer).unwrap_or(0)
    }

    /// Adds the vertex in the middle of an edge.
    fn halve(&mut self, edge: Edge) -> u32 {
        self.positions.push(self.middle(edge));
        self.normals.push(self.normals[edge.0 as usize]);
        self.positions.len() as u32 - 1
    }

    /// Bisects all triangles with halved edges, at the longest first. Of each such triangle the longest is halved.
    fn bisect(&mut self, vertex_of: &BTreeMap<Edge, u32>) {
        let mut next = 0;
        while next < self.parts.len() {
            let vertices = self.parts[next].vertices;
            let halved = |k: usize| vertex_of.contains_key(&edge(vertices, k));
            if self.parts[next].split.is_none() && (0..3).any(halved) {
                let longest = self.longest(vertices);
                let k =
                    if halved(longest) { longest } else { (0..3).find(|&k| halved(k)).unwrap_or(longest) };
                let middle = vertex_of[&edge(vertices, k)];
                let (mut low, mut high) = (vertices, vertices);
                low[(k + 1) % 3] = middle;
                high[k] = middle;
                self.parts[next].split = Some(Split { edge: k as u8, first: self.parts.len() as u32 });
                self.parts.extend([low, high].map(|vertices| Part { vertices, split: None }));
            }
            next += 1;
        }
        self.list_triangles();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A square grid of n × n × 2 triangles.
    fn grid(n: u32) -> ReceiverMesh {
        let at = |i: u32, j: u32| i * (n + 1) + j;
        let quads = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
        let triangles = quads.flat_map(|(i, j)| {
            [[at(i, j), at(i, j + 1), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i + 1, j)]]
        });
        let parts: Vec<Part> = triangles.map(|vertices| Part { vertices, split: None }).collect();
        let mut mesh = ReceiverMesh {
            positions: (0..=n)
                .flat_map(|i| (0..=n).map(move |j| Vec3::new(i as f32, 0.0, j as f32)))
                .collect(),
            normals: vec![Vec3::Y; ((n + 1) * (n + 1)) as usize],
            triangles: Vec::new(),
            patches: (0..parts.len() as u32).collect(),
            parts,
        };
        mesh.list_triangles();
        mesh
    }

    proptest! {
        #[test]
        fn split_meshes_conform_and_locate_every_point(
            picks in prop::collection::vec(prop::collection::vec(0usize..1000, 1..6), 1..5),
            patch in 0u32..18, u in 0.0..1.0f32, v in 0.0..1.0f32,
        ) {
            let mut mesh = grid(3);
            let flat = mesh.clone();
            for round in picks {
                let all: Vec<Edge> = edges(&mesh, std::iter::repeat(1.0)).into_keys().collect();
                let chosen = round.iter().map(|&k| all[k % all.len()]).collect();
                let vertex_of: BTreeMap<_, _> =
                    closed(&mesh, chosen).into_iter().map(|e| (e, mesh.halve(e))).collect();
                mesh.bisect(&vertex_of);
            }
            // No vertex lies within an edge, and the area stays.
            let edges = edges(&mesh, std::iter::repeat(1.0));
            for (&(a, b), beside) in &edges {
                let [p, q] = [a, b].map(|v| mesh.positions[v as usize]);
                for &r in &mesh.positions {
                    let inside = (r.distance(p) + r.distance(q) - p.distance(q)).abs() < 1e-5;
                    prop_assert!(!inside || r.distance(p) < 1e-5 || r.distance(q) < 1e-5, "T-junction at {}", r);
                }
                prop_assert!(beside.pixels <= 2.0);
            }
            let area = mesh.vertex_areas().iter().sum::<f64>();
            prop_assert!((area - 9.0).abs() < 1e-4);
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let weights = [1.0 - u - v, u, v];
            let place = |m: &ReceiverMesh| {
                let (vertices, w) = m.locate(patch, weights).unwrap();
                assert!(w.iter().all(|&w| w >= -1e-5) && (w.iter().sum::<f32>() - 1.0).abs() < 1e-5);
                (0..3).map(|k| m.positions[vertices[k] as usize] * w[k]).sum::<Vec3>()
            };
            prop_assert!(place(&mesh).distance(place(&flat)) < 1e-5);
        }
    }

    proptest! {
        #[test]
        fn the_largest_leave_no_more_than_asked_for(
            squares in prop::collection::vec(0.0..9.0f64, 0..30), rest in 0.0..40.0f64,
        ) {
            let squares: Vec<(Edge, f64)> = (0..).map(|i| (i, i + 1)).zip(squares).collect();
            let chosen = largest(squares.clone(), rest);
            let square = |e: &Edge| squares[e.0 as usize].1;
            prop_assert!(chosen.is_sorted_by(|a, b| square(a) >= square(b)));
            let all: f64 = squares.iter().map(|s| s.1).sum();
            let left = all - chosen.iter().map(square).sum::<f64>();
            prop_assert!(left <= rest + 1e-9);
            prop_assert!(chosen.last().is_none_or(|e| left + square(e) > rest - 1e-9), "one too many");
        }
    }

    #[test]
    fn only_patches_of_the_receivers_are_located() {
        assert!(grid(1).locate(7, [1.0, 0.0, 0.0]).is_none());
    }

    #[test]
    fn what_is_linear_is_not_bent() {
        let row = |a: f32, b: f32| Row { profile: vec![[a, 2.0], [b, 1.0]], ..Default::default() };
        assert_eq!(bent(&row(1.0, 1.0), &row(1.5, 0.5), &row(2.0, 0.0)), 0.0);
        assert!((bent(&row(1.0, 1.0), &row(2.0, 0.5), &row(2.0, 0.0)) - 0.2).abs() < 1e-6);
        assert_eq!(uneven(&row(1.0, 1.0), &row(1.0, 1.0)), 0.0);
        assert!((uneven(&row(2.0, 1.0), &row(0.0, 1.0)) - 1.0).abs() < 1e-6);
    }
}

//! Edges along the room's three directions, found instead of marked: segments are grouped by the orthogonal vanishing
//! points that explain most of them (Coughlan and Yuille 1999), drawn at random from the segments themselves.

use super::Problem;
use super::vanishing::{self, Edge, EdgeFit, Room, RoomEdges, StatedFocal, edge_residual};
use crate::least_squares::Loss;
use nalgebra::{Matrix3, Point2, Rotation3, Vector2, Vector3};
use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};
use rayon::prelude::*;

/// Accuracy of a segment's end, px: the scale of the robust loss.
pub const SEGMENT_SIGMA_PX: f64 = 0.7;
/// Turn of a segment against its direction in the room that has nothing to do with its length, rad.
const DIRECTION_SIGMA: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Shortest segment, of the image's diagonal.
const SHORTEST: f64 = 0.015;
/// Share of segments that are edges along one of the directions, before any is looked at.
const PRIOR: f64 = 0.5;
/// Rooms tried, and how many of the longest segments judge each.
const TRIES: usize = 4000;
const JUDGES: usize = 250;
/// So many of the best are refined.
const REFINED: usize = 6;
/// A segment agrees with a vanishing point within so many standard deviations, at first and at last.
const AGREE: [f64; 3] = [6.0, 3.0, 3.0];
/// Without a stated one the focal length is sought in this range, of the image's diagonal: 17 to 105 mm on 24 × 36 mm.
const FOCAL: std::ops::Range<f64> = 0.4..2.5;
/// Mean log-likelihood ratio of a judge below which chance explains the segments as well.
const CHANCE: f64 = 0.25;
const SEED: u64 = 1;

/// Edges found and the room that they fit.
#[derive(Debug, Clone)]
pub struct Found {
    /// The segments that agree, by direction: z is the direction nearest to the picture's vertical, x of the others the one
    /// nearest to its horizontal, pointing right; y points away from the camera.
    pub edges: RoomEdges,
    /// Focal length and orientation.
    pub fit: EdgeFit,
    /// Segments long enough to count.
    pub segments: usize,
}

impl Found {
    /// What was done, in words.
    pub fn told(&self) -> String {
        let along = self.edges.along.each_ref().map(Vec::len);
        format!(
            "no vanishing lines are marked: of {} line segments in the plate {} are taken as edges along x, {} along y, {} along \
             z ({:.1} px rms)",
            self.segments, along[0], along[1], along[2], self.fit.rms_px
        )
    }
}

/// A segment relative to the principal point, in units of the image's diagonal.
struct Judge {
    middle: Vector2<f64>,
    direction: Vector2<f64>,
    /// Normal of the plane through the segment and a camera of unit focal length.
    normal: Vector3<f64>,
    /// Standard deviation of its direction, rad.
    sigma: f64,
    /// Its length: long ones are rarely clutter.
    weight: f64,
}

impl Judge {
    fn new(edge: &Edge, centre: Point2<f64>, diagonal_px: f64) -> Self {
        let [p, q] = edge.map(|p| (p - centre) / diagonal_px);
        let length = (q - p).norm();
        let end = SEGMENT_SIGMA_PX / diagonal_px * 2f64.sqrt() / length;
        Self {
            middle: (p + q) / 2.0,
            direction: (q - p) / length,
            normal: p.push(1.0).cross(&q.push(1.0)),
            sigma: DIRECTION_SIGMA.hypot(end),
            weight: length,
        }
    }

    /// Logarithm of how much likelier the segment is with these vanishing points than with any direction alike.
    fn evidence(&self, points: &[Vector3<f64>; 3]) -> f64 {
        let within: f64 = points
            .iter()
            .map(|v| {
                let towards = v.xy() - self.middle * v.z;
                let sine2 = self.direction.perp(&towards).powi(2) / towards.norm_squared();
                (-0.5 * sine2 / (self.sigma * self.sigma)).exp()
            })
            .sum();
        let peak = (std::f64::consts::PI / 2.0).sqrt() / self.sigma;
        (1.0 - PRIOR + PRIOR / 3.0 * peak * within).ln()
    }
}

/// Mean evidence of segments, long ones counting more.
fn evidence(room: &Room, judges: &[Judge]) -> f64 {
    let points = [0, 1, 2].map(|k| room.vanishing_point(k, Point2::origin()));
    let sum: f64 = judges.iter().map(|j| j.weight * j.evidence(&points)).sum();
    sum / judges.iter().map(|j| j.weight).sum::<f64>()
}

/// Finds the room's directions in a photograph's segments (px, freed of distortion). A stated focal length is a prior.
pub fn find(
    segments: &[Edge],
    centre: Point2<f64>,
    diagonal_px: f64,
    stated: Option<StatedFocal>,
) -> Result<Found, Problem> {
    let long = |[p, q]: &&Edge| (q - p).norm() >= SHORTEST * diagonal_px;
    let mut segments: Vec<Edge> = segments.iter().filter(long).copied().collect();
    segments.sort_by(|a, b| (b[1] - b[0]).norm().total_cmp(&(a[1] - a[0]).norm()));
    let none = |used| Problem::NoRoom { found: segments.len(), used };
    if segments.len() < 4 {
        return Err(none(0));
    }
    let judges: Vec<Judge> = segments.iter().map(|s| Judge::new(s, centre, diagonal_px)).collect();
    let few = &judges[..judges.len().min(JUDGES)];
    let mut tried: Vec<(f64, Room)> = (0..TRIES)
        .into_par_iter()
        .filter_map(|k| {
            let mut random = SmallRng::seed_from_u64(SEED + k as u64);
            let room =
                draw(&judges, stated.map(|s| (s.focal_px / diagonal_px, s.relative_sigma)), &mut random)?;
            Some((evidence(&room, few), room))
        })
        .collect();
    tried.sort_by(|a, b| b.0.total_cmp(&a.0));
    let refined = tried[..tried.len().min(REFINED)].par_iter().filter_map(|(_, room)| {
        let start = Room { focal_px: room.focal_px * diagonal_px, ..*room };
        let (edges, fit) = refine(start, &segments, centre, stated)?;
        let scaled = Room { focal_px: fit.focal_px / diagonal_px, camera_from_room: fit.camera_from_room };
        Some((evidence(&scaled, &judges), edges, fit))
    });
    let best = refined.max_by(|a, b| a.0.total_cmp(&b.0));
    let (evidence, edges, fit) = best.ok_or_else(|| none(0))?;
    if evidence < CHANCE {
        return Err(none(edges.along.iter().map(Vec::len).sum()));
    }
    Ok(Found { edges, fit, segments: segments.len() })
}

/// A room from a few segments, long ones more likely: with a focal length two give one direction and a third another; without,
/// two and two give two directions, which are orthogonal with one focal length. All lengths in units of the diagonal.
fn draw(judges: &[Judge], stated: Option<(f64, f64)>, random: &mut SmallRng) -> Option<Room> {
    let total: f64 = judges.iter().map(|j| j.weight).sum();
    let mut normal = || {
        let mut left = random.random::<f64>() * total;
        let chosen = judges.iter().find(|j| {
            left -= j.weight;
            left <= 0.0
        });
        chosen.unwrap_or(&judges[0]).normal
    };
    let (a, b, c, d) = (normal(), normal(), normal(), normal());
    let (first, second) = (a.cross(&b), c.cross(&d));
    let focal_px = match stated {
        Some((focal, sigma)) => {
            // Nearly normal: three uniform numbers.
            let z: f64 = (0..3).map(|_| random.random_range(-1.0..1.0)).sum();
            focal * (sigma * z).exp()
        }
        None => {
            let f2 = -first.xy().dot(&second.xy()) / (first.z * second.z);
            if !f2.is_finite() || f2 <= 0.0 || !FOCAL.contains(&f2.sqrt()) {
                return None;
            }
            f2.sqrt()
        }
    };
    let direction = |v: Vector3<f64>| Vector3::new(v.x, v.y, v.z * focal_px).try_normalize(1e-12);
    let first = direction(first)?;
    let second = match stated {
        // A plane through the camera: its normal in the units of the focal length.
        Some(_) => first.cross(&Vector3::new(c.x * focal_px, c.y * focal_px, c.z)).try_normalize(1e-12)?,
        None => direction(second)?,
    };
    let third = first.cross(&second).try_normalize(1e-9)?;
    let camera_from_room = ordered([first, third.cross(&first), third]);
    Some(Room { focal_px, camera_from_room })
}

/// The right-handed frame of three orthogonal axes: z up, x to the right.
fn ordered(axes: [Vector3<f64>; 3]) -> Rotation3<f64> {
    let most = |of: &[usize], k: usize| {
        of.iter().copied().max_by(|a, b| axes[*a][k].abs().total_cmp(&axes[*b][k].abs())).unwrap_or(0)
    };
    let up = most(&[0, 1, 2], 1);
    let right = most(&[(up + 1) % 3, (up + 2) % 3], 0);
    let z = -axes[up] * axes[up].y.signum();
    let x = axes[right] * axes[right].x.signum();
    Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]))
}

/// Takes the segments that agree and fits the room to them, in turn.
fn refine(
    start: Room,
    segments: &[Edge],
    centre: Point2<f64>,
    stated: Option<StatedFocal>,
) -> Option<(RoomEdges, EdgeFit)> {
    let mut room = start;
    let mut last = None;
    for limit in AGREE {
        let edges = agreeing(&room, segments, centre, limit);
        let fit =
            vanishing::fit_from(&room, &edges, centre, SEGMENT_SIGMA_PX, stated, Loss::Cauchy(1.0)).ok()?;
        room = Room { focal_px: fit.focal_px, camera_from_room: fit.camera_from_room };
        last = Some((edges, fit));
    }
    last
}

/// Segments by the direction that each agrees with best, pointing along it.
fn agreeing(room: &Room, segments: &[Edge], centre: Point2<f64>, limit: f64) -> RoomEdges {
    let points = [0, 1, 2].map(|k| room.vanishing_point(k, centre));
    let mut edges = RoomEdges::default();
    for segment in segments {
        let miss = points.map(|v| edge_residual(&v, segment).abs() / SEGMENT_SIGMA_PX);
        let best = (0..3).min_by(|a, b| miss[*a].total_cmp(&miss[*b])).unwrap_or(0);
        if miss[best] < limit {
            let [p, q] = *segment;
            let v = points[best];
            let along = (q - p).dot(&(v.xy() - nalgebra::center(&p, &q).coords * v.z));
            edges.along[best].push(if along < 0.0 { [q, p] } else { [p, q] });
        }
    }
    edges
}

//! Edges along the room's three directions, found instead of marked: segments are grouped by the orthogonal vanishing
//! points that explain most of them (Coughlan and Yuille 1999), drawn at random from the segments themselves.

mod refine;
mod rival;

use super::Problem;
use super::vanishing::{Edge, EdgeFit, Room, RoomEdges, StatedFocal};
use nalgebra::{Matrix3, Point2, Rotation3, Vector2, Vector3};
use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};
use rayon::prelude::*;
use refine::refine;
use std::f64::consts::PI;

/// Accuracy of a segment's end, px: what rendered pictures show.
const SEGMENT_SIGMA_PX: f64 = 0.3;
/// Turn of a segment against its direction in the room that has nothing to do with its length, rad.
const DIRECTION_SIGMA: f64 = 0.3 * PI / 180.0;
/// Shortest segment, of the image's diagonal.
const SHORTEST: f64 = 0.015;
/// Share of segments that are edges along one of the directions, before any is looked at.
const PRIOR: f64 = 0.5;
/// Rooms tried, and how many of the longest segments judge each.
const TRIES: usize = 4000;
const JUDGES: usize = 250;
/// So many of the best are refined, not two of them with directions and focal lengths as near as this.
const REFINED: usize = 8;
const NEAR: [f64; 2] = [0.5 * PI / 180.0, 0.02];
/// Side of the squares of the picture whose segments count as one cluster, of its diagonal: about a quarter of its width.
const CLUSTER: f64 = 0.2;
/// A smaller share of a segment is left out.
const NEGLIGIBLE: f64 = 0.05;
/// A segment counts as an edge from this share on.
const AGREES: f64 = 0.5;
/// Turns of expectation and maximisation by the longest segments, and by all.
const TURNS: [usize; 2] = [6, 40];
/// Without a stated one the focal length is sought in this range, of the image's diagonal: 17 to 105 mm on 24 × 36 mm.
const FOCAL: std::ops::Range<f64> = 0.4..2.5;
/// Log-likelihood ratio of a segment, on average, and of all as if they were equally long, below which chance explains them as
/// well: the best of so many rooms finds some agreement anywhere.
const CHANCE: [f64; 2] = [0.25, 20.0];
/// The same where nothing but the room's turn is sought.
const CHANCE_TURN: [f64; 2] = [0.25, 6.0];
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

/// A segment, as it is and relative to the principal point in units of the image's diagonal.
struct Judge {
    /// Its ends, px.
    edge: Edge,
    middle: Vector2<f64>,
    direction: Vector2<f64>,
    /// Normal of the plane through the segment and a camera of unit focal length.
    normal: Vector3<f64>,
    /// Standard deviation of its direction, rad.
    sigma: f64,
    /// Its squared length: long ones are rarely clutter.
    weight: f64,
}

impl Judge {
    fn new(edge: &Edge, centre: Point2<f64>, diagonal_px: f64) -> Self {
        let [p, q] = edge.map(|p| (p - centre) / diagonal_px);
        let length = (q - p).norm();
        let end = SEGMENT_SIGMA_PX / diagonal_px * 2f64.sqrt() / length;
        Self {
            edge: *edge,
            middle: (p + q) / 2.0,
            direction: (q - p) / length,
            normal: p.push(1.0).cross(&q.push(1.0)),
            sigma: DIRECTION_SIGMA.hypot(end),
            weight: length * length,
        }
    }

    /// How much likelier the segment is as an edge towards this vanishing point than with any direction alike.
    fn likelihood(&self, point: &Vector3<f64>) -> f64 {
        let towards = point.xy() - self.middle * point.z;
        let sine2 = self.direction.perp(&towards).powi(2) / towards.norm_squared();
        (PI / 2.0).sqrt() / self.sigma * (-0.5 * sine2 / (self.sigma * self.sigma)).exp()
    }

    /// The direction that it agrees with best, and what share of it belongs to each.
    fn shares(&self, points: &[Vector3<f64>; 3]) -> (usize, [f64; 3]) {
        let likelihoods = points.each_ref().map(|v| self.likelihood(v));
        let best = (0..3).max_by(|a, b| likelihoods[*a].total_cmp(&likelihoods[*b])).unwrap_or(0);
        let all = 1.0 - PRIOR + PRIOR / 3.0 * likelihoods.iter().sum::<f64>();
        (best, likelihoods.map(|l| PRIOR / 3.0 * l / all))
    }

    /// Its length, px.
    fn length_px(&self, diagonal_px: f64) -> f64 {
        self.weight.sqrt() * diagonal_px
    }

    /// Logarithm of how much likelier it is as an edge along one of the three, or none, than with any direction alike.
    fn evidence(&self, points: &[Vector3<f64>; 3]) -> f64 {
        let sum: f64 = points.iter().map(|v| self.likelihood(v)).sum();
        (1.0 - PRIOR + PRIOR / 3.0 * sum).ln()
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
    let judges = judges(segments, centre, diagonal_px);
    let none = |used| Problem::NoRoom { found: judges.len(), used };
    if judges.len() < 4 {
        return Err(none(0));
    }
    // Where each one's share of all lengths ends.
    let ends: Vec<f64> = judges
        .iter()
        .scan(0.0, |sum, judge| {
            *sum += judge.weight.sqrt();
            Some(*sum)
        })
        .collect();
    let stated_in_diagonals = stated.map(|s| (s.focal_px / diagonal_px, s.relative_sigma));
    let few = &judges[..judges.len().min(JUDGES)];
    let mut tried: Vec<(f64, Room)> = (0..TRIES)
        .into_par_iter()
        .filter_map(|k| {
            let mut random = SmallRng::seed_from_u64(SEED + k as u64);
            let room = draw(&judges, &ends, stated_in_diagonals, &mut random)?;
            Some((evidence(&room, few), room))
        })
        .collect();
    tried.sort_by(|a, b| b.0.total_cmp(&a.0));
    let scaled = |room: &Room| Room { focal_px: room.focal_px / diagonal_px, ..*room };
    let mut starts = Vec::<Room>::new();
    for (_, room) in tried {
        let near = |other: &Room| {
            room.camera_from_room.angle_to(&other.camera_from_room) < NEAR[0]
                && (room.focal_px / other.focal_px).ln().abs() < NEAR[1]
        };
        if starts.len() < REFINED && !starts.iter().any(near) {
            starts.push(room);
        }
    }
    // By the longest segments, then by all.
    let refined = starts.par_iter().filter_map(|room| {
        let start = Room { focal_px: room.focal_px * diagonal_px, ..*room };
        let near = refine(start, few, centre, diagonal_px, stated, TURNS[0])?;
        let fit = refine(near.room, &judges, centre, diagonal_px, stated, TURNS[1])?;
        Some((evidence(&scaled(&fit.room), &judges), fit))
    });
    let mut refined: Vec<(f64, EdgeFit)> = refined.collect();
    refined.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut refined = refined.into_iter();
    let (evidence, mut fit) = refined.next().ok_or_else(|| none(0))?;
    let rivals: Vec<EdgeFit> = refined.map(|(_, fit)| fit).collect();
    rival::count(&mut fit, &rivals, &judges, diagonal_px);
    let edges = agreeing(&scaled(&fit.room), &judges);
    let within = stated.is_some() || FOCAL.contains(&(fit.room.focal_px / diagonal_px));
    if !within || is_chance(evidence, &judges, CHANCE) {
        return Err(none(edges.along.iter().map(Vec::len).sum()));
    }
    Ok(Found { edges, fit, segments: judges.len() })
}

/// The room's directions where lens and vertical (`up`, in the camera frame) are known, and the segments along each, as
/// [`Found`] has them. `along`: a horizontal direction of the room, in the camera frame, where that is known, too.
pub fn about_vertical(
    segments: &[Edge],
    centre: Point2<f64>,
    diagonal_px: f64,
    focal_px: f64,
    up: &Vector3<f64>,
    along: Option<Vector3<f64>>,
) -> Result<(Room, RoomEdges), Problem> {
    let judges = judges(segments, centre, diagonal_px);
    let scaled = |away: &Vector3<f64>| Room {
        focal_px: focal_px / diagonal_px,
        camera_from_room: Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[
            away.cross(up),
            *away,
            *up,
        ])),
    };
    let forward = Vector3::z() - up * up.z;
    // Looking straight down any direction is as far away as any other.
    let forward = forward.try_normalize(1e-6).unwrap_or_else(|| up.cross(&Vector3::x()).normalize());
    let turned = |from: &Vector3<f64>, angle: f64| from * angle.cos() + from.cross(up) * angle.sin();
    let best_of = |from: Vector3<f64>, step: f64, steps: i32| {
        let tried = (-steps..=steps).into_par_iter().map(|k| turned(&from, step * f64::from(k)));
        tried.map(|away| (evidence(&scaled(&away), &judges), away)).max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let none = |used| Problem::NoRoom { found: judges.len(), used };
    let away = match along {
        Some(along) => {
            let along = (along - up * along.dot(up)).try_normalize(1e-6).ok_or(none(0))?;
            let quarters = (0..4).map(|k| turned(&along, PI / 2.0 * f64::from(k)));
            quarters.max_by(|a, b| a.dot(&forward).total_cmp(&b.dot(&forward)))
        }
        None if judges.len() < 4 => None,
        // Half a quarter turn to both sides, then ever closer.
        None => best_of(forward, PI / 720.0, 180)
            .and_then(|(_, away)| best_of(away, PI / 7200.0, 15))
            .map(|(_, away)| away),
    };
    let room = scaled(&away.ok_or(none(0))?);
    let edges = agreeing(&room, &judges);
    if is_chance(evidence(&room, &judges), &judges, CHANCE_TURN) {
        return Err(none(edges.along.iter().map(Vec::len).sum()));
    }
    Ok((Room { focal_px, ..room }, edges))
}

/// Segments long enough to count, the longest first.
fn judges(segments: &[Edge], centre: Point2<f64>, diagonal_px: f64) -> Vec<Judge> {
    let long = |[p, q]: &&Edge| (q - p).norm() >= SHORTEST * diagonal_px;
    let mut judges: Vec<Judge> =
        segments.iter().filter(long).map(|s| Judge::new(s, centre, diagonal_px)).collect();
    judges.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    judges
}

/// Whether chance explains the segments as well.
fn is_chance(evidence: f64, judges: &[Judge], least: [f64; 2]) -> bool {
    let weights: f64 = judges.iter().map(|j| j.weight).sum();
    let as_many = weights * weights / judges.iter().map(|j| j.weight * j.weight).sum::<f64>();
    // Nothing to judge by is no evidence.
    !(evidence >= least[0] && evidence * as_many >= least[1])
}

/// A room from a few segments, long ones more likely: with a focal length two give one direction and a third another; without,
/// two and two give two directions, which are orthogonal with one focal length. All lengths in units of the diagonal; `ends`
/// are the running sums of the segments' lengths.
fn draw(judges: &[Judge], ends: &[f64], stated: Option<(f64, f64)>, random: &mut SmallRng) -> Option<Room> {
    let total = *ends.last()?;
    let mut normal = || {
        let at = random.random::<f64>() * total;
        judges[ends.partition_point(|end| *end < at).min(judges.len() - 1)].normal
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

/// Segments by the direction that each rather belongs to than not, pointing along it. Lengths in units of the diagonal.
fn agreeing(room: &Room, judges: &[Judge]) -> RoomEdges {
    let points = [0, 1, 2].map(|k| room.vanishing_point(k, Point2::origin()));
    let mut edges = RoomEdges::default();
    for judge in judges {
        let (best, shares) = judge.shares(&points);
        if shares[best] > AGREES {
            let towards = points[best].xy() - judge.middle * points[best].z;
            let [p, q] = judge.edge;
            edges.along[best].push(if judge.direction.dot(&towards) < 0.0 { [q, p] } else { [p, q] });
        }
    }
    edges
}

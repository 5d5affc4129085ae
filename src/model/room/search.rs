//! The layout that the picture speaks for most.

use super::contents::Contents;
use super::evidence::{Evidence, Support};
use super::layout::{AWAY, Edge, Layout, RIGHT, Side, UP};
use super::{Problem, Weak};
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Lines that may be feet of walls, corners between walls or upper edges: so many of each are tried.
const FEET: usize = 12;
const CORNERS: usize = 14;
const TOPS: usize = 8;
/// So many layouts are judged by their colours, too, and so many get a ceiling.
const COLOURED: usize = 300;
const CEILED: usize = 20;
/// Distance of a wall, in heights of the camera over the floor.
pub const DISTANCE: std::ops::Range<f64> = 0.25..10.0;
/// A ceiling is at least this far above the camera, in its heights over the floor.
const HEADROOM: f64 = 0.15;

/// What one more piece of each counts: edges that are not seen, lines that run on from face to face are as bad as supported edges are
/// good, lines that stick out of their face, nats a pixel of colour, and a further wall or ceiling.
const UNSEEN: f64 = 0.15;
const STICKING_OUT: f64 = 0.3;
const COLOUR: f64 = 120.0;
const FACE: f64 = 8.0;

/// What of a wall's foot the picture must support …
pub const LEAST_FOOT: f64 = 1.0 / 3.0;
/// … and of a corner between walls.
pub const LEAST_CORNER: f64 = 0.5;
/// A pixel's colour must tell so much of its face, nats: of two equal faces it tells 0.69 at most.
pub const LEAST_COLOUR: f64 = 0.4;
/// So much of a foot or corner tells of it, in pieces: a foot may be out of the picture, a corner must be seen.
const TELLING: f64 = 3.0;

/// Skirting boards are between this high, m …
const SKIRTING_M: std::ops::Range<f64> = 0.03..0.25;
/// … and are as high along all walls, within this share of their distance.
const SAME_SKIRTING: f64 = 0.01;
/// A room is nearly as good as another when of what that gains over an open floor it loses no more than this share.
const NEARLY: f64 = 0.1;
/// So many of the best are refined: steps by these shares of a distance, so often.
const REFINED: usize = 16;
const STEPS: [f64; 3] = [0.02, 0.007, 0.003];
const MOST_MOVES: usize = 6;

/// A layout with what speaks for it.
#[derive(Debug, Clone, Copy)]
struct Judged {
    layout: Layout,
    score: f64,
}

/// Finds it; `height_m` is the camera's over the floor.
pub fn search(evidence: &Evidence, contents: &Contents, height_m: f64) -> Result<Layout, Problem> {
    let judge = |layout: &Layout, coloured: bool| {
        let edges: Vec<(Edge, Support)> =
            layout.edges().into_iter().map(|e| (e, evidence.support(&e))).collect();
        let against = contents.against(layout);
        let faces = layout.walls().count() + usize::from(layout.has(Side::Ceiling));
        let sum = |of: &dyn Fn(&Support) -> f64| edges.iter().map(|(_, s)| of(s)).sum::<f64>();
        let colour = if coloured { COLOUR * contents.told_by_colour(layout) } else { 0.0 };
        sum(&|s| s.agree)
            - UNSEEN * sum(&|s| s.seen - s.agree)
            - against.crossing
            - STICKING_OUT * against.sticking_out
            + colour
            - FACE * faces as f64
    };
    let judged = |layouts: Vec<Layout>, coloured: bool| {
        let one = |layout: Layout| Judged { score: judge(&layout, coloured), layout };
        let mut all: Vec<Judged> = layouts.into_par_iter().map(one).collect();
        all.sort_by(|a, b| b.score.total_cmp(&a.score));
        all
    };
    let mut first = judged(with_walls(evidence, height_m), false);
    first.truncate(COLOURED);
    let walls = judged(first.into_iter().map(|j| j.layout).collect(), true);
    let tops = walls.iter().take(CEILED).flat_map(|j| with_ceiling(evidence, &j.layout)).collect();
    let mut all = judged(tops, true);
    all.extend(walls);
    all.sort_by(|a, b| b.score.total_cmp(&a.score));
    let close: Vec<Judged> =
        all[..all.len().min(REFINED)].par_iter().map(|j| refined(*j, &|l| judge(l, true))).collect();
    all.extend(close);
    all.sort_by(|a, b| b.score.total_cmp(&a.score));

    let open = judge(&Layout::open(height_m), true);
    let gain = |j: &Judged| j.score - open;
    let most = all.first().map_or(0.0, gain);
    let sound =
        |j: &&Judged| weakness(evidence, contents, &j.layout).is_none() && gain(j) > (1.0 - NEARLY) * most;
    let Some(best) = all.iter().find(sound).filter(|j| gain(j) > 0.0) else {
        let nearest =
            all.iter().find_map(|j| weakness(evidence, contents, &j.layout).filter(|w| w.walls >= 2));
        return Err(Problem::NoRoom(nearest.unwrap_or(Weak {
            walls: 0,
            foot: 0.0,
            corner: 0.0,
            colour: 0.0,
        })));
    };
    let enough = open + (1.0 - NEARLY) * gain(best);
    let without_skirting = all.iter().take_while(|j| j.score >= enough).filter(|j| {
        weakness(evidence, contents, &j.layout).is_none()
            && is_smaller_by_skirting(&j.layout, &best.layout, height_m)
    });
    let better = without_skirting.max_by(|a, b| a.score.total_cmp(&b.score));
    Ok(better.unwrap_or(best).layout)
}

/// A layout whose faces are moved, each by itself and all walls together, as long as that is better.
fn refined(from: Judged, judge: &impl Fn(&Layout) -> f64) -> Judged {
    let mut best = from;
    for share in STEPS {
        for _ in 0..MOST_MOVES {
            let sides: Vec<Side> =
                best.layout.walls().chain(best.layout.has(Side::Ceiling).then_some(Side::Ceiling)).collect();
            let walls: Vec<Side> = best.layout.walls().collect();
            let moves = sides.iter().map(std::slice::from_ref).chain([walls.as_slice()]);
            let moved = moves.flat_map(|sides| {
                [1.0 - share, 1.0 + share].map(|factor| {
                    let move_one = |l: Layout, s: &Side| l.with(*s, l.distance(*s) * factor);
                    sides.iter().fold(best.layout, move_one)
                })
            });
            let judged = moved.map(|layout| Judged { score: judge(&layout), layout });
            match judged.max_by(|a, b| a.score.total_cmp(&b.score)) {
                Some(better) if better.score > best.score => best = better,
                _ => break,
            }
        }
    }
    best
}

/// The upper edge of a skirting board looks like the foot of a wall further away, by the same share for all walls.
fn is_smaller_by_skirting(layout: &Layout, than: &Layout, height_m: f64) -> bool {
    let walls: Vec<Side> = than.walls().collect();
    if !layout.walls().eq(walls.iter().copied()) || layout.has(Side::Ceiling) != than.has(Side::Ceiling) {
        return false;
    }
    let shares: Vec<f64> = walls.iter().map(|&s| layout.distance(s) / than.distance(s)).collect();
    let mean = shares.iter().sum::<f64>() / shares.len().max(1) as f64;
    SKIRTING_M.contains(&((1.0 - mean) * height_m))
        && shares.iter().all(|share| (share - mean).abs() < SAME_SKIRTING)
}

/// What of a layout the picture supports too little; `None` where all is well.
fn weakness(evidence: &Evidence, contents: &Contents, layout: &Layout) -> Option<Weak> {
    let colour = contents.told_by_colour(layout);
    let mut weak = Weak { walls: layout.walls().count(), foot: 1.0, corner: 1.0, colour };
    for edge in layout.edges() {
        let support = evidence.support(&edge);
        if edge.axis == UP {
            let told = support.seen >= TELLING;
            weak.corner = weak.corner.min(if told { support.share() } else { 0.0 });
        } else if support.seen >= TELLING {
            weak.foot = weak.foot.min(support.share());
        }
    }
    let shown = weak.foot >= LEAST_FOOT && weak.corner >= LEAST_CORNER;
    let well = weak.walls >= 2 && shown && weak.colour >= LEAST_COLOUR;
    (!well).then_some(weak)
}

/// Rooms of one to three walls: feet that are lines on the floor, and feet that are where a corner between walls asks for them.
fn with_walls(evidence: &Evidence, height: f64) -> Vec<Layout> {
    let none = f64::INFINITY;
    let sensible = |d: f64| DISTANCE.contains(&(d / height));
    let below = |axis, range| evidence.peaks(axis, range, FEET).into_iter().map(|(angle, _)| angle);
    // Angles about the axis that points away count from the right upwards, about the axis to the right from above to away.
    let left: Vec<f64> =
        below(AWAY, PI..1.5 * PI).map(|a| height / a.tan()).filter(|d| sensible(*d)).collect();
    let right: Vec<f64> =
        below(AWAY, 1.5 * PI..TAU).map(|a| -height / a.tan()).filter(|d| sensible(*d)).collect();
    let back: Vec<f64> =
        below(RIGHT, FRAC_PI_2..PI).map(|a| -height * a.tan()).filter(|d| sensible(*d)).collect();
    // Sideways per length away.
    let corners: Vec<f64> =
        evidence.peaks(UP, 0.0..PI, CORNERS).into_iter().map(|(angle, _)| 1.0 / angle.tan()).collect();
    let or_none = |all: &[f64]| all.iter().copied().chain([none]).collect::<Vec<f64>>();
    let (lefts, rights, backs) = (or_none(&left), or_none(&right), or_none(&back));
    let mut all = Vec::new();
    let mut add = |left: f64, right: f64, back: f64| {
        if [left, right, back].iter().all(|d| d.is_infinite() || sensible(*d)) {
            all.push(Layout { floor: height, left, right, back, ceiling: none });
        }
    };
    for (&l, &r) in lefts.iter().flat_map(|l| rights.iter().map(move |r| (l, r))) {
        backs.iter().for_each(|&b| add(l, r, b));
        for corner in &corners {
            let side = if *corner < 0.0 { l } else { r };
            if side.is_finite() {
                add(l, r, side / corner.abs());
            }
        }
    }
    for (&b, corner) in back.iter().flat_map(|b| corners.iter().map(move |c| (b, c))) {
        if *corner < 0.0 {
            rights.iter().for_each(|&r| add(-corner * b, r, b));
        } else {
            lefts.iter().for_each(|&l| add(l, corner * b, b));
        }
    }
    all
}

/// The same room with each ceiling that a line speaks for.
fn with_ceiling(evidence: &Evidence, layout: &Layout) -> Vec<Layout> {
    let above = |axis, range| evidence.peaks(axis, range, TOPS).into_iter().map(|(angle, _)| angle);
    let mut heights: Vec<f64> = Vec::new();
    if layout.has(Side::Right) {
        heights.extend(above(AWAY, 0.0..FRAC_PI_2).map(|a| layout.right * a.tan()));
    }
    if layout.has(Side::Left) {
        heights.extend(above(AWAY, FRAC_PI_2..PI).map(|a| -layout.left * a.tan()));
    }
    if layout.has(Side::Back) {
        heights.extend(above(RIGHT, 0.0..FRAC_PI_2).map(|a| layout.back / a.tan()));
    }
    let sensible = |h: &f64| (HEADROOM..DISTANCE.end).contains(&(h / layout.floor));
    heights.into_iter().filter(sensible).map(|h| layout.with(Side::Ceiling, h)).collect()
}

//! How strong light is that a ball's picture clips: what the markers' white paper gets besides all else.
//!
//! Clipped cells of the environment that hang together are a light, which keeps its name while it stays. A place m of the paper
//! gets E(m) = rest + Σ P_j s_j(m): P_j is what light j gives the paper in the mean, s_j how that differs from place to place, by
//! distance and where the ball is in the way. All places together are solved for P by least squares. Lights known from frames
//! before stay near what they were, a new one is free: what the paper gets more is the new one's, and of several new ones
//! the places nearer to each say how much is whose.
//!
//! A light's P is remembered and not how much brighter than it looks it is: a small lamp is one pixel of the ball in one frame,
//! four in the next.

use crate::dome::cube::{self as dome, CubeMap};
use crate::image::luminance;
use glam::Vec3;
use nalgebra::{DMatrix, DVector};

/// Side of the cube on whose cells it is noted which light is clipped there.
const CELLS: usize = 8;
/// Clipped cells within this angle (cosine) are one light, and the one that was there before.
const SAME_LIGHT: f32 = 0.92;
/// A light that was not seen clipped for so many frames is forgotten.
const FORGOTTEN: usize = 10;
/// How far a place of the paper may lie from the model, as a share of its light: uneven print, blur, what else is not modelled.
const PLACE: f64 = 0.05;
/// Errors of neighbouring places are alike: all together count as so many.
const INDEPENDENT: f64 = 8.0;
/// Change of a known light from frame to frame, as a share of it.
const KNOWN: f64 = 0.02;
/// A larger misfit of the whole, as a share, is a change of the light, which is followed at once.
const LARGE: f64 = 0.15;
/// Places further off than this many standard deviations lie in a shadow or are covered, and are left out.
const FAR_OFF: f64 = 3.0;
const ROUNDS: usize = 3;
const MOST_BOOST: f64 = 1e4;

/// Where the environment is seen from.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    /// m.
    pub centre: Vec3,
    /// At what distance its light is taken to stand, m; 0: at infinity.
    pub distance_m: f32,
    /// Of the ball there, m; 0 where there is none.
    pub radius_m: f32,
}

impl Place {
    /// Irradiance that light of power 1, seen from here in a direction, gives to a place of the paper, which lies flat.
    pub fn gives(&self, direction: Vec3, to: Vec3) -> f32 {
        let (towards, falloff) = if self.distance_m > 0.0 {
            let way = self.centre + direction * self.distance_m - to;
            let towards = way.normalize_or_zero();
            (towards, self.distance_m.powi(2) * towards.dot(direction).max(0.0) / way.length_squared())
        } else {
            (direction, 1.0)
        };
        let ball = self.centre - to;
        let along = ball.dot(towards);
        let hidden = along > 0.0 && ball.length_squared() - along * along < self.radius_m.powi(2);
        if hidden { 0.0 } else { towards.y.max(0.0) * falloff }
    }
}

/// White paper and the irradiance that it shows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Paper {
    pub place: Vec3,
    pub irradiance: [f32; 3],
}

/// What of the environment is clipped.
pub(super) struct Clipped {
    /// By cell, the light that was clipped there last, and when.
    names: Vec<Option<(usize, usize)>>,
    /// What each light gives the paper in the mean, by channel.
    strength: Vec<[f64; 3]>,
    frame: usize,
}

/// A light in one frame.
struct Shown {
    name: usize,
    /// Whether its strength is known from frames before.
    known: bool,
    /// Its cells.
    cells: Vec<usize>,
}

/// A cell of the environment.
#[derive(Clone, Copy)]
struct Cell {
    /// Its middle.
    middle: Vec3,
    /// Where its clipped light comes from.
    towards: Vec3,
    /// Of that light as it looks.
    power: [f32; 3],
}

fn cells(clipped: &CubeMap) -> Vec<Cell> {
    let dark = |i| Cell { middle: dome::middle(i, CELLS), towards: Vec3::ZERO, power: [0.0; 3] };
    let mut cells: Vec<Cell> = (0..dome::FACES * CELLS * CELLS).map(dark).collect();
    for (i, radiance) in clipped.texels().iter().enumerate().filter(|(_, r)| r.0 != [0.0; 3]) {
        let (direction, solid_angle) = clipped.texel(i);
        let cell = &mut cells[dome::index(direction, CELLS)];
        let power = radiance.0.map(|l| l * solid_angle as f32);
        cell.towards += direction * luminance(power);
        (0..3).for_each(|k| cell.power[k] += power[k]);
    }
    cells.iter_mut().for_each(|c| c.towards = c.towards.normalize_or(c.middle));
    cells
}

impl Clipped {
    /// Nothing yet.
    pub fn new() -> Self {
        Self { names: vec![None; dome::FACES * CELLS * CELLS], strength: Vec::new(), frame: 0 }
    }

    /// The environment with its clipped part raised until the paper gets what it shows. `all` and `clipped` are as the ball shows
    /// them; `everywhere` are all places of paper, whether they are seen or not.
    pub fn raised(
        &mut self,
        all: &CubeMap,
        clipped: &CubeMap,
        paper: &[Paper],
        everywhere: &[Vec3],
        from: &Place,
    ) -> CubeMap {
        self.frame += 1;
        let cells = cells(clipped);
        let shown = self.named(&cells);
        let rest = [all, clipped].map(|c| c.irradiance(Vec3::Y));
        let mut boost = vec![[1.0f32; 3]; cells.len()];
        for k in 0..3 {
            let gives = |light: &Shown, to: Vec3| -> f64 {
                light
                    .cells
                    .iter()
                    .map(|&i| f64::from(cells[i].power[k] * from.gives(cells[i].towards, to)))
                    .sum()
            };
            let looks: Vec<f64> = shown
                .iter()
                .map(|l| {
                    everywhere.iter().map(|m| gives(l, *m)).sum::<f64>() / everywhere.len().max(1) as f64
                })
                .collect();
            // A light that the paper does not see says nothing.
            let seen: Vec<usize> = (0..shown.len()).filter(|&j| looks[j] > 0.0).collect();
            // Of all alike: a place in a shadow is no surer than the others.
            let whole = median(paper.iter().map(|p| f64::from(p.irradiance[k])).collect()).max(1e-6);
            let rows: Vec<Row> = paper
                .iter()
                .map(|p| Row {
                    shape: seen.iter().map(|&j| gives(&shown[j], p.place) / looks[j]).collect(),
                    lacks: f64::from(p.irradiance[k] - (rest[0][k] - rest[1][k])),
                    sigma: PLACE * whole,
                })
                .collect();
            let lights: Vec<Prior> = seen
                .iter()
                .map(|&j| Prior {
                    known: shown[j].known.then(|| self.strength[shown[j].name][k]),
                    bounds: [looks[j], MOST_BOOST * looks[j]],
                })
                .collect();
            for (&j, strength) in seen.iter().zip(solved(&rows, &lights)) {
                self.strength[shown[j].name][k] = strength;
                for &cell in &shown[j].cells {
                    boost[cell][k] = (strength / looks[j]) as f32;
                }
            }
        }
        CubeMap::from_fn(all.side(), |d| {
            let (a, c, by) = (all.nearest(d), clipped.nearest(d), boost[dome::index(d, CELLS)]);
            [0, 1, 2].map(|k| (a[k] - c[k]).max(0.0) + c[k] * by[k])
        })
    }

    /// The lights of a frame, each cell with the light that was clipped nearest to it before.
    fn named(&mut self, cells: &[Cell]) -> Vec<Shown> {
        let frame = self.frame;
        let before = self.names.clone();
        let remembered = |i: usize| before[i].filter(|(_, seen)| frame - seen <= FORGOTTEN).map(|n| n.0);
        let near = |i: usize, j: usize| cells[i].middle.dot(cells[j].middle);
        let (mut shown, mut fresh): (Vec<Shown>, Vec<usize>) = (Vec::new(), Vec::new());
        let mut add = |shown: &mut Vec<Shown>, i: usize, name: usize, known: bool| {
            self.names[i] = Some((name, frame));
            match shown.iter_mut().find(|l| l.name == name) {
                Some(light) => light.cells.push(i),
                None => shown.push(Shown { name, known, cells: vec![i] }),
            }
        };
        for i in (0..cells.len()).filter(|&i| cells[i].power != [0.0; 3]) {
            let same = (0..cells.len()).filter(|&j| near(i, j) > SAME_LIGHT);
            let named = same.filter_map(|j| Some((near(i, j), remembered(j)?)));
            match named.max_by(|a, b| a.0.total_cmp(&b.0)) {
                Some((_, name)) => add(&mut shown, i, name, true),
                None => fresh.push(i),
            }
        }
        while let Some(first) = fresh.pop() {
            let name = self.strength.len();
            self.strength.push([0.0; 3]);
            let mut waiting = vec![first];
            while let Some(i) = waiting.pop() {
                let (joined, apart): (Vec<_>, Vec<_>) =
                    std::mem::take(&mut fresh).into_iter().partition(|&j| near(i, j) > SAME_LIGHT);
                waiting.extend(joined);
                fresh = apart;
                add(&mut shown, i, name, false);
            }
        }
        shown
    }
}

/// A place of the paper.
struct Row {
    /// s_j of each light.
    shape: Vec<f64>,
    /// Irradiance that clipped light must give.
    lacks: f64,
    /// Standard deviation of that.
    sigma: f64,
}

/// What is known of a light.
struct Prior {
    known: Option<f64>,
    bounds: [f64; 2],
}

/// P of all lights.
fn solved(rows: &[Row], lights: &[Prior]) -> Vec<f64> {
    let n = lights.len();
    let known = |row: &Row| (0..n).map(|j| row.shape[j] * lights[j].known.unwrap_or(0.0)).sum::<f64>();
    let misfit = median(rows.iter().map(|r| r.lacks - known(r)).collect());
    let whole = rows.first().map_or(0.0, |r| r.sigma / PLACE);
    let fresh = lights.iter().any(|l| l.known.is_none());
    let changed = !fresh && misfit.abs() > LARGE * whole;
    let looks: f64 = lights.iter().filter(|l| l.known.is_none()).map(|l| l.bounds[0]).sum();
    let expected = |l: &Prior| match l.known {
        Some(strength) => (strength, if changed { strength } else { KNOWN * strength }),
        // By their size in the picture, but that is no more than a guess.
        None => (misfit.max(0.0) * l.bounds[0] / looks, misfit.abs().max(PLACE * whole)),
    };
    let priors: Vec<(f64, f64)> = lights.iter().map(expected).map(|(p, s)| (p, s.max(1e-9))).collect();
    let mut found: Vec<f64> = priors.iter().map(|p| p.0).collect();
    let mut kept: Vec<&Row> = rows.iter().collect();
    for _ in 0..ROUNDS {
        found = fitted(&kept, lights, &priors);
        let off = |r: &Row| (r.lacks - (0..n).map(|j| r.shape[j] * found[j]).sum::<f64>()) / r.sigma;
        let spread = 1.4826 * median(rows.iter().map(|r| off(r).abs()).collect());
        kept = rows.iter().filter(|r| off(r).abs() <= FAR_OFF * spread.max(0.5)).collect();
    }
    found
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// Least squares within the bounds of each light: what lies outside is held at its bound, and the rest found again.
fn fitted(rows: &[&Row], lights: &[Prior], priors: &[(f64, f64)]) -> Vec<f64> {
    let weight = (INDEPENDENT / rows.len().max(1) as f64).min(1.0);
    let mut held: Vec<Option<f64>> = vec![None; lights.len()];
    loop {
        let free: Vec<usize> = (0..lights.len()).filter(|&j| held[j].is_none()).collect();
        let fixed = |row: &Row| (0..lights.len()).map(|j| row.shape[j] * held[j].unwrap_or(0.0)).sum::<f64>();
        let mut normal = DMatrix::zeros(free.len(), free.len());
        let mut right = DVector::zeros(free.len());
        for (a, &i) in free.iter().enumerate() {
            let (mean, sigma) = priors[i];
            normal[(a, a)] += sigma.powi(-2);
            right[a] += mean * sigma.powi(-2);
            for row in rows {
                let w = weight * row.sigma.powi(-2) * row.shape[i];
                right[a] += w * (row.lacks - fixed(row));
                for (b, &j) in free.iter().enumerate() {
                    normal[(a, b)] += w * row.shape[j];
                }
            }
        }
        let solution = normal.cholesky().map(|c| c.solve(&right));
        let value = |a: usize, i: usize| solution.as_ref().map_or(priors[i].0, |s| s[a]);
        let outside = free.iter().enumerate().find_map(|(a, &i)| {
            let [low, high] = lights[i].bounds;
            let value = value(a, i);
            (value < low || value > high).then(|| (i, value.clamp(low, high)))
        });
        match outside {
            Some((i, bound)) => held[i] = Some(bound),
            None => {
                let mut found: Vec<f64> = held.iter().map(|h| h.unwrap_or(0.0)).collect();
                free.iter().enumerate().for_each(|(a, &i)| found[i] = value(a, i));
                return found;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINDOW: Vec3 = Vec3::new(-0.9, 0.43, 0.0);
    const LAMP: Vec3 = Vec3::new(0.5, 0.83, 0.25);
    const FROM: Place = Place { centre: Vec3::new(0.25, 0.06, 0.0), distance_m: 2.0, radius_m: 0.06 };

    /// A dim room with a window, and perhaps a lamp, of some radiance each.
    fn room(window: f32, lamp: f32) -> CubeMap {
        CubeMap::from_fn(32, |d| {
            let at = |towards: Vec3, cos: f32| d.dot(towards.normalize()) > cos;
            [if at(WINDOW, 0.95) {
                window
            } else if at(LAMP, 0.995) {
                lamp
            } else {
                0.1
            }; 3]
        })
    }

    fn places() -> Vec<Vec3> {
        (0..48)
            .map(|i| Vec3::new((i % 8) as f32 * 0.05 - 0.175, 0.0, (i / 8) as f32 * 0.05 - 0.125))
            .collect()
    }

    /// What paper shows in a room, some of it covered.
    fn paper(room: &CubeMap) -> Vec<Paper> {
        let shows = |(i, place): (usize, &Vec3)| {
            let e: f32 = (0..room.texels().len())
                .map(|t| {
                    let (direction, solid_angle) = room.texel(t);
                    room.texels()[t].0[0]
                        * solid_angle as f32
                        * if room.texels()[t].0[0] > 0.1 {
                            FROM.gives(direction, *place)
                        } else {
                            direction.y.max(0.0)
                        }
                })
                .sum();
            Paper { place: *place, irradiance: [if i % 7 == 0 { 0.3 } else { 1.0 } * e; 3] }
        };
        places().iter().enumerate().map(shows).collect()
    }

    fn follow(clipped: &mut Clipped, room: &CubeMap) -> CubeMap {
        let shown = room.map(|l| l.map(|v| v.min(1.0)));
        let lost = room.map(|l| l.map(|v| if v > 1.0 { 1.0 } else { 0.0 }));
        clipped.raised(&shown, &lost, &paper(room), &places(), &FROM)
    }

    fn off(found: &CubeMap, truth: &CubeMap, towards: Vec3, cos: f32) -> f32 {
        let power = |cube: &CubeMap| {
            let cut = |d: Vec3| if d.dot(towards.normalize()) > cos { cube.nearest(d) } else { [0.0; 3] };
            CubeMap::from_fn(32, cut).power()[0]
        };
        (power(found) / power(truth) - 1.0) as f32
    }

    #[test]
    fn a_lamp_that_is_switched_on_leaves_the_window_as_it_was() {
        let mut clipped = Clipped::new();
        let dark = room(6.0, 0.1);
        for _ in 0..5 {
            assert!(off(&follow(&mut clipped, &dark), &dark, WINDOW, 0.9).abs() < 0.03);
        }
        let lit = room(6.0, 90.0);
        for _ in 0..20 {
            let found = follow(&mut clipped, &lit);
            let off = [off(&found, &lit, WINDOW, 0.9), off(&found, &lit, LAMP, 0.9)];
            assert!(off.iter().all(|o| o.abs() < 0.05), "{off:?}");
        }
        // Switched off again, it takes nothing along.
        assert!(off(&follow(&mut clipped, &dark), &dark, WINDOW, 0.9).abs() < 0.05);
    }

    #[test]
    fn of_two_unlike_lights_from_the_first_frame_on_places_say_which_is_the_stronger() {
        let lit = room(6.0, 90.0);
        let found = follow(&mut Clipped::new(), &lit);
        let off = [off(&found, &lit, WINDOW, 0.9), off(&found, &lit, LAMP, 0.9)];
        assert!(off.iter().all(|o| o.abs() < 0.15), "{off:?}");
    }

    #[test]
    fn a_light_that_dims_is_followed_at_once() {
        let mut clipped = Clipped::new();
        for window in [6.0, 6.0, 3.0] {
            let room = room(window, 0.1);
            let found = follow(&mut clipped, &room);
            assert!(off(&found, &room, WINDOW, 0.9).abs() < 0.05, "{window}");
        }
    }
}

//! The scene's own shadows, laid over those that the plate shows.
//!
//! ε = B E_blocked / E supposes that plate B and model E have the scene's shadows in the same place. Marks leave corners open to a
//! pixel or so, and the shadows that they throw to more: where the plate is in the scene's shadow and the model in the sun, the
//! sun would be taken a second time. The plate says where the shadow ends. Around each pixel ln E is moved on its face until
//! ln B − ln E, the logarithm of the reflectance, is as even as can be; the pixel takes its light from there. A
//! displacement must be told by the plate: what is most probable, given how far marks may be off, and only where a border of the
//! model's shadows explains most of what the plate shows.

use super::receivers::barycentric;
use super::tiles::located;
use super::{Problem, Receiver, Scene};
use crate::image::luminance;
use glam::{IVec2, Vec2, Vec3};
use rayon::prelude::*;

/// Standard deviation of a displacement, and of the weights of pixels around the one whose light is sought, over the reach.
const OPEN: f32 = 0.5;
/// Radius of the window, px, and the standard deviation of its weights.
const RADIUS: i32 = 4;
const WIDTH: f32 = 2.0;
/// Fewest pixels of a window.
const LEAST: usize = 16;
/// So many pixels of a window say something of their own: textures and noise of neighbours hang together.
const INDEPENDENT: f32 = 12.0;
/// Standard deviation of ln B beside textures.
const NOISE: f32 = 0.02;
/// Borders are where ln E changes by more from one pixel to the next: where it changes less, a pixel's displacement is nothing.
const BORDER: f32 = 0.05;
/// Share of the variance of ln B in a window that a border must explain.
const EXPLAINED: f32 = 0.5;
/// No face.
const NONE: u32 = u32::MAX;

/// Plate and model, pixel by pixel.
pub(super) struct Registration<'a> {
    scene: Scene<'a>,
    /// How far light may be moved, px.
    reach: i32,
    map: Map,
}

/// Where a pixel's light is taken from.
pub(super) struct Place {
    pub patch: u32,
    pub barycentric: [f32; 3],
    /// From the pixel's own place, m.
    pub shift: Vec3,
}

/// What is laid over each other.
struct Map {
    size: IVec2,
    /// The model's face that a pixel sees.
    face: Vec<u32>,
    /// ln E.
    light: Vec<f32>,
    /// ln B; NaN where it does not count, as beside another face: the plate may show that.
    plate: Vec<f32>,
    /// Whether there is a border in squares of pixels.
    squares: Vec<bool>,
    side: i32,
}

impl<'a> Registration<'a> {
    pub fn new(scene: &Scene<'a>, reach: usize) -> Result<Self, Problem> {
        let pixels = scene.receivers.pixels.pixels();
        let seen = |receiver: &Option<Receiver>| -> Result<(u32, f32), Problem> {
            let Some(receiver) = receiver else { return Ok((NONE, f32::NAN)) };
            let (vertices, weights) = located(scene, receiver.patch, receiver.barycentric)?;
            let light = luminance(scene.transfers.irradiance_at(vertices, weights)).ln();
            Ok((scene.light.mesh.patches[receiver.patch as usize].face, light))
        };
        let seen: Vec<(u32, f32)> = pixels.par_iter().map(seen).collect::<Result<_, _>>()?;
        let (face, light) = seen.into_iter().unzip();
        let plate = scene.plate.pixels().iter().map(|b| b.luminance().ln()).collect();
        let (width, height) = scene.plate.size();
        let map = Map::new(IVec2::new(width as i32, height as i32), face, light, plate, reach as i32);
        Ok(Self { scene: *scene, reach: reach as i32, map })
    }

    /// Where the light of a pixel is taken from, if not from its own place.
    pub fn place(&self, x: usize, y: usize) -> Option<Place> {
        let at = IVec2::new(x as i32, y as i32);
        let by = self.map.displacement(at, self.reach)?;
        let whole = by.round().as_ivec2();
        let there = self.map.on_face(at, whole);
        let pixels = &self.scene.receivers.pixels;
        let own = (*pixels.at(x, y))?;
        let receiver = (*pixels.at(there.x as usize, there.y as usize))?;
        let rest = if there == at + whole { by - whole.as_vec2() } else { Vec2::ZERO };
        let corners = self.scene.light.mesh.corners(receiver.patch as usize);
        let barycentric = barycentric(corners, receiver.at(rest));
        let inside = (0..3).map(|k| corners[k] * barycentric[k]).sum::<Vec3>();
        Some(Place { patch: receiver.patch, barycentric, shift: inside - own.position })
    }
}

impl Map {
    fn new(size: IVec2, face: Vec<u32>, light: Vec<f32>, plate: Vec<f32>, reach: i32) -> Self {
        let side = reach;
        let mut map = Self { size, face, light, plate, squares: Vec::new(), side };
        let inner = |i: usize| {
            let at = map.at(i);
            let around = (0..9).map(|k| at + IVec2::new(k % 3 - 1, k / 3 - 1));
            around.into_iter().all(|p| map.index(p).is_none_or(|j| map.face[j] == map.face[i]))
        };
        let counts = |i: usize| map.plate[i].is_finite() && map.light[i].is_finite() && inner(i);
        let plate = (0..map.face.len()).into_par_iter();
        map.plate = plate.map(|i| if counts(i) { map.plate[i] } else { f32::NAN }).collect();
        let across = map.across();
        map.squares = vec![false; (across.x * across.y) as usize];
        for i in 0..map.light.len() {
            let at = map.at(i);
            let next = [IVec2::X, IVec2::Y].map(|step| map.index(at + step));
            let step = |j: usize| map.face[j] == map.face[i] && (map.light[j] - map.light[i]).abs() > BORDER;
            if next.into_iter().flatten().any(step) {
                let square = at / side;
                map.squares[(square.y * across.x + square.x) as usize] = true;
            }
        }
        map
    }

    fn at(&self, index: usize) -> IVec2 {
        IVec2::new(index as i32 % self.size.x, index as i32 / self.size.x)
    }

    fn index(&self, at: IVec2) -> Option<usize> {
        let inside = at.cmpge(IVec2::ZERO).all() && at.cmplt(self.size).all();
        inside.then_some((at.y * self.size.x + at.x) as usize)
    }

    /// Number of squares.
    fn across(&self) -> IVec2 {
        (self.size + self.side - 1) / self.side
    }

    /// Whether there may be a border where the light of a pixel may come from.
    fn has_border(&self, at: IVec2) -> bool {
        let (square, across) = (at / self.side, self.across());
        let (low, high) = ((square - 1).max(IVec2::ZERO), (square + 2).min(across));
        (low.y..high.y).any(|y| (low.x..high.x).any(|x| self.squares[(y * across.x + x) as usize]))
    }

    /// As far towards `at + by` as the face of `at` goes.
    fn on_face(&self, at: IVec2, by: IVec2) -> IVec2 {
        let face = self.index(at).map_or(NONE, |i| self.face[i]);
        let steps = by.abs().max_element();
        let step = |k: i32| {
            at + if k == steps { by } else { (by.as_vec2() * (k as f32 / steps as f32)).round().as_ivec2() }
        };
        let same =
            |p: &IVec2| self.index(*p).is_some_and(|i| self.face[i] == face && self.light[i].is_finite());
        (1..=steps).rev().map(step).find(same).unwrap_or(at)
    }

    /// Most probable displacement of the light around a pixel, px; none without a border that the plate shows.
    fn displacement(&self, at: IVec2, reach: i32) -> Option<Vec2> {
        let face = self.face[self.index(at)?];
        if face == NONE || !self.has_border(at) {
            return None;
        }
        let mut window: Vec<(IVec2, f32, f32)> = Vec::with_capacity(64);
        for y in -RADIUS..=RADIUS {
            for x in -RADIUS..=RADIUS {
                let (p, far) = (at + IVec2::new(x, y), (x * x + y * y) as f32);
                let Some(i) = self.index(p).filter(|_| far <= (RADIUS * RADIUS) as f32) else { continue };
                if self.face[i] == face && self.plate[i].is_finite() {
                    window.push((p, self.plate[i], (-far / (2.0 * WIDTH * WIDTH)).exp()));
                }
            }
        }
        if window.len() < LEAST {
            return None;
        }
        let open = OPEN * reach as f32;
        let uneven = |by: IVec2| {
            let left = |&(p, plate, weight): &(IVec2, f32, f32)| {
                let there = self.on_face(p, by);
                (plate - self.light[(there.y * self.size.x + there.x) as usize], weight)
            };
            variance(window.iter().map(left))
        };
        let cost = |by: IVec2, variance: f32| {
            INDEPENDENT / 2.0 * (variance + NOISE * NOISE).ln()
                + by.length_squared() as f32 / (2.0 * open * open)
        };
        let side = 2 * reach + 1;
        let by = |k: i32| IVec2::new(k % side, k / side) - reach;
        let variances: Vec<f32> = (0..side * side).map(|k| uneven(by(k))).collect();
        let costs: Vec<f32> = (0..side * side).map(|k| cost(by(k), variances[k as usize])).collect();
        let best = (0..costs.len()).min_by(|&a, &b| costs[a].total_cmp(&costs[b]))?;
        let shown = variance(window.iter().map(|&(_, plate, weight)| (plate, weight)));
        if variances[best] > (1.0 - EXPLAINED) * shown {
            return None;
        }
        let whole = by(best as i32);
        // Between pixels: the lowest point of a parabola.
        let part = |along: i32, step: i32| {
            if along.abs() == reach {
                return 0.0;
            }
            let [below, here, above] = [-step, 0, step].map(|s| costs[(best as i32 + s) as usize]);
            let bend = below + above - 2.0 * here;
            if bend > 0.0 { ((below - above) / (2.0 * bend)).clamp(-0.5, 0.5) } else { 0.0 }
        };
        Some(whole.as_vec2() + Vec2::new(part(whole.x, 1), part(whole.y, side)))
    }
}

/// Weighted variance.
fn variance(values: impl Iterator<Item = (f32, f32)>) -> f32 {
    let [mut all, mut sum, mut squares] = [0.0; 3];
    for (value, weight) in values {
        all += weight;
        sum += weight * value;
        squares += weight * value * value;
    }
    (squares / all - (sum / all).powi(2)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: IVec2 = IVec2::new(64, 48);

    /// A shadow's border, soft over a pixel, at an angle.
    fn light(p: Vec2) -> f32 {
        let inside = ((p - Vec2::new(30.0, 24.0)).dot(Vec2::new(0.3, 0.95)) + 0.5).clamp(0.0, 1.0);
        (0.3 + 0.7 * inside).ln()
    }

    /// Tiles with dark joints, and noise.
    fn reflectance(x: i32, y: i32) -> f32 {
        let joint = if x % 13 == 5 || y % 11 == 7 { -0.4 } else { 0.0 };
        joint + 0.05 * ((x * 7 + y * 13) as f32).sin() + 0.05 * ((x * 3 - y * 5) as f32).cos()
    }

    fn map(moved: Vec2, light: impl Fn(Vec2) -> f32, plate: impl Fn(i32, i32, f32) -> f32) -> Map {
        let at = |i: i32| IVec2::new(i % SIZE.x, i / SIZE.x);
        let all = || (0..SIZE.x * SIZE.y).map(at);
        let model = all().map(|p| light(p.as_vec2())).collect();
        let shown = all().map(|p| plate(p.x, p.y, light(p.as_vec2() + moved))).collect();
        Map::new(SIZE, vec![0; (SIZE.x * SIZE.y) as usize], model, shown, 4)
    }

    /// Largest error of the light at a pixel along the shadow's border, after and before.
    fn errors(map: &Map, moved: Vec2) -> [f32; 2] {
        let mut worst = [0.0f32; 2];
        for i in 0..map.face.len() {
            let at = map.at(i);
            let near = at.cmpge(IVec2::splat(9)).all() && at.cmplt(SIZE - 9).all();
            let found = map.displacement(at, 4).unwrap_or_default();
            let off = |by: Vec2| (light(at.as_vec2() + by) - light(at.as_vec2() + moved)).abs();
            if near {
                worst = [worst[0].max(off(found)), worst[1].max(off(Vec2::ZERO))];
            }
        }
        worst
    }

    #[test]
    fn a_shadow_is_laid_over_the_one_that_the_plate_shows() {
        for moved in [Vec2::ZERO, Vec2::new(0.0, 1.0), Vec2::new(-0.5, -1.6), Vec2::new(0.3, 2.4)] {
            let map = map(moved, light, |x, y, light| light + reflectance(x, y));
            let [after, before] = errors(&map, moved);
            println!("{moved}: {after:.2} instead of {before:.2}");
            assert!(after < 0.5, "{moved}: {after}, {before} before");
            assert!(moved.length() < 1.0 || before > 0.8);
        }
    }

    #[test]
    fn a_shadow_that_the_plate_does_not_show_stays() {
        let map = map(Vec2::ZERO, light, |x, y, _| reflectance(x, y));
        assert!((0..map.face.len()).all(|i| map.displacement(map.at(i), 4).is_none()));
    }

    #[test]
    fn a_texture_moves_no_even_light() {
        let slope = |p: Vec2| 0.001 * p.x;
        let map = map(Vec2::ZERO, slope, |x, y, light| light + reflectance(x, y));
        assert!((0..map.face.len()).all(|i| map.displacement(map.at(i), 4).is_none()));
    }

    #[test]
    fn light_stays_on_its_face() {
        let mut map = map(Vec2::ZERO, light, |_, _, light| light);
        map.face = (0..map.face.len()).map(|i| u32::from(map.at(i).x >= 20)).collect();
        assert_eq!(map.on_face(IVec2::new(18, 9), IVec2::new(4, 0)), IVec2::new(19, 9));
        assert_eq!(map.on_face(IVec2::new(22, 9), IVec2::new(-4, 2)), IVec2::new(20, 10));
        assert_eq!(map.on_face(IVec2::new(1, 1), IVec2::new(-4, 0)), IVec2::new(0, 1));
        assert_eq!(map.on_face(IVec2::new(9, 9), IVec2::ZERO), IVec2::new(9, 9));
    }
}

//! The shadow maps of a dome, few of them drawn anew in a frame (supan2006, §V, step 1), and what they hide (eq. 3).
//!
//! The paper draws one map a frame in turn. Here every other drawing goes to the light whose shadow is most wrong, by power
//! and by how far light and object have turned since its map was drawn; the rest go in turn. So with n lights and k
//! drawings a frame, each map is drawn again after at most ⌈2n/k⌉ frames ([`bound`]), the worst one after two. Where the
//! object only moves, nothing is wrong: light at infinity shifts a shadow with its object, and lookups are shifted.

use super::lights::{Cell, DomeLight};
use crate::image::luminance;
use crate::shadow::{Bounds, DistantLookup, MapPlan, Occluder, ShadowMap, ShadowOrigin, rasterise};
use crate::subtractive::Surface;
use glam::{Quat, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Where the object is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// A point that moves with it, m.
    pub anchor: Vec3,
    /// How it is turned.
    pub turn: Quat,
}

/// A map as it was drawn.
struct Drawn {
    plan: MapPlan,
    map: Option<ShadowMap>,
    pose: Pose,
    direction: Vec3,
    luminance: f32,
}

struct Slot {
    light: DomeLight,
    drawn: Arc<Drawn>,
    /// Of the drawing, counted over all lights; 0: the map was drawn for another light.
    drawing: u64,
    /// Drawings before the light was there.
    since: u64,
}

/// The lights of a dome with their maps.
pub struct DomeMaps {
    size: usize,
    per_frame: usize,
    slots: Vec<Slot>,
    drawings: u64,
    bounds: Option<Bounds>,
    pose: Pose,
}

/// After so many frames every map is one of the present scene.
pub fn bound(lights: usize, per_frame: usize) -> usize {
    (2 * lights).div_ceil(per_frame.max(1))
}

/// A light's brightness that has changed by its own counts as a turn by this angle, rad.
const CHANGED_RAD: f32 = 0.2;

/// Lookups reach beyond the object by this share of its size.
const MARGIN: f32 = 0.05;

impl DomeMaps {
    /// Maps of `size` texels a side, `per_frame` of them drawn in a frame, 0 for all.
    pub fn new(size: usize, per_frame: usize) -> Self {
        let pose = Pose { anchor: Vec3::ZERO, turn: Quat::IDENTITY };
        Self { size, per_frame, slots: Vec::new(), drawings: 0, bounds: None, pose }
    }

    /// The next frame: lights shine at once as they do now, a light that has no map yet borrows that of its nearest neighbour,
    /// and the maps due are drawn. Gives their number.
    pub fn update(&mut self, lights: &[DomeLight], occluder: &Occluder, pose: Pose) -> usize {
        let bounds = Bounds::of(occluder);
        (self.bounds, self.pose) = (Some(bounds), pose);
        let before = std::mem::take(&mut self.slots);
        if before.is_empty() || self.per_frame == 0 {
            let draw = |light: &DomeLight| Arc::new(self.draw(light, occluder, &bounds));
            let drawn: Vec<_> = lights.par_iter().map(draw).collect();
            self.drawings += 1;
            let slot = |(light, drawn): (&DomeLight, _)| Slot {
                light: *light,
                drawn,
                drawing: self.drawings,
                since: 0,
            };
            self.slots = lights.iter().zip(drawn).map(slot).collect();
            return lights.len();
        }
        self.slots = lights.iter().map(|light| carried(&before, light, self.drawings)).collect();
        let due = self.due();
        let drawn: Vec<_> =
            due.par_iter().map(|&i| Arc::new(self.draw(&self.slots[i].light, occluder, &bounds))).collect();
        for (&i, drawn) in due.iter().zip(drawn) {
            self.drawings += 1;
            self.slots[i].drawn = drawn;
            self.slots[i].drawing = self.drawings;
        }
        due.len()
    }

    /// The maps to draw: every other one by how wrong it is, the rest, and all if none is wrong, by age.
    fn due(&self) -> Vec<usize> {
        let mut left: Vec<usize> = (0..self.slots.len()).collect();
        let mut due = Vec::new();
        for drawing in (self.drawings + 1..).take(self.per_frame.min(left.len())) {
            let worst = left.iter().copied().max_by(|&a, &b| self.wrong(a).total_cmp(&self.wrong(b)));
            let oldest = left.iter().copied().min_by_key(|&i| self.slots[i].drawing.max(self.slots[i].since));
            let chosen = if drawing % 2 == 0 { worst.filter(|&i| self.wrong(i) > 0.0) } else { None };
            let Some(i) = chosen.or(oldest) else { break };
            left.retain(|&k| k != i);
            due.push(i);
        }
        due
    }

    /// How wrong a map is: the light's luminance × the angle by which light and object have turned since.
    fn wrong(&self, i: usize) -> f32 {
        let Slot { light, drawn, .. } = &self.slots[i];
        let now = luminance(light.power());
        let turned = self.pose.turn.angle_between(drawn.pose.turn);
        let moved = light.source.direction.angle_between(drawn.direction);
        let change = (now - drawn.luminance).abs() / now.max(drawn.luminance).max(f32::MIN_POSITIVE);
        // Angles below this are rounding.
        let angle = turned + moved + CHANGED_RAD * if change > 0.1 { change } else { 0.0 };
        if angle > 1e-3 { now * angle } else { 0.0 }
    }

    fn draw(&self, light: &DomeLight, occluder: &Occluder, bounds: &Bounds) -> Drawn {
        let direction = light.source.direction;
        let plan = MapPlan::new(0, ShadowOrigin::Direction(direction), 1.0, 0, bounds, self.size);
        let map = plan.projection.map(|p| rasterise(&p, occluder, self.size));
        Drawn { plan, map, pose: self.pose, direction, luminance: luminance(light.power()) }
    }

    /// The lights.
    pub fn lights(&self) -> impl ExactSizeIterator<Item = &DomeLight> {
        self.slots.iter().map(|s| &s.light)
    }

    /// Drawings of other maps since the oldest map was drawn, or its light appeared.
    pub fn oldest(&self) -> u64 {
        self.slots.iter().map(|s| self.drawings - s.drawing.max(s.since)).max().unwrap_or(0)
    }

    /// By light, corners of a body in which all lies that its map may shadow within a box, m.
    pub fn shadowed(&self, [low, high]: [Vec3; 2]) -> Vec<[Vec3; 16]> {
        let body = |slot: &Slot| {
            let Bounds { min, max, .. } = slot.drawn.plan.bounds;
            // A texel and more around.
            let margin = Vec3::splat(MARGIN * min.distance(max));
            let shift = self.pose.anchor - slot.drawn.pose.anchor;
            let (min, max) = (min - margin + shift, max + margin + shift);
            let direction = slot.drawn.direction;
            // How far the object goes down the light until it has left the box.
            let leaves = |k: usize| match direction[k] {
                d if d > 0.0 => (max[k] - low[k]) / d,
                d if d < 0.0 => (min[k] - high[k]) / d,
                _ => f32::INFINITY,
            };
            let far = leaves(0).min(leaves(1)).min(leaves(2)).max(0.0);
            std::array::from_fn(|i| {
                let pick = |bit: usize, low: f32, high: f32| if i >> bit & 1 > 0 { high } else { low };
                let corner = Vec3::new(pick(0, min.x, max.x), pick(1, min.y, max.y), pick(2, min.z, max.z));
                corner - direction * pick(3, 0.0, far)
            })
        };
        self.slots.iter().filter(|s| s.drawn.map.is_some()).map(body).collect()
    }

    /// The shadow buffer R = Σ C N·L (1 − S) (eq. 3) of neighbouring surfaces. `gone` says whether a surface gets nothing of a
    /// light anyway, by the numbers of both: what is not there cannot be taken.
    pub fn shadow_buffer(&self, surfaces: &[Surface], gone: impl Fn(usize, usize) -> bool) -> Vec<[f32; 3]> {
        let Some(first) = surfaces.first() else { return Vec::new() };
        let low = surfaces.iter().fold(first.position, |a, s| a.min(s.position));
        let high = surfaces.iter().fold(first.position, |a, s| a.max(s.position));
        let (centre, radius) = ((low + high) / 2.0, low.distance(high) / 2.0);
        // Where the object was when the map was drawn, a point stood as it stands to the object now.
        let then = |slot: &Slot| slot.drawn.pose.anchor - self.pose.anchor;
        let mut sums = vec![[0.0; 3]; surfaces.len()];
        let may_shadow = |s: &Slot| s.drawn.plan.may_shadow(centre + then(s), radius);
        for (i, slot) in self.slots.iter().enumerate().filter(|(_, s)| may_shadow(s)) {
            let Some(map) = &slot.drawn.map else { continue };
            let (direction, power) = (slot.light.source.direction, slot.light.power());
            // Neighbours mostly have one normal.
            let mut lookup: Option<(Vec3, DistantLookup)> = None;
            for (at, (surface, sum)) in surfaces.iter().zip(&mut sums).enumerate() {
                let cos = surface.normal.dot(direction);
                if cos <= 0.0 {
                    continue;
                }
                let on = match &lookup {
                    Some((normal, on)) if *normal == surface.normal => on,
                    _ => {
                        &lookup
                            .insert((surface.normal, DistantLookup::new(map, surface.normal, then(slot))))
                            .1
                    }
                };
                if on.blocked(surface.position) && !gone(i, at) {
                    (0..3).for_each(|k| sum[k] += cos * power[k]);
                }
            }
        }
        sums
    }

    /// The maps as the object's own surfaces look them up.
    pub fn on_itself(&self) -> OnItself<'_> {
        let lift_m = self.bounds.map_or(0.0, |b| 2.0 * b.radius / self.size.max(1) as f32);
        OnItself { lift_m, lights: self.slots.iter().map(|slot| OwnLight::new(slot, &self.pose)).collect() }
    }
}

struct OwnLight<'a> {
    light: &'a DomeLight,
    /// Its direction when the map was drawn.
    drawn: Vec3,
    turn: Quat,
    lookup: Option<DistantLookup<'a>>,
}

impl<'a> OwnLight<'a> {
    /// A point turns with the object, which now has a pose, to where it was when the map was drawn.
    fn new(slot: &'a Slot, now: &Pose) -> Self {
        let then = slot.drawn.pose;
        let turn = then.turn * now.turn.inverse();
        let lookup = |map| DistantLookup::moved(map, turn, then.anchor - turn * now.anchor);
        Self {
            light: &slot.light,
            drawn: slot.drawn.direction,
            turn,
            lookup: slot.drawn.map.as_ref().map(lookup),
        }
    }
}

/// The shadow of the object on itself.
pub struct OnItself<'a> {
    lift_m: f32,
    lights: Vec<OwnLight<'a>>,
}

impl OnItself<'_> {
    /// R of a surface of the object: looked up where it was when the map was drawn, turned with the object, and a texel
    /// above, so that hollows do not hide themselves. `hidden` says whether something else hides a light, by its number and
    /// direction.
    pub fn shadow_buffer(&self, surface: &Surface, hidden: impl Fn(usize, Vec3) -> bool) -> [f32; 3] {
        let from = surface.position + surface.face_normal * self.lift_m;
        let mut sum = [0.0; 3];
        for (i, OwnLight { light, drawn, turn, lookup }) in self.lights.iter().enumerate() {
            let cos = surface.normal.dot(light.source.direction);
            if cos <= 0.0 {
                continue;
            }
            let face = *turn * surface.face_normal;
            // Where smooth normals differ from the triangle's, its edges would show.
            if face.dot(*drawn) <= 0.0 {
                continue;
            }
            let own = lookup.is_some_and(|lookup| lookup.facing(face).blocked(from));
            if own || hidden(i, light.source.direction) {
                let power = light.power();
                (0..3).for_each(|k| sum[k] += cos * power[k]);
            }
        }
        sum
    }
}

/// A light of this frame with its own map, or that of the light of the frame before that stands nearest.
fn carried(before: &[Slot], light: &DomeLight, since: u64) -> Slot {
    let own = |cell: Cell| before.binary_search_by_key(&cell, |s| s.light.cell).ok();
    if let Some(i) = own(light.cell) {
        let Slot { drawn, drawing, since, .. } = &before[i];
        return Slot { light: *light, drawn: drawn.clone(), drawing: *drawing, since: *since };
    }
    let near = |s: &&Slot| s.drawn.direction.dot(light.source.direction);
    let nearest = before.iter().max_by(|a, b| near(a).total_cmp(&near(b)));
    let drawn = nearest.map_or(before[0].drawn.clone(), |s| s.drawn.clone());
    Slot { light: *light, drawn, drawing: 0, since }
}

#[cfg(test)]
mod tests {
    use super::super::{CubeMap, Layout, irradiance, lights};
    use super::*;
    use crate::synthetic::cuboid;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    fn dome(environment: impl Fn(Vec3) -> [f32; 3]) -> Vec<DomeLight> {
        let layout = Layout { texels: 4, centroid: true, splits: 0 };
        lights(&CubeMap::from_fn(16, environment), layout, &mut BTreeSet::new())
    }

    fn floor(x: f32, z: f32) -> Surface {
        let (position, up) = (Vec3::new(x, 0.0, z), Vec3::Y);
        Surface { position, normal: up, face_normal: up, viewer: up, material: 0, pixel_m: 1e-3 }
    }

    fn at(anchor: Vec3) -> Pose {
        Pose { anchor, turn: Quat::IDENTITY }
    }

    #[test]
    fn a_light_fully_blocked_removes_exactly_its_contribution_and_no_occluder_nothing() {
        let lamp = Vec3::new(0.3, 1.0, 0.1).normalize();
        let lights = dome(|d| if d.dot(lamp) > 0.98 { [50.0, 40.0, 20.0] } else { [0.0; 3] });
        assert!(!lights.is_empty());
        let mut maps = DomeMaps::new(64, 1);
        // A lid that hides the whole sky.
        let lid = cuboid(Vec3::Y * 0.01, Vec3::new(5.0, 0.001, 5.0));
        maps.update(&lights, &lid, at(Vec3::ZERO));
        let (gone, all) =
            (maps.shadow_buffer(&[floor(0.0, 0.0)], |_, _| false)[0], irradiance(&lights, Vec3::Y));
        assert!(
            all[0] > 0.0 && (0..3).all(|k| (gone[k] - all[k]).abs() <= 1e-6 * all[k]),
            "{gone:?} {all:?}"
        );
        let crumb = cuboid(Vec3::new(9.0, 9.0, 9.0), Vec3::splat(1e-3));
        maps.update(&lights, &crumb, at(Vec3::new(9.0, 9.0, 9.0)));
        let mut far = DomeMaps::new(64, 1);
        far.update(&lights, &crumb, at(Vec3::ZERO));
        assert_eq!(far.shadow_buffer(&[floor(0.0, 0.0)], |_, _| false), [[0.0; 3]]);
    }

    #[test]
    fn a_shadow_moves_with_its_object_though_no_map_was_drawn() {
        let lights = dome(|d| [1.0 + d.y, 1.0, 1.0 + 0.5 * d.x]);
        let object = cuboid(Vec3::Y * 0.2, Vec3::splat(0.1));
        let by = Vec3::new(0.37, 0.0, -0.21);
        let moved = cuboid(Vec3::Y * 0.2 + by, Vec3::splat(0.1));
        let mut maps = DomeMaps::new(64, 1);
        maps.update(&lights, &object, at(Vec3::ZERO));
        let places: Vec<[f32; 2]> =
            (0..400).map(|i| [i as f32 % 20.0 * 0.05 - 0.5, i as f32 / 400.0 - 0.5]).collect();
        let before: Vec<_> =
            places.iter().map(|p| maps.shadow_buffer(&[floor(p[0], p[1])], |_, _| false)[0]).collect();
        assert_eq!(maps.update(&lights, &moved, at(by)), 1);
        let mut other = 0;
        for (p, before) in places.iter().zip(before) {
            let now = maps.shadow_buffer(&[floor(p[0] + by.x, p[1] + by.z)], |_, _| false)[0];
            other += usize::from((0..3).any(|k| (now[k] - before[k]).abs() > 0.2));
        }
        assert!(other < 4, "{other} of 400 points differ");
    }

    #[test]
    fn the_brightest_change_comes_first_and_all_come_within_the_bound() {
        let object = cuboid(Vec3::Y * 0.2, Vec3::new(0.1, 0.1, 0.3));
        let dim = dome(|_| [1.0; 3]);
        let lamp = Vec3::new(-0.4, 1.0, 0.3).normalize();
        let lit = dome(|d| if d.dot(lamp) > 0.97 { [80.0; 3] } else { [1.0; 3] });
        let mut maps = DomeMaps::new(32, 1);
        maps.update(&dim, &object, at(Vec3::ZERO));
        let first = maps.drawings;
        let strongest = |maps: &DomeMaps| {
            let power = |s: &&Slot| s.light.power()[0];
            maps.slots.iter().max_by(|a, b| power(a).total_cmp(&power(b))).unwrap().drawing
        };
        for _ in 0..2 {
            maps.update(&lit, &object, at(Vec3::ZERO));
        }
        assert!(strongest(&maps) > first, "the lamp's map was drawn within two frames");
        for _ in 0..bound(lit.len(), 1) {
            maps.update(&lit, &object, at(Vec3::ZERO));
        }
        assert!(maps.slots.iter().all(|s| s.drawing > first), "every map was drawn");
    }

    #[test]
    fn a_turned_object_does_not_fall_into_its_old_shadow() {
        let sky = dome(|d| [1.0 + d.y, 1.0, 1.0]);
        let object = cuboid(Vec3::Y * 0.2, Vec3::new(0.3, 0.1, 0.05));
        let mut maps = DomeMaps::new(128, 1);
        maps.update(&sky, &object, at(Vec3::Y * 0.2));
        let turn = Quat::from_rotation_y(0.8);
        let mut turned = object.clone();
        turned.vertices.iter_mut().for_each(|v| *v = turn * *v);
        maps.update(&sky, &turned, Pose { anchor: Vec3::Y * 0.2, turn });
        for (place, normal) in [(Vec3::new(0.25, 0.3, 0.0), Vec3::Y), (Vec3::new(-0.2, 0.2, 0.05), Vec3::Z)] {
            let (position, normal) = (turn * place, turn * normal);
            let own = Surface { position, normal, face_normal: normal, ..floor(0.0, 0.0) };
            assert_eq!(maps.on_itself().shadow_buffer(&own, |_, _| false), [0.0; 3], "{place}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]
        #[test]
        fn no_map_is_older_than_the_bound(per_frame in 1usize..5, turn in 0.0..0.3f32, seed in 0usize..50) {
            let object = cuboid(Vec3::Y * 0.2, Vec3::splat(0.1));
            let lights = dome(|d| [1.0 + 0.5 * (d.x * 7.0 + seed as f32).sin(); 3]);
            let mut maps = DomeMaps::new(16, per_frame);
            for frame in 0..bound(lights.len(), per_frame) + 3 {
                let pose = Pose { anchor: Vec3::ZERO, turn: Quat::from_rotation_y(turn * frame as f32) };
                maps.update(&lights, &object, pose);
                prop_assert!(maps.oldest() <= 2 * lights.len() as u64 + per_frame as u64);
            }
        }
    }
}

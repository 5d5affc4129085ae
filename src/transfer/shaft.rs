//! Shafts (Haines and Wallace 1991): all segments between two boxes, and whether they pass a third.
//!
//! A shaft is the convex hull of its two ends. All boxes are aligned with the axes, so each of the hull's planes is one
//! of a box's or is parallel to an axis and joins an edge of one end to an edge of the other: seen along that axis, it is
//! a line between two corners of rectangles. Together with the directions in which two polyhedra can be parted at their
//! edges, which are the same, they decide exactly whether hull and box are apart (separating axes).

use super::boxes::Box3;
use super::tree::Extent;
use glam::DVec3;

/// The ends of a shaft in f64, as centres and half sides.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shaft {
    a: (DVec3, DVec3),
    b: (DVec3, DVec3),
    /// No end is bounded: it passes everything.
    open: bool,
}

/// Boxes are taken larger by this share of the coordinates' size: rounding never misses a touch.
const MARGIN: f64 = 1e-7;

fn halves(b: Box3) -> (DVec3, DVec3) {
    let (min, max) = (b.min.as_dvec3(), b.max.as_dvec3());
    ((min + max) / 2.0, (max - min) / 2.0)
}

impl Shaft {
    /// Between two boxes, m.
    pub fn between(a: Box3, b: Box3) -> Self {
        Self { a: halves(a), b: halves(b), open: false }
    }

    /// From a receiver box (m) to a node of sources, as far as a box within `reach` m of the receivers can be.
    ///
    /// What a box swept along the directions of a box passes, b + t·w, is the hull of the box and of the box moved as far
    /// as it is asked for: b + s·(T·w) with s in 0..1.
    pub fn to(receivers: Box3, sources: Extent, reach: f64) -> Self {
        let b = halves(receivers);
        match sources {
            Extent::Patches(a) => Self::between(a, receivers),
            Extent::Both => Self { a: b, b, open: true },
            Extent::Distant(w) => {
                let w = halves(w);
                // The shortest vector of the box of directions tells how far it must be stretched.
                let shortest = (w.0.abs() - w.1).max(DVec3::ZERO).length();
                if shortest < 1e-3 {
                    return Self { a: b, b, open: true };
                }
                let t = reach / shortest;
                Self { a: (b.0 + w.0 * t, b.1 + w.1 * t), b, open: false }
            }
        }
    }

    /// Whether some segment of the shaft may touch a box; never says no where one does.
    pub fn meets(&self, object: Box3) -> bool {
        if self.open {
            return true;
        }
        let (c, half) = halves(object);
        let (a, b) = (self.a.0 - c, self.b.0 - c);
        let (p, q) = (self.a.1, self.b.1);
        let size = a.abs().max(b.abs()) + p.max(q) + c.abs();
        let h = half + DVec3::splat(MARGIN * size.max_element());
        // Along the axes, from the middle of the object.
        let (low, high) = ((a - p).min(b - q), (a + p).max(b + q));
        if low.cmpgt(h).any() || high.cmplt(-h).any() {
            return false;
        }
        // In each plane of two axes the normals of the four lines that join like corners of both ends.
        let d = b - a;
        for (i, j) in [(0, 1), (1, 2), (2, 0)] {
            for (si, sj) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
                let (di, dj) = (d[i] + si * (q[i] - p[i]), d[j] + sj * (q[j] - p[j]));
                let (ni, nj) = (-dj, di);
                let (mi, mj) = (ni.abs(), nj.abs());
                let (at, bt) = (ni * a[i] + nj * a[j], ni * b[i] + nj * b[j]);
                let (pt, qt, ht) = (mi * p[i] + mj * p[j], mi * q[i] + mj * q[j], mi * h[i] + mj * h[j]);
                if (at - pt).min(bt - qt) > ht || (at + pt).max(bt + qt) < -ht {
                    return false;
                }
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use proptest::prelude::*;

    fn vec(range: std::ops::Range<f32>) -> impl Strategy<Value = Vec3> {
        (range.clone(), range.clone(), range).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    /// Sides may have no length.
    fn boxes() -> impl Strategy<Value = Box3> {
        let side = || prop_oneof![Just(0.0f32), 0.01..1.5f32];
        (vec(-2.0..2.0), side(), side(), side())
            .prop_map(|(min, x, y, z)| Box3 { min, max: min + Vec3::new(x, y, z) })
    }

    fn inside(b: Box3, u: Vec3) -> Vec3 {
        b.min + (b.max - b.min) * u
    }

    /// Distance of hull and box by Gilbert–Johnson–Keerthi-like descent (Frank–Wolfe on the difference): no plane in it.
    fn apart(a: Box3, b: Box3, c: Box3) -> f64 {
        let corners = |b: Box3| b.corners().map(|p| p.as_dvec3());
        let hull: Vec<DVec3> = corners(a).into_iter().chain(corners(b)).collect();
        let difference: Vec<DVec3> = hull.iter().flat_map(|&p| corners(c).map(|q| p - q)).collect();
        let mut x = difference[0];
        for _ in 0..4000 {
            let s = difference.iter().copied().min_by(|p, q| p.dot(x).total_cmp(&q.dot(x))).unwrap();
            let d = s - x;
            if d.length_squared() < 1e-20 {
                break;
            }
            x += d * (-x.dot(d) / d.length_squared()).clamp(0.0, 1.0);
        }
        x.length()
    }

    proptest! {
        #[test]
        fn a_segment_that_passes_the_box_is_never_missed(
            a in boxes(), b in boxes(), u in vec(0.0..1.0), v in vec(0.0..1.0), t in 0.0..1.0f32, size in vec(0.0..0.3),
            place in vec(0.0..1.0),
        ) {
            let at = inside(a, u).lerp(inside(b, v), t);
            let min = at - size * place;
            let object = Box3::of([min, min + size, at]);
            prop_assert!(Shaft::between(a, b).meets(object), "misses {:?}", object);
        }

        #[test]
        fn what_is_apart_by_a_millimetre_is_told_apart(a in boxes(), b in boxes(), c in boxes()) {
            let distance = apart(a, b, c);
            let meets = Shaft::between(a, b).meets(c);
            prop_assert!(!(meets && distance > 0.05), "meets at {}", distance);
            prop_assert!(meets || distance > 1e-9, "misses at {}", distance);
        }

        #[test]
        fn a_ray_towards_distant_light_is_never_missed(
            b in boxes(), axis in vec(-1.0..1.0), spread in vec(0.0..0.4), u in vec(0.0..1.0), v in vec(0.0..1.0),
            t in 0.0..30.0f32,
        ) {
            prop_assume!(axis.length() > 0.3);
            let axis = axis.normalize();
            let directions = Box3 { min: axis - spread, max: axis + spread };
            let w = inside(directions, v).normalize_or(axis);
            let at = inside(b, u) + w * t;
            let object = Box3::of([at]).grown(0.01);
            let shaft = Shaft::to(b, Extent::Distant(directions), 50.0);
            prop_assert!(shaft.meets(object), "misses {:?}", object);
        }
    }

    #[test]
    fn boxes_in_a_plane_of_the_shaft_touch_it() {
        let a = Box3 { min: Vec3::new(-1.0, 2.0, -1.0), max: Vec3::new(1.0, 2.0, 1.0) };
        let b = Box3 { min: Vec3::new(-1.0, 0.0, -1.0), max: Vec3::new(1.0, 0.0, 1.0) };
        let shaft = Shaft::between(a, b);
        // A flat box on the shaft's side, one beside it, one around all of it, one within, one of a point's size.
        let flat = |x: f32| Box3 { min: Vec3::new(x, 0.5, -0.2), max: Vec3::new(x, 0.9, 0.2) };
        assert!(shaft.meets(flat(1.0)));
        assert!(!shaft.meets(flat(1.001)));
        assert!(shaft.meets(Box3 { min: Vec3::splat(-5.0), max: Vec3::splat(5.0) }));
        assert!(shaft.meets(Box3::of([Vec3::new(0.2, 1.0, 0.3)])));
        assert!(!shaft.meets(Box3::of([Vec3::new(0.2, 2.01, 0.3)])));
    }

    #[test]
    fn an_object_around_the_source_meets_its_shafts() {
        let lamp = Box3 { min: Vec3::new(0.0, 2.0, 0.0), max: Vec3::new(0.1, 2.0, 0.1) };
        let floor = Box3 { min: Vec3::new(-3.0, 0.0, -3.0), max: Vec3::new(3.0, 0.0, 3.0) };
        let shade = Box3 { min: Vec3::new(-0.2, 1.8, -0.2), max: Vec3::new(0.3, 2.2, 0.3) };
        assert!(Shaft::between(lamp, floor).meets(shade));
        assert!(!Shaft::between(lamp, floor).meets(Box3 { min: Vec3::new(-0.2, 2.05, -0.2), ..shade }));
    }

    #[test]
    fn light_from_one_direction_sweeps_a_prism() {
        let b = Box3 { min: Vec3::new(-1.0, 0.0, -1.0), max: Vec3::new(1.0, 0.0, 1.0) };
        let slant = Box3::of([Vec3::new(0.6, 0.8, 0.0)]);
        let shaft = Shaft::to(b, Extent::Distant(slant), 100.0);
        assert!(
            shaft.meets(Box3::of([Vec3::new(4.4, 6.0, 0.0)])),
            "1.0 + 0.75 · 6 is 5.5, −1.0 + 4.5 is 3.5"
        );
        assert!(!shaft.meets(Box3::of([Vec3::new(5.6, 6.0, 0.0)])));
        assert!(!shaft.meets(Box3::of([Vec3::new(3.4, 6.0, 0.0)])));
        assert!(!shaft.meets(Box3::of([Vec3::new(0.0, -0.1, 0.0)])), "below the receivers");
        assert!(Shaft::to(b, Extent::Both, 1.0).meets(Box3::of([Vec3::splat(99.0)])));
    }
}

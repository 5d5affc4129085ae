//! Point-to-polygon form factor by Lambert's formula (Lambert 1760; Baum et al. 1989), clipped to the horizon.

use glam::{DVec3, Vec3};
use std::f64::consts::TAU;

/// Share (0..=1) of the cosine-weighted hemisphere over `normal` (unit) at `point` that a convex planar polygon
/// covers; the irradiance at `point` per unit of the polygon's radiance is π times that.
///
/// One-sided by the order of the corners: 0 where they run clockwise as seen from `point`. Finite everywhere, also
/// where the point lies on the polygon; on an edge the value is that of one of the two sides.
pub fn polygon(point: Vec3, normal: Vec3, corners: &[Vec3]) -> f32 {
    let (p, n) = (point.as_dvec3(), normal.as_dvec3());
    let Some(last) = corners.last() else { return 0.0 };
    let mut sum = 0.0;
    let (mut leaves, mut enters) = (None, None);
    let mut a = last.as_dvec3() - p;
    for corner in corners {
        let b = corner.as_dvec3() - p;
        let (ha, hb) = (a.dot(n), b.dot(n));
        let horizon = || a + (b - a) * (ha / (ha - hb));
        match (ha >= 0.0, hb >= 0.0) {
            (true, true) => sum += edge(a, b, n),
            (true, false) => {
                let q = horizon();
                sum += edge(a, q, n);
                leaves = Some(q);
            }
            (false, true) => {
                let q = horizon();
                sum += edge(q, b, n);
                enters = Some(q);
            }
            (false, false) => {}
        }
        a = b;
    }
    if let (Some(from), Some(to)) = (leaves, enters) {
        sum += edge(from, to, n);
    }
    // The sum is negative where the polygon shows its front: its corners turn about the axis towards the point.
    (-sum / TAU).clamp(0.0, 1.0) as f32
}

/// Angle under which an edge is seen, times the cosine between its plane's normal and `n`.
fn edge(a: DVec3, b: DVec3, n: DVec3) -> f64 {
    let cross = a.cross(b);
    let sine = cross.length();
    if sine > 0.0 { cross.dot(n) * (sine.atan2(a.dot(b)) / sine) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::sampling::{Shift, on_triangle};
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn vec(range: std::ops::Range<f32>) -> impl Strategy<Value = Vec3> {
        (range.clone(), range.clone(), range).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    /// Mean of the kernel over low-discrepancy points: no formula shared with [`polygon`].
    fn sampled(p: Vec3, n: Vec3, t: [Vec3; 3], samples: u32) -> f64 {
        let area_normal = (t[1] - t[0]).cross(t[2] - t[0]) / 2.0;
        let shift = Shift::new(0, 0);
        let sum: f64 = (0..samples)
            .map(|i| {
                let w = on_triangle(t, shift.point(i)) - p;
                let r2 = w.length_squared() as f64;
                (w.dot(n).max(0.0) * (-w.dot(area_normal)).max(0.0)) as f64 / (PI * r2 * r2)
            })
            .sum();
        sum / samples as f64
    }

    fn rectangle(half: f32, half_y: f32, height: f32) -> [Vec3; 4] {
        // Faces −Z, towards a receiver at the origin.
        [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)].map(|(x, y)| Vec3::new(x * half, y * half_y, height))
    }

    #[test]
    fn parallel_rectangle_has_its_closed_form() {
        // A corner over the point: F = 1/2π [A/√(1+A²) atan(B/√(1+A²)) + …] (Howell, B-3); four corners make the whole.
        for (a, b, h) in [(1.0f64, 1.0f64, 1.0f64), (0.1, 2.0, 0.5), (3.0, 0.2, 0.01)] {
            let (x, y) = (a / h, b / h);
            let (rx, ry) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
            let quarter = (x / rx * (y / rx).atan() + y / ry * (x / ry).atan()) / TAU;
            let f = polygon(Vec3::ZERO, Vec3::Z, &rectangle(a as f32, b as f32, h as f32)) as f64;
            assert!((f - 4.0 * quarter).abs() < 1e-6, "{a} {b} {h}: {f} against {}", 4.0 * quarter);
        }
    }

    #[test]
    fn disc_has_its_closed_form() {
        let (radius, height, sides) = (0.7f64, 1.3f64, 2000);
        let corners: Vec<Vec3> = (0..sides)
            .map(|i| {
                let (s, c) = (-TAU * i as f64 / sides as f64).sin_cos();
                Vec3::new((radius * c) as f32, (radius * s) as f32, height as f32)
            })
            .collect();
        let exact = radius * radius / (radius * radius + height * height);
        assert!((polygon(Vec3::ZERO, Vec3::Z, &corners) as f64 - exact).abs() < 1e-5);
    }

    #[test]
    fn a_source_that_touches_the_receiver_is_finite() {
        // 1/r² has no bound here; the form factor goes to 1 over the polygon and to ½ at the foot of a tall wall.
        for height in [1e-2, 1e-4, 1e-6, 0.0] {
            let f = polygon(Vec3::ZERO, Vec3::Z, &rectangle(1.0, 1.0, height));
            assert!((f - 1.0).abs() < 2.0 * height + 1e-6, "{f} at {height} m");
        }
        let wall = [(0.0, -1e3), (0.0, 1e3)].map(|(z, y)| Vec3::new(0.0, y, z));
        let wall = [wall[0], Vec3::new(0.0, 1e3, 0.0), Vec3::new(0.0, 1e3, 1e3), Vec3::new(0.0, -1e3, 1e3)];
        let f = polygon(Vec3::new(-1e-5, 0.0, 0.0), Vec3::Z, &wall);
        let g = polygon(Vec3::new(1e-5, 0.0, 0.0), Vec3::Z, &wall);
        assert!((f.max(g) - 0.5).abs() < 1e-3 && f.min(g) == 0.0, "{f} {g}");
        assert!(polygon(Vec3::ZERO, Vec3::Z, &wall).is_finite());
    }

    #[test]
    fn below_the_horizon_and_from_behind_there_is_nothing() {
        let mut corners = rectangle(1.0, 1.0, -0.5);
        assert_eq!(polygon(Vec3::ZERO, Vec3::Z, &corners), 0.0);
        corners = rectangle(1.0, 1.0, 0.5);
        corners.reverse();
        assert_eq!(polygon(Vec3::ZERO, Vec3::Z, &corners), 0.0);
        assert_eq!(polygon(Vec3::ZERO, Vec3::Z, &[]), 0.0);
        assert_eq!(polygon(Vec3::ZERO, Vec3::Z, &[Vec3::Z; 3]), 0.0, "zero area");
    }

    proptest! {
        #[test]
        fn agrees_with_sampling_also_across_the_horizon(
            p in vec(-1.0..1.0), n in vec(-1.0..1.0), a in vec(-3.0..3.0), b in vec(-3.0..3.0), c in vec(-3.0..3.0),
        ) {
            prop_assume!(n.length() > 0.1 && [a, b, c].iter().all(|v| v.distance(p) > 0.7));
            let t = [a, b, c];
            let plane = (b - a).cross(c - a).normalize_or_zero();
            prop_assume!((p - a).dot(plane).abs() > 0.3);
            let (f, s) = (polygon(p, n.normalize(), &t) as f64, sampled(p, n.normalize(), t, 20_000));
            prop_assert!((f - s).abs() < 2e-3 + 0.01 * s, "{} against {}", f, s);
        }

        #[test]
        fn parts_add_up_to_the_whole(
            p in vec(-1.0..1.0), n in vec(-1.0..1.0), a in vec(-3.0..3.0), b in vec(-3.0..3.0), c in vec(-3.0..3.0),
            s in 0.05..0.95f32,
        ) {
            prop_assume!(n.length() > 0.1);
            let (n, m) = (n.normalize(), a + (b - a) * s);
            let whole = polygon(p, n, &[a, b, c]);
            let parts = polygon(p, n, &[a, m, c]) + polygon(p, n, &[m, b, c]);
            prop_assert!((whole - parts).abs() < 1e-5, "{} against {}", whole, parts);
        }

        #[test]
        fn far_sources_fall_with_the_square_of_the_distance(r in 10.0..1e4f32) {
            let f = polygon(Vec3::ZERO, Vec3::Z, &rectangle(0.05, 0.05, r)) as f64;
            let point_source = 0.01 / (PI * r as f64 * r as f64);
            prop_assert!((f / point_source - 1.0).abs() < 1e-3);
        }
    }
}

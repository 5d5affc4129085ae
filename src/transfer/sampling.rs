//! Low-discrepancy points: deterministic, the same for any number of threads.

use glam::{DVec3, Vec2, Vec3};

/// A shifted R₂ sequence (Roberts 2018): any run of neighbouring indices is well spread over the unit square.
#[derive(Debug, Clone, Copy)]
pub struct Shift([u32; 2]);

impl Shift {
    /// The shift of a pair of numbers, e.g. of a source and a receiver (Cranley–Patterson rotation).
    pub fn new(a: u64, b: u64) -> Self {
        let h = hash(hash(a) ^ b);
        Self([h as u32, (h >> 32) as u32])
    }

    /// Point `i` in the unit square.
    pub fn point(self, i: u32) -> Vec2 {
        // 2³²/p and 2³²/p² with p the plastic number: sums wrap exactly.
        let x = self.0[0].wrapping_add(i.wrapping_mul(3_242_174_889));
        let y = self.0[1].wrapping_add(i.wrapping_mul(2_447_445_414));
        Vec2::new(unit(x), unit(y))
    }

    /// A number in `0..1` of its own.
    pub fn jitter(self, i: u32) -> f32 {
        unit(hash((self.0[0] as u64) << 32 | i as u64) as u32)
    }
}

fn unit(x: u32) -> f32 {
    (x >> 8) as f32 / (1 << 24) as f32
}

/// SplitMix64 (Steele et al. 2014).
fn hash(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Unit square to triangle, area for area.
pub fn on_triangle([a, b, c]: [Vec3; 3], mut u: Vec2) -> Vec3 {
    if u.x + u.y > 1.0 {
        u = Vec2::ONE - u;
    }
    a + (b - a) * u.x + (c - a) * u.y
}

/// Unit square to directions to a triangle (corners as seen from the origin), solid angle for solid angle (Arvo 1995).
/// `None` where it is too thin to have an inside.
pub fn towards_triangle(corners: [DVec3; 3], u: Vec2) -> Option<DVec3> {
    let [a, b, c] = corners.map(|v| v.try_normalize());
    let (a, b, c) = (a?, b?, c?);
    let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| p.cross(q).try_normalize());
    let (ab, bc, ca) = (ab?, bc?, ca?);
    let angle = |p: DVec3, q: DVec3| p.cross(q).length().atan2(p.dot(q));
    let (alpha, beta, gamma) = (angle(ab, -ca), angle(bc, -ab), angle(ca, -bc));
    let excess = alpha + beta + gamma - std::f64::consts::PI;
    // The part of the triangle up to the arc from b to a point p of the side c–a has the area u.x times the whole.
    let (sine, cosine) = (f64::from(u.x) * excess - alpha).sin_cos();
    let (sine_alpha, cosine_alpha) = alpha.sin_cos();
    let (k1, k2) = (cosine - cosine_alpha, sine + sine_alpha * a.dot(b));
    let above = (k2 * cosine - k1 * sine) * cosine_alpha - k2;
    let below = (k2 * sine + k1 * cosine) * sine_alpha;
    let along = if below.abs() > 1e-300 { (above / below).clamp(-1.0, 1.0) } else { 1.0 };
    let orthogonal = |v: DVec3, axis: DVec3| (v - axis * v.dot(axis)).try_normalize();
    let p = a * along + orthogonal(c, a)? * (1.0 - along * along).sqrt();
    let z = 1.0 - f64::from(u.y) * (1.0 - p.dot(b));
    let side = orthogonal(p, b).unwrap_or(DVec3::ZERO);
    Some((b * z + side * (1.0 - z * z).max(0.0).sqrt()).normalize())
}

/// Unit square to a disc of directions around `axis` (unit), solid angle for solid angle.
pub fn in_cap(axis: Vec3, angular_radius: f32, u: Vec2) -> Vec3 {
    let z = 1.0 - u.x * (1.0 - angular_radius.cos());
    let (s, c) = (std::f32::consts::TAU * u.y).sin_cos();
    let (x, y) = axis.any_orthonormal_pair();
    let r = (1.0 - z * z).max(0.0).sqrt();
    (x * (r * c) + y * (r * s) + axis * z).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_fill_the_triangle_evenly() {
        let t = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let n = 4096;
        for shift in [Shift::new(0, 0), Shift::new(7, 9)] {
            let mean = (0..n).map(|i| on_triangle(t, shift.point(i))).sum::<Vec3>() / n as f32;
            assert!((mean - Vec3::new(1.0, 1.0, 0.0) / 3.0).length() < 1e-3, "{mean}");
        }
    }

    #[test]
    fn directions_fill_a_triangle_by_solid_angle() {
        // An octant: the mean direction of its points is 1/2 along each axis; then one that is seen at a slant.
        let shift = Shift::new(3, 4);
        let n = 20_000;
        let octant = [DVec3::X, DVec3::Y, DVec3::Z];
        let mean =
            (0..n).filter_map(|i| towards_triangle(octant, shift.point(i))).sum::<DVec3>() / f64::from(n);
        assert!((mean - DVec3::splat(0.5)).length() < 2e-3, "{mean}");
        let corners = [DVec3::new(-0.3, 0.01, -0.2), DVec3::new(0.4, 0.01, -0.1), DVec3::new(0.1, 0.01, 0.9)];
        let plane = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let mut cosine = 0.0;
        for i in 0..n {
            let w = towards_triangle(corners, shift.point(i)).unwrap();
            let y = w * (corners[0].dot(plane) / w.dot(plane));
            let inside = (0..3).all(|k| {
                let (p, q) = (corners[k], corners[(k + 1) % 3]);
                (q - p).cross(y - p).dot(plane) >= -1e-9
            });
            assert!(inside, "{y}");
            cosine += w.y / f64::from(n);
        }
        // ∫ cos θ dω over the triangle is π times its form factor.
        let corners = corners.map(|c| c.as_vec3());
        let form = f64::from(crate::transfer::form_factor::polygon(Vec3::ZERO, Vec3::Y, &corners));
        let solid_angle = std::f64::consts::PI * form / cosine;
        let [a, b, c] = corners.map(|c| c.as_dvec3().normalize());
        // Van Oosterom and Strackee 1983.
        let half = a.dot(b.cross(c)).abs().atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a));
        assert!((solid_angle / (2.0 * half) - 1.0).abs() < 5e-3, "{solid_angle}, {}", 2.0 * half);
    }

    #[test]
    fn directions_stay_in_the_cap() {
        let axis = Vec3::new(0.3, -0.5, 0.8).normalize();
        for i in 0..1000 {
            let w = in_cap(axis, 0.2, Shift::new(1, 2).point(i));
            assert!(w.dot(axis) >= 0.2f32.cos() - 1e-6);
        }
    }
}

//! Low-discrepancy points: deterministic, the same for any number of threads.

use glam::{Vec2, Vec3};

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
    fn directions_stay_in_the_cap() {
        let axis = Vec3::new(0.3, -0.5, 0.8).normalize();
        for i in 0..1000 {
            let w = in_cap(axis, 0.2, Shift::new(1, 2).point(i));
            assert!(w.dot(axis) >= 0.2f32.cos() - 1e-6);
        }
    }
}

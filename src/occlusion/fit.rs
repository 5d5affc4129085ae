//! A rectangle on coplanar triangles.

use glam::{DMat2, DVec2};

/// A triangle in the plane, m.
pub(super) type Triangle = [DVec2; 3];

/// A rectangle in the plane: middle, unit direction of its first side, half sides, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rectangle {
    pub centre: DVec2,
    pub axis: DVec2,
    pub half: DVec2,
}

/// Steps by which the direction is sought, first over a right angle, then around the best, rad.
const COARSE: f64 = std::f64::consts::FRAC_PI_2 / 30.0;
const FINE: f64 = COARSE / 12.0;

impl Rectangle {
    /// The rectangle with the same middle and second moments as some triangles together, in the direction in which it
    /// covers them best, and the share that they and it have in common (intersection over union). Moments, unlike
    /// borders, hardly see that triangles are ragged.
    pub fn fit(triangles: &[Triangle]) -> Option<(Self, f64)> {
        let total: f64 = triangles.iter().map(area).sum();
        let centre = triangles.iter().map(|t| (t[0] + t[1] + t[2]) / 3.0 * area(t)).sum::<DVec2>() / total;
        let at = |angle: f64| {
            let axis = DVec2::from_angle(angle);
            let turned = turn(axis);
            // The mean of x² over a triangle is (Σ xᵢ² + (Σ xᵢ)²) / 12.
            let mean = |t: &Triangle| {
                let q = t.map(|p| turned * (p - centre));
                let sum = q[0] + q[1] + q[2];
                (q.iter().map(|q| q * q).sum::<DVec2>() + sum * sum) / 12.0 * area(t)
            };
            let variance = triangles.iter().map(mean).sum::<DVec2>() / total;
            let rectangle = Self { centre, axis, half: (3.0 * variance).map(f64::sqrt) };
            let inside = rectangle.share_of(triangles) * total;
            let share = inside / (total + rectangle.area() - inside);
            (rectangle, share, angle)
        };
        let best = |from: f64, step: f64, count: i32| {
            let tried = (0..count).map(|i| at(from + step * f64::from(i)));
            tried.filter(|t| t.1.is_finite()).max_by(|a, b| a.1.total_cmp(&b.1))
        };
        let (.., angle) = best(0.0, COARSE, 30)?;
        best(angle - COARSE, FINE, 25).map(|(rectangle, share, _)| (rectangle, share))
    }

    /// m².
    pub fn area(&self) -> f64 {
        4.0 * self.half.x * self.half.y
    }

    /// Share of the area of triangles that lies in the rectangle.
    pub fn share_of(&self, triangles: &[Triangle]) -> f64 {
        let total: f64 = triangles.iter().map(area).sum();
        triangles.iter().map(|t| self.common_area(t)).sum::<f64>() / total
    }

    /// Area of the part of a triangle that lies in the rectangle, m².
    pub fn common_area(&self, triangle: &Triangle) -> f64 {
        let turned = turn(self.axis);
        let mut polygon: Vec<DVec2> = triangle.iter().map(|&p| turned * (p - self.centre)).collect();
        for (k, sign) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)] {
            let within = |p: DVec2| self.half[k] - sign * p[k];
            // Sutherland and Hodgman 1974.
            let mut clipped = Vec::with_capacity(polygon.len() + 1);
            for (i, &a) in polygon.iter().enumerate() {
                let b = polygon[(i + 1) % polygon.len()];
                let (da, db) = (within(a), within(b));
                if da >= 0.0 {
                    clipped.push(a);
                }
                if (da >= 0.0) != (db >= 0.0) {
                    clipped.push(a.lerp(b, da / (da - db)));
                }
            }
            polygon = clipped;
        }
        let next = polygon.iter().cycle().skip(1);
        polygon.iter().zip(next).map(|(a, b)| a.perp_dot(*b)).sum::<f64>().abs() / 2.0
    }
}

/// Into a frame whose first axis is the given one.
fn turn(axis: DVec2) -> DMat2 {
    DMat2::from_cols(axis, axis.perp()).transpose()
}

fn area(t: &Triangle) -> f64 {
    (t[1] - t[0]).perp_dot(t[2] - t[0]).abs() / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_turned_rectangle_is_found(
            x in -2.0..2.0f64, y in -2.0..2.0f64, angle in 0.0..1.57f64, u in 0.1..1.0f64, v in 0.1..1.0f64,
        ) {
            let (centre, axis) = (DVec2::new(x, y), DVec2::from_angle(angle));
            let corner = |a: f64, b: f64| centre + axis * (a * u) + axis.perp() * (b * v);
            let [p, q, r, s] = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(a, b)| corner(a, b));
            let (found, share) = Rectangle::fit(&[[p, q, r], [p, r, s]]).unwrap();
            prop_assert!(share > 0.96 && found.centre.distance(centre) < 1e-9, "{:?} {}", found, share);
            prop_assert!((found.area() / (4.0 * u * v) - 1.0).abs() < 0.02, "{:?}", found);
        }
    }

    #[test]
    fn what_is_no_rectangle_covers_little_of_one() {
        let fan = |radius: f64| {
            move |i: i32| {
                let at = |i: i32| DVec2::from_angle(f64::from(i) * std::f64::consts::TAU / 24.0);
                [at(i) * radius, at(i + 1) * radius, DVec2::ZERO]
            }
        };
        let triangle = [[DVec2::ZERO, DVec2::X, DVec2::Y]];
        let mut frame: Vec<Triangle> = Vec::new();
        for i in 0..24 {
            let [a, b, _] = fan(1.0)(i);
            frame.extend([[a, b, a * 0.8], [b, b * 0.8, a * 0.8]]);
        }
        assert!(Rectangle::fit(&triangle).unwrap().1 < 0.75);
        assert!(Rectangle::fit(&frame).unwrap().1 < 0.5);
        assert!(Rectangle::fit(&[[DVec2::X; 3]]).is_none_or(|f| f.1 < 0.5), "no area");
    }
}

//! The outline of a ball in a picture: the tangent cone from the camera, projected exactly.

use crate::camera::Camera;
use nalgebra::{Point2, Point3, Vector3};

/// Points of tangency of a ball seen from `eye`: the rim, at the given angle about the line of sight.
pub struct Rim {
    centre: Point3<f64>,
    across: Vector3<f64>,
    up: Vector3<f64>,
}

impl Rim {
    /// `None` where the eye is inside the ball.
    pub fn new(eye: &Point3<f64>, centre: &Point3<f64>, radius_m: f64) -> Option<Self> {
        let axis = centre - eye;
        let distance = axis.norm();
        if distance <= radius_m * 1.000_001 {
            return None;
        }
        let axis = axis / distance;
        // The circle of tangency lies r²/d in front of the centre, and has the radius r √(1 − r²/d²).
        let k = radius_m / distance;
        let rim = radius_m * (1.0 - k * k).sqrt();
        let helper = if axis.y.abs() < 0.9 { Vector3::y() } else { Vector3::x() };
        let across = axis.cross(&helper).normalize();
        let up = across.cross(&axis);
        Some(Self { centre: centre - axis * (radius_m * k), across: across * rim, up: up * rim })
    }

    /// The angle at which the rim is nearest to a direction from the eye, rad.
    pub fn angle_of(&self, direction: &Vector3<f64>) -> f64 {
        direction.dot(&self.up).atan2(direction.dot(&self.across))
    }

    /// The point at an angle, world, m.
    pub fn at(&self, angle: f64) -> Point3<f64> {
        let (sin, cos) = angle.sin_cos();
        self.centre + self.across * cos + self.up * sin
    }
}

/// The outline in the picture at `count` equal steps of the angle; `None` where a point lies behind the camera.
pub fn project(
    camera: &Camera,
    centre: &Point3<f64>,
    radius_m: f64,
    count: usize,
) -> Option<Vec<Point2<f64>>> {
    let rim = Rim::new(&camera.centre(), centre, radius_m)?;
    (0..count).map(|i| camera.project(&rim.at(angle(i, count)))).collect()
}

/// Angle of the `i`-th of `count` outline points, rad.
pub fn angle(i: usize, count: usize) -> f64 {
    std::f64::consts::TAU * i as f64 / count as f64
}

/// Mean radius of the ball in the picture, px: radius of the circle of the outline's area.
pub fn radius_px(outline: &[Point2<f64>]) -> f64 {
    let n = outline.len();
    let area: f64 = (0..n)
        .map(|i| {
            let (a, b) = (outline[i], outline[(i + 1) % n]);
            (a.x * b.y - b.x * a.y) / 2.0
        })
        .sum();
    (area.abs() / std::f64::consts::PI).sqrt()
}

/// Share of the outline outside a `width × height` picture.
pub fn share_outside(outline: &[Point2<f64>], width: usize, height: usize) -> f64 {
    let inside = |p: &Point2<f64>| p.x >= 0.0 && p.y >= 0.0 && p.x <= width as f64 && p.y <= height as f64;
    outline.iter().filter(|p| !inside(p)).count() as f64 / outline.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::probe::mirror_ball::reflected_ray;
    use nalgebra::Isometry3;

    #[test]
    fn rays_meet_the_ball_just_inside_the_outline_and_miss_it_just_outside() {
        let camera = Camera {
            intrinsics: Intrinsics { focal_px: [600.0, 480.0], ..Intrinsics::pinhole(640, 480, 600.0) },
            world_from_camera: Isometry3::identity(),
        };
        let centre = Point3::new(0.2, 0.1, 0.9);
        let points = project(&camera, &centre, 0.1, 64).unwrap();
        let middle = points.iter().fold(Vector3::zeros(), |s, p| s + Vector3::new(p.x, p.y, 0.0)) / 64.0;
        for p in &points {
            let out = (p - Point2::new(middle.x, middle.y)).normalize();
            assert!(reflected_ray(&camera, &centre, 0.1, &(p - out * 0.05)).is_some());
            assert!(
                reflected_ray(&camera, &centre, 0.1, &(p + out * 0.05)).is_none(),
                "non-square pixels too"
            );
        }
    }

    #[test]
    fn an_eye_inside_the_ball_sees_no_outline() {
        assert!(Rim::new(&Point3::origin(), &Point3::new(0.0, 0.05, 0.0), 0.1).is_none());
    }
}

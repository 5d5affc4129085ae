//! A small path tracer of diffuse surfaces, area lights and one mirror ball: true pictures of scenes made by rule.

use crate::image::{Image, Radiance, RadianceImage};
use crate::shadow::Occluder;
use crate::visibility::Bvh;
use glam::Vec3;
use rand::{Rng, SeedableRng, rngs::SmallRng};
use rayon::prelude::*;
use std::f32::consts::{PI, TAU};

/// What a surface does with light.
#[derive(Clone, Copy)]
pub enum Finish<'a> {
    /// Sends this radiance from its front, and reflects nothing.
    Emitter([f32; 3]),
    /// Reflects diffusely, by place.
    Diffuse(&'a (dyn Fn(Vec3) -> [f32; 3] + Sync)),
}

/// A parallelogram, front along u × v.
#[derive(Clone, Copy)]
pub struct Quad<'a> {
    /// A corner, m.
    pub corner: Vec3,
    /// Its sides, m.
    pub sides: [Vec3; 2],
    /// What it does with light.
    pub finish: Finish<'a>,
    /// A light that is small and bright is sampled by its area.
    pub sampled: bool,
}

/// A mirror ball.
#[derive(Debug, Clone, Copy)]
pub struct Ball {
    /// Centre, m.
    pub centre: Vec3,
    /// Radius, m.
    pub radius: f32,
    /// Share of light reflected.
    pub reflectivity: f32,
}

/// A scene, ready for rays.
pub struct Tracer<'a> {
    quads: Vec<Quad<'a>>,
    ball: Option<Ball>,
    object_reflectance: [f32; 3],
    normals: Vec<Vec3>,
    bvh: Bvh,
}

/// Diffuse bounces followed.
const BOUNCES: u32 = 3;
const OFFSET_M: f32 = 1e-4;

impl<'a> Tracer<'a> {
    /// Quads, perhaps a ball, perhaps an object of one reflectance.
    pub fn new(quads: Vec<Quad<'a>>, ball: Option<Ball>, object: Option<(&Occluder, [f32; 3])>) -> Self {
        let (mut vertices, mut triangles): (Vec<Vec3>, Vec<[u32; 3]>) = (Vec::new(), Vec::new());
        for Quad { corner, sides: [u, v], .. } in &quads {
            let base = vertices.len() as u32;
            vertices.extend([*corner, corner + u, corner + u + v, corner + v]);
            triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        }
        if let Some((object, _)) = object {
            let base = vertices.len() as u32;
            vertices.extend(&object.vertices);
            triangles.extend(object.triangles.iter().map(|t| t.map(|v| v + base)));
        }
        let normal = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| vertices[v as usize]);
            (b - a).cross(c - a).normalize_or_zero()
        };
        let normals = triangles.iter().map(normal).collect();
        let object_reflectance = object.map_or([0.0; 3], |o| o.1);
        Self { quads, ball, object_reflectance, normals, bvh: Bvh::new(&vertices, &triangles) }
    }

    /// A picture of some size (px) by `side`² rays a pixel. `ray` gives origin and unit direction at a place of the picture, or
    /// nothing where the lens shows none.
    pub fn picture(
        &self,
        (width, height): (usize, usize),
        side: usize,
        seed: u64,
        ray: impl Fn(f64, f64) -> Option<(Vec3, Vec3)> + Sync,
    ) -> RadianceImage {
        let pixel = |i: usize| {
            let mut rng = SmallRng::seed_from_u64(seed ^ (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
            let (x, y) = (i % width, i / width);
            let mut sum = [0.0f32; 3];
            for s in 0..side * side {
                let mut at =
                    |k: usize, part: usize| k as f64 + (part as f64 + rng.random::<f64>()) / side as f64;
                let (px, py) = (at(x, s % side), at(y, s / side));
                let Some((origin, direction)) = ray(px, py) else { continue };
                let radiance = self.radiance(origin, direction, true, BOUNCES, &mut rng);
                (0..3).for_each(|k| sum[k] += radiance[k] / (side * side) as f32);
            }
            Radiance(sum)
        };
        Image::from_pixels(width, height, (0..width * height).into_par_iter().map(pixel).collect())
    }

    fn ball_at(&self, origin: Vec3, direction: Vec3, most: f32) -> Option<(f32, &Ball)> {
        let ball = self.ball.as_ref()?;
        let to = ball.centre - origin;
        let along = to.dot(direction);
        let discriminant = along * along - to.length_squared() + ball.radius * ball.radius;
        let t = along - discriminant.max(0.0).sqrt();
        (discriminant > 0.0 && t > OFFSET_M && t < most).then_some((t, ball))
    }

    /// Radiance along a ray; that of sampled lights only where `sees_lights`.
    fn radiance(
        &self,
        origin: Vec3,
        direction: Vec3,
        sees_lights: bool,
        bounces: u32,
        rng: &mut SmallRng,
    ) -> [f32; 3] {
        let hit = self.bvh.closest(origin, direction, 0.0, f32::INFINITY);
        let most = hit.map_or(f32::INFINITY, |h| h.t);
        if let Some((t, ball)) = self.ball_at(origin, direction, most) {
            let point = origin + direction * t;
            let normal = (point - ball.centre) / ball.radius;
            let mirrored = direction - normal * (2.0 * direction.dot(normal));
            let seen = self.radiance(point + normal * OFFSET_M, mirrored, sees_lights, bounces, rng);
            return seen.map(|l| l * ball.reflectivity);
        }
        let Some(hit) = hit else { return [0.0; 3] };
        let normal = self.normals[hit.triangle as usize];
        let (front, point) = (normal.dot(direction) < 0.0, origin + direction * hit.t);
        let reflectance = match self.quads.get(hit.triangle as usize / 2) {
            Some(Quad { finish: Finish::Emitter(radiance), sampled, .. }) => {
                return if front && (sees_lights || !sampled) { *radiance } else { [0.0; 3] };
            }
            Some(Quad { finish: Finish::Diffuse(reflectance), .. }) => reflectance(point),
            None => self.object_reflectance,
        };
        let normal = if front { normal } else { -normal };
        if bounces == 0 {
            return [0.0; 3];
        }
        let from = point + normal * OFFSET_M;
        let direct = self.direct(from, normal, rng);
        // Cosine-weighted: what comes back is the mean.
        let (r, phi) = (rng.random::<f32>().sqrt(), TAU * rng.random::<f32>());
        let (right, down) = normal.any_orthonormal_pair();
        let along = right * (r * phi.cos()) + down * (r * phi.sin()) + normal * (1.0 - r * r).max(0.0).sqrt();
        let indirect = self.radiance(from, along, false, bounces - 1, rng);
        [0, 1, 2].map(|k| reflectance[k] * (direct[k] / PI + indirect[k]))
    }

    /// Irradiance from the sampled lights.
    fn direct(&self, from: Vec3, normal: Vec3, rng: &mut SmallRng) -> [f32; 3] {
        let mut sum = [0.0; 3];
        for quad in self.quads.iter().filter(|q| q.sampled) {
            let Finish::Emitter(radiance) = quad.finish else { continue };
            let [u, v] = quad.sides;
            let to = quad.corner + u * rng.random::<f32>() + v * rng.random::<f32>() - from;
            let (distance, area) = (to.length(), u.cross(v));
            let direction = to / distance;
            let (cos, at_light) = (normal.dot(direction), -area.dot(direction));
            let near = distance * (1.0 - 1e-4);
            if cos <= 0.0
                || at_light <= 0.0
                || self.ball_at(from, direction, near).is_some()
                || self.bvh.any_hit(from, direction, 0.0, near)
            {
                continue;
            }
            (0..3).for_each(|k| sum[k] += radiance[k] * cos * at_light / (distance * distance));
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_white_furnace_stays_white_and_a_lamp_obeys_the_inverse_square() {
        let grey = |_: Vec3| [0.5; 3];
        let (x, y, z) = (Vec3::X * 20.0, Vec3::Y * 20.0, Vec3::Z * 20.0);
        let low = Vec3::splat(-10.0);
        let wall =
            |corner, u, v| Quad { corner, sides: [u, v], finish: Finish::Emitter([2.0; 3]), sampled: false };
        let mut quads = vec![
            wall(low, z, x),
            wall(low + y, x, z),
            wall(low, y, z),
            wall(low + x, z, y),
            wall(low, x, y),
            wall(low + z, y, x),
        ];
        let table = Vec3::new(-0.5, 0.0, -0.5);
        let floor =
            Quad { corner: table, sides: [Vec3::Z, Vec3::X], finish: Finish::Diffuse(&grey), sampled: false };
        quads.push(floor);
        let down = |x: f64, y: f64| Some((Vec3::new(0.01 * x as f32, 1.0, 0.01 * y as f32), Vec3::NEG_Y));
        let picture = Tracer::new(quads.clone(), None, None).picture((8, 8), 8, 1, down);
        assert!(picture.pixels().iter().all(|p| (p.0[0] - 1.0).abs() < 1e-4), "{:?}", picture.at(3, 3));
        let lamp = Quad {
            corner: Vec3::new(-0.05, 2.0, -0.05),
            sides: [Vec3::X * 0.1, Vec3::Z * 0.1],
            finish: Finish::Emitter([300.0; 3]),
            sampled: true,
        };
        let picture = Tracer::new(vec![floor, lamp], None, None).picture((8, 8), 8, 1, down);
        let expected = 0.5 / PI * 300.0 * 0.01 / 4.0;
        assert!((picture.at(0, 0).0[0] / expected - 1.0).abs() < 0.02, "{:?} {expected}", picture.at(0, 0));
    }
}

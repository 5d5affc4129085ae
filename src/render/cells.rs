//! Directions to sample an environment by: cells of about equal power, as the median cut makes them (Debevec 2005).

use super::environment::Environment;
use crate::probe::latlong;
use glam::Vec3;
use rand::Rng;
use std::f32::consts::PI;

/// A partition of the sphere of directions.
#[derive(Debug, Clone)]
pub struct Cells {
    width: usize,
    height: usize,
    cells: Vec<Cell>,
    radiance: Vec<[f32; 3]>,
}

#[derive(Debug, Clone)]
struct Cell {
    /// Texels and the running sum of their chances, ending at 1.
    texels: Vec<(u32, f32)>,
    /// Solid angle over chance of each texel, sr.
    weight: Vec<f32>,
}

/// A direction drawn from a cell. Summing `weight × f(direction)` over one draw from each cell estimates ∫ f dω.
#[derive(Debug, Clone, Copy)]
pub struct Draw {
    /// Unit vector in the world.
    pub direction: Vec3,
    /// sr.
    pub weight: f32,
    /// The environment's radiance there, plate units.
    pub radiance: [f32; 3],
}

/// Share of the chances that goes by solid angle alone: light from the object itself may come from where the
/// environment is dark.
const UNIFORM_SHARE: f64 = 0.25;

impl Cells {
    /// Cuts the sphere into `count` cells by splitting the most powerful one across its longer side until enough.
    pub fn new(environment: &Environment, count: usize) -> Self {
        let (width, height) = environment.map.size();
        let power = environment.power();
        let total: f64 = power.iter().sum();
        let solid_angle = |y: usize| latlong::texel_solid_angle(y, width, height);
        let chance: Vec<f64> = (0..width * height)
            .map(|i| {
                let uniform = solid_angle(i / width) / (4.0 * std::f64::consts::PI);
                if total > 0.0 {
                    UNIFORM_SHARE * uniform + (1.0 - UNIFORM_SHARE) * power[i] / total
                } else {
                    uniform
                }
            })
            .collect();
        let mass = |r: &Rectangle| -> f64 { r.texels(width).map(|i| chance[i]).sum() };
        let whole = Rectangle { x: [0, width], y: [0, height] };
        let mut rectangles = vec![(whole, 1.0f64)];
        while rectangles.len() < count {
            let splittable = rectangles.iter().enumerate().filter(|(_, (r, _))| r.area() > 1);
            let Some((heaviest, _)) = splittable.max_by(|(_, a), (_, b)| a.1.total_cmp(&b.1)) else { break };
            let (rectangle, _) = rectangles.swap_remove(heaviest);
            rectangles.extend(rectangle.split(width, height, &chance).map(|r| (r, mass(&r))));
        }
        let cells = rectangles
            .iter()
            .map(|(r, mass)| {
                let mut running = 0.0;
                let mut cell = Cell { texels: Vec::new(), weight: Vec::new() };
                for i in r.texels(width) {
                    running += chance[i] / mass;
                    cell.texels.push((i as u32, running as f32));
                    cell.weight.push((solid_angle(i / width) * mass / chance[i]) as f32);
                }
                cell
            })
            .collect();
        Self { width, height, cells, radiance: environment.map.pixels().iter().map(|p| p.0).collect() }
    }

    /// One direction from each cell.
    pub fn draw<'a, R: Rng>(&'a self, rng: &'a mut R) -> impl Iterator<Item = Draw> + 'a {
        self.cells.iter().map(move |cell| {
            let u: f32 = rng.random();
            let k = cell.texels.partition_point(|(_, running)| *running <= u).min(cell.texels.len() - 1);
            let i = cell.texels[k].0 as usize;
            let x = (i % self.width) as f32 + rng.random::<f32>();
            // Uniform in solid angle within the texel.
            let edge = |row: usize| (PI / 2.0 - PI * row as f32 / self.height as f32).sin();
            let row = i / self.width;
            let (top, bottom) = (edge(row), edge(row + 1));
            let sine = (top + (bottom - top) * rng.random::<f32>()).clamp(-1.0, 1.0);
            let y = (PI / 2.0 - sine.asin()) / PI * self.height as f32;
            Draw {
                direction: latlong::direction(x, y, self.width, self.height),
                weight: cell.weight[k],
                radiance: self.radiance[i],
            }
        })
    }
}

#[derive(Debug, Clone, Copy)]
struct Rectangle {
    x: [usize; 2],
    y: [usize; 2],
}

impl Rectangle {
    fn area(&self) -> usize {
        (self.x[1] - self.x[0]) * (self.y[1] - self.y[0])
    }

    fn texels(self, width: usize) -> impl Iterator<Item = usize> {
        (self.y[0]..self.y[1]).flat_map(move |y| (self.x[0]..self.x[1]).map(move |x| y * width + x))
    }

    /// Cuts where both sides hold about half of the chances.
    fn split(self, width: usize, height: usize, chance: &[f64]) -> [Self; 2] {
        let middle = (self.y[0] + self.y[1]) as f64 / 2.0 / height as f64;
        let shrink = (std::f64::consts::PI * middle).sin().max(1e-3);
        let wide = (self.x[1] - self.x[0]) as f64 * 2.0 / width as f64 * shrink;
        let high = (self.y[1] - self.y[0]) as f64 / height as f64;
        let along_x = self.y[1] - self.y[0] == 1 || (self.x[1] - self.x[0] > 1 && wide >= high);
        let [from, to] = if along_x { self.x } else { self.y };
        let half = self.texels(width).map(|i| chance[i]).sum::<f64>() / 2.0;
        let line = |k: usize| {
            if along_x { Self { x: [k, k + 1], ..self } } else { Self { y: [k, k + 1], ..self } }
        };
        let mut sum = 0.0;
        let mut cut = from + 1;
        for k in from..to - 1 {
            let mass: f64 = line(k).texels(width).map(|i| chance[i]).sum();
            // Whichever side of this line lies nearer to the half.
            if k > from && sum + mass - half > half - sum {
                break;
            }
            sum += mass;
            cut = k + 1;
            if sum >= half {
                break;
            }
        }
        if along_x {
            [Self { x: [from, cut], ..self }, Self { x: [cut, to], ..self }]
        } else {
            [Self { y: [from, cut], ..self }, Self { y: [cut, to], ..self }]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Image, Radiance};
    use rand::{SeedableRng, rngs::SmallRng};

    fn sunny() -> Environment {
        Environment {
            map: Image::from_fn(64, 32, |x, y| {
                Radiance([if (x, y) == (20, 9) { 5e3 } else { 1.0 }, 1.0, 0.0])
            }),
        }
    }

    #[test]
    fn draws_estimate_the_irradiance() {
        let environment = sunny();
        let cells = Cells::new(&environment, 128);
        let normal = Vec3::new(0.2, 0.9, 0.1).normalize();
        let mut rng = SmallRng::seed_from_u64(7);
        let mut sum = [0.0f64; 2];
        for _ in 0..200 {
            for d in cells.draw(&mut rng) {
                let cos = f64::from(d.weight * d.direction.dot(normal).max(0.0));
                sum[0] += cos * f64::from(d.radiance[0]) / 200.0;
                sum[1] += cos / 200.0;
            }
        }
        let exact = f64::from(environment.irradiance(normal)[0]);
        assert!((sum[0] / exact - 1.0).abs() < 0.01, "{} {exact}", sum[0]);
        assert!((sum[1] / std::f64::consts::PI - 1.0).abs() < 0.01, "{}", sum[1]);
    }

    #[test]
    fn cells_are_a_partition_and_the_sun_has_its_own() {
        let cells = Cells::new(&sunny(), 128);
        let mut seen: Vec<u32> = cells.cells.iter().flat_map(|c| c.texels.iter().map(|t| t.0)).collect();
        seen.sort_unstable();
        assert_eq!(seen, (0..64 * 32).collect::<Vec<u32>>());
        assert!(cells.cells.iter().any(|c| c.texels.len() == 1 && c.texels[0].0 == 9 * 64 + 20));
        assert_eq!(cells.cells.len(), 128);
    }

    #[test]
    fn a_black_environment_is_cut_by_solid_angle() {
        let black = Environment { map: Image::from_fn(16, 8, |_, _| Radiance::default()) };
        assert_eq!(Cells::new(&black, 32).cells.len(), 32);
    }
}

//! A room as its faces stand around the camera, and the edges where they meet.

use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Axes of the room as the camera looks into it: to the right, up, away from the camera.
pub const RIGHT: usize = 0;
/// Upwards.
pub const UP: usize = 1;
/// Away from the camera.
pub const AWAY: usize = 2;

/// A face of the room as the camera looks into it; there is none behind the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Side {
    /// Below.
    Floor,
    /// To the left.
    Left,
    /// To the right.
    Right,
    /// Opposite.
    Back,
    /// Above.
    Ceiling,
}

/// All, as [`Layout::face`] numbers them.
pub const SIDES: [Side; 5] = [Side::Floor, Side::Left, Side::Right, Side::Back, Side::Ceiling];

impl Side {
    /// The axis across the face.
    pub fn normal(self) -> usize {
        match self {
            Self::Left | Self::Right => RIGHT,
            Self::Floor | Self::Ceiling => UP,
            Self::Back => AWAY,
        }
    }
}

/// Distances of the faces from the camera, m; infinite where there is none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layout {
    /// Height of the camera over the floor.
    pub floor: f64,
    /// To the left wall.
    pub left: f64,
    /// To the right wall.
    pub right: f64,
    /// To the wall opposite.
    pub back: f64,
    /// Up to the ceiling.
    pub ceiling: f64,
}

/// Where two faces meet.
#[derive(Debug, Clone, Copy)]
pub struct Edge {
    /// The faces.
    pub of: [Side; 2],
    /// Along which axis it runs.
    pub axis: usize,
    /// Its places on the other two axes, in their order, m.
    pub across: [f64; 2],
    /// From where to where it runs, m; possibly infinite.
    pub range: [f64; 2],
}

/// The other two axes, in their order.
pub fn others(axis: usize) -> [usize; 2] {
    match axis {
        RIGHT => [UP, AWAY],
        UP => [RIGHT, AWAY],
        _ => [RIGHT, UP],
    }
}

impl Edge {
    /// The half plane from the camera in which it lies, as an angle about its axis in 0 … 2π.
    pub fn angle(&self) -> f64 {
        self.across[1].atan2(self.across[0]).rem_euclid(TAU)
    }
}

impl Layout {
    /// A floor and nothing else.
    pub fn open(floor: f64) -> Self {
        let none = f64::INFINITY;
        Self { floor, left: none, right: none, back: none, ceiling: none }
    }

    /// Distance of a face, m.
    pub fn distance(&self, side: Side) -> f64 {
        match side {
            Side::Floor => self.floor,
            Side::Left => self.left,
            Side::Right => self.right,
            Side::Back => self.back,
            Side::Ceiling => self.ceiling,
        }
    }

    /// The same with a face at another distance, m.
    pub fn with(mut self, side: Side, distance: f64) -> Self {
        match side {
            Side::Floor => self.floor = distance,
            Side::Left => self.left = distance,
            Side::Right => self.right = distance,
            Side::Back => self.back = distance,
            Side::Ceiling => self.ceiling = distance,
        }
        self
    }

    /// Whether there is such a face.
    pub fn has(&self, side: Side) -> bool {
        self.distance(side).is_finite()
    }

    /// The walls that it has.
    pub fn walls(&self) -> impl Iterator<Item = Side> {
        let own = *self;
        [Side::Left, Side::Right, Side::Back].into_iter().filter(move |side| own.has(*side))
    }

    /// The face that a ray from the camera hits, and how far it goes there in lengths of the ray.
    pub fn face(&self, ray: &Vector3<f64>) -> Option<(Side, f64)> {
        let reach = |side: Side| {
            let towards = match side {
                Side::Floor => -ray[UP],
                Side::Ceiling => ray[UP],
                Side::Left => -ray[RIGHT],
                Side::Right => ray[RIGHT],
                Side::Back => ray[AWAY],
            };
            let far = self.distance(side) / towards;
            (towards > 0.0 && far.is_finite()).then_some((side, far))
        };
        SIDES.into_iter().filter_map(reach).min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Where its faces meet.
    pub fn edges(&self) -> Vec<Edge> {
        let (up, across) = ([-self.floor, self.ceiling], [-self.left, self.right]);
        let away = [f64::NEG_INFINITY, self.back];
        let mut edges = Vec::new();
        let mut add = |of: [Side; 2], axis, across: [f64; 2], range| {
            if of.iter().all(|side| self.has(*side)) {
                edges.push(Edge { of, axis, across, range });
            }
        };
        for (level, height) in [(Side::Floor, -self.floor), (Side::Ceiling, self.ceiling)] {
            add([level, Side::Left], AWAY, [-self.left, height], away);
            add([level, Side::Right], AWAY, [self.right, height], away);
            add([level, Side::Back], RIGHT, [height, self.back], across);
        }
        add([Side::Left, Side::Back], UP, [-self.left, self.back], up);
        add([Side::Right, Side::Back], UP, [self.right, self.back], up);
        edges
    }
}

//! Primitives in their place: parameters to frames. Contact, alignment and equality hold by construction.

use super::{Problem, parameters};
use crate::annotations::{Across, Kind, Primitive};
use nalgebra::{Isometry3, Matrix3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::{PI, TAU};

/// Sides of the prism that stands for a cylinder.
const SIDES: usize = 16;

/// A plane with axes: `u` to the right and `v` up as seen from the front, `u × v` towards the viewer.
#[derive(Debug, Clone, Copy)]
pub struct Plane {
    /// Origin, m.
    pub origin: Point3<f64>,
    /// To the right.
    pub u: Vector3<f64>,
    /// Up.
    pub v: Vector3<f64>,
}

impl Plane {
    /// The point at two coordinates, m.
    pub fn at(&self, u: f64, v: f64) -> Point3<f64> {
        self.origin + self.u * u + self.v * v
    }

    /// Towards its front.
    pub fn normal(&self) -> Vector3<f64> {
        self.u.cross(&self.v)
    }

    /// The same, `m` before it.
    pub fn before(&self, m: f64) -> Self {
        Self { origin: self.origin + self.normal() * m, ..*self }
    }
}

/// A room, box, wedge, cylinder, extrusion or ground.
#[derive(Debug, Clone)]
pub struct Solid {
    /// Its shape.
    pub kind: Kind,
    /// World from solid, m: the origin in the middle of its bottom (of an extrusion: where its corners count from), +Y up.
    pub frame: Isometry3<f64>,
    /// Height of what it stands on in the world, m.
    pub support: f64,
    /// Width, height, depth, m.
    pub size: [f64; 3],
    /// x and z of the corners of a cylinder's or an extrusion's section, m.
    pub outline: Vec<Point2<f64>>,
}

/// A primitive in its place.
#[derive(Debug, Clone)]
pub enum Placed {
    /// What has a volume, and the ground.
    Solid(Solid),
    /// Quad or polygon: the plane that it lies in.
    Flat(Plane),
}

impl Solid {
    /// Seen from inside.
    pub fn is_hollow(&self) -> bool {
        matches!(self.kind, Kind::Room | Kind::Ground)
    }

    /// A point of its own frame in the world, m.
    pub fn at(&self, x: f64, y: f64, z: f64) -> Point3<f64> {
        self.frame * Point3::new(x, y, z)
    }

    /// Turn about the vertical, rad; `None` where it stands aslant.
    fn yaw(&self) -> Option<f64> {
        let (x, y) = (self.frame * Vector3::x(), self.frame * Vector3::y());
        (y.y > 1.0 - 1e-9).then(|| (-x.z).atan2(x.x))
    }

    /// A face's plane, its origin in the middle. The front is the outside, of a room the inside.
    pub fn side(&self, name: &str) -> Option<Plane> {
        let [w, h, d] = self.size;
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        let middle = y * (h / 2.0);
        let round = !self.outline.is_empty();
        let (centre, u, v) = match name {
            "top" | "ceiling" if self.kind != Kind::Wedge => (y * h, x, -z),
            "bottom" | "floor" => (Vector3::zeros(), x, z),
            "back" if !round => (middle - z * (d / 2.0), -x, y),
            "slope" if self.kind == Kind::Wedge => (middle, x, (y * h - z * d).normalize()),
            "front" if !round && self.kind != Kind::Wedge => (middle + z * (d / 2.0), x, y),
            "left" if !round => (middle - x * (w / 2.0), z, y),
            "right" if !round => (middle + x * (w / 2.0), -z, y),
            _ => {
                let (a, b) = self.edge(name.parse().ok()?)?;
                let along = Vector3::new(b.x - a.x, 0.0, b.y - a.y).try_normalize(1e-9)?;
                let centre = Vector3::new((a.x + b.x) / 2.0, h / 2.0, (a.y + b.y) / 2.0);
                (centre, along, y)
            }
        };
        // From inside, left and right change places.
        let u = if self.is_hollow() { -u } else { u };
        Some(Plane { origin: self.frame * Point3::from(centre), u: self.frame * u, v: self.frame * v })
    }

    /// The `k`-th edge of the section, from left to right as seen from outside.
    pub fn edge(&self, k: usize) -> Option<(Point2<f64>, Point2<f64>)> {
        let n = self.outline.len();
        let (a, b) = (*self.outline.get(k)?, self.outline[(k + 1) % n]);
        // With z down the page an area above zero is clockwise from above: the outside is to the left of the edge.
        let clockwise = super::polygon::signed_area(&self.outline) > 0.0;
        Some(if clockwise { (b, a) } else { (a, b) })
    }

    /// Height in the world of the face on which a thing stands, or under which it hangs, m; none where it is aslant or has no such face.
    fn carrier(&self, attach: &str) -> Option<f64> {
        let bottom = self.frame.translation.y;
        self.yaw()?;
        match attach {
            "base" => Some(self.support),
            "ceiling" if self.is_hollow() => Some(bottom + self.size[1]),
            "bottom" if !self.is_hollow() => Some(bottom),
            "top" | "floor" if self.is_hollow() => Some(bottom),
            "top" if self.kind != Kind::Wedge => Some(bottom + self.size[1]),
            _ => None,
        }
    }

    /// Its mirror image in an upright plane through the middle of another solid.
    fn mirrored(&self, about: &Self, across: Across) -> Self {
        let axis = match across {
            Across::X => Vector3::x(),
            Across::Z => Vector3::z(),
        };
        let n = about.frame * axis;
        let reflection = Matrix3::identity() - n * n.transpose() * 2.0;
        let c = about.frame.translation.vector;
        let t = self.frame.translation.vector;
        let t = t - n * (2.0 * n.dot(&(t - c)));
        // A mirror image turns right into left; its own x does so back.
        let own = self.frame.rotation.to_rotation_matrix().into_inner();
        let turned = reflection * own * Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turned));
        let outline = self.outline.iter().map(|p| Point2::new(-p.x, p.y)).collect();
        Self { frame: Isometry3::from_parts(Translation3::from(t), rotation), outline, ..self.clone() }
    }
}

/// What a primitive's place depends on.
#[derive(Debug, Clone, Copy)]
pub struct Around<'a> {
    /// What carries it.
    pub parent: Option<&'a Placed>,
    /// What it is parallel to.
    pub parallel_to: Option<&'a Placed>,
    /// Whose mirror image it is, and about what.
    pub mirror: Option<(&'a Placed, &'a Placed)>,
    /// Height of the surface that primitives without a parent stand on, in the world, m.
    pub ground_y: f64,
}

fn vertical(yaw: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw)
}

/// Puts a primitive in its place.
pub fn place(primitive: &Primitive, values: &[f64], around: &Around) -> Result<Placed, Problem> {
    let refuse = || Problem::Attach { name: primitive.name.clone(), attach: primitive.attach.clone() };
    if let (Some((of, about)), Some(mirror)) = (around.mirror, &primitive.mirror) {
        let (Placed::Solid(of), Placed::Solid(about)) = (of, about) else { return Err(refuse()) };
        return Ok(Placed::Solid(of.mirrored(about, mirror.across)));
    }
    let parent = match around.parent {
        None => None,
        Some(Placed::Flat(_)) => return Err(refuse()),
        Some(Placed::Solid(solid)) => Some(solid),
    };
    if let Some(face) = &primitive.leans_on {
        let refuse = || Problem::Attach { name: primitive.name.clone(), attach: face.clone() };
        let parent = parent.ok_or_else(refuse)?;
        let wall = parent.side(face).filter(|wall| wall.v.y > 1.0 - 1e-9).ok_or_else(refuse)?;
        let support = parent.carrier(&primitive.attach).ok_or_else(refuse)?;
        return leaning(primitive, values, &wall, support).ok_or_else(refuse);
    }
    let (mut origin, mut yaw) = (Point3::new(0.0, around.ground_y + primitive.level_m, 0.0), 0.0);
    if let Some(parent) = parent {
        let middle = parent.frame.translation.vector;
        if parameters::is_upright(primitive) {
            let height = parent.carrier(&primitive.attach).ok_or_else(refuse)?;
            origin = Point3::new(middle.x, height, middle.z);
            yaw = parent.yaw().ok_or_else(refuse)?;
        }
    } else if parameters::hangs(primitive) {
        return Err(refuse());
    }
    if let Some(Placed::Solid(other)) = around.parallel_to {
        yaw = other.yaw().ok_or_else(refuse)?;
    }
    yaw += primitive.turn_deg.to_radians();
    let standing = |x: f64, lift: f64, z: f64, turn: f64, height: f64| {
        // A thing turned by itself is still placed along its parent's axes.
        let lift = if parameters::hangs(primitive) { -lift - height } else { lift };
        let shift = vertical(parent.and_then(Solid::yaw).unwrap_or(0.0)) * Vector3::new(x, lift, z);
        Isometry3::from_parts(Translation3::from((origin + shift).coords), vertical(yaw + turn))
    };
    let solid = |frame, size, outline| {
        Ok(Placed::Solid(Solid { kind: primitive.kind, frame, support: origin.y, size, outline }))
    };
    match primitive.kind {
        Kind::Ground => {
            let side = 2.0 * primitive.extent_m;
            solid(standing(0.0, 0.0, 0.0, 0.0, 0.0), [side, 0.0, side], vec![])
        }
        Kind::Room | Kind::Box | Kind::Wedge => {
            let [x, z, lift, turn, size @ ..] = values else { return Err(refuse()) };
            let size = [size[0], size[1], size[2]];
            if parameters::is_upright(primitive) {
                return solid(standing(*x, *lift, *z, *turn, size[1]), size, vec![]);
            }
            let parent = parent.ok_or_else(refuse)?;
            let wall =
                parent.side(&primitive.attach).filter(|wall| wall.v.y > 1.0 - 1e-9).ok_or_else(refuse)?;
            let foot = wall.at(*x, *lift - parent.size[1] / 2.0) + wall.normal() * (size[2] / 2.0);
            let support = parent.frame.translation.y;
            let frame =
                Isometry3::from_parts(Translation3::from(foot.coords), axes(wall.u, wall.v, wall.normal()));
            Ok(Placed::Solid(Solid { kind: primitive.kind, frame, support, size, outline: vec![] }))
        }
        Kind::Cylinder => {
            let [x, z, lift, diameter, height] = values[..] else { return Err(refuse()) };
            // Of the same section as the circle.
            let sector = TAU / SIDES as f64;
            let radius = diameter / 2.0 * (sector / sector.sin()).sqrt();
            let corner = |k: usize| {
                let (sin, cos) = (sector * k as f64).sin_cos();
                Point2::new(radius * cos, radius * sin)
            };
            let frame = standing(x, lift, z, 0.0, height);
            solid(frame, [diameter, height, diameter], (0..SIDES).map(corner).collect())
        }
        Kind::Extrusion => {
            let [lift, height, corners @ ..] = values else { return Err(refuse()) };
            let outline: Vec<_> = corners.chunks_exact(2).map(|p| Point2::new(p[0], p[1])).collect();
            let extent = |axis: usize| {
                let all = outline.iter().map(|p| p[axis].abs());
                2.0 * all.fold(0.0, f64::max)
            };
            let size = [extent(0), *height, extent(1)];
            solid(standing(0.0, *lift, 0.0, 0.0, *height), size, outline)
        }
        Kind::Quad | Kind::Polygon => {
            let turn = vertical(yaw);
            let mut plane = Plane { origin, u: turn * Vector3::x(), v: turn * -Vector3::z() };
            if parameters::hangs(primitive) || !parameters::is_upright(primitive) {
                plane = parent.and_then(|p| p.side(&primitive.attach)).ok_or_else(refuse)?;
            }
            if let (Kind::Quad, [u, v, turn, ..]) = (primitive.kind, values) {
                let (sin, cos) = turn.sin_cos();
                plane = Plane {
                    origin: plane.at(*u, *v),
                    u: plane.u * cos + plane.v * sin,
                    v: plane.v * cos - plane.u * sin,
                };
            }
            Ok(Placed::Flat(plane))
        }
    }
}

fn axes(x: Vector3<f64>, y: Vector3<f64>, z: Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&[x, y, z]))
}

/// With its foot on the support and its upper edge on the wall: both touch whatever the lean (0 flat on the wall … 90° lying).
fn leaning(primitive: &Primitive, values: &[f64], wall: &Plane, support: f64) -> Option<Placed> {
    let (along, lean) = (*values.first()?, *values.get(1)?);
    let lean = lean.clamp(0.0, PI / 2.0);
    let size = &values[parameters::extents(primitive.kind)];
    let (normal, up) = (wall.normal(), Vector3::y());
    let v = up * lean.cos() - normal * lean.sin();
    let at = wall.origin + wall.u * along + normal * (size[1] * lean.sin());
    let foot = Point3::new(at.x, support, at.z);
    let front = wall.u.cross(&v);
    match primitive.kind {
        Kind::Quad => Some(Placed::Flat(Plane { origin: foot + v * (size[1] / 2.0), u: wall.u, v })),
        Kind::Box => {
            let base = foot + front * (size[2] / 2.0);
            let frame = Isometry3::from_parts(Translation3::from(base.coords), axes(wall.u, v, front));
            let size = [size[0], size[1], size[2]];
            Some(Placed::Solid(Solid { kind: Kind::Box, frame, support, size, outline: vec![] }))
        }
        _ => None,
    }
}

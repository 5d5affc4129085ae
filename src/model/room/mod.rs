//! A room found in the plate, in the place of marks.
//!
//! Known are lens, the vertical and the camera's height over the floor, so that line segments tell how the room is turned
//! (`view`), and every line of the picture along one of its axes is the foot of a wall at one distance, a corner between walls at one
//! bearing, or the upper edge of a wall at one height. What speaks for such a line is a step of colour that lies on it and stays the
//! same along it (`evidence`). A room is judged by its edges (as Hedau, Hoiem and Forsyth 2009 do), by segments that run out of its faces (Lee,
//! Hebert and Kanade 2009), and by how much the colour of a pixel tells of its face (`contents`); the best of some thousand is taken, or none
//! (`search`). Its edges become marks, which the fit treats as a person's (`marks`), and faces that nothing in the picture tells of are presumed.

mod contents;
mod evidence;
mod layout;
mod marks;
mod search;
#[cfg(test)]
mod tests;
mod view;

pub use marks::{Found, Presumed, find};
pub use search::{LEAST_COLOUR, LEAST_CORNER, LEAST_FOOT};

use crate::annotations::{Kind, Primitive};
use crate::calibrate;
use crate::camera::Camera;
use crate::config;
use crate::error::Result as Outcome;
use crate::exposure::Photograph;

/// Whether it is a room that may be searched.
pub fn can_be_searched(primitive: &Primitive) -> bool {
    primitive.kind == Kind::Room && primitive.parent.is_none()
}

/// Primitives with marks on what was found, and the rooms; or why there is none.
pub type Searched = std::result::Result<(Vec<Primitive>, Vec<Found>), super::Problem>;

/// The primitives, those that are to be searched with marks on the edges that the plate shows, and what was found. `plate`: name,
/// camera, and how to read it.
pub fn searched(
    primitives: &[Primitive],
    (image, camera): (&str, &Camera),
    plate: impl Fn() -> Outcome<Photograph>,
    ground_y: f64,
    settings: &config::Model,
) -> Outcome<Searched> {
    let mut all = primitives.to_vec();
    let mut rooms = Vec::new();
    for primitive in all.iter_mut().filter(|p| p.search && can_be_searched(p)) {
        match find(primitive, image, &plate()?, camera, ground_y, settings) {
            Ok(found) => {
                primitive.marks.extend(found.marks.iter().cloned());
                rooms.push(found);
            }
            Err(problem) => {
                let (name, image) = (primitive.name.clone(), image.to_string());
                return Ok(Err(super::Problem::Room { name, image, problem }));
            }
        }
    }
    Ok(Ok((all, rooms)))
}

/// A room that the picture supports too little.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weak {
    /// Its walls.
    pub walls: usize,
    /// Share of the foot of a wall, or of its upper edge, that shows in the picture: the least.
    pub foot: f64,
    /// The same of corners between walls.
    pub corner: f64,
    /// What a pixel's colour tells of the face it lies on, nats.
    pub colour: f64,
}

impl std::fmt::Display for Weak {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.walls < 2 {
            return write!(f, "no two walls that meet are seen");
        }
        write!(
            f,
            "the best one shows on {:.0} % of an edge where a wall ends and {:.0} % of a corner between walls, and a pixel's colour \
             tells {:.2} nats of its face; at least {:.0} %, {:.0} % and {:.1} nats are needed",
            100.0 * self.foot,
            100.0 * self.corner,
            self.colour,
            100.0 * LEAST_FOOT,
            100.0 * LEAST_CORNER,
            LEAST_COLOUR
        )
    }
}

/// Why no room is found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// Its directions are not seen, or the picture cannot be searched.
    #[error(transparent)]
    Directions(#[from] calibrate::Problem),
    /// The camera is not over the floor.
    #[error("the camera is {0:.2} m over the room's floor")]
    Below(f64),
    /// Too little speaks for the best one.
    #[error("the plate shows no room: {0}")]
    NoRoom(Weak),
}

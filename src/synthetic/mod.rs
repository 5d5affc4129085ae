//! Scenes made by rule, for tests and benchmarks: what they measure depends on no photograph.

mod lobby;
mod shapes;
pub mod table;
mod tracer;

pub use lobby::{Lobby, lobby, lobby_of};
pub use shapes::{blob, camera, cuboid, face};
pub use tracer::{Ball, Finish, Quad, Tracer};

//! Scenes made by rule, for tests and benchmarks: what they measure depends on no photograph.

mod lobby;
mod shapes;

pub use lobby::{Lobby, lobby, lobby_of};
pub use shapes::{blob, camera, cuboid, face};

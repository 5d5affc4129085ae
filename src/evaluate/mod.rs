//! Judging the result: errors on linear radiance and on display images, each stage against truth, the report.

mod camera;
pub mod compare;
pub mod display;
pub mod errors;
pub mod figures;
pub mod gallery;
mod html;
mod pictures;
pub mod radiometry;
pub mod references;
pub mod region;
mod stage;
pub mod true_light;
pub mod true_scene;
pub mod truth;

pub use compare::{Comparison, Ours, Reference, compare};
pub use figures::{DEFINITIONS, Figure, Measured, Report, check_bounds};
pub use html::{Page, page};
pub use pictures::{ErrorMap, error_map, range, removal_map};
pub use stage::judge;
pub use truth::Truth;

//! Every bad input gets an exact message, an exit status and leaves earlier results as they were.

#[path = "../common/mod.rs"]
mod common;

mod artefacts;
mod calibrate;
mod cases;
mod driver;
mod evaluate;
mod model;
mod photographs;
mod probe;
mod render;
mod results;
mod settings;
mod spoil;

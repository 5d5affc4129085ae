//! The scene model.

pub mod face;

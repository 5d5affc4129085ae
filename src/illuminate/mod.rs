//! Light on the model.

pub mod mesh;
pub mod patch;

//! Light on the model.

pub mod patch;

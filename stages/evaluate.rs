//! Stage `evaluate`.

fn main() {}

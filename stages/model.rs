//! Stage `model`.

fn main() {}

//! Stage `probe`.

fn main() {}

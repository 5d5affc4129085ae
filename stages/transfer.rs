//! Stage `transfer`.

fn main() {}

//! Stage `merge`.

fn main() {}

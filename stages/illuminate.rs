//! Stage `illuminate`.

fn main() {}

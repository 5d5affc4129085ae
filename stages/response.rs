//! Stage `response`.

fn main() {}

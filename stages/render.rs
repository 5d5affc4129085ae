//! Stage `render`.

fn main() {}

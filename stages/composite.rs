//! Stage `composite`.

fn main() {}

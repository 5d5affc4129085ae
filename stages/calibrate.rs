//! Stage `calibrate`.

fn main() {}

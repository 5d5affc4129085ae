//! Stage `irradiance`.

fn main() {}

//! Stage `ingest`.

fn main() {}

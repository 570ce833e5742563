//! The `fluvia` binary.
fn main() {}

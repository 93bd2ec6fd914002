//! The thin client's program.

fn main() {}

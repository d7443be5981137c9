//! Adaptive dual contouring; see `docs/dual.md`.

// Only tests use it until the steps before it are there.
#[allow(dead_code)]
mod flips;

//! Adaptive dual contouring (Li et al. 2022; Ju et al. 2002): see `docs/dual.md`.

mod build;
mod forest;
mod grading;
mod knots;
mod leaves;
mod octree;
mod placement;
mod polygons;
mod qef;
mod roots;
mod topology;
mod vertices;

pub use build::Builder;
pub use octree::{Bound, Collapses, Placement};

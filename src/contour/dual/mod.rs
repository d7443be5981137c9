//! Adaptive dual contouring (Li et al. 2022; Ju et al. 2002; Schaefer, Ju and Warren 2007) for any number of
//! materials: method, guarantees and departures in `docs/dual.md`.
//!
//! [`Builder`] takes the volume's layers one after the other; [`Builder::finish`] makes the surface.

mod build;
mod census;
mod changes;
mod choices;
mod complex;
mod deviation;
mod flips;
mod forest;
mod grading;
mod knots;
mod leaves;
mod merge;
mod octree;
mod placement;
mod plain;
mod polygons;
mod qef;
mod relax;
mod remedy;
mod roots;
mod sigmas;
mod strays;
mod surface;
mod topology;
mod vertices;

pub use build::Builder;
pub use census::{NodeCounts, PairPolygons};
pub use deviation::Deviation;
pub use octree::{Bound, Collapses};
pub use qef::Placement;
pub use remedy::Remedy;
pub use surface::{DualOptions, DualSurface, STAGES, Statistics};

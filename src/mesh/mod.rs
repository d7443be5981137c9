//! The labelled surface mesh, its checks, parts and measures.

pub mod check;
mod edge_table;
#[cfg(test)]
pub(crate) mod fixtures;
mod from_patch;
mod interface_mesh;
mod junctions;
mod kinds;
mod measure;
mod piece;
mod quality;
mod report;
mod split;
mod vertex_table;

pub use check::{CheckOptions, Defects, check};
pub use interface_mesh::{InterfaceMesh, MeshError, MeshMaterial};
pub use junctions::{Boundaries, JunctionCurve, Junctions, junctions};
pub use kinds::kinds_from_labels;
pub use measure::{Measures, PairMeasure, PieceMeasure, ShellMeasure, measure};
pub use piece::MeshPiece;
pub use quality::{BINS, GOOD, Quality, quality, triangle_quality};
pub use report::MeshReport;
pub use split::{Shell, split};

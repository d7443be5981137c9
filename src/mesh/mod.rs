//! The labelled surface mesh, its checks, parts and measures.

pub mod check;
mod components;
mod curve_edges;
mod curve_vertices;
#[cfg(test)]
mod cut;
#[cfg(test)]
mod cut_tests;
#[cfg(test)]
pub(crate) mod fixtures;
mod from_patch;
mod in_chunks;
mod interface_mesh;
mod junctions;
mod kinds;
mod measure;
mod merge;
mod piece;
mod quality;
mod report;
mod sigmas;
mod split;
mod split_pieces;
mod tables;
mod window;

pub use check::{CheckOptions, Defects, check};
pub use curve_vertices::CurveVertices;
pub use interface_mesh::{InterfaceMesh, MeshError, MeshMaterial};
pub use junctions::{Boundaries, JunctionCurve, Junctions, junctions};
pub use kinds::kinds_from_labels;
pub use measure::{Measures, PairMeasure, PieceMeasure, ShellMeasure, measure};
pub use merge::MeshMerger;
pub use piece::MeshPiece;
pub use quality::{BINS, GOOD, Quality, quality};
pub use report::{MeshReport, MeshReportBuilder};
pub use sigmas::SigmaMeasure;
pub use split::{Shell, split};
pub use split_pieces::{ShellPiece, ShellSplitter};

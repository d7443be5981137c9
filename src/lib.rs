//! interfacet turns an industrial CT volume of an assembly made of several materials into one
//! labelled, non-manifold surface mesh.

pub mod classify;
pub mod cli;
pub mod contour;
pub mod execution;
pub mod export;
pub mod grid;
pub mod material;
pub mod mesh;
pub mod phantom;
pub mod pipeline;
pub mod report;
pub mod volume;

//! The labelled surface mesh, its checks, parts and measures.

pub mod check;
mod edge_table;
#[cfg(test)]
pub(crate) mod fixtures;
mod from_patch;
mod interface_mesh;
mod vertex_table;

pub use interface_mesh::{InterfaceMesh, MeshError, MeshMaterial};

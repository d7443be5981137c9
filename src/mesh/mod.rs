//! The labelled surface mesh, its checks, parts and measures.

mod interface_mesh;

pub use interface_mesh::{InterfaceMesh, MeshError, MeshMaterial};

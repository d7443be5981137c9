//! Where things are: lattice boxes, geometry in millimetres, material ids and pairs, vertex kinds,
//! and the one numbering of a cube's corners, edges and faces.

pub mod cube;
mod geometry;
mod label;
mod vertex_kind;
mod voxel_box;
mod written;

pub use geometry::{Geometry, GeometryError};
pub use label::{MaterialId, Pair};
pub use vertex_kind::VertexKind;
pub use voxel_box::VoxelBox;
pub use written::Written;

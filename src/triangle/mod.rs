//! Triangles in space, whatever mesh they belong to: their shape, tables of their edges and vertices, exact
//! tests of how two of them lie, and the search for all pairs that meet where they must not.
//!
//! A layer of its own because contouring mends its mesh with what the check of a mesh judges it by: the
//! same predicates, the same rule, the same search.

mod apart;
mod around_edge;
mod edge_table;
mod filed;
mod meetings;
mod moving;
mod nearby;
mod shape;
mod size_trees;
mod stars;
mod triangle_pair;
mod vertex_table;

pub(crate) use around_edge::in_turn;
pub(crate) use edge_table::{EdgeTable, EdgeUse};
pub(crate) use meetings::{Search, is_without_area, without_area};
pub(crate) use moving::MovingTriangles;
pub use shape::{smallest_angle, triangle_quality};
pub(crate) use vertex_table::VertexTable;

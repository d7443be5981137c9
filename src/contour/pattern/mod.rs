//! Corner patterns: what the surface looks like inside a cell, for every way in which its eight
//! corners can share materials. Derived by rule (`docs/contouring.md`), never typed in.

mod curve_graph;
mod face;
mod leaves;
mod packed;
mod partition;
mod surface;
mod table;

pub use curve_graph::{DirectedCurve, Disc, FACE_NODE, Node, Sheet, sheets};
pub use face::{FaceCurves, curves, is_ambiguous, outward_ring, ring_edges};
pub use leaves::{CellLeaf, CellLeaves, FaceKnot, Tie};
pub use packed::{CELL_VERTICES, Packed, PackedEntry};
pub(crate) use partition::classes_of;
pub use partition::{Classes, PARTITIONS, Partitions};
pub use surface::{Apex, CellSurface, CellTriangle};
pub use table::{ENTRIES, PatternTable};

//! Interfaces: from labelled voxels to labelled triangles.
//!
//! [`pattern`] says what the surface inside a cell looks like for every way in which its corners
//! can share materials; [`CrossingRule`] says where on a cell edge an interface lies;
//! [`marching`] walks the cells, all at once or piece by piece; [`merge`] puts [`Piece`]s together. See `docs/contouring.md`.

mod crossing;
pub mod dual;
mod error;
pub mod hermite;
mod isosurface;
pub mod marching;
mod moves;
mod patch;
pub mod pattern;
mod piece;
mod settle;

pub use crossing::{CROSSING_MARGIN, CrossingRule, Level, Midpoints, Node, Thresholds};
pub use error::ContourError;
pub use hermite::{Hermite, HermiteRule, NormalRule};
pub use isosurface::isosurface;
pub use marching::{Surroundings, surroundings};
pub use moves::{Move, Moves, Wish, Wishes};
pub use patch::{Border, Patch};
pub(crate) use patch::{append_sigmas, same_sigmas};
pub use piece::{Piece, SeamKey, layers_of, merge};
pub use settle::settle;

//! Files in and out: one file per format, every write staged aside and put in place by a rename.

mod block_reader;
mod block_writer;
mod error;
mod junctions;
pub mod metaimage;
mod ply_decode;
mod ply_encode;
mod ply_layout;
mod ply_pieces;
mod ply_read;
mod ply_stream;
mod read;
mod staging;
mod stl;
mod stl_merged;
mod stl_read;

pub use error::ExportError;
pub use junctions::{write_curves, write_junctions};
pub use ply_layout::{Coordinates, PlyEncoding, PlyOptions};
pub use ply_pieces::PlyPieces;
pub use ply_stream::{PlyStream, ShellPlyStream, write_ply};
pub use read::{ReadOptions, read_mesh};
pub use staging::{Abandoned, RESULT_MARK, StagedFolder, abandon_unfinished, write_atomically};
pub use stl::{StlStream, write_stl};
pub use stl_merged::{MergedByStl, vertices_merged_by_stl};

#[cfg(test)]
pub(crate) use ply_stream::tests::pieces;

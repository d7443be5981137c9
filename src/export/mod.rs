//! Files in and out: one file per format, every write staged aside and put in place by a rename.

mod error;
mod junctions;
pub mod metaimage;
mod ply;
mod ply_read;
mod read;
mod staging;
mod stl;
mod stl_read;

pub use error::ExportError;
pub use junctions::write_junctions;
pub use ply::{PlyEncoding, PlyOptions, write_ply};
pub use read::{ReadOptions, read_mesh};
pub use staging::{Abandoned, RESULT_MARK, StagedFolder, abandon_unfinished, write_atomically};
pub use stl::{vertices_merged_by_stl, write_stl};

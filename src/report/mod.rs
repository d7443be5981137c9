//! What happened: [`RunReport`] for programs (`report.json`), and, for people, pictures of a mesh and of a volume's slices, drawn without a GPU or
//! a display.
//!
//! [`render()`] draws a mesh with its own z-buffer, [`render_ply`] one in a file without holding it; [`slice_picture`] draws a slice of grey values with the
//! mesh's outline over it. Both give a [`Picture`], which saves itself as PNG. The same input gives the same
//! bytes whatever the number of threads.

mod camera;
mod colour;
mod draw;
mod edges;
mod font;
mod legend;
mod outline;
mod picture;
mod piece_edges;
mod raster;
mod render;
mod result_folder;
mod run_report;
mod shade;
mod sheet;
mod shells;
mod slice;
mod view;

pub use colour::{Palette, Rgb};
pub use picture::{Background, Picture, PictureError};
pub use render::{Cut, RenderOptions, render, render_pieces, render_ply};
pub use result_folder::{ResultError, ResultWriter};
pub use run_report::{
    CurveReport, InputReport, MaterialReport, NonManifoldReport, PairReport, RunReport, ThresholdReport,
};
pub use sheet::sheet;
pub use slice::{SliceOptions, slice_picture};

//! TIFF: a file of many pages, an ImageJ stack, or a folder of numbered slices.
//!
//! - `directory`: one image file directory, checked against the file before anything is allocated;
//! - `page`: what a page is (size, number type, where its rows are), and reading a part of it;
//! - `stack`: a multi-page file as a volume;
//! - `series`: a folder of slices as a volume.
//!
//! Pages are 8- or 16-bit unsigned, 16-bit signed or 32-bit floating-point grey images of one
//! channel, of classic TIFF or BigTIFF, in strips or tiles, uncompressed or compressed by LZW,
//! deflate or PackBits. Everything else (colour, palettes, white as zero, other depths, turned
//! images) is refused by name. TIFF has no third axis and its resolution is often a printer's: the
//! spacing is 1 mm until the caller gives it ([`super::OpenOptions::spacing`]).

mod directory;
mod page;
mod series;
mod stack;

use std::ops::Range;

use rayon::prelude::*;

pub(crate) use series::open_folder;
pub(crate) use stack::open_file;

use self::page::Page;
use super::collect::{Collector, Endian};
use super::{Samples, VolumeError};
use crate::execution::Execution;
use crate::grid::VoxelBox;

/// Whether a file with these first bytes is a TIFF.
pub(crate) fn is_tiff(start: &[u8]) -> bool {
    [&b"II*\0"[..], b"MM\0*", b"II+\0", b"MM\0+"].iter().any(|magic| start.starts_with(magic))
}

/// Appends a box of slices to `out`: `rows(z)` gives the bytes of the box's part of slice z.
fn read_slices(
    part: &VoxelBox,
    first: &Page,
    out: &mut Samples,
    execution: &Execution,
    rows: impl Fn(usize, Range<usize>, Range<usize>) -> Result<(Vec<u8>, Endian), VolumeError> + Sync,
) -> Result<(), VolumeError> {
    let (columns, lines) = (part.low[0]..part.high[0], part.low[1]..part.high[1]);
    let mut out = Collector::new(first.sample, part, out)?;
    // Slices are decoded in parallel, a few at a time, so that little waits to be collected.
    let batch = 2 * rayon::current_num_threads();
    let mut z = part.low[2];
    while z < part.high[2] {
        execution.check()?;
        let end = (z + batch).min(part.high[2]);
        let slices: Result<Vec<_>, VolumeError> =
            (z..end).into_par_iter().map(|z| rows(z, columns.clone(), lines.clone())).collect();
        for (bytes, endian) in slices? {
            out.push(&bytes, endian)?;
        }
        z = end;
    }
    out.finish()
}

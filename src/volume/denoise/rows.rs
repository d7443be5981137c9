//! The walk that filters share: rows of the slices to be made, by all threads.

use rayon::prelude::*;

use crate::execution::{Cancelled, Execution};

/// Calls `filter` with room of its own for the thread, y, z and the row to be written, for each row of the
/// slices from `first` on, which are `out`; `size` is that of the volume.
pub(super) fn each_row<R>(
    size: [usize; 3],
    first: usize,
    out: &mut [f32],
    execution: &Execution,
    room: impl Fn() -> R + Send + Sync,
    filter: impl Fn(&mut R, [usize; 2], &mut [f32]) + Send + Sync,
) -> Result<(), Cancelled> {
    let [width, height, _] = size;
    out.par_chunks_mut(width).enumerate().try_for_each_init(room, |room, (i, out)| {
        execution.check()?;
        filter(room, [i % height, first + i / height], out);
        Ok(())
    })
}

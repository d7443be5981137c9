//! Sums over all triangles of a mesh that do not depend on threads or on how the mesh was cut.
//!
//! Floating-point sums depend on their order. So a mesh's triangles are summed in chunks of [`CHUNK`], counted
//! from its first triangle; a chunk is summed in order by one task, and chunks are added in order. A chunk
//! that begins in one window and ends in the next is simply gone on with.

use rayon::prelude::*;

use super::window::Window;

/// Triangles in a chunk; few in tests, so that small meshes have many chunks.
const CHUNK: u64 = if cfg!(test) { 1 << 5 } else { 1 << 14 };

/// Something that is summed up over triangles.
pub(crate) trait Sum: Default + Send + Sync {
    /// What it needs to know beforehand.
    type Given: Sync;

    /// Adds the window's triangle `t`.
    fn take(&mut self, window: &Window<'_>, t: usize, given: &Self::Given);

    /// Adds the sum over later triangles.
    fn join(&mut self, later: Self);
}

/// The sum over the windows so far.
#[derive(Default)]
pub(crate) struct InChunks<S> {
    whole: S,
    /// The chunk that is not complete yet.
    open: S,
}

impl<S: Sum> InChunks<S> {
    /// Adds the triangles that the window owns.
    pub(crate) fn add(&mut self, window: &Window<'_>, given: &S::Given) {
        let own = window.own_triangles();
        if own.is_empty() {
            return;
        }
        let first = window.first_own_triangle();
        let end = first + own.len() as u64;
        let take = |mut sum: S, chunk: u64| {
            let range = (chunk * CHUNK).max(first)..((chunk + 1) * CHUNK).min(end);
            for t in range {
                sum.take(window, own.start + (t - first) as usize, given);
            }
            sum
        };
        let begun = take(std::mem::take(&mut self.open), first / CHUNK);
        let later: Vec<S> =
            (first / CHUNK + 1..end.div_ceil(CHUNK)).into_par_iter().map(|c| take(S::default(), c)).collect();
        self.open = begun;
        for next in later {
            self.whole.join(std::mem::replace(&mut self.open, next));
        }
        if end.is_multiple_of(CHUNK) {
            self.whole.join(std::mem::take(&mut self.open));
        }
    }

    /// The sum over all triangles.
    pub(crate) fn finish(mut self) -> S {
        self.whole.join(self.open);
        self.whole
    }
}

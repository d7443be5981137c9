//! How a run is carried out, apart from what it computes: progress, cancellation, memory.
//!
//! Nothing here changes a result. Threads are those of the current rayon pool: a caller that wants
//! a certain number of them runs the pipeline inside `ThreadPool::install`; the library never
//! builds or configures a global pool.

mod cost;
mod memory;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use thiserror::Error;

pub use cost::{CostLog, StageCost, peak_memory};
pub use memory::available_memory;

/// Receives the progress of a run. Calls may come from any thread.
pub trait Progress: Send + Sync {
    /// What is to come: each stage in order, with its share of the run's time as far as it can be
    /// guessed. A stage may be missing or repeated in the end. An empty plan: the run is over.
    fn plan(&self, _stages: &[(&str, f64)]) {}
    /// A stage starts that will take `steps` steps (0: unknown). Stages may lie inside one another; `id` tells
    /// them apart.
    fn begin(&self, id: u64, stage: &str, steps: u64);
    /// `steps` more steps of a stage are done.
    fn advance(&self, id: u64, steps: u64);
    /// A stage is over.
    fn end(&self, id: u64);
}

/// A progress sink that drops everything.
#[derive(Debug, Default, Clone, Copy)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _id: u64, _stage: &str, _steps: u64) {}
    fn advance(&self, _id: u64, _steps: u64) {}
    fn end(&self, _id: u64) {}
}

/// A run was asked to stop before it was done.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
#[error("interrupted before it was done; nothing unfinished was left behind")]
pub struct Cancelled;

/// Execution options: a progress sink, a cancellation flag, a memory budget; passed into every long
/// stage.
#[derive(Clone)]
pub struct Execution {
    progress: Arc<dyn Progress>,
    cancel: Arc<AtomicBool>,
    memory: Option<u64>,
    slab: Option<usize>,
}

impl Default for Execution {
    fn default() -> Self {
        Self::new(Arc::new(Silent))
    }
}

impl Execution {
    /// An execution that reports to `progress`.
    #[must_use]
    pub fn new(progress: Arc<dyn Progress>) -> Self {
        Self { progress, cancel: Arc::new(AtomicBool::new(false)), memory: None, slab: None }
    }

    /// The same execution with a budget of memory, in bytes. Without one, a run takes what it needs to be
    /// fast: the whole volume at once.
    #[must_use]
    pub fn with_memory(mut self, bytes: u64) -> Self {
        self.memory = Some(bytes);
        self
    }

    /// The memory that the run may take, in bytes; `None`: any.
    #[must_use]
    pub fn memory(&self) -> Option<u64> {
        self.memory
    }

    /// The same execution with slabs of at most `slices` slices, however much memory there is.
    #[must_use]
    pub fn with_slab(mut self, slices: usize) -> Self {
        self.slab = Some(slices.max(1));
        self
    }

    /// The most slices that a slab may have; `None`: any.
    #[must_use]
    pub fn slab(&self) -> Option<usize> {
        self.slab
    }

    /// Announces what is to come; see [`Progress::plan`].
    pub fn plan(&self, stages: &[(&str, f64)]) {
        self.progress.plan(stages);
    }

    /// The flag to set (from a signal handler, say) to stop the run.
    #[must_use]
    pub fn cancel_flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.cancel)
    }

    /// Whether the run was asked to stop.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// Stages call this between units of work of at most a fraction of a second.
    ///
    /// # Errors
    /// [`Cancelled`] once the flag is set.
    pub fn check(&self) -> Result<(), Cancelled> {
        if self.is_cancelled() { Err(Cancelled) } else { Ok(()) }
    }

    /// Begins a stage of `steps` steps; it ends when the returned guard is dropped.
    #[must_use]
    pub fn stage(&self, name: &str, steps: u64) -> Stage<'_> {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let id = NEXT.fetch_add(1, Ordering::Relaxed);
        self.progress.begin(id, name, steps);
        Stage { progress: self.progress.as_ref(), id }
    }
}

/// A stage under way; see [`Execution::stage`].
pub struct Stage<'a> {
    progress: &'a dyn Progress,
    id: u64,
}

impl Stage<'_> {
    /// Marks `steps` more steps as done.
    pub fn advance(&self, steps: u64) {
        self.progress.advance(self.id, steps);
    }
}

impl Drop for Stage<'_> {
    fn drop(&mut self) {
        self.progress.end(self.id);
    }
}

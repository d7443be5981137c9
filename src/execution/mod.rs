//! How a run is carried out, apart from what it computes: progress and cancellation.
//!
//! Nothing here changes a result. Threads are those of the current rayon pool: a caller that wants
//! a certain number of them runs the pipeline inside `ThreadPool::install`; the library never
//! builds or configures a global pool.

mod cost;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use thiserror::Error;

pub use cost::{CostLog, StageCost, peak_memory};

/// Receives the progress of a run. Calls may come from any thread.
pub trait Progress: Send + Sync {
    /// A stage starts that will take `steps` steps (0: unknown).
    fn begin(&self, stage: &str, steps: u64);
    /// `steps` more steps of the current stage are done.
    fn advance(&self, steps: u64);
    /// The current stage is over.
    fn end(&self);
}

/// A progress sink that drops everything.
#[derive(Debug, Default, Clone, Copy)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _stage: &str, _steps: u64) {}
    fn advance(&self, _steps: u64) {}
    fn end(&self) {}
}

/// A run was asked to stop before it was done.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
#[error("interrupted before it was done; nothing unfinished was left behind")]
pub struct Cancelled;

/// Execution options: a progress sink and a cancellation flag, passed into every long stage.
#[derive(Clone)]
pub struct Execution {
    progress: Arc<dyn Progress>,
    cancel: Arc<AtomicBool>,
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
        Self { progress, cancel: Arc::new(AtomicBool::new(false)) }
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
        self.progress.begin(name, steps);
        Stage { progress: self.progress.as_ref() }
    }
}

/// A stage under way; see [`Execution::stage`].
pub struct Stage<'a> {
    progress: &'a dyn Progress,
}

impl Stage<'_> {
    /// Marks `steps` more steps as done.
    pub fn advance(&self, steps: u64) {
        self.progress.advance(steps);
    }
}

impl Drop for Stage<'_> {
    fn drop(&mut self) {
        self.progress.end();
    }
}

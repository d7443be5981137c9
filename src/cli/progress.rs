//! A progress bar on the terminal.

use std::io::IsTerminal;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::execution::{Progress, Silent};

/// A bar with time left where standard error is a terminal, silence elsewhere.
pub(crate) fn for_terminal() -> Arc<dyn Progress> {
    if std::io::stderr().is_terminal() { Arc::new(Bar::default()) } else { Arc::new(Silent) }
}

/// Stages may lie inside one another; the innermost is shown.
#[derive(Default)]
struct Bar {
    stages: Mutex<Vec<ProgressBar>>,
}

impl Bar {
    fn stages(&self) -> MutexGuard<'_, Vec<ProgressBar>> {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Progress for Bar {
    fn begin(&self, stage: &str, steps: u64) {
        let mut stages = self.stages();
        if let Some(outer) = stages.last() {
            outer.finish_and_clear();
        }
        let bar = ProgressBar::with_draw_target(Some(steps), ProgressDrawTarget::stderr_with_hz(10));
        let template = if steps == 0 {
            "{spinner} {msg} {elapsed}"
        } else {
            "{msg:32} {wide_bar} {percent:>3} % {eta:>4} left"
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.set_message(stage.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        stages.push(bar);
    }

    fn advance(&self, steps: u64) {
        if let Some(bar) = self.stages().last() {
            bar.inc(steps);
        }
    }

    fn end(&self) {
        if let Some(bar) = self.stages().pop() {
            bar.finish_and_clear();
        }
    }
}

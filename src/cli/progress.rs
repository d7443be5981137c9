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

/// What is shown: without a plan, a bar for the innermost stage; with one, a single bar for the whole run.
#[derive(Default)]
struct Bar {
    shown: Mutex<Shown>,
}

#[derive(Default)]
struct Shown {
    /// Stages that have begun; they may lie inside one another.
    stages: Vec<Stage>,
    plan: Vec<(String, f64)>,
    bar: Option<ProgressBar>,
}

struct Stage {
    id: u64,
    steps: u64,
    done: u64,
    /// Its place in the plan.
    planned: Option<usize>,
    /// Its own bar, if there is no plan.
    bar: Option<ProgressBar>,
}

/// Positions of the bar for a whole run.
const WHOLE: u64 = 10_000;
const KNOWN: &str = "{msg:32} {wide_bar} {percent:>3} % {eta:>4} left";
const UNKNOWN: &str = "{spinner} {msg} {elapsed}";

impl Bar {
    fn shown(&self) -> MutexGuard<'_, Shown> {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn new_bar(steps: u64) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(steps), ProgressDrawTarget::stderr_with_hz(10));
    if let Ok(style) = ProgressStyle::with_template(if steps == 0 { UNKNOWN } else { KNOWN }) {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

impl Shown {
    /// How far the run is, by the stage of the plan that runs now.
    fn place(&self) -> Option<u64> {
        let stage = self.stages.iter().rev().find(|s| s.planned.is_some())?;
        let at = stage.planned?;
        let share = |part: &[(String, f64)]| part.iter().map(|p| p.1).sum::<f64>();
        let part = if stage.steps == 0 { 0.0 } else { stage.done as f64 / stage.steps as f64 };
        let reached = share(&self.plan[..at]) + self.plan[at].1 * part.min(1.0);
        Some((WHOLE as f64 * reached / share(&self.plan)) as u64)
    }

    fn update(&self) {
        if let (Some(bar), Some(place)) = (&self.bar, self.place()) {
            bar.set_position(place);
        }
    }
}

impl Progress for Bar {
    fn plan(&self, stages: &[(&str, f64)]) {
        let mut shown = self.shown();
        if let Some(bar) = shown.bar.take() {
            bar.finish_and_clear();
        }
        shown.plan = stages.iter().map(|&(name, share)| (name.to_owned(), share)).collect();
        shown.bar = (!stages.is_empty()).then(|| new_bar(WHOLE));
    }

    fn begin(&self, id: u64, stage: &str, steps: u64) {
        let mut shown = self.shown();
        let planned = shown.plan.iter().position(|p| p.0 == stage);
        let bar = match &shown.bar {
            Some(whole) => {
                if planned.is_some() {
                    whole.set_message(stage.to_owned());
                }
                None
            }
            None => {
                if let Some(outer) = shown.stages.last().and_then(|s| s.bar.as_ref()) {
                    outer.finish_and_clear();
                }
                let bar = new_bar(steps);
                bar.set_message(stage.to_owned());
                Some(bar)
            }
        };
        shown.stages.push(Stage { id, steps, done: 0, planned, bar });
        shown.update();
    }

    fn advance(&self, id: u64, steps: u64) {
        let mut shown = self.shown();
        if let Some(stage) = shown.stages.iter_mut().rev().find(|s| s.id == id) {
            stage.done += steps;
            if let Some(bar) = &stage.bar {
                bar.inc(steps);
            }
        }
        shown.update();
    }

    fn end(&self, id: u64) {
        let mut shown = self.shown();
        if let Some(at) = shown.stages.iter().rposition(|s| s.id == id)
            && let Some(bar) = shown.stages.remove(at).bar
        {
            bar.finish_and_clear();
        }
    }
}

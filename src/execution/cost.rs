//! What a run cost: time and memory, stage by stage.

use std::time::Instant;

use serde::{Deserialize, Serialize};

/// What one stage cost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageCost {
    /// The stage.
    pub stage: String,
    /// Wall-clock time.
    pub seconds: f64,
    /// The most memory the process had held by the end of the stage, in bytes, where the system
    /// says (Linux). It never falls: a stage that raises it is a stage that needed more.
    pub peak_memory: Option<u64>,
}

/// Collects the cost of stages in the order they ran.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct CostLog {
    /// The stages so far.
    pub stages: Vec<StageCost>,
}

impl CostLog {
    /// Runs a stage and records what it cost.
    pub fn measure<T>(&mut self, stage: &str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let out = work();
        self.add(stage, start.elapsed().as_secs_f64());
        out
    }

    /// Records a stage that is over and took `seconds`.
    pub fn add(&mut self, stage: &str, seconds: f64) {
        self.stages.push(StageCost { stage: stage.into(), seconds, peak_memory: peak_memory() });
    }

    /// Time of all stages together, in seconds.
    #[must_use]
    pub fn total_seconds(&self) -> f64 {
        self.stages.iter().map(|s| s.seconds).sum()
    }
}

/// The most memory this process has held so far, in bytes, where the system says.
#[must_use]
pub fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

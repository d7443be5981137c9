//! The first step where it is asked for: the volume, its noise filtered, kept for all later passes.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::memory_plan::MemoryPlan;
use super::{MaterialChoice, PipelineError, PipelineOptions};
use crate::execution::{CostLog, Execution};
use crate::grid::Geometry;
use crate::material::read_noise;
use crate::volume::{Denoise, Denoised, MemorySource, VolumeSource};

/// Its name as a stage.
pub(super) const STAGE: &str = "removing noise";

/// Slices filtered at a time where every pass filters again.
const AGAIN: usize = 8;

/// What was done about noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DenoiseFound {
    /// The filter, with the grey parameter that was used.
    pub used: Denoise,
    /// Standard deviation of the noise found before, in grey values.
    pub noise_before: f64,
    /// The same after it.
    pub noise_after: f64,
}

/// A filtered volume: in memory if the whole run has room there, otherwise in a scratch file, so that it is
/// filtered once; filtered again in each pass only if there is no folder for that file.
pub(super) enum Clean<'a> {
    Memory(MemorySource),
    File(Box<dyn VolumeSource>),
    Again(Denoised<'a>),
}

impl Clean<'_> {
    pub(super) fn source(&self) -> &dyn VolumeSource {
        match self {
            Self::Memory(source) => source,
            Self::File(source) => source.as_ref(),
            Self::Again(source) => source,
        }
    }

    /// Bytes that reading it takes beside what is read.
    pub(super) fn reading(&self) -> u64 {
        if let Self::Again(source) = self { source.bytes(source.slices_at_a_time()) } else { 0 }
    }
}

/// Filters the noise of `source`. `memory` is the plan of the run on the filtered volume.
pub(super) fn denoise<'a>(
    source: &'a dyn VolumeSource,
    denoise: Denoise,
    execution: &Execution,
    scratch: Option<&Path>,
    memory: &MemoryPlan,
    costs: &mut CostLog,
) -> Result<(Clean<'a>, DenoiseFound), PipelineError> {
    let stage = execution.stage(STAGE, source.geometry().size()[2] as u64);
    costs.measure("denoise", || {
        // Before anything is read: what it takes does not depend on the noise.
        let (keep, slices) = memory.denoising(&Denoised::new(source, denoise)?)?;
        let noise_before = read_noise(source, execution)?;
        let used = denoise.with_noise(noise_before);
        let denoised = Denoised::new(source, used)?.with_slices(slices);
        let clean = match (keep, scratch) {
            (true, _) => Clean::Memory(denoised.in_memory(execution, &stage)?),
            (false, Some(folder)) => Clean::File(denoised.in_file(folder, execution, &stage)?),
            // Beside all that a later stage holds.
            (false, None) => Clean::Again(denoised.with_slices(slices.min(AGAIN))),
        };
        let noise_after = read_noise(clean.source(), execution)?;
        Ok((clean, DenoiseFound { used, noise_before, noise_after }))
    })
}

impl PipelineOptions {
    /// Refuses a filter that makes no sense in a volume of this geometry, or of labels.
    pub(super) fn check_denoise(&self, geometry: &Geometry) -> Result<(), PipelineError> {
        let Some(denoise) = &self.denoise else { return Ok(()) };
        if self.materials == MaterialChoice::Labels {
            return Err(PipelineError::DenoiseLabels);
        }
        Ok(denoise.check(geometry)?)
    }
}

//! Who owns each voxel: voxel classification and junction thinning (Fujimori and Suzuki 2006, §3).
//!
//! Three passes on bit planes ([`alpha()`], [`core()`], [`pair()`]), then junction voxels are given to
//! their neighbours' materials in rounds ([`thin`]). The result is a [`LabelVolume`] and a plane
//! that remembers which voxels were junction: their grey values are not credible.
//!
//! Guarantees: every voxel gets a material; the result does not depend on threads. Not guaranteed:
//! parts and gaps thinner than about 2R (and cores thinner than R) may be lost, for the published
//! rule needs a core voxel of each material within 2R.

mod alpha;
mod ball;
mod bit_planes;
mod bricks;
mod error;
mod interior;
mod label_ids;
mod label_store;
mod label_volume;
mod pair;
mod passes;
mod sweeps;
mod thinning;

use serde::{Deserialize, Serialize};

use alpha::count_densest_kept;
use interior::add_interior;

pub use alpha::alpha;
pub use ball::{Ball, Dilation};
pub(crate) use bit_planes::set_bits;
pub use bit_planes::{BitPlanes, SliceMut, WORD};
pub use bricks::{Brick, Schedule, Sweep, SweepReport};
pub use error::ClassifyError;
pub use label_ids::{KnownLabels, LabelIds};
pub use label_store::{LabelStore, Stored};
pub use label_volume::{LabelVolume, WordOfLabels};
pub use pair::{core, junction, pair};
pub use passes::{Decided, Passes, halo};
pub use sweeps::{Classified, SlabPlan, classify_slabs};
pub use thinning::{Step, Thinned, Thinning, thin};

use crate::execution::Execution;
pub use crate::material::MAX_RADIUS;
use crate::material::{LevelSums, MaterialTable};
use crate::volume::{Sample, Slab};

/// Numbers of voxels per material after each pass, and what thinning did.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClassifyCounts {
    /// By grey value alone.
    pub alpha: Vec<u64>,
    /// Certain: the whole ball of radius R has one alpha class.
    pub core: Vec<u64>,
    /// Core voxels and those decided between two materials.
    pub pair: Vec<u64>,
    /// Decided by neither.
    pub junction: u64,
    /// After thinning.
    pub labelled: Vec<u64>,
    /// Voxels that have the densest material both by grey value alone and in the end.
    pub densest_kept: u64,
    /// Rounds of thinning.
    pub thinning_rounds: usize,
    /// Rounds that settled voxels no removable cell reached.
    pub settling_rounds: usize,
    /// Voxels settled in those.
    pub settled: u64,
}

impl ClassifyCounts {
    /// Nothing counted yet, for `materials` materials.
    fn zero(materials: usize) -> Self {
        let none = || vec![0; materials];
        Self {
            alpha: none(),
            core: none(),
            pair: none(),
            junction: 0,
            labelled: none(),
            densest_kept: 0,
            thinning_rounds: 0,
            settling_rounds: 0,
            settled: 0,
        }
    }

    fn add_thinned(&mut self, thinned: &Thinned) {
        self.thinning_rounds += thinned.rounds;
        self.settling_rounds += thinned.settling_rounds;
        self.settled += thinned.settled;
    }

    /// The share of the densest material's voxels by grey value that it still has in the end. What
    /// is missing went to other materials because its parts are thin. Of the other materials this
    /// would say nothing: their grey range holds blurred interfaces between their neighbours, too.
    #[must_use]
    pub fn densest_kept_share(&self) -> f64 {
        let by_grey = self.alpha.last().copied().unwrap_or(0);
        if by_grey == 0 { 1.0 } else { self.densest_kept as f64 / by_grey as f64 }
    }
}

/// A classified volume.
#[derive(Debug, Clone)]
pub struct Classification {
    /// The material of every voxel.
    pub labels: LabelVolume,
    /// The voxels that were junction before thinning.
    pub junction: BitPlanes,
    /// Sums over the voxels well inside of each material.
    pub levels: LevelSums,
    /// Counts for the report.
    pub counts: ClassifyCounts,
}

/// Whether a blur radius (R, in voxels per axis) is usable.
///
/// # Errors
/// [`ClassifyError::Radius`] if it is not.
pub fn check_radius(radius: [f64; 3]) -> Result<(), ClassifyError> {
    if radius.iter().all(|r| *r > 0.0 && *r <= MAX_RADIUS) {
        return Ok(());
    }
    Err(ClassifyError::Radius { radius, limit: MAX_RADIUS })
}

/// Classifies a volume of which all slices are here, with blur radius `radius` (R, in voxels per axis).
///
/// # Errors
/// [`ClassifyError::Radius`] for a radius that is not usable, [`ClassifyError::NoCore`] if nothing
/// is certain, [`ClassifyError::Cancelled`] if asked to stop.
pub fn classify<S: Sample>(
    slab: Slab<'_, S>,
    materials: &MaterialTable,
    radius: [f64; 3],
    execution: &Execution,
) -> Result<Classification, ClassifyError> {
    check_radius(radius)?;
    let stage = execution.stage(sweeps::STAGE, 2);
    let all = 1..slab.size()[2] + 1;
    let mut levels = LevelSums::new(slab.size(), materials.count());
    let decided = Passes::new(slab.size(), materials, radius)
        .decide_and(slab, all.clone(), |core| add_interior(&mut levels, slab, core, all.clone()));
    stage.advance(1);
    execution.check()?;
    if decided.core.iter().all(|&c| c == 0) {
        return Err(ClassifyError::NoCore { radius });
    }
    let Decided { mut b, junction, alpha, core } = decided;
    let pair = b.counts();
    let thinned = thin(slab, &mut b, &junction, materials, radius, execution)?;
    stage.advance(1);
    let mut counts = ClassifyCounts {
        alpha,
        core,
        pair,
        junction: junction.counts()[0],
        labelled: b.counts(),
        densest_kept: count_densest_kept(slab, &b, materials, all),
        ..ClassifyCounts::zero(0)
    };
    counts.add_thinned(&thinned);
    Ok(Classification { labels: LabelVolume::from_planes(&b), junction, levels, counts })
}

//! The passes that locate interfaces below a voxel, in slabs: see [`crate::locate`].

use super::PipelineError;
use crate::classify::{BitPlanes, LabelStore, LabelVolume};
use crate::execution::{Execution, Stage};
use crate::locate::{Scan, Sheets, Sites, find_curves, find_junctions, find_sheets, halo};
use crate::volume::{Sample, SampleWindow, Slab};

/// Its name as a stage, and its part of the time beside that of contouring.
pub(super) const STAGE: (&str, f64) = ("locating interfaces", 8.0);

/// Passes over the volume, contouring's not counted.
const PASSES: u64 = 3;

/// The curves at which interfaces meet or bend, in the whole volume, in slabs of `slices` slices.
pub(super) fn locate<S: Sample>(
    window: &mut SampleWindow<'_, S>,
    store: &mut LabelStore,
    scan: &Scan,
    slices: usize,
    execution: &Execution,
) -> Result<Sites, PipelineError> {
    let depth = window.size()[2] as u64;
    let stage = execution.stage(STAGE.0, PASSES * depth);
    let done = |stage: &Stage<'_>, core: &std::ops::Range<usize>| {
        stage.advance(core.len() as u64);
        execution.check()
    };
    let reach = halo(scan.units);
    let mut junctions = Vec::new();
    window.sweep(slices, reach, |slab, core| {
        let (labels, uncertain) = part(store, slab)?;
        junctions.append(&mut find_junctions(&scan.view(slab, &labels, &uncertain), core.clone()));
        Ok::<_, PipelineError>(done(&stage, &core)?)
    })?;
    let junctions = Sites::new(scan.units, junctions);
    let mut sheets = Sheets::default();
    window.sweep(slices, reach, |slab, core| {
        let (labels, uncertain) = part(store, slab)?;
        sheets.append(find_sheets(&scan.view(slab, &labels, &uncertain), &junctions, core.clone()));
        Ok::<_, PipelineError>(done(&stage, &core)?)
    })?;
    let mut curves = Vec::new();
    window.sweep(slices, reach, |slab, core| {
        let (labels, uncertain) = part(store, slab)?;
        let view = scan.view(slab, &labels, &uncertain);
        curves.append(&mut find_curves(&view, &junctions, &sheets, core.clone()));
        Ok::<_, PipelineError>(done(&stage, &core)?)
    })?;
    Ok(Sites::new(scan.units, curves))
}

/// Labels and flags of the slices of a slab, and what is around the volume.
pub(super) fn part<S: Sample>(
    store: &mut LabelStore,
    slab: Slab<'_, S>,
) -> Result<(LabelVolume, BitPlanes), PipelineError> {
    let (held, depth) = (slab.slices(), slab.size()[2]);
    let first = if held.start == 0 { 0 } else { held.start + 1 };
    let end = if held.end == depth { depth + 2 } else { held.end + 1 };
    let (labels, junction) = store.read(first..end)?;
    let all = labels.codes().slices() == (first..end);
    Ok(match (labels, junction) {
        (labels, junction) if all => (labels.into_owned(), junction.into_owned()),
        (labels, junction) => (labels.window(first..end), junction.into_owned().moved(first..end)),
    })
}

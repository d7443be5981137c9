//! What the models that locate interfaces below a voxel need to know, and their passes in slabs: see [`crate::locate`].

use std::ops::Range;

use super::PipelineError;
use crate::classify::{BitPlanes, LabelStore, LabelVolume};
use crate::execution::Execution;
use crate::grid::{Geometry, MaterialId};
use crate::locate::{
    BlurUnits, MOST_HALO, Places, Scan, SheetIndex, Sheets, Sites, View, find_curves, find_flat_cores,
    find_junctions, find_sheets, find_thin, flat_reach, halo, thin_reach,
};
use crate::material::{
    Blur, DEFAULT_RADIUS, Levels, Material, MaterialTable, Misfit, Noise, RADIUS_PER_SIGMA,
};
use crate::volume::{Sample, SampleWindow, Slab};

/// Its name as a stage, and its part of the time beside that of contouring.
pub(super) const STAGE: (&str, f64) = ("locating interfaces", 8.0);

/// Blurs below this many voxels leave steps that single voxels cannot show: models have nothing to fit to.
const LEAST_BLUR: f64 = 0.5;
/// The noise of a material is taken to be at least this share of the noisiest one's: where grey values are
/// clipped there is none to be seen, but at its borders there is.
const LEAST_NOISE: f64 = 0.5;
/// Grey values that spread by less than this share of the smallest contrast are all alike.
const ALIKE: f64 = 1e-6;
/// The noise is taken to be at least this share of the smallest contrast.
const LEAST_NOISE_OF_CONTRAST: f64 = 1e-3;

/// What the models that place crossings need; `None` if the blur is not known, too small or too wide for them.
pub(super) fn scan(
    geometry: &Geometry,
    materials: &MaterialTable,
    blur: &Blur,
    levels: &Levels,
    noise: &[Option<Noise>],
    misfits: &[Misfit],
    range: [f64; 2],
) -> Option<Scan> {
    let spacing = geometry.spacing();
    let axes = blur.sigma_axes_mm.or(blur.sigma_mm.map(|s| [s; 3]));
    let guess = [DEFAULT_RADIUS / RADIUS_PER_SIGMA * geometry.voxel_edge(); 3];
    let sigma: [f64; 3] = std::array::from_fn(|a| axes.unwrap_or(guess)[a] / spacing[a]);
    let units = BlurUnits::new(sigma);
    if sigma.iter().any(|s| *s < LEAST_BLUR) || halo(units) > MOST_HALO {
        return None;
    }
    let all = materials.materials();
    let contrast = all.windows(2).map(|m| m[1].mean - m[0].mean).fold(f64::INFINITY, f64::min);
    let measured = |i: usize| noise.get(i).and_then(Option::as_ref).map(|n| n.sigma);
    // The spread of a material that is nowhere thick is mostly blur; it is as noisy as another.
    let other = (0..all.len()).filter_map(measured).reduce(f64::max);
    let known = |i: usize| measured(i).or(other).or(all[i].sigma);
    let largest = (0..all.len()).filter_map(known).fold(LEAST_NOISE_OF_CONTRAST * contrast, f64::max);
    let sigmas = (0..all.len()).map(|i| known(i).unwrap_or(0.0).max(LEAST_NOISE * largest)).collect();
    let inflation = noise.iter().flatten().map(|n| n.effective).fold(1.0, f64::max).sqrt();
    let means: Vec<f64> = all.iter().map(|m| m.mean).collect();
    // Where all voxels of the lightest or densest material are alike, grey values end there.
    let alike = |m: &Material| m.sigma.is_some_and(|s| s < ALIKE * contrast).then_some(m.mean);
    let ends = [all.first().and_then(alike), all.last().and_then(alike)];
    let clip = [ends[0].unwrap_or(range[0]), ends[1].unwrap_or(range[1])];
    let thresholds = all.windows(2).map(|m| materials.threshold(m[0].id, m[1].id) as f32).collect();
    Some(Scan {
        units,
        is_blur_known: axes.is_some(),
        levels: levels.clone(),
        is_thin: vec![false; all.len()],
        thresholds,
        means,
        contrast,
        noise: sigmas,
        misfits: misfits.to_vec(),
        clip,
        inflation,
    })
}

/// Passes over the volume, contouring's not counted.
const PASSES: u64 = 5;

/// Looks at the volume in slabs of slices and a halo on each side, with the labels as they are.
fn look<S: Sample>(
    window: &mut SampleWindow<'_, S>,
    store: &mut LabelStore,
    scan: &Scan,
    [slices, halo]: [usize; 2],
    execution: &Execution,
    mut visit: impl FnMut(&View<'_>, Range<usize>) + Send,
) -> Result<(), PipelineError> {
    window.sweep(slices, halo, |slab, core| {
        let (labels, uncertain) = part(store, slab)?;
        visit(&scan.view(&slab, &labels, &uncertain, execution), core);
        Ok(execution.check()?)
    })
}

/// What thin parts tell of a scan: the levels of materials that are nowhere thick, and the blur if there is no plain
/// interface to measure it at. `None` if the blur is not known.
fn refined<S: Sample>(
    window: &mut SampleWindow<'_, S>,
    store: &mut LabelStore,
    scan: &Scan,
    slices: usize,
    execution: &Execution,
) -> Result<Option<Scan>, PipelineError> {
    let mut scan = scan.clone();
    let all = (0..scan.noise.len()).map(|m| MaterialId(m as u8));
    let thin: Vec<MaterialId> = all.filter(|m| scan.levels.drift(*m).is_none()).collect();
    for material in thin {
        let mut places = Places::new(material);
        look(window, store, &scan, [slices, halo(scan.units)], execution, |view, core| {
            places.add(view, core);
        })?;
        if let Some(found) = places.suit(&scan, scan.is_blur_known) {
            scan = Scan { is_blur_known: true, ..found };
        }
    }
    let usable = scan.is_blur_known && halo(scan.units) <= MOST_HALO;
    Ok(usable.then_some(scan))
}

/// The scan as it is known in the end, and the curves at which interfaces meet or bend, in the whole volume, in slabs of
/// `slices` slices. `None` if no model can be fitted.
pub(super) fn locate<S: Sample>(
    window: &mut SampleWindow<'_, S>,
    store: &mut LabelStore,
    scan: &Scan,
    slices: usize,
    execution: &Execution,
) -> Result<Option<(Scan, Sites)>, PipelineError> {
    let Some(scan) = refined(window, store, scan, slices, execution)? else { return Ok(None) };
    let depth = window.size()[2] as u64;
    let stage = execution.stage(STAGE.0, PASSES * depth);
    let done = |core: Range<usize>| stage.advance(core.len() as u64);
    let mut flat = Vec::new();
    look(window, store, &scan, [slices, flat_reach(scan.units)], execution, |view, core| {
        flat.append(&mut find_flat_cores(view, core.clone()));
        done(core);
    })?;
    store.relabel(flat.iter().map(|f| (f.voxel, f.material)))?;
    if thin_reach(scan.units) <= MOST_HALO {
        let mut thin = Vec::new();
        look(window, store, &scan, [slices, thin_reach(scan.units)], execution, |view, core| {
            thin.append(&mut find_thin(view, core.clone()));
            done(core);
        })?;
        store.relabel(thin.iter().map(|t| (t.voxel, t.material)))?;
    }
    let far = [slices, halo(scan.units)];
    let mut junctions = Vec::new();
    look(window, store, &scan, far, execution, |view, core| {
        junctions.append(&mut find_junctions(view, core.clone()));
        done(core);
    })?;
    let junctions = Sites::new(scan.units, junctions);
    let mut sheets = Sheets::default();
    look(window, store, &scan, far, execution, |view, core| {
        sheets.append(find_sheets(view, &junctions, core.clone()));
        done(core);
    })?;
    let sheets = SheetIndex::from(sheets);
    let mut curves = Vec::new();
    look(window, store, &scan, far, execution, |view, core| {
        curves.append(&mut find_curves(view, &junctions, &sheets, core.clone()));
        done(core);
    })?;
    let sites = Sites::new(scan.units, curves);
    Ok(Some((scan, sites)))
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

//! Levels of materials that are nowhere thick: from the shape of their thin parts.
//!
//! A plate of 2.5 voxels peaks at 70 % of its contrast; where a material has no thicker part, that peak is all that a
//! histogram shows, and a plate as wide as it looks is a third too thick. But a thicker plate is also flatter. So
//! slabs are fitted at many places, and one level (a polynomial of second degree over the volume, where that explains
//! clearly more) is found that suits all; where the volume has no plain interface to measure the blur at, the blur
//! as well.
//!
//! Each fit is made with the levels as they stand and narrow priors about them. How it strains against these and its
//! covariance give its own normal equations of level and blur, all else eliminated; summed up they give the next
//! levels. (A mean of free fits would be biased: one alone hardly tells level from thickness.)
//!
//! Not guaranteed: at a blur of another shape than a Gaussian's the level of parts thinner than two blur units is off; so
//! it is for parts with blurred or porous faces. With few places nothing is said.

use std::ops::Range;

use glam::DVec3;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use rayon::prelude::*;

use super::patches::BLOCK;
use super::ridges::{Finder, Ridge};
use super::sheet::{LevelPrior, Sample};
use super::slab_model::{BLUR, Slab, Start, WITHIN, fit_blurred_slab};
use super::thin_faces::{WINDOW, explains, levels};
use super::view::{Scan, View};
use crate::grid::MaterialId;
use crate::material::Levels;

/// Places at most, and at least.
const KEPT: usize = 400;
const FEWEST: usize = 60;
/// Terms of the polynomial.
const TERMS: usize = 10;
/// The priors of a fit: of the level as a share of the contrast, and of the blur's logarithm.
const LEVEL: f64 = 0.03;
const WIDTH: f64 = 0.03;
/// How free curvatures and taper are, for what they are where a place is fitted alone.
const FREEDOM: f64 = 0.3;
/// Largest change at a time of either.
const STEP: f64 = 0.1;
/// Rounds with one level, and with a polynomial.
const ROUNDS: [usize; 2] = [10, 6];
/// Prior standard deviation of the polynomial's other terms, as a share of the contrast.
const DRIFT: f64 = 0.15;
/// What the polynomial must gain to be preferred, squared standard errors: three for each term.
const GAIN: f64 = 27.0;
/// Neighbouring places share grey values: variances are so much larger.
const SHARED: f64 = 2.0;
/// Fewest voxels of a fit.
const LEAST_SAMPLES: usize = 40;
/// What is known worse than this, as a share, is not known.
const UNSURE: f64 = 0.08;
/// Nothing changes any more.
const SMALL: f64 = 1e-4;

/// A place on something thin.
#[derive(Debug, Clone)]
pub struct Place {
    hash: u64,
    voxel: [usize; 3],
    /// Before, within, after.
    materials: [MaterialId; 3],
    ridge: Ridge,
    samples: Vec<Sample>,
    outside: [LevelPrior; 2],
}

/// Places on the thin parts of a material, of which those with the lowest hash are kept.
#[derive(Debug, Clone)]
pub struct Places {
    material: MaterialId,
    kept: Vec<Place>,
}

/// A number that tells nothing of where a voxel is.
fn hash([x, y, z]: [usize; 3]) -> u64 {
    let mut h = (z as u64) << 42 ^ (y as u64) << 21 ^ x as u64;
    for shift in [30, 27] {
        h = (h ^ h >> shift).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    }
    h ^ h >> 31
}

impl Places {
    /// None yet.
    #[must_use]
    pub fn new(material: MaterialId) -> Self {
        Self { material, kept: Vec::new() }
    }

    /// Adds those of the slices `core`.
    pub fn add(&mut self, view: &View<'_>, core: Range<usize>) {
        let Some(finder) = Finder::new(view) else { return };
        let material = self.material;
        let layers = core.start.div_ceil(BLOCK)..core.end.div_ceil(BLOCK);
        let mut found: Vec<(u64, [usize; 3], Ridge)> =
            layers.into_par_iter().flat_map_iter(|layer| blocks(view, &finder, material, layer)).collect();
        found.sort_unstable_by_key(|f| f.0);
        found.truncate(KEPT);
        let new: Vec<Place> = found.into_par_iter().filter_map(|f| place(view, f, material)).collect();
        self.kept.extend(new);
        self.kept.sort_unstable_by_key(|p| p.hash);
        self.kept.truncate(KEPT);
    }
}

/// The clearest ridge of each block of a layer.
fn blocks(
    view: &View<'_>,
    finder: &Finder,
    material: MaterialId,
    layer: usize,
) -> Vec<(u64, [usize; 3], Ridge)> {
    let size = view.slab.size();
    let mut found: Vec<([usize; 2], [usize; 3], Ridge)> = Vec::new();
    for z in layer * BLOCK..((layer + 1) * BLOCK).min(view.slab.slices().end) {
        for y in 0..size[1] {
            for x in 0..size[0] {
                let voxel = [x, y, z];
                if view.label(voxel) != material {
                    continue;
                }
                if let Some(ridge) = finder.at(view.slab, voxel).filter(|r| r.rank == 1) {
                    found.push(([y / BLOCK, x / BLOCK], voxel, ridge));
                }
            }
        }
    }
    found.sort_by(|a, b| a.0.cmp(&b.0).then(b.2.strength.total_cmp(&a.2.strength)));
    found.dedup_by_key(|f| f.0);
    found.into_iter().map(|f| (hash(f.1), f.1, f.2)).collect()
}

fn place(
    view: &View<'_>,
    (hash, voxel, ridge): (u64, [usize; 3], Ridge),
    material: MaterialId,
) -> Option<Place> {
    let at = DVec3::from(voxel.map(|c| c as f64));
    let others = (0..view.scan.noise.len()).map(|m| MaterialId(m as u8)).filter(|m| *m != material);
    let nearest = |grey: f64| {
        let off = |m: &MaterialId| (view.mean(*m, at) - grey).abs();
        others.clone().min_by(|a, b| off(a).total_cmp(&off(b)))
    };
    let materials = [nearest(ridge.sides[1])?, material, nearest(ridge.sides[0])?];
    let mut seen = Vec::new();
    view.ball(at, WINDOW, &mut seen);
    let samples: Vec<Sample> = seen.iter().map(|s| s.sample).collect();
    let (all, _) = levels(view, at, materials);
    // All are kept: which ones may not depend on how many a slab has.
    Some(Place { hash, voxel, materials, ridge, samples, outside: [all[0], all[2]] })
}

/// Level and blur as they stand.
struct State {
    level: SVector<f64, TERMS>,
    log_blur: f64,
}

/// The normal equations of all places, about a state.
struct Sum {
    matrix: SMatrix<f64, { TERMS + 1 }, { TERMS + 1 }>,
    right: SVector<f64, { TERMS + 1 }>,
    places: usize,
}

impl Places {
    /// The scan with the level that suits the places; with another blur, too, if that is not `known`. `None` if they
    /// say too little.
    #[must_use]
    pub fn suit(&self, scan: &Scan, known: bool) -> Option<Scan> {
        let terms: Vec<SVector<f64, TERMS>> =
            self.kept.iter().map(|p| SVector::from(scan.levels.terms(p.voxel.map(|c| c as f64)))).collect();
        let mean = f64::from(scan.levels.mean(self.material, [0.0; 3]));
        let first = self.kept.first()?;
        let contrast = (mean - first.outside[0].mean).abs();
        let mut state = State { level: SVector::zeros(), log_blur: 0.0 };
        state.level[0] = mean;
        let (mut drifts, mut sigmas) = (false, None);
        let mut round = 0;
        while round < ROUNDS[0] + ROUNDS[1] {
            let sum = self.sum(scan, &state, &terms, contrast, known, round >= 4);
            if sum.places < FEWEST {
                return None;
            }
            if round == ROUNDS[0] {
                let [flat, bent] = [false, true].map(|d| step(&sum, &state, contrast, d, known));
                let gain =
                    |s: &SVector<f64, { TERMS + 1 }>| 2.0 * s.dot(&sum.right) - s.dot(&(sum.matrix * s));
                drifts = gain(&bent?.0) - gain(&flat?.0) > SHARED * GAIN;
            }
            let (change, inverse) = step(&sum, &state, contrast, drifts, known)?;
            let largest = (change.fixed_rows::<TERMS>(0).abs().max() / contrast).max(change[TERMS].abs());
            let shorter = (STEP / largest.max(1e-12)).min(1.0);
            state.level += change.fixed_rows::<TERMS>(0) * shorter;
            state.log_blur += change[TERMS] * shorter;
            sigmas = Some(inverse * SHARED);
            round = match round {
                r if r < 4 || largest > SMALL => r + 1,
                r if r < ROUNDS[0] => ROUNDS[0],
                _ => break,
            };
        }
        let covariance = sigmas?;
        let unsure =
            covariance[(0, 0)].sqrt() / contrast > UNSURE || covariance[(TERMS, TERMS)].sqrt() > UNSURE;
        let ratio = (state.level[0] - first.outside[0].mean) / (mean - first.outside[0].mean);
        if unsure || !(0.7..2.5).contains(&ratio) {
            return None;
        }
        let covariance = covariance.fixed_view::<TERMS, TERMS>(0, 0).into_owned();
        let levels: Levels =
            scan.levels.with_polynomial(self.material, state.level.into(), covariance.into());
        let units = scan.units.wider(libm::exp(state.log_blur));
        let mut is_thin = scan.is_thin.clone();
        is_thin[usize::from(self.material.0)] = true;
        Some(Scan { levels, units, is_thin, ..scan.clone() })
    }

    fn sum(
        &self,
        scan: &Scan,
        state: &State,
        terms: &[SVector<f64, TERMS>],
        contrast: f64,
        known: bool,
        strict: bool,
    ) -> Sum {
        let width = if known { 0.0 } else { WIDTH };
        let parts: Vec<Option<(Matrix2<f64>, Vector2<f64>)>> = self
            .kept
            .par_iter()
            .zip(terms)
            .map(|(place, terms)| {
                if place.samples.len() < LEAST_SAMPLES {
                    return None;
                }
                let level = LevelPrior { mean: state.level.dot(terms), sigma: LEVEL * contrast };
                let noise = place.materials.iter().map(|m| scan.noise[usize::from(m.0)]).fold(0.0, f64::max);
                let noise = noise.hypot(0.003 * contrast);
                let levels = [place.outside[0], level, place.outside[1]];
                let start = Start { at: place.ridge.offset, normal: place.ridge.normal, half: 1.0 };
                let slab =
                    fit_blurred_slab(&place.samples, start, levels, (state.log_blur, width), FREEDOM, noise)?;
                let Slab { fit, .. } = slab;
                if strict && !explains(fit.chi2, fit.strain, place.samples.len(), 1.0) {
                    return None;
                }
                let shift = [fit.x[WITHIN] - level.mean, fit.x[BLUR] - state.log_blur];
                let c = &fit.covariance;
                Some(if known {
                    let own = 1.0 / c[(WITHIN, WITHIN)];
                    let info = (own - level.sigma.powi(-2)).max(0.0);
                    (Matrix2::new(info, 0.0, 0.0, 0.0), Vector2::new(own * shift[0], 0.0))
                } else {
                    let block = Matrix2::new(
                        c[(WITHIN, WITHIN)],
                        c[(WITHIN, BLUR)],
                        c[(BLUR, WITHIN)],
                        c[(BLUR, BLUR)],
                    );
                    let own = block.try_inverse()?;
                    let prior = Matrix2::new(level.sigma.powi(-2), 0.0, 0.0, width.powi(-2));
                    (own - prior, own * Vector2::from(shift))
                })
            })
            .collect();
        let mut sum = Sum { matrix: SMatrix::zeros(), right: SVector::zeros(), places: 0 };
        for (part, terms) in parts.iter().zip(terms) {
            let Some((info, score)) = part else { continue };
            sum.places += 1;
            for i in 0..TERMS {
                for j in 0..TERMS {
                    sum.matrix[(i, j)] += info[(0, 0)] * terms[i] * terms[j];
                }
                sum.matrix[(i, TERMS)] += info[(0, 1)] * terms[i];
                sum.matrix[(TERMS, i)] += info[(1, 0)] * terms[i];
                sum.right[i] += score[0] * terms[i];
            }
            sum.matrix[(TERMS, TERMS)] += info[(1, 1)];
            sum.right[TERMS] += score[1];
        }
        sum
    }
}

/// The change that the normal equations ask for, and the inverse of their matrix; with all terms or one level alone.
fn step(
    sum: &Sum,
    state: &State,
    contrast: f64,
    drifts: bool,
    known: bool,
) -> Option<(SVector<f64, { TERMS + 1 }>, SMatrix<f64, { TERMS + 1 }, { TERMS + 1 }>)> {
    let (mut matrix, mut right) = (sum.matrix, sum.right);
    let width = if drifts { DRIFT * contrast } else { 1e-6 * contrast };
    for i in 1..TERMS {
        matrix[(i, i)] += width.powi(-2);
        right[i] -= state.level[i] / (width * width);
    }
    if known {
        matrix[(TERMS, TERMS)] += 1e12;
    }
    let cholesky = matrix.cholesky()?;
    Some((cholesky.solve(&right), cholesky.inverse()))
}

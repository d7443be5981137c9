//! Which octant holds what: from three rough planes and rough labels, and by trial against the grey values.
//!
//! A voxel's label counts for each octant with the fourth power of the octant's share of the blur around it, so
//! voxels well inside speak, and octants too thin for any still hear somebody. Thresholds put a shell of a third
//! material between two others, and rough planes cut wrong, so the majority is often wrong in one octant. With the
//! planes held, grey values are linear in the octants' levels, and the misfit of any assignment of materials
//! follows from one 8 x 8 matrix of sums, levels solved for, priors included. Assignments that differ from the
//! majority's in one or two octants are ranked by it and fitted in turn from the rough planes, until one
//! explains the grey values. Ranks alone do not decide: planes half a unit off cost more than a wrong octant.

use glam::{DMat3, DVec3};
use nalgebra::{SMatrix, SVector};

use super::batch::Batches;
use super::corner::{Corner, CornerFit, MATERIALS};
use super::corner_fit::{Anchor, CornerPrior};
use super::corner_rows::{Survey, survey};
#[cfg(test)]
use super::sheet::Sample;

/// Assignments of a round from each of two rankings, and rounds: those after the first try such that differ
/// in one octant from the best so far.
const TRIES: usize = 10;
/// Another arrangement is worth a fit if, the planes held as they start or as the first fit left them, it takes the
/// misfit down to this share: a place that is no corner would be fitted again and again.
const WORTH: f64 = 0.45;
const ROUNDS: usize = 2;
/// Iterations of a trial, after how many it is given up if it leaves so many times what is hopeless, and of the fit of
/// the best one.
const TRIAL: usize = 14;
const ROUGH: usize = 6;
const LOST: f64 = 8.0;
const FINAL: usize = 40;
/// On the way a fit may stray so many times as far as its apex may lie in the end.
const STRAY: f64 = 1.5;
/// Misfit and strain per sample that leave nothing to explain: noise is known to some 15 %.
const EXPLAINED: f64 = 1.3;
/// Whatever the noise: by how many times the misfit all changes of one octant would raise it where nothing is left
/// to try.
const SETTLED: f64 = 2.0;
/// A corner that is seen has a margin above this, and an apex known better than this.
const SURE: f64 = 50.0;
const LOOSE: f64 = 0.7;
/// Standard deviations by which a level may differ from what is known.
const BELIEVABLE: f64 = 5.0;

/// The best fit, and how sure its materials are.
#[derive(Debug, Clone)]
pub(super) struct Found {
    /// The fit.
    pub fit: CornerFit,
    /// By how much the misfit would rise at least if one octant held another of the materials: small where
    /// the window does not tell.
    pub margin: f64,
}

impl Found {
    /// Whether the window of a radius shows this corner, and not less than a corner: a window of an edge or of one
    /// sheet is explained as well, by a corner far away or by octants that may hold anything. And whether it is
    /// explained; noise may be known badly and planes bent, as long as other materials are worse by far.
    #[must_use]
    pub(super) fn is_sound(&self, radius: f64) -> bool {
        let misfit = total(&self.fit);
        self.fit.fit.converged
            && self.margin > SURE
            && self.fit.corner.apex.length() < radius
            && self.fit.apex_sigmas()[2] < LOOSE
            && (misfit < 2.0 * EXPLAINED * self.fit.samples as f64 || self.margin > SETTLED * misfit)
    }
}

impl Survey {
    /// Misfit and strain of an assignment with its best levels, and these.
    fn misfit(&self, materials: &[u8; 8], prior: &CornerPrior) -> Option<(f64, [f64; MATERIALS])> {
        let weight = 1.0 / (prior.noise * prior.noise);
        let mut matrix = SMatrix::<f64, MATERIALS, MATERIALS>::identity();
        let mut right = SVector::<f64, MATERIALS>::zeros();
        let mut constant = self.total * weight;
        for m in 0..MATERIALS {
            if materials.iter().any(|&o| usize::from(o) == m) {
                let p = prior.levels[m]?;
                let w = 1.0 / (p.sigma * p.sigma);
                matrix[(m, m)] = w;
                right[m] = w * p.mean;
                constant += w * p.mean * p.mean;
            }
        }
        for i in 0..8 {
            let m = usize::from(materials[i]);
            for j in 0..8 {
                let product = self.square[i.max(j)][i.min(j)];
                matrix[(m, usize::from(materials[j]))] += product * weight;
            }
            right[m] += self.grey[i] * weight;
        }
        let levels = matrix.cholesky()?.solve(&right);
        Some((constant - right.dot(&levels), std::array::from_fn(|m| levels[m])))
    }

    /// Assignments that differ from one in one octant or, with `pairs`, two: by turns the next by misfit, and the
    /// next by the votes that it goes against.
    fn ranked(&self, materials: &[u8; 8], prior: &CornerPrior, pairs: bool) -> Vec<[u8; 8]> {
        let votes = &self.votes;
        let present = prior.present();
        let mut all: Vec<(f64, f64, [u8; 8])> = Vec::new();
        // By how much a material has fewer votes in an octant, 0 to 1.
        let against = |o: usize, m: u8| {
            let (own, other) = (votes[o][usize::from(materials[o])], votes[o][usize::from(m)]);
            (own - other) / (own + other).max(1e-12)
        };
        let mut add = |other: [u8; 8]| {
            let protest =
                (0..8).filter(|&o| other[o] != materials[o]).map(|o| 0.2 + against(o, other[o])).sum();
            all.extend(self.misfit(&other, prior).map(|(value, _)| (value, protest, other)));
        };
        for i in 0..8 {
            for &m in present.iter().filter(|&&m| m != materials[i]) {
                let mut other = *materials;
                other[i] = m;
                add(other);
                for j in (0..i).filter(|_| pairs) {
                    for &n in present.iter().filter(|&&n| n != materials[j]) {
                        let mut third = other;
                        third[j] = n;
                        add(third);
                    }
                }
            }
        }
        let mut by_votes = all.clone();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        by_votes.sort_by(|a, b| a.1.total_cmp(&b.1));
        let mut out: Vec<[u8; 8]> = Vec::new();
        for (a, b) in all.iter().zip(&by_votes).take(TRIES) {
            for m in [a.2, b.2] {
                if !out.contains(&m) {
                    out.push(m);
                }
            }
        }
        out
    }
}

/// By how much the misfit rises at least when one octant is given another material, planes held.
fn margin(corner: &Corner, samples: &Batches, prior: &CornerPrior) -> f64 {
    let sums = survey(corner, samples, &[]);
    let Some((own, _)) = sums.misfit(&corner.materials, prior) else { return 0.0 };
    let mut least = f64::INFINITY;
    for i in 0..8 {
        for m in prior.present().into_iter().filter(|&m| m != corner.materials[i]) {
            let mut other = corner.materials;
            other[i] = m;
            if let Some((value, _)) = sums.misfit(&other, prior) {
                least = least.min(value - own);
            }
        }
    }
    least
}

/// The material with the most votes in each octant.
fn elect(votes: &[[f64; MATERIALS]; 8]) -> [u8; 8] {
    votes.map(|v| (1..MATERIALS).fold(0, |m, i| if v[i] > v[m] { i } else { m }) as u8)
}

/// Three rough planes with materials, and what else could be tried.
pub(super) struct Start {
    corner: Corner,
    sums: Survey,
}

impl Start {
    /// From three planes, each given by a point and a normal, with materials by the labels of the samples: others than
    /// those below [`MATERIALS`] do not count.
    pub(super) fn new(
        planes: &[(DVec3, DVec3); 3],
        samples: &Batches,
        labels: &[u8],
        prior: &CornerPrior,
    ) -> Option<Self> {
        let units = planes.map(|(point, normal)| (point, normal.normalize_or_zero()));
        let mut corner = Corner {
            apex: Corner::meet(&units)?,
            normals: units.map(|(_, n)| n),
            materials: [0; 8],
            levels: prior.levels.map(|l| l.map_or(0.0, |l| l.mean)),
            log_sigma: 0.0,
            forms: prior.bends.map(|b| b.0),
        };
        let sums = survey(&corner, samples, labels);
        corner.materials = elect(&sums.votes);
        Some(Self { corner, sums })
    }
}

/// Misfit and strain.
fn total(fit: &CornerFit) -> f64 {
    fit.fit.chi2 + fit.fit.strain
}

/// Whether grey levels are those of their materials and not, say, two of them swapped.
fn is_believable(corner: &Corner, prior: &CornerPrior) -> bool {
    let present = corner.present();
    (0..MATERIALS)
        .filter(|&m| present[m])
        .all(|m| prior.levels[m].is_some_and(|l| (corner.levels[m] - l.mean).abs() < BELIEVABLE * l.sigma))
}

/// See [`Start::new`] and [`Start::find`].
#[cfg(test)]
pub(super) fn find(
    planes: &[(DVec3, DVec3); 3],
    samples: &[Sample],
    labels: &[u8],
    anchors: &[Anchor],
    prior: &CornerPrior,
    hopeless: f64,
) -> Option<Found> {
    let samples = &Batches::new(samples);
    Start::new(planes, samples, labels, prior)?.find(samples, anchors, prior, hopeless, f64::INFINITY, false)
}

/// The fit of a corner, as it is known so far, to grey values alone.
pub(super) fn alone(corner: &Corner, samples: &Batches, prior: &CornerPrior) -> Option<Found> {
    let fit = corner.fit(samples, &[], prior, FINAL)?;
    let margin = margin(&fit.corner, samples, prior);
    Some(Found { fit, margin })
}

impl Start {
    /// Whether the materials that labels say make a corner.
    pub(super) fn is_complete(&self) -> bool {
        self.corner.is_complete()
    }

    /// Fits from here, then from other materials until the grey values are explained, and returns the best fit.
    /// `None` where fits are far from leaving no more than `hopeless` in chi squared per measurement, and where they are
    /// explained by a corner farther than `farthest` from the window's middle: by an edge or a single sheet. A `first` fit, from which
    /// the window is moved, need not be good to the last digit.
    #[must_use]
    pub(super) fn find(
        &self,
        samples: &Batches,
        anchors: &[Anchor],
        prior: &CornerPrior,
        hopeless: f64,
        farthest: f64,
        first: bool,
    ) -> Option<Found> {
        let measured = (samples.voxels() + anchors.len()) as f64;
        let is_far = |fit: &CornerFit| fit.corner.apex.length() > STRAY * farthest;
        // In few steps, and on where they lead somewhere.
        let trial = |corner: &Corner| {
            let rough = corner.fit(samples, anchors, prior, ROUGH)?;
            if rough.fit.converged || total(&rough) > LOST * hopeless * measured || is_far(&rough) {
                return Some(rough);
            }
            rough.corner.fit(samples, anchors, prior, TRIAL - ROUGH)
        };
        let mut best: Option<CornerFit> = None;
        let mut tried: Vec<[u8; 8]> = Vec::new();
        let mut centre = self.corner.materials;
        'rounds: for round in 0..ROUNDS {
            let mut held: Option<Survey> = None;
            // Others are ranked only once it is known that they are wanted.
            let own = std::iter::once_with(|| vec![centre]);
            let others = std::iter::once_with(|| self.sums.ranked(&centre, prior, round == 0));
            for materials in own.chain(others).flatten() {
                let is_worth = |sums: &Survey| {
                    let value = |m: &[u8; 8]| sums.misfit(m, prior).map(|v| v.0);
                    value(&materials).zip(value(&centre)).is_some_and(|(new, own)| new < WORTH * own)
                };
                if tried.contains(&materials) {
                    continue;
                }
                if !tried.is_empty() && !is_worth(&self.sums) {
                    let from = best.as_ref().map_or(&self.corner, |fit| &fit.corner);
                    if !is_worth(held.get_or_insert_with(|| survey(from, samples, &[]))) {
                        continue;
                    }
                }
                tried.push(materials);
                let Some(fit) = trial(&Corner { materials, ..self.corner.clone() }) else { continue };
                let value = total(&fit);
                if is_far(&fit) && value < hopeless * measured {
                    return None;
                }
                if !is_believable(&fit.corner, prior) || best.as_ref().is_some_and(|b| total(b) <= value) {
                    continue;
                }
                let settled = value < EXPLAINED * measured
                    || (fit.fit.converged && margin(&fit.corner, samples, prior) > SETTLED * value);
                best = Some(fit);
                if settled {
                    break 'rounds;
                }
            }
            match &best {
                Some(b) if b.corner.materials != centre => centre = b.corner.materials,
                _ => break,
            }
        }
        let mut fit = best?;
        if fit.reduced() > 2.0 * hopeless || is_far(&fit) {
            return None;
        }
        // Bends are told in the frames of the start; and a trial may have been too short.
        if !first && (!fit.fit.converged || fit.corner.forms != [DMat3::ZERO; 3]) {
            fit = fit.corner.fit(samples, anchors, prior, FINAL)?;
        }
        let margin = margin(&fit.corner, samples, prior);
        Some(Found { fit, margin })
    }
}

//! Labels of thin parts: what the published classification has given away.
//!
//! That needs a ball of the blur's radius inside of a material; plates, gaps, pores and inclusions under about five blur
//! units have none. Here, before anything else is located:
//!
//! 1. *Candidates* are the voxels whose grey class is not their label, those that were undecided, and those of a
//!    material that is nowhere thick.
//! 2. Of those that are [`super::ridges`] the one nearest to the middle of each block is a *seed*.
//! 3. At a seed a slab or a ball is fitted for each material that may be inside: darker than both sides for a valley,
//!    brighter for a ridge; the sides are of the materials whose levels the grey values reach there. Of the fits that
//!    explain the grey values the best is taken: a thin plate of iron and a thicker one of aluminium may have the same
//!    peak, but not the same shape.
//! 4. The voxels about it take the materials that it says; of several fits the one whose middle is nearest speaks.
//!    Where no fit is accepted (rods, ends), both sides are of one material and only one can be inside, the voxels at the
//!    seed whose grey value is nearer to it than to the sides become it.
//!
//! 5. At a rim a blurred step down to a third material passes the level of what is on the sides, which so would close
//!    around the rim: between the faces of a slab, gone on for six units, a run of that material of under 2.5 units
//!    with the third one behind it is a step, and its voxels are of what their grey values are nearer to.
//!
//! Guaranteed: all is decided by what is within [`reach`] of a voxel. Where grey values have no extremum nothing
//! changes: a blurred interface never becomes a layer of what lies between. Not guaranteed: parts under 1.4 blur units
//! (1.7 voxels at the usual blur) are left as they are, and layers between a darker and a brighter material, which have
//! no extremum.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::ball_model::{Ball, fit_ball, share};
use super::frame::BlurUnits;
use super::gauss::bisect;
use super::patches::BLOCK;
use super::ridges::{self, Finder, Ridge};
use super::sheet::Sample;
use super::slab_model::{Slab, Start, fit_slab, peak};
use super::specks;
use super::thin_faces::{TAINTED, WINDOW, explains, label_at, levels, strange};
use super::view::{Seen, View};
use crate::grid::MaterialId;

/// A slab speaks for places so far from its seed's foot along it, and so far beyond its faces; blur units.
const ASIDE: f64 = 2.6;
const BEYOND: f64 = 1.5;
/// Where grey values are farther from it than this share of its contrast it says nothing.
const UNLIKE: f64 = 0.25;
/// Beyond that it speaks of blurred rims, so far from the foot and for runs no longer than this.
const RIM: f64 = 6.0;
const RUN: f64 = 2.5;
/// A ball speaks so far beyond its surface, and is no larger than this.
const AROUND: f64 = 2.0;
const LARGEST: f64 = 3.5;
/// Where nothing is fitted: so far from the seed.
const BY_GREY: f64 = 1.6;
/// Half the thickness, and the radius, of what is safe; blur units.
const THINNEST: f64 = 0.7;
const SMALLEST: f64 = 1.2;
/// Largest half thickness, curvature, and standard deviation of half the thickness.
const THICKEST: f64 = 2.6;
const MOST_CURVED: f64 = 0.35;
const UNSURE: f64 = 0.15;
/// A part whose faces are tilted more against its middle is a wedge.
const MOST_TAPERED: f64 = 0.2;
/// Share of the contrast that a ridge may have of a material inside.
const SHARES: Range<f64> = 0.35..1.15;
/// Fewest voxels of a fit.
const FEWEST: usize = 40;

/// The farthest that a seed speaks: rims, and as far as runs are followed.
const FAR: f64 = 7.5;

/// Slices that this reads beyond those that it decides.
#[must_use]
pub fn reach(units: BlurUnits) -> usize {
    // From a voxel to a seed that speaks for it, and from there to what its fit sees.
    let far = FAR + (WINDOW + TAINTED + 1.0).max(LARGEST + 3.0).max(ridges::REACH);
    (far / units.per_voxel.z).ceil() as usize + BLOCK + ridges::AROUND + specks::MOST
}

/// A voxel that is decided anew.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Relabelled {
    /// Where: z, y, x.
    pub voxel: [u32; 3],
    /// Its material.
    pub material: MaterialId,
}

/// What a seed turned out to be.
enum Thin {
    Slab(Box<Slab>, [MaterialId; 3]),
    Ball(Box<Ball>, [MaterialId; 2]),
    /// Not understood: inside, sides along and against the normal.
    Grey(Ridge, [MaterialId; 3], f64),
}

struct Seed {
    voxel: [usize; 3],
    ridge: Ridge,
}

/// The voxels of the slices `core` that belong to thin parts, or lie beside them, and are not labelled so; ascending.
#[must_use]
pub fn find_thin(view: &View<'_>, core: Range<usize>) -> Vec<Relabelled> {
    let Some(finder) = Finder::new(view) else { return Vec::new() };
    let far = (FAR / view.units.per_voxel.z).ceil() as usize + 1;
    let around = |by: usize| core.start.saturating_sub(by)..(core.end + by).min(view.slab.size()[2]);
    // What is a speck is told by what is around it.
    let (wider, slices) = (around(specks::MOST), around(far + specks::MOST));
    let slices = slices.start.max(view.slab.slices().start)..slices.end.min(view.slab.slices().end);
    let layers = slices.start / BLOCK..slices.end.div_ceil(BLOCK);
    let seeds: Vec<Seed> = layers.into_par_iter().flat_map_iter(|b| seeds(view, &finder, b)).collect();
    let mut claims: Vec<Claim> = seeds
        .par_iter()
        .filter(|_| !view.execution.is_cancelled())
        .flat_map_iter(|seed| understand(view, seed).map(|thin| claims(view, seed, &thin, &wider)))
        .flatten_iter()
        .collect();
    claims.par_sort_unstable_by(|a, b| {
        a.voxel.cmp(&b.voxel).then(a.score.total_cmp(&b.score)).then(a.seed.cmp(&b.seed))
    });
    claims.dedup_by_key(|c| c.voxel);
    let changes = |c: &Claim| {
        let voxel = [c.voxel[2], c.voxel[1], c.voxel[0]].map(|c| c as usize);
        view.is_uncertain(voxel) || view.label(voxel) != c.material
    };
    claims.retain(changes);
    let kept = |c: &&Claim| core.contains(&(c.voxel[0] as usize)) && !is_speck(view, &claims, c);
    claims.iter().filter(kept).map(|c| Relabelled { voxel: c.voxel, material: c.material }).collect()
}

/// The seeds of a layer of blocks.
fn seeds(view: &View<'_>, finder: &Finder, layer: usize) -> Vec<Seed> {
    let size = view.slab.size();
    let slices =
        (layer * BLOCK).max(view.slab.slices().start)..((layer + 1) * BLOCK).min(view.slab.slices().end);
    let mut found: Vec<([usize; 2], bool, Seed)> = Vec::new();
    for z in slices {
        for y in 0..size[1] {
            for x in 0..size[0] {
                let voxel = [x, y, z];
                let label = view.label(voxel);
                let is_thin = view.scan.is_thin.get(usize::from(label.0)).is_some_and(|t| *t);
                if view.scan.class(view.slab.grey(voxel)) == label && !view.is_uncertain(voxel) && !is_thin {
                    continue;
                }
                if let Some(ridge) = finder.at(view.slab, voxel) {
                    found.push(([y / BLOCK, x / BLOCK], ridge.bright, Seed { voxel, ridge }));
                }
            }
        }
    }
    // What speaks for a block lies in its middle, so that neighbours leave nothing out between them.
    let off =
        |s: &Seed| s.voxel.map(|c| (c % BLOCK).abs_diff(BLOCK / 2)).iter().map(|d| d * d).sum::<usize>();
    found.sort_by(|a, b| {
        let clearest = || b.2.ridge.strength.total_cmp(&a.2.ridge.strength);
        (a.0, a.1, off(&a.2)).cmp(&(b.0, b.1, off(&b.2))).then_with(clearest)
    });
    found.dedup_by_key(|f| (f.0, f.1));
    found.into_iter().map(|f| f.2).collect()
}

/// Whether a claim (of all, ascending) leaves no more than a few voxels that hang together.
fn is_speck(view: &View<'_>, claims: &[Claim], claim: &Claim) -> bool {
    let size = view.slab.size();
    let mut part = vec![claim.voxel];
    let mut next = 0;
    while next < part.len() {
        for k in 0..6 {
            let mut at = part[next];
            at[k / 2] = if k % 2 == 0 { at[k / 2].wrapping_sub(1) } else { at[k / 2] + 1 };
            let voxel = [at[2], at[1], at[0]].map(|c| c as usize);
            if (0..3).any(|a| voxel[a] >= size[a]) || part.contains(&at) {
                continue;
            }
            let claimed = claims.binary_search_by(|c| c.voxel.cmp(&at)).ok().map(|i| claims[i].material);
            if claimed.unwrap_or_else(|| view.label(voxel)) == claim.material {
                part.push(at);
            }
        }
        if part.len() > specks::MOST {
            return false;
        }
        next += 1;
    }
    true
}

/// What is at a seed.
fn understand(view: &View<'_>, seed: &Seed) -> Option<Thin> {
    let ridge = &seed.ridge;
    let place = DVec3::from(seed.voxel.map(|c| c as f64)) + view.units.voxel(ridge.offset);
    let count = view.scan.noise.len();
    let all = (0..count).map(|m| MaterialId(m as u8));
    let mean = |m: MaterialId| view.mean(m, place);
    let nearest =
        |grey: f64| all.clone().min_by(|a, b| (mean(*a) - grey).abs().total_cmp(&(mean(*b) - grey).abs()));
    let (after, before) = (nearest(ridge.sides[0])?, nearest(ridge.sides[1])?);
    let outside = 0.5 * (mean(after) + mean(before));
    let share_of = |m: MaterialId| (ridge.grey - outside) / (mean(m) - outside);
    let inside: Vec<MaterialId> = all
        .clone()
        .filter(|&m| {
            let beyond = if ridge.bright { m > after && m > before } else { m < after && m < before };
            beyond && SHARES.contains(&share_of(m))
        })
        .collect();
    let (mut seen, mut best) = (Vec::new(), None::<(f64, Thin)>);
    let mut take = |misfit: f64, thin: Thin| {
        if best.as_ref().is_none_or(|b| misfit < b.0) {
            best = Some((misfit, thin));
        }
    };
    if ridge.rank > 1 && before == after {
        for &m in &inside {
            if let Some((misfit, ball)) = ball_at(view, place, share_of(m), [m, after], &mut seen) {
                take(misfit, Thin::Ball(Box::new(ball), [m, after]));
            }
        }
    }
    if ridge.rank < 3 {
        for &m in &inside {
            let materials = [before, m, after];
            if let Some((misfit, slab)) =
                slab_at(view, place, ridge.normal, share_of(m), materials, &mut seen)
            {
                take(misfit, Thin::Slab(Box::new(slab), materials));
            }
        }
    }
    let by_grey = || {
        // Between different materials there are other extrema, at the tips of wedges.
        let [m] = inside[..] else { return None };
        if before != after {
            return None;
        }
        (share_of(m) > 0.5).then(|| Thin::Grey(*ridge, [m, after, before], half_of(share_of(m))))
    };
    best.map(|b| b.1).or_else(by_grey)
}

/// Half the thickness of a slab with this share of the contrast in its middle.
fn half_of(share: f64) -> f64 {
    size_of(share.clamp(0.2, 0.98), peak)
}

/// Where a rising function of a size in blur units has a value.
fn size_of(value: f64, rising: impl Fn(f64) -> f64) -> f64 {
    bisect([0.2, 4.0], 30, value, rising)
}

/// Fits a slab about a place; with its misfit per voxel.
fn slab_at(
    view: &View<'_>,
    place: DVec3,
    normal: DVec3,
    share: f64,
    materials: [MaterialId; 3],
    seen: &mut Vec<Seen>,
) -> Option<(f64, Slab)> {
    // What blurs into the window may lie beyond it.
    view.ball(place, WINDOW + TAINTED, seen);
    let start = Start { at: DVec3::ZERO, normal, half: half_of(share) };
    let ends = strange(seen, normal, start.half, materials.map(|m| view.mean(m, place)));
    let samples: Vec<Sample> = seen
        .iter()
        .map(|s| s.sample)
        .filter(|s| s.at.length_squared() < WINDOW * WINDOW)
        .filter(|s| ends.iter().all(|e| e.distance_squared(s.at) > TAINTED * TAINTED))
        .collect();
    if samples.len() < FEWEST {
        return None;
    }
    let (levels, noise) = levels(view, place, materials);
    let slab = fit_slab(&samples, start, levels, noise)?;
    let good = explains(slab.fit.chi2, slab.fit.strain, samples.len(), 1.0)
        && (THINNEST..THICKEST).contains(&slab.half())
        && slab.half_sigma() < UNSURE
        && slab.curvature() < MOST_CURVED
        && slab.taper() < MOST_TAPERED
        && slab.middle().length() < 1.0;
    good.then(|| ((slab.fit.chi2 + slab.fit.strain) / samples.len() as f64, slab))
}

/// Fits a ball about a place; with its misfit per voxel.
fn ball_at(
    view: &View<'_>,
    place: DVec3,
    peak: f64,
    materials: [MaterialId; 2],
    seen: &mut Vec<Seen>,
) -> Option<(f64, Ball)> {
    let radius = size_of(peak.clamp(0.1, 0.99), |r| share(r, 0.0)[0]);
    if radius > LARGEST {
        return None;
    }
    view.ball(place, radius + 2.2, seen);
    let samples: Vec<Sample> = seen.iter().map(|s| s.sample).collect();
    if samples.len() < FEWEST {
        return None;
    }
    let (levels, noise) = levels(view, place, materials);
    let ball = fit_ball(&samples, DVec3::ZERO, radius, levels, noise)?;
    let good = explains(ball.fit.chi2, ball.fit.strain, samples.len(), 1.0)
        && (SMALLEST..LARGEST).contains(&ball.radius())
        && ball.radius_sigma() < UNSURE
        && ball.centre().length() < 1.0;
    good.then(|| ((ball.fit.chi2 + ball.fit.strain) / samples.len() as f64, ball))
}

/// What something thin says of a voxel.
struct Claim {
    /// z, y, x.
    voxel: [u32; 3],
    /// The smallest counts.
    score: f64,
    seed: [usize; 3],
    material: MaterialId,
}

/// What is said of the voxels of the slices `core`.
fn claims(view: &View<'_>, seed: &Seed, thin: &Thin, core: &Range<usize>) -> Vec<Claim> {
    let place = DVec3::from(seed.voxel.map(|c| c as f64)) + view.units.voxel(seed.ridge.offset);
    let radius = match thin {
        Thin::Slab(slab, _) => ASIDE.hypot(slab.half() + BEYOND).max(RIM) + 1.0,
        Thin::Ball(ball, _) => ball.radius() + AROUND + 1.0,
        Thin::Grey(..) => BY_GREY,
    };
    let (size, reach) = (view.slab.size(), view.units.voxel(DVec3::splat(radius)));
    let range = |a: usize| {
        (place[a] - reach[a]).ceil().max(0.0) as usize
            ..((place[a] + reach[a]).floor() + 1.0).clamp(0.0, size[a] as f64) as usize
    };
    let z = range(2).start.max(core.start)..range(2).end.min(core.end);
    let voxels = z.flat_map(|z| range(1).flat_map(move |y| range(0).map(move |x| [x, y, z])));
    let mut out = Vec::new();
    for voxel in voxels {
        let at = view.units.of(DVec3::from(voxel.map(|c| c as f64)) - place);
        let Some((score, material, about)) = says(view, thin, at, voxel) else { continue };
        // What is of another material belongs to something else.
        if !view.is_uncertain(voxel) && !about.contains(&view.label(voxel)) {
            continue;
        }
        let [x, y, z] = voxel.map(|c| c as u32);
        out.push(Claim { voxel: [z, y, x], score, seed: seed.voxel, material });
    }
    out
}

/// What is said of a place (blur units from the window's middle): how surely, its material, and those it is about.
fn says<'a>(
    view: &View<'_>,
    thin: &'a Thin,
    at: DVec3,
    voxel: [usize; 3],
) -> Option<(f64, MaterialId, &'a [MaterialId])> {
    match thin {
        Thin::Slab(slab, materials) => {
            let [first, second] = slab.distances(at);
            let aside = slab.aside(at);
            if aside > ASIDE {
                let material = (aside < RIM && first > 0.0 && second < 0.0)
                    .then(|| rim(view, slab, *materials, at, voxel))??;
                return Some((20.0 + aside, material, materials));
            }
            if first < -BEYOND || second > BEYOND {
                return None;
            }
            // Beyond a rim the slab does not go on.
            let grey = f64::from(view.slab.grey(voxel));
            if (grey - slab.grey(at)).abs() > slab.contrast() * UNLIKE {
                return None;
            }
            let material = materials[usize::from(first > 0.0) + usize::from(second > 0.0)];
            Some((aside / ASIDE, material, materials))
        }
        Thin::Ball(ball, materials) => {
            let distance = at.distance(ball.centre()) - ball.radius();
            let material = materials[usize::from(distance > 0.0)];
            (distance < AROUND).then(|| (0.5, material, &materials[..]))
        }
        Thin::Grey(ridge, materials, half) => {
            let w = ridge.normal.dot(at);
            let side = materials[if w > 0.0 { 1 } else { 2 }];
            let place = DVec3::from(voxel.map(|c| c as f64));
            let [inside, outside] = [materials[0], side].map(|m| view.mean(m, place));
            let grey = f64::from(view.slab.grey(voxel));
            let nearer = (grey - inside).abs() < (grey - outside).abs();
            (nearer && at.length() < BY_GREY && w.abs() < half + 0.8)
                .then(|| (10.0 + at.length(), materials[0], &materials[..]))
        }
    }
}

/// What a voxel beyond the rim of a slab is, if the material of its sides has closed around the rim there.
fn rim(
    view: &View<'_>,
    slab: &Slab,
    materials: [MaterialId; 3],
    at: DVec3,
    voxel: [usize; 3],
) -> Option<MaterialId> {
    let [before, within, after] = materials;
    let label = view.label(voxel);
    if label == within || (label != before && label != after) {
        return None;
    }
    let outwards = slab.outwards(at)?;
    let place = DVec3::from(voxel.map(|c| c as f64));
    let steps = (RUN / 0.5) as usize;
    let next = (1..=steps)
        .filter_map(|k| label_at(view, place + view.units.voxel(outwards * (0.5 * k as f64))))
        .find(|l| *l != label)?;
    if materials.contains(&next) {
        return None;
    }
    let grey = f64::from(view.slab.grey(voxel));
    let inside = slab.grey(at);
    Some(if (grey - inside).abs() < (grey - view.mean(next, place)).abs() { within } else { next })
}

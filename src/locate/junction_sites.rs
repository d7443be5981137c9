//! Junction curves: where they are looked for, and the wedge fits there.
//!
//! Seeds are the junction cells (three labels among eight corners) that thinning left, one fit for those of a block.
//! The start needs the published result alone (`../shared/notes/junctions.md`, "Method" 1): the mean of the
//! block's junction cells, the direction in which those around spread most, and a ray per pair towards the mean of its
//! crossings around. Where that leads nowhere and patches are known, the line on which their planes meet (`flat_starts`).
//! Then rough fits in a small ball, and fits in a larger one with places on the flanks where patches
//! know the interface of a pair alone; planar first, then curved.
//!
//! Acceptance: the fit explains the grey values; the curve lies in the ball, its place is known; rays do not
//! merge; sigma is the scan's. A ball without a junction fits well, but leaves the place along an interface open.

use std::ops::Range;

use glam::DVec3;
use nalgebra::{Matrix3, SymmetricEigen};
use rayon::prelude::*;

use super::flanks::{FlatIndex, flanks_of};
use super::flat_starts::{self, meeting, ordered};
use super::sheet::{LevelPrior, Sample};
use super::site::{Model, Site};
use super::view::{Seen, View};
use super::wedge::{EDGE, Flank, JUNCTION, Prior, SMALLEST_ANGLE, Stage, Wedge, WedgeFit, most_reduced};
use crate::grid::MaterialId;

/// Voxels along a block whose junction cells share a fit.
const BLOCK: usize = 5;
/// Radius of the ball of the rough fits and of the later ones, blur units.
const ROUGH: f64 = 3.0;
const FULL: f64 = 4.2;
/// Later fits look so far along the curve, blur units, but not where it has turned by more than this (radians): it is
/// the longer look that tells where a weak interface ends at a strong one.
const ALONG: f64 = 5.0;
const TURN: f64 = 0.5;
/// It reaches to where a narrow sector is at least twice this wide, but no farther than the second, blur units: where a
/// material is narrower its grey value is not seen.
const HALF_WIDTH: f64 = 2.1;
const WIDEST: f64 = 7.0;
/// Radii of the balls of the rough fits from patches, blur units.
const COARSE: [f64; 2] = [7.0, 5.5];
/// How far around a seed labels are looked at, voxels.
const AROUND: f64 = 7.0;
/// Other sheets are nowhere nearer to the curve than this, blur units: nearer labels that contradict a rough wedge may be right.
const OTHERS: f64 = 2.5;
/// So many labels of voxels within the window may contradict.
const MOST_WRONG: usize = 4;
/// A fit that leaves so many times the chi squared that may be left is given up: the last rough one, planar ones and curved ones.
/// Of fits that were accepted in the end, on phantoms and on the engine, one rough one of 280 left more, and planar ones at most 45 times.
const HOPELESS: [f64; 3] = [16.0, 64.0, 8.0];
/// Fewest voxels of a fit.
const FEWEST: usize = 120;
/// Junction cells around a seed that tell the direction lie within this distance, voxels.
const SPREAD: f64 = 6.0;
/// Standard deviation of grey levels, as a share of the smallest contrast, and of the largest, beside what the levels say:
/// what a dense material does to the scan it does to its neighbours.
const LEVEL: [f64; 2] = [0.03, 0.01];
/// Standard deviation of the logarithm of sigma.
const SIGMA: f64 = 0.1;
/// Standard deviation of curvatures, per blur unit.
const CURVATURE: f64 = 0.05;
/// The models' own errors, as a share of the largest contrast.
const MODEL: f64 = 0.0005;
/// Largest standard deviation of the curve's place, blur units.
const UNSURE: f64 = 0.4;
/// The curve may move this far from its seed, and from where patches say it is, blur units.
const FARTHEST: f64 = 5.0;
const FOUND: f64 = 2.5;

/// Fits the junction curves whose blocks begin in the slices `core`, from what labels show.
#[must_use]
pub(super) fn junction_sites(view: &View<'_>, core: Range<usize>) -> Vec<Site> {
    let by_labels = |seed: &Seed| fit_from(view, seed, &start(view, seed)?);
    seeds_of(view, &core).par_iter().filter_map(by_labels).collect()
}

/// The same from where patches' planes meet, for seeds from which none of `known` was found.
#[must_use]
pub(super) fn more_junctions(
    view: &View<'_>,
    flats: &FlatIndex<'_>,
    known: &[Site],
    core: &Range<usize>,
) -> Vec<Site> {
    let order = |a: DVec3, b: DVec3| a.z.total_cmp(&b.z).then(a.y.total_cmp(&b.y)).then(a.x.total_cmp(&b.x));
    let mut found: Vec<DVec3> = known.iter().map(|site| site.middle).collect();
    found.sort_by(|a, b| order(*a, *b));
    let is_new = |seed: &&Seed| found.binary_search_by(|at| order(*at, seed.at)).is_err();
    let seeds = seeds_of(view, core);
    seeds.par_iter().filter(is_new).filter_map(|seed| by_patches(view, flats, seed)).collect()
}

/// The seeds of blocks that begin in the slices `core`.
fn seeds_of(view: &View<'_>, core: &Range<usize>) -> Vec<Seed> {
    let last = view.slab.size()[2] - 1;
    let blocks = blocks_of(core, BLOCK).into_par_iter();
    blocks.flat_map_iter(|b| seeds(view, b * BLOCK..((b + 1) * BLOCK).min(last))).collect()
}

/// The layers of blocks (of `side` slices) that begin in the slices `core`.
#[must_use]
pub(super) fn blocks_of(core: &Range<usize>, side: usize) -> Range<usize> {
    core.start.div_ceil(side)..core.end.div_ceil(side)
}

/// Junction cells of a block with the same three materials.
struct Seed {
    materials: [MaterialId; 3],
    /// Their mean, voxels.
    at: DVec3,
}

/// The materials at the corners of the cell with this lowest voxel, ascending; `None` beyond the volume.
fn materials_of(view: &View<'_>, low: [usize; 3]) -> Option<Vec<MaterialId>> {
    let size = view.slab.size();
    if (0..3).any(|a| low[a] + 1 >= size[a]) || !view.slab.slices().contains(&(low[2] + 1)) {
        return None;
    }
    let mut out: Vec<MaterialId> = Vec::with_capacity(4);
    for c in 0..8 {
        let label = view.label([low[0] + (c & 1), low[1] + (c >> 1 & 1), low[2] + (c >> 2)]);
        if let Err(at) = out.binary_search(&label) {
            out.insert(at, label);
        }
    }
    Some(out)
}

/// The seeds of a layer of blocks.
fn seeds(view: &View<'_>, slices: Range<usize>) -> Vec<Seed> {
    let mut cells: Vec<([usize; 2], [MaterialId; 3], DVec3)> = Vec::new();
    for z in slices {
        let mut last = None;
        let mut rows: Vec<[usize; 2]> = Vec::new();
        super::crossing_edges::crossing_edges(view.labels, z, |[x, y, _], _| {
            // Cells that have this edge among their lower ones; every junction cell has such an edge in one of
            // its two lower planes of edges.
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                if x >= dx && y >= dy {
                    rows.push([y - dy, x - dx]);
                }
            }
            last = Some(());
        });
        if last.is_none() {
            continue;
        }
        rows.sort_unstable();
        rows.dedup();
        for [y, x] in rows {
            if let Some(m) = materials_of(view, [x, y, z])
                && let [a, b, c] = m[..]
            {
                let at = DVec3::new(x as f64, y as f64, z as f64) + 0.5;
                cells.push(([y / BLOCK, x / BLOCK], [a, b, c], at));
            }
        }
    }
    cells.sort_by_key(|c| (c.0, c.1));
    cells
        .chunk_by(|a, b| (a.0, a.1) == (b.0, b.1))
        .map(|group| Seed {
            materials: group[0].1,
            at: group.iter().map(|c| c.2).sum::<DVec3>() / group.len() as f64,
        })
        .collect()
}

/// Where blocks in these slices have junction cells, voxels.
#[must_use]
pub(super) fn junction_places(view: &View<'_>, slices: Range<usize>) -> Vec<DVec3> {
    let held = view.slab.slices();
    let blocks = slices.start / BLOCK..slices.end.div_ceil(BLOCK);
    let of = |b: usize| b * BLOCK..((b + 1) * BLOCK).min(view.slab.size()[2] - 1);
    let blocks: Vec<Range<usize>> =
        blocks.map(of).filter(|r| held.start <= r.start && r.end < held.end).collect();
    blocks.into_par_iter().flat_map_iter(|r| seeds(view, r)).map(|seed| seed.at).collect()
}

/// Direction of the curve, and rays with the sectors between them (indices into the seed's materials).
struct Start {
    direction: DVec3,
    rays: [DVec3; 3],
    sectors: [usize; 3],
}

fn start(view: &View<'_>, seed: &Seed) -> Option<Start> {
    let (size, slices) = (view.slab.size(), view.slab.slices());
    let low: [usize; 3] = std::array::from_fn(|a| (seed.at[a] - AROUND).max(0.0) as usize);
    let end: [usize; 3] = std::array::from_fn(|a| ((seed.at[a] + AROUND) as usize + 1).min(size[a]));
    let mut spread: Vec<DVec3> = Vec::new();
    let mut sums = [[DVec3::ZERO; 3]; 3];
    let index = |m: MaterialId| seed.materials.iter().position(|&other| other == m);
    for z in low[2].max(slices.start)..end[2].min(slices.end) {
        for y in low[1]..end[1] {
            for x in low[0]..end[0] {
                let here = view.label([x, y, z]);
                let voxel = DVec3::new(x as f64, y as f64, z as f64);
                let mut differs = false;
                for axis in 0..3 {
                    let mut to = [x, y, z];
                    to[axis] += 1;
                    if to[axis] >= end[axis].min(if axis == 2 { slices.end } else { size[axis] }) {
                        continue;
                    }
                    let there = view.label(to);
                    if there == here {
                        continue;
                    }
                    differs = true;
                    let at = voxel + 0.5 * DVec3::AXES[axis] - seed.at;
                    if at.length() <= AROUND
                        && let (Some(i), Some(j)) = (index(here), index(there))
                    {
                        sums[i.min(j)][i.max(j)] += view.units.of(at);
                    }
                }
                let cell = voxel + 0.5 - seed.at;
                if cell.length() <= SPREAD
                    && (differs || here != seed.materials[0])
                    && materials_of(view, [x, y, z]).is_some_and(|m| m[..] == seed.materials)
                {
                    spread.push(view.units.of(cell));
                }
            }
        }
    }
    let mean = spread.iter().copied().sum::<DVec3>() / spread.len().max(1) as f64;
    let mut matrix = Matrix3::<f64>::zeros();
    for p in &spread {
        let d = *p - mean;
        let d = nalgebra::Vector3::new(d.x, d.y, d.z);
        matrix += d * d.transpose();
    }
    let eigen = SymmetricEigen::new(matrix);
    let v = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    let direction = DVec3::new(v[0], v[1], v[2]).try_normalize()?;
    let mut rays = [DVec3::ZERO; 3];
    for (ray, pair) in rays.iter_mut().zip([[0, 1], [0, 2], [1, 2]]) {
        let sum = sums[pair[0]][pair[1]];
        *ray = (sum - direction * sum.dot(direction)).try_normalize()?;
    }
    let (rays, sectors) = ordered(direction, rays)?;
    Some(Start { direction, rays, sectors })
}

/// The fit of a seed from where patches' planes meet, coarse to fine.
fn by_patches(view: &View<'_>, flats: &FlatIndex<'_>, seed: &Seed) -> Option<Site> {
    let found = meeting(view, flats, seed.at, seed.materials)?;
    let (rays, sectors) = ordered(found.direction, found.rays)?;
    let middle = seed.at + view.units.voxel(found.at);
    // What a pass reads beyond its slices is enough for the widest window up to here.
    let most = FOUND.min(flat_starts::FARTHEST + 0.5 - found.at.length());
    let materials = sectors.map(|k| seed.materials[k]);
    let prior = prior(view, middle, materials);
    let (mut seen, mut samples): (Vec<Seen>, Vec<Sample>) = (Vec::new(), Vec::new());
    let mut wedge =
        Wedge::<3, JUNCTION>::new(DVec3::ZERO, found.direction, rays, prior.levels.map(|l| l.mean));
    for radius in COARSE {
        view.samples(middle, wedge.origin, radius, &mut seen, &mut samples);
        let rough = wedge.fit(&samples, &[], &prior, Stage::Rough)?;
        wedge = rough.wedge.recentred(0.0);
        if wedge.origin.length() > most {
            return None;
        }
    }
    finish(view, flats, (middle, most), wedge, materials, &prior)
}

/// The fit from a start about a seed.
fn fit_from(view: &View<'_>, seed: &Seed, start: &Start) -> Option<Site> {
    let (middle, most) = (seed.at, FARTHEST);
    let materials = start.sectors.map(|k| seed.materials[k]);
    let prior = prior(view, middle, materials);
    let levels = prior.levels.map(|l| l.mean);
    let mut seen: Vec<Seen> = Vec::new();
    let mut samples: Vec<Sample> = Vec::new();
    let mut wedge = Wedge::<3, JUNCTION>::new(DVec3::ZERO, start.direction, start.rays, levels);
    for pass in 0..2 {
        view.samples(middle, wedge.origin, ROUGH, &mut seen, &mut samples);
        let rough = wedge.fit(&samples, &[], &prior, Stage::Rough)?;
        wedge = rough.wedge.recentred(0.0);
        if wedge.origin.length() > most || (pass == 1 && is_hopeless(&rough, &prior, HOPELESS[0])) {
            return None;
        }
    }
    finish(view, &FlatIndex::new(&[]), (middle, most), wedge, materials, &prior)
}

/// What is known before the fits at a place.
fn prior(view: &View<'_>, at: DVec3, materials: [MaterialId; 3]) -> Prior<3> {
    let levels: [LevelPrior; 3] = materials.map(|m| view.level(m, at));
    let mut sorted = levels.map(|l| l.mean);
    sorted.sort_by(f64::total_cmp);
    let smallest = (sorted[1] - sorted[0]).min(sorted[2] - sorted[1]);
    let level = (LEVEL[0] * smallest).hypot(LEVEL[1] * (sorted[2] - sorted[0]));
    Prior {
        levels: levels.map(|l| LevelPrior { mean: l.mean, sigma: l.sigma.hypot(level) }),
        reading: view.reading(&materials, MODEL),
        log_sigma: SIGMA,
        curvature: CURVATURE,
        bends: [None; 3],
    }
}

/// Fits sites again, with patches on their flanks, those whose window's middle lies in the slices `core`; one that
/// then explains less stays as it was.
#[must_use]
pub(super) fn refine(
    view: &View<'_>,
    flats: &FlatIndex<'_>,
    sites: &[Site],
    core: &Range<usize>,
) -> Vec<Site> {
    let own = |site: &&Site| core.contains(&(site.middle.z.max(0.0) as usize));
    let own: Vec<&Site> = sites.iter().filter(own).collect();
    own.par_iter()
        .map(|&site| {
            let Model::Junction(fit) = &site.model else { return site.clone() };
            let prior = prior(view, site.at, site.materials);
            finish(view, flats, (site.middle, FARTHEST), fit.wedge.recentred(0.0), site.materials, &prior)
                .unwrap_or_else(|| site.clone())
        })
        .collect()
}

/// The later fits, from a rough one; the site, if it is accepted.
fn finish(
    view: &View<'_>,
    flats: &FlatIndex<'_>,
    (middle, most): (DVec3, f64),
    mut wedge: Wedge<3, JUNCTION>,
    materials: [MaterialId; 3],
    prior: &Prior<3>,
) -> Option<Site> {
    let mut seen: Vec<Seen> = Vec::new();
    let mut samples: Vec<Sample> = Vec::new();
    let mut last: Option<WedgeFit<3, JUNCTION>> = None;
    let mut on: Vec<Flank> = Vec::new();
    for pass in 0..2 {
        let along = ALONG.min(TURN / wedge.bend().max(1e-9));
        let full = wide(&wedge);
        view.samples(middle, wedge.origin, full.hypot(along), &mut seen, &mut samples);
        // In a thin wall the sheet of its other side is near.
        let certain =
            |(s, sample): &(&Seen, &Sample)| !s.uncertain && wedge.section(sample.at).0.length() > OTHERS;
        let mut others = wedge.others(&materials, seen.iter().zip(&samples).filter(certain));
        let is_within = |at: DVec3| {
            let (r, z) = wedge.section(at);
            r.length_squared() <= full * full && z.abs() <= along
        };
        // But if it is within the window, as where the curve ends, there is no such wedge: leaving much out would hide that.
        if others.iter().filter(|(at, _)| is_within(*at)).count() > MOST_WRONG {
            others.clear();
        }
        samples.retain(|s| {
            is_within(s.at) && others.iter().all(|(p, reach)| p.distance_squared(s.at) > reach * reach)
        });
        if samples.len() < FEWEST {
            return None;
        }
        let bends = flanks_of(view, flats, middle, &wedge, &materials, &mut on);
        let prior = &Prior { bends, ..*prior };
        let planar = wedge.fit(&samples, &on, prior, Stage::Planar)?;
        if is_hopeless(&planar, prior, HOPELESS[1]) {
            return None;
        }
        let best = planar.curved(&samples, &on, prior);
        if is_hopeless(&best, prior, HOPELESS[2]) {
            return None;
        }
        wedge = best.wedge.recentred(0.0);
        let still = best.wedge.apex(0.0).length() < 0.1;
        last = Some(best);
        // What a pass reads beyond its slices is enough up to here.
        if wedge.origin.length() > most {
            return None;
        }
        if pass == 0 && still {
            break;
        }
    }
    let fit = last?;
    let accepted = fit.wedge.apex(0.0).length() < 1.0
        && fit.wedge.origin.length() <= most
        && fit.apex_sigma(0.0)[1] < UNSURE
        && fit.explains(&prior.reading, range_of(&prior.levels))
        && fit.wedge.sigma().ln().abs() < 2.5 * SIGMA
        && fit.wedge.angles().iter().all(|a| *a > SMALLEST_ANGLE);
    if !accepted || !needs_all(&fit, &samples, prior) {
        return None;
    }
    let at = middle + view.units.voxel(fit.wedge.point(0.0));
    Some(Site { middle, at, materials, model: Model::Junction(Box::new(fit)) })
}

/// Whether a fit leaves so many times what may be left that a better middle will not mend it.
fn is_hopeless(fit: &WedgeFit<3, JUNCTION>, prior: &Prior<3>, times: f64) -> bool {
    fit.reduced() > times * most_reduced(fit.samples, &prior.reading, range_of(&prior.levels))
}

/// Radius of the window about a wedge, blur units: where its narrowest sector is wide enough for its material to be seen.
fn wide(wedge: &Wedge<3, JUNCTION>) -> f64 {
    let narrowest = wedge.angles().into_iter().fold(f64::INFINITY, f64::min);
    (HALF_WIDTH / (0.5 * narrowest).tan()).clamp(FULL, WIDEST)
}

/// Sectors narrower than this must be needed, radians: a blurred step between two materials passes the level of one
/// between them, and labels there may show it.
const NARROW: f64 = 1.05;
/// By how much the grey values must be explained better with it than without, chi squared.
const EVIDENCE: f64 = 50.0;

/// Whether the grey values show the narrowest sector: whether its two neighbours, meeting in one sheet in its place, explain them less.
fn needs_all(fit: &WedgeFit<3, JUNCTION>, samples: &[Sample], prior: &Prior<3>) -> bool {
    let angles = fit.wedge.angles();
    let i = (0..3).fold(0, |least, i| if angles[i] < angles[least] { i } else { least });
    if angles[i] > NARROW {
        return true;
    }
    let (next, last) = ((i + 1) % 3, (i + 2) % 3);
    let rays = fit.wedge.rays(0.0);
    let Some(instead) = (rays[i] + rays[next]).try_normalize() else { return true };
    let levels = [prior.levels[next], prior.levels[last]];
    let (origin, direction) = (fit.wedge.point(0.0), fit.wedge.direction(0.0));
    let wedge = Wedge::<2, EDGE>::new(origin, direction, [instead, rays[last]], levels.map(|l| l.mean));
    let Prior { reading, log_sigma, curvature, .. } = *prior;
    let prior = Prior { levels, reading, log_sigma, curvature, bends: [None; 2] };
    let without = wedge.fit(samples, &[], &prior, Stage::Planar).map(|w| w.or_curved(samples, &[], &prior));
    without.is_none_or(|w| w.fit.chi2 + w.fit.strain > fit.fit.chi2 + EVIDENCE)
}

/// Difference of the largest and the smallest level.
fn range_of(levels: &[LevelPrior]) -> f64 {
    let ends =
        levels.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], l| [a.min(l.mean), b.max(l.mean)]);
    ends[1] - ends[0]
}

//! Junction curves: where they are looked for, and where the fits ([`junction_fit`](super::junction_fit)) start.
//!
//! Seeds are the junction cells (three labels among eight corners) that thinning left, one fit for those of a block.
//! The start needs the published result alone (`../shared/notes/junctions.md`, "Method" 1): the mean of the
//! block's junction cells, the direction in which those around spread most, and a ray per pair towards the mean of its
//! crossings around. Where that leads nowhere and patches are known, the line on which their planes meet (`flat_starts`).

use std::cmp::Ordering;
use std::ops::Range;

use glam::DVec3;
use nalgebra::{Matrix3, SymmetricEigen};
use rayon::prelude::*;

use super::crossing_edges::{differing_from, junction_cells};
use super::flanks::FlatIndex;
use super::flat_starts::{self, meeting, ordered};
use super::junction_fit::{Asked, finish, prior, refit, rough};
use super::site::{Model, Site};
use super::view::View;
use super::wedge::Wedge;
use crate::classify::{WORD, set_bits};
use crate::grid::MaterialId;

/// Voxels along a block whose junction cells share a fit.
const BLOCK: usize = 5;
/// How far around a seed labels are looked at, voxels.
const AROUND: f64 = 7.0;
/// Junction cells around a seed that tell the direction lie within this distance, voxels.
const SPREAD: f64 = 6.0;
/// The curve may move this far from its seed, if a sector is narrow and if none is, and from where patches say it is, blur units.
const FARTHEST: f64 = 9.0;
const NEAREST: f64 = 5.0;
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
    flats: &FlatIndex,
    known: &[Site],
    core: &Range<usize>,
) -> Vec<Site> {
    let mut found: Vec<DVec3> = known.iter().map(|site| site.middle).collect();
    found.sort_by(|a, b| by_place(*a, *b));
    let is_new = |seed: &&Seed| found.binary_search_by(|at| by_place(*at, seed.at)).is_err();
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
    let [width, height, _] = view.slab.size();
    for z in slices.filter(|z| view.slab.slices().contains(&(z + 1))) {
        for y in 0..height.saturating_sub(1) {
            for from in (0..width.saturating_sub(1)).step_by(WORD) {
                for x in set_bits(junction_cells(view.labels, [from, y, z])).map(|k| from + k) {
                    if let Some(m) = materials_of(view, [x, y, z])
                        && let [a, b, c] = m[..]
                    {
                        let at = DVec3::new(x as f64, y as f64, z as f64) + 0.5;
                        cells.push(([y / BLOCK, x / BLOCK], [a, b, c], at));
                    }
                }
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
    // Of the window's rows, no wider than a word.
    let within = (1u64 << (end[0].saturating_sub(low[0])).min(WORD - 1)) - 1;
    for z in low[2].max(slices.start)..end[2].min(slices.end) {
        for y in low[1]..end[1] {
            let ends = [within >> 1, if y + 1 < end[1] { within } else { 0 }];
            let above = z + 1 < end[2].min(slices.end);
            let row = [low[0], y, z];
            let differs: [u64; 3] = std::array::from_fn(|axis| match axis {
                2 if !above => 0,
                2 => within & differing_from(view.labels, row, axis),
                _ => ends[axis] & differing_from(view.labels, row, axis),
            });
            let junctions =
                if slices.contains(&(z + 1)) { within & junction_cells(view.labels, row) } else { 0 };
            for k in set_bits(differs[0] | differs[1] | differs[2] | junctions) {
                let x = low[0] + k;
                let here = view.label([x, y, z]);
                let voxel = DVec3::new(x as f64, y as f64, z as f64);
                for axis in (0..3).filter(|&axis| differs[axis] >> k & 1 == 1) {
                    let mut to = [x, y, z];
                    to[axis] += 1;
                    let there = view.label(to);
                    let at = voxel + 0.5 * DVec3::AXES[axis] - seed.at;
                    if at.length() <= AROUND
                        && let (Some(i), Some(j)) = (index(here), index(there))
                    {
                        sums[i.min(j)][i.max(j)] += view.units.of(at);
                    }
                }
                let cell = voxel + 0.5 - seed.at;
                if junctions >> k & 1 == 1
                    && (here != seed.materials[0] || differs.iter().any(|d| d >> k & 1 == 1))
                    && cell.length() <= SPREAD
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
fn by_patches(view: &View<'_>, flats: &FlatIndex, seed: &Seed) -> Option<Site> {
    let found = meeting(view, flats, seed.at, seed.materials)?;
    let (rays, sectors) = ordered(found.direction, found.rays)?;
    let middle = seed.at + view.units.voxel(found.at);
    // What a pass reads beyond its slices is enough for the widest window up to here.
    let most = FOUND.min(flat_starts::FARTHEST + 0.5 - found.at.length());
    let materials = sectors.map(|k| seed.materials[k]);
    let prior = prior(view, middle, materials);
    let levels = prior.levels.map(|l| l.mean);
    let start = Wedge::new(DVec3::ZERO, found.direction, rays, levels);
    let wedge = rough(view, middle, start, &prior, [most; 2])?;
    finish(view, &Asked { place: (middle, most), materials, prior, flats }, &wedge)
}

/// The fit from a start about a seed.
fn fit_from(view: &View<'_>, seed: &Seed, start: &Start) -> Option<Site> {
    let (middle, most) = (seed.at, FARTHEST);
    let materials = start.sectors.map(|k| seed.materials[k]);
    let prior = prior(view, middle, materials);
    let levels = prior.levels.map(|l| l.mean);
    let start = Wedge::new(DVec3::ZERO, start.direction, start.rays, levels);
    let wedge = rough(view, middle, start, &prior, [most, NEAREST])?;
    finish(view, &Asked { place: (middle, most), materials, prior, flats: &FlatIndex::default() }, &wedge)
}

/// An order of places.
fn by_place(a: DVec3, b: DVec3) -> Ordering {
    a.z.total_cmp(&b.z).then(a.y.total_cmp(&b.y)).then(a.x.total_cmp(&b.x))
}

/// Fits sites again, with patches on their flanks, those whose window's middle lies in the slices `core`; one that
/// then explains less stays as it was.
#[must_use]
pub(super) fn refine(view: &View<'_>, flats: &FlatIndex, sites: &[Site], core: &Range<usize>) -> Vec<Site> {
    let own = |site: &&Site| core.contains(&(site.middle.z.max(0.0) as usize));
    let own: Vec<&Site> = sites.iter().filter(own).collect();
    own.par_iter()
        .map(|&site| {
            let (prior, place) = (prior(view, site.at, site.materials), (site.middle, FARTHEST));
            let asked = Asked { place, materials: site.materials, prior, flats };
            let again = match &site.model {
                Model::Junction(fit) => refit(view, &asked, &fit.wedge.recentred(0.0)),
                // Knees do without patches.
                Model::Knee(_) | Model::Edge(_) | Model::Corner(_) => None,
            };
            again.unwrap_or_else(|| site.clone())
        })
        .collect()
}

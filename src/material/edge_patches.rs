//! Bundles of parallel grey profiles across clean interfaces, a sample of those that there are.
//!
//! A *patch* is [`ROWS`] x [`ROWS`] neighbouring profiles of [`LENGTH`] voxels along the lattice axis that is
//! nearest to the interface's normal, around a voxel next to the crossing. It is a candidate if both ends of
//! its middle profile lie on the plateaus of two different materials. Of all candidates of an axis those with
//! the [`KEPT`] lowest hashes of their place are kept: a fair sample that does not depend on slabs or threads.

use std::ops::Range;

use rayon::prelude::*;

use super::sampling::{POINTS, SampleGrid};
use super::table::{Material, MaterialTable};
use crate::volume::{Sample, Slab};

/// Half-length of a profile, in voxels.
pub(super) const REACH: usize = 6;
/// Voxels of a profile.
pub(super) const LENGTH: usize = 2 * REACH + 1;
/// How far a patch goes to the sides, in voxels.
pub(super) const SIDE: usize = 2;
/// Profiles of a patch along each side.
pub(super) const ROWS: usize = 2 * SIDE + 1;
/// Patches kept per axis: each gives sigma to about 2.5 % where noise is 4 % of the contrast.
const KEPT: usize = 256;
/// Ends must be this close to a material's mean, as a share of the profile's contrast.
pub(super) const PLATEAU: f64 = 0.12;

/// A bundle of profiles.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Patch {
    /// Orders patches by chance, the same for any slabs.
    hash: u64,
    /// The lattice axis of the profiles.
    pub(super) axis: usize,
    /// Positions in the table of the materials at the near and the far end.
    pub(super) materials: [usize; 2],
    /// Where the middle profile crosses halfway, in voxels from its middle voxel (0 to 1).
    pub(super) crossing: f64,
    /// Grey values: profile after profile, sides in the order of [`sides`].
    pub(super) grey: Box<[f32]>,
}

/// The two axes across `axis`, in the order in which a patch has them.
pub(super) fn sides(axis: usize) -> [usize; 2] {
    [(axis + 1) % 3, (axis + 2) % 3]
}

/// The sample so far.
#[derive(Debug, Clone)]
pub(super) struct Patches<'a> {
    materials: &'a MaterialTable,
    spacing: [f64; 3],
    grid: SampleGrid,
    kept: [Vec<Patch>; 3],
    /// Candidates seen along each axis.
    seen: [usize; 3],
}

/// A candidate, not copied yet.
struct Candidate {
    hash: u64,
    voxel: [usize; 3],
    axis: usize,
    materials: [usize; 2],
    crossing: f64,
}

impl<'a> Patches<'a> {
    pub(super) fn new(size: [usize; 3], spacing: [f64; 3], materials: &'a MaterialTable) -> Self {
        let grid = SampleGrid::new(size, POINTS);
        Self { materials, spacing, grid, kept: Default::default(), seen: [0; 3] }
    }

    /// Looks for patches through the grid points in the slices `core`; `slab` must hold [`REACH`] + 1 more
    /// slices on both sides, as far as there are any.
    pub(super) fn add<S: Sample>(&mut self, slab: Slab<'_, S>, core: Range<usize>) {
        let (materials, spacing, grid) = (self.materials, self.spacing, &self.grid);
        let [across, down, _] = grid.points;
        let planes = grid.within(core);
        let mut found: Vec<Candidate> = (0..down * planes.len())
            .into_par_iter()
            .flat_map_iter(|i| {
                let (y, z) = (grid.at(i % down), grid.at(planes.start + i / down));
                (0..3).flat_map(move |axis| {
                    let steps = Crossings::new(slab, [y, z], axis);
                    let xs = (0..across).map(|i| grid.at(i)).filter(move |&x| steps.is_one(x));
                    xs.filter_map(move |x| candidate(slab, spacing, materials, [x, y, z], axis))
                })
            })
            .collect();
        found.sort_unstable_by_key(|c| c.hash);
        for axis in 0..3 {
            self.seen[axis] += found.iter().filter(|c| c.axis == axis).count();
            let kept = &mut self.kept[axis];
            let new = found.iter().filter(|c| c.axis == axis).take(KEPT);
            kept.extend(new.map(|c| Patch::copy(slab, c)));
            kept.sort_unstable_by_key(|patch| patch.hash);
            kept.truncate(KEPT);
        }
    }

    /// The sample, each patch with the number of candidates that it stands for.
    pub(super) fn finish(self) -> Vec<(Patch, f64)> {
        let Self { kept, seen, .. } = self;
        let weighted = kept.into_iter().zip(seen).flat_map(|(kept, seen)| {
            let weight = seen as f64 / kept.len().max(1) as f64;
            kept.into_iter().map(move |patch| (patch, weight))
        });
        weighted.collect()
    }
}

impl Patch {
    fn copy<S: Sample>(slab: Slab<'_, S>, candidate: &Candidate) -> Self {
        let &Candidate { hash, voxel, axis, materials, crossing } = candidate;
        let [b, c] = sides(axis);
        let grey = (0..ROWS * ROWS * LENGTH).map(|i| {
            let mut at = voxel;
            at[axis] = at[axis] + i % LENGTH - REACH;
            at[b] = at[b] + i / LENGTH % ROWS - SIDE;
            at[c] = at[c] + i / (LENGTH * ROWS) - SIDE;
            slab.grey(at)
        });
        Self { hash, axis, materials, crossing, grey: grey.collect() }
    }
}

/// The values that tell of most voxels of a row that they are not the last ones before a crossing.
struct Crossings<'a, S> {
    /// The rows of both ends, the voxel and the next one; none if the volume ends before.
    rows: Option<[&'a [S]; 4]>,
    /// Where in its row each of them is, from the voxel.
    offsets: [isize; 4],
}

impl<'a, S: Sample> Crossings<'a, S> {
    /// For profiles along `axis` through the row (y, z).
    fn new(slab: Slab<'a, S>, [y, z]: [usize; 2], axis: usize) -> Self {
        let steps = [-(REACH as isize), REACH as isize, 0, 1];
        let size = slab.size();
        let fits = |at: usize, n: usize| at >= REACH && at + REACH + 1 < n;
        let (rows, offsets) = match axis {
            0 => (Some([slab.row(y, z); 4]), steps),
            1 => (fits(y, size[1]).then(|| steps.map(|d| slab.row(y.wrapping_add_signed(d), z))), [0; 4]),
            _ => (fits(z, size[2]).then(|| steps.map(|d| slab.row(y, z.wrapping_add_signed(d)))), [0; 4]),
        };
        Self { rows, offsets }
    }

    /// Whether voxel x is the last one on the near side of the half.
    fn is_one(&self, x: usize) -> bool {
        let Some(rows) = self.rows else { return false };
        let value = |i: usize| {
            rows[i].get(x.wrapping_add_signed(self.offsets[i])).map_or(f64::NAN, |v| f64::from(v.to_f32()))
        };
        let [first, last, own, next] = std::array::from_fn(value);
        let half = 0.5 * (first + last);
        (own < half) != (next < half) && (own < half) == (first < half)
    }
}

/// The candidate whose middle profile runs along `axis` with `voxel` last before the crossing, if it is one.
fn candidate<S: Sample>(
    slab: Slab<'_, S>,
    spacing: [f64; 3],
    materials: &MaterialTable,
    voxel: [usize; 3],
    axis: usize,
) -> Option<Candidate> {
    let size = slab.size();
    let room = |a: usize| if a == axis { REACH } else { SIDE };
    if (0..3).any(|a| voxel[a] < room(a) || voxel[a] + room(a) + 1 >= size[a]) {
        return None;
    }
    let step = |a: usize, d: isize| {
        let mut voxel = voxel;
        voxel[a] = voxel[a].wrapping_add_signed(d);
        f64::from(slab.grey(voxel))
    };
    let along = |d: isize| step(axis, d);
    let reach = REACH as isize;
    let (first, last) = (along(-reach), along(reach));
    let contrast = (last - first).abs();
    let half = 0.5 * (first + last);
    let nearest = |v: f64| {
        let distance = |m: &Material| (m.mean - v).abs();
        let all = materials.materials().iter().enumerate();
        all.min_by(|(_, a), (_, b)| distance(a).total_cmp(&distance(b)))
    };
    let ((near, near_material), (far, far_material)) = (nearest(first)?, nearest(last)?);
    let close = |a: f64, b: f64| (a - b).abs() <= PLATEAU * contrast;
    // Both ends must be flat, or a third material may begin just beyond.
    if near == far
        || !close(first, near_material.mean)
        || !close(last, far_material.mean)
        || !close(along(1 - reach), first)
        || !close(along(reach - 1), last)
    {
        return None;
    }
    // Of the axes the one nearest to the normal: each interface gives profiles along one axis.
    let slope = |a: usize| ((step(a, 1) - step(a, -1)) / spacing[a]).abs();
    let own = slope(axis);
    if own <= 0.0 || (0..3).any(|a| slope(a) > own) {
        return None;
    }
    let crossing = (half - along(0)) / (along(1) - along(0));
    let index = (voxel[2] * size[1] + voxel[1]) * size[0] + voxel[0];
    Some(Candidate { hash: mixed(index as u64), voxel, axis, materials: [near, far], crossing })
}

/// Another number for each number, as if by chance (the finaliser of SplitMix64: Steele et al. 2014).
pub(super) fn mixed(mut n: u64) -> u64 {
    n = n.wrapping_add(0x9e37_79b9_7f4a_7c15);
    n = (n ^ (n >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    n = (n ^ (n >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    n ^ (n >> 31)
}

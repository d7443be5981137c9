//! [`Survey`]: all that finding materials needs to know of a volume, gathered slab by slab.
//!
//! One pass (two for `f32`, whose range must be known first) counts all grey values and looks at the
//! surroundings of the voxels of a regular grid of at most four million points. What it leaves is bounded
//! ([`survey_bytes`]) and does not depend on the slabs; finding materials needs no further look at the
//! volume.

use std::mem::size_of;
use std::ops::Range;

use rayon::prelude::*;
use thiserror::Error;

use super::counts::{GreyCounts, range, rows};
use super::neighbourhood::{self, DEPTH, Neighbourhood};
use super::sampling::{POINTS, SampleGrid, class_of, steps, thresholds};
use super::table::MaterialTable;
use crate::volume::{Sample, SampleType, SampleWindow, Slab, VolumeError};
use crate::with_sample_type;

/// Of so many grid points one is looked at for crossings.
const CROSSING_SHARE: usize = 8;

/// There is no memory for a survey.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
#[error("{bytes} bytes of memory for a survey of the grey values are not available")]
pub struct OutOfMemory {
    /// Bytes asked for.
    pub bytes: usize,
}

impl From<OutOfMemory> for VolumeError {
    fn from(OutOfMemory { bytes }: OutOfMemory) -> Self {
        Self::Memory { bytes }
    }
}

/// What was seen of a volume of grey values.
#[derive(Debug, Clone)]
pub struct Survey<S> {
    pub(super) size: [usize; 3],
    pub(super) grid: SampleGrid,
    pub(super) counts: GreyCounts,
    /// The points of the grid, x fastest.
    pub(super) points: Vec<Neighbourhood<S>>,
    /// Values of border voxels: all, or those on the grid's stride where the grid has one.
    pub(super) border: Vec<S>,
    /// Values of some grid points and of the next voxels along x, y and z.
    pairs: Vec<[S; 4]>,
    /// Materials given, their thresholds, and whether a voxel was nearest to each.
    pub(super) given: Option<(MaterialTable, Vec<f32>, Vec<bool>)>,
}

/// Slices that a survey must see on both sides of those it surveys.
pub const SURVEY_HALO: usize = DEPTH;

impl<S: Sample> Survey<S> {
    /// Surveys a volume in passes over a window on it, by slabs of `thickness` slices (and
    /// [`SURVEY_HALO`]). `given` are the materials if they are known.
    ///
    /// # Errors
    /// [`VolumeError`] if the volume cannot be read.
    pub fn read(
        window: &mut SampleWindow<'_, S>,
        given: Option<&MaterialTable>,
        thickness: usize,
    ) -> Result<Self, VolumeError> {
        let mut ends = NO_RANGE;
        if S::LEVELS == 0 {
            window.sweep(thickness, 0, |slab, core| {
                ends = join(ends, range(slab, core));
                Ok::<_, VolumeError>(())
            })?;
        }
        let mut survey = Self::begin(window.size(), ends, given)?;
        window.sweep(thickness, SURVEY_HALO, |slab, core| {
            survey.add(slab, core);
            Ok::<_, VolumeError>(())
        })?;
        Ok(survey)
    }

    /// Surveys a volume of which all slices are in memory.
    ///
    /// # Errors
    /// [`OutOfMemory`] if there is no room for what is kept.
    ///
    /// # Panics
    /// If the slab does not hold all slices.
    pub fn of(slab: Slab<'_, S>, given: Option<&MaterialTable>) -> Result<Self, OutOfMemory> {
        let mut ends = NO_RANGE;
        if S::LEVELS == 0 {
            ends = steps(slab.size()).map(|core| range(slab, core)).fold(ends, join);
        }
        let mut survey = Self::begin(slab.size(), ends, given)?;
        steps(slab.size()).for_each(|core| survey.add(slab, core));
        Ok(survey)
    }

    fn begin(size: [usize; 3], ends: [f32; 2], given: Option<&MaterialTable>) -> Result<Self, OutOfMemory> {
        let grid = SampleGrid::new(size, POINTS);
        let mut points = Vec::new();
        points
            .try_reserve_exact(grid.len())
            .map_err(|_| OutOfMemory { bytes: grid.len().saturating_mul(size_of::<Neighbourhood<S>>()) })?;
        let given = given.map(|table| {
            let greys: Vec<f64> = table.materials().iter().map(|m| m.mean).collect();
            (table.clone(), thresholds(&greys), vec![false; greys.len()])
        });
        let counts = GreyCounts::new::<S>(ends);
        Ok(Self { size, grid, counts, points, border: Vec::new(), pairs: Vec::new(), given })
    }

    /// Adds the slices `core`, which follow those added before.
    fn add(&mut self, slab: Slab<'_, S>, core: Range<usize>) {
        self.counts.add(slab, core.clone());
        neighbourhood::gather(slab, &self.grid, core.clone(), &mut self.points);
        self.add_pairs(slab, core.clone());
        self.add_border(slab, core.clone());
        let Some((_, thresholds, seen)) = &mut self.given else { return };
        if S::LEVELS > 0 {
            for (value, _) in self.counts.iter().filter(|(_, count)| *count > 0) {
                seen[thresholds.partition_point(|&t| value as f32 >= t)] = true;
            }
            return;
        }
        let none = || vec![false; seen.len()];
        let found = rows(slab, core)
            .into_par_iter()
            .fold(none, |mut seen, row| {
                row.iter().for_each(|v| seen[thresholds.partition_point(|&t| v.to_f32() >= t)] = true);
                seen
            })
            .reduce(none, |a, b| a.iter().zip(b).map(|(a, b)| *a || b).collect());
        seen.iter_mut().zip(found).for_each(|(seen, found)| *seen |= found);
    }

    fn add_pairs(&mut self, slab: Slab<'_, S>, core: Range<usize>) {
        let [across, down, _] = self.grid.points;
        for plane in self.grid.within(core) {
            let z = self.grid.at(plane);
            for line in 0..down {
                let y = self.grid.at(line);
                // Interior points: the next voxel is always there, in the halo at worst.
                let [row, above, next] = [slab.row(y, z), slab.row(y, z + 1), slab.row(y + 1, z)];
                // Another offset in each row, so that no pattern of the volume is favoured.
                let offset = (plane * 5 + line * 3) % CROSSING_SHARE;
                let xs = (offset..across).step_by(CROSSING_SHARE).map(|i| self.grid.at(i));
                self.pairs.extend(xs.map(|x| [row[x], row[x + 1], next[x], above[x]]));
            }
        }
    }

    fn add_border(&mut self, slab: Slab<'_, S>, core: Range<usize>) {
        let [across, down, depth] = self.size;
        let ends = |n: usize| move |i: &usize| *i == 0 || i + 1 == n;
        let stride = self.grid.stride;
        let chosen = |n: usize| (0..n).filter(move |i| i.is_multiple_of(stride) || i + 1 == n);
        let all_x: Vec<usize> = chosen(across).collect();
        let ends_x: Vec<usize> = all_x.iter().copied().filter(ends(across)).collect();
        for z in chosen(depth).filter(|z| core.contains(z)) {
            for y in chosen(down) {
                let on_side = ends(depth)(&z) || ends(down)(&y);
                let row = slab.row(y, z);
                self.border.extend(if on_side { &all_x } else { &ends_x }.iter().map(|&x| row[x]));
            }
        }
    }

    /// How often each grey value occurs.
    #[must_use]
    pub fn counts(&self) -> &GreyCounts {
        &self.counts
    }

    /// About how many lattice edges have ends nearest to different materials: the vertices that a surface
    /// through all of them has. Thinning and the removal of specks leave fewer; junctions add a few.
    #[must_use]
    pub fn crossings(&self, table: &MaterialTable) -> u64 {
        let greys: Vec<f64> = table.materials().iter().map(|m| m.mean).collect();
        let thresholds = thresholds(&greys);
        let crossed: usize = self
            .pairs
            .par_iter()
            .map(|values| {
                let [own, next @ ..] = values.map(|v| class_of(&thresholds, v));
                next.into_iter().filter(|&class| class != own).count()
            })
            .sum();
        let voxels: f64 = self.size.iter().map(|&n| n as f64).product();
        (crossed as f64 * voxels / self.pairs.len().max(1) as f64).round() as u64
    }
}

const NO_RANGE: [f32; 2] = [f32::INFINITY, f32::NEG_INFINITY];

fn join(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Bytes that a [`Survey`] of a volume of `size` voxels takes at most while it is made and used, beside
/// the window on the volume: 60 to 160 million for large volumes, whatever their size.
#[must_use]
pub fn survey_bytes(size: [usize; 3], sample: SampleType) -> u64 {
    let grid = SampleGrid::new(size, POINTS);
    let point =
        with_sample_type!(sample, S => size_of::<Neighbourhood<S>>() + size_of::<[S; 4]>() / CROSSING_SHARE);
    let [x, y, z] = size.map(|n| n / grid.stride + 2);
    // Vectors that grow hold up to twice what they need.
    let border = 4 * (x * y + y * z + z * x) * sample.bytes();
    let tables = (rayon::current_num_threads() + 4) * (1 << 19);
    (grid.len() * point + border + tables) as u64
}

//! What must be known about the surroundings of a voxel to judge it by any thresholds.
//!
//! Whether all voxels around one are of its own class is asked for many sets of thresholds. Classes are
//! ranges of grey, so the smallest and the largest value around answer it for all of them, and the volume
//! is read once.

use std::ops::Range;

use rayon::prelude::*;

use super::sampling::SampleGrid;
use crate::volume::{Sample, Slab};

/// How far around a voxel is looked: past 2.5 sigma of the usual blur less than 1 % of a step is left.
/// Deeper voxels would favour the middle of thick parts, which cupping darkens.
pub(super) const DEPTH: usize = 3;

/// A voxel and its surroundings.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Neighbourhood<S> {
    /// Its value.
    pub(super) grey: S,
    /// The variance of the 27 values around it.
    pub(super) variance: f32,
    /// The smallest value among it and the voxels 1, up to 2, up to 3 steps away in the 26 directions
    /// (axes, diagonals of faces and cubes); its own where the volume ends before.
    low: [S; DEPTH],
    /// The largest.
    high: [S; DEPTH],
    /// How many steps the volume goes on on all sides, at most [`DEPTH`].
    room: u8,
}

impl<S: Sample> Neighbourhood<S> {
    /// How many steps around all voxels are of one class: that of the grey values from the lower to below
    /// the upper end of a range. The voxel itself must be of it.
    pub(super) fn depth(&self, [low, high]: [f32; 2]) -> usize {
        let own = |d: &usize| self.low[*d].to_f32() >= low && self.high[*d].to_f32() < high;
        (0..usize::from(self.room)).take_while(own).count()
    }
}

/// The ranges of grey of the classes between ascending `thresholds`.
pub(super) fn class_ranges(thresholds: &[f32]) -> Vec<[f32; 2]> {
    (0..=thresholds.len())
        .map(|k| {
            let low = k.checked_sub(1).map_or(f32::NEG_INFINITY, |k| thresholds[k]);
            [low, thresholds.get(k).copied().unwrap_or(f32::INFINITY)]
        })
        .collect()
}

/// Appends the neighbourhoods of the grid's points in the slices `core`; `slab` must hold [`DEPTH`] slices
/// on both sides of them, as far as there are any.
pub(super) fn gather<S: Sample>(
    slab: Slab<'_, S>,
    grid: &SampleGrid,
    core: Range<usize>,
    out: &mut Vec<Neighbourhood<S>>,
) {
    let [across, down, _] = grid.points;
    let planes = grid.within(core);
    if across * down == 0 || planes.is_empty() {
        return;
    }
    let start = out.len();
    out.resize(start + across * down * planes.len(), Neighbourhood::default());
    out[start..].par_chunks_mut(across).enumerate().for_each_init(
        || [vec![S::default(); slab.size()[0]], vec![S::default(); slab.size()[0]]],
        |columns, (i, row)| {
            let (y, z) = (grid.at(i % down), grid.at(planes.start + i / down));
            fill_row(slab, grid.stride, [y, z], row, columns);
        },
    );
}

fn fill_row<S: Sample>(
    slab: Slab<'_, S>,
    stride: usize,
    [y, z]: [usize; 2],
    out: &mut [Neighbourhood<S>],
    [low, high]: &mut [Vec<S>; 2],
) {
    let size = slab.size();
    let around: [&[S]; 9] = std::array::from_fn(|i| slab.row(y + i % 3 - 1, z + i / 3 - 1));
    for (i, point) in out.iter_mut().enumerate() {
        let x = 1 + i * stride;
        let grey = around[4][x];
        let room = [x, size[0] - 1 - x, y, size[1] - 1 - y, z, size[2] - 1 - z];
        let room = room.into_iter().fold(DEPTH, usize::min) as u8;
        let variance = variance(&around, x);
        *point = Neighbourhood { grey, variance, low: [grey; DEPTH], high: [grey; DEPTH], room };
    }
    let room = [y, size[1] - 1 - y, z, size[2] - 1 - z].into_iter().fold(DEPTH, usize::min);
    for d in 1..=room {
        let shell: [&[S]; 9] = std::array::from_fn(|i| slab.row(y + i % 3 * d - d, z + i / 3 * d - d));
        low.copy_from_slice(shell[0]);
        high.copy_from_slice(shell[0]);
        for row in &shell[1..] {
            for ((low, high), &v) in low.iter_mut().zip(high.iter_mut()).zip(*row) {
                *low = if v < *low { v } else { *low };
                *high = if v > *high { v } else { *high };
            }
        }
        for (i, point) in out.iter_mut().enumerate().filter(|(_, point)| usize::from(point.room) >= d) {
            let x = 1 + i * stride;
            let before = d.max(2) - 2; // the shells further in are part of it
            let (mut least, mut most) = (point.low[before], point.high[before]);
            for x in [x - d, x, x + d] {
                least = if low[x] < least { low[x] } else { least };
                most = if high[x] > most { high[x] } else { most };
            }
            point.low[d - 1] = least;
            point.high[d - 1] = most;
        }
    }
}

/// The variance of the 27 values around x, of rows in the order of y, then z.
fn variance<S: Sample>(around: &[&[S]; 9], x: usize) -> f32 {
    // Differences from the centre keep the variance exact for large grey values.
    let (sum, squares) = if S::LEVELS > 0 {
        let centre = around[4][x].level() as i64;
        let (mut sum, mut squares) = (0, 0);
        for v in around.iter().flat_map(|row| &row[x - 1..x + 2]) {
            let d = v.level() as i64 - centre;
            sum += d;
            squares += d * d;
        }
        (sum as f64, squares as f64)
    } else {
        let centre = around[4][x].to_f32();
        around.iter().flat_map(|row| &row[x - 1..x + 2]).fold((0.0, 0.0), |(sum, squares), v| {
            let d = f64::from(v.to_f32() - centre);
            (sum + d, squares + d * d)
        })
    };
    (squares / 27.0 - (sum / 27.0).powi(2)).max(0.0) as f32
}

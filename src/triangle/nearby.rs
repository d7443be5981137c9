//! Which triangles can meet one of a few: a coarse sieve before trees are built.
//!
//! Method: a lattice of cells over the mesh; the boxes of the asked triangles mark cells, and a triangle stays if its
//! box has a marked one. Cell numbers grow with the coordinate, rounding included, so two boxes that
//! overlap have a cell in common.

use glam::DVec3;
use rayon::prelude::*;

use super::size_trees::bounds;

/// Cells per axis: two million flags.
const CELLS: usize = 128;

/// Flags the triangles whose boxes may overlap the box of one that is `asked` for; `None` if these are so many
/// that the sieve is not worth while.
pub(super) fn nearby(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    asked: &(impl Fn(usize) -> bool + Sync),
) -> Option<Vec<bool>> {
    let asked: Vec<usize> = (0..triangles.len()).into_par_iter().filter(|&t| asked(t)).collect();
    if asked.len() > triangles.len() / 8 {
        return None;
    }
    let corners = |t: usize| triangles[t].map(|v| positions[v as usize]);
    let (low, high) = bounds(positions);
    let scale = CELLS as f64 / (high - low).max_element().max(f64::MIN_POSITIVE);
    let cell = |p: DVec3| ((p - low) * scale).to_array().map(|c| (c as usize).min(CELLS - 1));
    let cells = |t: usize| {
        let [a, b, c] = corners(t);
        let (first, last) = (cell(a.min(b).min(c)), cell(a.max(b).max(c)));
        let rows = (first[2]..=last[2]).flat_map(move |z| (first[1]..=last[1]).map(move |y| z * CELLS + y));
        rows.map(move |row| row * CELLS + first[0]..row * CELLS + last[0] + 1)
    };
    let mut marked = vec![false; CELLS * CELLS * CELLS];
    for t in asked {
        for row in cells(t) {
            marked[row].fill(true);
        }
    }
    let stays = |t: usize| cells(t).any(|row| marked[row].contains(&true));
    Some((0..triangles.len()).into_par_iter().with_min_len(1 << 10).map(stays).collect())
}

//! From shares of materials to grey values of a slice of the fine grid, with levels that may differ in places.

use super::coverage::FineMesh;
use crate::grid::MaterialId;
use crate::material::Levels;

/// Voxels between places along x where levels are taken; between them they are interpolated.
const STEP: usize = 8;

/// Where the fine grid lies in the volume.
#[derive(Debug, Clone, Copy)]
pub(super) struct FineGrid {
    /// Cells along a voxel.
    pub(super) factor: usize,
    /// Cells before the first voxel, per axis.
    pub(super) before: [usize; 3],
    /// Voxels per axis.
    pub(super) size: [usize; 3],
}

impl FineGrid {
    /// A coordinate in cells, of one in voxels.
    pub(super) fn cells(&self, axis: usize, voxels: f64) -> f64 {
        self.factor as f64 * (voxels + 0.5) + self.before[axis] as f64
    }

    /// The voxel of a cell; beyond the volume the last one before it.
    pub(super) fn voxel(&self, axis: usize, cell: usize) -> usize {
        (cell.saturating_sub(self.before[axis]) / self.factor).min(self.size[axis] - 1)
    }
}

/// The grey values of slice `z` of the fine grid, less `base`.
///
/// # Errors
/// Those of [`FineMesh::runs`].
pub(super) fn fine_slice(
    mesh: &FineMesh<'_>,
    grid: &FineGrid,
    levels: &Levels,
    base: f64,
    z: usize,
) -> Result<Vec<f32>, (usize, MaterialId)> {
    let width = mesh.size[0];
    let mut out = vec![0.0_f32; width * mesh.size[1]];
    let nodes = grid.size[0].div_ceil(STEP) + 1;
    let mut table = vec![0.0_f64; nodes * mesh.materials];
    let mut table_of = None;
    let z_voxel = grid.voxel(2, z) as f32;
    mesh.runs(z, |row, cells, shares| {
        let y = grid.voxel(1, row);
        if table_of != Some(y) {
            table_of = Some(y);
            for (k, values) in table.chunks_mut(nodes).enumerate() {
                for (node, value) in values.iter_mut().enumerate() {
                    let at = [(node * STEP) as f32, y as f32, z_voxel];
                    *value = f64::from(levels.mean(MaterialId(k as u8), at)) - base;
                }
            }
        }
        let out = &mut out[row * width..][cells.clone()];
        for (k, &share) in shares.iter().enumerate().filter(|(_, share)| **share != 0.0) {
            let values = &table[k * nodes..(k + 1) * nodes];
            for (cell, v) in cells.clone().zip(&mut *out) {
                let x = grid.voxel(0, cell);
                let (node, part) = (x / STEP, (x % STEP) as f64 / STEP as f64);
                *v += (share * (values[node] + part * (values[node + 1] - values[node]))) as f32;
            }
        }
    })?;
    Ok(out)
}

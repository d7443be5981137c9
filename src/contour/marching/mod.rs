//! Generalized, non-binary marching cubes (Fujimori and Suzuki §4, after Hege et al. 1997).
//!
//! The padded lattice is walked in *layers* of cells. A layer owns the crossings on the x and y
//! edges of its lower plane and on its z edges, the nodes of the faces whose lower cell lies in it,
//! and the apexes inside its cells. Counting comes first (`count.rs`), then one prefix sum gives
//! every layer its place in the output, then the layers are filled (`fill.rs`): the same mesh for
//! any number of threads. Work follows the surface: rows of cells are looked at 64 at a time, and
//! only cells with a crossing one by one.
//!
//! Guarantees and their proofs: `docs/contouring.md`. Halo: one voxel.

mod cell;
mod count;
mod edge_rows;
mod fill;

use rayon::prelude::*;

use super::crossing::CrossingRule;
use super::error::ContourError;
use super::patch::{Border, Patch};
use crate::classify::LabelVolume;
use crate::execution::Execution;
use crate::grid::{MaterialId, Pair, VertexKind};

use count::LayerCount;
use fill::LayerSlices;

/// Extracts the interfaces of a labelled volume.
///
/// # Errors
/// [`ContourError::TooManyVertices`] or [`ContourError::TooManyTriangles`] if an index could not name them;
/// [`ContourError::Cancelled`] if asked to stop.
pub fn march<C: CrossingRule>(
    labels: &LabelVolume,
    rule: &C,
    border: Border,
    execution: &Execution,
) -> Result<Patch, ContourError> {
    let layers = labels.codes().padded()[2] - 1;
    let stage = execution.stage("contouring", 2 * layers as u64);
    let counts: Vec<LayerCount> = (0..layers)
        .into_par_iter()
        .map(|z| {
            execution.check()?;
            let count = LayerCount::new(labels, rule, border, z);
            stage.advance(1);
            Ok(count)
        })
        .collect::<Result<_, ContourError>>()?;
    let vertices: u64 = counts.iter().map(LayerCount::vertices).sum();
    // PLY indices are signed; better refused now than after all the work.
    let limit = u64::from(i32::MAX.unsigned_abs());
    if vertices > limit {
        return Err(ContourError::TooManyVertices { vertices, limit });
    }
    let triangles: usize = counts.iter().map(|c| c.triangles).sum();
    let limit = u64::from(u32::MAX);
    if triangles as u64 > limit {
        return Err(ContourError::TooManyTriangles { triangles: triangles as u64, limit });
    }
    let any_pair = Pair::new(MaterialId(1), MaterialId::BACKGROUND);
    let mut patch = Patch {
        positions: vec![[0.0; 3]; vertices as usize],
        kinds: vec![VertexKind::Interface; vertices as usize],
        triangles: vec![[0; 3]; triangles],
        pairs: any_pair.map_or_else(Vec::new, |pair| vec![pair; triangles]),
    };
    let mut slices = Vec::with_capacity(layers);
    {
        let (mut positions, mut kinds) = (&mut patch.positions[..], &mut patch.kinds[..]);
        let (mut tris, mut pairs) = (&mut patch.triangles[..], &mut patch.pairs[..]);
        let mut first_vertex = 0;
        for count in &counts {
            let v = count.vertices() as usize;
            slices.push(LayerSlices {
                first_vertex,
                positions: positions.split_off_mut(..v).unwrap_or_default(),
                kinds: kinds.split_off_mut(..v).unwrap_or_default(),
                triangles: tris.split_off_mut(..count.triangles).unwrap_or_default(),
                pairs: pairs.split_off_mut(..count.triangles).unwrap_or_default(),
            });
            first_vertex += v as u32;
        }
    }
    let firsts: Vec<u32> = slices.iter().map(|s| s.first_vertex).collect();
    slices.into_par_iter().enumerate().try_for_each(|(z, out)| {
        execution.check()?;
        let above = counts.get(z + 1).zip(firsts.get(z + 1).copied());
        fill::fill_layer(labels, rule, border, z, &counts[z], above, out);
        stage.advance(1);
        Ok::<(), ContourError>(())
    })?;
    drop(stage);
    Ok(patch)
}

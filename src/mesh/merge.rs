//! [`MeshMerger`]: pieces of a mesh, put together in memory.

use glam::DVec3;

use super::interface_mesh::Parts;
use super::{InterfaceMesh, MeshError, MeshMaterial, MeshPiece};
use crate::contour::append_sigmas;
use crate::grid::{Pair, VertexKind};

/// Puts pieces that come in order together to one mesh. A mesh in one piece is not copied.
#[derive(Debug, Default)]
pub struct MeshMerger {
    positions: Vec<DVec3>,
    kinds: Vec<VertexKind>,
    sigmas: Vec<f32>,
    triangles: Vec<[u32; 3]>,
    pairs: Vec<Pair>,
}

impl MeshMerger {
    /// Adds the next piece.
    ///
    /// # Errors
    /// [`MeshError::Piece`] if another piece should have come.
    pub fn add(&mut self, piece: MeshPiece) -> Result<(), MeshError> {
        let MeshPiece { mesh, owned, first_vertex, first_triangle, .. } = piece;
        let here = [self.positions.len() as u64, self.triangles.len() as u64];
        if [first_vertex, first_triangle] != here {
            return Err(MeshError::Piece { got: [first_vertex, first_triangle], needed: here });
        }
        let offset = u32::try_from(first_vertex)
            .map_err(|_| MeshError::Piece { got: [first_vertex, first_triangle], needed: here })?;
        let Parts { mut positions, mut kinds, mut sigmas, mut triangles, pairs } = mesh.into_parts();
        positions.truncate(owned);
        kinds.truncate(owned);
        sigmas.truncate(owned);
        if here == [0, 0] {
            *self = Self { positions, kinds, sigmas, triangles, pairs };
            return Ok(());
        }
        append_sigmas(&mut self.sigmas, self.positions.len(), &sigmas, positions.len());
        triangles.iter_mut().flatten().for_each(|v| *v = v.saturating_add(offset));
        self.positions.append(&mut positions);
        self.kinds.append(&mut kinds);
        self.triangles.append(&mut triangles);
        self.pairs.extend(pairs);
        Ok(())
    }

    /// The mesh of all pieces.
    ///
    /// # Errors
    /// As [`InterfaceMesh::new`]: the last piece had a seam, or a triangle a material that is not listed.
    pub fn finish(self, materials: Vec<MeshMaterial>) -> Result<InterfaceMesh, MeshError> {
        InterfaceMesh::new(self.positions, self.kinds, self.triangles, self.pairs, materials)?
            .with_sigmas(self.sigmas)
    }
}
